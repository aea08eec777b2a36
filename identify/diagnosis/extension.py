"""The extended model as a study file that runs as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from identify.diagnosis.library import Hypothesis, placed_options
from identify.diagnosis.verdict import Diagnosis
from identify.problems import name_robot_from, read_toml
from identify.study import Tracker
from identify.units import UM

__all__ = ["extended_toml"]


def extended_toml(found: Diagnosis, out: Path) -> str:
    """Text of the study with the causes in its model, their options, and what was identified as starting values.

    Args:
        found: The diagnosis.
        out: Folder that the file will stand in; the robot file is named from there.
    """
    import tomli_w

    data: dict[str, Any] = read_toml(found.study.path)
    model = data.setdefault("model", {})
    model["effects"] = list(found.extended_study.effects)
    model["reference"] = found.study.reference
    for cause in found.causes:
        _put_options(model, cause.hypothesis)
    known = set(found.identification.model.names)
    nominal = {name: value for name, value in _flat(model.get("nominal", {})).items() if name in known}
    model["nominal"] = {**nominal, **found.identification.parameters}
    if found.range_noise is not None:
        _put_noise(data["noise"], found.range_noise.noise.tracker)
    name_robot_from(out, data, found.study.path)
    return tomli_w.dumps(data)


def _put_options(model: dict[str, Any], cause: Hypothesis) -> None:
    """Options of a cause, at its place where it has one of its own."""
    options = placed_options(cause)
    if options:
        model.setdefault(cause.name, {}).update(options)


def _put_noise(noise: dict[str, Any], tracker: Tracker | None) -> None:
    """Noise that grows with the distance in place of a constant one."""
    if tracker is not None:
        noise.pop("reading_mm", None)
        noise["tracker"] = {
            "radial_um": tracker.radial / UM,
            "radial_um_per_m": tracker.radial_per_m / UM,
            "transverse_um": tracker.transverse / UM,
            "transverse_um_per_m": tracker.transverse_per_m / UM,
        }


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, float]:
    """Nested tables of numbers as one table with dotted names."""
    flat: dict[str, float] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat
