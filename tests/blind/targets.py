"""Rates that are promised, with binomial bounds."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta


@dataclass(frozen=True)
class Rate:
    """How often something happened, and what was promised.

    Attributes:
        name: What is counted.
        hits, of: Number, and out of how many.
        limit: The promised rate.
        least: True if it is to be at least that, False if at most.
    """

    name: str
    hits: int
    of: int
    limit: float
    least: bool

    def bounds(self, alpha: float = 0.05) -> tuple[float, float]:
        """Clopper-Pearson interval of two-sided level 1 - alpha."""
        low = beta.ppf(alpha / 2, self.hits, self.of - self.hits + 1) if self.hits else 0.0
        high = beta.ppf(1 - alpha / 2, self.hits + 1, self.of - self.hits) if self.hits < self.of else 1.0
        return float(low), float(high)

    def broken(self, alpha: float) -> bool:
        """The promise is refuted at a one-sided level alpha."""
        if not self.of:
            return False
        low, high = self.bounds(2 * alpha)
        return high < self.limit if self.least else low > self.limit

    @property
    def met(self) -> bool:
        """The observed rate itself keeps the promise (true if nothing was counted)."""
        rate = self.hits / self.of if self.of else self.limit
        return rate >= self.limit if self.least else rate <= self.limit


def rates(outcomes: list[dict]) -> list[Rate]:
    """All promised rates over the outcomes of an exam."""
    ended = [o for o in outcomes if "outcome" in o]
    clean = [o for o in ended if o["group"] == "clean"]
    jitter = [o for o in ended if o["kind"] == "noise:jitter"]
    louder = [o for o in ended if o["kind"] in {"noise:jitter", "noise:reading"}]
    noise = [o for o in ended if o["group"] == "noise" and o["kind"] != "noise:range"]
    single = [o for o in ended if o["group"] == "single" and o["judged"]]
    exact = [o for o in ended if o["group"] == "confounded"]
    pairs = [o for o in ended if o["group"] == "pair" and o["judged"]]
    strange = [o for o in ended if o["group"] == "outside" and o["judged"]]
    named = [o for o in single + exact if o["outcome"] not in {"unexplained", "missed"}]
    true = [o for o in single if o["outcome"] == "right"]
    gains = [o for o in true if o.get("gain") is not None]
    faulty = [o for o in ended if o["group"] == "fault"]

    def rate(name, pool, test, limit, least):
        return Rate(name, sum(bool(test(o)) for o in pool), len(pool), limit, least)

    def is_(*words):
        return lambda o: o["outcome"] in words

    lost = [o for o in ended if "robbed" in o]
    more = [o for o in ended if o.get("more") and o["more"]["resolvable"]]
    differ = [o for o in more if o["more"]["proposed"] != o["more"]["random"]]
    return [
        rate("the command ends with 0", outcomes, lambda o: "outcome" in o, 1.0, True),
        rate("clean data named", clean, is_("wrong"), 0.02, False),
        rate("clean data unexplained", clean, is_("unexplained"), 0.02, False),
        rate("jitter twice as large: named", jitter, is_("wrong"), 0.07, False),
        rate("jitter or reading misstated: unexplained", louder, is_("unexplained"), 0.1, False),
        rate("other noise: named", noise, is_("wrong"), 0.07, False),
        rate("truth in the set where named", named, lambda o: o["together"], 0.97, True),
        rate("right and alone where resolvable", [o for o in single if o["resolvable"]], is_("right"), 0.85, True),
        rate("wrong name", single + exact, is_("wrong"), 0.02, False),
        rate("below detection: wrong name", [o for o in ended if o["group"] == "below"], is_("wrong"), 0.05, False),
        rate("missed", single, is_("missed"), 0.03, False),
        rate("place right where the name is", [o for o in true if o["place"] is not None], _placed, 0.85, True),
        rate("exact twins given as a set", exact, is_("right"), 0.9, True),
        rate("strangers unexplained or flagged", strange, is_("right"), 0.9, True),
        rate("remainder beside right and complete", true, lambda o: o["remainder"], 0.1, False),
        rate("pairs both named", pairs, lambda o: o["together"], 0.9, True),
        rate("faulty pose named", faulty, lambda o: o["together"] and o["place"], 0.9, True),
        rate("held-out error within 1.3 of the oracle's", gains, lambda o: o["gain"] <= 1.3, 0.9, True),
        rate("effect taken out of the library: confident name", lost, lambda o: o["robbed"], 0.05, False),
        rate("proposed poses resolve", more, lambda o: o["more"]["proposed"], 0.9, True),
        rate("where only one resolves, the proposed do", differ, lambda o: o["more"]["proposed"], 0.5, True),
    ]


def _placed(outcome):
    return outcome["place"]


def confusion(outcomes: list[dict]) -> str:
    """Table: one row a kind of truth, one column an outcome, then what was said most often."""
    words = ("right", "set", "extra", "partial", "alone", "quiet", "unexplained", "missed", "wrong", "failed")
    short = ("right", "set", "extra", "part", "alone", "quiet", "unexp", "missed", "wrong", "fail")
    rows = sorted({_row(o) for o in outcomes})
    lines = [f"{'truth':34}{'n':>4}" + "".join(f"{word:>7}" for word in short) + "  said instead"]
    for row in rows:
        mine = [o for o in outcomes if _row(o) == row]
        count = Counter(o.get("outcome", "failed") for o in mine)
        said = Counter(o.get("said", "failed") for o in mine if o.get("outcome") not in {"right", "quiet"})
        cells = "".join(f"{count[word] or '.':>7}" for word in words)
        lines.append(f"{row:34}{len(mine):>4}{cells}  " + ", ".join(f"{w} {n}" for w, n in said.most_common(3)))
    return "\n".join(lines)


def _row(outcome):
    names = "+".join(sorted(name for name, _ in outcome["causes"]))
    return outcome["kind"] if outcome["group"] not in {"single", "pair"} else f"{outcome['group']}:{names}"


def report(outcomes: list[dict], alpha: float) -> tuple[str, list[Rate]]:
    """The text of an exam and the promises that are refuted at a level alpha."""
    lines = [confusion(outcomes), ""]
    broken = []
    for rate in rates(outcomes):
        low, high = rate.bounds() if rate.of else (0.0, 1.0)
        sign = ">=" if rate.least else "<="
        mark = "BROKEN" if rate.broken(alpha) else "ok" if rate.met else "missed, not refuted"
        broken += [rate] if rate.broken(alpha) else []
        share = f"{rate.hits / rate.of:.3f}" if rate.of else "-"
        bounds = f"[{low:.3f}, {high:.3f}]"
        lines.append(f"{rate.name:48}{rate.hits:>5}/{rate.of:<5}{share:>7} {bounds} {sign} {rate.limit:.2f}  {mark}")
    more = [o["more"] for o in outcomes if o.get("more")]
    if more:
        wins = [sum(m[key] for m in more) for key in ("proposed", "random")]
        lines.append(f"ambiguities resolved by extra poses: proposed {wins[0]}, random {wins[1]} of {len(more)}")
    seconds = [o["seconds"] for o in outcomes if "seconds" in o]
    if seconds:
        quick, slow = np.median(seconds), np.quantile(seconds, 0.95)
        lines.append(f"time of one diagnosis: median {quick:.2f} s, 95 % below {slow:.2f} s")
    return "\n".join(lines), broken
