"""One reconstruction: the parameters scaled, the linear equations solved, and what to say if nothing is possible."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.cone_problems import Affine, affine, closest, nearest_values, shortfalls
from identify.errors import Infeasible, InputError
from identify.identified import Identified
from identify.positive_cone import Cone, cone_of
from identify.priors import Prior

__all__ = ["Scaled", "check_constants", "indices_of", "infeasible", "scaled_problem", "worst"]

_SINGULAR = 1e-9  # a covariance with relative eigenvalues below this says nothing about some directions


@dataclass(frozen=True, eq=False)
class Scaled:
    """A reconstruction in scaled parameters.

    Attributes:
        identified: What was identified.
        cone: The possible parameters.
        matrix: (r, P) functions of the scaled parameters.
        margin: Smallest eigenvalue.
        fixed: Where the constants are as stated.
        space: Where all identified values are as well.
    """

    identified: Identified
    cone: Cone
    matrix: Floats
    margin: float
    fixed: Affine
    space: Affine


def scaled_problem(identified: Identified, prior: Prior, fixed: Mapping[str, float], margin: float) -> Scaled:
    """Scale everything and solve the linear equations.

    Raises:
        Infeasible: The equations contradict each other.
    """
    cone = cone_of(identified.full, prior)
    matrix = identified.matrix * cone.scale
    constants = {**dict(identified.fixed), **fixed}
    index = indices_of(identified, constants)
    rows = np.eye(len(cone.names))[index]
    held = np.array([constants[cone.names[i]] for i in index]) / cone.scale[index]
    apart = affine(rows, held, cone.prior, cone.weight)
    values = np.concatenate([held, identified.values])
    space = affine(np.concatenate([rows, matrix]), values, cone.prior, cone.weight)
    problem = Scaled(identified, cone, matrix, margin, apart, space)
    if space.contradiction:
        check_constants(problem)
        raise Infeasible(
            f"{', '.join(constants) or 'identified values'}: these contradict what was identified by "
            f"{100 * space.contradiction:.2g} % of the prior's size; what is identified cannot be held"
        )
    return problem


def indices_of(identified: Identified, names: Collection[str]) -> list[int]:
    """Where parameters stand, ascending.

    Raises:
        InputError: A name that is none of them.
    """
    for name in names:
        if name not in identified.full:
            raise InputError(f"{name!r}: no such parameter; there are {identified.full[0]} ... {identified.full[-1]}")
    return sorted(identified.full.index(name) for name in names)


def check_constants(problem: Scaled) -> None:
    """Refuse constants that alone leave no positive definite matrix.

    Raises:
        Infeasible: There is none.
    """
    if closest(problem.cone, problem.fixed, problem.margin) is not None:
        return
    label = worst(problem, problem.fixed)
    raise Infeasible(
        f"the constants break positive definiteness: no matrix of {label} with these values is positive definite, "
        "whatever its other elements; give constants of one beam or leave them free"
    )


def worst(problem: Scaled, space: Affine) -> str:
    """Whose matrix lacks most to be positive definite."""
    return problem.cone.blocks[int(np.argmax(shortfalls(problem.cone, space, problem.margin)))].label


def infeasible(problem: Scaled) -> Infeasible:
    """Says whose matrix is worst and how far the identified values would have to move."""
    check_constants(problem)
    identified, cone = problem.identified, problem.cone
    short = shortfalls(cone, problem.space, problem.margin)
    known = identified.covariance is not None
    std, root = _metric(problem)
    y, distance = nearest_values(cone, problem.fixed, problem.margin, problem.matrix, identified.values, root)
    moves = (problem.matrix @ y - identified.values) / std
    most, unit = int(np.argmax(np.abs(moves))), "std" if known else "% of the prior's size"
    return Infeasible(
        f"no positive definite matrices agree with what was identified: {cone.blocks[int(np.argmax(short))].label} is "
        f"the worst, its smallest eigenvalue would be {problem.margin - short.max():.2g} in units of the prior; the "
        f"identified values would have to move by {distance:.2g} {unit}, most {identified.names[most]} by "
        f"{moves[most]:.2g}; use identify_positive or check data and template"
    )


def _metric(problem: Scaled) -> tuple[Floats, Floats]:
    """Unit of each identified value and the metric of their moves: standard deviations, or per cent of the prior."""
    covariance = problem.identified.covariance
    if covariance is None:
        unit = 0.01 * np.abs(problem.matrix) @ np.maximum(np.abs(problem.cone.prior), 1.0)
        return unit, np.diag(1.0 / unit)
    std = np.sqrt(np.diag(covariance))
    spread, axes = np.linalg.eigh(covariance / np.outer(std, std))
    if spread[0] < _SINGULAR * spread[-1]:  # from fewer poses than parameters: what it does not show is not certain
        return std, np.diag(1.0 / std)
    return std, (axes / np.sqrt(spread)).T / std
