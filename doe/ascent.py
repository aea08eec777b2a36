"""Poses off the grid: observations as a function of what varies continuously, and where one of them tells most.

`ascend` follows the sensitivity ``d(x) = |A(x) R|^2`` uphill from many starts at once. It takes differences of the
blocks themselves, in batches over all starts and variables, so it serves every effect; steps are those of BFGS
within bounds (Nocedal and Wright, Numerical Optimization, 2006, chapters 6 and 16.7).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints, frozen

__all__ = ["DEPTH", "Region", "ascend", "neighbours", "pulled_back"]

STEP = 1e-5  # of a difference, in units of `Region.scale`
DEPTH = 3e3  # what the square of the excess (m) takes off the logarithm of the sensitivity, times this
FARTHEST = 0.4  # longest step, in units of `Region.scale`
SHARES = np.array([1.0, 0.3, 0.08, 0.02])  # of a step, tried together
RISE = 1e-9  # of the logarithm of d: a smaller one is the end
PATIENCE = 2  # steps in a row without a rise
HALVINGS = 16  # of the way back from outside


@dataclass(frozen=True, eq=False)
class Region:
    """What one experiment may be.

    Attributes:
        blocks: ``(x (m, d), choice (m,)) -> (m, k, p)`` whitened rows.
        excess: ``(x, choice) -> (m,)``: 0 where it may be measured, the distance to that (m) where it is known, else
            infinite.
        lower: (d,) lowest values.
        upper: (d,) highest values.
        scale: (d,) size of a usual step of each variable; 0 for one that stays as it is.
    """

    blocks: Callable[[Floats, Ints], Floats]
    excess: Callable[[Floats, Ints], Floats]
    lower: Floats
    upper: Floats
    scale: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in ("lower", "upper", "scale"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def neighbours(region: Region, x: Floats) -> tuple[Floats, Floats]:
    """Points (m, 1 + d, d), each with its neighbours along the variables, and the signed steps (m, d) in `scale`."""
    step = np.where(x + STEP * region.scale > region.upper, -STEP, STEP)
    points = np.repeat(x[:, None], 1 + x.shape[1], axis=1)
    along = np.arange(x.shape[1])
    points[:, 1 + along, along] += step * region.scale
    return points, step


def pulled_back(region: Region, x: Floats, good: Floats, choice: Ints) -> Floats:
    """Points (m, d) on the lines from ``x`` to ``good``, which may be measured: the first that may be too."""
    outer, inner = x, good
    fine = region.excess(x, choice) <= 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (inner + outer)
        holds = (region.excess(middle, choice) <= 0.0)[:, None]
        inner, outer = np.where(holds, middle, inner), np.where(holds, outer, middle)
    return np.asarray(np.where(fine[:, None], x, inner))


def ascend(region: Region, factor: Floats, x: Floats, choice: Ints, *, steps: int = 40) -> tuple[Floats, Floats]:
    """Follow the sensitivity uphill from each start; all starts may be measured.

    Args:
        region: Where to search.
        factor: (p, q) R.
        x: (m, d) starts.
        choice: (m,) their choices, which stay.
        steps: Most steps.

    Returns:
        (m, d) points that may be measured, none with a smaller sensitivity than its start, and their
        sensitivities (m,).
    """
    climb = _Climb(region, factor, x, choice)
    for _ in range(steps):
        if not climb.step():
            break
    climb.settle()
    return climb.best, np.exp(climb.height)


class _Climb:
    """The points on their way.

    Attributes:
        x: (m, d) points, possibly a little outside.
        f: (m,) logarithm of d less the penalty of excess.
        best: (m, d) best points met that may be measured.
        height: (m,) logarithm of d there.
        waiting: (m,) steps in a row without a rise.
    """

    def __init__(self, region: Region, factor: Floats, x: Floats, choice: Ints) -> None:
        self.region, self.factor, self.choice = region, factor, choice
        self.x, self.best = np.array(x), np.array(x)
        self.height = np.full(len(x), -np.inf)
        self.f = self._rate(np.arange(len(x)), self.x)
        count, size = x.shape
        self.inverse = np.tile(0.3 * np.eye(size), (count, 1, 1))  # of minus the curvature, in units of scale
        self.slope: Floats = np.zeros_like(self.x)
        self.fresh = np.ones(count, dtype=bool)  # no slope yet
        self.waiting = np.zeros(count, dtype=np.int64)

    def step(self) -> bool:
        """One step of all points that still rise; False if none does."""
        here = np.flatnonzero(self.waiting < PATIENCE)
        if not len(here):
            return False
        slope = self._slopes(here)
        self._learn(here, slope)
        ahead = self._ahead(here, slope)
        self._try(here, ahead)
        return True

    def settle(self) -> None:
        """Where a point ended outside, take the last good one on the way to it."""
        out = np.flatnonzero(self.f > self.height)
        if len(out):
            self._rate(out, pulled_back(self.region, self.x[out], self.best[out], self.choice[out]))

    def _rate(self, which: Ints, x: Floats) -> Floats:
        """Rate points (m, d) of some climbers by f; the best ones that may be measured are kept."""
        choice = self.choice[which]
        excess = self.region.excess(x, choice)
        logs = np.full(len(x), -np.inf)
        open_ = np.isfinite(excess)
        if open_.any():
            logs[open_] = self._logs(x[open_], choice[open_])
        good = np.flatnonzero((excess <= 0.0) & (logs > self.height[which]))
        good = good[np.argsort(logs[good], kind="stable")]  # where several are of one start, the last one stays
        self.height[which[good]], self.best[which[good]] = logs[good], x[good]
        return np.asarray(logs - DEPTH * np.where(open_, excess, 0.0) ** 2)

    def _logs(self, x: Floats, choice: Ints) -> Floats:
        """Logarithms of the sensitivities."""
        rows = self.region.blocks(x, choice) @ self.factor
        return np.asarray(np.log(np.maximum(np.einsum("mkq,mkq->m", rows, rows), 1e-300)))

    def _slopes(self, which: Ints) -> Floats:
        """Differences of f, (m, d), in units of scale."""
        points, step = neighbours(self.region, self.x[which])
        count, around, size = points.shape
        choice = np.repeat(self.choice[which], around)
        flat = points.reshape(-1, size)
        excess = self.region.excess(flat, choice)
        f = self._logs(flat, choice) - DEPTH * np.where(np.isfinite(excess), excess, 0.0) ** 2
        f = f.reshape(count, around)
        slope = (f[:, 1:] - f[:, :1]) / step
        return np.asarray(np.where(self.region.scale > 0.0, slope, 0.0))

    def _learn(self, which: Ints, slope: Floats) -> None:
        """Update the curvature by the change of the slopes since the last step."""
        known = which[~self.fresh[which]]
        new = slope[~self.fresh[which]]
        if len(known):
            scale = np.where(self.region.scale > 0.0, self.region.scale, 1.0)
            s = (self.x[known] - self.last[known]) / scale
            y = self.slope[known] - new  # of -f
            bend = np.einsum("md,md->m", s, y)
            sane = bend > 1e-10 * np.linalg.norm(s, axis=1) * np.linalg.norm(y, axis=1)
            rho = np.where(sane, 1.0 / np.where(sane, bend, 1.0), 0.0)
            left = np.eye(s.shape[1]) - rho[:, None, None] * s[:, :, None] * y[:, None, :]
            moved = left @ self.inverse[known] @ left.swapaxes(1, 2) + rho[:, None, None] * s[:, :, None] * s[:, None]
            self.inverse[known] = np.where(sane[:, None, None], moved, self.inverse[known])
        self.slope[which] = slope
        self.fresh[which] = False

    def _ahead(self, which: Ints, slope: Floats) -> Floats:
        """Steps (m, d) in the variables themselves: along the free ones, not too long."""
        x, region = self.x[which], self.region
        edge = 1e-12 * (1.0 + np.abs(x))
        stuck = ((x >= region.upper - edge) & (slope > 0.0)) | ((x <= region.lower + edge) & (slope < 0.0))
        slope = np.where(stuck, 0.0, slope)
        step = np.where(stuck, 0.0, np.einsum("mij,mj->mi", self.inverse[which], slope))
        against = np.einsum("md,md->m", step, slope) <= 0.0
        step = np.where(against[:, None], 0.3 * slope, step)
        self.inverse[which[against]] = 0.3 * np.eye(x.shape[1])
        length = np.linalg.norm(step, axis=1)
        return np.asarray(step * np.minimum(1.0, FARTHEST / np.maximum(length, 1e-300))[:, None] * region.scale)

    def _try(self, which: Ints, ahead: Floats) -> None:
        """Take the whole step where it rises, else the best part of it."""
        self.last = self.x.copy()
        whole = np.clip(self.x[which] + ahead, self.region.lower, self.region.upper)
        f = self._rate(which, whole)
        up = f > self.f[which]
        rest = np.flatnonzero(~up)
        if len(rest):
            parts = self.x[which[rest], None] + SHARES[1:, None] * ahead[rest, None]
            parts = np.clip(parts, self.region.lower, self.region.upper)
            flat = parts.reshape(-1, parts.shape[2])
            rates = self._rate(np.repeat(which[rest], len(SHARES) - 1), flat).reshape(len(rest), -1)
            best = np.argmax(rates, axis=1)
            whole[rest], f[rest] = parts[np.arange(len(rest)), best], rates[np.arange(len(rest)), best]
        rises = f > self.f[which] + RISE
        self.waiting[which] = np.where(rises, 0, self.waiting[which] + 1)
        better = f > self.f[which]
        self.x[which[better]], self.f[which[better]] = whole[better], f[better]
        failed = which[~rises]
        self.inverse[failed] = 0.05 * np.eye(ahead.shape[1])
