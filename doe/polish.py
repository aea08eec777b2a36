"""Move all experiments of a plan at once off the grid, whatever their blocks are made of.

Minimises the criterion over everything that varies continuously, by L-BFGS-B (Byrd, Lu, Nocedal and Zhu 1995) with
differences of each experiment's own block; what lies outside costs a penalty that grows with the distance. For blocks
with symbolic derivatives `doe.refine` does the same with hard constraints. `descend` takes experiments that share some
of what varies, such as a load that hangs at several of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.ascent import Region, neighbours, pulled_back
from doe.criteria import Criterion, Mean
from doe.problem import make_problem
from identify.arrays import Floats, Ints
from identify.errors import NotIdentifiable
from identify.threads import one_thread

__all__ = ["descend", "polish"]

ASIDE = 0.002  # of the scale: the search starts this far from the plan, so that it leaves saddle points and parts twins
SMOOTHING = (1e-2, 1e-3)  # of the criteria that are not smooth, one run each
DEPTHS = (1e2, 1e4)  # what the square of the excess (m) costs in units of the logarithm, one run each
FORBIDDEN = 10.0  # what an experiment costs that may not be measured at all, in units of the logarithm
ITERATIONS = 200
SHARES = 0.5 ** np.arange(6)


def polish(
    region: Region, x: Floats, choice: Ints, target: Floats | None, criterion: str, prior: Floats | None = None
) -> tuple[Floats, int]:
    """A better plan near a given one.

    Args:
        region: What may be measured.
        x: (n, d) what varies continuously; all may be measured.
        choice: (n,) what does not; it stays.
        target: As for `doe.exact.exact_design`.
        criterion: test_pose, A, D, E or G.
        prior: (p, p) information that is there already, or None.

    Returns:
        (n, d) of a plan that may be measured and is not worse, and the number of iterations.
    """
    with one_thread():
        try:
            goal = _goal(region, x, choice, target, criterion, prior)
        except NotIdentifiable:  # nothing to follow
            return x, 0
        found, steps = goal.run(x)
        before = goal.value(x)
        found = pulled_back(region, found, x, choice)
        for share in SHARES:
            moved = np.clip(x + share * (found - x), region.lower, region.upper)
            if (region.excess(moved, choice) <= 0.0).all() and goal.value(moved) < before:
                return moved, steps
    return x, steps


def descend(
    region: Region,
    x: Floats,
    choice: Ints,
    target: Floats | None,
    criterion: str,
    shared: Ints,
    prior: Floats | None = None,
) -> tuple[Floats, int]:
    """Where a search from a plan leads if some of what varies is shared by several experiments.

    Args:
        region: What may be measured.
        x: (n, d) what varies continuously; all may be measured.
        choice: (n,) what does not.
        target: As for `doe.exact.exact_design`.
        criterion: test_pose, A, D, E or G.
        shared: (n, d) variables of one number stay equal; they must have equal bounds and scales.
        prior: (p, p) information that is there already, or None.

    Returns:
        (n, d) of a plan that may be a little outside or worse, and the number of iterations.
    """
    with one_thread():
        try:
            return _goal(region, x, choice, target, criterion, prior, shared).run(x)
        except NotIdentifiable:  # nothing to follow
            return x, 0


def _goal(
    region: Region,
    x: Floats,
    choice: Ints,
    target: Floats | None,
    criterion: str,
    prior: Floats | None,
    shared: Ints | None = None,
) -> _Goal:
    """The criterion in coordinates where the information of the given plan and the prior is about I."""
    problem = make_problem(region.blocks(x, choice), target, criterion, None, prior, None)
    numbers = np.arange(x.size) if shared is None else shared.ravel()
    _, first, place = np.unique(numbers, return_index=True, return_inverse=True)
    return _Goal(region, choice, problem.criterion, problem.space.basis, problem.prior, first, place.ravel())


@dataclass(frozen=True, eq=False)
class _Goal:
    """The criterion of a plan as a function of what varies.

    Attributes:
        region: What may be measured.
        choice: (n,).
        criterion: In the coordinates of ``basis``.
        basis: (p, rank).
        prior: (rank, rank) information that is there already, in these coordinates.
        first: (z,) where each variable first stands in a plan, flattened.
        place: (n d,) variable of each entry of a plan.
    """

    region: Region
    choice: Ints
    criterion: Criterion
    basis: Floats
    prior: Floats
    first: Ints
    place: Ints

    def value(self, x: Floats) -> float:
        """The criterion of a plan (n, d); infinite where its information is singular."""
        try:
            return self.criterion.value(self._information(self.region.blocks(x, self.choice) @ self.basis))
        except np.linalg.LinAlgError:
            return float("inf")

    def run(self, x: Floats) -> tuple[Floats, int]:
        """L-BFGS-B from a plan: where it ends (n, d), and its iterations."""
        from scipy.optimize import Bounds, minimize

        scale = np.where(self.region.scale > 0.0, self.region.scale, 1.0)
        ends = (np.tile(ends / scale, len(x))[self.first] for ends in (self.region.lower, self.region.upper))
        bounds = Bounds(*ends)
        aside = np.random.default_rng(0).uniform(-ASIDE, ASIDE, x.shape) * self.region.scale
        at, steps = self._whole(self._own(np.clip(x + aside, self.region.lower, self.region.upper))), 0
        for share, depth in zip((0.0, 0.0) if self.criterion.smooth else SMOOTHING, DEPTHS, strict=True):
            unit = self.criterion.unit(self._information(self.region.blocks(at, self.choice) @ self.basis))
            ended = minimize(
                lambda own, m=share * unit, u=unit, d=depth: self._rated(self._whole(own) * scale, m, u, d),
                self._own(at / scale),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": ITERATIONS, "maxcor": 20, "ftol": 1e-10, "gtol": 1e-7},
            )
            at, steps = self._whole(ended.x) * scale, steps + int(ended.nit)
        return at, steps

    def _own(self, x: Floats) -> Floats:
        """(z,) variables of a plan (n, d)."""
        own: Floats = x.ravel()[self.first]
        return own

    def _whole(self, own: Floats) -> Floats:
        """Plan (n, d) of variables (z,)."""
        x: Floats = own[self.place].reshape(len(self.choice), -1)
        return x

    def _rated(self, x: Floats, mu: float, unit: float, depth: float) -> tuple[float, Floats]:
        """What is minimised, and its derivative (z,) in units of scale; ``unit`` is the size of the objective."""
        points, step = neighbours(self.region, x)
        count, around, size = points.shape
        choice = np.repeat(self.choice, around)
        flat = points.reshape(-1, size)
        rows = (self.region.blocks(flat, choice) @ self.basis).reshape(count, around, -1, self.basis.shape[1])
        excess = self.region.excess(flat, choice).reshape(count, around)
        penalty = np.minimum(depth * excess**2, FORBIDDEN)
        own = rows[:, 0]
        try:
            information = self._information(own)
            local = self.criterion.local(information, mu, None)
            height = self.criterion.objective(information, mu)
        except np.linalg.LinAlgError:
            return 1e3, np.zeros(len(self.first))
        if isinstance(self.criterion, Mean):
            height, unit = float(np.log(height)), height
        else:
            height /= unit
        pull = -2.0 / unit * (own @ local.certificate.factor) @ local.certificate.factor.T
        slope = np.einsum("nkp,njkp->nj", pull, rows[:, 1:] - own[:, None])
        slope = (slope + penalty[:, 1:] - penalty[:, :1]) / step
        slope = np.where(self.region.scale > 0.0, slope, 0.0)
        total = np.bincount(self.place, weights=slope.ravel()).astype(np.float64)
        return height + float(penalty[:, 0].sum()), total

    def _information(self, rows: Floats) -> Floats:
        """Of blocks (n, k, rank) and the prior, (rank, rank)."""
        flat = rows.reshape(-1, rows.shape[2])
        total: Floats = flat.T @ flat + self.prior
        return total
