"""The true robot of the blind tests: kinematics, statics and everything that can be wrong with it.

Nothing here comes from the packages under test. Units are SI and rad. A `World` is one robot, its tracker and all its
faults (zero by default); `respond` says what the tracker reads. Deflections are of first order: torques on the
undeflected arm, small rotations applied by the Jacobian, as in the default model of a study
(``equilibrium = "linear"``).

Shapes: P visits, L readings (loads) of each, N = P L shots, M markers.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tests.blind.arm import Arm, bodies, cross, place_frames, point_of, rotation

HOUR = 3600.0
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Conditions:
    """What is set and known for every shot.

    Joints q (P, 6); load (P, L), the index of its load; mass (K,) and attach (K, 3) of the loads; time and temperature
    (P, L); approach (P, 6); wrench (P, L, 6) measured in the flange frame, or None; jitter of the joints (P, L, 6).
    """

    q: np.ndarray
    load: np.ndarray
    mass: np.ndarray
    attach: np.ndarray
    time: np.ndarray
    temperature: np.ndarray
    approach: np.ndarray
    wrench: np.ndarray | None = None
    jitter: np.ndarray | float = 0.0


@dataclass(frozen=True, eq=False)
class World:
    """One robot, its surroundings and their faults."""

    arm: Arm
    marker: np.ndarray  # (M, 3) true positions in the flange frame
    tracker: np.ndarray  # (4, 4) tracker in the base frame
    compliance: np.ndarray = field(default_factory=partial(np.zeros, 6))  # rad/Nm
    frame: np.ndarray = field(
        default_factory=partial(np.zeros, 6)
    )  # small displacement of the tracker's readings, m and rad
    spring: np.ndarray = field(
        default_factory=partial(np.zeros, (8, 6, 6))
    )  # base, column, ends of links 1 ... 6; moved by a force and moment there
    cross: np.ndarray = field(default_factory=partial(np.zeros, (6, 6)))  # rad/Nm between joints
    hardening: np.ndarray = field(
        default_factory=partial(np.zeros, 6)
    )  # share of the compliance lost at the reference torque
    windup: np.ndarray = field(default_factory=partial(np.zeros, 6))  # rad
    knee: np.ndarray = field(default_factory=lambda: np.full(6, 300.0))  # Nm
    backlash: np.ndarray = field(default_factory=partial(np.zeros, 6))  # rad
    friction: np.ndarray = field(default_factory=partial(np.zeros, 6))  # Nm
    friction_share: np.ndarray = field(default_factory=lambda: np.ones(6))
    hysteresis: np.ndarray = field(default_factory=partial(np.zeros, 6))  # rad
    eccentric: np.ndarray = field(
        default_factory=partial(np.zeros, (6, 3, 2))
    )  # rad: joint, order 1 ... 3, sine and cosine
    coupling: np.ndarray = field(default_factory=partial(np.zeros, 3))  # rad/rad: 5 -> 6, 4 -> 5, 4 -> 6
    balance: float = 0.0  # N/m, spring beside joint 2
    balance_shape: tuple = (0.69, 0.18, 0.17, 0.45)  # distance, radius, angle, free length
    balance_torque: np.ndarray = field(default_factory=partial(np.zeros, 4))  # Nm: sin q2, cos q2, sin 2 q2, cos 2 q2
    balance_rate: np.ndarray = field(default_factory=partial(np.zeros, 2))  # share of compliance: cos q2, sin q2
    load_shift: np.ndarray = field(default_factory=partial(np.zeros, 3))  # m, flange frame
    load_factor: np.ndarray = field(default_factory=partial(np.zeros, 4))
    gravity_tilt: np.ndarray = field(default_factory=partial(np.zeros, 2))  # rad about world x and y
    bias: np.ndarray = field(default_factory=partial(np.zeros, 6))  # N, Nm: the sensor says true + bias
    growth: np.ndarray = field(default_factory=partial(np.zeros, 7))  # 1/K of each link
    warm_angle: np.ndarray = field(default_factory=partial(np.zeros, 6))  # rad/K
    drift: np.ndarray = field(default_factory=partial(np.zeros, 6))  # m/h, rad/h
    step: np.ndarray = field(default_factory=partial(np.zeros, 6))
    step_time: float = 0.0
    scale: float = 0.0
    seating: np.ndarray = field(default_factory=partial(np.zeros, (3, 3)))  # m, flange frame
    hose: float = 0.0  # N/m
    hose_ends: tuple = ((-0.4, 0.25, 0.9), (0.3, 0.15, 0.2), 0.9)  # base-side point (link 1), link 4 point, free length
    ripple: float = 0.0  # compliance of joint 3 ~ sin 3 q3
    softening: float = 0.0  # compliance grows per K
    wave: float = 0.0  # rad, joint 3, by sin 2 q2 cos 3 q3
    sway: np.ndarray = field(default_factory=partial(np.zeros, 3))  # m, tracker to and fro
    sway_period: float = 1500.0


def respond(world: World, given: Conditions, *, base_frame: bool = False) -> np.ndarray:
    """(P, L, M, 3) what the tracker reads without its own noise (in the robot's base frame if asked)."""
    shots = given.load.size
    warm = (given.temperature - 20.0).reshape(shots)
    q = _joint_angles(world, given, warm)
    frames = place_frames(world.arm, q, 1.0 + warm[:, None] * world.growth)
    force, moment, point = _hung(world, given, frames)
    gravity = _gravity(world)
    carried, centres = bodies(world.arm, frames)
    loads = _moments(frames.origin, point, force, moment)
    t_load = np.einsum("nji,nji->nj", frames.axis, loads)
    t_own = _own_torque(frames, carried, centres, gravity)
    turn = _joint_turns(world, q, warm, frames, t_load, t_own)
    spots = point_of(frames.flange, world.marker)  # (N, M, 3)
    moved = np.einsum("nj,nmji->nmi", turn, cross(frames.axis[:, None], spots[:, :, None] - frames.origin[:, None]))
    moved = moved + _bending(world, frames, spots, (force, moment, point), (carried, centres, gravity))
    loaded = (given.load.ravel() > 0)[:, None, None]
    moved = moved + loaded * np.einsum("nab,mb->nma", frames.flange[:, :3, :3], world.seating)
    read = spots + moved
    if not base_frame:
        read = _through_tracker(world, given, read)
    return read.reshape(*given.load.shape, len(world.marker), 3)


def _joint_angles(world, given, warm):
    """(N, 6) where the joints really stand before anything yields."""
    visits, readings = given.load.shape
    q = np.repeat(given.q, readings, axis=0)
    jitter = np.broadcast_to(given.jitter, (visits, readings, 6)).reshape(-1, 6)
    order = np.arange(1, 4)
    angle = q[:, :, None] * order
    wrong = np.einsum("njk,jk->nj", np.sin(angle), world.eccentric[:, :, 0])
    wrong = wrong + np.einsum("njk,jk->nj", np.cos(angle), world.eccentric[:, :, 1])
    wrong = wrong + np.repeat(given.approach, readings, axis=0) * world.hysteresis + warm[:, None] * world.warm_angle
    wrong[:, 5] += world.coupling[0] * q[:, 4] + world.coupling[2] * q[:, 3]
    wrong[:, 4] += world.coupling[1] * q[:, 3]
    wrong[:, 2] += world.wave * np.sin(2 * q[:, 1]) * np.cos(3 * q[:, 2])
    return q + jitter + wrong


def _gravity(world):
    """(3,) m/s^2; base and world frame are one."""
    tilt = rotation(np.array([*world.gravity_tilt, 0.0]))
    return tilt @ (-9.80665 * UP)


def _hung(world, given, frames):
    """Force, moment (N, 3) of the load and the point where they act, base frame."""
    load = given.load.ravel()
    local = given.attach[load] + world.load_shift
    point = point_of(frames.flange, local[:, None])[:, 0]
    factor = (1.0 + world.load_factor)[load][:, None]
    if given.wrench is None:
        return factor * given.mass[load][:, None] * _gravity(world), np.zeros_like(point), point
    true = given.wrench.reshape(-1, 6) - (load > 0)[:, None] * world.bias
    turn = frames.flange[:, :3, :3]
    return (
        factor * np.einsum("nab,nb->na", turn, true[:, :3]),
        factor * np.einsum("nab,nb->na", turn, true[:, 3:]),
        point,
    )


def _moments(origin, point, force, moment):
    """(N, s, 3) moment of one wrench about several points."""
    return cross(point[:, None] - origin, force[:, None]) + moment[:, None]


def _own_torque(frames, carried, centres, gravity):
    """(N, 6) torque of all bodies that a joint carries."""
    lever = centres[:, None] - frames.origin[:, :, None]  # (N, joint, body, 3)
    torque = np.einsum("nji,njbi->njb", frames.axis, cross(lever, gravity)) * carried
    return np.where(np.arange(len(carried)) >= np.arange(6)[:, None], torque, 0.0).sum(axis=2)


def _joint_turns(world, q, warm, frames, t_load, t_own):
    """(N, 6) how far each joint yields."""
    torque = t_load + t_own + _hose_torque(world, frames)
    c = world.compliance * (1.0 + world.softening * warm[:, None])
    c[:, 2] *= 1.0 + world.ripple * np.sin(3 * q[:, 2])
    c[:, 1] *= 1.0 + world.balance_rate @ np.array([np.cos(q[:, 1]), np.sin(q[:, 1])])
    harmonics = np.array([f(k * q[:, 1]) for k in (1, 2) for f in (np.sin, np.cos)])
    pull, rate = _balance(world, q[:, 1])
    reference = 2500.0 * np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
    share = (torque / reference) ** 2
    plain = torque.copy()
    plain[:, 1] -= pull + world.balance_torque @ harmonics
    turn = c * plain
    turn[:, 1] /= 1.0 + c[:, 1] * rate
    turn = turn - world.hardening * c * torque * share / (1.0 + 0.3 * share)
    turn = turn + world.windup * np.arctan(0.5 * np.pi * torque / world.knee) * 2.0 / np.pi
    turn = turn + world.backlash * np.sign(torque) + torque @ world.cross
    held = np.sign(world.friction) * np.clip(t_load, -np.abs(world.friction), np.abs(world.friction))
    return turn - c * world.friction_share * held


def _balance(world, q2):
    """Torque dU/dq2 and stiffness d2U/dq2^2 of the spring beside joint 2."""
    a, radius, angle, free = world.balance_shape
    phase = angle - q2
    length = np.sqrt(a**2 + radius**2 + 2 * a * radius * np.cos(phase))
    pull = world.balance * (1 - free / length) * a * radius * np.sin(phase)
    lever = a * radius * np.sin(phase) / length  # d length / d q2
    bend = (a * radius * -np.cos(phase) - lever**2) / length
    return pull, world.balance * (lever**2 + (length - free) * bend)


def _hose_torque(world, frames):
    """(N, 6) torque of an elastic hose from the column to the forearm."""
    if not world.hose:
        return 0.0
    near, far, free = world.hose_ends
    start = point_of(frames.moved[:, 0], np.array([near]))[:, 0]
    end = point_of(frames.moved[:, 3], np.array([far]))[:, 0]
    along = start - end
    length = np.linalg.norm(along, axis=1, keepdims=True)
    force = world.hose * (length - free) * along / length
    torque = np.einsum("nji,nji->nj", frames.axis, cross(end[:, None] - frames.origin, force[:, None]))
    return torque * np.array([0.0, 1.0, 1.0, 1.0, 0.0, 0.0])


def _bending(world, frames, spots, load, own):
    """(N, M, 3) motion of the markers by the springs of base, column and link ends."""
    force, moment, point = load
    carried, centres, gravity = own
    total = np.zeros_like(spots)
    for index in np.flatnonzero(world.spring.any(axis=(1, 2))):
        first = max(index - 1, 0)  # bodies from here on are carried
        origin, turn = frames.spring_origin[:, index], frames.spring_turn[:, index]
        weight = carried[first:, None] * gravity
        here = cross(centres[:, first:] - origin[:, None], weight).sum(axis=1) + cross(point - origin, force) + moment
        local = np.concatenate(
            [
                np.einsum("nba,nb->na", turn, force + weight.sum(axis=0)),
                np.einsum("nba,nb->na", turn, here),
            ],
            axis=1,
        )
        yielded = local @ world.spring[index].T
        shift = np.einsum("nab,nb->na", turn, yielded[:, :3])
        angle = np.einsum("nab,nb->na", turn, yielded[:, 3:])
        total += shift[:, None] + cross(angle[:, None], spots - origin[:, None])
    return total


def _through_tracker(world, given, points):
    """Readings of base-frame points (N, M, 3) in the tracker's own frame."""
    turn, origin = world.tracker[:3, :3], world.tracker[:3, 3]
    seen = (points - origin) @ turn
    time = given.time.reshape(-1, 1)
    motion = world.frame + world.drift * time / HOUR + world.step * (time > world.step_time)
    seen = seen + motion[:, None, :3] + cross(motion[:, None, 3:], seen)
    seen = seen + np.sin(2 * np.pi * time / world.sway_period)[:, None] * world.sway
    return (1.0 + world.scale) * seen
