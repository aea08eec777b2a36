"""Equilibrium of the loaded arm: deflections that agree with the torques on the deflected geometry.

``theta = C t(theta)``, C the compliances of all pairs of springs, t the torque of load and self-weight. Newton's step
solves ``(1 - C H) d = C t - theta`` with ``H = dt/dtheta``. Where C can be inverted this is the stiffness ``K - H`` of
the conservative congruence transformation, with the complementary stiffness H, the change of the Jacobian under a
constant load (Chen and Kao, Int. J. Robot. Res. 19(9), 835-847, 2000); springs without compliance are no trouble here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import Effect, Fields, Scene, SpringSet
from identify.elastic_chain import chain_index, deflect
from identify.errors import NoConvergence
from identify.experiment import Experiment
from identify.kinematics import Frames
from identify.robot import Robot
from identify.rotations import rotation_vectors
from identify.springs import Springs, carried, cross, load_torque, motion, self_weight_torque
from identify.units import SI_OF

__all__ = ["TOLERANCE", "LoadedScene", "load_scene", "spring_matrix"]

TOLERANCE = 1e-12  # rad or m
_MAX_STEPS = 30
_CHUNK = 512  # shots at once
_WILD = 1.0  # rad or m: no arm yields that much and stands


@dataclass(frozen=True, eq=False)
class LoadedScene(Scene):
    """A scene in equilibrium. Its fields of springs are exact there: a compliance moves markers by motion times torque.

    Attributes:
        moved: (R, 3) displacement of the markers by all springs, m (of turns: rotation vectors, rad).
        exact: Fields of each set of springs on the deflected arm. ``motion`` is how a marker moves if a spring yields
            by one unit more and all others follow, ``D (1 - C H)^-1``.
        iterations: Newton steps taken.
    """

    moved: Floats
    exact: Mapping[SpringSet, Fields]
    iterations: int

    def fields(self, springs: SpringSet) -> Fields:
        """Fields of a named set of springs."""
        return self.exact[springs]

    def torque(self, springs: SpringSet) -> Floats:
        """(S, s) the torques of a named set of springs."""
        return self.exact[springs].torque

    def moved_by(self, springs: SpringSet, compliance: Floats) -> Floats:
        """(R, 3) motion of the markers, m, where springs of ``compliance`` (s, s), SI, yield and all others follow."""
        fields = self.exact[springs]
        yielded = fields.torque @ compliance.T
        moved: Floats = np.einsum("rsi,rs->ri", fields.motion, yielded[self.experiment.row_shot])
        return moved


@dataclass(frozen=True, eq=False)
class _Load:
    """What acts on the flange in S shots.

    Attributes:
        attach: (S, 3) point, flange frame, m.
        force: (S, 3) fixed in the base frame, N.
        moment: (S, 3) fixed in the base frame, Nm.
        turning_force: (S, 3) fixed in the flange frame, N.
        turning_moment: (S, 3) fixed in the flange frame, Nm.
    """

    attach: Floats
    force: Floats
    moment: Floats
    turning_force: Floats
    turning_moment: Floats

    def part(self, shots: slice) -> _Load:
        """The load of some shots."""
        return _Load(*(array[shots] for array in vars(self).values()))


@dataclass(frozen=True, eq=False)
class _State:
    """Torques and their derivatives at some deflections of S shots.

    Attributes:
        frames: The deflected frames.
        springs: The deflected axes.
        torque: (S, a) Nm or N.
        slope: (S, a, a) ``H[s, r]``: change of torque s with deflection r.
    """

    frames: Frames
    springs: Springs
    torque: Floats
    slope: Floats


def spring_matrix(effects: Iterable[tuple[Effect, Floats]], joints: int) -> tuple[Floats, Ints]:
    """Compliances of all pairs of springs.

    Args:
        effects: Effects with their values, in their units.
        joints: Number of joints.

    Returns:
        (a, a) rad/Nm, m/N and mixed, and the (a,) coordinates that any pair names, see `identify.elastic_chain`.
    """
    matrix = np.zeros((7 * joints + 12,) * 2)
    named = np.zeros(len(matrix), dtype=bool)
    for effect, values in effects:
        if effect.springs is None:
            continue
        where = chain_index(joints, effect.springs)
        pairs = [*zip(effect.terms, values.tolist(), strict=False), *effect.held]
        for term, value in pairs:
            first, second = where[term.first], where[term.second]
            named[[first, second]] = True
            matrix[first, second] += value * SI_OF[term.unit]
            if term.mutual and first != second:
                matrix[second, first] += value * SI_OF[term.unit]
    active = np.flatnonzero(named)
    return matrix[np.ix_(active, active)], active


def load_scene(scene: Scene, compliance: Floats, active: Ints, *, tolerance: float = TOLERANCE) -> LoadedScene:
    """Let the springs of a scene yield until they are in equilibrium.

    Args:
        scene: The undeflected scene.
        compliance: (a, a), see `spring_matrix`.
        active: (a,) coordinates.
        tolerance: Largest difference of a deflection to what its torque demands, rad or m.

    Raises:
        NoConvergence: The arm finds no equilibrium.
    """
    experiment, robot = scene.experiment, scene.frames.robot
    load, q = _loads(experiment, robot), experiment.q[experiment.shot_pose]
    shots = len(q)
    points = np.empty((shots, len(experiment.markers.names) + 1, 3))
    moves = np.empty((*points.shape[:2], len(active), 3))
    torque = np.empty((shots, len(active)))
    iterations = 0
    for start in range(0, shots, _CHUNK):
        part = slice(start, start + _CHUNK)
        state, steps = _settle(scene, load.part(part), q[part], compliance, active, tolerance)
        points[part, :-1], torque[part] = _points(scene, state.frames), state.torque
        points[part, -1] = _turn(scene, state.frames, experiment.shot_pose[part])
        moves[part] = _following(scene, state, points[part, :-1], compliance)
        iterations = max(iterations, steps)
    rows, marker = experiment.row_shot, np.where(scene.turning, -1, experiment.row_marker)
    exact = _sets(robot.n, active, moves[rows, marker], torque)
    moved = points[rows, marker] - np.where(scene.turning[:, None], 0.0, scene.point)
    return LoadedScene(experiment, scene.frames, scene.marker, scene.self_weight, moved, exact, iterations)


def _settle(
    scene: Scene, load: _Load, q: Floats, compliance: Floats, active: Ints, tolerance: float
) -> tuple[_State, int]:
    """Newton's iteration for some shots; the state and the number of steps."""
    theta = np.zeros((len(q), len(active)))
    for steps in range(_MAX_STEPS):
        state = _state(scene, load, q, theta, active)
        gap = state.torque @ compliance.T - theta
        if np.abs(gap).max(initial=0.0) < tolerance:
            return state, steps
        theta = theta + np.linalg.solve(np.eye(len(active)) - compliance @ state.slope, gap[..., None])[..., 0]
        if not np.abs(theta).max() < _WILD:
            break
    raise NoConvergence(
        f"the loaded arm {scene.frames.robot.name} finds no equilibrium: it would yield by "
        f'{np.abs(theta).max():.3g} rad (or m); check the compliances, or use equilibrium = "linear"',
        theta,
    )


def _state(scene: Scene, load: _Load, q: Floats, theta: Floats, active: Ints) -> _State:
    """Torques and their slopes at some deflections."""
    robot = scene.frames.robot
    frames, springs = deflect(robot, q, theta, active)
    point = frames.point(load.attach)
    follow, twist = (
        np.einsum("sij,sj->si", frames.flange_rotation, v) for v in (load.turning_force, load.turning_moment)
    )
    force, moment = load.force + follow, load.moment + twist
    torque = load_torque(springs, point, force, moment)
    turning = np.where(springs.slides[:, None], 0.0, springs.axis)
    lever = motion(springs, point[:, None])[:, 0]
    fixed = _swung(lever, turning, load.force) + _swung(turning, turning, load.moment)
    turned = _swung(lever, turning, follow) + _swung(turning, turning, twist)
    pushed = _swung(lever, turning, force).swapaxes(1, 2)
    if scene.self_weight:
        torque = torque + self_weight_torque(springs, frames)
        weight, arm = carried(springs, frames)
        swung = np.where(springs.slides[:, None], weight[:, None] * springs.axis, cross(springs.axis, arm))
        hung = _swung(swung, turning, np.broadcast_to(robot.gravity_base, point.shape))
        fixed, pushed = fixed + hung, pushed + hung.swapaxes(1, 2)
    distal = np.tri(len(active), dtype=bool).T
    return _State(frames, springs, torque, np.where(distal, turned - pushed, -fixed))


def _swung(lever: Floats, axis: Floats, vector: Floats) -> Floats:
    """``lever_s . (axis_r x v)``: what each lever feels of a vector that turns about each axis, (S, a, a)."""
    turned = cross(axis, vector[:, None])
    felt: Floats = lever @ turned.swapaxes(1, 2)
    return felt


def _loads(experiment: Experiment, robot: Robot) -> _Load:
    """What acts on the flange in every shot."""
    index = experiment.shot_load
    attach = np.array([load.attach for load in experiment.loads])[index]
    world = robot.world_R_base
    if experiment.wrench is not None:
        fixed = np.zeros(len(index), bool) if experiment.wrench_in_world is None else experiment.wrench_in_world
        return _split(attach, experiment.wrench[:, :3], experiment.wrench[:, 3:], ~fixed[:, None], world)
    turning = np.array([load.in_flange for load in experiment.loads])[index, None]
    force, moment = (np.array([getattr(load, key) for load in experiment.loads])[index] for key in ("force", "moment"))
    weight = np.array([load.mass for load in experiment.loads])[index, None] * robot.gravity_base
    load = _split(attach, force, moment, turning, world)
    return replace(load, force=load.force + weight)


def _split(attach: Floats, force: Floats, moment: Floats, turning: np.ndarray, world: Floats) -> _Load:
    """Wrenches that turn with the flange where ``turning`` (S, 1) says so; the others are world vectors."""
    return _Load(
        attach,
        np.where(turning, 0.0, force @ world),
        np.where(turning, 0.0, moment @ world),
        np.where(turning, force, 0.0),
        np.where(turning, moment, 0.0),
    )


def _points(scene: Scene, frames: Frames) -> Floats:
    """(S, M, 3) markers on the deflected flange; those on the base stand where they were."""
    rigid = scene.marker[0]
    flange = scene.frames
    local = (rigid - flange.flange_origin[0]) @ flange.flange_rotation[0]
    points: Floats = frames.flange_origin[:, None] + local @ frames.flange_rotation.swapaxes(1, 2)
    points[:, scene.experiment.markers.on_base] = rigid[scene.experiment.markers.on_base]
    return points


def _turn(scene: Scene, frames: Frames, pose: Ints) -> Floats:
    """(S, 3) how the flange is turned against the undeflected one, rad; zero where no row asks for it."""
    if scene.experiment.row_turns is None:
        return np.zeros_like(frames.flange_origin)
    return rotation_vectors(frames.flange_rotation @ scene.frames.flange_rotation[pose].swapaxes(1, 2))


def _following(scene: Scene, state: _State, points: Floats, compliance: Floats) -> Floats:
    """``D (1 - C H)^-1`` of markers (S, M, 3), then of the turn of the flange, (S, M + 1, a, 3)."""
    springs = state.springs
    direct = motion(springs, points)
    direct[:, scene.experiment.markers.on_base] = 0.0
    turning = np.where(springs.slides[:, None], 0.0, springs.axis)
    direct = np.concatenate([direct, turning[:, None]], axis=1)
    count, markers, active, _ = direct.shape
    rows = direct.transpose(0, 2, 1, 3).reshape(count, active, 3 * markers)
    system = np.eye(active) - (compliance @ state.slope).swapaxes(1, 2)
    followed = np.linalg.solve(system, rows).reshape(count, active, markers, 3)
    return np.asarray(followed.transpose(0, 2, 1, 3))


def _sets(n: int, active: Ints, moves: Floats, torque: Floats) -> dict[SpringSet, Fields]:
    """The fields of the active coordinates, put where each set of springs looks for them; zero elsewhere."""
    slot = np.full(7 * n + 12, -1, dtype=np.int64)
    slot[active] = np.arange(len(active))
    found: dict[SpringSet, Fields] = {}
    names: tuple[SpringSet, ...] = ("joints", "links", "base")
    for name in names:
        index = slot[chain_index(n, name)]
        known = index >= 0
        motions, torques = np.zeros((len(moves), len(index), 3)), np.zeros((len(torque), len(index)))
        motions[:, known], torques[:, known] = moves[:, index[known]], torque[:, index[known]]
        found[name] = Fields(motions, torques)
    return found
