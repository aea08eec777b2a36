"""A number of experiments: searched on the grid, then off it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from doe.candidates import rounded
from doe.feasible import screen
from doe.guard import Guard, blind_spot, guarded_search
from doe.off_grid import OffGrid, Visits, off_grid, others_of, search_off_grid
from doe.pool import Pool
from doe.purse import Purse
from doe.reach import Reach
from doe.refine import Refinement
from doe.robustness import value_that_counts
from identify.arrays import Floats, Ints
from identify.units import counted

__all__ = ["Choice", "all_poses_count", "choose"]

_SHARES = (1.0, 0.5, 0.25, 0.125)  # of the way of a refinement that is tried for robust plans

_LOADS_STAY = (
    "loads with ranges hang at the settings of the candidates (settings_per_load): their values are moved further only "
    "in plans with refine = true and without losses, draws or a budget, and not where a tolerance asks for more visits "
    "beside measured ones"
)

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Choice:
    """A plan that nothing is proven about yet.

    Attributes:
        pool: What it was chosen from; its study holds the loads of the plan.
        q: (n, joints) joint values, rad or m.
        visit_loads: (n, L) loads.
        grid: (n, k, p) blocks before refinement.
        own: (n, k, p) blocks of the plan; ``grid`` itself if refinement gained nothing.
        refinement: What the refinement did, or None.
        guard: What was weighed in.
        notes: What the user should know.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    grid: Floats
    own: Floats
    refinement: Refinement | None
    guard: Guard
    notes: tuple[str, ...]


def choose(
    pool: Pool, count: int | None, seed: int, reach: Reach | None = None, *, purse: Purse | None = None
) -> Choice:
    """Search ``count`` experiments, or what the purse pays for, on the grid, then off it.

    Args:
        pool: The candidates.
        count: Number of experiments; None where a purse limits it.
        seed: Of the search.
        reach: All poses, with the columns to search off the grid; None to move the plan alone.
        purse: What may be spent.

    Raises:
        Infeasible: ``max_std_percent`` cannot be met.
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    study, aim = pool.observer.study, pool.objective
    sought = "affordable experiments" if count is None else counted(count, "experiment")
    log.info("%s, %s; searching %s",
             counted(len(pool.blocks), "candidate"), counted(aim.size, "parameter"), sought)  # fmt: skip
    # a plan that leaves the grid is proven at the end alone
    chosen, guard, notes = guarded_search(pool, count, seed, purse=purse, prove=not study.plan.refine)
    best = guard.best
    most = None if best is None else study.plan.max_std_percent / 100.0 * best
    start = Visits(pool.candidates.visit_q[chosen], pool.candidates.visit_loads[chosen], pool.blocks[chosen])
    found, refinement = start, None
    if study.plan.refine and len(chosen):
        log.info("searching %s off the grid", counted(len(chosen), "experiment"))
        if reach is None or count is None:
            found, refinement = _moved_beside(pool, chosen, start, most)
        else:
            found, refinement, pool = search_off_grid(OffGrid(pool, reach, count, seed, best, most), chosen, start)
    if refinement is not None and refinement.reason and found is start:
        notes = (*notes, f"not refined: {refinement.reason}")
    if best is not None:
        notes = (*notes, *blind_spot(pool, found.blocks, best))
    if study.load_ranges and (reach is None or count is None):
        notes = (*notes, _LOADS_STAY)
    return Choice(pool, found.q, found.loads, start.blocks, found.blocks, refinement, guard, notes)


def all_poses_count(pool: Pool) -> bool:
    """True if a plan is searched among all poses: their number is known beside measured ones, and none may be lost."""
    asked = pool.observer.study.plan
    plain = asked.losses == 0 and not pool.draws and not asked.budgeted
    return plain and (pool.prior is None or bool(asked.poses)) and pool.earlier.reached is None


def _moved_beside(pool: Pool, chosen: Ints, start: Visits, most: Floats | None) -> tuple[Visits, Refinement]:
    """Move a plan that has something beside it, or that counts after losses or on average; it is no worse."""
    study = pool.observer.study
    q, blocks, refinement = off_grid(
        pool.observer, pool.known.kept, pool.objective, chosen, start.q, start.loads, most, others_of(pool.prior),
        pool.earlier,
    )  # fmt: skip
    if study.plan.losses or pool.draws:
        q, blocks = _part_of_the_way(pool, start.q, start.loads, q)
    better = value_that_counts(pool, q, start.loads, blocks) < value_that_counts(
        pool, start.q, start.loads, start.blocks
    )
    return (Visits(q, start.loads, blocks) if better else start), refinement


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
