"""The small problem of column generation: best weights on a few candidates, by an interior-point method.

Minimises f(M(w)) for M(w) = base + sum_i w_i A_i'A_i over ``sum w = total, 0 < w < upper`` with Newton
steps on the perturbed optimality conditions

    -d_i + lambda - s_i + z_i = 0,   w_i s_i = mu,   (upper_i - w_i) z_i = mu

and a line search on the barrier function (Waechter and Biegler, Math. Program. 106, 2006, without the filter:
the problem is convex). The iterates stay inside, so M stays regular even where the optimum is singular, and
the distance to the optimum is about mu times the number of candidates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError
from scipy.linalg import cho_factor, cho_solve

from doe.blocks import sensitivities
from doe.criteria import Certificate, Criterion
from doe.polytope import largest_sum
from identify.arrays import Floats

__all__ = ["Centre", "Restricted", "solve"]

BOUNDARY = 0.99  # largest part of the way to the boundary in one step
REFINEMENTS = 3
STEPS = 200
PATIENCE = 25  # steps without a better proof before giving up


@dataclass(frozen=True, eq=False)
class Restricted:
    """A design problem on few candidates held in memory, in the coordinates of a row space.

    Attributes:
        criterion: What to minimise.
        blocks: (m, k, p) candidates.
        base: (p, p) information that is there without them.
        upper: (m,) caps, infinite where there is none.
        total: Sum of the weights, below ``sum(upper)``.
    """

    criterion: Criterion
    blocks: Floats
    base: Floats
    upper: Floats
    total: float

    def bound(self, certificate: Certificate, d: Floats) -> float:
        """Lower bound of the criterion on this problem from the sensitivities ``d`` (m,)."""
        fixed = float(np.sum((self.base @ certificate.factor) * certificate.factor))
        return certificate.numerator / (largest_sum(d, self.upper, self.total) + fixed)


@dataclass(frozen=True, eq=False)
class Centre:
    """A point close to the central path.

    Attributes:
        weights: (m,) inside the bounds.
        mu: Barrier parameter.
        certificate: At these weights.
        d: (m,) sensitivities of the certificate.
        bound: Proven lower bound on the restricted problem.
        steps: Newton steps taken.
    """

    weights: Floats
    mu: float
    certificate: Certificate
    d: Floats
    bound: float
    steps: int

    @property
    def gap(self) -> float:
        """``1 - bound/value``."""
        return 1.0 - self.bound / self.certificate.value


def solve(problem: Restricted, start: Floats, mu: float | None, done: Callable[[float, float], bool]) -> Centre:
    """Follow the central path until ``done(value, bound)`` or no more progress.

    Args:
        problem: The restricted problem.
        start: (m,) weights strictly inside.
        mu: Barrier parameter to begin with; None to choose one.
        done: When to stop.

    Raises:
        numpy.linalg.LinAlgError: M is singular at ``start``.
    """
    path = _Path(problem, start, mu)
    best = path.centre(path.local.certificate, 0)
    for step in range(1, STEPS + 1):
        try:
            if done(best.certificate.value, best.bound) or not path.step():
                break
        except LinAlgError:  # rounding: the best point so far is all that can be had
            break
        here = path.centre(path.certificate, step)
        if here.gap < best.gap:
            best = here
        elif step > best.steps + PATIENCE:
            break
    return best


class _Path:
    """The iterates for one restricted problem: weights w, duals s and z, barrier parameter mu."""

    def __init__(self, problem: Restricted, start: Floats, mu: float | None) -> None:
        self.problem = problem
        self.criterion = problem.criterion
        blocks = problem.blocks
        self.grams = np.matmul(blocks.swapaxes(1, 2), blocks).reshape(len(start), -1)
        self.capped = np.isfinite(problem.upper)
        self.w = start
        self.mu = mu or self._first_mu()
        self.level = self.mu  # where on the path the duals really are
        self.s, self.z = self.mu / start, self.mu / (problem.upper - start)
        self.local = self.criterion.local(self.information(start), self.mu, None)
        self.certificate = self.local.certificate

    def centre(self, certificate: Certificate, steps: int) -> Centre:
        """The iterate with its certificate."""
        d = sensitivities(self.problem.blocks, certificate.factor)
        return Centre(self.w, self.mu, certificate, d, self.problem.bound(certificate, d), steps)

    def information(self, w: Floats) -> Floats:
        """``base + sum_i w_i A_i'A_i``."""
        return self.problem.base + self._sum(w)

    def step(self) -> bool:
        """One Newton step with line search; then lower mu if the path is near. False if no progress."""
        w, mu, room = self.w, self.mu, self.problem.upper - self.w
        d = sensitivities(self.problem.blocks, self.local.certificate.factor)
        gradient = -d - mu / w + mu / room
        dw = self._direction(gradient, self.s / w + self.z / room, np.minimum(w, room))
        slope = float(gradient @ dw)
        length = self._search(dw, slope)
        self._move(dw, length)
        dual, reach = self.local.predict(self._sum(dw))
        information = self.information(self.w)
        both = min(length, reach)
        self.level = (1.0 - both) * self.level + both * mu
        self.mu = self.level * (0.15 if both > 0.9 else 0.4 if both > 0.5 else 0.8)
        self.local = self.criterion.local(information, self.mu, dual)
        self.certificate = self.local.certificate if dual is None else self.criterion.certificate(information, dual)
        return length > 0.0

    def _sum(self, w: Floats) -> Floats:
        """``sum_i w_i A_i'A_i``."""
        result: Floats = (w @ self.grams).reshape(self.problem.base.shape)
        return result

    def _first_mu(self) -> float:
        """A barrier parameter of the size of the objective's slope."""
        information = self.information(self.w)
        local = self.criterion.local(information, self.criterion.unit(information), None)
        slope = float(sensitivities(self.problem.blocks, local.certificate.factor) @ self.w)
        return (0.1 if self.criterion.smooth else 1.0) * slope / len(self.w)

    def _direction(self, gradient: Floats, diagonal: Floats, scale: Floats) -> Floats:
        """Newton direction that keeps the sum; ``scale`` makes the system well conditioned."""
        rows = self.local.curvature(self.problem.blocks) * scale[:, None]
        system = rows @ rows.T
        system[np.diag_indices(len(scale))] += diagonal * scale**2
        size = scale / np.sqrt(np.diag(system))
        system *= np.outer(size / scale, size / scale)
        system[np.diag_indices(len(size))] += 1e-15 * len(size)
        factor = cho_factor(system, lower=True, overwrite_a=True, check_finite=False)
        along = cho_solve(factor, size, check_finite=False)
        x, rest = np.zeros(len(size)), -gradient * size
        for _ in range(REFINEMENTS):
            # the products below are more accurate than the factor where the objective is nearly flat
            step = cho_solve(factor, rest, check_finite=False)
            x += step - (size @ step) / (size @ along) * along
            turned = size * x
            rest = -size * (gradient + rows @ (rows.T @ (turned / scale)) / scale + diagonal * turned)
            rest -= (along @ rest) / (size @ along) * size
        direction: Floats = size * x
        direction -= scale * (direction.sum() / scale.sum())  # no drift of the sum by rounding
        return direction

    def _search(self, dw: Floats, slope: float) -> float:
        """Longest of 1, 1/2, ... times the way inside that lowers the barrier function enough; 0 if none."""
        room = self.problem.upper - self.w
        length = min(_reach(self.w, dw), _reach(room[self.capped], -dw[self.capped]))
        now = self._barrier(self.w)
        for _ in range(30):
            if self._barrier(self.w + length * dw) <= now + 1e-4 * length * slope + 1e-13 * abs(now):
                return length
            length *= 0.5
        return 0.0

    def _barrier(self, w: Floats) -> float:
        """Objective and barrier terms; infinite where M is singular."""
        try:
            objective = self.criterion.objective(self.information(w), self.mu)
        except LinAlgError:
            return np.inf
        room = self.problem.upper[self.capped] - w[self.capped]
        return objective - self.mu * float(np.log(w).sum() + np.log(room).sum())

    def _move(self, dw: Floats, length: float) -> None:
        """New weights and, with a step length of their own, new duals."""
        w, mu, room = self.w, self.mu, np.where(self.capped, self.problem.upper - self.w, 1.0)
        ds = mu / w - self.s - self.s / w * dw
        dz = np.where(self.capped, mu / room - self.z + self.z / room * dw, 0.0)
        reach = min(_reach(self.s, ds), _reach(self.z[self.capped], dz[self.capped]))
        self.w = w + length * dw
        room = self.problem.upper - self.w
        self.s = np.clip(self.s + reach * ds, 1e-8 * mu / self.w, 1e8 * mu / self.w)
        self.z = np.clip(self.z + reach * dz, 1e-8 * mu / room, 1e8 * mu / room)


def _reach(values: Floats, change: Floats) -> float:
    """Longest step up to 1 that keeps ``values + step change`` positive."""
    ratio = float(np.max(-change / values, initial=0.0))
    return min(1.0, BOUNDARY / ratio) if ratio > 0.0 else 1.0
