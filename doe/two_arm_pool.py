"""What a plan for two arms is chosen from: the candidates of both, on common parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.candidates import Candidates, candidates
from doe.design_choices import open_choices
from doe.executor import HERE, Executor
from doe.information import information_of
from doe.objective import Objective, objective
from doe.observations import identifiable, keep_columns
from doe.storage import joined
from doe.two_arms import TwoArmObserver, two_arm_observer
from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.identifiability import Identifiability
from identify.two_arm_study import TwoArmStudy

__all__ = ["TwoArmPool", "build_two_arm_pool", "drawn", "kept_of"]


@dataclass(frozen=True, eq=False)
class TwoArmPool:
    """Candidates of both arms with their blocks.

    Attributes:
        observer: How poses become blocks.
        candidates: The feasible candidates of each arm.
        known: Parameters that they can identify together.
        blocks: (N1 + N2, k, p) on the identifiable parameters, those of the first arm first.
        objective: The criterion on these parameters.
    """

    observer: TwoArmObserver
    candidates: tuple[Candidates, Candidates]
    known: Identifiability
    blocks: Floats
    objective: Objective

    @property
    def prior(self) -> None:
        """Nothing is known before."""

    @property
    def executor(self) -> Executor:
        """This process: plans for two arms are small."""
        return HERE

    @property
    def draws(self) -> tuple[()]:
        """Plans for two arms are made at the nominal values."""
        return ()

    def information(self, blocks: Floats) -> Floats:
        """(p, p) of blocks (n, k, p)."""
        return information_of(blocks)

    def of_arm(self, chosen: Ints, side: int) -> Ints:
        """Indices into the candidates of one arm, for those of the (n,) chosen candidates that are its own."""
        first = len(self.candidates[0])
        mine = chosen >= first if side else chosen < first
        return np.asarray(chosen[mine] - first * side)


def build_two_arm_pool(study: TwoArmStudy, seed: int) -> TwoArmPool:
    """Candidates of both arms, their blocks and the objective.

    Raises:
        InputError: An arm wants its unloaded readings in visits of their own.
        NotIdentifiable: The criterion needs what no candidate of either arm shows.
        Infeasible: An arm has no candidate that keeps to its constraints.
    """
    for arm in study.arms:
        if arm.study.plan.references == "own_visits":
            raise InputError(
                f'{arm.study.path}: [plan] references = "own_visits" is for the arm alone; a plan of both arms '
                'takes "same_visit"'
            )
    watching = two_arm_observer(study)
    first, second = (drawn(study, side, seed) for side in (0, 1))
    blocks = joined(*(watching.blocks(side, c.visit_q, c.visit_loads) for side, c in enumerate((first, second))))
    known = identifiable(blocks, parameters=watching.parameters)
    aim = objective(watching, known, study.plan.criterion)
    return TwoArmPool(watching, (first, second), known, keep_columns(blocks, known.kept), aim)


def drawn(study: TwoArmStudy, side: int, seed: int) -> Candidates:
    """The candidates of one arm: half of what the plan of both asks for, by the constraints of its own study."""
    own = study.arms[side].study
    if open_choices(own):
        raise InputError(
            f"{own.path}: the tracker's station or the markers are still to be chosen; plan this arm alone first and "
            "name the planned.toml that this writes in [[arms]] study"
        )
    count = max(study.plan.candidates // 2, 1)
    return candidates(replace(own, plan=replace(own.plan, candidates=count)), seed=seed)


def kept_of(watching: TwoArmObserver, known: Identifiability, side: int) -> tuple[Ints, Ints]:
    """Kept columns of one arm's model, and where they stand among the (p,) kept ones of both."""
    columns = watching.columns[side]
    own = np.flatnonzero(np.isin(columns, known.kept))
    return own, np.searchsorted(known.kept, columns[own])
