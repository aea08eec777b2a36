"""The commands of this package, from files to files: simulate, identify, predict.

Each function reads its inputs, refuses what is wrong, computes, and returns the content of its JSON
file and its tables. Writing, printing and exit codes are the command line's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from identify.compare import compare
from identify.comparison_table import comparison_json, comparison_lines
from identify.config import load_study
from identify.equilibrium import linear_misses
from identify.errors import InputError
from identify.fit import absorb_frame
from identify.identification import identify
from identify.model import Model, known_nominal, model_of
from identify.simulate import default_placement, simulate
from identify.study import Noise
from identify.summary import identification_json, load_fitted, predict
from identify.tables import load_measurements, load_plan, measurements_csv, plan_experiment, predicted_csv
from identify.truth import Truth, load_truth
from identify.units import MM

__all__ = ["Outcome", "misses_lines", "run_identify", "run_predict", "run_simulate"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a command leaves behind.

    Attributes:
        command: Its name; the JSON file is ``<command>.json``.
        content: Content of the JSON file.
        inputs: Every file it read.
        tables: Other files, by name.
        lines: A summary for people.
    """

    command: str
    content: dict[str, Any]
    inputs: tuple[Path, ...]
    tables: dict[str, str]
    lines: tuple[str, ...]


def run_identify(study_file: Path, measurements: Path, *, seed: int, compare_models: bool = False) -> Outcome:
    """Identify the parameters of a study; compare models if asked for, or where the study lists some."""
    study = load_study(study_file)
    result = identify(study, load_measurements(measurements, study), seed=seed)
    state = result.fit.state
    misses = linear_misses(result.model, result.data.experiment, state.values)
    content = {**identification_json(result), "equilibrium": study.equilibrium, "linear_misses": misses}
    lines = list(_identify_lines(content))
    if compare_models or study.models:
        content["comparison"] = comparison_json(compare(study, result.data, result.reference, seed=seed))
        lines += ["", *comparison_lines(content["comparison"])]
    return Outcome("identify", content, (*study.inputs, measurements), {}, tuple(lines))


def _identify_lines(content: dict[str, Any]) -> tuple[str, ...]:
    lines = [f"{'parameter':<28}{'value':>12}{'std':>11}  unit"]
    lines += [
        f"{p['name']:<28}{p['value']:>12.5g}{p['std']:>11.2g}  {p['unit']}"
        for p in content["parameters"]
        if not p["nuisance"]
    ]
    lines += [f"{item['name']:<28}{'-':>12}{'':>11}  {item['why']}" for item in content["nonidentifiable"]]
    misfit, heldout = content["residual"], content["heldout"]
    lines.append(
        f"reference {content['reference']}, intervals from {content['covariance_kind']}, rank {content['rank']}"
    )
    lines.append(f"error after the fit: rms {misfit['rms_mm']:.4f} mm, max {misfit['max_mm']:.4f} mm")
    if heldout:
        lines.append(
            f"error on {heldout['poses']} held-out poses: "
            f"rms {heldout['rms_mm']:.4f} mm, max {heldout['max_mm']:.4f} mm"
        )
    if content["compensated_percent"] is not None:
        lines.append(
            f"measured deflection: rms {content['deflection']['rms_mm']:.4f} mm, "
            f"compensated {content['compensated_percent']:.1f} %"
        )
    lines += misses_lines(content)
    return (*lines, *(f"note: {note}" for note in content["notes"]))


def misses_lines(content: dict[str, Any]) -> list[str]:
    """What the linear model misses, and whether that is counted."""
    misses = content["linear_misses"]
    if misses is None:
        return []
    loaded = content["equilibrium"] == "loaded"
    counted = "counted here" if loaded else 'not counted, see [model] equilibrium = "loaded"'
    return [
        f"the linear model misses rms {misses['rms_mm']:.4f} mm, max {misses['max_mm']:.4f} mm "
        f"({misses['percent']:.2g} % of the deflection; {counted})"
    ]


def run_simulate(study_file: Path, plan_file: Path, truth_file: Path | None, *, seed: int) -> Outcome:
    """Simulate the measurements of a plan from a stated truth."""
    study = load_study(study_file)
    plan = load_plan(plan_file, study)
    truth = Truth() if truth_file is None else load_truth(truth_file, study)
    study = replace(study, options=truth.options if truth_file else study.options)
    model = model_of(study, truth.effects, known_nominal(study, truth.effects))
    values = _true_values(model, truth)
    noise = _solid(truth.noise or study.noise)
    start = default_placement(noise, frame_free=study.frame_free)
    values, placement = absorb_frame(model, values, start)
    experiment = plan_experiment(plan, study)
    data = simulate(model, values, experiment, noise, placement, np.random.default_rng(seed))
    stated = {name: value for name, value in zip(model.names, values.tolist(), strict=True) if value}
    placement[:3, 3] /= MM
    content = {
        "effects": list(truth.effects or study.effects),
        "values": stated,
        "frames": {"base_T_measurement": placement},
        "readings": len(data.positions),
        "poses": len(data.experiment.visits),
        "equilibrium": study.equilibrium,
        "linear_misses": linear_misses(model, experiment, values),
    }
    inputs = (*study.inputs, plan_file, *(() if truth_file is None else (truth_file,)))
    lines = (f"{len(data.positions)} readings of {len(data.experiment.visits)} poses", *misses_lines(content))
    return Outcome("simulate", content, inputs, {"measurements.csv": measurements_csv(data, study)}, lines)


def _true_values(model: Model, truth: Truth) -> np.ndarray:
    """Nominal values overlaid with the stated ones.

    Raises:
        InputError: A name that the true model does not have.
    """
    values = model.nominal.copy()
    for name, value in truth.values.items():
        if name not in model.names:
            raise InputError(
                f"{truth.path}: [truth.values] {name!r} = {value:g}: the truth has no such parameter; it has "
                + ", ".join(model.names)
            )
        values[model.names.index(name)] = value
    return values


def _solid(noise: Noise) -> Noise:
    """The same noise, with an instrument that is at least picometres wrong (its covariance must have a root)."""
    return replace(noise, reading=max(noise.reading, 1e-12)) if noise.tracker is None else noise


def run_predict(study_file: Path, result_file: Path, plan_file: Path, *, seed: int) -> Outcome:
    """Predict readings with a fitted model."""
    study = load_study(study_file)
    fitted = load_fitted(result_file, study)
    experiment = plan_experiment(load_plan(plan_file, study), study)
    position, std = predict(fitted, experiment)
    content = {
        "rows": len(position),
        "std_rms_mm": float(np.sqrt((std**2).sum(axis=1).mean()) / MM),
        "std_max_mm": float(np.linalg.norm(std, axis=1).max() / MM),
        "equilibrium": study.equilibrium,
        "linear_misses": linear_misses(fitted.model, experiment, fitted.values),
    }
    lines = (
        f"{len(position)} readings predicted; std of the position rms {content['std_rms_mm']:.4f} mm, "
        f"max {content['std_max_mm']:.4f} mm",
        *misses_lines(content),
    )
    tables = {"predicted.csv": predicted_csv(experiment, position, std)}
    return Outcome("predict", content, (*study.inputs, result_file, plan_file), tables, lines)
