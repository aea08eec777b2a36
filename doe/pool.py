"""What a plan is chosen from: candidates with their blocks and the objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from doe.candidates import Candidates, candidates
from doe.objective import Objective, objective
from doe.observations import Observer, identifiable, keep_columns, observer
from doe.subject import Subject
from identify.arrays import Floats
from identify.identifiability import Identifiability
from identify.study import Study

__all__ = ["AnyPool", "Pool", "build_pool"]


class AnyPool(Protocol):
    """What the search needs of the candidates of one arm or of two."""

    @property
    def observer(self) -> Subject:
        """What the plan is for."""

    @property
    def known(self) -> Identifiability:
        """Parameters that the candidates can identify."""

    @property
    def blocks(self) -> Floats:
        """(N, k, p) on the identifiable parameters."""

    @property
    def objective(self) -> Objective:
        """The criterion on these parameters."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates with their blocks.

    Attributes:
        observer: How poses become blocks.
        candidates: The feasible candidates.
        known: Parameters that they can identify.
        blocks: (N, k, p) on the identifiable parameters.
        objective: The criterion on these parameters.
    """

    observer: Observer
    candidates: Candidates
    known: Identifiability
    blocks: Floats
    objective: Objective


def build_pool(study: Study, seed: int) -> Pool:
    """Candidates, their blocks and the objective."""
    watching = observer(study, own_visits=study.plan.references == "own_visits")
    chosen = candidates(study, seed=seed)
    blocks = watching.blocks(chosen.q[chosen.pose], chosen.visit_loads)
    known = identifiable(blocks)
    return Pool(
        watching,
        chosen,
        known,
        keep_columns(blocks, known.kept),
        objective(watching, known, study.plan.criterion),
    )
