"""The fewest experiments that keep a stated tolerance at the test poses."""

from __future__ import annotations

import functools
import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from doe.accuracy import jitter_covariance
from doe.approximate import ApproximateDesign, approximate_design
from doe.choice import Choice, choose
from doe.guard import Guard, search
from doe.information import covariance_of, information_of
from doe.losses import after_losses
from doe.observations import target_rows
from doe.pool import AnyPool, Pool
from doe.reach import Reach
from identify.arrays import Floats
from identify.error_radius import radii
from identify.errors import Infeasible, NoConvergence, NotIdentifiable
from identify.units import MM

__all__ = ["fewest", "sufficient"]

_MOST = 2000  # experiments


class Chosen(Protocol):
    """A plan of some number of experiments."""

    @property
    def own(self) -> Floats:
        """(n, k, p) blocks of the plan."""


_C = TypeVar("_C", bound=Chosen)


def sufficient(pool: Pool, seed: int, reach: Reach | None) -> Choice:
    """The plan with the fewest experiments whose total error keeps the tolerance at every test pose.

    Args:
        pool: The candidates.
        seed: Of the search.
        reach: All poses, or None to stay on the candidates.

    Raises:
        Infeasible: The robot's own repeatability forbids it, or more experiments are needed than may be made.
    """
    jitter = functools.partial(jitter_covariance, pool.observer.study)
    return fewest(pool, seed, jitter, lambda count: choose(pool, count, seed, reach))


def fewest(pool: AnyPool, seed: int, jitter: Callable[[], Floats], choice_of: Callable[[int], _C]) -> _C:
    """The same for the candidates of one arm or of two.

    Args:
        pool: The candidates.
        seed: Seed of the search.
        jitter: ``() -> (t, 3, 3)`` covariance of the test poses from the robots' own jitter, mm^2.
        choice_of: ``(n) -> plan`` of n experiments.

    Raises:
        Infeasible: Repeatability forbids it, or more experiments are needed than may be made.
    """
    aim, settings = pool.objective, pool.observer.settings
    contract = _contract(pool, jitter)
    least = math.ceil(aim.size / pool.blocks.shape[1]) if pool.prior is None else 0
    most = contract.most

    def suffices(own: Floats) -> bool:
        return contract.kept(after_losses(own, settings.losses, pool.prior))

    def suffices_on_the_grid(count: int) -> bool:
        try:
            chosen = search(pool, count, seed, Guard(), effort="low")
        except NotIdentifiable:  # too few
            return False
        return suffices(pool.blocks[chosen])

    @functools.cache  # the last steps come by the same numbers again
    def chosen(count: int) -> _C | None:
        try:
            return choice_of(count)
        except (NotIdentifiable, Infeasible):  # too few
            return None

    low, high = least, min(least, most)
    while not suffices_on_the_grid(high):
        if high == most:
            raise contract.too_many()
        low, high = high + 1, min(max(2 * high, 1), most)
    count = bisect_left(range(high), True, lo=low, key=suffices_on_the_grid)
    found = chosen(count)
    if found is not None and count:  # refinement may take fewer, a guard more: the first plan tells about how many
        count = min(bisect_left(range(most), True, lo=least, key=contract.kept_by_usual(found.own)), most)
        found = chosen(count)
    while found is None or not suffices(found.own):
        count += 1
        if count > most:
            raise contract.too_many()
        found = chosen(count)
    while count > least:
        count -= 1
        fewer = chosen(count)
        if fewer is None or not suffices(fewer.own):
            break
        found = fewer
    return found


@dataclass(frozen=True, eq=False)
class _Contract:
    """The tolerance and what decides whether it is kept.

    Attributes:
        pool: The candidates.
        rows: (t, 3, p) error per unit of each parameter, mm.
        jitter: (t, 3, 3) of the robot's own jitter, mm^2.
    """

    pool: AnyPool
    rows: Floats
    jitter: Floats

    @property
    def most(self) -> int:
        """Experiments that a plan may have."""
        return _MOST if self.pool.observer.settings.repeats else min(_MOST, len(self.pool.blocks))

    @property
    def tolerance(self) -> float:
        """Radius that is asked for, mm."""
        return (self.pool.observer.settings.tolerance or 0.0) / MM

    def radius(self, information: Floats) -> float:
        """Largest radius of the total error at a test pose, for any of the (L, p, p) informations, mm."""
        if not all(np.isfinite(self.pool.objective.value(one, "test_pose")) for one in information):
            return math.inf
        covariance = np.stack([covariance_of(one) for one in information])[:, None]
        total = self.rows @ covariance @ self.rows.swapaxes(1, 2) + self.jitter
        confidence = self.pool.observer.settings.confidence
        return float(radii(total.reshape(-1, 3, 3), confidence).max(initial=0.0))

    def kept(self, information: Floats) -> bool:
        """True if each of the (L, p, p) informations keeps the tolerance; false without any, for all was lost."""
        return len(information) > 0 and self.radius(information) <= self.tolerance

    def kept_by_usual(self, own: Floats) -> Callable[[int], bool]:
        """``n -> bool``: would n experiments of the usual worth of these (m, k, p) keep it after losses?"""
        each, losses, prior = information_of(own) / len(own), self.pool.observer.settings.losses, self.pool.prior
        start = np.zeros_like(each) if prior is None else prior
        return lambda count: self.kept((start + max(count - losses, 0) * each)[None])

    def too_many(self) -> Infeasible:
        """The error for a tolerance that no allowed number of experiments keeps."""
        asked = self.pool.observer
        return Infeasible(
            f"{asked.path}: [plan] tolerance_mm = {self.tolerance:g} needs more than {self.most} experiments; "
            f"{self.best()}. Allow a larger tolerance, heavier loads or a better instrument"
        )

    def best(self) -> str:
        """In words, the tolerance that the best plan of the largest size keeps."""
        weights, most = _best_weights(self.pool, self.most), self.most
        used = np.flatnonzero(weights)
        rows = self.pool.blocks[used] * np.sqrt(most * weights[used])[:, None, None]
        reached = self.radius(self.pool.information(rows)[None])
        return f"the smallest that {most} experiments keep is about {reached:.3g} mm"


def _best_weights(pool: AnyPool, count: int) -> Floats:
    """(N,) weights of the relaxed plan of ``count`` experiments."""
    aim, share = pool.objective, None if pool.prior is None else pool.prior / count
    cap = None if pool.observer.settings.repeats else 1.0 / count
    try:
        found = approximate_design(
            pool.blocks, aim.target(), criterion=aim.criterion, max_weight=cap, prior=share, tol=1e-4
        )
    except NoConvergence as error:  # good enough for a message
        if not isinstance(error.best, ApproximateDesign):
            raise
        found = error.best
    return found.weights


def _contract(pool: AnyPool, jitter: Callable[[], Floats]) -> _Contract:
    """The tolerance with what decides on it.

    Raises:
        Infeasible: The robot's own repeatability forbids it.
    """
    asked = pool.observer
    contract = _Contract(pool, target_rows(asked, pool.known) / MM, jitter())
    confidence = asked.settings.confidence
    own = float(radii(contract.jitter, confidence).max())
    if own >= contract.tolerance:
        raise Infeasible(
            f"{asked.path}: [plan] tolerance_mm = {contract.tolerance:g}: the robot's own pose jitter alone gives "
            f"{own:.3g} mm at a test pose with confidence {confidence:g}; no number of experiments removes it, and "
            f"{contract.best()}"
        )
    return contract
