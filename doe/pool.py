"""What a plan is chosen from: candidates with their blocks and the objective."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from doe.candidates import Candidates, candidates
from doe.column_generation import best_weights
from doe.draws import drawn_values
from doe.earlier import NOTHING, Earlier, in_reach, only, without_refused
from doe.executor import HERE, Executor
from doe.information import information_of
from doe.objective import Objective, objective
from doe.observations import Observer, identifiable, keep_columns, observer, stacked_visits
from doe.problem import make_problem
from doe.regions import check_test_poses, with_regions
from doe.subject import Subject
from identify.arrays import Floats, Ints
from identify.identifiability import Identifiability
from identify.study import Study

__all__ = ["AnyPool", "Pool", "build_pool", "measured_blocks"]

_ROUGH = 1e-3  # gap of the relaxed design that candidates are put in order by
_COMPARED = 4096  # blocks at a time

log = logging.getLogger("elastocal")


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

    @property
    def executor(self) -> Executor:
        """Who does independent pieces of work."""

    @property
    def draws(self) -> tuple[AnyPool, ...]:
        """The same candidates at other nominal values; empty where the plan is made at the nominal ones."""

    def information(self, blocks: Floats) -> Floats:
        """(p, p) of blocks (n, k, p) and of what is there already."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates with their blocks.

    Attributes:
        observer: How poses become blocks.
        candidates: The feasible candidates.
        known: Parameters that they, and what was measured, can identify.
        blocks: (N, k, p) on the identifiable parameters.
        objective: The criterion on these parameters.
        prior: (p, p) information of what was measured, or None.
        earlier: What was there before.
        draws: The same candidates at draws of the nominal values; empty if the plan is for the nominal ones.
        executor: Who does independent pieces of work.
    """

    observer: Observer
    candidates: Candidates
    known: Identifiability
    blocks: Floats
    objective: Objective
    prior: Floats | None = None
    earlier: Earlier = NOTHING
    draws: tuple[Pool, ...] = ()
    executor: Executor = HERE

    def information(self, blocks: Floats) -> Floats:
        """(p, p) of blocks (n, k, p) and of what is there already."""
        return information_of(blocks, self.prior)


def build_pool(study: Study, seed: int, earlier: Earlier = NOTHING, executor: Executor = HERE) -> Pool:
    """Candidates, their blocks and the objective; what was measured adds its information.

    Frame and markers are the same for measured and new visits, so both tell about them.

    Raises:
        InputError: The arm cannot stand in a test pose.
        NotIdentifiable: The criterion needs what neither candidates nor measured visits show.
        Infeasible: No candidate keeps to the constraints, or none is clear of what could not be measured.
    """
    stated, study = study, with_regions(study)
    drawn = drawn_values(study, seed) if study.plan.draws else ()
    chosen = without_refused(study, candidates(study, seed=seed, executor=executor), earlier)
    check_test_poses(stated)  # where nothing can be measured, that is told first
    watching = observer(study, own_visits=study.plan.references == "own_visits")
    blocks = watching.blocks(chosen.visit_q, chosen.visit_loads, executor)
    measured = measured_blocks(watching, earlier)
    if earlier.reached is not None:
        best = _most_promising(watching, blocks, measured)
        kept = in_reach(study, chosen, best, earlier.reached)
        chosen, blocks = only(chosen, kept, unreachable=int(len(kept) - kept.sum())), blocks[kept]
    known = identifiable(blocks, measured, parameters=watching.parameters)
    own = replace(_pool(watching, chosen, known, blocks, earlier, measured), executor=executor)
    draws = tuple(_at_values(own, replace(study, nominal=values)) for values in drawn)
    same = all(_equal(draw.blocks, own.blocks) for draw in draws)
    if same and draws:
        log.warning("%s: [plan] draws change nothing: these effects are linear in their values", study.path)
    return own if same else replace(own, draws=draws)


def _most_promising(watching: Observer, blocks: Floats, measured: Floats | None) -> Ints:
    """(N,) candidates in the order in which they would improve the relaxed design of all of them."""
    known = identifiable(blocks, measured, parameters=watching.parameters)
    aim = objective(watching, known, watching.study.plan.criterion)
    prior = None if measured is None else information_of(measured[:, :, known.kept])
    problem = make_problem(blocks[:, :, known.kept], aim.target(), aim.criterion, None, prior, None)
    return np.argsort(-best_weights(problem, _ROUGH).d, kind="stable")


def _at_values(pool: Pool, study: Study) -> Pool:
    """The same candidates and parameters at other nominal values."""
    nominal = pool.observer
    watching = replace(observer(study, own_visits=nominal.own_visits), reference=nominal.reference)
    blocks = watching.blocks(pool.candidates.visit_q, pool.candidates.visit_loads, pool.executor)
    measured = measured_blocks(watching, pool.earlier)
    return _pool(watching, pool.candidates, pool.known, blocks, pool.earlier, measured)


def _equal(first: Floats, second: Floats) -> bool:
    """True if blocks are the same but for rounding."""
    parts = (slice(start, start + _COMPARED) for start in range(0, len(first), _COMPARED))
    return all(np.allclose(first[part], second[part], rtol=1e-9, atol=0.0) for part in parts)


def measured_blocks(watching: Observer, earlier: Earlier) -> Floats | None:
    """(V, k, p) blocks of what was measured, whose visits are as they were, whatever those of the plan will be."""
    if earlier.measured is None:
        return None
    return stacked_visits(replace(watching, own_visits=False), earlier.measured)


def _pool(
    watching: Observer,
    chosen: Candidates,
    known: Identifiability,
    blocks: Floats,
    earlier: Earlier,
    measured: Floats | None,
) -> Pool:
    """A pool on the kept parameters; ``blocks`` (N, k, p) are used up, ``measured`` (V, k, p) is the prior."""
    prior = None if measured is None else information_of(measured[:, :, known.kept])
    aim = objective(watching, known, watching.study.plan.criterion)
    return Pool(watching, chosen, known, keep_columns(blocks, known.kept), aim, prior, earlier)
