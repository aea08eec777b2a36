"""What a plan is chosen from: candidates with their blocks and the objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from doe.candidates import Candidates, candidates
from doe.information import information_of
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

    @property
    def prior(self) -> Floats | None:
        """(p, p) information that is there already, in full, or None."""

    def information(self, blocks: Floats) -> Floats:
        """(p, p) of blocks (n, k, p) and of what is there already."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates with their blocks.

    Attributes:
        observer: How poses become blocks.
        candidates: The feasible candidates.
        known: Parameters that they can identify.
        blocks: (N, k, p) on the identifiable parameters.
        objective: The criterion on these parameters.
        prior: (p, p) information that is there already, in full, or None.
    """

    observer: Observer
    candidates: Candidates
    known: Identifiability
    blocks: Floats
    objective: Objective
    prior: Floats | None = None

    def information(self, blocks: Floats) -> Floats:
        """(p, p) of blocks (n, k, p) and of what is there already."""
        return information_of(blocks, self.prior)


def build_pool(study: Study, seed: int) -> Pool:
    """Candidates, their blocks and the objective."""
    chosen = candidates(study, seed=seed)
    watching = observer(study)
    blocks = watching.blocks(chosen.q[chosen.pose], chosen.visit_loads)
    known = identifiable(blocks)
    return Pool(
        watching,
        chosen,
        known,
        keep_columns(blocks, known.kept),
        objective(watching, known, study.plan.criterion),
    )
