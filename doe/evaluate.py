"""The public verb `evaluate`: how good any set of poses and loads is, whoever made it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from doe.bounds import NODES, Bound, bound_of
from doe.candidates import Candidates, candidates
from doe.design_choices import open_choices
from doe.earlier import NOTHING, Earlier
from doe.executor import HERE, Executor
from doe.feasible import FEASIBLE, count_reasons, screen
from doe.information import covariance_of, information_of
from doe.objective import Objective, objective
from doe.observations import Observer, identifiable, keep_columns, observer, stacked_visits
from doe.pool import Pool, measured_blocks
from doe.regions import check_test_poses, with_regions
from identify.arrays import Floats
from identify.errors import Infeasible, InputError
from identify.experiment import Experiment
from identify.identifiability import Identifiability
from identify.study import Study

__all__ = ["Evaluation", "broken_visits", "evaluate"]

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A judged pose set.

    Attributes:
        observer: How readings are compared.
        experiment: The poses and loads.
        known: Parameters that they, and what was measured, can identify.
        objective: The criterion on these parameters.
        information: (p, p) of them, what was measured included.
        own: (V, k, p) blocks of the visits, in their order.
        pool: What it was compared with, on these parameters; None if nothing keeps to the constraints.
        bound: Value and proven bound.
        broken: Number of visits by the first constraint of the study that they break.
        prior: (p, p) information of what was measured, or None.
    """

    observer: Observer
    experiment: Experiment
    known: Identifiability
    objective: Objective
    information: Floats
    own: Floats
    pool: Pool | None
    bound: Bound
    broken: Mapping[str, int]
    prior: Floats | None = None

    @property
    def visits(self) -> int:
        """Number of visits."""
        return len(self.own)

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def evaluate(
    study: Study, experiment: Experiment, *, seed: int = 0, earlier: Earlier = NOTHING, executor: Executor = HERE
) -> Evaluation:
    """Judge a pose set by the criterion of the study.

    The bound is the best that any set of as many visits could reach with the study's candidates and the
    set's own visits, each beside what was measured. Parameters that the set cannot identify are held at their
    nominal values in both.

    Args:
        study: The study.
        experiment: The visits with their shots, any layout.
        seed: Seed of the candidates.
        earlier: What was measured before, which counts in full beside these visits.
        executor: Who checks the candidates and builds their blocks.

    Raises:
        NotIdentifiable: The criterion needs a direction that these poses cannot show.
        InputError: The study leaves the tracker's station or the markers open (`doe.design_choices.decide`).
    """
    if open_choices(study):
        raise InputError(
            f"{study.path}: station or markers are still to be chosen; judge the study that decide() gives"
        )
    check_test_poses(study)
    study = with_regions(study)
    watching = observer(study)
    own = stacked_visits(watching, experiment)
    measured = measured_blocks(watching, earlier)
    known = identifiable(own, measured, parameters=watching.parameters)
    aim = objective(watching, known, study.plan.criterion)
    own = own[:, :, known.kept]
    prior = None if measured is None else information_of(measured[:, :, known.kept])
    information = information_of(own, prior)
    chosen, pool = _candidates(study, seed, executor), None
    if chosen is not None:
        blocks = keep_columns(watching.blocks(chosen.visit_q, chosen.visit_loads, executor), known.kept)
        pool = Pool(watching, chosen, known, blocks, aim, prior, earlier, executor=executor)
    among = own[:0] if pool is None else pool.blocks
    value, repeats = aim.value(information), study.plan.repeats
    bound = bound_of(aim, len(own), among, own, value, repeats=repeats, prior=prior, nodes=NODES)
    broken = broken_visits(study, experiment)
    return Evaluation(watching, experiment, known, aim, information, own, pool, bound, broken, prior)


def broken_visits(study: Study, experiment: Experiment) -> dict[str, int]:
    """Number of visits by the first constraint of the study that they break."""
    codes = screen(study).codes(experiment.q[experiment.shot_pose])
    own = codes[np.arange(len(codes)), experiment.shot_load]
    first = np.full(len(experiment.visits), FEASIBLE)
    np.minimum.at(first, experiment.shot_visit, own)
    return {reason: count for reason, count in count_reasons(first).items() if count}


def _candidates(study: Study, seed: int, executor: Executor) -> Candidates | None:
    """The study's candidates; none if nothing keeps to its constraints."""
    try:
        return candidates(study, seed=seed, executor=executor)
    except Infeasible as error:
        log.warning("compared with the given poses only: %s", error)
        return None
