"""The observation block of one visit as a CasADi expression of its joint values, for exact derivatives.

The formulas are those of `identify`: the chain and the springs (`doe.symbolic_arm`), the columns of the effects
and the operators of `identify.noise` for regular visits (every shot reads all markers). With Helmert contrasts
h over the L shots and columns that split into a part S that all shots share and a part V_s of each shot, the
whitened block is

    B^-1/2 sum_s h_rs V_s                              for each contrast r
    (B + L J L_pose J')^-1/2 (sqrt(L) S + sum_s V_s / sqrt(L))      for the mean (``absolute`` only)

Where nominal compliances are not zero the deflection changes with geometry and markers. `identify.response` takes
this part of their columns by differences; here it is a derivative too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import helmert

from doe.observations import Observer
from doe.symbolic_arm import SX, Chain, chain, load_torque, motion_of, springs_of, turning_of, vector, weight_torque
from identify.arrays import Floats, Ints
from identify.effects import Effect
from identify.effects.base import SpringSet, Term
from identify.experiment import full_experiment
from identify.response import frame_displacement, marker_positions
from identify.robot import Robot
from identify.study import Noise
from identify.units import MM, MRAD, SI_OF

__all__ = ["block_function", "missing_columns"]


# --- columns of the model --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Visit:
    """One pose with all its fields, symbolic.

    Attributes:
        robot: The nominal robot.
        arm: The chain of the robot as adjusted by the effects' nominal values.
        on_base: (M,) True for markers that do not move.
        points: M (3, 1) markers.
        loads: (15, L) columns of `load_table`, one a shot.
        self_weight: The weight of links and tool counts.
        targets: How many 6-D targets there are, whose turns are read behind the M positions of a shot.
    """

    robot: Robot
    arm: Chain
    on_base: np.ndarray
    points: list[SX]
    loads: SX
    self_weight: bool
    targets: int

    @property
    def rows(self) -> int:
        """Numbers read in one shot."""
        return 3 * (len(self.points) + self.targets)

    def motion(self, kind: SpringSet) -> SX:
        """(rows, s) motion of what is read per unit of each spring of a set."""
        springs = springs_of(self.arm, kind)
        pairs = zip(self.points, self.on_base, strict=True)
        moved = (ca.SX(3, len(springs)) if fixed else motion_of(springs, point) for point, fixed in pairs)
        return ca.vertcat(*moved, *[turning_of(springs)] * self.targets)

    def torques(self, kind: SpringSet) -> list[SX]:
        """What each spring of a set bears, (s, 1): of the self-weight, then of the load of each shot."""
        springs = springs_of(self.arm, kind)
        weight = weight_torque(self.arm, springs) if self.self_weight else ca.SX(len(springs), 1)
        return [weight, *(load_torque(self.arm, springs, load) for load in ca.horzsplit(self.loads))]


Columns = tuple[SX, list[SX]]  # what all shots share, (rows, p), and what each of the L shots adds; [] for nothing


def _spring_columns(visit: _Visit, effect: Effect, values: Floats) -> Columns:
    """``D_s t_r + D_r t_s`` for each pair of springs, ``D_s t_s`` where they are one."""
    return _pair_columns(visit, effect, effect.terms)


def _pair_columns(visit: _Visit, effect: Effect, terms: tuple[Term, ...]) -> Columns:
    """The columns of some pairs among the springs of an effect."""
    assert effect.springs is not None
    motion, torques = visit.motion(effect.springs), visit.torques(effect.springs)
    first, second = [term.first for term in terms], [term.second for term in terms]
    scale = np.array([SI_OF[term.unit] for term in terms])
    back = scale * np.array([term.mutual and term.first != term.second for term in terms])
    shared, *own = (
        motion[:, first] @ ca.diag(scale * torque[second])
        + motion[:, second] @ ca.diag(ca.sparsify(ca.SX(back)) * torque[first])
        for torque in torques
    )
    return shared, own


def _geometry_columns(visit: _Visit, effect: Effect, values: Floats) -> Columns:
    """Each parameter is a screw that stands still in the frame which it displaces."""
    screws = [_screw(effect, visit.robot, values, column) for column in range(len(values))]
    return ca.horzcat(*(_screw_motion(visit, frame, screw) for frame, screw in screws)), []


#: Name of an effect -> its columns. An effect that is not here cannot be refined.
COLUMNS: dict[str, Callable[[_Visit, Effect, Floats], Columns]] = {
    "base_compliance": _spring_columns,
    "geometry": _geometry_columns,
    "joint_compliance": _spring_columns,
    "joint_cross_compliance": _spring_columns,
    "link_compliance": _spring_columns,
    "tool_compliance": _spring_columns,
}


def missing_columns(observer: Observer) -> tuple[str, ...]:
    """Names of the observer's effects that have no symbolic columns."""
    return tuple(effect.name for effect in observer.model.effects if effect.name not in COLUMNS)


def _screw(effect: Effect, robot: Robot, values: Floats, column: int) -> tuple[int, Floats]:
    """Number of the frame that a geometric parameter displaces, and its screw (4, 4) per unit of the parameter.

    The displacement is a product of exponentials, so a step of any size gives the screw exactly.
    """
    assert effect.adjust is not None
    scale = effect.parameters[column].scale
    step = np.zeros(len(values))
    step[column] = 1.0 / scale  # 1 m or 1 rad
    before, after = effect.adjust(robot, values).placements, effect.adjust(robot, values + step).placements
    frame = int(np.argmax(np.abs(after - before).max(axis=(1, 2))))
    screw = _logarithm(np.linalg.solve(before[frame], after[frame]))
    screw[np.abs(screw) < 1e-14] = 0.0
    return frame, scale * screw


def _logarithm(motion: Floats) -> Floats:
    """The screw (4, 4) whose exponential is a motion (4, 4) by less than half a turn."""
    turn = 0.5 * (motion[:3, :3] - motion[:3, :3].T)
    sine = float(np.sqrt(0.5 * np.sum(turn * turn)))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(motion[:3, :3]) - 1.0)))
    screw = np.zeros((4, 4))
    if sine < 1e-12:
        screw[:3, 3] = motion[:3, 3]
        return screw
    turn = turn / sine
    along = np.eye(3) * angle + (1.0 - np.cos(angle)) * turn + (angle - sine) * turn @ turn
    screw[:3, :3], screw[:3, 3] = angle * turn, angle * np.linalg.solve(along, motion[:3, 3])
    return screw


def _screw_motion(visit: _Visit, frame: int, screw: Floats) -> SX:
    """Motion of all that is read by a screw of one frame, (rows, 1)."""
    arm = visit.arm
    last = frame == arm.robot.n
    rotation = arm.flange_rotation if last else arm.rotation[frame]
    origin = arm.flange_origin if last else arm.origin[frame]
    shift, turn = rotation @ vector(screw[:3, 3]), rotation @ vector(screw[[2, 0, 1], [1, 2, 0]])
    moves = [shift + ca.cross(turn, point - origin) for point in visit.points]
    moved = (ca.SX(3, 1) if fixed else move for move, fixed in zip(moves, visit.on_base, strict=True))
    return ca.vertcat(*moved, *[turn] * visit.targets)


def _frame_columns(visit: _Visit, deflection: Columns, turn: Floats, shift: Floats) -> Columns:
    """Displacement of the base: translation, then rotation about the base origin."""
    shared, *own = (part[: 3 * len(visit.points)] for part in (deflection[0], *deflection[1]))
    turned = ca.diagcat(*[ca.SX(turn)] * len(visit.points))
    position = turned @ (ca.vertcat(*visit.points) + shared) + ca.repmat(vector(shift), len(visit.points), 1)
    ahead = ca.repmat(MM * ca.SX.eye(3), len(visit.points), 1)
    none, targets = ca.SX(*ahead.shape), visit.targets
    turns = ca.horzcat(ca.SX(3 * targets, 3), ca.repmat(MRAD * ca.SX.eye(3), targets, 1))
    return ca.vertcat(ca.horzcat(ahead, _turned(position)), turns), [
        ca.vertcat(ca.horzcat(none, _turned(turned @ part)), ca.SX(*turns.shape)) for part in own
    ]


def _turned(position: SX) -> SX:
    """Motion (3 M, 3) of points (3 M, 1) per mrad about the base axes."""
    return ca.vertcat(*(-MRAD * ca.skew(point) for point in ca.vertsplit(position, 3)))


def _marker_columns(visit: _Visit) -> Columns:
    """Each marker moves by its own correction, turned by the flange (or not, on the base)."""
    turns = [ca.SX.eye(3) if fixed else visit.arm.flange_rotation for fixed in visit.on_base]
    columns = MM * ca.diagcat(*turns)
    return ca.vertcat(columns, ca.SX(3 * visit.targets, columns.shape[1])), []


def _target_columns(visit: _Visit) -> Columns:
    """Each 6-D target turns by its own correction about the axes of the flange."""
    turns = ca.diagcat(*[MRAD * visit.arm.flange_rotation] * visit.targets)
    return ca.vertcat(ca.SX(3 * len(visit.points), turns.shape[1]), turns), []


def _model_columns(observer: Observer, q: SX, loads: SX, visit: _Visit) -> Columns:
    """All columns of the model: frame, markers, effects."""
    model, shots = observer.model, visit.loads.shape[1]
    parts = []
    if model.frame_size:
        displaced = frame_displacement(model, model.nominal)
        parts.append(_frame_columns(visit, _deflection(observer, visit), *displaced))
    if model.marker_size:
        parts.append(_marker_columns(visit))
    if model.turn_size:
        parts.append(_target_columns(visit))
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        parts.append(COLUMNS[effect.name](visit, effect, model.nominal[where]))
    return _add(_beside(parts, shots), _bending(observer, q, loads, visit.rows))


def _deflection(observer: Observer, visit: _Visit) -> Columns:
    """Displacement of all markers by the effects at their nominal values; all effects of the table are linear."""
    model, rows = observer.model, visit.rows
    total: Columns = ca.SX(rows, 1), [ca.SX(rows, 1)] * visit.loads.shape[1]
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        values = model.nominal[where]
        if effect.adjust is None and values.any():
            shared, own = COLUMNS[effect.name](visit, effect, values)
            total = _add(total, (shared @ values, [part @ values for part in own]))
        if effect.held:
            terms, constants = zip(*effect.held, strict=True)
            shared, own = _pair_columns(visit, effect, terms)
            total = _add(total, (shared @ ca.SX(constants), [part @ ca.SX(constants) for part in own]))
    return total


def _bending(observer: Observer, q: SX, loads: SX, rows: int) -> Columns:
    """How the deflection changes with markers and geometry."""
    model = observer.model
    pairs = zip(model.effects, model.effect_slices, strict=True)
    if not any(effect.held or model.nominal[where].any() for effect, where in pairs if effect.adjust is None):
        return ca.SX(rows, len(model.parameters)), []
    changes = ca.SX.sym("changes", len(model.parameters))
    shared, own = _deflection(observer, _visit(observer, q, loads, changes))
    none = ca.SX.zeros(changes.shape)
    shared, *own = (ca.substitute(ca.jacobian(part, changes), changes, none) for part in (shared, *own))
    return shared, own


def _add(left: Columns, right: Columns) -> Columns:
    """Sum of two sets of columns, the left one with a part of every shot."""
    own = right[1] or [0.0] * len(left[1])
    return left[0] + right[0], [a + b for a, b in zip(left[1], own, strict=True)]


def _beside(parts: list[Columns], shots: int) -> Columns:
    """Columns next to each other."""
    shared = ca.horzcat(*(part[0] for part in parts))
    own = [ca.horzcat(*(part[1][s] if part[1] else ca.SX(*part[0].shape) for part in parts)) for s in range(shots)]
    return shared, own


# --- whitening -------------------------------------------------------------------------------------------------------


def block_function(observer: Observer, shots: int, kept: Ints) -> Any:
    """The transposed whitened block of one visit as a CasADi function.

    Args:
        observer: What turns poses into blocks.
        shots: Number L of shots of a visit.
        kept: (p,) columns of the model to keep.

    Returns:
        ``(q (n, 1), loads (15, L)) -> (p, k)``, with ``loads`` columns of `load_table`. It equals
        ``observer.blocks`` up to the differences taken there, see the module.
    """
    robot, noise = observer.model.robot, observer.noise
    q, loads = ca.SX.sym("q", robot.n), ca.SX.sym("loads", 15, shots)
    visit = _visit(observer, q, loads)
    shared, own = _model_columns(observer, q, loads, visit)
    columns = [part[:, kept.tolist()] for part in own]
    motion = visit.motion("joints")
    jolt = motion @ motion.T
    spread = _instrument(noise, visit.points, visit.targets) + noise.reading_jitter**2 * jolt
    weights = np.vstack([helmert(shots) if shots > 1 else np.zeros((0, 1)), np.full((1, shots), shots**-0.5)])
    mixed = [sum((w * part for w, part in zip(row, columns, strict=True)), ca.SX(*columns[0].shape)) for row in weights]
    blocks = [_whitened(spread, part) for part in mixed[:-1]]
    if observer.reference == "absolute":
        mean = mixed[-1] + np.sqrt(shots) * shared[:, kept.tolist()]
        blocks.append(_whitened(spread + shots * noise.pose_jitter**2 * jolt, mean))
    return ca.Function("block", [q, loads], [ca.densify(ca.vertcat(*blocks).T)], {"cse": True})


def _visit(observer: Observer, q: SX, loads: SX, changes: SX | None = None) -> _Visit:
    """All fields of one visit; ``changes`` (p, 1) are small changes of the parameters of markers and geometry."""
    model, markers = observer.model, observer.study.markers
    robot = _adjusted(observer)
    changes = ca.SX(len(model.parameters), 1) if changes is None else changes
    arm = chain(robot, q, _displaced(observer, robot, changes))
    no_load = np.zeros((1, 1), dtype=np.int64)
    experiment = full_experiment(np.zeros((1, robot.n)), no_load, observer.study.loads, markers)
    local = ca.SX(marker_positions(model, experiment, model.nominal).T)
    if model.marker_size:
        local += MM * ca.reshape(changes[model.frame_size : model.frame_size + model.marker_size], 3, -1)
    fixed = markers.on_base
    points = [p if f else arm.point(p) for p, f in zip(ca.horzsplit(ca.sparsify(local)), fixed, strict=True)]
    targets = int((~fixed).sum()) if observer.study.six_d else 0
    return _Visit(model.robot, arm, fixed, points, loads, model.self_weight, targets)


def _displaced(observer: Observer, robot: Robot, changes: SX) -> list[SX]:
    """The placements of the adjusted robot after small changes of the parameters that displace them."""
    model = observer.model
    placements = [ca.SX(placement) for placement in robot.placements]
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if effect.adjust is None or changes.nnz() == 0:
            continue
        for column in range(where.stop - where.start):
            frame, screw = _screw(effect, model.robot, model.nominal[where], column)
            placements[frame] += ca.SX(robot.placements[frame] @ screw) * changes[where.start + column]
    return placements


def _adjusted(observer: Observer) -> Robot:
    """The robot with the nominal values of the effects that change it."""
    model = observer.model
    robot = model.robot
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if effect.adjust is not None:
            robot = effect.adjust(robot, model.nominal[where])
    return robot


def _instrument(noise: Noise, points: list[SX], targets: int) -> SX:
    """Covariance of one shot's readings, (rows, rows), m^2 and rad^2; see `identify.noise.reading_covariance`."""
    turns = noise.orientation**2 * ca.SX.eye(3 * targets)
    tracker = noise.tracker
    if tracker is None:
        return ca.diagcat(noise.reading**2 * ca.SX.eye(3 * len(points)), turns)
    assert tracker.station is not None  # the observer has refused it before
    parts = []
    for point in points:
        beam = point - ca.SX(tracker.station)
        distance = ca.norm_2(beam)
        across = (tracker.transverse + tracker.transverse_per_m * distance) ** 2
        along = (tracker.radial + tracker.radial_per_m * distance) ** 2
        outer = beam @ beam.T / distance**2
        parts.append(across * (ca.SX.eye(3) - outer) + along * outer)
    return ca.diagcat(*parts, turns)


def _whitened(covariance: SX, rows: SX) -> SX:
    """``L^-1 rows`` with ``covariance = L L'``."""
    return ca.solve(ca.chol(covariance).T, rows)
