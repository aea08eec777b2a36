"""Lack of fit against replicates: is the residual larger than readings of the same thing scatter among themselves?

Rows of the same joint values, load and marker should agree but for noise, whatever the model says. With a free mean of
each such cell the whitened residual splits into scatter within the cells and the rest, which only a better model can
lower (Draper and Smith, Applied Regression Analysis, 1998, sec. 2.2):

    F = ((chi2 - chi2_within) / (dof - dof_within)) / (chi2_within / dof_within)

A noise that is stated too small or too large by one factor cancels in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.experiment import Experiment
from identify.fit import Fit
from identify.row_groups import classes
from identify.tails import f_sf

__all__ = ["Cluster", "Replicates", "cells_of", "clusters", "replicates"]

_SAME = 1e-6  # rad, m, N or Nm: values this close are the same
_SMALL = 1e-9


@dataclass(frozen=True)
class Replicates:
    """Scatter of replicates and what it says about a fit.

    Attributes:
        readings: Number of rows that have a replicate.
        chi2: Whitened sum of squares within the cells.
        dof: Its degrees of freedom.
        std: Standard deviation of one coordinate within the cells, m.
        ratio: Variance of the rest of the residual by that within the cells (F).
        p_value: Probability of a ratio this large if the model is right.
    """

    readings: int
    chi2: float
    dof: int
    std: float
    ratio: float
    p_value: float


def replicates(found: Fit) -> Replicates | None:
    """Compare the residual of a fit with the scatter of replicates; None without any, or if they are mere copies.

    Readings count as replicates if joint values, approach, load (or measured wrench) and marker agree. What changes
    with time between two visits of one pose is scatter here.

    Args:
        found: A fit with weights of one.
    """
    cell = cells_of(found.data.experiment)
    count = np.bincount(cell)
    repeated = count[cell] > 1
    if not repeated.any():
        return None
    chi2, dof = 0.0, 0
    for cluster in clusters(found, cell):
        residual = cluster.residual
        left, values, _ = np.linalg.svd(cluster.means, full_matrices=False)
        basis = left[:, values > _SMALL * values.max(initial=0.0)]
        chi2 += float(residual @ residual - ((basis.T @ residual) ** 2).sum())
        dof += len(residual) - basis.shape[1]
    if dof < 1 or found.dof <= dof or chi2 <= _SMALL * found.chi2:  # copies of a reading tell nothing
        return None
    ratio = max(found.chi2 - chi2, 0.0) / (found.dof - dof) / (chi2 / dof)
    p_value = f_sf(ratio, found.dof - dof, dof)
    return Replicates(int(repeated.sum()), chi2, dof, _scatter(found.residual, cell, count), ratio, p_value)


@dataclass(frozen=True, eq=False)
class Cluster:
    """Visits that hang together by common cells, or that repeat some.

    Attributes:
        residual: (k,) whitened residual.
        means: (k, 3 c) whitened columns of a free mean for each of c cells.
        first_rows: First row of each visit, in their order.
    """

    residual: Floats
    means: Floats
    first_rows: tuple[int, ...]


def cells_of(experiment: Experiment) -> Ints:
    """(R,) number of what each row reads."""
    shot = experiment.row_shot
    keys = [*(experiment.q[experiment.shot_pose[shot]] / _SAME).round().T, experiment.shot_load[shot]]
    if experiment.approach is not None:
        keys += list(experiment.approach[experiment.row_visit].T)
    if experiment.wrench is not None:
        keys += list((experiment.wrench[shot] / _SAME).round().T)
    return classes(*keys, experiment.row_marker)


def clusters(found: Fit, cell: Ints) -> Iterator[Cluster]:
    """The clusters of a fit's visits by the (R,) cells of its rows."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    visit = found.data.experiment.row_visit
    size = int(visit.max()) + 1
    table = coo_array((np.ones(len(cell)), (visit, size + cell)), shape=(size + cell.max() + 1,) * 2)
    _, label = connected_components(table, directed=False)
    rows_of, cells_of = np.bincount(label[visit]), np.bincount(label[size:])
    blocks: dict[int, list[tuple[Ints, Floats, Floats]]] = {}
    first: dict[int, list[int]] = {}
    start = 0
    for index, operator in found.whitening.groups:
        width = operator.shape[1]
        for number, rows in enumerate(index):
            cluster = int(label[visit[rows[0]]])
            if rows_of[cluster] > cells_of[cluster]:
                own = slice(start + number * width, start + (number + 1) * width)
                blocks.setdefault(cluster, []).append((cell[rows], operator[number], found.whitened[own]))
                first.setdefault(cluster, []).append(int(rows[0]))
        start += len(index) * width
    for cluster, parts in blocks.items():
        yield Cluster(np.concatenate([part[2] for part in parts]), _free_means(parts), tuple(first[cluster]))


def _free_means(parts: list[tuple[Ints, Floats, Floats]]) -> Floats:
    """Whitened columns (k, 3 c) of a mean of its own for each of c cells."""
    present = np.unique(np.concatenate([cells for cells, _, _ in parts]))
    made = []
    for cells, operator, _ in parts:
        picked = (cells[:, None] == present).astype(np.float64)
        split = operator.reshape(len(operator), len(cells), 3)
        made.append(np.einsum("kmi,mc->kci", split, picked).reshape(len(operator), -1))
    return np.concatenate(made)


def _scatter(residual: Floats, cell: Ints, count: Ints) -> float:
    """Pooled standard deviation of one coordinate within the cells, m."""
    mean = np.stack([np.bincount(cell, residual[:, axis]) for axis in range(3)], axis=1) / count[:, None]
    return float(np.sqrt(((residual - mean[cell]) ** 2).sum() / (3.0 * (len(cell) - len(count)))))
