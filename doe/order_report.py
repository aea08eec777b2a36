"""What plan.json says about order, times and budget, and the same in words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from doe.drift import Leftover
from doe.feasible import approach_of
from doe.next_visits import following_names
from doe.plan import Plan
from doe.schedule import STEP, Schedule
from identify.arrays import Floats
from identify.experiment import Experiment, full_experiment
from identify.study import Study
from identify.units import clock

__all__ = [
    "approach_json",
    "budget_json",
    "budget_lines",
    "conditions_of",
    "in_turn",
    "order_json",
    "order_lines",
    "order_notes",
]

_SHOWN = 10  # moves in a note


def conditions_of(ordered: Schedule | None, study: Study, taken: tuple[str, ...] = ()) -> Experiment:
    """The visits of a plan; one without any still has its columns.

    Args:
        ordered: The visits, or None.
        study: The study.
        taken: Names that earlier visits have; new ones follow them.
    """
    count = 0 if ordered is None else len(ordered.q)
    names = following_names("P", taken, count) if taken else None
    if ordered is not None:
        return ordered.conditions(study, names)
    return full_experiment(np.zeros((0, study.robot.n)), np.zeros((0, 1), dtype=np.int64), study.loads, study.markers)


def order_json(ordered: Schedule, names: tuple[str, ...]) -> dict[str, Any]:
    """Order of a plan, for plan.json; ``names`` (V,) of its visits."""
    return {
        "visits": len(ordered.q),
        "lifts": ordered.lifts,
        "lifts_fewest": ordered.fewest.lifts,
        "lifts_proven": ordered.fewest.proven,
        "travel_deg": ordered.travel_deg,
        "travel_s": None if ordered.time is None else ordered.travel_s,
        "detours": ordered.detours,
        "blocked": [list(names[place - 1 : place + 1]) for place in ordered.blocked],
        "reading_times": "stated" if ordered.stated else f"equal steps of {STEP:g} s",
        "drift_leftover": _leftover_json(ordered.left, ordered.unit),
        "as_found": {
            "lifts": ordered.lifts_as_found,
            "drift_leftover": _leftover_json(ordered.as_found, ordered.unit),
        },
    }


def order_notes(ordered: Schedule | None, names: tuple[str, ...]) -> tuple[str, ...]:
    """Moves that must not be driven straight; ``names`` (V,) of the visits."""
    if ordered is None or not len(ordered.blocked):
        return ()
    moves = [" to ".join(names[place - 1 : place + 1]) for place in ordered.blocked]
    more = f" and {len(moves) - _SHOWN} more" if len(moves) > _SHOWN else ""
    return (
        f"the order found has moves that collide: do not drive straight from {', '.join(moves[:_SHOWN])}"
        f"{more}. State a home pose ([constraints] home_deg) to have ways around planned",
    )


def _leftover_json(left: Leftover, unit: str) -> dict[str, Any]:
    """What a drift leaves."""
    return {"unit": unit, "per_mm_h": left.shift, "per_mrad_h": left.turn}


def order_lines(ordered: Schedule | None) -> tuple[str, ...]:
    """The order of a plan for people; nothing without visits."""
    if ordered is None:
        return ()
    lines = [f"crane operations: {ordered.lifts} (as chosen it would take {ordered.lifts_as_found})"]
    if ordered.fewest.proven and ordered.lifts == ordered.fewest.lifts:
        lines[0] += ", proven that fewer are not possible"
    if ordered.time is not None:
        lines.append(f"time to measure it: {clock(ordered.time)}, {ordered.travel_s:.0f} s of it between poses")
    where = "at the test poses" if ordered.unit == "mm" else "of the parameters"
    lines.append(
        f"a drift of 1 mm/h leaves {ordered.left.shift:.2g} {ordered.unit} {where}, one of 1 mrad/h "
        f"{ordered.left.turn:.2g} (unloaded state always first: {ordered.as_found.shift:.2g} and "
        f"{ordered.as_found.turn:.2g})"
    )
    return tuple(lines)


def approach_json(study: Study) -> Floats | None:
    """(n,) how far each joint comes from below, deg, or mm where it slides; None if from anywhere."""
    return None if study.plan.approach == "any" else approach_of(study) / study.joint_units


def budget_json(made: Plan) -> dict[str, Any] | None:
    """What a budget paid for; None without one."""
    if made.bought is None:
        return None
    purse = made.bought.purse
    return {
        "key": purse.key,
        "asked": purse.asked,
        "for_experiments": purse.budget,
        "searched": made.bought.searched,
        "used": None
        if made.schedule is None
        else made.schedule.time
        if purse.key == "time_budget_s"
        else made.bought.spent,
    }


def budget_lines(made: Plan) -> tuple[str, ...]:
    """The same for people."""
    told = budget_json(made)
    if told is None:
        return ()
    return (f"{told['key']} = {told['asked']:g}: the plan uses {told['used']:.6g}",)


def in_turn(times: Iterable[float | None]) -> float | None:
    """Time of several plans one after the other, s; None if one of them is not known."""
    known = list(times)
    return None if None in known else float(sum(time for time in known if time is not None))
