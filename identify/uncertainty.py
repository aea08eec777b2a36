"""Covariance of fitted parameters: from the stated noise, from the scatter between poses, from the loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats
from identify.fit import Fit
from identify.loads import LoadCase
from identify.model import respond

__all__ = ["load_changes_by_sigma", "load_share", "stated_covariance", "visit_covariance"]


def stated_covariance(found: Fit) -> Floats:
    """``(X'X)^-1`` of the whitened columns, (p, p) in the parameters' units; zero for what was not fitted."""
    inverse, _, _ = _pieces(found)
    return _spread(found, inverse)


def visit_covariance(found: Fit) -> tuple[Floats, int]:
    """Sandwich covariance with visits as clusters, and the number of clusters.

    The scores use leave-one-visit-out residuals ``(I - H_v)^-1 r_v`` (Bell and McCaffrey 2002, CR3), which
    is on the safe side for few visits with high leverage.
    """
    inverse, columns, whitened = _pieces(found)
    visit = found.whitening.visits(found.data.experiment)
    order = np.argsort(visit, kind="stable")
    starts = np.flatnonzero(np.diff(visit[order], prepend=-1))
    sizes = np.diff(starts, append=len(order))
    scores = np.zeros((len(starts), columns.shape[1]))
    for size in np.unique(sizes):
        members = np.flatnonzero(sizes == size)
        rows = order[starts[members][:, None] + np.arange(size)]
        block = columns[rows]
        hat = block @ inverse @ block.swapaxes(1, 2)
        left = np.eye(size) - hat
        outside = (np.linalg.pinv(left, hermitian=True, rcond=1e-8) @ whitened[rows][..., None])[..., 0]
        scores[members] = np.einsum("vkp,vk->vp", block, outside)
    clusters = len(starts)
    meat = scores.T @ scores * (clusters - 1) / clusters
    return _spread(found, inverse @ meat @ inverse), clusters


def load_share(found: Fit) -> Floats:
    """What the stated uncertainty of masses and attach points adds, (p, p).

    The readings move by ``dy/dm dm``; the estimate follows by ``(X'X)^-1 X'`` of the whitened change.
    """
    inverse, columns, _ = _pieces(found)
    changes = inverse @ (columns.T @ load_changes_by_sigma(found))
    return _spread(found, changes @ changes.T)


def load_changes_by_sigma(found: Fit) -> Floats:
    """Whitened change of the readings by one sigma of each uncertain load number, (K, u)."""
    changes = np.zeros((len(found.whitened), 0))
    if found.data.experiment.wrench is None:
        for index, load in enumerate(found.data.experiment.loads):
            for nudged, sigma in _uncertain(load):
                change = found.whitening.apply(_change(found, index, nudged)) * sigma
                changes = np.column_stack([changes, change])
    return changes


def _uncertain(load: LoadCase) -> list[tuple[LoadCase, float]]:
    """The load moved by one unit (kg, m) in each uncertain direction, with its sigma."""
    moves = []
    if load.mass_std > 0:
        moves.append((replace(load, mass=load.mass + 1.0), load.mass_std))
    if load.attach_std > 0:
        moves += [(replace(load, attach=load.attach + axis), load.attach_std) for axis in np.eye(3)]
    return moves


def _change(found: Fit, index: int, load: LoadCase) -> Floats:
    """(R, 3) change of the readings with another load case; exact, since torques are linear in both."""
    experiment = found.data.experiment
    loads = (*experiment.loads[:index], load, *experiment.loads[index + 1 :])
    other = respond(found.model, replace(experiment, loads=loads), found.state.values, derivative=False)
    moved: Floats = other.position - found.response.position
    return moved


def _pieces(found: Fit) -> tuple[Floats, Floats, Floats]:
    """``(X'X)^-1`` on the kept columns, the kept whitened columns and the whitened residual."""
    columns = found.columns[:, found.identifiability.kept]
    norms = np.linalg.norm(columns, axis=0)
    upper = np.linalg.qr(columns / norms, mode="r")
    root = np.linalg.inv(upper) / norms[:, None]
    return root @ root.T, columns, found.whitened


def _spread(found: Fit, kept: Floats) -> Floats:
    """Kept parameters' matrix in the place of all p."""
    index = found.identifiability.kept
    full = np.zeros((len(found.model.parameters),) * 2)
    full[np.ix_(index, index)] = kept
    return full
