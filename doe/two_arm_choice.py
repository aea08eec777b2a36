"""A number of experiments for two arms: searched on the grid of both, refined arm by arm."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from doe.guard import Guard, blind_spot, guarded_search
from doe.information import information_of
from doe.off_grid import off_grid
from doe.refine import Others, Refinement
from doe.storage import joined
from doe.two_arm_pool import TwoArmPool, kept_of
from identify.arrays import Floats, Ints
from identify.units import counted

__all__ = ["ArmVisits", "TwoArmChoice", "choose_for_both"]

_TURNS = (0, 1, 0, 1)  # the arm that moves while the visits of the other one stay; a third pass moves nothing any more

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class ArmVisits:
    """Visits of one arm.

    Attributes:
        q: (n_a, joints) joint values, rad or m.
        visit_loads: (n_a, L) loads of their shots.
        blocks: (n_a, k_a, p) on the kept parameters of the plan.
    """

    q: Floats
    visit_loads: Ints
    blocks: Floats


@dataclass(frozen=True, eq=False)
class TwoArmChoice:
    """A plan for two arms that nothing is proven about yet.

    Attributes:
        arms: The visits of each arm.
        grid: (n, k, p) blocks before refinement.
        own: (n, k', p) blocks of the plan; ``grid`` itself if refinement gained nothing.
        refinements: What the refinement did in its turns; empty without one.
        guard: What was weighed in.
        notes: What the user should know.
    """

    arms: tuple[ArmVisits, ArmVisits]
    grid: Floats
    own: Floats
    refinements: tuple[Refinement, ...]
    guard: Guard
    notes: tuple[str, ...]


def choose_for_both(pool: TwoArmPool, count: int, seed: int) -> TwoArmChoice:
    """Search ``count`` experiments of both arms together on their grids and refine them."""
    aim, asked = pool.objective, pool.observer.settings
    log.info("%s, %s; searching %s", counted(len(pool.blocks), "candidate"), counted(aim.size, "parameter"),
             counted(count, "experiment"))  # fmt: skip
    chosen, guard, notes = guarded_search(pool, count, seed)
    best = guard.best
    grid = own = pool.blocks[chosen]
    arms = _visits(pool, chosen)
    refinements: tuple[Refinement, ...] = ()
    if asked.refine:
        log.info("refining the joint angles of %d experiments, one arm after the other", count)
        moved, refinements = _refined(
            pool, chosen, arms, None if best is None else asked.max_std_percent / 100.0 * best
        )
        if moved is not arms:
            arms, own = moved, joined(moved[0].blocks, moved[1].blocks)
    reasons = dict.fromkeys(refinement.reason for refinement in refinements if refinement.status == "not run")
    notes = (*notes, *(f"not refined: {reason}" for reason in reasons if reason))
    if best is not None:
        notes = (*notes, *blind_spot(pool, own, best))
    return TwoArmChoice(arms, grid, own, refinements, guard, notes)


def _visits(pool: TwoArmPool, chosen: Ints) -> tuple[ArmVisits, ArmVisits]:
    """The chosen candidates (n,) by arm."""
    found = []
    for side, drawn in enumerate(pool.candidates):
        index = pool.of_arm(chosen, side)
        blocks = pool.blocks[index + side * len(pool.candidates[0])]
        found.append(ArmVisits(drawn.visit_q[index], drawn.visit_loads[index], blocks))
    return found[0], found[1]


def _refined(
    pool: TwoArmPool, chosen: Ints, arms: tuple[ArmVisits, ArmVisits], most: Floats | None
) -> tuple[tuple[ArmVisits, ArmVisits], tuple[Refinement, ...]]:
    """Move the visits of one arm after the other off the grid; the given ones where that gains nothing."""
    best, done = arms, []
    for side in _TURNS:
        own, other = best[side], best[1 - side]
        if not len(own.q):
            continue
        kept, place = kept_of(pool.observer, pool.known, side)
        others = Others(other.blocks.reshape(-1, pool.objective.size), place)
        q, blocks, refinement = off_grid(
            pool.observer.arms[side],
            kept,
            pool.objective,
            pool.of_arm(chosen, side),
            own.q,
            own.visit_loads,
            most,
            others,
        )
        done.append(refinement)
        moved = ArmVisits(q, own.visit_loads, blocks)
        if _value(pool, moved, other) < _value(pool, own, other):
            best = (moved, other) if side == 0 else (other, moved)
    return best, tuple(done)


def _value(pool: TwoArmPool, *arms: ArmVisits) -> float:
    """Criterion of the visits of both arms."""
    information = np.sum([information_of(arm.blocks) for arm in arms], axis=0)
    return pool.objective.value(information)
