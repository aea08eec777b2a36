"""Small studies in memory: a heavy arm with three markers, the UR10, planar arms, and readings of a stated truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from identify.arrays import Floats, rotation_of
from identify.experiment import Experiment, Measurements, full_experiment
from identify.loads import LoadCase, Markers
from identify.model import Model, model_of
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.simulate import simulate
from identify.study import Noise, Study
from identify.transforms import axis_frame, translation

ROOT = Path(__file__).parents[2]
ROBOTS = ROOT / "configs" / "robots"

NOISE = Noise(reading=0.03e-3, pose_jitter=12e-6, reading_jitter=1.5e-6)
EXACT = Noise(reading=1e-15)
UNLOADED = LoadCase("L0")
WEIGHT = LoadCase("L1", mass=250.0, attach=np.array([0.2, 0.05, -0.25]))
LIGHT = LoadCase("L2", mass=120.0, attach=np.array([0.1, -0.3, 0.15]))
SIDE = LoadCase("L3", attach=np.array([0.3, 0.1, 0.1]), force=np.array([300.0, 900.0, -500.0]), in_flange=True)
PLATE = Markers(
    names=("M1", "M2", "M3"),
    positions=np.array([[0.05, 0.0, 0.12], [0.05, 0.1, -0.06], [0.05, -0.1, -0.06]]),
    on_base=np.zeros(3, dtype=bool),
)
COMPLIANCE = {f"joint_compliance.j{i + 1}": c for i, c in enumerate((0.35, 0.27, 0.38, 2.7, 3.1, 2.2))}
SOFT = {f"joint_compliance.j{i + 1}": c for i, c in enumerate((14.0, 15.0, 18.0, 40.0, 42.0, 45.0))}
LINKS = np.array([0.0, 320.0, 180.0, 90.0, 40.0, 20.0])  # kg; made up, about those of a heavy arm
CENTRES = np.array([[0.1, 0, -0.2], [0.5, 0.1, 0], [0.2, 0, 0.1], [0.3, 0, 0], [0.05, 0, 0], [0.1, 0, 0]])
WINDOW = np.deg2rad([[-150, 150], [-120, -30], [0, 140], [-180, 180], [-110, 110], [-180, 180]])


def kr270(*, masses: bool = True, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Robot:
    """A KR 270 R2700, with link masses of about the right size unless they are to be unknown."""
    robot = load_robot(ROBOTS / "kr270_r2700.toml", mount=mount)
    return replace(robot, masses=LINKS, centres=CENTRES) if masses else robot


def study_of(robot: Robot, **changes: Any) -> Study:
    """A study of any robot: three markers, unloaded and one weight, free frame, joint compliances."""
    given: dict[str, Any] = {"loads": (UNLOADED, WEIGHT), "markers": PLATE, "noise": NOISE}
    return Study(path=Path("study.toml"), robot=robot, **{**given, **changes})


def kr270_study(*, masses: bool = True, mount: tuple[float, float, float] = (0.0, 0.0, 0.0), **changes: Any) -> Study:
    """The heavy arm."""
    return study_of(kr270(masses=masses, mount=mount), **changes)


def ur10_study(**changes: Any) -> Study:
    """The UR10 with 8 kg on it."""
    load = LoadCase("L1", mass=8.0, attach=np.array([0.05, 0.02, 0.1]))
    given: dict[str, Any] = {"loads": (UNLOADED, load), "noise": Noise(reading=0.02e-3, pose_jitter=10e-6)}
    return study_of(load_robot(ROBOTS / "ur10.toml"), **{**given, **changes})


def random_robot(rng: np.random.Generator, slides: tuple[bool, ...]) -> Robot:
    """Joints about crooked axes, some of them sliding, with masses, a tool and a tilted base."""
    n = len(slides)
    placements = [translation(rng.normal(0, 0.4, 3)) @ axis_frame(rng.normal(size=3)) for _ in range(n + 1)]
    return Robot(
        name="crooked",
        joints=tuple(f"q{i + 1}" for i in range(n)),
        prismatic=np.array(slides),
        placements=np.array(placements),
        lower=np.full(n, -2.0),
        upper=np.full(n, 2.0),
        masses=rng.uniform(1, 50, n),
        centres=rng.normal(0, 0.3, (n, 3)),
        efforts=np.full(n, np.nan),
        world_R_base=rotation_of(rng.normal(0, 0.5, 3)),
        tool_mass=12.0,
        tool_centre=np.array([0.1, 0.2, -0.1]),
    )


def poses(study: Study, count: int, rng: np.random.Generator) -> Floats:
    """Random joint values of a working window, (count, n)."""
    robot = study.robot
    window = WINDOW if robot.name.startswith("KUKA KR 270") else np.tile([-1.8, 1.8], (robot.n, 1))
    return rng.uniform(window[:, 0], window[:, 1], (count, robot.n))


def experiment_of(study: Study, q: Floats) -> Experiment:
    """Every pose under every load, all markers read."""
    return full_experiment(q, np.tile(np.arange(len(study.loads)), (len(q), 1)), study.loads, study.markers)


def values_of(model: Model, given: Mapping[str, float]) -> Floats:
    """Nominal parameters overlaid with given ones."""
    values = model.nominal.copy()
    for name, value in given.items():
        values[model.names.index(name)] = value
    return values


def placement_of(rng: np.random.Generator) -> Floats:
    """Somewhere in the hall, turned anyhow, (4, 4)."""
    placement = np.eye(4)
    placement[:3, :3] = rotation_of(rng.normal(size=3))
    placement[:3, 3] = rng.uniform(-4, 4, 3)
    return placement


def readings(
    truth: Study,
    experiment: Experiment,
    values: Mapping[str, float],
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    placement: Floats | None = None,
) -> Measurements:
    """Simulated readings; the experiment's loads are those of the truth while they are simulated."""
    if placement is None:
        placement = placement_of(rng) if truth.frame_free else np.eye(4)
    model = model_of(truth)
    true_experiment = replace(experiment, loads=truth.loads, markers=truth.markers)
    data = simulate(model, values_of(model, values), true_experiment, noise or truth.noise, placement, rng)
    return replace(data, experiment=experiment)


def measured(
    study: Study, rng: np.random.Generator, *, count: int = 12, values: Mapping[str, float] = COMPLIANCE, **options: Any
) -> Measurements:
    """Readings of random poses under all loads, the study itself being the truth."""
    return readings(study, experiment_of(study, poses(study, count, rng)), values, rng, **options)


def moved_markers(study: Study, rng: np.random.Generator, spread: float = 1e-3) -> dict[str, float]:
    """Random marker corrections, mm."""
    return {
        f"marker.{name}.{axis}": float(rng.normal(0, spread * 1e3)) for name in study.markers.names for axis in "xyz"
    }


def geometry_errors(robot: Robot, rng: np.random.Generator, turn: float = 0.5, shift: float = 0.3) -> dict[str, float]:
    """Random geometric errors: mrad and mm, 1 sigma."""
    from identify.effects import bind_effects

    (effect,) = bind_effects(("geometry",), robot)
    return {p.name: float(rng.normal(0, turn if p.unit == "mrad" else shift)) for p in effect.parameters}
