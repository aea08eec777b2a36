"""What every criterion offers, and the small linear algebra that they share; formulas in `doe.criteria`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from identify.arrays import Floats

__all__ = [
    "Certificate",
    "Criterion",
    "Local",
    "central_slack",
    "eliminated",
    "inverse_root",
    "packed",
    "products",
    "short",
    "step_inside",
]


@dataclass(frozen=True, eq=False)
class Certificate:
    """What proves a bound at one information matrix, see the module.

    Attributes:
        value: The criterion.
        factor: (p, q) R.
        numerator: Of the bound.
        dual: Mixture (t,) for G, factor (p, q) of X in row-space coordinates for E, else None.
    """

    value: float
    factor: Floats
    numerator: float
    dual: Floats | None = None


@dataclass(frozen=True, eq=False)
class Local:
    """The smooth function and its derivatives at one information matrix.

    Attributes:
        certificate: Its factor R also gives the gradient: minus the derivative by w_i is ``|A_i R|^2``.
        curvature: Maps blocks (m, k, p) to rows V (m, s) with Hessian ``V V'`` with respect to their weights.
        predict: Maps a change of M to the dual after the same Newton step, kept inside its cone, and the part
            of that step that was taken.
    """

    certificate: Certificate
    curvature: Callable[[Floats], Floats]
    predict: Callable[[Floats], tuple[Floats | None, float]]


class Criterion(ABC):
    """One criterion in the coordinates of a row space.

    All methods take M (p, p) and raise `numpy.linalg.LinAlgError` where it is singular.
    """

    smooth = True

    @abstractmethod
    def value(self, information: Floats) -> float:
        """The criterion."""

    def unit(self, information: Floats) -> float:
        """The size of the objective, in which ``mu`` is to be measured."""
        return self.value(information)

    @abstractmethod
    def objective(self, information: Floats, mu: float) -> float:
        """The smooth convex function that is minimised."""

    @abstractmethod
    def local(self, information: Floats, mu: float, dual: Floats | None) -> Local:
        """The smooth function's gradient, and its curvature as a primal-dual method sees it from ``dual``."""

    @abstractmethod
    def certificate(self, information: Floats, dual: Floats | None) -> Certificate:
        """The certificate for a given dual (None where the criterion has none)."""

    @abstractmethod
    def after_adding(self, information: Floats, rows: Floats) -> Floats:
        """The criterion for M plus the information of one more candidate, for n candidates at once.

        Args:
            information: M (p, p).
            rows: (k, n, p) blocks, row by row.

        Returns:
            (n,); infinite where a candidate cannot be the best of all.
        """

    @abstractmethod
    def prospect(self, information: Floats, goal: float) -> tuple[Floats, float]:
        """Factor R and threshold: a candidate with ``|A_i R|^2`` below it cannot bring M's value to ``goal``."""

    def published(self, dual: Floats | None) -> Floats | None:
        """The dual in the parameters' own coordinates."""
        return dual


def short(rows: Floats) -> Floats:
    """At most p rows with the same Gram matrix: the triangular factor of (r, p)."""
    return rows if len(rows) <= rows.shape[1] else np.asarray(np.linalg.qr(rows, mode="r"))


def inverse_root(information: Floats) -> Floats:
    """``L^-T`` with ``M = L L'``: upper triangular, and ``L^-T L^-1 = M^-1``."""
    root = np.linalg.cholesky(information)
    inverse: Floats = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
    return inverse.T


def products(blocks: Floats, left: Floats, right: Floats) -> Floats:
    """``left' A_i'A_i right`` of all blocks, flattened, (m, p q)."""
    count, k, p = blocks.shape
    flat = blocks.reshape(-1, p)
    first = (flat @ left).reshape(count, k, -1)
    second = first if right is left else (flat @ right).reshape(count, k, -1)
    return np.asarray(np.matmul(first.swapaxes(1, 2), second).reshape(count, -1))


def packed(rows: Floats) -> Floats:
    """Symmetric matrices (m, p p) or (m, p, p) as (m, p (p + 1) / 2) with the same inner products."""
    p = int(np.sqrt(rows[0].size))
    upper = np.triu_indices(p)
    weight = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))
    return rows.reshape(len(rows), p, p)[:, upper[0], upper[1]] * weight


def eliminated(rows: Floats, root: Floats, factor: Floats) -> tuple[Floats, Floats]:
    """Gauss elimination of ``I + A_j P A_j'`` for n candidates at once, P = root root'.

    Args:
        rows: (k, n, p) blocks.
        root: (p, p).
        factor: (p, q).

    Returns:
        The pivots (k, n), and ``A_j factor`` after the same elimination, (q, k, n).
    """
    k, count, p = rows.shape
    flat = rows.reshape(-1, p)
    scaled = (flat @ root).reshape(k, count, p).swapaxes(0, 1)
    square = np.matmul(scaled, scaled.swapaxes(1, 2)).reshape(count, k * k)
    square = np.ascontiguousarray(square.T).reshape(k, k, count)  # candidates last: long runs for the loop below
    turned = (factor.T @ flat.T).reshape(-1, k, count)
    pivots = np.empty((k, count))
    for a in range(k):
        pivots[a] = 1.0 + square[a, a]
        ratio = square[a + 1 :, a] / pivots[a]
        turned[:, a + 1 :] -= ratio * turned[:, a, None]
        square[a + 1 :, a + 1 :] -= ratio[:, None] * square[a, a + 1 :]
    return pivots, turned


def central_slack(gaps: Floats, mu: float) -> Floats:
    """``y + gaps`` with y > 0 such that ``sum mu / (y + gaps) = 1``; gaps >= 0, the least of them 0."""
    y = mu  # the sum is at least 1 here, and Newton on its inverse, a concave function, comes up from below
    for _ in range(60):
        share = mu / (y + gaps)
        total = float(share.sum())
        slope = float(np.sum(share * share)) / mu
        step = (total - 1.0) * total / slope
        y += step
        if step <= 1e-14 * y:
            break
    return y + gaps


def step_inside(least: float) -> float:
    """Longest step up to 1 after which ``1 + step least`` is at least 0.02."""
    return min(1.0, 0.98 / -least) if least < 0.0 else 1.0
