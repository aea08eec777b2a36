"""Sections of the other results of a folder, and where everything comes from."""

from __future__ import annotations

from collections.abc import Callable

from doe.report.folder import Entry, Folder
from doe.report.page import Markup, element, joined, table
from doe.report.pictures import accuracy_curve
from doe.report.words import number

__all__ = ["other_sections", "provenance_section"]


def other_sections(folder: Folder) -> list[Markup]:
    """Plan, evaluation, identification, prediction and reduction, where they stand."""
    return [joined(element("h2", title), show(folder.results[command])) for command, (title, show) in _SHOWN.items()
            if command in folder.results]  # fmt: skip


def _judged(result: Entry) -> Markup:
    """A plan, or poses that were judged."""
    criterion = result.table("criterion")
    rows = [
        ("experiments", str(result["poses"])),
        ("different poses", str(result["different_poses"])),
        ("parameters", str(result["rank"])),
        ("reference", result["reference"]),
        ("expected error at the test poses, rms", _mm(criterion["rms_mm"])),
        ("the same with the robot's repeatability", _mm(criterion["rms_total_mm"])),
        (f"criterion {criterion['name']}", f"{number(criterion['value'], 5)} {criterion.get('unit', '')}"),
        ("proven lower bound", number(result["bound"], 5)),
        ("efficiency, proven", f"{number(100 * result.number('efficiency'), 4)} %"),
        ("not identifiable", ", ".join(result.texts("nonidentifiable")) or "none"),
    ]
    told = table(("", ""), rows, words=(0, 1))
    points = result.tables("curve") if result.get("curve") else []
    shown = sum(point["bound_mm"] is not None for point in points) > 1
    return joined(told, accuracy_curve(points)) if shown else told


def _mm(value: object) -> str:
    return "–" if value is None else f"{number(value)} mm"


def _identified(result: Entry) -> Markup:
    """Parameters with intervals, and the errors."""
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
    errors = f"Error after the fit: {_mm(result.table('residual')['rms_mm'])} rms"
    errors += "" if heldout is None else f"; on {heldout['poses']} held-out poses {_mm(heldout['rms_mm'])}"
    return joined(
        element("p", f"{errors}. Intervals from {result['covariance_kind']}; reference {result['reference']}."),
        table(("parameter", "value", "unit", "95 % interval"), rows, words=(0, 2)),
        element("ul", *(element("li", note) for note in result.texts("notes")), class_="quiet"),
    )


def _predicted(result: Entry) -> Markup:
    """How sure the prediction is."""
    return element(
        "p",
        f"{result['rows']} readings predicted in predicted.csv; standard deviation {_mm(result['std_rms_mm'])} rms, "
        f"{_mm(result['std_max_mm'])} at most.",
    )


def _reduced(result: Entry) -> Markup:
    """The chain of reductions."""
    chain, groups = dict(result.table("chain").items()), dict(result.table("groups").items())
    return joined(
        table(list(chain), [[str(size) for size in chain.values()]], words=()),
        element("p", f"Rank {result['rank']}; groups {', '.join(f'{name}: {size}' for name, size in groups.items())}."),
    )


_SHOWN: dict[str, tuple[str, Callable[[Entry], Markup]]] = {
    "plan": ("The plan", _judged),
    "evaluate": ("Poses that were judged", _judged),
    "identify": ("The identification", _identified),
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
