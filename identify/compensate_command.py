"""The command ``compensate``: study, fitted model and targets in, compensated commands out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.calibrated import CalibratedRegion, check_region
from identify.commands import Outcome, misses_lines
from identify.compensation import Compensation, Form, compensate
from identify.config import load_study
from identify.equilibrium import linear_misses
from identify.errors import Infeasible
from identify.robot import Robot
from identify.summary import load_fitted
from identify.targets import compensated_csv, load_targets
from identify.tool_response import Arm, Targets, arm_of, target_experiment
from identify.units import MM

__all__ = ["run_compensate"]

_ANSWERS = 1e-8  # m per unit: a parameter that moves no target by more is not loaded
_LEFT, _SEEN = 0.05, 1e-6  # of the deflection, and m: a target with more left is named
_SHOWN = 10  # names in a message
#: Effects whose conditions targets do not state.
_UNSTATED = {
    "thermal_growth": "targets are taken at 20 degC (or with a cold arm)",
    "approach_hysteresis": "targets do not say from where they are approached, so nothing is taken back",
}


def run_compensate(
    study_file: Path,
    result_file: Path,
    targets_file: Path,
    *,
    seed: int,
    form: Form = "joint",
    passes: int = 10,
    extrapolate: bool = False,
) -> Outcome:
    """Compensate the targets of a program with a fitted model.

    Raises:
        InputError: A file is wrong.
        Infeasible: A target is outside the calibrated region (unless ``extrapolate``), or cannot be reached.
        NoConvergence: The loaded arm finds no equilibrium.
    """
    study = load_study(study_file)
    fitted = load_fitted(result_file, study)
    targets = load_targets(targets_file, study)
    outside = _outside(fitted.calibrated, study.robot, targets, targets_file, extrapolate=extrapolate)
    arm = arm_of(fitted.model, fitted.values, fitted.covariance)
    found = compensate(arm, targets, form, passes)
    unknown = () if fitted.calibrated is not None else (_unknown_region(result_file),)
    content = {
        **_summary(found),
        "extrapolated": [targets.names[row] for row in np.flatnonzero(outside)],
        "equilibrium": study.equilibrium,
        "linear_misses": linear_misses(arm.model, target_experiment(targets), arm.values),
        "notes": [*unknown, *_notes(found)],
    }
    tables = {"compensated.csv": compensated_csv(found, outside, study)}
    return Outcome("compensate", content, (*study.inputs, result_file, targets_file), tables, _lines(content))


def _outside(
    region: CalibratedRegion | None, robot: Robot, targets: Targets, path: Path, *, extrapolate: bool
) -> np.ndarray:
    """(T,) True for targets outside the calibrated region; none where the result does not know it.

    Raises:
        Infeasible: There are some, and they are not to be extrapolated.
    """
    if region is None:
        return np.zeros(len(targets.names), dtype=bool)
    check = check_region(region, robot, targets)
    rows = np.flatnonzero(check.outside)
    if len(rows) and not extrapolate:
        more = f" (and {len(rows) - 1} more targets outside the calibrated region)" if len(rows) > 1 else ""
        raise Infeasible(
            f"{path}: target {targets.names[rows[0]]}: {check.words(int(rows[0]))}{more}; measure poses and loads that "
            "reach it and identify again, or give --extrapolate"
        )
    return check.outside


def _unknown_region(path: Path) -> str:
    return (
        f"{path.name} does not say which poses and loads were measured (key calibrated), so no target was checked "
        "against them; identify again with this version to have it checked"
    )


def _summary(found: Compensation) -> dict[str, Any]:
    """What was done and what remains, lengths in mm."""
    before, after = (np.linalg.norm(error, axis=1) for error in (found.before, found.residual))
    share = float(1.0 - np.linalg.norm(after) / np.linalg.norm(before)) if before.any() else float("nan")
    return {
        "targets": len(found.targets.names),
        "form": found.form,
        "passes": found.passes,
        "deflection": _sizes(before),
        "residual": _sizes(after),
        "residual_ci95": _sizes(found.radius95),
        "residual_turn_max_mrad": float(1e3 * found.residual_turn.max()),
        "removed_percent": 100.0 * share,
    }


def _sizes(lengths: Floats) -> dict[str, float]:
    """Rms and maximum of lengths in m, as mm."""
    return {"rms_mm": float(np.sqrt((lengths**2).mean()) / MM), "max_mm": float(lengths.max() / MM)}


def _notes(found: Compensation) -> Iterator[str]:
    """What the user should know."""
    arm = found.arm
    after, before = (np.linalg.norm(error, axis=1) for error in (found.residual, found.before))
    left = [found.targets.names[row] for row in np.flatnonzero(after > np.maximum(_LEFT * before, _SEEN))]
    if left:
        yield (
            f"a part of the deflection is not taken back at {_listed(left)} (see residual_mm): more passes may help, "
            "or the pose is singular, or the arm has fewer joints than a pose needs"
        )
    held = _held(arm, found.answer)
    if held:
        yield (
            f"not identified, held at nominal: {_listed(held)}; the targets load what it describes, and "
            "residual_ci95_mm does not count what that may cost"
        )
    yield from (f"{effect.name}: {_UNSTATED[effect.name]}" for effect in arm.model.effects if effect.name in _UNSTATED)
    if not arm.model.self_weight:
        yield (
            "the mass of a moved link is unknown: the sag under self-weight is not taken back, only that under the "
            "wrench"
        )


def _listed(names: list[str]) -> str:
    """Names as text, not too many."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _held(arm: Arm, answer: Floats) -> list[str]:
    """Parameters of elasticity that were not identified and that targets load, with the values they stay at."""
    held = arm.held & (answer > _ANSWERS)
    yields = np.zeros(len(held), dtype=bool)
    for effect, where in zip(arm.model.effects, arm.model.effect_slices, strict=True):
        yields[where] = effect.yields
    return [
        f"{parameter.name} ({value:g} {parameter.unit})"
        for parameter, value, wanted in zip(arm.model.parameters, arm.values.tolist(), held & yields, strict=True)
        if wanted
    ]


def _lines(content: dict[str, Any]) -> tuple[str, ...]:
    """The summary for people."""
    before, after, radius = (content[key] for key in ("deflection", "residual", "residual_ci95"))
    lines = [
        f"{content['targets']} targets, {content['form']} form, {content['passes']} "
        f"{'pass' if content['passes'] == 1 else 'passes'}",
        f"deflection: rms {before['rms_mm']:.4f} mm, max {before['max_mm']:.4f} mm",
        f"remaining by the model: rms {after['rms_mm']:.6f} mm, max {after['max_mm']:.6f} mm",
        f"95 % radius from the parameters: rms {radius['rms_mm']:.4f} mm, max {radius['max_mm']:.4f} mm",
    ]
    if content["extrapolated"]:
        lines.append(f"outside the calibrated region: {_listed(content['extrapolated'])}")
    return (*lines, *misses_lines(content), *(f"note: {note}" for note in content["notes"]))
