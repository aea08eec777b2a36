"""Covariance of readings and the whitening that follows from it.

Readings of one visit share its pose jitter, readings of one shot its reading jitter:

    V = diag(B_row) + sum_shots J L_reading J' + J L_pose J'

with B the instrument's 3x3 covariance and J the marker's joint Jacobian. A whitening operator N of
a visit satisfies ``N V N' = I``; with free offsets (reference ``differences``) it also annihilates
every displacement that the rows of one marker share, so that only changes between loads are left.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import Scene
from identify.experiment import Experiment
from identify.study import Noise

__all__ = ["Whitening", "instrument_covariance", "joined", "reading_covariance", "whitening"]

_NEGLIGIBLE = 1e-10  # a column that the free offsets cancel to this share is zero
_MANY, _SMALL = 64, 48  # matrices, and their size, from where one by one is slower
_CACHE = 1 << 16  # numbers that stay at hand


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening operators of all visits, in groups of equal layout.

    Attributes:
        groups: (G, m) rows of G visits with m rows each, and their operators (G, k, 3 m).
        cancels: True if the operators annihilate offsets.
    """

    groups: tuple[tuple[Ints, Floats], ...]
    cancels: bool

    def apply(self, rows: Floats) -> Floats:
        """Whiten (R, 3) residuals or (R, 3, p) columns -> (K,) or (K, p), visits in the order of groups."""
        blocks = [block.reshape(block.shape[0] * block.shape[1], *rows.shape[2:]) for block in self.blocks(rows)]
        shape = (0, *rows.shape[2:])
        return np.concatenate(blocks) if blocks else np.zeros(shape)

    def blocks(self, rows: Floats) -> Iterator[Floats]:
        """The same by groups: (G, k) or (G, k, p)."""
        for index, operator in self.groups:
            together = index.size and index[-1, -1] - index[0, 0] == index.size - 1  # a view, not a copy
            chosen = rows[index[0, 0] : index[-1, -1] + 1] if together else rows[index]
            taken = chosen.reshape(len(index), 3 * index.shape[1], -1)
            block = operator @ taken
            if self.cancels:
                size, given = np.einsum("gkp,gkp->p", block, block), np.einsum("gkp,gkp->p", taken, taken)
                scale = np.einsum("gkm,gkm->", operator, operator) / max(len(index), 1)
                block[:, :, size <= _NEGLIGIBLE**2 * scale * given] = 0.0
            yield block.reshape(len(index), operator.shape[1], *rows.shape[2:])

    @property
    def size(self) -> int:
        """Number K of whitened rows."""
        return sum(len(index) * operator.shape[1] for index, operator in self.groups)

    def split(self, whitened: Floats) -> Iterator[Floats]:
        """Whitened rows (K, c) visit by visit: (G, k, c) for each group that has any."""
        start = 0
        for index, operator in self.groups:
            count, size = len(index), operator.shape[1]
            if size:
                yield whitened[start : start + count * size].reshape(count, size, -1)
            start += count * size

    @cached_property
    def precisions(self) -> tuple[Floats, ...]:
        """By groups, (G, m, 3, 3): the block of ``N'N`` that belongs to each row, 1/m^2."""
        return tuple(_row_blocks(operator) for _, operator in self.groups)

    def visits(self, experiment: Experiment) -> Ints:
        """(K,) visit of each whitened row."""
        parts = [np.repeat(experiment.row_visit[index[:, 0]], operator.shape[1]) for index, operator in self.groups]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def _row_blocks(operator: Floats) -> Floats:
    """Diagonal blocks (G, m, 3, 3) of ``N'N``."""
    count, rows, size = operator.shape
    split = operator.reshape(count, rows, size // 3, 3).transpose(0, 2, 3, 1)
    blocks: Floats = split @ split.swapaxes(2, 3)
    return blocks


def joined(parts: Sequence[Whitening], starts: Sequence[int]) -> Whitening:
    """One whitening of rows that were whitened in parts.

    Args:
        parts: The whitening of each part.
        starts: First row of each part.
    """
    groups = [
        (index + start, operator) for part, start in zip(parts, starts, strict=True) for index, operator in part.groups
    ]
    return Whitening(tuple(groups), any(part.cancels for part in parts))


def instrument_covariance(noise: Noise, points: Floats, station: Floats) -> Floats:
    """Covariance of one reading of each point, (R, 3, 3), m^2, base frame.

    For a tracker ``s_t^2 (I - u u') + s_r^2 u u'`` with u the beam direction and ``s = a + b range``.

    Args:
        noise: The noise.
        points: (R, 3) base frame, m.
        station: (3,) the instrument in the base frame, m.
    """
    tracker = noise.tracker
    if tracker is None:
        return np.broadcast_to(noise.reading**2 * np.eye(3), (len(points), 3, 3))
    beam = points - station
    distance = np.linalg.norm(beam, axis=1)
    unit = beam / np.maximum(distance, 1e-9)[:, None]
    across = (tracker.transverse + tracker.transverse_per_m * distance) ** 2
    along = (tracker.radial + tracker.radial_per_m * distance) ** 2
    outer = unit[:, :, None] * unit[:, None, :]
    covariance: Floats = across[:, None, None] * (np.eye(3) - outer) + along[:, None, None] * outer
    return covariance


def reading_covariance(noise: Noise, experiment: Experiment, points: Floats, station: Floats) -> Floats:
    """Covariance of the instrument in each row of an experiment, (R, 3, 3), m^2, or rad^2 where a turn is read.

    Args:
        noise: The noise.
        experiment: The rows.
        points: (R, 3) base frame, m.
        station: (3,) the instrument in the base frame, m.
    """
    covariance = instrument_covariance(noise, points, station)
    if experiment.row_turns is None:
        return covariance
    return np.where(experiment.row_turns[:, None, None], noise.orientation**2 * np.eye(3), covariance)


def whitening(
    scene: Scene, noise: Noise, station: Floats, *, free_offsets: bool, weights: Floats | None = None
) -> Whitening:
    """Operators for the rows of a scene.

    Args:
        scene: The rows with their Jacobians.
        noise: The stated noise.
        station: (3,) the instrument in the base frame, m.
        free_offsets: Cancel what the rows of one visit and marker share.
        weights: (R,) in (0, 1]; the instrument's covariance of a row is divided by its weight.
    """
    experiment = scene.experiment
    weights = np.ones(len(scene.point)) if weights is None else weights
    covariance = reading_covariance(noise, scene.experiment, scene.point, station) / weights[:, None, None]
    groups = []
    for rows, layout in _layouts(experiment):
        plain = (weights[rows] == 1.0).all(axis=1)
        if not _is_balanced(experiment, rows, layout):
            plain[:] = False
        for chosen, build in ((plain, _balanced_operator), (~plain, _general_operator)):
            if chosen.any():
                part = rows[chosen]
                groups.append((part, build(scene, noise, covariance, part, layout, free_offsets=free_offsets)))
    return Whitening(tuple(groups), free_offsets)


def _layouts(experiment: Experiment) -> Iterator[tuple[Ints, Ints]]:
    """Visits grouped by layout: rows (G, m) and the local shot and what is read in each of the m rows, (m, 2)."""
    visit = experiment.row_visit
    channel = experiment.row_channel
    starts = np.flatnonzero(np.diff(visit, prepend=-1))
    sizes = np.diff(starts, append=len(visit))
    for size in np.unique(sizes):
        rows = starts[sizes == size][:, None] + np.arange(size)
        shot = experiment.row_shot[rows]
        local = np.cumsum(np.diff(shot, axis=1, prepend=shot[:, :1]) != 0, axis=1)
        keys = np.concatenate([local, channel[rows]], axis=1)
        if (keys == keys[0]).all():
            yield rows, keys[0].reshape(2, size).T
            continue
        kinds, member = np.unique(keys, axis=0, return_inverse=True)
        for kind, key in enumerate(kinds):
            yield rows[member.ravel() == kind], key.reshape(2, size).T


def _is_balanced(experiment: Experiment, rows: Ints, layout: Ints) -> bool:
    """True if every shot reads the same markers at the same joint values."""
    shots = layout[-1, 0] + 1
    if len(layout) % shots:
        return False
    markers = layout[:, 1].reshape(shots, -1)
    pose = experiment.shot_pose[experiment.row_shot[rows]]
    return bool((markers == markers[0]).all() and (pose == pose[:, :1]).all())


def _balanced_operator(
    scene: Scene, noise: Noise, covariance: Floats, rows: Ints, layout: Ints, *, free_offsets: bool
) -> Floats:
    """Equal shots: contrasts over the shots have covariance B, their scaled mean has B + L J L_pose J'."""
    shots = int(layout[-1, 0]) + 1
    first = rows[:, : rows.shape[1] // shots]
    shared = _shared(scene, first)
    spread = _block_diagonal(covariance[first]) + noise.reading_jitter**2 * shared
    inner = _inverse_root(spread)
    contrasts = _helmert(shots)
    parts = [_kron(contrasts[1:], inner)]
    if not free_offsets:
        outer = _inverse_root(spread + shots * noise.pose_jitter**2 * shared)
        parts.append(_kron(contrasts[:1], outer))
    return np.concatenate(parts, axis=1)


def _general_operator(
    scene: Scene, noise: Noise, covariance: Floats, rows: Ints, layout: Ints, *, free_offsets: bool
) -> Floats:
    """Any layout: Cholesky of the whole covariance, then the complement of the whitened offsets."""
    shared = _shared(scene, rows)
    same_shot = np.kron(layout[:, :1] == layout[:, 0], np.ones((3, 3)))
    total = _block_diagonal(covariance[rows]) + (noise.reading_jitter**2 * same_shot + noise.pose_jitter**2) * shared
    operator = _inverse_root(total)
    if not free_offsets:
        return operator
    kinds = np.unique(layout[:, 1])
    offsets = np.kron(layout[:, 1:] == kinds, np.eye(3))
    complement = np.linalg.qr(operator @ offsets, mode="complete")[0][:, :, offsets.shape[1] :]
    whitened: Floats = complement.swapaxes(1, 2) @ operator
    return whitened


def _shared(scene: Scene, rows: Ints) -> Floats:
    """``J J'`` of the rows' markers, (G, 3 m, 3 m), m^2 per rad^2."""
    jacobian = scene.joints.motion[rows].swapaxes(2, 3).reshape(len(rows), 3 * rows.shape[1], -1)
    product: Floats = jacobian @ jacobian.swapaxes(1, 2)
    return product


def _inverse_root(covariance: Floats) -> Floats:
    """Inverses of the Cholesky factors of (G, m, m), by forward substitution in many at once."""
    lower = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    count, size = lower.shape[:2]
    if count < _MANY or size > _SMALL:
        return np.asarray(np.linalg.inv(lower))
    inverse = np.empty_like(lower)
    chunk = max(_MANY, _CACHE // size**2)
    for start in range(0, count, chunk):
        inverse[start : start + chunk] = _inverse_lower(lower[start : start + chunk])
    return inverse


def _inverse_lower(lower: Floats) -> Floats:
    """Inverses of lower triangles (G, m, m), row by row."""
    size = lower.shape[1]
    lower, inverse = np.ascontiguousarray(lower.transpose(1, 2, 0)), np.zeros((size, size, len(lower)))
    for row in range(size):
        inverse[row, row] = 1.0 / lower[row, row]
        known = np.einsum("kg,kjg->jg", lower[row, :row], inverse[:row, :row])
        np.multiply(known, -inverse[row, row], out=inverse[row, :row])
    return inverse.transpose(2, 0, 1)


def _block_diagonal(blocks: Floats) -> Floats:
    """(G, m, 3, 3) -> (G, 3 m, 3 m)."""
    count, size = blocks.shape[:2]
    full = np.zeros((count, size, 3, size, 3))
    index = np.arange(size)
    full[:, index, :, index] = blocks.swapaxes(0, 1)
    return full.reshape(count, 3 * size, 3 * size)


def _helmert(size: int) -> Floats:
    """Orthonormal rows: the scaled mean, then contrasts."""
    from scipy.linalg import helmert

    matrix: Floats = np.vstack([np.full((1, size), size**-0.5), helmert(size)])
    return matrix


def _kron(left: Floats, right: Floats) -> Floats:
    """Kronecker products of one (r, s) matrix with many (G, m, m): (G, r m, s m)."""
    product: Floats = np.einsum("rs,gij->grisj", left, right)
    return product.reshape(len(right), left.shape[0] * right.shape[1], left.shape[1] * right.shape[2])
