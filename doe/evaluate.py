"""The public verb `evaluate`: how good any set of poses and loads is, whoever made it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from doe.bounds import Bound, bound_of
from doe.candidates import Candidates, candidates
from doe.information import covariance_of, information_of
from doe.objective import Objective, objective
from doe.observations import Observer, keep_columns, observer, stacked_visits
from doe.pool import Pool
from doe.regions import with_regions
from identify.arrays import Floats
from identify.errors import Infeasible
from identify.experiment import Experiment
from identify.identifiability import Identifiability, independent_columns, triangle
from identify.study import Study

__all__ = ["Evaluation", "evaluate"]

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A judged pose set.

    Attributes:
        observer: How readings are compared.
        experiment: The poses and loads.
        known: Parameters that they can identify.
        objective: The criterion on these parameters.
        information: (p, p) of them.
        own: (V, k, p) blocks of the visits, in their order.
        pool: What it was compared with, on these parameters; None if nothing keeps to the constraints.
        bound: Value and proven bound.
    """

    observer: Observer
    experiment: Experiment
    known: Identifiability
    objective: Objective
    information: Floats
    own: Floats
    pool: Pool | None
    bound: Bound

    @property
    def visits(self) -> int:
        """Number of visits."""
        return len(self.own)

    @property
    def covariance(self) -> Floats:
        """(p, p) of the identifiable parameters, in their units."""
        return covariance_of(self.information)


def evaluate(study: Study, experiment: Experiment, *, seed: int = 0) -> Evaluation:
    """Judge a pose set by the criterion of the study.

    The bound is the best that any set of as many visits could reach with the study's candidates and the
    set's own visits. Parameters that the set cannot identify are held at their nominal values in both.

    Args:
        study: The study.
        experiment: The visits with their shots, any layout.
        seed: Seed of the candidates.

    Raises:
        NotIdentifiable: The criterion needs a direction that these poses cannot show.
    """
    study = with_regions(study)
    watching = observer(study)
    own = stacked_visits(watching, experiment)
    known = independent_columns(triangle([own.reshape(-1, own.shape[2])]))
    aim = objective(watching, known, study.plan.criterion)
    own = own[:, :, known.kept]
    information = information_of(own)
    chosen, pool = _candidates(study, seed), None
    if chosen is not None:
        blocks = keep_columns(watching.blocks(chosen.visit_q, chosen.visit_loads), known.kept)
        pool = Pool(watching, chosen, known, blocks, aim)
    among = own[:0] if pool is None else pool.blocks
    bound = bound_of(aim, len(own), among, own, aim.value(information), repeats=study.plan.repeats)
    return Evaluation(watching, experiment, known, aim, information, own, pool, bound)


def _candidates(study: Study, seed: int) -> Candidates | None:
    """The study's candidates; none if nothing keeps to its constraints."""
    try:
        return candidates(study, seed=seed)
    except Infeasible as error:
        log.warning("compared with the given poses only: %s", error)
        return None
