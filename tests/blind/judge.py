"""What a diagnosis is worth against the truth."""

from dataclasses import dataclass

HARMLESS = {"tails": {"data_fault", "range_noise"}, "marker": {"range_noise", "data_fault"}}


@dataclass(frozen=True)
class Judgement:
    """One verdict judged.

    Attributes:
        outcome: ``right`` (complete and nothing else), ``set`` (the truth among several that fit), ``extra`` (the truth
            and something that is not), ``partial`` (one of two), ``alone`` (one of exact twins), ``unexplained``,
            ``missed`` (adequate, but something is wrong), ``wrong`` (named without the truth), ``quiet`` (nothing is
            wrong, or too little to be seen, and nothing is said).
        place: The places of right names are right, or None.
        said: The names, for the table.
        remainder: The diagnosis says that something is left.
        together: All true names are in the reported set.
    """

    outcome: str
    place: bool | None
    said: str
    remainder: bool
    together: bool


def reported(found: dict) -> tuple[set, set]:
    """Names of the causes, and those together with what fits as well."""
    names = {cause["name"] for cause in found["causes"]}
    also = {other.partition("@")[0] for cause in found["causes"] for other in cause["ambiguous_with"]}
    return names, names | also


def judge(kind: str, causes: tuple, kin: tuple, found: dict) -> Judgement:
    """Judge the content of a diagnose.json.

    Args:
        kind: Kind of the case, ``group:detail``.
        causes: (name, where) of the truth.
        kin: Names that fit exactly as well.
        found: The diagnosis.
    """
    names, wide = reported(found)
    true = {name for name, _ in causes}
    said = "+".join(sorted(names)) + ("?" if wide - names else "") or found["verdict"]
    if found["verdict"] == "unexplained":
        said = "unexplained" + (f"({'+'.join(sorted(names))})" if names else "")
    outcome = _outcome(kind.split(":"), true, set(kin), found["verdict"], names, wide, bool(found["remainder"]))
    places = {(cause["name"], cause["where"]) for cause in found["causes"]}
    known = [(name, where) for name, where in causes if where is not None and name in names]
    place = all(_same_place(item, places) for item in known) if known else None
    return Judgement(outcome, place, said, bool(found["remainder"]), bool(true) and true <= wide)


def _same_place(item, places):
    """A pose counts also where one marker of it is accused."""
    name, where = item
    return any(other == name and (place or "").split("/")[0] == where for other, place in places)


def _outcome(kind, true, kin, verdict, names, wide, remainder):
    group, detail = kind[0], kind[-1]
    if group == "outside":
        return "right" if verdict == "unexplained" or remainder else "missed" if verdict == "adequate" else "wrong"
    if not true:
        guilty = names - HARMLESS.get(detail, set()) if group == "noise" else names
        return (
            "wrong" if guilty and verdict != "unexplained" else "unexplained" if verdict == "unexplained" else "quiet"
        )
    if verdict == "adequate":
        return "quiet" if group == "below" else "missed"
    if verdict == "unexplained":
        return "unexplained"
    if kin:
        return "wrong" if not true <= wide else "right" if kin & wide else "alone"
    return _named(true, names, wide)


def _named(true, names, wide):
    """The outcome where causes are named."""
    if not true & wide:
        return "wrong"
    if not true <= wide:
        return "partial"
    if names - true and true <= names:
        return "extra"
    return "right" if wide == true else "set"


def confident(found: dict) -> bool:
    """The diagnosis names causes and leaves no doubt about them."""
    doubt = any(cause["ambiguous_with"] for cause in found["causes"])
    return found["verdict"] == "cause_found" and not doubt and not found["remainder"]
