"""The physical faults that a simulation may lack: how each is drawn, and in which directions it can go.

A *handle* changes a world by a multiple of a typical size. A `Fault` is a set of handles with drawn weights; its
size is chosen later. `rivals` lists the handles of every kind of fault at every place.
"""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from tests.blind.setting import Setting

SOFTNESS = np.array([1.0, 1.0, 1.0, 6.0, 6.0, 6.0])  # wrist joints are that much softer


@dataclass(frozen=True, eq=False)
class Fault:
    """A hidden cause: name and place, handles with weights, largest plausible multiple of the typical size."""

    name: str
    where: str | None
    handles: tuple
    weights: np.ndarray
    largest: float = 30.0

    def apply(self, world, size):
        """The world with this fault."""
        for handle, weight in zip(self.handles, self.weights, strict=True):
            world = handle(world, size * weight)
        return world


def bump(name, index, typical):
    """Handle that adds to one number of a world (or of its arm: ``arm.mass``)."""

    def apply(world, size):
        owner = world.arm if name.startswith("arm.") else world
        field = name.removeprefix("arm.")
        value = np.array(getattr(owner, field), dtype=float)
        value[index] += size * typical
        changed = replace(owner, **{field: value})
        return replace(world, arm=changed) if owner is not world else changed

    return apply


def base_handles():
    """What every study fits: six compliances, the frame, the markers."""
    handles = [bump("compliance", j, 1e-7 * SOFTNESS[j]) for j in range(6)]
    handles += [bump("frame", k, 1e-4) for k in range(6)]
    return handles + [bump("marker", (m, k), 1e-4) for m in range(3) for k in range(3)]


def springs(index, entries):
    """Handles for elements (a, b) of one 6x6 spring, symmetric; um/N and urad/Nm as typical."""
    return [_symmetric(index, a, b) for a, b in entries]


def _symmetric(index, a, b):
    typical = 1e-7 if a > 2 and b > 2 else 1e-7 if a > 2 or b > 2 else 2e-7

    def apply(world, size):
        value = world.spring.copy()
        value[index, a, b] += size * typical
        if a != b:
            value[index, b, a] += size * typical
        return replace(world, spring=value)

    return apply


BEAM = [(k, k) for k in range(6)] + [(1, 5), (2, 4)]


def tube(index, length, shares):
    """Handle of a bending and twisting tube whose axis is x: an Euler-Bernoulli beam clamped at its near end.

    Args:
        index: Which spring.
        length: m.
        shares: Bending in the plane y, in z, twist (urad/Nm over the whole length, in units of 0.1).
    """
    matrix = np.zeros((6, 6))
    for turn, slide, sign, share in ((5, 1, 1.0, shares[0]), (4, 2, -1.0, shares[1])):
        matrix[turn, turn] = share
        matrix[slide, slide] = share * length**2 / 3
        matrix[slide, turn] = matrix[turn, slide] = sign * share * length / 2
    matrix[3, 3] = 1.3 * shares[2]
    matrix[0, 0] = 0.01 * np.mean(shares)

    def apply(world, size):
        value = world.spring.copy()
        value[index] += 1e-7 * size * matrix
        return replace(world, spring=value)

    return apply


def knee_at(joint, knee):
    """Handle of a soft range near zero torque with a given knee."""

    def apply(world, size):
        knees = world.knee.copy()
        knees[joint] = knee
        amount = world.windup.copy()
        amount[joint] += 1e-4 * size
        return replace(world, knee=knees, windup=amount)

    return apply


def spring_beside(shape):
    """Handle of a real spring beside joint 2 with given geometry; typical 10 N/mm."""
    return lambda world, size: replace(world, balance=world.balance + 1e4 * size, balance_shape=shape)


def step_at(time, index, typical):
    """Handle of a knock at a given time."""
    plain = bump("step", index, typical)
    return lambda world, size: replace(plain(world, size), step_time=time)


def rivals(setting: Setting, times) -> list[tuple[str, str | None, list]]:
    """Name, place and handles of every kind of fault of the library (grids where one is nonlinear).

    Args:
        setting: The healthy robot.
        times: (P, L) when its readings are taken.
    """
    design, world = setting.design, setting.world
    c = world.compliance
    named = [(f"j{j + 1}", j) for j in range(6)]
    found = [("link_compliance", f"link{k}", springs(k + 1, BEAM)) for k in (1, 2, 3, 4, 5)]
    found += [("base_compliance", w, springs(k, [(3, 3), (4, 4)])) for k, w in enumerate(("base", "column"))]
    found += [("tool_compliance", "flange", springs(7, [(4, 4), (5, 5)]))]
    pairs = [(a, a + 1) for a in range(5)]
    found += [("joint_cross_compliance", f"j{a + 1}-j{b + 1}", [_cross(a, b)]) for a, b in pairs]
    balance = [bump("balance_torque", k, 100.0) for k in range(4)] + [bump("balance_rate", k, 0.01) for k in range(2)]
    found += [("gravity_compensator", "j2", balance)]
    found += [("joint_hardening", w, [bump("hardening", j, 0.1)]) for w, j in named if c[j]]
    knees = {j: np.geomspace(*((150.0, 6000.0) if j < 3 else (30.0, 1500.0)), 10) for j in range(6)}
    found += [("joint_windup", w, [knee_at(j, knee)]) for w, j in named for knee in knees[j]]
    found += [("backlash", w, [bump("backlash", j, 1e-4)]) for w, j in named]
    found += [("approach_hysteresis", w, [bump("hysteresis", j, 5e-5)]) for w, j in named if design.approach]
    turns = [(n, k) for n in range(2) for k in range(2)]
    found += [("transmission_error", w, [bump("eccentric", (j, *t), 1e-4) for t in turns]) for w, j in named]
    found += [("wrist_coupling", None, [bump("coupling", k, 3e-4) for k in range(3)])]
    shifts = {j: [bump("arm.shift", (j, k), 3e-4) for k in range(6)] for j in range(1, 6)}
    found += [("geometry", f"j{j + 1}", shifts[j]) for j in shifts] + [("geometry", None, [*chain(*shifts.values())])]
    found += [("link_mass", f"link{k}", mass_handles(world, k)) for k in range(2, 7)]
    if not design.free:
        found += [("load_direction", None, [bump("gravity_tilt", k, 0.01) for k in range(2)])]
    else:
        found += [("force_sensor_bias", None, [bump("bias", k, 10.0 if k < 3 else 2.0) for k in range(6)])]
    levels = range(1, len(design.levels))
    found += [("load_com", None, [bump("load_shift", k, 0.02) for k in range(3)])]
    found += [("load_level", f"L{k}", [bump("load_factor", k, 0.03)]) for k in levels]
    found += [("load_scale", None, [bump("load_factor", slice(1, None), 0.02)])]
    found += [("marker_seating", f"M{m + 1}", [bump("seating", (m, k), 3e-5) for k in range(3)]) for m in range(3)]
    found += [("tracker_scale", None, [bump("scale", (), 1e-5)])]
    found += [("thermal_growth", None, _warm_handles())] if design.temperature or design.time else []
    if design.time:
        found += [("tracker_drift", None, [bump("drift", k, 5e-5 if k < 3 else 1e-5) for k in range(6)])]
        moments = np.quantile(times, np.linspace(0.1, 0.9, 9))
        steps = [[step_at(t, k, 1e-4 if k < 3 else 3e-5) for k in range(6)] for t in moments]
        found += [("tracker_step", None, handles) for handles in steps]
    stuck = np.geomspace(10.0, 600.0, 8)
    found += [("stiction", w, [_stuck(j, f * (1 if j > 2 else 4))]) for w, j in named for f in stuck]
    return found


def _cross(a, b):
    one, other = bump("cross", (a, b), 2e-7), bump("cross", (b, a), 2e-7)
    return lambda world, size: other(one(world, size), size)


def _stuck(joint, level):
    """Handle of the friction term at a fixed level: linear in size, of the shape of a clipped torque."""

    def apply(world, size):
        friction, share = world.friction.copy(), world.friction_share.copy()
        friction[joint], share[joint] = level, size
        return replace(world, friction=friction, friction_share=share)

    return apply


def mass_handles(world, link):
    mass = world.arm.mass[link - 1]
    return [bump("arm.mass", link - 1, 0.1 * mass)] + [bump("arm.centre", (link - 1, k), 0.03) for k in range(3)]


def _warm_handles():
    grow = [bump("growth", k, 1e-5) for k in range(1, 7)]
    return grow + [bump("warm_angle", j, 1e-5) for j in (1, 2)]
