"""A number of experiments: searched on the grid, then off it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from doe.guard import blind_spot, guarded_search
from doe.off_grid import OffGrid, Visits, search_off_grid
from doe.pool import Pool
from doe.reach import Reach
from doe.refine import Refinement
from identify.arrays import Floats, Ints

__all__ = ["Choice", "choose"]

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


def choose(pool: Pool, count: int, seed: int, reach: Reach | None = None) -> Choice:
    """Search ``count`` experiments on the grid, then off it.

    Args:
        pool: The candidates.
        count: Number of experiments.
        seed: Of the search.
        reach: All poses, with the columns to search off the grid; None to stay on it.

    Raises:
        Infeasible: ``max_std_percent`` cannot be met.
        NotIdentifiable: So many experiments cannot show what the criterion needs.
    """
    study, aim = pool.observer.study, pool.objective
    log.info("%d candidates, %d parameters; searching %d experiments", len(pool.blocks), aim.size, count)
    chosen, best, notes = guarded_search(pool, count, seed)
    most = None if best is None else study.plan.max_std_percent / 100.0 * best
    start = Visits(pool.candidates.visit_q[chosen], pool.candidates.visit_loads[chosen], pool.blocks[chosen])
    found, refinement = start, None
    if reach is not None:
        log.info("searching %d experiments off the grid", count)
        found, refinement = search_off_grid(OffGrid(pool, reach, count, seed, best, most), chosen, start)
    if refinement is not None and refinement.reason:
        notes = (*notes, f"not refined: {refinement.reason}")
    if best is not None:
        notes = (*notes, *blind_spot(pool, found.blocks, best))
    return Choice(found.q, found.loads, start.blocks, found.blocks, refinement, notes)
