"""A number of experiments: searched on the grid, refined off it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from doe.candidates import rounded
from doe.feasible import check, joint_range
from doe.guard import blind_spot, guarded_search
from doe.information import information_of, standard_deviations
from doe.pool import Pool
from doe.refine import Refinement, refine
from identify.arrays import Floats, Ints

__all__ = ["Choice", "choose"]

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
        notes: What the user should know.
    """

    q: Floats
    visit_loads: Ints
    grid: Floats
    own: Floats
    refinement: Refinement | None
    notes: tuple[str, ...]


def choose(pool: Pool, count: int, seed: int) -> Choice:
    """Search ``count`` experiments on the grid and refine them."""
    study, aim = pool.observer.study, pool.objective
    log.info("%d candidates, %d parameters; searching %d experiments", len(pool.blocks), aim.size, count)
    chosen, best, notes = guarded_search(pool, count, seed)
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
            if most is None or (standard_deviations(information_of(moved)) <= most * (1.0 + 1e-6)).all():
                break
        if aim.value(information_of(moved)) < aim.value(information_of(grid)):
            q, own = refined, moved
    if refinement is not None and refinement.reason:
        notes = (*notes, f"not refined: {refinement.reason}")
    if best is not None:
        notes = (*notes, *blind_spot(pool, own, best))
    return Choice(q, loads, grid, own, refinement, notes)


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
    return pool.objective.value(information_of(pool.observer.blocks(q, loads)[:, :, pool.known.kept]))
