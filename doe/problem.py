"""A design problem in the form the solvers need: checked, in row-space coordinates, costs scaled away.

With u_i = c_i w_i and blocks A_i / sqrt(c_i) the constraint sum c_i w_i = 1 becomes sum u_i = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from doe.blocks import Blocks
from doe.criteria import Certificate, Criterion, criterion_for
from doe.polytope import largest_sum
from doe.row_space import RowSpace, prior_rows, row_space
from identify.arrays import Floats, Ints
from identify.errors import InputError

__all__ = ["Problem", "checked_costs", "checked_prior", "make_problem"]


@dataclass(frozen=True, eq=False)
class Problem:
    """Minimise the criterion over ``sum u = 1, 0 <= u <= upper``.

    Attributes:
        blocks: The candidates.
        space: Their row space.
        criterion: In the coordinates of ``space``.
        costs: (N,) c, all ones where none are given.
        upper: (N,) caps of u, infinite where there is none.
        prior: (rank, rank) information that is there already, in the coordinates of ``space``.
    """

    blocks: Blocks
    space: RowSpace
    criterion: Criterion
    costs: Floats
    upper: Floats
    prior: Floats

    @property
    def room(self) -> float:
        """What the caps let the weights sum up to."""
        return float(np.sum(np.minimum(self.upper, 1.0)))

    def part(self, index: Ints) -> Problem:
        """The same problem on some candidates alone, in the same coordinates; their blocks are copied."""
        blocks = Blocks(self.blocks.array[index])
        return replace(self, blocks=blocks, costs=self.costs[index], upper=self.upper[index])

    def take(self, index: Ints) -> Floats:
        """Scaled blocks of some candidates, (m, k, rank)."""
        return self.blocks.take(index, self.space.basis) / np.sqrt(self.costs[index])[:, None, None]

    def sensitivities(self, factor: Floats) -> Floats:
        """``|A_i factor|^2 / c_i`` of all candidates, (N,); zero for those whose cap is zero."""
        d = self.blocks.sensitivities(self.space.basis @ factor) / self.costs
        return np.where(self.upper > 0.0, d, 0.0)

    def information(self, index: Ints, u: Floats) -> Floats:
        """Sum of the scaled blocks' information with weights ``u`` (m,), without the prior."""
        rank = len(self.prior)
        total = np.zeros((rank, rank))
        for part in range(0, len(index), 1024):
            here = slice(part, part + 1024)
            rows = (self.take(index[here]) * np.sqrt(u[here])[:, None, None]).reshape(-1, rank)
            total += rows.T @ rows
        return total

    def bound(self, certificate: Certificate, d: Floats) -> float:
        """Lower bound of the criterion from the sensitivities ``d`` (N,) of all candidates."""
        return certificate.numerator / (largest_sum(d, self.upper, 1.0) + self.fixed(certificate))

    def fixed(self, certificate: Certificate) -> float:
        """Share of the prior in the sum of all sensitivities."""
        return float(np.sum((self.prior @ certificate.factor) * certificate.factor))


def make_problem(blocks: Any, target: Any, criterion: str, costs: Any, prior: Any, upper: Any) -> Problem:
    """Check the input and reduce it to the row space.

    Args:
        blocks: (N, k, p).
        target: See `doe.criteria.criterion_for`.
        criterion: Name.
        costs: (N,) or None.
        prior: (p, p) per unit of effort, or None.
        upper: (N,) or scalar cap of the weights w, or None.

    Raises:
        InputError: Something has the wrong shape or value.
        NotIdentifiable: The candidates cannot show what the criterion needs.
    """
    stream = Blocks(blocks)
    price = checked_costs(costs, len(stream))
    information = checked_prior(prior, stream.p)
    # row_space weighs the prior against the average of the unscaled blocks
    space = row_space(stream, information * float(price.mean()))
    known = prior_rows(information) @ space.basis  # the square of rows has no negative direction, in spite of rounding
    caps = np.full(len(stream), np.inf) if upper is None else upper * price
    caps = np.where(caps >= 1.0, np.inf, caps)
    return Problem(stream, space, criterion_for(criterion, space, target), price, caps, known.T @ known)


def checked_costs(costs: Any, count: int) -> Floats:
    """Costs as float64 (N,), ones where None.

    Raises:
        InputError: Wrong shape, or a cost that is not a positive finite number.
    """
    if costs is None:
        return np.ones(count)
    price = np.asarray(costs)
    if price.shape != (count,) or price.dtype.kind not in "fiu":
        raise InputError(f"costs have shape {price.shape} and dtype {price.dtype}, needed: {count} real numbers")
    price = price.astype(np.float64)
    if not np.all(np.isfinite(price) & (price > 0.0)):
        first = int(np.flatnonzero(~(np.isfinite(price) & (price > 0.0)))[0])
        raise InputError(f"costs[{first}] is {price[first]}, needed: a positive finite number")
    return price


def checked_prior(prior: Any, p: int) -> Floats:
    """Prior information as float64 (p, p), zeros where None.

    Raises:
        InputError: Wrong shape, not finite, not symmetric or with a negative eigenvalue.
    """
    if prior is None:
        return np.zeros((p, p))
    matrix = np.asarray(prior)
    if matrix.shape != (p, p) or matrix.dtype.kind not in "fiu":
        raise InputError(f"prior has shape {matrix.shape} and dtype {matrix.dtype}, needed: real ({p}, {p})")
    matrix = matrix.astype(np.float64)
    if not np.isfinite(matrix).all():
        raise InputError("prior holds NaN or infinity, needed: finite numbers")
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.outer(np.abs(diagonal), np.abs(diagonal)))
    if np.any(np.abs(matrix - matrix.T) > 1e-8 * scale):
        raise InputError("prior is not symmetric")
    unit = matrix / np.where(scale > 0.0, scale, 1.0)
    if np.any(diagonal < 0.0) or np.linalg.eigvalsh(unit)[0] < -1e-8 * p:
        raise InputError("prior has a negative eigenvalue, needed: an information matrix (positive semidefinite)")
    symmetric: Floats = 0.5 * (matrix + matrix.T)
    return symmetric
