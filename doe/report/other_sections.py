"""Sections of the other results of a folder, and where everything comes from."""

from __future__ import annotations

from collections.abc import Callable

from doe.report.compensation_section import compensation_section
from doe.report.folder import Folder
from doe.report.page import Markup, element, joined, table
from doe.report.plan_section import evaluate_section, plan_section
from doe.report.words import millimetres, number

__all__ = ["other_sections", "provenance_section"]


def other_sections(folder: Folder) -> list[Markup]:
    """Plan, evaluation, identification, compensation, prediction and reduction, where they stand."""
    return [joined(element("h2", title), show(folder)) for command, (title, show) in _SHOWN.items()
            if command in folder.results]  # fmt: skip


def _identified(folder: Folder) -> Markup:
    """Parameters with intervals, and the errors."""
    result = folder.results["identify"]
    rows = [
        (
            element("code", p["name"]),
            number(p["value"], 4),
            p["unit"],
            " to ".join(number(end, 4) for end in p.numbers("ci95")),
        )
        for p in result.tables("parameters")
        if not p["nuisance"]
    ]
    heldout = result["heldout"]
    errors = f"Error after the fit: {millimetres(result.table('residual')['rms_mm'])} rms"
    errors += "" if heldout is None else f"; on {heldout['poses']} held-out poses {millimetres(heldout['rms_mm'])}"
    return joined(
        element("p", f"{errors}. Intervals from {result['covariance_kind']}; reference {result['reference']}."),
        table(("parameter", "value", "unit", "95 % interval"), rows, words=(0, 2)),
        element("ul", *(element("li", note) for note in result.texts("notes")), class_="quiet"),
    )


def _predicted(folder: Folder) -> Markup:
    """How sure the prediction is."""
    result = folder.results["predict"]
    return element(
        "p",
        f"{result['rows']} readings predicted in predicted.csv; standard deviation "
        f"{millimetres(result['std_rms_mm'])} rms, {millimetres(result['std_max_mm'])} at most.",
    )


def _reduced(folder: Folder) -> Markup:
    """The chain of reductions."""
    result = folder.results["reduce"]
    chain, groups = dict(result.table("chain").items()), dict(result.table("groups").items())
    return joined(
        table(list(chain), [[str(size) for size in chain.values()]], words=()),
        element("p", f"Rank {result['rank']}; groups {', '.join(f'{name}: {size}' for name, size in groups.items())}."),
    )


_SHOWN: dict[str, tuple[str, Callable[[Folder], Markup]]] = {
    "plan": ("The plan", plan_section),
    "evaluate": ("Poses that were judged", evaluate_section),
    "identify": ("The identification", _identified),
    "compensate": ("What compensation changed", compensation_section),
    "predict": ("The prediction", _predicted),
    "reduce": ("The reduction of the model", _reduced),
}


def provenance_section(folder: Folder) -> Markup:
    """Versions, seeds and hashes of the inputs of each result."""
    rows: list[tuple[object, ...]] = []
    for command, result in folder.results.items():
        origin = result.table("provenance")
        versions = ", ".join(f"{name} {version}" for name, version in origin.table("versions").items() if version)
        inputs = list(origin.table("inputs").items())
        first = (command, str(origin["seed"]), versions)
        rows += [(*(first if not number_ else ("", "", "")), name, element("code", digest))
                 for number_, (name, digest) in enumerate(inputs)]  # fmt: skip
        rows += [] if inputs else [(*first, "", "")]
    return joined(
        element("h2", "Where this comes from"),
        table(("result", "seed", "versions", "input", "SHA-256"), rows, words=(0, 2, 3, 4)),
    )
