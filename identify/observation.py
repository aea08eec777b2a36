"""Observation matrix of elastic parameters: what loads alone do to markers (or 6-D targets) at many configurations."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.effects import build_scene
from identify.errors import NotIdentifiable
from identify.experiment import full_experiment
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import Model
from identify.response import effect_columns
from identify.springs import cross
from identify.study import Study

__all__ = ["observation_matrix", "probing_loads", "random_configurations"]

_TURN = np.pi  # +- rad: a turning joint without limits
_STROKE = 1.0  # +- m: a sliding joint without limits


def random_configurations(study: Study, count: int, rng: np.random.Generator) -> Floats:
    """Joint values (count, n), uniform within the limits; unknown limits are +-180 deg or +-1 m."""
    robot = study.robot
    half = np.where(robot.prismatic, _STROKE, _TURN)
    lower = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(-half, robot.upper - 2 * half))
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.maximum(half, lower + 2 * half))
    drawn: Floats = lower + (upper - lower) * rng.random((count, robot.n))
    return drawn


def probing_loads(study: Study) -> tuple[LoadCase, ...]:
    """The loads that are put on at every configuration.

    The loaded cases of the study as they stand, or unit forces (and moments) along all axes at the points where they
    act, as `study.reduce.directions` asks.

    Raises:
        NotIdentifiable: Nothing loads the robot.
    """
    loaded = [load for load in study.loads if not load.unloaded]
    if study.reduce.directions == "loads":
        if not loaded:
            raise NotIdentifiable(
                f'{study.path}: no load loads the robot; give one under [[loads]], or [reduce] directions = "forces"'
            )
        return tuple(loaded)
    points = dict.fromkeys(tuple(load.attach.tolist()) for load in loaded or study.loads)
    units = np.eye(6)[: 3 if study.reduce.directions == "forces" else 6]
    return tuple(
        LoadCase("unit", attach=np.array(point), force=unit[:3], moment=unit[3:]) for point in points for unit in units
    )


def observation_matrix(study: Study, model: Model, q: Floats) -> Floats:
    """Rows of readings, columns of the model's parameters in their units.

    Rows are the displacements (m) of all flange markers by each load alone, and for ``targets = "pose"`` also the
    rotation (rad) of the flange.

    Args:
        study: Markers, loads and settings.
        model: Effects on the robot, without frame and markers.
        q: (V, n) configurations.

    Returns:
        (K, p).

    Raises:
        NotIdentifiable: Nothing loads the robot.
    """
    loads, pose = (LoadCase("L0"), *probing_loads(study)), study.reduce.targets == "pose"
    positions = study.markers.positions[~study.markers.on_base]
    if pose:
        positions = np.concatenate([positions, positions[0] + np.eye(3)])
    markers = Markers(tuple(f"M{i}" for i in range(len(positions))), positions, np.zeros(len(positions), dtype=bool))
    experiment = full_experiment(q, np.tile(np.arange(len(loads)), (len(q), 1)), loads, markers)
    scene = build_scene(experiment, forward(model.robot, q), positions, self_weight=False)
    columns = effect_columns(model, scene, model.nominal).reshape(len(q), len(loads), len(positions), 3, -1)
    change = columns[:, 1:] - columns[:, :1]
    if pose:
        change = _with_rotation(change, scene.marker)
    return np.asarray(change.reshape(-1, change.shape[-1]))


def _with_rotation(columns: Floats, points: Floats) -> Floats:
    """Replace the last three markers by the rotation of the flange.

    They stand 1 m from the first marker along the axes e of the flange and move by ``theta x e`` relative to it, so
    ``theta = 1/2 sum e x (theta x e)``, exactly.

    Args:
        columns: (V, L, M, 3, p).
        points: (V, M, 3) undeflected markers, base frame, m.

    Returns:
        (V, L, M - 2, 3, p).
    """
    arms = (points[:, -3:] - points[:, :1])[:, None, :, None]
    relative = (columns[:, :, -3:] - columns[:, :, :1]).swapaxes(3, 4)
    turned = 0.5 * cross(arms, relative).sum(axis=2).swapaxes(2, 3)
    return np.concatenate([columns[:, :, :-3], turned[:, :, None]], axis=2)
