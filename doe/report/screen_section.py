"""What was wrong, before any name: tables and pictures of the residual."""

from __future__ import annotations

import numpy as np

from doe.report.folder import Entry, Folder, Residuals
from doe.report.page import Markup, element, joined, table
from doe.report.pictures import against, maps, scale_of
from doe.report.words import heading, length, number, probability
from identify.arrays import Floats

__all__ = ["wrong_section"]

_DEPENDENCES = 8


def wrong_section(diagnosis: Entry, folder: Folder) -> Markup:
    """Rms by axis, marker, load and pose; lack of fit; dependences; pictures."""
    wrong, residuals = diagnosis.table("wrong"), folder.residuals
    changes = diagnosis["reference"] == "differences"
    what = "changes of readings between loads" if changes else "readings"
    parts = [
        element("h2", "2. What was wrong"),
        element(
            "p",
            f"Residual (reading minus simulation, base frame) of {what} before any cause was named: "
            f"{length(wrong['rms_mm'])} mm rms, {length(wrong['max_mm'])} mm at most. ",
            element("span", "Before", class_="b"), " and ", element("span", "after", class_="a"),
            " the causes of section 3 were put in.",
        ),
        _groups(wrong, residuals),
        element("h3", "Lack of fit"),
        _lack_of_fit(diagnosis),
        element("h3", "What the residual goes with"),
        _dependences(wrong),
    ]  # fmt: skip
    return joined(*parts, *(_no_pictures() if residuals is None else _pictures(residuals)))


def _no_pictures() -> list[Markup]:
    return [element("p", "residuals.csv does not stand in this folder, so that there are no pictures.", class_="quiet")]


def _groups(wrong: Entry, residuals: Residuals | None) -> Markup:
    """Tables of the rms before and after, side by side."""
    worst = {str(item["pose"]): item["rms_mm"] for item in wrong.tables("worst_poses")}
    after = _after(residuals)
    kinds = (("axis", "axis_rms_mm"), ("marker", "marker_rms_mm"), ("load", "load_rms_mm"))
    tables = [_group(kind, dict(wrong.table(key).items()), after.get(kind)) for kind, key in kinds]
    return element("div", *tables, _group("worst poses", worst, after.get("pose")), class_="grid2")


def _after(residuals: Residuals | None) -> dict[str, dict[str, float]]:
    """Rms after the extension by axis, marker, load and pose."""
    if residuals is None:
        return {}
    square = residuals.after**2
    by = {
        kind: _rms_by(square.sum(axis=1), ids)
        for kind, ids in (("marker", residuals.marker), ("load", residuals.load), ("pose", residuals.pose))
    }
    return {"axis": dict(zip("xyz", np.sqrt(square.mean(axis=0)).tolist(), strict=True)), **by}


def _rms_by(square: Floats, ids: np.ndarray) -> dict[str, float]:
    """Root of the mean square of each id."""
    names, index = np.unique(ids, return_inverse=True)
    mean = np.bincount(index, square) / np.bincount(index)
    return dict(zip(names.tolist(), np.sqrt(mean).tolist(), strict=True))


def _group(kind: str, before: dict[str, object], after: dict[str, float] | None) -> Markup:
    """One table with bars."""
    later = after or {}
    sizes = [value for value in [*before.values(), *later.values()] if isinstance(value, int | float)]
    known = {name: later.get(name) for name in before}
    largest = max([s for s in sizes if s > 0], default=1.0)
    rows = [
        (name, length(size), length(known[name]), _bars(size, known[name], largest)) for name, size in before.items()
    ]
    return table((kind, "before, mm", "after, mm", ""), rows, words=(0, 3))


def _bars(before: object, after: object, largest: float) -> Markup:
    """Two bars below each other."""

    def bar(value: object, kind: str) -> Markup | None:
        if not isinstance(value, int | float):
            return None
        return element("i", class_=kind, style=f"width:{min(100.0 * value / largest, 100.0):.1f}%")

    return element("div", bar(before, "b"), bar(after, "a"), class_="bar")


def _lack_of_fit(diagnosis: Entry) -> Markup:
    """Chi-square and the comparison with replicates, before and after."""
    lack = diagnosis.table("lack_of_fit")
    rows = []
    for when in ("before", "after"):
        own = lack.table(when)
        ratio = own.number("chi2") / max(own.number("dof"), 1.0)
        rows.append((when, number(own["chi2"], 5), str(own["dof"]), length(ratio), probability(own["p_value"])))
    against_noise = table(("against the stated noise", "χ²", "degrees of freedom", "χ²/dof", ""), rows)
    repeated = diagnosis.table("wrong").get("replicates")
    if repeated is None:
        missing = "No reading was repeated, so that the fit cannot be compared with replicates."
        return joined(against_noise, element("p", missing, class_="quiet"))
    ratios = [
        (when, length(repeated.table(when)["ratio"]), probability(repeated.table(when)["p_value"]))
        for when in ("before", "after")
    ]
    return joined(
        against_noise,
        table(("against replicates", "variance ratio", ""), ratios),
        element(
            "p",
            f"{repeated['readings']} readings have replicates ({repeated['dof']} degrees of freedom); one coordinate "
            f"scatters among them with {length(repeated['std_mm'])} mm. The ratio is 1 for a model that fits, whatever "
            "noise is stated.",
            class_="quiet",
        ),
    )


def _dependences(wrong: Entry) -> Markup:
    """The strongest rank correlations."""
    rows = [
        (heading(str(item["column"])), str(item["axis"]), number(item["correlation"], 2), probability(item["p_value"]))
        for item in wrong.tables("depends_on")[:_DEPENDENCES]
    ]
    if not rows:
        return element("p", "Too few readings, or nothing varies.", class_="quiet")
    return table(("quantity", "axis of the residual", "rank correlation", ""), rows, words=(0, 1))


def _pictures(residuals: Residuals) -> list[Markup]:
    """Residual against every quantity that varies, and maps."""
    scale = scale_of(residuals)
    columns = [name for name, values in residuals.quantities.items() if np.ptp(residuals.by_shot(values)) > 0]
    return [
        element("h3", "Residual against everything recorded"),
        element("div", *(element("figure", against(residuals, column, scale)) for column in columns), class_="grid3"),
        element(
            "figcaption",
            "Each dot is the mean over the markers of one reading before the causes were put in, mm; lines are means "
            "of neighbours, ", element("span", "before", class_="b"), " and ", element("span", "after", class_="a"),
            ". Torques are those of load and self-weight together. All panels have one scale.",
        ),
        element("h3", "Over the workspace"),
        element("figure", maps(residuals), element("figcaption", "Residual vectors, mean over the markers.")),
    ]  # fmt: skip
