"""Approximate design: the best weights of the candidates, with a proven bound.

Column generation: an interior-point method finds the best weights on a few candidates, one pass over all
candidates finds those that would improve them, and the same pass proves how far the weights are from the
optimum of the whole problem (the equivalence theorem, Kiefer and Wolfowitz 1960, in the form of `doe.criteria`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from doe.column_generation import best_weights
from doe.problem import make_problem
from identify.arrays import Floats, frozen
from identify.errors import InputError, NoConvergence
from identify.threads import one_thread

__all__ = ["ApproximateDesign", "approximate_design"]


@dataclass(frozen=True, eq=False)
class ApproximateDesign:
    """Weights of the candidates and the proof of their quality.

    Attributes:
        weights: (N,) shares of the effort.
        value: The criterion, minimised.
        bound: No feasible weights have a smaller value.
        gap: ``1 - bound/value``.
        iterations: Passes over all candidates.
        dual: G: mixture (t,) of the test poses; E: (p, p) positive semidefinite with trace 1; else None.
    """

    weights: Floats
    value: float
    bound: float
    gap: float
    iterations: int
    dual: Floats | None


def approximate_design(
    blocks: Any,
    target: Any,
    *,
    criterion: str = "test_pose",
    max_weight: float | None = None,
    costs: Any = None,
    prior: Any = None,
    tol: float = 1e-6,
) -> ApproximateDesign:
    """Best weights of the candidates for ``M(w) = sum_i w_i A_i'A_i + prior``.

    Args:
        blocks: (N, k, p) whitened observation rows, any float dtype; never changed, never copied whole.
        target: (r, p) rows of the test poses; (t, r, p) for G; ignored by A, D and E.
        criterion: test_pose, A, D, E or G, as in `doe.criteria`.
        max_weight: Cap of every weight; 1/n is the relaxation of n experiments without repeats.
        costs: (N,) positive; then ``sum c_i w_i = 1`` instead of ``sum w_i = 1``.
        prior: (p, p) information that is there already, on the scale of one experiment.
        tol: Largest relative gap between value and bound.

    Returns:
        The weights with value and bound; the weights (with ``dual`` for G and E) reproduce the bound.

    Raises:
        InputError: A wrong shape or value, or caps that cannot reach the sum.
        NotIdentifiable: The candidates cannot show what the criterion needs.
        NoConvergence: The gap stayed above ``tol``; holds the best result.
    """
    if not (isinstance(tol, (int, float)) and 0.0 < tol < 1.0):
        raise InputError(f"tol is {tol!r}, needed: a number between 0 and 1")
    with one_thread():
        problem = make_problem(blocks, target, criterion, costs, prior, _checked_cap(max_weight))
        if problem.room < 1.0 - 1e-9:
            raise InputError(f"the caps only let the weights sum up to {problem.room:.9g}, not 1; raise max_weight")
        found = best_weights(problem, tol)
    dual = problem.criterion.published(found.certificate.dual)
    value = found.certificate.value
    design = ApproximateDesign(
        weights=frozen(found.u / problem.costs),
        value=value,
        bound=found.bound,
        gap=1.0 - found.bound / value,
        iterations=found.passes,
        dual=None if dual is None else frozen(dual),
    )
    if design.gap > tol:
        raise NoConvergence(f"the proven gap stayed at {design.gap:.2e}, above tol = {tol:.2e}; raise tol", design)
    return design


def _checked_cap(max_weight: float | None) -> float | None:
    """The cap as a float.

    Raises:
        InputError: Not a positive number.
    """
    if max_weight is None:
        return None
    if not (isinstance(max_weight, (int, float, np.number)) and max_weight > 0.0):
        raise InputError(f"max_weight is {max_weight!r}, needed: a positive number or None")
    return float(max_weight)
