"""A number of experiments: searched on the grid, refined off it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doe.candidates import rounded
from doe.earlier import NOTHING, Earlier
from doe.feasible import joint_range, screen
from doe.guard import Guard, blind_spot, guarded_search
from doe.information import information_of, standard_deviations
from doe.objective import Objective
from doe.observations import Observer
from doe.pool import Pool
from doe.purse import Purse
from doe.refine import Others, Refinement, refine
from doe.robustness import value_that_counts
from identify.arrays import Floats, Ints

__all__ = ["Choice", "choose", "off_grid"]

_SHARES = (1.0, 0.5, 0.25, 0.125)  # of the way of a refinement that is tried for robust plans
_HARDLY = 1e-3  # loss of the criterion that a plan with fewer different poses is worth

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Choice:
    """A plan that nothing is proven about yet.

    Attributes:
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads.
        grid: (n, k, p) blocks before refinement.
        own: (n, k, p) blocks of the plan; ``grid`` itself if refinement gained nothing.
        refinement: What the refinement did, or None.
        guard: What was weighed in.
        notes: What the user should know.
    """

    q: Floats
    visit_loads: Ints
    grid: Floats
    own: Floats
    refinement: Refinement | None
    guard: Guard
    notes: tuple[str, ...]


def choose(pool: Pool, count: int | None, seed: int, *, purse: Purse | None = None) -> Choice:
    """Search ``count`` experiments, or what the purse pays for, on the grid and refine them."""
    study, aim = pool.observer.study, pool.objective
    log.info("%d candidates, %d parameters; searching %s experiments",
             len(pool.blocks), aim.size, "affordable" if count is None else count)  # fmt: skip
    chosen, guard, notes = guarded_search(pool, count, seed, purse=purse)
    best = guard.best
    most = None if best is None else study.plan.max_std_percent / 100.0 * best
    q, loads = pool.candidates.visit_q[chosen], pool.candidates.visit_loads[chosen]
    grid = own = pool.blocks[chosen]
    refinement = None
    if study.plan.refine and len(q):
        log.info("refining the joint angles of %d experiments", len(q))
        refined, moved, refinement = off_grid(
            pool.observer, pool.known.kept, aim, chosen, q, loads, most, others_of(pool.prior), pool.earlier
        )
        if study.plan.losses or pool.draws:
            refined, moved = _part_of_the_way(pool, q, loads, refined)
        if value_that_counts(pool, refined, loads, moved) < value_that_counts(pool, q, loads, grid):
            q, own = refined, moved
    if refinement is not None and refinement.reason:
        notes = (*notes, f"not refined: {refinement.reason}")
    if best is not None:
        notes = (*notes, *blind_spot(pool, own, best))
    return Choice(q, loads, grid, own, refinement, guard, notes)


def _part_of_the_way(pool: Pool, q: Floats, loads: Ints, refined: Floats) -> tuple[Floats, Floats]:
    """The allowed joint values between a plan and its refined one that are best by what counts, and their blocks.

    The refinement knows the nominal criterion alone, and may go too far for the worst loss or for other values.
    """
    study, best, least = pool.observer.study, q, np.inf
    tests = screen(study)
    blocks = pool.observer.blocks(q, loads)[:, :, pool.known.kept]
    for share in _SHARES:
        moved = rounded(study, q + share * (refined - q))
        if not (tests.check(moved, loads).ok & pool.earlier.clear(study, moved)).all():
            continue
        own = pool.observer.blocks(moved, loads)[:, :, pool.known.kept]
        value = value_that_counts(pool, moved, loads, own)
        if value < least:
            best, blocks, least = moved, own, value
    return best, blocks


def others_of(prior: Floats | None) -> Others | None:
    """Rows (p, p) that carry the information ``prior``, as what stays beside the moved visits; None without one."""
    if prior is None:
        return None
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    values, vectors = np.linalg.eigh(prior / scale / scale[:, None])
    rows = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
    return Others(rows, np.arange(len(prior)))


def off_grid(
    observer: Observer,
    kept: Ints,
    aim: Objective,
    chosen: Ints,
    q: Floats,
    loads: Ints,
    most: Floats | None,
    others: Others | None = None,
    earlier: Earlier = NOTHING,
) -> tuple[Floats, Floats, Refinement]:
    """Move the visits of one arm off the grid.

    Args:
        observer: What turns poses of this arm into blocks.
        kept: Kept columns of its model.
        aim: The criterion on all p kept parameters of the plan.
        chosen: (n,) candidate of each visit; repeats of one may end at one pose.
        q: (n, dof) joint values, rad or m.
        loads: (n, L) loads.
        most: (p,) standard deviations that must not be exceeded, or None.
        others: What else belongs to the plan.
        earlier: What it keeps clear of.

    Returns:
        Joint values (n, dof) as a plan file holds them, the blocks (n, k, p) and what was done. They may be no better.
    """

    def blocks(values: Floats) -> Floats:
        own = observer.blocks(values, loads)[:, :, kept]
        return own if others is None else others.spread(own)

    def information(values: Floats) -> Floats:
        own = information_of(blocks(values))
        return own if others is None else own + others.rows.T @ others.rows

    for limit in (None, most):  # most plans keep the limit without being told
        refinement = _refine(observer, kept, aim, q, loads, limit, others, earlier)
        refined = rounded(observer.study, refinement.q)
        refined = _together(lambda values: aim.value(information(values)), chosen, refined)
        if most is None or (standard_deviations(information(refined)) <= most * (1.0 + 1e-6)).all():
            break
    return refined, blocks(refined), refinement


def _refine(
    observer: Observer,
    kept: Ints,
    aim: Objective,
    q: Floats,
    loads: Ints,
    limits: Floats | None,
    others: Others | None,
    earlier: Earlier,
) -> Refinement:
    """Move the joint angles within limits, floor and the parameters' limits; all else is checked on arrival."""
    study = observer.study
    (lower, upper), tests = joint_range(study), screen(study)

    def allowed(moved: Floats) -> np.ndarray:
        arrived = rounded(study, moved)
        return np.asarray(tests.check(arrived, loads).ok & earlier.clear(study, arrived))

    return refine(
        observer,
        q,
        loads,
        kept,
        aim.target(),
        criterion=aim.criterion,
        lower=lower,
        upper=upper,
        floor=study.constraints.floor,
        max_std=limits,
        allowed=allowed,
        others=others,
    )


def _together(value: Callable[[Floats], float], chosen: Ints, q: Floats) -> Floats:
    """Joint values in which repeats of one candidate that hardly parted stand at one pose again."""
    reached = value(q)
    for candidate in np.unique(chosen):
        visits = np.flatnonzero(chosen == candidate)
        tidy = q.copy()
        tidy[visits] = q[visits[0]]
        if len(visits) > 1 and value(tidy) <= reached * (1.0 + _HARDLY):
            q = tidy
    return q
