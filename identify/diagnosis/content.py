"""A diagnosis as plain data: the content of ``diagnose.json`` and its summary for people."""

from __future__ import annotations

from typing import Any

import numpy as np

from identify.diagnosis.curves import Curve, curves
from identify.diagnosis.faults import Fault
from identify.diagnosis.library import Hypothesis
from identify.diagnosis.replicates import replicates
from identify.diagnosis.screen import Screen, screen
from identify.diagnosis.search import Cause
from identify.diagnosis.verdict import Diagnosis
from identify.summary import identification_json
from identify.units import MM, MRAD

__all__ = ["diagnosis_json", "diagnosis_lines"]

_SHOWN = 12  # dependences
_DIGITS = 6
_AXES = ("x", "y", "z", "norm")


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnose.json`` (without schema, provenance and plans); lengths in mm."""
    wrong = screen(found.search.first, found.identification.reference)
    return {
        "measured": _measured(found),
        "verdict": found.verdict,
        "causes": _causes(found),
        "remainder": found.remainder.present,
        "remainder_depends_on": found.remainder.depends_on,
        "gain": _gain(found),
        "noise": _noise(found),
        "curves": [_curve(found, curve) for curve in curves(found.identification, found.causes)],
        "extended_model": list(found.extended_study.effects),
        "wrong": _wrong(wrong, found),
        "lack_of_fit": {"before": vars(found.first_lack), "after": vars(found.remainder.lack_of_fit)},
        "significance": found.search.gate,
        "reference": found.identification.reference,
        "identification": identification_json(found.identification),
        "notes": list(found.notes),
    }


def _measured(found: Diagnosis) -> dict[str, Any]:
    """What was measured."""
    experiment = found.data.experiment
    return {
        "robot": found.study.robot.name,
        "poses": len(np.unique(experiment.row_visit)),
        "readings": len(found.data.positions),
        "loads": [experiment.loads[index].name for index in np.unique(experiment.shot_load)],
        "markers": [experiment.markers.names[index] for index in np.unique(experiment.row_marker)],
    }


def _causes(found: Diagnosis) -> list[dict[str, Any]]:
    """Causes, strongest first: effects in the order of the search, then noise, then rows."""
    listed = [_cause(found, cause) for cause in found.causes]
    if found.range_noise is not None:
        listed.append(_plain("range_noise", None, found.range_noise.p_value))
    return listed + [_fault(found, fault) for fault in found.faults]


def _plain(name: str, where: str | None, p_value: float) -> dict[str, Any]:
    return {"name": name, "where": where, "p_value": p_value, "ambiguous_with": [], "parameters": []}


def _cause(found: Diagnosis, cause: Cause) -> dict[str, Any]:
    own = cause.hypothesis
    names = [_named(own, rival) for rival in cause.rivals]
    return {
        **_plain(own.name, own.where, cause.p_value),
        "ambiguous_with": list(dict.fromkeys(names)),
        "parameters": _parameters(found, own),
        "options": dict(own.options),
    }


def _curve(found: Diagnosis, curve: Curve) -> dict[str, Any]:
    """Turn of a joint over its value, with the half width of its 95 % band."""
    slides = bool(found.study.robot.prismatic[curve.joint])
    unit, word = (MM, "mm") if slides else (MRAD, "mrad")
    return {
        "cause": curve.cause,
        "joint": f"j{curve.joint + 1}",
        "q_mm" if slides else "q_deg": np.round(curve.value / found.study.joint_units[curve.joint], _DIGITS),
        f"turn_{word}": np.round(curve.turn / unit, _DIGITS),
        f"half_{word}": np.round(curve.half / unit, _DIGITS),
    }


def _named(own: Hypothesis, rival: Hypothesis) -> str:
    """A rival: its name, with the place where that is all that differs."""
    return rival.entry if rival.name == own.name or rival.where is not None else rival.name


def _parameters(found: Diagnosis, own: Hypothesis) -> list[dict[str, Any]]:
    """Fitted sizes of a cause with intervals and what is plausible."""
    result = found.identification
    listed = []
    for index in own.own:
        parameter = own.effect.parameters[index]
        position = result.model.names.index(parameter.name)
        value, std = float(result.values[position]), float(np.sqrt(result.covariance[position, position]))
        half = result.quantile * std
        listed.append({
            "name": parameter.name,
            "value": value,
            "unit": parameter.unit,
            "std": std,
            "ci95": [value - half, value + half],
            "typical": parameter.typical,
            "plausible_up_to": parameter.plausible,
            "plausible": bool(abs(value) <= parameter.plausible),
        })
    return listed


def _fault(found: Diagnosis, fault: Fault) -> dict[str, Any]:
    experiment, rows = found.data.experiment, fault.rows
    return {
        **_plain("data_fault", fault.where(experiment), 0.0),
        "what": fault.what,
        "error_mm": fault.size / MM,
        "lines": found.data.lines[rows],
    }


def _gain(found: Diagnosis) -> dict[str, Any] | None:
    gain = found.gain
    if gain is None:
        return None
    return {
        "heldout_rms_before_mm": gain.before / MM,
        "heldout_rms_after_mm": gain.after / MM,
        "noise_rms_mm": gain.noise / MM,
        "poses_heldout": gain.visits,
        "ci95": list(gain.interval),
        "significant": gain.significant,
    }


def _noise(found: Diagnosis) -> dict[str, Any]:
    stated = found.study.noise.reading / MM if found.study.noise.tracker is None else None
    return {
        "stated_mm": stated,
        "found_mm": None if stated is None or found.range_noise else stated * found.noise.reading,
        "reading_times_stated": found.noise.reading,
        "reading_jitter_times_stated": found.noise.reading_jitter,
        "pose_jitter_times_stated": found.noise.pose_jitter,
    }


def _wrong(wrong: Screen, found: Diagnosis) -> dict[str, Any]:
    """Where the simulation fails before the extension, mm."""
    return {
        "rms_mm": wrong.misfit.rms / MM,
        "max_mm": wrong.misfit.maximum / MM,
        "axis_rms_mm": dict(zip("xyz", wrong.axis / MM, strict=True)),
        "marker_rms_mm": {name: value / MM for name, value in wrong.marker.items()},
        "load_rms_mm": {name: value / MM for name, value in wrong.load.items()},
        "worst_poses": [{"pose": name, "rms_mm": value / MM} for name, value in wrong.worst.items()],
        "depends_on": [vars(dependence) for dependence in wrong.dependences[:_SHOWN]],
        "rank_correlation": _correlations(wrong),
        "p_value": found.first_lack.p_value,
        "replicates": _replicates(found),
    }


def _correlations(wrong: Screen) -> dict[str, list[float]]:
    """Rank correlation of x, y, z and norm of the residual with every quantity, in the order of the table."""
    listed: dict[str, dict[str, float]] = {}
    for dependence in wrong.dependences:
        listed.setdefault(dependence.column, {})[dependence.axis] = round(dependence.correlation, 4)
    return {column: [by_axis[axis] for axis in _AXES] for column, by_axis in sorted(listed.items())}


def _replicates(found: Diagnosis) -> dict[str, Any] | None:
    """Lack of fit against the scatter of replicates, before and after; None without replicates."""
    before, after = replicates(found.search.first), replicates(found.search.last)
    if before is None or after is None:
        return None
    return {
        "readings": before.readings,
        "std_mm": before.std / MM,
        "chi2": before.chi2,
        "dof": before.dof,
        "before": {"ratio": before.ratio, "p_value": before.p_value},
        "after": {"ratio": after.ratio, "p_value": after.p_value},
    }


def diagnosis_lines(content: dict[str, Any]) -> tuple[str, ...]:
    """A summary for people."""
    lines = [f"verdict: {content['verdict']}{_and_remainder(content)}"]
    for cause in content["causes"]:
        lines.append(f"cause: {cause['name']}{_at(cause['where'])}{_evidence(cause)}")
        lines += [
            f"    {p['name']} = {p['value']:.4g} +- {p['std']:.2g} {p['unit']}"
            + ("" if p["plausible"] else f" (not plausible: at most {p['plausible_up_to']:g})")
            for p in cause["parameters"]
            if np.isfinite(p["std"]) and p["std"] > 0
        ]
        if cause["ambiguous_with"]:
            lines.append(f"    explains as well: {', '.join(cause['ambiguous_with'])}")
    gain = content["gain"]
    if gain is not None:
        claim = f"ratio {gain['ci95'][0]:.2f} to {gain['ci95'][1]:.2f}" if gain["significant"] else "no gain is claimed"
        lines.append(
            f"error on {gain['poses_heldout']} held-out poses: {gain['heldout_rms_before_mm']:.4f} mm before, "
            f"{gain['heldout_rms_after_mm']:.4f} mm after ({claim}); noise alone {gain['noise_rms_mm']:.4f} mm"
        )
    noise = content["noise"]
    if noise["found_mm"] is not None:
        lines.append(f"noise of a reading: {noise['found_mm']:.4f} mm found, {noise['stated_mm']:.4f} mm stated")
    return (*lines, *(f"note: {note}" for note in content["notes"]))


def _and_remainder(content: dict[str, Any]) -> str:
    if not content["remainder"]:
        return ""
    on = content["remainder_depends_on"]
    return ", and something remains that " + ("has no name here" if on is None else f"depends on {on}")


def _at(where: str | None) -> str:
    return "" if where is None else f" at {where}"


def _evidence(cause: dict[str, Any]) -> str:
    if "what" in cause:
        return f" ({cause['what']}, {cause['error_mm']:.3g} mm off)"
    p_value = cause["p_value"]
    return " (p < 1e-300)" if p_value < 1e-300 else f" (p = {p_value:.2g})"
