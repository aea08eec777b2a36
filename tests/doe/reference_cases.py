"""Reference problems of the design engine: a heavy six-axis arm with three markers, made here from DH numbers.

Case a (p = 6): joint compliances; every third candidate is pulled horizontally, the others carry 250 kg.
Case b (p = 26): joint and beam-like link compliances under gravity alone, reduced to independent columns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import qr

from doe.ascent import Region
from doe.continuous import Sample
from identify.arrays import Floats, Ints

__all__ = ["continuous_case", "reference_case"]

DH = np.array(  # a (m), alpha (deg), d (m), offset (deg); an arm of the 270 kg class
    [
        [0.35, -90.0, 0.675, 0.0],
        [1.15, 0.0, 0.0, -90.0],
        [-0.041, -90.0, 0.0, 0.0],
        [0.0, 90.0, 1.2, 0.0],
        [0.0, -90.0, 0.0, 0.0],
        [0.0, 0.0, 0.215, 0.0],
    ]
)
LIMITS = np.deg2rad([[-150, 150], [-50, 75], [-120, 60], [-180, 180], [-115, 115], [-180, 180]])
FRONT = np.deg2rad([[-30, 30], [-20, 50], [-90, 10], [-90, 90], [-90, 90], [-180, 180]])
MARKERS = np.array([[0.12, 0.0, 0.05], [-0.06, 0.10, 0.05], [-0.06, -0.10, 0.05]])
LOAD_POINTS = np.array([[0.0, 0.0, 0.20], [0.25, 0.0, 0.20], [0.0, 0.25, 0.35]])
TOOL = np.array([0.0, 0.0, 0.30])
WEIGHT, PULL, PROCESS = 250 * 9.81, 1000.0, 800.0  # N
SIGMA_MM = 0.03
LOWEST = 0.1  # m, of the tool
JOINT_SCALE = np.array([0.4, 0.3, 0.4, 2.8, 3.0, 2.5]) * 1e-6  # rad/Nm, the unit of each joint parameter
LINK_SCALE = 1e-9 * np.array([10.0, 10.0, 10.0, 100.0, 100.0, 100.0, 30.0, 30.0])  # m/N, rad/Nm, coupling
PAIRS = ((0, 0), (1, 1), (2, 2), (3, 3), (4, 4), (5, 5), (1, 5), (2, 4))  # a beam: six springs, two couplings


def frames(q: Floats) -> Floats:
    """Link frames (V, 7, 4, 4) of joint angles (V, 6), base first."""
    placements = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
    for (a, alpha, d, offset), angle in zip(DH, q.T, strict=True):
        c, s = np.cos(angle + np.deg2rad(offset)), np.sin(angle + np.deg2rad(offset))
        ca, sa = np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
        zero, one = np.zeros_like(c), np.ones_like(c)
        rows = [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [zero, sa * one, ca * one, d * one],
            [zero, zero, zero, one],
        ]
        placements.append(placements[-1] @ np.stack([np.stack(row, -1) for row in rows], -2))
    return np.stack(placements, 1)


def point(placements: Floats, local: Floats) -> Floats:
    """Points of the flange in the base frame."""
    return placements[:, 6, :3, :3] @ local + placements[:, 6, :3, 3]


def columns(axis: Floats, origin: Floats, at: Floats) -> Floats:
    """Motion (V, 3, s) of the points ``at`` (V, 3) by rotations about ``axis`` (V, s, 3) through ``origin``."""
    return np.cross(axis, at[:, None] - origin).swapaxes(1, 2)


def joint_rows(placements: Floats, at: Floats, load_at: Floats, force: Floats) -> Floats:
    """Rows (V, 3, 6) in mm per unit of the joint parameters."""
    axis, origin = placements[:, :6, :3, 2], placements[:, :6, :3, 3]
    torque = np.einsum("vij,vi->vj", columns(axis, origin, load_at), force)
    return 1e3 * columns(axis, origin, at) * (torque * JOINT_SCALE)[:, None]


def link_rows(placements: Floats, at: Floats, load_at: Floats, force: Floats) -> Floats:
    """Rows (V, 3, 48) in mm per unit of the link parameters, springs at the end of each link."""
    parts = []
    for link in range(1, 7):
        axis = placements[:, link, :3, :3].swapaxes(1, 2)
        origin = np.repeat(placements[:, link, None, :3, 3], 3, 1)
        move = np.concatenate([axis.swapaxes(1, 2), columns(axis, origin, at)], 2)
        feel = np.einsum("vij,vi->vj", np.concatenate([axis.swapaxes(1, 2), columns(axis, origin, load_at)], 2), force)
        for (i, j), unit in zip(PAIRS, LINK_SCALE, strict=True):
            column = move[:, :, i] * feel[:, None, j]
            parts.append(1e3 * unit * (column if i == j else column + move[:, :, j] * feel[:, None, i]))
    return np.stack(parts, 2)


def rows(placements: Floats, at: Floats, load_at: Floats, force: Floats, case: str) -> Floats:
    """Rows of one point, all parameters of the case."""
    joints = joint_rows(placements, at, load_at, force)
    return joints if case == "a" else np.concatenate([joints, link_rows(placements, at, load_at, force)], 2)


def candidates(count: int, case: str, rng: np.random.Generator) -> Floats:
    """Whitened blocks (count, 9, 6 or 54) of random poses above the floor."""
    q = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (4 * count, 6))
    q = q[point(frames(q), TOOL)[:, 2] > LOWEST][:count]
    placements = frames(q)
    load_at = point(placements, np.zeros(3)) + np.einsum(
        "vij,vj->vi", placements[:, 6, :3, :3], LOAD_POINTS[rng.integers(3, size=count)]
    )
    force = np.zeros((count, 3))
    force[:, 2] = -WEIGHT
    if case == "a":
        pulled, turn = np.arange(count) % 3 == 0, rng.uniform(0, 2 * np.pi, count)
        force[pulled] = PULL * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)[pulled]
    parts = [rows(placements, point(placements, marker), load_at, force, case) for marker in MARKERS]
    return np.concatenate(parts, 1) / SIGMA_MM


def tests(count: int, case: str, rng: np.random.Generator) -> Floats:
    """Test rows (3 count, 6 or 54) divided by sqrt(count)."""
    placements = frames(rng.uniform(FRONT[:, 0], FRONT[:, 1], (count, 6)))
    direction = rng.normal(size=(count, 3))
    force = PROCESS * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    at = point(placements, TOOL)
    parts = rows(placements, at, at, force, case)
    return parts.reshape(3 * count, -1) / np.sqrt(count)


def reference_case(
    count: int, p: int = 6, test_poses: int = 20, seed: int = 0, candidate_seed: int | None = None
) -> tuple[Floats, Floats]:
    """Blocks (count, 9, p) and target (3 test_poses, p) of case a (p = 6) or b (p = 26)."""
    case = {6: "a", 26: "b"}[p]
    rng = np.random.default_rng(seed if candidate_seed is None else candidate_seed)
    target = tests(test_poses, case, np.random.default_rng(1000 + seed))
    blocks = candidates(count, case, rng)
    if case == "b":
        sample = candidates(300, case, np.random.default_rng(7)).reshape(-1, 54)
        kept = np.sort(qr(sample, mode="r", pivoting=True)[1][:p])
        blocks, target = np.ascontiguousarray(blocks[..., kept]), target[:, kept]
    return blocks, target


def continuous_case(p: int = 6, seed: int = 0) -> tuple[Region, Callable[[int], Sample], Floats]:
    """Case a (p = 6) or b (p = 26) over all poses: its region, candidates drawn of it by number, and its target.

    In case a the direction of the horizontal pull varies continuously too, as a seventh variable; choices 0 to 2 are
    the points where the weight hangs, 3 to 5 those where the arm is pulled (case a only).
    """
    case = {6: "a", 26: "b"}[p]
    kept = np.arange(6)
    if case == "b":
        sample = candidates(300, case, np.random.default_rng(7)).reshape(-1, 54)
        kept = np.sort(qr(sample, mode="r", pivoting=True)[1][:p])

    def blocks(x: Floats, choice: Ints) -> Floats:
        placements = frames(x[:, :6])
        turned = np.einsum("vij,vj->vi", placements[:, 6, :3, :3], LOAD_POINTS[choice % 3])
        load_at = point(placements, np.zeros(3)) + turned
        pull = PULL * np.stack([np.cos(x[:, -1]), np.sin(x[:, -1]), 0 * x[:, -1]], 1)
        force = np.where((choice >= 3)[:, None], pull, [0.0, 0.0, -WEIGHT])
        parts = [rows(placements, point(placements, marker), load_at, force, case) for marker in MARKERS]
        return np.concatenate(parts, 1)[..., kept] / SIGMA_MM

    def excess(x: Floats, choice: Ints) -> Floats:
        return np.maximum(LOWEST - point(frames(x[:, :6]), TOOL)[:, 2], 0.0)

    limits = np.vstack([LIMITS, [[-np.pi, np.pi]]]) if case == "a" else LIMITS
    region = Region(blocks, excess, limits[:, 0], limits[:, 1], np.ones(len(limits)))

    def drawn(count: int) -> Sample:
        rng = np.random.default_rng(seed)
        x = rng.uniform(limits[:, 0], limits[:, 1], (4 * count, len(limits)))
        x = x[excess(x, np.zeros(len(x))) <= 0.0][:count]
        choice = rng.integers(3, size=count)
        if case == "a":
            choice[::3] += 3
        return Sample(x, choice, blocks(x, choice))

    target = tests(20, case, np.random.default_rng(1000 + seed))[:, kept]
    return region, drawn, target
