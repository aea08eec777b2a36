"""Convex problems over positive definite compliance matrices, in the scaled parameters of `identify.positive_cone`.

Linear equations are solved once and for all, ``y = point + basis z``, so that every answer fulfils them to rounding.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from identify.arrays import Floats, Ints
from identify.errors import NoConvergence
from identify.positive_cone import Block, Cone

__all__ = ["Affine", "affine", "closest", "elements", "inside", "nearest_values", "shortfalls", "solutions"]

_DEPENDENT = 1e-10  # singular values of unit rows below this are zero
_CONTRADICTION = 1e-8
_SLACK = 0.5  # of the margin, for the accuracy of the solver
_ATTEMPTS: tuple[dict[str, Any], ...] = (
    {},
    {"max_step_fraction": 0.9, "static_regularization_constant": 1e-7},
    {"max_step_fraction": 0.8, "equilibrate_enable": False},
)  # of Clarabel: usual settings, then shorter and stiffer steps, for problems with degenerate answers


@dataclass(frozen=True, eq=False)
class Affine:
    """All solutions of linear equations: ``point + basis z``.

    Attributes:
        point: (P,) the solution closest to a given point.
        basis: (P, d) orthonormal in the metric of the weights.
        contradiction: Largest residual of an equation, relative to its size; 0 if all can be fulfilled.
    """

    point: Floats
    basis: Floats
    contradiction: float


def affine(matrix: Floats, values: Floats, near: Floats, weight: Floats) -> Affine:
    """Solutions of ``matrix y = values`` and, of them, the closest to ``near`` in ``|weight (y - near)|``.

    Args:
        matrix: (e, P); rows may depend on each other.
        values: (e,).
        near: (P,).
        weight: (P,).
    """
    rows = matrix / weight
    size = np.linalg.norm(rows, axis=1)
    size = np.where(size > 0, size, 1.0)
    wanted = (values - matrix @ near) / size
    left, singular, right = np.linalg.svd(rows / size[:, None], full_matrices=True)
    rank = int((singular > _DEPENDENT * singular.max(initial=0.0)).sum())
    point = near + right[:rank].T @ ((left[:, :rank].T @ wanted) / singular[:rank]) / weight
    missed = np.abs(matrix @ point - values) / (size + np.abs(values))
    contradiction = float(missed.max(initial=0.0))
    basis = right[rank:].T / weight[:, None]
    if not basis.shape[1]:
        basis = np.zeros((len(near), 1))  # everything is determined; solvers want a variable
    return Affine(point, basis, contradiction if contradiction > _CONTRADICTION else 0.0)


def inside(cone: Cone, y: Floats, margin: float, slack: float = 1e-9) -> bool:
    """True if all matrices have eigenvalues of at least ``margin``."""
    return bool((cone.smallest(y) >= margin - slack).all())


def closest(cone: Cone, space: Affine, margin: float) -> Floats | None:
    """Possible values (P,) closest to the prior, None if there are none."""
    if inside(cone, space.point, margin):
        return space.point
    import cvxpy as cp

    z = cp.Variable(space.basis.shape[1])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(z)), _possible(cone, space, z, margin))
    return _answer(problem, z, cone, space, margin)


def nearest_values(
    cone: Cone, space: Affine, margin: float, matrix: Floats, values: Floats, root: Floats
) -> tuple[Floats, float]:
    """Possible values (P,) whose functions are nearest to given ones, and ``|root (matrix y - values)|``.

    Args:
        cone: The cone.
        space: Where y may be.
        margin: Smallest eigenvalue.
        matrix: (r, P) functions of y.
        values: (r,) what they should be.
        root: (r, r) the metric.

    Raises:
        NoConvergence: The solver gave up.
    """
    import cvxpy as cp

    rows = root @ matrix @ space.basis
    target = root @ (values - matrix @ space.point)
    unit = max(float(np.linalg.norm(rows, 2)), np.finfo(np.float64).tiny)
    z = cp.Variable(space.basis.shape[1])
    error = cp.norm(rows / unit @ z - target / unit)
    y = _answer(cp.Problem(cp.Minimize(error), _possible(cone, space, z, margin)), z, cone, space, margin)
    if y is None:
        raise NoConvergence("the solver found no positive definite matrices nearest to what was identified")
    return y, float(np.linalg.norm(root @ (matrix @ y - values)))


def shortfalls(cone: Cone, space: Affine, margin: float) -> Floats:
    """(blocks,) what must be added to the diagonals of each matrix, in all as little as possible."""
    import cvxpy as cp

    z = cp.Variable(space.basis.shape[1])
    lack = cp.Variable(len(cone.blocks), nonneg=True)
    limits = [
        _matrix(block, space, z) + lack[i] * np.eye(len(block.columns)) >> margin * np.eye(len(block.columns))
        for i, block in enumerate(cone.blocks)
    ]
    found = np.zeros(len(cone.blocks))
    for status in solutions(cp.Problem(cp.Minimize(cp.sum(lack)), limits)):
        found = found if lack.value is None else np.asarray(lack.value)
        if status == "optimal":
            break
    return found


def _possible(cone: Cone, space: Affine, z: Any, margin: float) -> list[Any]:
    """Constraints: every block has eigenvalues of at least ``margin``."""
    single: Ints = np.array([b.columns[0, 0] for b in cone.blocks if len(b.columns) == 1], dtype=np.int64)
    limits = [space.basis[single] @ z + space.point[single] >= margin] if len(single) else []
    larger = [block for block in cone.blocks if len(block.columns) > 1]
    return limits + [_matrix(block, space, z) >> margin * np.eye(len(block.columns)) for block in larger]


def elements(block: Block, space: Affine) -> tuple[Floats, Floats]:
    """All elements of a block's matrix, row by row, as ``rows z + offset``: (k k, d) and (k k,)."""
    size = len(block.columns) ** 2
    return block.matrices(space.basis.T).reshape(-1, size).T, block.matrices(space.point).reshape(size)


def solutions(problem: Any) -> Iterator[str]:
    """Solve a cvxpy problem, and again with more careful settings each time the next status is asked for.

    An interior-point method can step so close to the edge of a problem with a degenerate answer that rounding stops
    it before it counts as solved; the last point is then often good, and the caller judges what it is worth.

    Yields:
        Status by cvxpy of each attempt that left an answer or a verdict.
    """
    import cvxpy as cp

    for settings in _ATTEMPTS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # inaccurate answers are judged by what they are worth
            try:
                problem.solve(solver=cp.CLARABEL, warm_start=False, accept_unknown=True, **settings)
            except cp.SolverError:
                continue  # the next attempt is more careful
        yield str(problem.status)


def _matrix(block: Block, space: Affine, z: Any) -> Any:
    """The matrix of a block as an expression of z."""
    import cvxpy as cp

    rows, offset = elements(block, space)
    size = len(block.columns)
    return cp.reshape(rows @ z + offset, (size, size), order="C")


def _answer(problem: Any, z: Any, cone: Cone, space: Affine, margin: float) -> Floats | None:
    """The solution (P,) if there is one that is positive definite in truth; the first accurate one if there is."""
    found: Floats | None = None
    for status in solutions(problem):
        if status == "infeasible":
            break
        if status in {"optimal", "optimal_inaccurate"}:
            y: Floats = space.point + space.basis @ z.value
            found = y if inside(cone, y, _SLACK * margin, 0.0) else found
            if status == "optimal":
                break
    return found
