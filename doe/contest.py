"""A cause against its rivals: how much of it no rival can imitate, for any set of visits.

With X the whitened columns of the model and of the other causes, G those of a rival and x the signal of the cause at
its fitted size, what tells them apart is

    E = |(I - P_[X,G]) x|^2,

the non-centrality of the chi-square by which the cause is still seen beside the rival; maximising it is T-optimality
(Atkinson and Fedorov, Biometrika 62, 1975). Either of the two may be true: the same is asked of the rival's signal, at
the size at which it imitates the cause best, beside the cause, and of the rivals among each other. Only normal matrices
are needed, which add up over visits. Columns are projected off X over all rows beforehand, which changes no E and keeps
the numbers small.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from identify.arrays import Floats
from identify.diagnosis.library import Hypothesis
from identify.identifiability import TOLERANCE, triangle

__all__ = ["Contest", "contest", "needed_energy"]

_INSIDE = 1e-6  # a column that the model imitates to this share is inside it
_RIDGE = 1e-11  # information on directions that nothing shows, all rows together having 1
_FLAT = 1e-8  # relative eigenvalue below which a direction does not count
_SURE, _POWER = 1e-3, 0.9


@dataclass(frozen=True, eq=False)
class Contest:
    """A cause, its rivals and the normal matrices of all their columns.

    The m columns of the hypotheses stand behind the r of the model.

    Attributes:
        cause: The cause.
        rivals: Its k rivals.
        model: Number r of directions of the model.
        where: The columns of the cause and of each rival, counted from the first behind the model.
        size: (m,) fitted sizes of the cause on its columns, zero elsewhere.
        measured: (r + m, r + m) normal matrix of the readings.
        possible: (N, r + m, r + m) those of the visits that could be measured.
    """

    cause: Hypothesis
    rivals: tuple[Hypothesis, ...]
    model: int
    where: tuple[slice, ...]
    size: Floats
    measured: Floats
    possible: Floats

    @property
    def everything(self) -> Floats:
        """Normal matrix of the readings and all possible visits."""
        total: Floats = self.measured + self.possible.sum(axis=0)
        return total

    def energies(self, normal: Floats) -> Floats:
        """What tells each of the k + 1 hypotheses from each other one.

        Args:
            normal: (..., r + m, r + m) normal matrices.

        Returns:
            (..., k + 1, k + 1): the signal of the first beside the columns of the second; infinite on the diagonal.
        """
        left = self._beyond_model(normal)
        whole = np.einsum("hi,...ij,hj->...h", self._signals, left, self._signals)
        beside = np.stack([whole - _imitated(left, there, self._signals) for there in self.where], axis=-1)
        every = np.arange(len(self.where))
        beside[..., every, every] = np.inf
        beside[..., self.nested, 0] = np.inf  # if such a rival is true, the cause with its further freedom fits too
        energy: Floats = np.maximum(beside, 0.0)
        return energy

    @cached_property
    def dofs(self) -> np.ndarray:
        """(k + 1, k + 1) directions in which the first is seen beside the second; 0 where it lies inside it."""
        left = self._beyond_model(self.everything)
        return np.array([[_rank(left, here, there) for there in self.where] for here in self.where])

    @cached_property
    def nested(self) -> np.ndarray:
        """Numbers of the rivals that lie inside the cause, which holds more: only what is beyond them can tell."""
        return np.flatnonzero((self.dofs[:, 0] == 0) & (self.dofs[0] > 0))

    @cached_property
    def needed(self) -> Floats:
        """(k + 1, k + 1) energies with which two hypotheses are told apart, whichever is true."""
        energy = np.array([[needed_energy(max(int(dof), 1)) for dof in row] for row in self.dofs])
        either: Floats = np.maximum(energy, energy.T)
        return either

    @cached_property
    def _signals(self) -> Floats:
        """(k + 1, m) sizes of the cause, and of each rival where it imitates the cause best."""
        left, here = self._beyond_model(self.measured), self.where[0]
        signals = np.zeros((len(self.where), len(self.size)))
        signals[0] = self.size
        for signal, there in zip(signals[1:], self.where[1:], strict=True):
            inverse = np.linalg.pinv(left[there, there], rcond=_FLAT, hermitian=True)
            signal[there] = inverse @ left[there, here] @ self.size[here]
        return signals

    def _beyond_model(self, normal: Floats) -> Floats:
        """(..., m, m) normal matrix of the hypotheses' columns projected off the model."""
        r = self.model
        ridge = _RIDGE * np.eye(r)
        mixed = normal[..., :r, r:]
        solved = np.linalg.solve(normal[..., :r, :r] + ridge, mixed)
        beyond: Floats = normal[..., r:, r:] - mixed.swapaxes(-1, -2) @ solved
        return beyond


def _imitated(left: Floats, there: slice, signals: Floats) -> Floats:
    """(..., h) energy of h signals that some columns can imitate."""
    mixed = left[..., there, :] @ signals.T
    inside = left[..., there, there] + _RIDGE * np.eye(there.stop - there.start)
    energy: Floats = (mixed * np.linalg.solve(inside, mixed)).sum(axis=-2)
    return energy


def _rank(left: Floats, here: slice, there: slice) -> int:
    """Directions of some columns that others cannot imitate."""
    inverse = np.linalg.pinv(left[there, there], rcond=_FLAT, hermitian=True)
    rest = left[here, here] - left[here, there] @ inverse @ left[there, here]
    scale = np.sqrt(np.diag(left[here, here]))
    unit = rest / np.where(scale > 0, scale, np.inf) / np.where(scale > 0, scale, np.inf)[:, None]
    return int((np.linalg.eigvalsh(unit) > _INSIDE).sum())


def contest(
    cause: Hypothesis,
    rivals: tuple[Hypothesis, ...],
    sizes: Floats,
    measured: tuple[Floats, Floats],
    possible: tuple[Floats, Floats],
) -> Contest:
    """Normal matrices of a cause and its rivals in well-scaled coordinates.

    Args:
        cause: The cause with b parameters.
        rivals: Its rivals.
        sizes: (b,) fitted sizes of the cause, in its units.
        measured: Whitened rows of the readings: (K, p) of the model, (K, m) of cause and rivals in this order.
        possible: The same of each possible visit, (N, k, p) and (N, k, m).
    """
    model = np.concatenate([measured[0], possible[0].reshape(-1, possible[0].shape[2])])
    own = np.concatenate([measured[1], possible[1].reshape(-1, possible[1].shape[2])])
    basis = model @ _unit_coordinates(model)
    whole = np.linalg.norm(own, axis=0)
    for _ in range(2):  # twice is enough (Kahan, Parlett)
        own -= basis @ (basis.T @ own)
    scale = np.linalg.norm(own, axis=0)
    scale[scale <= _INSIDE * whole] = 0.0
    own /= np.where(scale > 0, scale, np.inf)
    rows = np.hstack([basis, own])
    begin = len(measured[0])
    blocks = rows[begin:].reshape(*possible[0].shape[:2], rows.shape[1])
    ends = np.cumsum([0, *(len(hypothesis.own) for hypothesis in (cause, *rivals))])
    size = np.zeros(len(scale))
    size[: len(sizes)] = sizes * scale[: len(sizes)]
    return Contest(
        cause,
        rivals,
        basis.shape[1],
        tuple(slice(int(a), int(b)) for a, b in pairwise(ends)),
        size,
        rows[:begin].T @ rows[:begin],
        blocks.swapaxes(1, 2) @ blocks,
    )


def _unit_coordinates(columns: Floats) -> Floats:
    """(p, r) coordinates in which columns (K, p) become r orthonormal ones."""
    norms = np.linalg.norm(columns, axis=0)
    inverse = np.where(norms > 0, 1 / np.where(norms > 0, norms, 1.0), 0.0)
    _, values, directions = np.linalg.svd(triangle([columns * inverse]))
    seen = values > TOLERANCE * values.max(initial=0.0)
    coordinates: Floats = inverse[:, None] * directions[: len(values)][seen].T / values[seen]
    return coordinates


@lru_cache
def needed_energy(dof: int) -> float:
    """Non-centrality at which a chi-square test at 0.1 % finds something in nine of ten cases; about 21 for one dof."""
    from scipy.optimize import brentq
    from scipy.stats import chi2, ncx2

    limit = chi2.isf(_SURE, dof)
    return float(brentq(lambda energy: ncx2.sf(limit, dof, energy) - _POWER, 1.0, 200.0 + 10.0 * dof))
