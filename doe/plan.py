"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

from dataclasses import dataclass

from doe.bounds import Bound, bound_of
from doe.choice import choose
from doe.design_choices import Decision, decide
from doe.earlier import NOTHING, Earlier
from doe.guard import Guard
from doe.information import covariance_of
from doe.pool import Pool, build_pool
from doe.refine import Refinement
from doe.robustness import Robustness, robustness
from doe.tolerance import sufficient
from identify.arrays import Floats, Ints
from identify.study import Study

__all__ = ["Plan", "plan"]


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
        guard: What was weighed into the search.
        robust: What it is worth after losses and at other nominal values; None if not asked for.
        notes: What the user should know.
        decision: How station and markers were chosen; None where there was no choice.
    """

    pool: Pool
    q: Floats
    visit_loads: Ints
    grid: Bound
    final: Bound
    information: Floats
    refinement: Refinement | None
    guard: Guard
    robust: Robustness | None
    notes: tuple[str, ...]
    decision: Decision | None = None

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan(study: Study, *, seed: int = 0, earlier: Earlier = NOTHING) -> Plan:
    """Pick the poses and loads that minimise the criterion of the study.

    Candidates are drawn over the joint limits; column generation gives the best relaxed design and its
    proven bound; exchange and local search make it a plan of n experiments; the joint angles are then
    moved off the grid. Where the study leaves the tracker's station or the markers open, they are chosen first.

    Args:
        study: The study; its ``[plan]`` says what is wanted.
        seed: Seed of candidates and search.
        earlier: What was measured, which counts in full beside the ``poses`` that are picked, and poses to keep clear
            of. With a tolerance none may be left to pick.

    Raises:
        NotIdentifiable: The criterion needs what no candidate shows, or n is too small.
        Infeasible: No candidate keeps to the constraints, or no plan meets the tolerance.
    """
    study, decision = decide(study, seed=seed)
    pool = build_pool(study, seed, earlier)
    aim, repeats = pool.objective, study.plan.repeats
    choice = sufficient(pool, seed) if study.plan.poses is None else choose(pool, study.plan.poses, seed)
    count, none = len(choice.q), pool.blocks[:0]
    value = aim.value(pool.information(choice.grid))
    grid = bound_of(aim, count, pool.blocks, none, value, repeats=repeats, prior=pool.prior)
    information = pool.information(choice.own)
    final = grid
    if choice.own is not choice.grid:
        value = aim.value(information)
        final = bound_of(aim, count, pool.blocks, choice.own, value, repeats=repeats, prior=pool.prior)
    return Plan(
        pool,
        choice.q,
        choice.visit_loads,
        grid,
        final,
        information,
        choice.refinement,
        choice.guard,
        robustness(pool, choice.q, choice.visit_loads, choice.own),
        choice.notes,
        decision,
    )
