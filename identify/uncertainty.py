"""Covariance of fitted parameters: from the stated noise, from the scatter between poses, from the loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats
from identify.fit import Fit
from identify.loads import LoadCase
from identify.noise import Whitening
from identify.response import respond

__all__ = ["load_changes_by_sigma", "load_share", "off_columns", "stated_covariance", "visit_covariance"]

_LIGHT = 0.5  # no visit decides anything alone: powers of its leverage die out
_ROUNDING = float(np.finfo(np.float64).eps)


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

    def meat_of(operators: Whitening, columns: Floats, rows: slice) -> tuple[Floats, int]:
        basis = columns[:, found.identifiability.kept] @ root
        parts = list(operators.split(np.column_stack([basis, found.whitened[rows]])))
        scores = np.concatenate([_scores(part[:, :, :-1], part[:, :, -1]) for part in parts]) if parts else basis[:0]
        return scores.T @ scores, len(scores)

    meats, counts = zip(*found.rows.each(meat_of), strict=True)
    clusters = sum(counts)
    return _spread(found, root @ sum(meats) @ root.T * ((clusters - 1) / clusters)), clusters


def _scores(basis: Floats, whitened: Floats) -> Floats:
    """``Q_v' (I - Q_v Q_v')^-1 r_v`` of G visits with k rows each, (G, m), from orthonormal columns (G, k, m)."""
    across = basis.swapaxes(1, 2)
    heaviest = np.einsum("gkm,gkm->g", basis, basis).max(initial=0.0)
    if heaviest >= _LIGHT:
        left = np.eye(basis.shape[1]) - basis @ across
        return np.asarray((across @ (np.linalg.pinv(left, hermitian=True, rcond=1e-8) @ whitened[..., None]))[..., 0])
    plain = scores = across @ whitened[..., None]
    for _ in range(_terms(heaviest)):
        scores = plain + across @ (basis @ scores)
    return np.asarray(scores[..., 0])


def _terms(share: float) -> int:
    """How many terms of ``sum share^k`` rounding does not swallow."""
    return int(np.ceil(np.log(_ROUNDING) / np.log(share))) if share > 0 else 0


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
    moved: Floats = other.deflection - found.response.deflection
    return moved


def along_columns(found: Fit, whitened: Floats) -> Floats:
    """``Q'Z`` of whitened rows Z (K, u), (rank, u), with Q an orthonormal basis of the kept columns."""
    if not whitened.shape[1]:
        return np.zeros((found.identifiability.rank, 0))
    root, kept = _root(found), found.identifiability.kept
    parts = found.rows.each(lambda _, columns, rows: (columns[:, kept] @ root).T @ whitened[rows])
    return np.asarray(np.sum(parts, axis=0))


def off_columns(found: Fit, whitened: Floats) -> Floats:
    """``Z - Q Q'Z`` of whitened rows Z (K, u): what no kept column can take up."""
    if not whitened.shape[1]:
        return whitened
    kept, taken = found.identifiability.kept, _root(found) @ along_columns(found, whitened)
    parts = found.rows.each(lambda _, columns, rows: whitened[rows] - columns[:, kept] @ taken)
    return np.concatenate(parts)


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
