"""A healthy random robot, where it stands and what is to be measured."""

from dataclasses import dataclass

import numpy as np

from tests.blind.arm import Arm, place_frames, point_of, rigid, rotation
from tests.blind.physics import Conditions, World

MARKERS = ("M1", "M2", "M3")
GRAVITY = 9.80665
LOWER = np.array([-185.0, -140.0, -120.0, -350.0, -122.5, -350.0])
UPPER = np.array([185.0, -5.0, 155.0, 350.0, 122.5, 350.0])


@dataclass(frozen=True)
class Noise:
    """What the readings scatter by: m, rad; law of the tracker's spread over range (m, m/m) if given."""

    reading: float = 30e-6
    pose: float = 12e-6
    shot: float = 1.5e-6
    tails: bool = False
    marker: tuple = (1.0, 1.0, 1.0)
    law: tuple | None = None

    def spread(self, distance):
        """(..., M) standard deviation of one coordinate."""
        plain = self.reading if self.law is None else self.law[0] + self.law[1] * distance
        return plain * np.array(self.marker) + 0.0 * distance


@dataclass(frozen=True, eq=False)
class Design:
    """What is measured: levels (N), readings of a visit (indices into the levels), columns of the file."""

    poses: int = 30
    levels: tuple = (0.0, 500.0, 1400.0, 2500.0)
    repeats: int = 1
    free: bool = False
    time: bool = True
    temperature: bool = True
    approach: bool = True
    one_way: bool = False

    @property
    def loads(self):
        return tuple(f"L{k}" for k in range(len(self.levels)))


@dataclass(frozen=True, eq=False)
class Setting:
    """Healthy truth, nominal arm and markers, joint limits (6,) deg, the loads and the climate."""

    world: World
    nominal_marker: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    design: Design
    attach: np.ndarray
    climate: tuple  # rise, time constant, wander, start


def random_setting(rng, design: Design, *, far: bool = True) -> Setting:
    """Draw a robot of KR-270 size, its true markers and a tracker a few metres off."""
    arm, lower, upper = _arm(rng)
    nominal = np.array([[0.05, 0.0, 0.16], [0.09, 0.15, -0.08], [0.02, -0.15, -0.06]]) + rng.uniform(
        -0.03, 0.03, (3, 3)
    )
    nominal = nominal.round(4)
    away = rng.uniform(3.5, 5.5) if far else rng.uniform(2.2, 2.8)
    turn = rotation([0.0, 0.0, rng.uniform(-3, 3)]) @ rotation(rng.normal(0, 0.02, 3))
    place = rotation([0.0, 0.0, rng.uniform(-1.2, 1.2)]) @ [away, 0.0, rng.uniform(0.8, 1.6)]
    world = World(
        arm,
        nominal + rng.uniform(-1e-3, 1e-3, (3, 3)),
        rigid(turn, place),
        compliance=_compliance(rng),
        load_factor=np.zeros(len(design.levels)),
    )
    hook = np.array([0.2, 0.05, -0.25]) + rng.uniform(-0.1, 0.1, 3)
    hook = hook.round(3)
    wander = 0.3 if design.temperature else 0.0
    start = rng.uniform(19.0, 21.0) if design.temperature else 20.0
    climate = (rng.uniform(3.0, 8.0), rng.uniform(2400.0, 7000.0), wander, start)
    return Setting(world, nominal, lower, upper, design, np.tile(hook, (len(design.levels), 1)), climate)


def _arm(rng):
    lengths = np.array([675.0, 350, 1150, 1200, -41, 240]) * 1e-3 * rng.uniform(0.93, 1.07, 6)
    base, reach, upper, fore, drop, hand = lengths.round(3)
    offset = np.array([[0, 0, base], [reach, 0, 0], [upper, 0, 0], [fore, 0, drop], [0, 0, 0], [0, 0, 0], [hand, 0, 0]])
    sign = np.where(rng.random(6) < 0.25, -1.0, 1.0)
    sign[[1, 2, 4]] = 1.0
    axis = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], float) * sign[:, None]
    mass = (np.array([330.0, 260, 190, 45, 38, 12]) * rng.uniform(0.8, 1.2, 6)).round(1)
    centre = np.array([
        [0.2, 0, -0.15],
        [0.5, 0.1, 0],
        [0.25, -0.05, 0.05],
        [-0.3, 0, 0],
        [0.02, 0, 0.01],
        [0.15, 0, 0],
    ])
    centre = (centre + rng.uniform(-0.04, 0.04, (6, 3))).round(3)
    tool = 0.0 if rng.random() < 0.6 else round(rng.uniform(4, 12), 1)
    arm = Arm(offset, axis, mass, centre, tool, np.array([0.06, 0.0, 0.0]))
    flip = sign < 0
    return arm, np.where(flip, -UPPER, LOWER), np.where(flip, -LOWER, UPPER)


def _compliance(rng):
    """(6,) rad/Nm between the published sets of heavy arms; joint 1 counts only where something turns it."""
    low = np.array([0.2, 0.15, 0.25, 1.8, 1.5, 2.0]) * 1e-6
    high = np.array([0.45, 0.32, 0.42, 3.0, 3.3, 2.8]) * 1e-6
    value = low * (high / low) ** rng.random(6)
    if rng.random() < 0.3:
        value[0] = 0.0
    return value


def random_poses(rng, setting: Setting, count: int) -> np.ndarray:
    """(count, 6) rad: inside the limits, hook and arm above the floor and outside the column."""
    found = np.zeros((0, 6))
    while len(found) < count:
        q = np.radians((setting.lower + 3 + rng.random((400, 6)) * (setting.upper - setting.lower - 6)).round(3))
        frames = place_frames(setting.world.arm, q, np.ones((400, 7)))
        spots = np.concatenate([setting.attach[:1], setting.nominal_marker, np.zeros((1, 3))])
        low = np.concatenate([point_of(frames.flange, spots)[:, :, 2], frames.origin[:, 3:, 2]], axis=1).min(axis=1)
        out = np.hypot(*point_of(frames.flange, spots)[:, :, :2].transpose(2, 0, 1)).min(axis=1)
        found = np.concatenate([found, q[(low > 0.35) & (out > 0.75)]])
    return found[:count]


def conditions(rng, setting: Setting, q: np.ndarray, *, start: float = 0.0, times=None, load=None) -> Conditions:
    """Measure visits q (P, 6) one after the other, from a time on (or at stated times), all levels at each."""
    design = setting.design
    levels = len(design.levels)
    load = np.tile(np.tile(np.arange(levels), design.repeats), (len(q), 1)) if load is None else load
    if times is None:
        visit = start + np.cumsum(rng.uniform(220.0, 300.0, len(q))) - 200.0
        times = visit[:, None] + 40.0 * np.arange(load.shape[1]) * 4 / max(4, load.shape[1])
    approach = np.ones((len(q), 6)) if design.one_way else rng.choice([-1.0, 1.0], (len(q), 6))
    wrench = _wrenches(rng, setting, load) if design.free else None
    mass = np.array(design.levels) / GRAVITY
    return Conditions(q, load, mass.round(3), setting.attach, times, climate(setting, times), approach, wrench)


def climate(setting, time):
    """Temperature at a time (degC), as the file will say."""
    rise, constant, wander, start = setting.climate
    return start + rise * (1 - np.exp(-time / constant)) + wander * np.sin(time / 900.0)


def _wrenches(rng, setting, load):
    """(P, L, 6) what the force sensor says: any direction, the size of the level, some moment."""
    direction = rng.normal(size=(*load.shape, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    size = np.array(setting.design.levels)[load][..., None]
    return np.concatenate([size * direction, 0.03 * size * rng.normal(size=(*load.shape, 3))], axis=-1).round(3)
