"""Study files for tests: two robots as tables of a study file, changed as a test needs them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from identify.config import load_study
from identify.study import Study

#: Unit load at the tip of the three-joint arm, read with sigma = 1 m: rms_mm is 1000 times rho_0 of the tables.
ARM: dict[str, Any] = {
    "robot": {"model": "arm_3dof"},
    "markers": {"M1": [0.0, 0.0, 0.0]},
    "loads": [{"id": "L0"}, {"id": "L1", "wrench": [0, 0, -1, 0, 0, 0]}],
    "noise": {"reading_mm": 1000.0},
    "frames": {"measurement": "base", "markers": "exact"},
    "model": {"effects": ["joint_compliance"], "reference": "absolute"},
    "test_poses": [{"joints_deg": [0, 45, -90], "wrench": [0, 0, -1, 0, 0, 0]}],
    "plan": {"poses": 4, "reference_rows": False, "candidates": 2000},
    "constraints": {"self_collision": False},
}

_PUSH = {"wrench": [0.0, 0.0, -1500.0, 0.0, 0.0, 0.0], "attach_mm": [300.0, 0.0, 0.0]}

#: A KR 270 with three reflectors and two weights.
KR270: dict[str, Any] = {
    "robot": {"model": "kr270_r2700"},
    "markers": {"M1": [50.0, 0.0, 120.0], "M2": [50.0, 100.0, -60.0], "M3": [50.0, -100.0, -60.0]},
    "loads": [
        {"id": "L0"},
        {"id": "L1", "mass_kg": 250.0, "attach_mm": [200.0, 50.0, -250.0]},
        {"id": "L2", "mass_kg": 120.0, "attach_mm": [100.0, -300.0, 150.0]},
    ],
    "noise": {"reading_mm": 0.03, "pose_jitter_urad": 12.0, "reading_jitter_urad": 1.5},
    "test_poses": [
        {"joints_deg": [0.0, -60.0, 90.0, 0.0, 45.0, 0.0], **_PUSH},
        {"joints_deg": [0.0, -45.0, 60.0, 30.0, 60.0, 20.0], **_PUSH, "weight": 2.0},
    ],
    "plan": {"poses": 8, "loads": ["L1"], "candidates": 400},
    "constraints": {"joint_margin_deg": 2.0, "floor_mm": 100.0},
}


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with some keys changed; None takes a key away."""
    result = dict(base)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(value, Mapping) and isinstance(old, Mapping) else value
    return {key: value for key, value in result.items() if value is not None}


def study_file(folder: Path, base: Mapping[str, Any], *, name: str = "study.toml", **changes: Any) -> Path:
    """A study file with the tables of ``base``, changed."""
    path = folder / name
    path.write_text(tomli_w.dumps(merged(base, changes)), encoding="utf-8")
    return path


def study(folder: Path, base: Mapping[str, Any], **changes: Any) -> Study:
    """The study of such a file."""
    return load_study(study_file(folder, base, **changes))
