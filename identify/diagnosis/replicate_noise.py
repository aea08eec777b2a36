"""Sizes of the noise from replicates alone, which no missing cause can swell.

Readings of the same thing differ by noise only. With a free mean of every cell of replicates the whitened residual of
visits that share cells is projected off these means, and the sizes of the parts of the noise follow from what is left,
as in `identify.diagnosis.spread`. Repeats within a visit tell the instrument's part and the jitter between readings;
visits of the same joint values tell the jitter between visits too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.diagnosis.replicates import cells_of, clusters
from identify.diagnosis.spread import NoiseFound, noise_parts, sizes_of
from identify.fit import Fit
from identify.study import Noise
from identify.tails import chi2_sf

__all__ = ["ReplicateNoise", "replicate_noise"]

_LEAST = 40  # degrees of freedom; fewer tell a standard deviation to no better than 11 %
_LARGEST = 600  # rows of visits that hang together by common cells
_SEEN = 10.0  # of Fisher's information about a share of variance: less says nothing about it


@dataclass(frozen=True, eq=False)
class ReplicateNoise:
    """The noise of replicates.

    Attributes:
        sizes: As multiples of the stated ones; 1 for parts that these replicates do not show.
        dof: Degrees of freedom within the cells.
        p_value: Probability of scatter so far from the stated noise, either way, if that is right.
    """

    sizes: NoiseFound
    dof: int
    p_value: float


def replicate_noise(found: Fit, noise: Noise) -> ReplicateNoise | None:
    """Estimate the noise from replicates; None where there are too few.

    Args:
        found: A fit with weights of one, by any model.
        noise: The noise it was made with.
    """
    by_row = _by_first_row(found, noise)
    parts, total, dof = [], 0.0, 0
    for cluster in clusters(found, cells_of(found.data.experiment)):
        if len(cluster.residual) > _LARGEST:
            continue
        rest = np.linalg.qr(cluster.means, mode="complete")[0][:, np.linalg.matrix_rank(cluster.means) :]
        if rest.shape[1]:
            error = rest.T @ cluster.residual
            parts.append((error[None], (rest.T @ _stacked([by_row[row] for row in cluster.first_rows]) @ rest)[None]))
            total, dof = total + float(error @ error), dof + len(error)
    if dof < _LEAST or total <= 1e-9 * dof:
        return None
    seen = np.array([sum(float((part[0, a] ** 2).sum()) for _, part in parts) for a in range(3)]) > _SEEN
    lower = float(chi2_sf(total, dof))
    return ReplicateNoise(sizes_of(parts, seen, 1.0), dof, 2.0 * min(lower, 1.0 - lower))


def _by_first_row(found: Fit, noise: Noise) -> dict[int, Floats]:
    """The three whitened covariances (3, k, k) of each visit, by the number of its first row."""
    made: dict[int, Floats] = {}
    for (index, _), (_, covariances) in zip(found.whitening.groups, noise_parts(found, noise), strict=True):
        made.update(zip(index[:, 0].tolist(), covariances, strict=True))
    return made


def _stacked(blocks: list[Floats]) -> Floats:
    """Covariances (3, k_i, k_i) of independent visits as (3, K, K)."""
    size = sum(block.shape[1] for block in blocks)
    total, start = np.zeros((3, size, size)), 0
    for block in blocks:
        own = slice(start, start + block.shape[1])
        total[:, own, own] = block
        start = own.stop
    return total
