"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

import logging
import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from doe.accuracy import accuracy, jitter_covariance, radius
from doe.approximate import approximate_design
from doe.candidates import Candidates, candidates, rounded
from doe.exact import exact_design
from doe.feasible import check, joint_range
from doe.objective import Objective, objective
from doe.observations import Observer, identifiable, keep_columns, observer, target_rows
from doe.refine import Refinement, refine
from identify.arrays import Floats, Ints
from identify.errors import Infeasible
from identify.identifiability import Identifiability
from identify.study import Study
from identify.units import MM

__all__ = ["Bound", "Plan", "Pool", "bound_of", "build_pool", "plan"]

_GUARD_ROUNDS = 12
_MOST = 2000  # experiments

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates with their blocks.

    Attributes:
        observer: How poses become blocks.
        candidates: The feasible candidates.
        known: Parameters that they can identify.
        blocks: (N, k, p) on the identifiable parameters.
        objective: The criterion on these parameters.
    """

    observer: Observer
    candidates: Candidates
    known: Identifiability
    blocks: Floats
    objective: Objective


@dataclass(frozen=True, eq=False)
class Bound:
    """A value with its proven lower bound, for one number of experiments.

    Attributes:
        value: Value of the criterion.
        bound: No plan of as many experiments on the same candidates is better than this.
    """

    value: float
    bound: float

    @property
    def efficiency(self) -> float:
        """Bound / value, at most 1."""
        return min(self.bound / self.value, 1.0) if np.isfinite(self.value) else 0.0


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses and loads to measure.

    Attributes:
        pool: What it was chosen from.
        q: (n, joints) joint values of the visits, rad or m.
        visit_loads: (n, L) loads of their shots.
        grid: Value and bound before refinement.
        final: Value and bound of this plan, on the candidates and its own poses.
        information: (p, p) of the identifiable parameters.
        refinement: What the refinement did, or None.
        notes: What the user should know.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    grid: Bound
    final: Bound
    information: Floats
    refinement: Refinement | None
    notes: tuple[str, ...]

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan(study: Study, *, seed: int = 0) -> Plan:
    """Pick the poses and loads that minimise the criterion of the study.

    Candidates are drawn over the joint limits; column generation gives the best relaxed design and its
    proven bound; exchange and local search make it a plan of n experiments; the joint angles are then
    moved off the grid.

    Args:
        study: The study; its ``[plan]`` says what is wanted.
        seed: Seed of candidates and search.

    Raises:
        NotIdentifiable: The criterion needs what no candidate shows, or n is too small.
        Infeasible: No candidate keeps to the constraints, or no plan meets the tolerance.
    """
    pool = build_pool(study, seed)
    count = study.plan.poses or _smallest(pool, seed)
    log.info("%d candidates, %d parameters; searching %d experiments", len(pool.blocks), pool.objective.size, count)
    chosen, limits, notes = _guarded_search(pool, count, seed)
    q = pool.candidates.q[pool.candidates.pose[chosen]]
    loads = pool.candidates.visit_loads[chosen]
    information = _information(pool.blocks[chosen])
    aim, repeats = pool.objective, study.plan.repeats
    grid = bound_of(aim, count, pool.blocks, pool.blocks[:0], aim.value(information), repeats=repeats)
    final, refinement = grid, None
    if study.plan.refine:
        log.info("refining the joint angles of %d experiments", count)
        refinement = _refine(pool, q, loads, limits)
        refined = rounded(study, refinement.q)
        own = pool.observer.blocks(refined, loads)[:, :, pool.known.kept]
        better = aim.value(_information(own))
        if better < grid.value:
            q, information = refined, _information(own)
            final = bound_of(aim, count, pool.blocks, own, better, repeats=repeats)
    return Plan(pool, q, loads, grid, final, information, refinement, notes)


def _refine(pool: Pool, q: Floats, loads: Ints, limits: Floats | None) -> Refinement:
    """Move the joint angles within limits, floor and the parameters' limits; self-collision is checked on arrival."""
    study = pool.observer.study
    lower, upper = joint_range(study)
    return refine(
        pool.observer,
        q,
        loads,
        pool.known.kept,
        pool.objective.target(),
        criterion=pool.objective.criterion,
        lower=lower,
        upper=upper,
        floor=study.constraints.floor,
        max_std=limits,
        allowed=lambda moved: check(study, rounded(study, moved), loads).ok,
    )


def build_pool(study: Study, seed: int) -> Pool:
    """Candidates, their blocks and the objective."""
    chosen = candidates(study, seed=seed)
    watching = observer(study)
    blocks = watching.blocks(chosen.q[chosen.pose], chosen.visit_loads)
    known = identifiable(blocks)
    return Pool(
        watching,
        chosen,
        known,
        keep_columns(blocks, known.kept),
        objective(watching, known, study.plan.criterion),
    )


def bound_of(aim: Objective, count: int, pool: Floats, own: Floats, value: float, *, repeats: bool) -> Bound:
    """Proven lower bound for ``count`` experiments.

    Args:
        aim: The criterion.
        count: Number of experiments.
        pool: (N, k, p) blocks of the candidates.
        own: (n, k', p) blocks of the plan itself, which count as candidates too.
        value: What the plan reaches.
        repeats: One candidate may be measured several times.
    """
    blocks = joined(pool, own)
    cap = None if repeats else 1.0 / count
    relaxed = approximate_design(blocks, aim.target(), criterion=aim.criterion, max_weight=cap)
    return Bound(value, min(relaxed.bound / count, value))


def joined(first: Floats, second: Floats) -> Floats:
    """Blocks of both, the shorter ones filled up with rows of zeros."""
    if not len(first) or not len(second):
        return second if len(second) else first
    rows = max(first.shape[1], second.shape[1])
    blocks = np.zeros((len(first) + len(second), rows, first.shape[2]))
    blocks[: len(first), : first.shape[1]] = first
    blocks[len(first) :, : second.shape[1]] = second
    return blocks


def _smallest(pool: Pool, seed: int) -> int:
    """Smallest number of experiments whose total error keeps the tolerance at every test pose.

    Raises:
        Infeasible: The robot's own repeatability forbids it, or more than `_MOST` experiments are needed.
    """
    study, aim = pool.observer.study, pool.objective
    rows = target_rows(pool.observer, pool.known) / MM
    tolerance = (study.plan.tolerance or 0.0) / MM
    own = max(radius(jitter, study.plan.confidence) for jitter in jitter_covariance(study))
    if own >= tolerance:
        raise Infeasible(
            f"{study.path}: [plan] tolerance_mm = {tolerance:g}: the robot's own pose jitter alone gives {own:.3g} mm "
            f"at a test pose with confidence {study.plan.confidence:g}"
        )

    def meets(count: int) -> bool:
        chosen = _search(pool, aim.target("test_pose"), count, seed, criterion="test_pose", effort="low")
        reached = accuracy(study, rows, covariance_of(_information(pool.blocks[chosen])))
        worst = max(radius(total, study.plan.confidence) for total in reached.covariance + reached.jitter)
        return worst <= tolerance

    least = high = math.ceil(aim.size / pool.blocks.shape[1])
    while not meets(high):
        least, high = high + 1, 2 * high
        if high > _MOST:
            raise Infeasible(
                f"{study.path}: [plan] tolerance_mm = {tolerance:g} needs more than {_MOST} experiments; allow a "
                "larger tolerance, heavier loads or a better instrument"
            )
    return bisect_left(range(high), True, lo=least, key=meets)


def covariance_of(information: Floats) -> Floats:
    """Inverse on unit columns; infinite variances where the matrix is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return np.diag(np.where(scale > 0, np.nan, np.inf))
    inverse: Floats = np.linalg.inv(information / scale / scale[:, None]) / scale / scale[:, None]
    return inverse


def standard_deviations(information: Floats) -> Floats:
    """(p,) standard deviations; infinite where the information is singular."""
    variance = np.diag(covariance_of(information))
    return np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, np.inf))


def _information(blocks: Floats) -> Floats:
    rows = blocks.reshape(-1, blocks.shape[2])
    product: Floats = rows.T @ rows
    return product


def _search(pool: Pool, target: Floats, count: int, seed: int, *, criterion: str, effort: str = "normal") -> Ints:
    """Indices of the chosen candidates, repeats included."""
    found = exact_design(
        pool.blocks,
        target,
        count,
        criterion=criterion,
        repeats=pool.observer.study.plan.repeats,
        effort=effort,
        seed=seed,
    )
    return np.repeat(np.arange(len(found.counts)), found.counts)


def _guarded_search(pool: Pool, count: int, seed: int) -> tuple[Ints, Floats | None, tuple[str, ...]]:
    """Search; where the plan sees little but the test poses, weigh the parameters' own variances in.

    Returns:
        Chosen candidates, the largest standard deviations allowed (p,) or None, and notes.
    """
    aim = pool.objective
    study = pool.observer.study
    chosen = _search(pool, aim.target(), count, seed, criterion=aim.criterion)
    if aim.criterion not in {"test_pose", "G"}:
        return chosen, None, ()
    best = standard_deviations(
        _information(pool.blocks[_search(pool, np.eye(aim.size), count, seed, criterion="A", effort="low")])
    )
    limit = study.plan.max_std_percent / 100.0
    ratio = _worst_ratio(pool, chosen, best)
    if ratio.max() <= limit:
        return chosen, limit * best, ()
    names = [pool.observer.model.names[index] for index in pool.known.kept]
    worst = int(np.argmax(ratio))
    unguarded = aim.value(_information(pool.blocks[chosen]))
    share = 1e-4 * max(unguarded if np.isfinite(unguarded) else 1.0, 1e-300) / aim.size
    for _ in range(_GUARD_ROUNDS):
        target = aim.guarded(best, share)
        chosen = _search(pool, target, count, seed, criterion=aim.criterion, effort="low")
        if _worst_ratio(pool, chosen, best).max() <= limit:
            value = aim.value(_information(pool.blocks[chosen]))
            seen = (
                f"{ratio[worst]:.3g} times worse than a plan for the parameters"
                if np.isfinite(ratio[worst])
                else "not at all"
            )
            cost = f"costs {100 * (value / unguarded - 1):.2g} %" if np.isfinite(unguarded) else "keeps it identifiable"
            note = (
                f"the best plan for the test poses alone would tell {names[worst]} {seen}; "
                f"max_std_percent = {study.plan.max_std_percent:g} {cost}"
            )
            return chosen, limit * best, (note,)
        share *= 8.0
    raise Infeasible(
        f"{study.path}: [plan] max_std_percent = {study.plan.max_std_percent:g} cannot be met with {count} poses: "
        f"{names[worst]} stays {ratio[worst]:.3g} times worse than in the best plan for the parameters; allow more"
    )


def _worst_ratio(pool: Pool, chosen: Ints, best: Floats) -> Floats:
    """(p,) standard deviations of a plan relative to the best plan for the parameters."""
    ratio: Floats = standard_deviations(_information(pool.blocks[chosen])) / best
    return ratio
