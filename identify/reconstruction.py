"""Back to full matrices: joint compliances and positive definite 6x6 link matrices from what was identified.

The paper leaves it to the future: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot",
section 6. Here it is a convex problem: of all symmetric positive definite matrices that agree with the identified
parameters take those closest to a prior, and say how far each element could still move.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from identify.arrays import Floats, frozen
from identify.cone_extremes import extremes
from identify.cone_problems import closest, nearest_values
from identify.errors import InputError
from identify.identifiability import triangle
from identify.identification import Identification
from identify.identified import Identified, identified_by_fit
from identify.positive_cone import Cone
from identify.priors import Prior
from identify.reconstruction_problem import Scaled, check_constants, indices_of, infeasible, scaled_problem, worst
from identify.reduction import Reduction
from identify.reduction_steps import element_of
from identify.threads import one_thread

__all__ = ["MARGIN", "Positive", "Reconstruction", "identify_positive", "reconstruct"]

#: Smallest eigenvalue of a reconstructed matrix in units of the prior, ``k_ab / sqrt(prior_aa prior_bb)``.
MARGIN = 1e-3
_ROOM = 1.05  # constrained values stay inside the cone by this factor of the margin, so that matrices are found


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Full parameters that agree with what was identified, and what is left open.

    Attributes:
        identified: What they agree with.
        values: (P,) of ``identified.full``, result units.
        prior: (P,) what was expected.
        lower: (P,) smallest possible value of each; nan where it was not asked for.
        upper: (P,) largest possible value, within ``bound`` times the larger of prior and ``values``.
        bound: This factor.
        smallest: Whose matrix (``link2``, ``joints``) -> its smallest eigenvalue in units of the prior.
        disagreement: Largest difference to an identified value, relative to the sizes of what adds up to it.
    """

    identified: Identified
    values: Floats
    prior: Floats
    lower: Floats
    upper: Floats
    bound: float
    smallest: Mapping[str, float]
    disagreement: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("values", "prior", "lower", "upper"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter by name, result units."""
        return dict(zip(self.identified.full, self.values.tolist(), strict=True))

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Remaining freedom of the parameters that were asked for, result units."""
        rows = zip(self.identified.full, self.lower.tolist(), self.upper.tolist(), strict=True)
        return {name: (low, high) for name, low, high in rows if not np.isnan(low)}

    @property
    def links(self) -> dict[int, Floats]:
        """Link -> (6, 6) compliance at its distal end, m/N, rad/N, rad/Nm; elements outside its template are zero."""
        found: dict[int, Floats] = {}
        for name, value in self.parameters.items():
            place = element_of(name)
            if place is not None:
                a, b = place[1][0] - 1, place[1][1] - 1
                matrix = found.setdefault(place[0], np.zeros((6, 6)))
                matrix[a, b] = matrix[b, a] = 1e-6 * value
        return found


@dataclass(frozen=True, eq=False)
class Positive:
    """Identified values that positive definite matrices can have.

    Attributes:
        identified: The constrained values and their functions; the covariance is that of the unconstrained ones.
        unconstrained: (r,) values before.
        values: (P,) one set of full parameters that has them; `reconstruct` gives the set closest to a prior.
        chi2_increase: What the constraint costs; 0 if it was fulfilled.
        worst: Whose matrix was farthest from positive definite; empty if none was.
    """

    identified: Identified
    unconstrained: Floats
    values: Floats
    chi2_increase: float
    worst: str = ""


def reconstruct(
    identified: Identified,
    prior: Prior,
    *,
    fixed: Mapping[str, float] | None = None,
    intervals: Collection[str] | None = None,
    bound: float = 10.0,
    margin: float = MARGIN,
) -> Reconstruction:
    """Joint compliances and link matrices that agree with the identified values and are closest to a prior.

    Minimises ``sum_i |D_i^-1/2 (K_i - K_i0) D_i^-1/2|^2`` with ``D_i`` the diagonal of the prior ``K_i0``, over
    ``K_i >= margin D_i`` and ``matrix x = values``, by cvxpy and Clarabel. Intervals are the extremes of each element
    over all positive semidefinite matrices that agree with the identified values as they are, each proven by
    duality; the uncertainty of these values is not in them.

    Args:
        identified: What was identified.
        prior: What is expected; it also gives the scales.
        fixed: Parameters held at stated values, result units.
        intervals: Names whose freedom is computed; None: all, empty: none.
        bound: Factor on the larger of prior and reconstruction within which freedom is looked for.
        margin: Smallest eigenvalue in units of the prior.

    Raises:
        InputError: A name that is no parameter, or a bound or margin out of range.
        Infeasible: No positive definite matrices agree with the values or with the constants.
        NoConvergence: The solver found no bound of a parameter's freedom.
    """
    if not (bound > 1 and 0 < margin < 1):
        raise InputError(f"bound = {bound}, margin = {margin}: a bound above 1 and a margin between 0 and 1 expected")
    with one_thread():
        problem = scaled_problem(identified, prior, fixed or {}, margin)
        wanted = indices_of(identified, identified.full if intervals is None else intervals)
        y = closest(problem.cone, problem.space, margin)
        if y is None:
            raise infeasible(problem)
        low, high = np.full((2, len(y)), np.nan)
        low[wanted], high[wanted] = extremes(problem.cone, problem.space, 0.0, _box(problem.cone, y, bound), wanted)
    return _told(problem, y, (low, high), bound)


def _told(problem: Scaled, y: Floats, freedom: tuple[Floats, Floats], bound: float) -> Reconstruction:
    """The reconstruction in result units."""
    cone, identified = problem.cone, problem.identified
    smallest: dict[str, float] = {}
    for block, value in zip(cone.blocks, cone.smallest(y).tolist(), strict=True):
        smallest[block.label] = min(value, smallest.get(block.label, np.inf))
    x = cone.scale * y
    size = np.abs(identified.matrix) @ np.abs(x)
    missed = np.abs(identified.matrix @ x - identified.values) / np.where(size > 0, size, 1.0)
    return Reconstruction(
        identified=identified,
        values=x,
        prior=cone.scale * cone.prior,
        lower=np.minimum(cone.scale * freedom[0], x),
        upper=np.maximum(cone.scale * freedom[1], x),
        bound=bound,
        smallest=MappingProxyType(smallest),
        disagreement=float(missed.max(initial=0.0)),
    )


def identify_positive(
    result: Identification, prior: Prior, *, reduction: Reduction | None = None, margin: float = MARGIN
) -> Positive:
    """Fit again with positive definite matrices: the least increase of chi2, ``|R (matrix x - values)|^2``.

    ``R`` is the triangular factor of the whitened columns of the compliances, with frame, markers and all else free.
    A compliance that the fit held because it is coupled with others may take any value that makes the matrices
    positive definite. The model is taken as linear around the fit, which is exact for compliances.

    Args:
        result: The unconstrained fit.
        prior: Gives the scales of the margin.
        reduction: The reduction that the model comes from, so that the matrices are those before it.
        margin: Smallest eigenvalue in units of the prior.

    Raises:
        NotIdentifiable: No compliance was identified.
        Infeasible: The constants of the model break positive definiteness.
    """
    identified = identified_by_fit(result, reduction)
    with one_thread():
        problem = scaled_problem(identified, prior, {}, _ROOM * margin)
        cone = problem.cone
        y = closest(cone, problem.space, _ROOM * margin)
        if y is not None:
            return Positive(identified, identified.values, frozen(cone.scale * y), 0.0)
        check_constants(problem)
        label = worst(problem, problem.space)
        root = _root(result, identified)
        y, distance = nearest_values(cone, problem.fixed, problem.margin, problem.matrix, identified.values, root)
    moved = replace(identified, values=problem.matrix @ y)
    return Positive(moved, identified.values, frozen(cone.scale * y), distance**2, label)


def _root(result: Identification, identified: Identified) -> Floats:
    """(r, r) factor of the information on the identified values, all other parameters free."""
    names, kept = result.model.names, result.fit.identifiability.kept.tolist()
    own = [names.index(name) for name in identified.names]
    order = [i for i in kept if i not in own] + own
    return triangle([result.fit.upper[:, order]])[-len(own) :, -len(own) :]


def _box(cone: Cone, y: Floats, bound: float) -> tuple[Floats, Floats]:
    """Upper bounds of diagonals, and both bounds of what no matrix bounds; infinite for the rest."""
    largest = bound * np.maximum(np.maximum(np.abs(cone.prior), np.abs(y)), 1.0)
    coupled = np.array([], dtype=np.int64)
    for block in cone.blocks:
        coupled = np.union1d(coupled, block.columns[block.columns >= 0])
    beside = np.setdiff1d(coupled, cone.diagonal)
    upper, lower = largest.copy(), -largest
    upper[beside], lower[beside] = np.inf, -np.inf
    return lower, upper
