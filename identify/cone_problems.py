"""Convex problems over positive definite compliance matrices, in the scaled parameters of `identify.positive_cone`.

Linear equations are solved once and for all, ``y = point + basis z``, so that every answer fulfils them to rounding.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from identify.arrays import Floats, Ints
from identify.errors import NoConvergence
from identify.positive_cone import Block, Cone

__all__ = ["Affine", "affine", "closest", "extremes", "inside", "nearest_values", "shortfalls"]

_DEPENDENT = 1e-10  # singular values of unit rows below this are zero
_CONTRADICTION = 1e-8
_SLACK = 0.5  # of the margin, for the accuracy of the solver
_DETERMINED = 1e-9


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
    _solve(cp.Problem(cp.Minimize(cp.sum(lack)), limits))
    return np.zeros(len(cone.blocks)) if lack.value is None else np.asarray(lack.value)


def extremes(
    cone: Cone, space: Affine, margin: float, bounds: tuple[Floats, Floats], wanted: Sequence[int]
) -> tuple[Floats, Floats]:
    """Smallest and largest possible values (w,) of some parameters.

    Args:
        cone: The cone.
        space: Where y may be.
        margin: Smallest eigenvalue.
        bounds: (P,) and (P,) box around y; infinite where there is none.
        wanted: Indices of the parameters.

    Raises:
        NoConvergence: The solver gave up.
    """
    found = np.empty((2, len(wanted)))
    if not wanted:
        return found[0], found[1]
    import cvxpy as cp

    z, direction = cp.Variable(space.basis.shape[1]), cp.Parameter(space.basis.shape[1])
    y, boxed = space.basis @ z + space.point, np.flatnonzero(np.isfinite(bounds[1]))
    limits = [*_possible(cone, space, z, margin), y[boxed] <= bounds[1][boxed], y[boxed] >= bounds[0][boxed]]
    problem = cp.Problem(cp.Minimize(direction @ z), limits)
    for place, index in enumerate(wanted):
        size = float(np.linalg.norm(space.basis[index]))
        for side, sign in enumerate((1.0, -1.0)):
            found[side, place] = space.point[index]
            if size > _DETERMINED:
                direction.value = sign * space.basis[index] / size
                if not _solve(problem):
                    raise NoConvergence(f"the solver found no bound of {cone.names[index]}")
                found[side, place] += sign * float(problem.value) * size
    return found[0], found[1]


def _possible(cone: Cone, space: Affine, z: Any, margin: float) -> list[Any]:
    """Constraints: every block has eigenvalues of at least ``margin``."""
    single: Ints = np.array([b.columns[0, 0] for b in cone.blocks if len(b.columns) == 1], dtype=np.int64)
    limits = [space.basis[single] @ z + space.point[single] >= margin] if len(single) else []
    larger = [block for block in cone.blocks if len(block.columns) > 1]
    return limits + [_matrix(block, space, z) >> margin * np.eye(len(block.columns)) for block in larger]


def _matrix(block: Block, space: Affine, z: Any) -> Any:
    """The matrix of a block as an expression of z."""
    import cvxpy as cp

    size = len(block.columns)
    parts = block.matrices(space.basis.T)
    fixed = block.matrices(space.point)
    return cp.reshape(parts.reshape(-1, size * size).T @ z, (size, size), order="C") + fixed


def _answer(problem: Any, z: Any, cone: Cone, space: Affine, margin: float) -> Floats | None:
    """The solution (P,) if there is one that is positive definite in truth."""
    if not _solve(problem):
        return None
    y: Floats = space.point + space.basis @ z.value
    return y if inside(cone, y, _SLACK * margin, 0.0) else None


def _solve(problem: Any) -> bool:
    """Solve; True if there is an answer."""
    import cvxpy as cp

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # inaccurate answers are judged by what they are worth
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return False
    return problem.status in {"optimal", "optimal_inaccurate"}
