"""Drawing of hidden causes: place, sign, phase and shape at random; the size follows from how well it is to show."""

import numpy as np

from tests.blind import faults
from tests.blind.faults import Fault, bump, spring_beside, springs, step_at, tube
from tests.blind.setting import Setting


def draw(rng, name: str, setting: Setting, times) -> Fault:
    """A fault of a given name (a cause of the library, or ``outside:...``).

    Args:
        rng: Generator.
        name: What is wrong.
        setting: The healthy robot.
        times: (P, L) of the readings, s.
    """
    sign = rng.choice([-1.0, 1.0])
    maker = _MAKERS.get(name)
    if maker is not None:
        return maker(rng, setting, times, sign)
    joint, field, typical, positive, largest = _on_joint(rng, name)
    return Fault(name, f"j{joint + 1}", (bump(field, joint, typical),), np.array([1.0 if positive else sign]), largest)


def _on_joint(rng, name):
    table = {
        "joint_hardening": ((1, 2, 3, 4, 5), "hardening", 0.1, True, 9.0),
        "backlash": ((2, 3, 4, 5), "backlash", 5e-5, True, 10.0),
        "stiction": ((1, 2, 3, 4, 5), "friction", 50.0, True, 40.0),
        "approach_hysteresis": ((0, 1, 2, 3, 4, 5), "hysteresis", 5e-5, False, 6.0),
    }
    joints, field, typical, positive, largest = table[name]
    joint = int(rng.choice(joints))
    return joint, field, typical, positive, largest


def _link(rng, setting, times, sign):
    link = int(rng.choice([2, 3]))
    kind = rng.choice(["tube", "bend", "twist"], p=[0.7, 0.2, 0.1])
    length = setting.world.arm.offset[link, 0]
    shares = rng.uniform(0.5, 1.5, 3)
    shares *= {"tube": 1.0, "bend": np.array([1.0, 1.0, 0.05]), "twist": np.array([0.05, 0.05, 1.0])}[kind]
    return Fault("link_compliance", f"link{link}", (tube(link + 1, length, shares),), np.ones(1))


def _compensator(rng, setting, times, sign):
    shape = (rng.uniform(0.55, 0.8), rng.uniform(0.15, 0.2), rng.uniform(-0.4, 0.4), rng.uniform(0.35, 0.45))
    return Fault("gravity_compensator", "j2", (spring_beside(shape),), np.ones(1))


def _base(rng, setting, times, sign):
    place = int(rng.integers(2))
    handles = springs(place, [(3, 3), (4, 4)])
    return Fault("base_compliance", ("base", "column")[place], tuple(handles), rng.uniform(0.1, 0.5, 2))


def _tool(rng, setting, times, sign):
    return Fault("tool_compliance", "flange", tuple(springs(7, [(4, 4), (5, 5)])), rng.uniform(1, 4, 2), 10.0)


def _cross(rng, setting, times, sign):
    a = int(rng.choice([1, 2, 3, 4]))
    handles = (bump("cross", (a, a + 1), 2e-7), bump("cross", (a + 1, a), 2e-7))
    return Fault("joint_cross_compliance", f"j{a + 1}-j{a + 2}", handles, sign * np.ones(2), 8.0)


def _windup(rng, setting, times, sign):
    joint = int(rng.choice([1, 2, 3, 4, 5]))
    knee = rng.uniform(200, 900) if joint < 3 else rng.uniform(50, 180)
    return Fault("joint_windup", f"j{joint + 1}", (faults.knee_at(joint, knee),), np.ones(1), 10.0)


def _transmission(rng, setting, times, sign, joint=None):
    joint = int(rng.integers(6)) if joint is None else joint
    phase, share = rng.uniform(0, 2 * np.pi, 2), np.array([1.0, 0.0])
    share = {0: share, 1: share[::-1], 2: rng.uniform(0.3, 1.0, 2)}[int(rng.integers(3))]
    handles = tuple(bump("eccentric", (joint, n, k), 1e-4) for n in range(2) for k in range(2))
    weights = np.array([share[n] * f(phase[n]) for n in range(2) for f in (np.sin, np.cos)])
    return Fault("transmission_error", f"j{joint + 1}", handles, weights, 3.5)


def _wrist(rng, setting, times, sign):
    weights = rng.normal(size=3) * (rng.permutation(3) < rng.integers(1, 4))
    where = None
    return Fault("wrist_coupling", where, tuple(bump("coupling", k, 3e-4) for k in range(3)), weights)


def _geometry(rng, setting, times, sign):
    joint = int(rng.integers(1, 6))
    weights = rng.normal(size=6) * (rng.permutation(6) < rng.integers(1, 5))
    return Fault("geometry", f"j{joint + 1}", tuple(bump("arm.shift", (joint, k), 3e-4) for k in range(6)), weights)


def _mass(rng, setting, times, sign):
    link = int(rng.integers(2, 7))
    return Fault("link_mass", f"link{link}", tuple(faults.mass_handles(setting.world, link)), _some(rng, 4), 8.0)


def _some(rng, count):
    """Random weights; either all, or the first alone."""
    weights = rng.normal(size=count)
    return weights if rng.random() < 0.6 else np.eye(count)[0] * rng.choice([-1.0, 1.0])


def _com(rng, setting, times, sign):
    return Fault("load_com", None, tuple(bump("load_shift", k, 0.02) for k in range(3)), rng.normal(size=3), 10.0)


def _level(rng, setting, times, sign):
    level = int(rng.integers(1, len(setting.design.levels)))
    return Fault("load_level", f"L{level}", (bump("load_factor", level, 0.02),), sign * np.ones(1), 15.0)


def _scale(rng, setting, times, sign):
    return Fault("load_scale", None, (bump("load_factor", slice(1, None), 0.02),), sign * np.ones(1), 15.0)


def _direction(rng, setting, times, sign):
    return Fault(
        "load_direction", None, tuple(bump("gravity_tilt", k, 0.01) for k in range(2)), rng.normal(size=2), 6.0
    )


def _bias(rng, setting, times, sign):
    handles = tuple(bump("bias", k, 10.0 if k < 3 else 2.0) for k in range(6))
    return Fault("force_sensor_bias", None, handles, rng.normal(size=6), 12.0)


def _thermal(rng, setting, times, sign):
    grow = tuple(bump("growth", k, 1e-5) for k in range(1, 7))
    angle = tuple(bump("warm_angle", j, 1e-5) for j in (1, 2))
    even = np.full(6, rng.uniform(0.8, 2.0))
    return Fault("thermal_growth", None, grow + angle, np.concatenate([even, rng.normal(0, 0.5, 2)]))


def _drift(rng, setting, times, sign):
    handles = tuple(bump("drift", k, 5e-5 if k < 3 else 1.5e-5) for k in range(6))
    return Fault("tracker_drift", None, handles, rng.normal(size=6))


def _step(rng, setting, times, sign):
    time = float(np.quantile(times, rng.uniform(0.15, 0.85)))
    handles = tuple(step_at(time, k, 8e-5 if k < 3 else 2e-5) for k in range(6))
    return Fault("tracker_step", None, handles, rng.normal(size=6))


def _tracker_scale(rng, setting, times, sign):
    return Fault("tracker_scale", None, (bump("scale", (), 1e-5),), sign * np.ones(1), 60.0)


def _seating(rng, setting, times, sign):
    marker = int(rng.integers(3))
    handles = tuple(bump("seating", (marker, k), 3e-5) for k in range(3))
    return Fault("marker_seating", f"M{marker + 1}", handles, rng.normal(size=3), 20.0)


def _outside(field, typical, index=(), largest=200.0):
    def make(rng, setting, times, sign):
        weights = np.array([1.0 if field in {"hose", "softening"} else sign])
        return Fault(f"outside:{field}", None, (bump(field, index, typical),), weights, largest)

    return make


def _sway(rng, setting, times, sign):
    handles = tuple(bump("sway", k, 5e-5) for k in range(3))
    return Fault("outside:sway", None, handles, rng.normal(size=3), 100.0)


_MAKERS = {
    "link_compliance": _link,
    "gravity_compensator": _compensator,
    "base_compliance": _base,
    "tool_compliance": _tool,
    "joint_cross_compliance": _cross,
    "joint_windup": _windup,
    "transmission_error": _transmission,
    "wrist_coupling": _wrist,
    "geometry": _geometry,
    "link_mass": _mass,
    "load_com": _com,
    "load_level": _level,
    "load_scale": _scale,
    "load_direction": _direction,
    "force_sensor_bias": _bias,
    "thermal_growth": _thermal,
    "tracker_drift": _drift,
    "tracker_step": _step,
    "tracker_scale": _tracker_scale,
    "marker_seating": _seating,
    "outside:hose": _outside("hose", 200.0),
    "outside:ripple": _outside("ripple", 0.05, largest=8.0),
    "outside:softening": _outside("softening", 0.01, largest=12.0),
    "outside:wave": _outside("wave", 5e-5),
    "outside:sway": _sway,
}
EFFECTS = (
    *(name for name in _MAKERS if not name.startswith("outside")),
    *("joint_hardening", "backlash", "stiction", "approach_hysteresis"),
)
OUTSIDE = tuple(name for name in _MAKERS if name.startswith("outside"))
