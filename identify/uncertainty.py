"""Covariance of fitted parameters: from the stated noise, from the scatter between poses, from the loads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from identify.arrays import Floats
from identify.fit import Fit
from identify.loads import LoadCase
from identify.model import respond

__all__ = ["load_changes_by_sigma", "load_share", "off_columns", "stated_covariance", "visit_covariance"]

_LIGHT = 0.5  # no visit decides anything alone: the rest of its leverage is far from singular


def stated_covariance(found: Fit) -> Floats:
    """``(X'X)^-1`` of the whitened columns, (p, p) in the parameters' units; zero for what was not fitted."""
    root = _root(found)
    return _spread(found, root @ root.T)


def visit_covariance(found: Fit) -> tuple[Floats, int]:
    """Sandwich covariance with visits as clusters, and the number of clusters.

    The scores use leave-one-visit-out residuals ``(I - H_v)^-1 r_v`` (Bell and McCaffrey 2002, CR3), which
    is on the safe side for few visits with high leverage.
    """
    root = _root(found)
    meat, clusters, start = np.zeros((root.shape[1],) * 2), 0, 0
    for operators, columns in found.rows.stacks():
        basis = columns[:, found.identifiability.kept] @ root
        for visits in operators.split(np.column_stack([basis, found.whitened[start : start + len(basis)]])):
            scores = _scores(visits[:, :, :-1], visits[:, :, -1])
            meat += scores.T @ scores
            clusters += len(visits)
        start += len(basis)
    return _spread(found, root @ meat @ root.T * ((clusters - 1) / clusters)), clusters


def _scores(basis: Floats, whitened: Floats) -> Floats:
    """``Q_v' (I - Q_v Q_v')^-1 r_v`` of G visits with k rows each, (G, m); orthonormal columns (G, k, m) of all rows."""
    hat = basis @ basis.swapaxes(1, 2)
    left = np.eye(hat.shape[1]) - hat
    if np.trace(hat, axis1=1, axis2=2).max() < _LIGHT:
        outside = np.linalg.solve(left, whitened[..., None])
    else:
        outside = np.linalg.pinv(left, hermitian=True, rcond=1e-8) @ whitened[..., None]
    scores: Floats = (basis.swapaxes(1, 2) @ outside)[..., 0]
    return scores


def load_share(found: Fit) -> Floats:
    """What the stated uncertainty of masses and attach points adds, (p, p).

    The readings move by ``dy/dm dm``; the estimate follows by ``(X'X)^-1 X'`` of the whitened change.
    """
    changes = _root(found) @ along_columns(found, load_changes_by_sigma(found))
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
    moved: Floats = other.position - (found.reading - found.residual)
    return moved


def along_columns(found: Fit, whitened: Floats) -> Floats:
    """``Q'Z`` of whitened rows Z (K, u), (rank, u), with Q an orthonormal basis of the kept columns."""
    total, start = np.zeros((found.identifiability.rank, whitened.shape[1])), 0
    if whitened.shape[1]:
        for basis in _bases(found):
            total += basis.T @ whitened[start : start + len(basis)]
            start += len(basis)
    return total


def off_columns(found: Fit, whitened: Floats) -> Floats:
    """``Z - Q Q'Z`` of whitened rows Z (K, u): what no kept column can take up."""
    along, rest, start = along_columns(found, whitened), whitened.copy(), 0
    if whitened.shape[1]:
        for basis in _bases(found):
            rest[start : start + len(basis)] -= basis @ along
            start += len(basis)
    return rest


def _bases(found: Fit) -> Iterator[Floats]:
    """Rows (K_i, rank) of the orthonormal basis, part by part."""
    root = _root(found)
    for _, columns in found.rows.stacks():
        yield columns[:, found.identifiability.kept] @ root


def _root(found: Fit) -> Floats:
    """Inverse (rank, rank) of the triangle of the kept columns: columns times it are orthonormal."""
    columns = found.upper[:, found.identifiability.kept]
    norms = np.linalg.norm(columns, axis=0)
    root: Floats = np.linalg.inv(np.linalg.qr(columns / norms, mode="r")) / norms[:, None]
    return root


def _spread(found: Fit, kept: Floats) -> Floats:
    """Kept parameters' matrix in the place of all p."""
    index = found.identifiability.kept
    full = np.zeros((len(found.model.parameters),) * 2)
    full[np.ix_(index, index)] = kept
    return full
