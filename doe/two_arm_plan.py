"""The verbs for two arms: `plan_for_both` and `evaluate_both`."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doe.accuracy import Accuracy
from doe.bounds import Bound, bound_of
from doe.candidates import Candidates
from doe.drift import yardstick
from doe.information import covariance_of, information_of
from doe.objective import Objective, objective
from doe.observations import identifiable, keep_columns, stacked_visits
from doe.schedule import Schedule, schedule
from doe.storage import joined
from doe.tolerance import fewest
from doe.two_arm_choice import TwoArmChoice, choose_for_both
from doe.two_arm_pool import TwoArmPool, build_two_arm_pool, drawn, kept_of
from doe.two_arms import TwoArmObserver, relative_jitter, two_arm_observer
from identify.arrays import Floats
from identify.errors import Infeasible
from identify.experiment import Experiment
from identify.identifiability import Identifiability
from identify.two_arm_study import TwoArmStudy

__all__ = ["TwoArmEvaluation", "TwoArmPlan", "evaluate_both", "plan_for_both", "relative_accuracy"]

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class TwoArmPlan:
    """Poses and loads to measure with two arms.

    Attributes:
        pool: What it was chosen from.
        choice: The visits of each arm, and what refinement did.
        grid: Value and bound before refinement.
        final: Value and bound of this plan, on the candidates of both arms and its own poses.
        information: (p, p) of the identifiable parameters.
        schedules: The visits of each arm in the order of measuring; None for an arm without any.
    """

    pool: TwoArmPool
    choice: TwoArmChoice
    grid: Bound
    final: Bound
    information: Floats
    schedules: tuple[Schedule | None, ...]

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


@dataclass(frozen=True, eq=False)
class TwoArmEvaluation:
    """A judged set of poses of two arms.

    Attributes:
        observer: How readings are compared.
        known: Parameters that the poses can identify.
        objective: The criterion on these parameters.
        information: (p, p) of them.
        visits: Number of visits of each arm.
        candidates: What it was compared with; None for an arm where nothing keeps to the constraints.
        pool: Blocks of both arms' candidates, where both have some.
        bound: Value and proven bound.
    """

    observer: TwoArmObserver
    known: Identifiability
    objective: Objective
    information: Floats
    visits: tuple[int, int]
    candidates: tuple[Candidates | None, Candidates | None]
    pool: TwoArmPool | None
    bound: Bound

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def plan_for_both(study: TwoArmStudy, *, seed: int = 0) -> TwoArmPlan:
    """Pick the poses and loads of both arms that minimise the criterion of the study together.

    Args:
        study: The study of two arms; its ``[plan]`` says what is wanted.
        seed: Seed of candidates and search.

    Raises:
        NotIdentifiable: The criterion needs what no candidate shows, or n is too small.
        Infeasible: An arm has no candidate, or no plan meets the tolerance.
    """
    pool = build_two_arm_pool(study, seed)
    aim, repeats = pool.objective, study.plan.repeats
    if study.plan.poses is None:
        choice = fewest(pool, seed, lambda: relative_jitter(study), lambda count: choose_for_both(pool, count, seed))
    else:
        choice = choose_for_both(pool, study.plan.poses, seed)

    def bound(own: Floats) -> Bound:
        return bound_of(aim, len(own), pool.blocks, own, aim.value(information_of(own)), repeats=repeats)

    grid = bound(choice.grid)
    information, final = information_of(choice.own), grid if choice.own is choice.grid else bound(choice.own)
    return TwoArmPlan(pool, choice, grid, final, information, _schedules(pool, choice, information, seed))


def _schedules(pool: TwoArmPool, choice: TwoArmChoice, information: Floats, seed: int) -> tuple[Schedule | None, ...]:
    """The visits of each arm in order; what drift leaves is that of the relative error."""
    covariance = covariance_of(information)
    measure = yardstick(pool.objective, covariance)
    gain = measure.rows @ covariance
    found: list[Schedule | None] = []
    for side, own in enumerate(choice.arms):
        kept, place = kept_of(pool.observer, pool.known, side)
        arm = pool.observer.arms[side]
        ordered = None
        if len(own.q):
            ordered = schedule(arm, own.q, own.visit_loads, kept, gain[:, place], measure, seed=seed)
        found.append(ordered)
    return tuple(found)


def evaluate_both(study: TwoArmStudy, experiments: Sequence[Experiment], *, seed: int = 0) -> TwoArmEvaluation:
    """Judge a pose set of each arm by the criterion of both, compared with the candidates of both.

    Args:
        study: The study of two arms.
        experiments: The visits of each arm with their shots, any layout.
        seed: Seed of the candidates.

    Raises:
        NotIdentifiable: The criterion needs a direction that these poses cannot show.
    """
    watching = two_arm_observer(study)
    parts = [
        watching.spread(side, stacked_visits(watching.arms[side], experiment))
        for side, experiment in enumerate(experiments)
    ]
    own = joined(*parts)
    known = identifiable(own, parameters=watching.parameters)
    aim = objective(watching, known, study.plan.criterion)
    own = own[:, :, known.kept]
    information = information_of(own)
    chosen = _candidates(study, 0, seed), _candidates(study, 1, seed)
    pool = own[:0]
    for side, found in enumerate(chosen):
        if found is not None:
            blocks = watching.blocks(side, found.visit_q, found.visit_loads)
            pool = joined(pool, keep_columns(blocks, known.kept))
    bound = bound_of(aim, len(own), pool, own, aim.value(information), repeats=study.plan.repeats)
    visits, (first, second), among = (len(parts[0]), len(parts[1])), chosen, None
    if first is not None and second is not None:
        among = TwoArmPool(watching, (first, second), known, pool, aim)
    return TwoArmEvaluation(watching, known, aim, information, visits, chosen, among, bound)


def relative_accuracy(study: TwoArmStudy, aim: Objective, covariance: Floats) -> Accuracy | None:
    """Accuracy of one tool point relative to the other at the tasks, world frame; None without tasks."""
    if aim.rows is None:
        return None
    weights = np.array([task.weight for task in study.tasks])
    return Accuracy(aim.rows @ covariance @ aim.rows.swapaxes(1, 2), relative_jitter(study), weights / weights.sum())


def _candidates(study: TwoArmStudy, side: int, seed: int) -> Candidates | None:
    """The candidates of one arm; none if nothing keeps to its constraints."""
    try:
        return drawn(study, side, seed)
    except Infeasible as error:
        log.warning("arm %s is compared with the given poses only: %s", study.arms[side].name, error)
        return None
