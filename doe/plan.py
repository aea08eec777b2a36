"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

import logging
import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doe.accuracy import accuracy, jitter_covariance, radius
from doe.approximate import ApproximateDesign, approximate_design
from doe.candidates import Candidates, candidates, rounded
from doe.exact import exact_design
from doe.feasible import check, joint_range
from doe.objective import Objective, objective
from doe.observations import Observer, identifiable, keep_columns, observer, target_rows
from doe.refine import Refinement, refine
from identify.arrays import Floats, Ints
from identify.errors import Infeasible, NoConvergence, NotIdentifiable
from identify.identifiability import Identifiability
from identify.study import Study
from identify.units import MM

__all__ = ["Bound", "Plan", "Pool", "bound_of", "build_pool", "plan"]

_GUARD_ROUNDS = 12
_HARDLY = 1e-3  # loss of the criterion that a plan with fewer different poses is worth
_MOST = 2000  # experiments
_USUAL_PERCENT = 300.0  # the default of max_std_percent; beyond it a plan says what it does not see
_SAME = 1e-9  # blocks that differ by less are those of one pose
_SINGULAR = 1e-15  # smallest over largest eigenvalue on unit columns

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
    aim, repeats = pool.objective, study.plan.repeats
    choice = _sufficient(pool, seed) if study.plan.poses is None else _choose(pool, study.plan.poses, seed)
    count, none = len(choice.q), pool.blocks[:0]
    grid = bound_of(aim, count, pool.blocks, none, aim.value(_information(choice.grid)), repeats=repeats)
    information = _information(choice.own)
    final = grid
    if choice.own is not choice.grid:
        final = bound_of(aim, count, pool.blocks, choice.own, aim.value(information), repeats=repeats)
    return Plan(pool, choice.q, choice.visit_loads, grid, final, information, choice.refinement, choice.notes)


@dataclass(frozen=True, eq=False)
class _Choice:
    """A plan that nothing is proven about yet.

    Attributes:
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads.
        grid: (n, k, p) blocks before refinement.
        own: (n, k, p) blocks of the plan; ``grid`` itself if refinement gained nothing.
        refinement: What the refinement did, or None.
        notes: What the user should know.
    """

    q: Floats
    visit_loads: Ints
    grid: Floats
    own: Floats
    refinement: Refinement | None
    notes: tuple[str, ...]


def _choose(pool: Pool, count: int, seed: int) -> _Choice:
    """Search ``count`` experiments on the grid and refine them."""
    study, aim = pool.observer.study, pool.objective
    log.info("%d candidates, %d parameters; searching %d experiments", len(pool.blocks), aim.size, count)
    chosen, best, notes = _guarded_search(pool, count, seed)
    most = None if best is None else study.plan.max_std_percent / 100.0 * best
    q, loads = pool.candidates.visit_q[chosen], pool.candidates.visit_loads[chosen]
    grid = own = pool.blocks[chosen]
    refinement = None
    if study.plan.refine:
        log.info("refining the joint angles of %d experiments", count)
        for limit in (None, most):  # most plans keep the limit without being told
            refinement = _refine(pool, q, loads, limit)
            refined = _together(pool, chosen, rounded(study, refinement.q), loads)
            moved = pool.observer.blocks(refined, loads)[:, :, pool.known.kept]
            if most is None or (standard_deviations(_information(moved)) <= most * (1.0 + 1e-6)).all():
                break
        if aim.value(_information(moved)) < aim.value(_information(grid)):
            q, own = refined, moved
    if best is not None:
        notes = (*notes, *_blind_spot(pool, own, best))
    return _Choice(q, loads, grid, own, refinement, notes)


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


def _together(pool: Pool, chosen: Ints, q: Floats, loads: Ints) -> Floats:
    """Joint values in which repeats of one candidate that hardly parted stand at one pose again."""
    value = _value(pool, q, loads)
    for candidate in np.unique(chosen):
        visits = np.flatnonzero(chosen == candidate)
        tidy = q.copy()
        tidy[visits] = q[visits[0]]
        if len(visits) > 1 and _value(pool, tidy, loads) <= value * (1.0 + _HARDLY):
            q = tidy
    return q


def _value(pool: Pool, q: Floats, loads: Ints) -> float:
    """Criterion of visits, by the exact blocks."""
    return pool.objective.value(_information(pool.observer.blocks(q, loads)[:, :, pool.known.kept]))


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
    blocks = joined(pool, own[~_among(pool, own, repeats=repeats)])
    cap = None if repeats else 1.0 / count
    try:
        relaxed = approximate_design(blocks, aim.target(), criterion=aim.criterion, max_weight=cap)
    except NoConvergence as error:  # its bound is proven all the same, only not the tightest
        if not isinstance(error.best, ApproximateDesign):
            raise
        relaxed = error.best
    return Bound(value, min(relaxed.bound / count, value))


def _among(pool: Floats, own: Floats, *, repeats: bool) -> np.ndarray:
    """(n,) True for blocks of ``own`` that are candidates already; without repeats a candidate stands for one only."""
    known = np.zeros(len(own), dtype=bool)
    if not len(pool) or own.shape[1:] != pool.shape[1:]:
        return known
    size, sizes = (np.einsum("nki,nki->n", blocks, blocks) for blocks in (own, pool))
    free = np.ones(len(pool), dtype=bool)
    for index, block in enumerate(own):
        near = np.flatnonzero(free & (np.abs(sizes - size[index]) <= _SAME * size[index]))
        same = near[np.abs(pool[near] - block).max(axis=(1, 2), initial=0.0) <= _SAME * size[index] ** 0.5]
        known[index] = len(same) > 0
        free[same[:1]] = repeats
    return known


def joined(first: Floats, second: Floats) -> Floats:
    """Blocks of both, the shorter ones filled up with rows of zeros."""
    if not len(first) or not len(second):
        return second if len(second) else first
    rows = max(first.shape[1], second.shape[1])
    blocks = np.zeros((len(first) + len(second), rows, first.shape[2]))
    blocks[: len(first), : first.shape[1]] = first
    blocks[len(first) :, : second.shape[1]] = second
    return blocks


def _sufficient(pool: Pool, seed: int) -> _Choice:
    """The plan with the fewest experiments whose total error keeps the tolerance at every test pose.

    Raises:
        Infeasible: The robot's own repeatability forbids it, or more experiments are needed than may be made.
    """
    aim, settings = pool.objective, pool.observer.study.plan
    least = math.ceil(aim.size / pool.blocks.shape[1])
    most = _MOST if settings.repeats else min(_MOST, len(pool.blocks))
    keeps = _tolerance_test(pool)

    def keeps_on_the_grid(count: int) -> bool:
        try:
            chosen = _search(pool, aim.target(), count, seed, aim.criterion, effort="low")
        except NotIdentifiable:  # too few
            return False
        return keeps(_information(pool.blocks[chosen]))

    def chosen(count: int) -> _Choice | None:
        try:
            return _choose(pool, count, seed)
        except (NotIdentifiable, Infeasible):  # too few
            return None

    low, high = least, min(least, most)
    while not keeps_on_the_grid(high):
        if high == most:
            raise _too_many(pool, most)
        low, high = high + 1, min(2 * high, most)
    count = bisect_left(range(high), True, lo=low, key=keeps_on_the_grid)
    found = chosen(count)
    if found is not None:  # refinement may take fewer, a guard more: the first plan tells about how many
        each = _information(found.own) / count
        count = min(bisect_left(range(most), True, lo=least, key=lambda n: keeps(n * each)), most)
        found = chosen(count)
    while found is None or not keeps(_information(found.own)):
        count += 1
        if count > most:
            raise _too_many(pool, most)
        found = chosen(count)
    while count > least:
        count -= 1
        fewer = chosen(count)
        if fewer is None or not keeps(_information(fewer.own)):
            break
        found = fewer
    return found


def _too_many(pool: Pool, most: int) -> Infeasible:
    """The error for a tolerance that no allowed number of experiments keeps."""
    study = pool.observer.study
    tolerance = (study.plan.tolerance or 0.0) / MM
    return Infeasible(
        f"{study.path}: [plan] tolerance_mm = {tolerance:g} needs more than {most} experiments; "
        "allow a larger tolerance, heavier loads or a better instrument"
    )


def _tolerance_test(pool: Pool) -> Callable[[Floats], bool]:
    """``information (p, p) -> bool``: is the tolerance kept at every test pose?

    Raises:
        Infeasible: The robot's own repeatability forbids it.
    """
    study, aim = pool.observer.study, pool.objective
    rows = target_rows(pool.observer, pool.known) / MM
    tolerance, confidence = (study.plan.tolerance or 0.0) / MM, study.plan.confidence
    own = max(radius(jitter, confidence) for jitter in jitter_covariance(study))
    if own >= tolerance:
        raise Infeasible(
            f"{study.path}: [plan] tolerance_mm = {tolerance:g}: the robot's own pose jitter alone gives {own:.3g} mm "
            f"at a test pose with confidence {confidence:g}; no number of experiments removes it"
        )

    def keeps(information: Floats) -> bool:
        if not np.isfinite(aim.value(information, "test_pose")):
            return False
        reached = accuracy(study, rows, covariance_of(information))
        return max(radius(total, confidence) for total in reached.covariance + reached.jitter) <= tolerance

    return keeps


def covariance_of(information: Floats) -> Floats:
    """Inverse on unit columns; infinite where the matrix is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return np.full_like(information, np.inf)
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    if values[0] <= _SINGULAR * values[-1]:
        return np.full_like(information, np.inf)
    root = vectors / np.sqrt(values) / scale[:, None]
    covariance: Floats = root @ root.T
    return covariance


def standard_deviations(information: Floats) -> Floats:
    """(p,) standard deviations; infinite where the information is singular."""
    deviation: Floats = np.sqrt(np.diag(covariance_of(information)))
    return deviation


def _information(blocks: Floats) -> Floats:
    rows = blocks.reshape(-1, blocks.shape[2])
    product: Floats = rows.T @ rows
    return product


def _search(pool: Pool, target: Floats, count: int, seed: int, criterion: str, *, effort: str = "normal") -> Ints:
    """Indices of the chosen candidates, repeats included.

    Raises:
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    study = pool.observer.study
    try:
        found = exact_design(
            pool.blocks, target, count, criterion=criterion, repeats=study.plan.repeats, effort=effort, seed=seed
        )
    except NotIdentifiable as error:
        columns = [index for index in error.missing if isinstance(index, int)]
        names = tuple(pool.observer.model.names[pool.known.kept[index]] for index in columns)
        raise NotIdentifiable(
            f"{study.path}: [plan] {count} poses are too few: no plan of them shows "
            f"{', '.join(names) or 'all parameters'}, which criterion {criterion} needs; plan more poses, more loads "
            "at each pose or more markers",
            names,
        ) from error
    return np.repeat(np.arange(len(found.counts)), found.counts)


def _guarded_search(pool: Pool, count: int, seed: int) -> tuple[Ints, Floats | None, tuple[str, ...]]:
    """Search; where the plan sees little but the test poses, weigh the parameters' own variances in.

    Returns:
        Chosen candidates, the standard deviations under the best plan for the parameters (None for criteria that
        need no guard), and notes.

    Raises:
        Infeasible: ``max_std_percent`` cannot be met.
    """
    aim, study = pool.objective, pool.observer.study
    chosen = _search(pool, aim.target(), count, seed, aim.criterion)
    if aim.criterion not in {"test_pose", "G"}:
        return chosen, None, ()
    thorough = _search(pool, np.eye(aim.size), count, seed, "A")
    best = standard_deviations(_information(pool.blocks[thorough]))
    percent = study.plan.max_std_percent
    name, ratio = _worst(pool, pool.blocks[chosen], best)
    if ratio <= percent / 100.0:
        return chosen, best, ()
    unguarded = aim.value(_information(pool.blocks[chosen]))
    share = 1e-4 * max(unguarded if np.isfinite(unguarded) else 1.0, 1e-300) / aim.size
    for _ in range(_GUARD_ROUNDS):
        chosen = _search(pool, aim.guarded(best, share), count, seed, aim.criterion, effort="low")
        if _worst(pool, pool.blocks[chosen], best)[1] <= percent / 100.0:
            value = aim.value(_information(pool.blocks[chosen]))
            cost = f"costs {100 * (value / unguarded - 1):.2g} %" if np.isfinite(unguarded) else "keeps it identifiable"
            note = (
                f"the best plan for the test poses alone would tell {name} {_times(ratio)}; "
                f"max_std_percent = {percent:g} {cost}"
            )
            return chosen, best, (note,)
        share *= 8.0
    raise Infeasible(
        f"{study.path}: [plan] max_std_percent = {percent:g} cannot be met with {count} poses: the best plan for the "
        f"test poses tells {name} {_times(ratio)}; allow more"
    )


def _blind_spot(pool: Pool, own: Floats, best: Floats) -> tuple[str, ...]:
    """A note if ``max_std_percent`` allows a plan that sees little but the test poses, and it is one."""
    name, ratio = _worst(pool, own, best)
    percent = pool.observer.study.plan.max_std_percent
    if ratio <= _USUAL_PERCENT / 100.0 * (1.0 + 1e-6):
        return ()
    return (
        f"this plan sees little but the test poses: it tells {name} {_times(ratio)}, which max_std_percent = "
        f"{percent:g} allows; it is of little use for other poses or loads",
    )


def _worst(pool: Pool, own: Floats, best: Floats) -> tuple[str, float]:
    """The parameter that a plan (n, k, p) tells worst relative to ``best`` (p,), and how much worse."""
    ratio = standard_deviations(_information(own)) / best
    worst = int(np.argmax(ratio))
    return pool.observer.model.names[pool.known.kept[worst]], float(ratio[worst])


def _times(ratio: float) -> str:
    """A ratio of standard deviations in words."""
    return f"{ratio:.3g} times worse than a plan for the parameters" if math.isfinite(ratio) else "not at all"
