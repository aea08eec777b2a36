"""Results as plain data: the content of ``identify.json``, and what `predict` reads back from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from identify.alignment import inverse
from identify.arrays import Floats
from identify.calibrated import CalibratedRegion, calibrated_region, region_json, region_of
from identify.effects.thermal import REFERENCE
from identify.errors import InputError
from identify.experiment import Experiment
from identify.identifiability import why_not
from identify.identification import Identification, Misfit
from identify.model import Model, known_nominal, model_of
from identify.response import marker_positions, respond
from identify.study import Study
from identify.units import MM, MRAD

__all__ = ["Fitted", "identification_json", "load_fitted", "predict"]


def identification_json(result: Identification) -> dict[str, Any]:
    """The content of ``identify.json`` (without schema and provenance); lengths in mm."""
    found, data = result.fit, result.data
    kept = result.kept
    heldout = result.heldout
    return {
        "parameters": [_parameter(result, int(index)) for index in kept],
        "covariance": result.covariance[np.ix_(kept, kept)],
        "covariance_kind": result.covariance_kind,
        "effects": list(result.study.effects),
        "options": {effect.name: _options(result, effect.name) for effect in result.model.effects},
        "reference": result.reference,
        "frames": {"base_T_measurement": _in_mm(found.state.base_T_measurement)},
        "time_start_s": data.experiment.start,
        "by_temperature": data.experiment.temperature is not None,
        "markers": dict(
            zip(
                result.study.markers.names,
                marker_positions(found.model, data.experiment, result.values) / MM,
                strict=True,
            )
        ),
        "rank": found.identifiability.rank,
        "nonidentifiable": [
            {"name": found.model.names[dropped.column], "why": why_not(found.model, dropped)}
            for dropped in _dropped(result)
        ],
        "chi2": result.lack_of_fit.chi2,
        "dof": result.lack_of_fit.dof,
        "p_value": result.lack_of_fit.p_value,
        "robust_scale": found.scale,
        "residual": {"rms_mm": result.misfit.rms / MM, "max_mm": result.misfit.maximum / MM, **_by(result)},
        "orientation": _orientation(result),
        "heldout": None
        if heldout is None
        else {
            "rms_mm": heldout.misfit.rms / MM,
            "max_mm": heldout.misfit.maximum / MM,
            "poses": heldout.visits,
        },
        "deflection": {"rms_mm": result.deflection[0].rms / MM, "max_mm": result.deflection[0].maximum / MM},
        "compensated_percent": result.compensated_percent,
        "calibrated": region_json(calibrated_region(result.study.robot, data.experiment), result.study.robot),
        "worst": [_bad_row(result, int(row)) for row in result.worst],
        "ignored_columns": list(data.ignored_columns),
        "notes": list(result.notes),
    }


def _orientation(result: Identification) -> dict[str, Any] | None:
    """Errors of the orientations of 6-D targets, and how these sit on the flange; None where they do not count."""
    if result.mounts is None:
        return None
    errors = np.linalg.norm(result.turn_residuals, axis=1) / MRAD
    return {
        "rms_mrad": float(np.sqrt((errors**2).mean())),
        "max_mrad": float(errors.max()),
        "flange_R_target": dict(zip(result.study.markers.names, result.mounts, strict=True)),
    }


def _options(result: Identification, name: str) -> dict[str, Any]:
    """The options of an effect as plain data."""
    given = result.study.options.get(name, {})
    return {key: dict(value) if isinstance(value, Mapping) else value for key, value in given.items()}


def _dropped(result: Identification) -> list[Any]:
    """What could not be identified, frame and markers left out where others are asked for."""
    model = result.model
    return [
        d for d in result.fit.identifiability.dropped if result.fit.fitted[d.column] or not model.nuisance[d.column]
    ]


def _parameter(result: Identification, index: int) -> dict[str, Any]:
    parameter = result.model.parameters[index]
    value, std = float(result.values[index]), float(np.sqrt(result.covariance[index, index]))
    half = result.quantile * std
    return {
        "name": parameter.name,
        "value": value,
        "unit": parameter.unit,
        "std": std,
        "ci95": [value - half, value + half],
        "nuisance": parameter.nuisance,
    }


def _in_mm(placement: Floats) -> Floats:
    """A placement with its translation in mm."""
    scaled = placement.copy()
    scaled[:3, 3] /= MM
    return scaled


def _by(result: Identification) -> dict[str, Any]:
    """Rms of the misfit per axis (base frame), marker and load, mm."""
    misfit, experiment = result.misfit, result.data.experiment
    marker = experiment.row_marker[misfit.rows]
    load = experiment.shot_load[experiment.row_shot][misfit.rows]
    axes = np.sqrt((misfit.error**2).mean(axis=0)) / MM if len(misfit.error) else np.full(3, np.nan)
    return {
        "axis_rms_mm": dict(zip("xyz", axes, strict=True)),
        "marker_rms_mm": {
            name: Misfit(misfit.error[marker == index], misfit.rows).rms / MM
            for index, name in enumerate(experiment.markers.names)
        },
        "load_rms_mm": {
            case.name: Misfit(misfit.error[load == index], misfit.rows).rms / MM
            for index, case in enumerate(experiment.loads)
            if (load == index).any()
        },
    }


def _bad_row(result: Identification, row: int) -> dict[str, Any]:
    experiment = result.data.experiment
    shot = experiment.row_shot[row]
    size, turns = float(np.linalg.norm(result.fit.residual[row])), bool(experiment.turning[row])
    return {
        "line": int(result.data.lines[row]),
        "pose": experiment.visits[experiment.shot_visit[shot]],
        "load": experiment.loads[experiment.shot_load[shot]].name,
        "marker": experiment.markers.names[experiment.row_marker[row]],
        "repeat": int(experiment.shot_repeat[shot]),
        "z": float(result.fit.z[row] / result.fit.scale),
        "error_mm": None if turns else size / MM,
        **({"orientation_error_mrad": size / MRAD} if turns else {}),
    }


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted model read back from a result file.

    Attributes:
        model: The model of the result's effects.
        values: (p,) its parameters; frame values are zero, they are in the placement.
        covariance: (p, p).
        base_T_measurement: (4, 4) m.
        start: The time from which the fit counted drift and warm-up, s; None if its readings had no times.
        by_temperature: The fit knew temperatures, so that growth is per kelvin; None if the result does not say.
        calibrated: What was measured; None if the result does not say.
        reference: absolute or differences; None if the result does not say.
    """

    model: Model
    values: Floats
    covariance: Floats
    base_T_measurement: Floats
    start: float | None = None
    by_temperature: bool | None = None
    calibrated: CalibratedRegion | None = None
    reference: Literal["absolute", "differences"] | None = None


def load_fitted(path: str | Path, study: Study) -> Fitted:
    """Read an ``identify.json`` (or the ``identification`` of a ``diagnose.json``).

    Raises:
        InputError: The file cannot be read, or does not belong to this study.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content = content.get("identification", content)
        study = replace(study, options={**study.options, **content.get("options", {})})
        effects = tuple(content["effects"])
        model = model_of(study, effects, known_nominal(study, effects))
        listed = [str(parameter["name"]) for parameter in content["parameters"]]
        given = np.array([float(parameter["value"]) for parameter in content["parameters"]])
        spread = np.array(content["covariance"], dtype=np.float64).reshape(len(given), len(given))
        placement = np.array(content["frames"]["base_T_measurement"], dtype=np.float64).reshape(4, 4)
        start = None if content.get("time_start_s") is None else float(content["time_start_s"])
        by_temperature = content.get("by_temperature")
        reference = content.get("reference")
        calibrated = region_of(content["calibrated"], study.robot) if "calibrated" in content else None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: no result of identify or diagnose ({type(error).__name__}: {error})") from None
    unknown = sorted(set(listed) - set(model.names))
    if unknown or not np.isfinite(given).all() or not np.isfinite(spread).all() or not np.isfinite(placement).all():
        raise InputError(
            f"{path}: does not belong to {study.path}: "
            + (f"the study has no parameter {', '.join(unknown)}" if unknown else "a number is not finite")
        )
    index = [model.names.index(name) for name in listed]
    values = model.nominal.copy()
    values[index] = given
    values[: model.frame_size] = 0.0
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(index, index)] = spread
    placement[:3, 3] *= MM
    known = reference if reference in {"absolute", "differences"} else None
    return Fitted(model, values, covariance, placement, start, by_temperature, calibrated, known)


def predict(fitted: Fitted, experiment: Experiment) -> tuple[Floats, Floats]:
    """Where the markers will be read and how sure that is (parameters only).

    Times count from the first reading of the fit, on the same clock. Temperatures count if the fit had some; where
    the experiment has none, the arm is then at the reference temperature.

    Returns:
        (R, 3) positions and (R, 3) standard deviations in the frame of the measurements, m.
    """
    experiment = _as_in_the_fit(fitted, experiment)
    response = respond(fitted.model, experiment, fitted.values)
    back = inverse(fitted.base_T_measurement)
    position = response.position @ back[:3, :3].T + back[:3, 3]
    columns = back[:3, :3] @ response.derivative
    variance = np.einsum("rip,pq,riq->ri", columns, fitted.covariance, columns, optimize=True)
    return position, np.sqrt(np.maximum(variance, 0.0))


def _as_in_the_fit(fitted: Fitted, experiment: Experiment) -> Experiment:
    """The experiment with time and temperature meaning what they meant in the fit."""
    temperature = experiment.temperature
    if fitted.by_temperature is False:
        temperature = None
    elif fitted.by_temperature and temperature is None:
        temperature = np.full(len(experiment.row_shot), REFERENCE)
    start = experiment.start if fitted.start is None else fitted.start
    return replace(experiment, start=start, temperature=temperature)
