"""A KR 270 in a cell, and the same geometry as coal objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import numpy as np

from doe.candidates import sampled_range
from identify.cell import Box, Station, Wall
from identify.loads import LoadCase, Markers
from identify.robot_files import load_robot
from identify.study import Constraints, Noise, PlanSettings, Study
from identify.transforms import roll_pitch_yaw

UNLOADED = LoadCase("L0")
BLOCK = LoadCase("W1", mass=180.0, attach=np.array([0.2, 0.06, -0.12]), size=np.array([0.3, 0.25, 0.4]), hang=0.35)
MARKERS = Markers(
    ("M1", "M2", "M3"),
    np.array([[0.06, 0.0, 0.16], [0.06, 0.15, -0.08], [0.06, -0.15, -0.08]]),
    np.zeros(3, dtype=bool),
    np.array([[1.0, 0, 0], [0.8, 0.6, 0], [np.nan] * 3]),
)
CABINET = Box("cabinet", np.array([1.2, 1.0, 0.6]), np.array([0.4, 0.3, 0.6]), roll_pitch_yaw([0.2, -0.3, 0.7]))
BACK = Wall("back", np.array([-0.8, 0.0, 0.0]), np.array([0.8, 0.0, 0.6]))


def cell(
    robot: Any = "kr270_r2700",
    loads: tuple[LoadCase, ...] = (UNLOADED, BLOCK),
    markers: Markers = MARKERS,
    station: Any = None,
    mount: Any = (0.0, 0.0, 0.0),
    plan: dict[str, Any] | None = None,
    **constraints: Any,
) -> Study:
    robot = load_robot(robot, mount=np.array(mount)) if isinstance(robot, str) else robot
    stations = () if station is None else (Station("S1", np.array(station)),)
    return Study(
        Path("s.toml"), robot, loads, markers, Noise(1e-5), constraints=Constraints(**constraints),
        stations=stations, plan=PlanSettings(**(plan or {"stations": ("S1",) if stations else ()})),
    )  # fmt: skip


def poses(study: Study, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(*sampled_range(study), (count, study.robot.n))


def placed(rotation: np.ndarray, origin: np.ndarray) -> Any:
    transform = coal.Transform3s()
    transform.setRotation(np.array(rotation))
    transform.setTranslation(np.array(origin))
    return transform


def capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[Any, Any]:
    """A coal capsule; coal's length is that of its axis, along z."""
    length = np.linalg.norm(end - start)
    z = (end - start) / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return coal.Capsule(radius, length), placed(np.column_stack([x, np.cross(z, x), z]), (start + end) / 2)


def box(centre: np.ndarray, half: np.ndarray, rotation: np.ndarray) -> tuple[Any, Any]:
    return coal.Box(*(2 * half)), placed(rotation, centre)


def distance(first: tuple[Any, Any], second: tuple[Any, Any]) -> float:
    """Signed distance by coal, m; not above zero where they overlap."""
    return float(coal.distance(*first, *second, coal.DistanceRequest(), coal.DistanceResult()))
