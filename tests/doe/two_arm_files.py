"""Studies of two arms for tests: two three-joint arms on one waist, and the shipped SDA5F."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from identify.two_arm_config import load_two_arm_study
from identify.two_arm_study import TwoArmStudy
from tests.doe.study_files import ARM, merged, study_file

ROOT = Path(__file__).parents[2]
SDA5F = ROOT / "configs" / "studies" / "sda5f_both.toml"
TRUTHS = [ROOT / "configs" / "truths" / f"sda5f_{name}.toml" for name in ("r1", "r2")]

PUSH = [0.3, 0.7, -1.0, 0.0, 0.0, 0.0]
PULL = [-0.2, 0.5, -0.6, 0.0, 0.0, 0.0]
#: The elbow up in one arm and down in the other: with equal waists both tips are at one point.
UP, DOWN = [20.0, 60.0, -70.0], [20.0, -0.915, 70.0]

#: Loads pull sideways too, so that the waist shows.
SIDE: dict[str, Any] = merged(
    ARM,
    {
        "loads": [{"id": "L0"}, {"id": "L1", "wrench": [0, 0.5, -1, 0, 0, 0]}],
        "plan": {"reference_rows": False, "candidates": None, "poses": None},
        "test_poses": None,
    },
)

BOTH: dict[str, Any] = {
    "arms": [{"name": "A", "study": "a.toml"}, {"name": "B", "study": "b.toml"}],
    "waist": {"shared_joints": 1},
    "test_poses": [
        {"A": {"joints_deg": UP, "wrench": PUSH}, "B": {"joints_deg": [20.0, 10.0, 40.0], "wrench": PULL}},
        {
            "A": {"joints_deg": [-50.0, 30.0, 40.0], "wrench": PULL, "point_mm": [50.0, 30.0, -20.0]},
            "B": {"joints_deg": [-50.0, 45.0, 20.0], "wrench": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]},
            "weight": 2.0,
        },
    ],
    "plan": {"poses": 7, "candidates": 400, "refine": False},
}


def write_both(folder: Path, *, first: Any = None, second: Any = None, **changes: Any) -> Path:
    """A study file of two arms beside the files of its arms; ``first`` and ``second`` change those."""
    study_file(folder, SIDE, name="a.toml", **(first or {}))
    study_file(folder, SIDE, name="b.toml", **(second or {}))
    path = folder / "both.toml"
    path.write_text(tomli_w.dumps(merged(BOTH, changes)), encoding="utf-8")
    return path


def both(folder: Path, **changes: Any) -> TwoArmStudy:
    """The study of such a file."""
    return load_two_arm_study(write_both(folder, **changes))
