"""The sections of a diagnosis: verdict, causes, held-out errors, the extended model, what to measure next."""

from __future__ import annotations

from doe.report.folder import Entry, Folder
from doe.report.page import Markup, element, joined, table
from doe.report.pictures import curve, heldout
from doe.report.screen_section import wrong_section
from doe.report.words import (
    cause_words,
    gain_words,
    length,
    noise_words,
    number,
    place_words,
    probability,
    rival_words,
    size_words,
    verdict_label,
    verdict_words,
)

__all__ = ["diagnosis_sections"]

_LINES = 12  # of a fault
_POSES = 60  # of the plan
_WHEN = ("before", "after")

_GATES = {
    "holm": "The stated noise agrees with what the extended model leaves. A cause counts if its probability, times the "
    "number of causes tried (Holm), is below 1 %.",
    "flip": "The readings contradict the stated noise even with the extended model. A cause counts if hardly any of "
    "many random flips of the signs of whole poses shows as much; this needs no stated noise.",
}


def diagnosis_sections(diagnosis: Entry, folder: Folder) -> list[Markup]:
    """All sections of a diagnosis, the verdict first."""
    return [
        _verdict(diagnosis),
        wrong_section(diagnosis, folder),
        _causes(diagnosis, folder),
        _gain(diagnosis),
        _model(diagnosis),
        _next(diagnosis, folder),
    ]


def _verdict(diagnosis: Entry) -> Markup:
    """The verdict in words, and the figures that matter most."""
    verdict = str(diagnosis["verdict"])
    known = verdict if verdict in {"adequate", "cause_found", "ambiguous", "unexplained"} else "unknown"
    notes, gained = diagnosis.texts("notes"), gain_words(diagnosis["gain"])
    return joined(
        element(
            "div",
            element("span", f"1. Verdict: {verdict_label(verdict)}", class_="label"),
            element("h1", verdict_words(diagnosis)),
            element("p", gained) if gained else None,
            class_=f"verdict {known}",
        ),
        element("div", *_cards(diagnosis), class_="cards"),
        element("ul", *(element("li", note) for note in notes), class_="quiet") if notes else None,
    )


def _cards(diagnosis: Entry) -> list[Markup]:
    """The figures that matter most."""
    gain, noise, measured = diagnosis["gain"], diagnosis.table("noise"), diagnosis.get("measured")
    lack, wrong = diagnosis.table("lack_of_fit"), diagnosis.table("wrong")
    cards = []
    if gain is not None:
        after = length(gain["heldout_rms_after_mm"])
        before = length(gain["heldout_rms_before_mm"])
        cards.append((f"{before} → {after}", "mm, error on held-out poses, before and after"))
        cards.append((f"{length(gain['noise_rms_mm'])} mm", "would be left by the noise alone"))
    else:
        cards.append((f"{length(wrong['rms_mm'])} mm", "error of the fitted model, rms"))
    ratios = [length(lack.table(when).number("chi2") / max(lack.table(when).number("dof"), 1.0)) for when in _WHEN]
    cards.append((ratios[0] if ratios[0] == ratios[1] else " → ".join(ratios), "χ² per degree of freedom; 1 is noise"))
    if noise["found_mm"] is not None:
        stated = f"noise of a reading as found; {length(noise['stated_mm'])} mm stated"
        cards.append((f"{length(noise['found_mm'])} mm", stated))
    if measured is not None:
        cards.append((f"{measured['poses']} poses", f"{measured['readings']} readings of {measured['robot']}"))
    return [element("div", element("b", figure), element("span", words), class_="card") for figure, words in cards]


def _causes(diagnosis: Entry, folder: Folder) -> Markup:
    """Every cause with sizes, evidence and rivals."""
    causes = diagnosis.tables("causes")
    parts: list[Markup] = [element("h2", "3. The cause" if len(causes) == 1 else "3. The causes")]
    if not causes:
        parts.append(element("p", "No cause is named: nothing that was tried is significant."))
    else:
        gate = str(diagnosis["significance"])
        parts.append(element("p", _GATES.get(gate, gate), class_="quiet"))
    drawn = {str(found["cause"]): found for found in diagnosis.tables("curves")} if diagnosis.get("curves") else {}
    parts += [_cause(cause, drawn, folder) for cause in causes]
    said = noise_words(diagnosis)
    return joined(*parts, element("p", said) if said else None)


def _cause(cause: Entry, drawn: dict[str, Entry], folder: Folder) -> Markup:
    """One cause."""
    name, where = str(cause["name"]), cause["where"]
    entry = name if where is None else f"{name}@{where}"
    title = cause_words(name, where)
    if cause.get("what") is not None:
        return element("div", element("h3", _capital(title)), _fault(cause), class_="cause")
    parts = [
        element("h3", _capital(title), " ", element("code", entry)),
        element("p", f"Evidence: {probability(cause['p_value'])}, corrected for everything that was tried."),
        _sizes(cause),
        _options(cause),
        _rivals(cause, folder),
    ]
    if entry in drawn:
        text = f"Its curve over the measured range{place_words(where)}, with the 95 % band of each point."
        parts.append(element("figure", curve(drawn[entry]), element("figcaption", text)))
    return element("div", *parts, class_="cause")


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _sizes(cause: Entry) -> Markup | None:
    """Fitted sizes with intervals, and how they compare."""
    rows = [
        (
            element("code", p["name"]),
            f"{number(p['value'])} {p['unit']}",
            " to ".join(map(number, p.numbers("ci95"))) if p.get("ci95") else f"± {number(p['std'])} (std)",
            _judged(size_words(cause, p), plausible=bool(p.get("plausible", True))),
        )
        for p in cause.tables("parameters")
    ]
    header = ("parameter", "value", "95 % interval", "compared with what is known")
    return table(header, rows, words=(0, 3)) if rows else None


def _judged(words: str, *, plausible: bool) -> Markup:
    return element("span", words, class_=None if plausible else "warn")


def _options(cause: Entry) -> Markup | None:
    """Options with which the cause was found."""
    options = cause.get("options")
    said = "" if options is None else ", ".join(f"{key} = {_value(value)}" for key, value in options.items())
    return element("p", f"Found with {said}.", class_="quiet") if said else None


def _value(value: object) -> str:
    """An option as text."""
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    return number(value, 4) if isinstance(value, int | float) else str(value)


def _rivals(cause: Entry, folder: Folder) -> Markup:
    """What explains the same, and what would settle it."""
    rivals = cause.texts("ambiguous_with")
    if not rivals:
        return element("p", "Nothing else that was tried explains the same.")
    settle = (
        "The poses of section 6 would separate them."
        if folder.next_poses is not None
        else "No poses that would separate them are proposed here; section 6 says what else helps."
    )
    listed = element("ul", *(element("li", rival_words(rival), " ", element("code", rival)) for rival in rivals))
    return joined(element("p", "Explains as well, within what these data can tell:"), listed, element("p", settle))


def _fault(cause: Entry) -> Markup:
    """A faulty row: what is wrong with it, and where it stands in the file."""
    lines = cause.texts("lines") if cause.get("lines") is not None else []
    shown = ", ".join(lines[:_LINES]) + (f" and {len(lines) - _LINES} more" if len(lines) > _LINES else "")
    return joined(
        element("p", f"{_capital(str(cause['what']))}: {length(cause['error_mm'])} mm off."),
        element(
            "p", f"Line{'s'[: len(lines) > 1]} {shown} of the measurements; left out of the fit and of all errors."
        ),
    )


def _gain(diagnosis: Entry) -> Markup:
    """Errors on held-out poses."""
    gain = diagnosis["gain"]
    title = element("h2", "4. Before and after, on held-out poses")
    if gain is None:
        return joined(title, element("p", "No cause is named, so that there is nothing to compare."))
    low, high = (float(end) for end in gain.numbers("ci95"))
    claim = (
        f"The error falls to {100 * low:.0f} to {100 * high:.0f} % of what it was (95 % interval)."
        if gain["significant"]
        else f"The ratio after / before is {low:.2f} to {high:.2f} (95 % interval): no gain is claimed."
    )
    how = (
        f"Rms of the 3-D error of a marker on {gain['poses_heldout']} poses; for each of them the causes were chosen "
        "and fitted without it. Faulty rows are left out on both sides."
    )
    return joined(title, element("p", claim), element("figure", heldout(gain), element("figcaption", how)))


def _model(diagnosis: Entry) -> Markup:
    """The extended model and how to use it."""
    identified, study = diagnosis.table("identification"), diagnosis.get("extended_study")
    rows = [
        (
            element("code", p["name"]),
            f"{number(p['value'], 4)}",
            p["unit"],
            " to ".join(number(end, 4) for end in p.numbers("ci95")),
        )
        for p in identified.tables("parameters")
        if not p["nuisance"]
    ]
    kind = f"Intervals from {identified['covariance_kind']}; reference {identified['reference']}."
    file = str(study or "the study")
    return joined(
        element("h2", "5. The extended model"),
        element("p", "Effects: ", element("code", ", ".join(diagnosis.texts("extended_model")) or "none"), "."),
        table(("parameter", "value", "unit", "95 % interval"), rows, words=(0, 2)) if rows else None,
        _held(identified),
        element("p", kind, class_="quiet"),
        element("p", "The study with these effects stands in ", element("code", file), ". In this folder:"),
        element(
            "pre",
            f"elastocal predict  {file} diagnose.json PLAN.csv --out DIR\n"
            f"elastocal identify {file} MEASUREMENTS.csv --out DIR",
        ),
    )


def _held(identified: Entry) -> Markup | None:
    """What could not be identified."""
    held = identified.tables("nonidentifiable")
    if not held:
        return None
    listed = (element("li", element("code", item["name"]), f": {item['why']}") for item in held)
    return joined(element("p", "Held at the nominal value, because these data do not show it:"), element("ul", *listed))


def _next(diagnosis: Entry, folder: Folder) -> Markup:
    """The poses to measure next."""
    title, plan = element("h2", "6. What to measure next"), folder.next_poses
    if plan is None:
        return joined(title, element("p", _advice(diagnosis)))
    names = list(plan.cells)
    rows = list(zip(*(plan.cells[name] for name in names), strict=True))
    more = f" The first {_POSES} of {len(rows)} rows:" if len(rows) > _POSES else ""
    text = f"These poses would separate what is ambiguous; they stand in {plan.path.name}.{more}"
    return joined(title, element("p", text), table(names, rows[:_POSES], words=(0, 1)))


def _advice(diagnosis: Entry) -> str:
    """What helps where no poses are proposed."""
    verdict = diagnosis["verdict"]
    if verdict == "adequate":
        return "Nothing: the model is adequate for what these poses show."
    if verdict == "ambiguous":
        return (
            "No plan stands in this folder. Measure further poses in which the rivals differ: other loads, other sides "
            "of the workspace, the unloaded state at each pose."
        )
    if diagnosis["remainder"] or verdict == "unexplained":
        on = diagnosis["remainder_depends_on"]
        more = "" if on is None else f" Vary {on} on its own, everything else held."
        return "Repeat some poses at another time and from another side, and record temperature and approach." + more
    if all(cause["name"] == "data_fault" for cause in diagnosis.tables("causes")):
        return "Correct the faulty rows in the file or read them again, then diagnose again."
    return "Nothing is needed to tell the cause. After a repair, measure the worst poses of section 2 again."
