"""Causes that turn one joint by a function of its own value alone, as curves with their bands.

Whether a cause is of this kind is seen, not listed: at several poses of the rest of the arm, unloaded and loaded, the
same value of the joint must give the same turn, and no other motion.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats
from identify.diagnosis.search import Cause
from identify.experiment import Experiment, full_experiment
from identify.identification import Identification
from identify.response import respond

__all__ = ["Curve", "curves"]

_POINTS, _FINE = 73, 361  # of a curve, of one with short waves
_POSES = 3  # of the rest of the arm
_SAME = 0.02  # of the largest turn
_JOINT = re.compile(r"j(\d+)")


@dataclass(frozen=True, eq=False)
class Curve:
    """How far a cause turns (or slides) one joint over its value.

    Attributes:
        cause: Its entry, ``name@where``.
        joint: Number of the joint, from 0.
        value: (K,) joint values within those that were measured, rad or m.
        turn: (K,) rad or m.
        half: (K,) half width of the 95 % band of each point, rad or m.
    """

    cause: str
    joint: int
    value: Floats
    turn: Floats
    half: Floats


def curves(result: Identification, causes: Sequence[Cause]) -> tuple[Curve, ...]:
    """The curves of those causes that have one.

    Args:
        result: The extended model, identified.
        causes: Causes in it.
    """
    made = (_curve(result, cause) for cause in causes)
    return tuple(curve for curve in made if curve is not None)


def _curve(result: Identification, cause: Cause) -> Curve | None:
    """The curve of one cause, None if it is no function of one joint's value."""
    own = cause.hypothesis
    place = _JOINT.fullmatch(own.where or "")
    if place is None:
        return None
    joint, model = int(place[1]) - 1, result.model
    names = model.names
    index = np.array([names.index(own.effect.parameters[number].name) for number in own.own])
    values = np.where(model.nuisance, model.nominal, result.values)
    points = _FINE if "knots_deg" in own.options else _POINTS
    swept = _sweep(result, joint, points)
    without = values.copy()
    without[index] = 0.0
    response = respond(model, swept, values)
    moved = response.position - respond(model, swept, without, derivative=False).position
    motion = response.scene.joints.motion[:, joint]
    turn, slopes = _turned(motion, moved[..., None])[:, 0], _turned(motion, response.derivative[:, :, index])
    by_pose = turn.reshape(-1, points)
    size = np.abs(turn).max()
    beside = np.linalg.norm(moved - motion * turn[:, None], axis=1).max() > _SAME * np.linalg.norm(moved, axis=1).max()
    if beside or np.ptp(by_pose, axis=0).max() > _SAME * size or np.ptp(by_pose[0]) <= _SAME * size:
        return None
    spread = slopes[:points] @ result.covariance[np.ix_(index, index)]
    half = result.quantile * np.sqrt(np.maximum((spread * slopes[:points]).sum(axis=1), 0.0))
    return Curve(own.entry, joint, swept.q[:points, joint], by_pose[0], half)


def _turned(motion: Floats, moved: Floats) -> Floats:
    """(R, 3, c) displacements as turns of the joint by its motion (R, 3), least squares: (R, c)."""
    square = np.maximum((motion**2).sum(axis=1), 1e-300)  # a marker on the axis does not move
    turned: Floats = np.einsum("ri,ric->rc", motion, moved) / square[:, None]
    return turned


def _sweep(result: Identification, joint: int, points: int) -> Experiment:
    """One marker read while one joint moves over its measured range: unloaded and with each load, at several poses."""
    measured, far = result.data.experiment, _farthest_marker(result, joint)
    rest = measured.q[np.linspace(0, len(measured.q) - 1, _POSES).round().astype(int)]
    q = np.repeat(rest, points, axis=0)
    q[:, joint] = np.tile(np.linspace(measured.q[:, joint].min(), measured.q[:, joint].max(), points), _POSES)
    loads = len(measured.loads)
    q = np.tile(q, (loads, 1))
    which = np.repeat(np.arange(loads), _POSES * points)[:, None]
    full = full_experiment(q, which, measured.loads, measured.markers)
    kept = np.flatnonzero(full.row_marker == far)
    return replace(
        full,
        row_shot=full.row_shot[kept],
        row_marker=full.row_marker[kept],
        time=None if measured.time is None else np.full(len(kept), measured.time[0]),
        temperature=None if measured.temperature is None else np.full(len(kept), measured.temperature[0]),
        approach=None if measured.approach is None else np.ones((len(q), q.shape[1])),
    )


def _farthest_marker(result: Identification, joint: int) -> int:
    """The marker that the joint moves most."""
    moves = np.linalg.norm(result.fit.response.scene.joints.motion[:, joint], axis=1)
    return int(np.argmax(np.bincount(result.data.experiment.row_marker, moves)))
