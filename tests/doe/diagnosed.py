"""Files of a small diagnosis: a UR10 with one weight, and readings of a truth that its study does not know."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from doe.cli import run
from identify.csv_file import csv_text
from tests.doe.study_files import study_file

UR10: dict[str, Any] = {
    "robot": {"model": "ur10"},
    "markers": {"M1": [50.0, 0.0, 120.0], "M2": [50.0, 100.0, -60.0], "M3": [50.0, -100.0, -60.0]},
    "loads": [{"id": "L0"}, {"id": "L1", "mass_kg": 8.0, "attach_mm": [50.0, 20.0, 100.0]}],
    "noise": {"reading_mm": 0.02, "pose_jitter_urad": 10.0},
    "model": {"effects": ["joint_compliance"], "reference": "absolute"},
}
_SOFT = {f"joint_compliance.j{i + 1}": c for i, c in enumerate((14.0, 15.0, 18.0, 40.0, 42.0, 45.0))}


def arm_study(folder: Path) -> Path:
    """The study file."""
    return study_file(folder, UR10)


def measured_arm(folder: Path, hidden: Mapping[str, float], *, poses: int = 25) -> Path:
    """Measurements of random poses with hidden effects beside the joints' compliance.

    Args:
        folder: Holds the study.
        hidden: Values of hidden parameters by name; ``<name>.<where>.<component>``.
        poses: Number of poses.
    """
    rng = np.random.default_rng(5)
    q = np.repeat(rng.uniform(-100, 100, (poses, 6)).round(3), 2, axis=0)
    names = [f"P{i // 2 + 1:03d}" for i in range(2 * poses)]
    header = ["pose", "load", *(f"q{joint}_deg" for joint in range(1, 7))]
    plan, truth = folder / "plan.csv", folder / "truth.toml"
    plan.write_text(csv_text(header, [names, ["L0", "L1"] * poses, *q.T]))
    effects = ["joint_compliance", *sorted({"@".join(name.split(".")[:2]) for name in hidden})]
    truth.write_text(tomli_w.dumps({"truth": {"effects": effects, "values": {**_SOFT, **hidden}}}))
    assert (
        run(["simulate", str(folder / "study.toml"), str(plan), "--truth", str(truth), "--out", str(folder / "sim")])
        == 0
    )
    return folder / "sim" / "measurements.csv"
