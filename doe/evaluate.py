"""The public verb `evaluate`: how good any set of poses and loads is, whoever made it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from doe.bounds import NODES, Bound, bound_of
from doe.candidates import Candidates, candidates
from doe.information import covariance_of
from doe.objective import Objective, objective
from doe.observations import Observer, keep_columns, observer, stacked_visits
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
        visits: Number of visits.
        candidates: What it was compared with; None if nothing keeps to the constraints.
        bound: Value and proven bound.
    """

    observer: Observer
    experiment: Experiment
    known: Identifiability
    objective: Objective
    information: Floats
    visits: int
    candidates: Candidates | None
    bound: Bound

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
    watching = observer(study)
    own = stacked_visits(watching, experiment)
    known = independent_columns(triangle([own.reshape(-1, own.shape[2])]))
    aim = objective(watching, known, study.plan.criterion)
    own = own[:, :, known.kept]
    rows = own.reshape(-1, aim.size)
    information: Floats = rows.T @ rows
    chosen = _candidates(study, seed)
    pool = own[:0]
    if chosen is not None:
        pool = keep_columns(watching.blocks(chosen.q[chosen.pose], chosen.visit_loads), known.kept)
    bound = bound_of(aim, pool, own, aim.value(information), repeats=study.plan.repeats, nodes=NODES)
    return Evaluation(watching, experiment, known, aim, information, len(own), chosen, bound)


def _candidates(study: Study, seed: int) -> Candidates | None:
    """The study's candidates; none if nothing keeps to its constraints."""
    try:
        return candidates(study, seed=seed)
    except Infeasible as error:
        log.warning("compared with the given poses only: %s", error)
        return None
