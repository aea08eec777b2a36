"""A plan, or poses that were judged: what they are worth, in which order they are measured, and what was refused."""

from __future__ import annotations

import re
from collections.abc import Iterator

from doe.report.folder import Entry, Folder
from doe.report.page import Markup, element, joined, table
from doe.report.pictures import accuracy_curve
from doe.report.words import millimetres, number
from identify.csv_file import CsvTable
from identify.units import clock

__all__ = ["evaluate_section", "plan_section"]

_VISITS = 60  # of a plan file
_DECIMAL = re.compile(r"-?\d+\.\d+", re.ASCII)


def plan_section(folder: Folder) -> Markup:
    """What a plan is worth, its order, and its file."""
    result = folder.results["plan"]
    files = [
        joined(element("h3", f"{name}, in the order of measuring"), _visits(plan))
        for name, plan in folder.plans.items()
    ]
    return joined(_judged(result), *(_order(order, arm) for arm, order in _orders(result)), *files)


def evaluate_section(folder: Folder) -> Markup:
    """What a set of poses is worth."""
    return _judged(folder.results["evaluate"])


def _judged(result: Entry) -> Markup:
    """Errors, efficiencies, the curve, refused candidates and notes."""
    points = result.tables("curve") if result.get("curve") else []
    shown = sum(point["bound_mm"] is not None for point in points) > 1
    return joined(
        table(("", ""), [*_worth(result)], words=(0, 1)),
        accuracy_curve(points) if shown else None,
        _rejections(result),
        element("ul", *(element("li", note) for note in result.texts("notes")), class_="quiet")
        if result.get("notes")
        else None,
    )


def _worth(result: Entry) -> Iterator[tuple[str, str]]:
    """What is asked of a plan, and how good it is."""
    criterion, measured = result.table("criterion"), result.get("measured")
    yield "experiments", str(result["poses"])
    yield "different poses", str(result["different_poses"])
    if measured is not None:
        yield "beside what was measured", f"{measured['visits']} visits, {millimetres(measured['rms_mm'])} rms alone"
    yield "parameters", str(result["rank"])
    yield "reference", result["reference"]
    yield "expected error at the test poses, rms", millimetres(criterion["rms_mm"])
    yield "the same with the robot's repeatability", millimetres(criterion["rms_total_mm"])
    yield f"criterion {criterion['name']}", f"{number(criterion['value'], 5)} {criterion.get('unit', '')}"
    yield "proven lower bound", number(result["bound"], 5)
    yield "efficiency on the candidates and these poses, proven", _percent(result.number("efficiency"))
    if result.get("efficiency_continuous") is not None:
        yield "efficiency over all joint angles, estimated", _percent(result.number("efficiency_continuous"))
    if result.get("efficiencies") is not None:
        known = [(name, share) for name, share in result.table("efficiencies").items() if share is not None]
        yield "efficiency by each criterion", ", ".join(f"{name} {_percent(share)}" for name, share in known)
    yield "not identifiable", ", ".join(result.texts("nonidentifiable")) or "none"
    if result.get("time_s") is not None:
        yield "time to measure it", clock(result.number("time_s"))


def _percent(share: object) -> str:
    return f"{number(100 * share, 4)} %" if isinstance(share, int | float) else str(share)


def _rejections(result: Entry) -> Markup | None:
    """Refused candidates by reason, most frequent first."""
    counted = result.table("rejected") if result.get("rejected") is not None else None
    listed = [] if counted is None else [(reason, counted.number(reason)) for reason, _ in counted.items()]
    refused = sorted(((reason, count) for reason, count in listed if count > 0), key=lambda item: -item[1])
    if not refused:
        return None
    rows = [(reason, f"{count:.0f}") for reason, count in refused]
    return joined(
        element("h3", "Candidates that were refused"),
        element("p", f"{result['candidates']} were kept. Each refused one counts under the first reason against it."),
        table(("reason", "candidates"), rows),
    )


def _orders(result: Entry) -> list[tuple[str | None, Entry]]:
    """The order of a plan, or that of each arm by its name."""
    order = result.get("order")
    if order is None:
        return []
    if result.get("arms") is None:
        return [(None, result.table("order"))]
    return [(arm, result.table("order").table(arm)) for arm, own in order.items() if own is not None]


def _order(order: Entry, arm: str | None) -> Markup:
    """Crane operations, travel and drift."""
    return joined(
        element("h3", "Order of measuring" if arm is None else f"Order of measuring, {arm}"),
        table(("", "as planned", "as chosen"), [*_steps(order)], words=(0,)),
    )


def _steps(order: Entry) -> Iterator[tuple[str, str, str]]:
    """What the order costs and leaves, beside the order in which the visits were chosen."""
    found = order.table("as_found")
    yield "visits", str(order["visits"]), ""
    proven = "proven fewest" if order["lifts_proven"] else "fewest found"
    yield f"crane operations ({proven}: {order['lifts_fewest']})", str(order["lifts"]), str(found["lifts"])
    yield "travel, sum of the largest turns, deg", number(order["travel_deg"], 4), ""
    if order["travel_s"] is not None:
        yield "travel, s", number(order["travel_s"], 4), ""
    yield "moves over the home pose", str(order["detours"]), ""
    left, before = order.table("drift_leftover"), found.table("drift_leftover")
    for key, words in (("per_mm_h", "a drift of 1 mm/h"), ("per_mrad_h", "a drift of 1 mrad/h")):
        yield f"error that {words} leaves, {left['unit']}", number(left[key], 2), number(before[key], 2)


def _visits(plan: CsvTable) -> Markup:
    """The first visits of a plan file, with their loads in the order of reading."""
    columns = [name for name in plan.cells if name not in {"pose", "load", "repeat"}]
    visits: dict[str, list[str]] = {}
    first: dict[str, int] = {}
    for row, (pose, load) in enumerate(zip(plan.cells["pose"], plan.cells["load"], strict=True)):
        visits.setdefault(pose, []).append(load)
        first.setdefault(pose, row)
    rows = [
        (pose, ", ".join(loads), *(_short(plan.cells[name][first[pose]]) for name in columns))
        for pose, loads in visits.items()
    ]
    more = element("p", f"The first {_VISITS} of {len(rows)} visits:", class_="quiet") if len(rows) > _VISITS else None
    return joined(more, table(("pose", "loads", *columns), rows[:_VISITS], words=(0, 1)))


def _short(cell: str) -> str:
    """A number with two decimals; any other text as it is."""
    return f"{float(cell):.2f}" if _DECIMAL.fullmatch(cell) else cell
