"""The public verb `plan`: from a study to poses and loads, with a proof of how good they are."""

from __future__ import annotations

from dataclasses import dataclass, replace

from doe.bounds import NODES, Bound, Efficiencies, bound_of, efficiencies
from doe.choice import all_poses_count, choose
from doe.design_choices import Decision, decide
from doe.earlier import NOTHING, Earlier
from doe.guard import Guard
from doe.information import covariance_of
from doe.pool import Pool, build_pool
from doe.reach import reach_of
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
        compared: How good the plan is by every criterion; None for no plan at all.
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
    compared: Efficiencies | None
    notes: tuple[str, ...]
    decision: Decision | None = None

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan(study: Study, *, seed: int = 0, earlier: Earlier = NOTHING) -> Plan:
    """Pick the poses and loads that minimise the criterion of the study.

    Candidates are drawn over the joint limits; column generation gives the best relaxed design and its
    proven bound; exchange and local search make it a plan of n experiments. Off the grid, column generation over
    all poses gives further candidates and an estimate of what is best anywhere; the plan is exchanged with them
    and all its joint angles are moved. Where the study leaves the tracker's station or the markers open, they are
    chosen first.

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
    reach = reach_of(pool, seed) if study.plan.refine and all_poses_count(pool) else None
    if study.plan.poses is None:
        choice = sufficient(pool, seed, reach)
    else:
        choice = choose(pool, study.plan.poses, seed, reach)
    count = len(choice.q)

    def bound(own: Floats) -> Bound:
        value = aim.value(pool.information(own))
        proven = bound_of(aim, count, pool.blocks, own, value, repeats=repeats, prior=pool.prior, nodes=NODES)
        if reach is None:
            return proven
        return replace(proven, estimate=min(reach.columns.bound / count, proven.bound))

    grid = bound(choice.grid)
    final = grid if choice.own is choice.grid else bound(choice.own)
    return Plan(
        pool,
        choice.q,
        choice.visit_loads,
        grid,
        final,
        pool.information(choice.own),
        choice.refinement,
        choice.guard,
        robustness(pool, choice.q, choice.visit_loads, choice.own),
        efficiencies(aim, pool.blocks, choice.own, repeats=repeats) if count else None,
        choice.notes,
        decision,
    )
