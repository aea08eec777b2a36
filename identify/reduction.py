"""Reduction of the complete stiffness model to the parameters that given loads and markers can show.

Source: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", section 3: physical steps
M1 to M3 (`identify.reduction_steps`), algebraic steps M4 and M5 here, on the algebra of `identify.partition`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from types import MappingProxyType

import numpy as np

from identify.algebraic_steps import (
    CoupledGroup,
    assigned_constants,
    assignment,
    check_complete,
    holders,
    split_and_select,
)
from identify.arrays import Floats
from identify.effects.templates import check_link_options, link_template
from identify.errors import InputError, NotIdentifiable
from identify.fates import tell_fates
from identify.model import Model, model_of, without_nuisance
from identify.observation import observation_matrix, random_configurations
from identify.partition import Partition, partition
from identify.preference import check_patterns, preferred_order
from identify.reduction_steps import Step, aggregation, keep, sparsing, symmetrisation
from identify.study import Study
from identify.threads import one_thread

__all__ = ["Reduction", "complete_model", "reduce"]


@dataclass(frozen=True, eq=False)
class Reduction:
    """The chain from the full to the complete and irreducible model.

    Attributes:
        steps: M1 to M5; together they map all parameters to the kept ones and back.
        partition: The columns after M3 in three groups, with singular values and tolerance.
        coupled: The coupled groups of G3.
        ranks: Stage -> rank of the observation matrix; from M2 on no step may change it.
        constants: Parameters that M5 assigns -> their values, in their units.
        units: Unit of every parameter of the full model.
        fates: What became of every parameter of the full model.
        configurations: Number of configurations it was made from.
    """

    steps: tuple[Step, ...]
    partition: Partition
    coupled: tuple[CoupledGroup, ...]
    ranks: Mapping[str, int]
    constants: Mapping[str, float]
    units: Mapping[str, str]
    fates: Mapping[str, str]
    configurations: int

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Stage -> names of its parameters."""
        return {"full": self.steps[0].before, **{step.name: step.after for step in self.steps}}

    @property
    def chain(self) -> dict[str, int]:
        """Stage -> number of its parameters."""
        return {stage: len(names) for stage, names in self.names.items()}

    @property
    def rank(self) -> int:
        """Number of parameters that can be identified."""
        return self.partition.rank

    @property
    def kept(self) -> tuple[str, ...]:
        """Names of the parameters of the irreducible model."""
        return self.steps[-1].after

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Names in G1 (identifiable), G2 (not identifiable) and G3 (coupled)."""
        names, parts = self.steps[2].after, self.partition
        indices = {"G1": parts.identifiable, "G2": parts.invisible, "G3": parts.coupled}
        return {group: tuple(names[i] for i in index) for group, index in indices.items()}

    def fate(self, name: str) -> str:
        """What became of a parameter of the full model.

        Raises:
            InputError: The full model has no such parameter.
        """
        if name not in self.fates:
            first, last = self.steps[0].before[0], self.steps[0].before[-1]
            raise InputError(f"{name!r}: the full model has no such parameter; it has {first} ... {last}")
        return self.fates[name]

    def reduced(self, values: Floats) -> Floats:
        """Kept parameters (r,) that deflect the arm like given ones of the full model, in result units."""
        for step in self.steps:
            values = step.reduced(values)
        return values

    def expanded(self, values: Floats) -> Floats:
        """One set of parameters of the full model for given kept ones (r,): constants elsewhere."""
        for step in reversed(self.steps):
            values = step.expanded(values)
        return values


def reduce(study: Study, *, configurations: int | None = None, seed: int = 0, poses: Floats | None = None) -> Reduction:
    """Reduce the complete model of a study: every joint, and a 6x6 compliance at the end of every link.

    Experiments are random configurations within the limits, each with the loads of the study, read by all flange
    markers; what counts is the displacement by the load alone.

    Args:
        study: The study; `study.reduce` and the templates in ``[model.link_compliance]`` are followed.
        configurations: Number of configurations; default: what the study says (150).
        seed: Seed of the configurations.
        poses: (V, n) configurations to take instead of random ones, rad or m.

    Raises:
        InputError: A template that is not symmetric or a preference for a parameter that does not exist.
        NotIdentifiable: Nothing loads the robot, no parameter shows, or a step would lose rank.
    """
    model = complete_model(study)
    check_patterns(study.reduce.prefer, model.names, f"{study.path}: [reduce] prefer")
    if poses is None:
        count = study.reduce.configurations if configurations is None else configurations
        poses = random_configurations(study, count, np.random.default_rng(seed))
    with one_thread():
        matrix = observation_matrix(study, model, poses)
        return _algebraic(study, model, matrix, _physical_steps(study, model), len(poses))


def complete_model(study: Study) -> Model:
    """All joints and all 36 elements of all links, with the gravity compensators of the study."""
    special = (effect for effect in study.effects if effect.partition("@")[0] == "gravity_compensator")
    options = {**study.options, "link_compliance": {"template": "full"}}
    complete = replace(study, options=options, effects=("joint_compliance", "link_compliance", *special))
    known = model_of(complete, nominal={}).names
    return without_nuisance(model_of(complete, nominal={k: v for k, v in study.nominal.items() if k in known}))


def _physical_steps(study: Study, model: Model) -> tuple[Step, ...]:
    """M1 to M3; a joint whose compliance another effect depends on stays."""
    options, links = study.options.get("link_compliance", {}), study.robot.n + 1
    check_link_options(options, links)
    first = symmetrisation(model.names)
    second = sparsing(first.after, {link: link_template(options, link) for link in range(links)})
    borrowed = {name for effect in model.effects for name in effect.borrowed}
    return first, second, aggregation(second.after, study.robot, borrowed)


def _algebraic(study: Study, model: Model, full: Floats, physical: tuple[Step, ...], count: int) -> Reduction:
    """M4 and M5, and everything that is said about the result."""
    matrices = list(accumulate(physical, lambda matrix, step: matrix @ step.expand, initial=full))
    parts, before = partition(matrices[-1]), physical[-1].after
    if not parts.rank:
        raise NotIdentifiable(f"{study.path}: no parameter of the model shows in any reading", before)
    visible = tuple(before[i] for i in np.setdiff1d(np.arange(len(before)), parts.invisible))
    elimination = keep("M4", "partition and elimination", "eq. 15-20", before, visible)
    seen = matrices[-1] @ elimination.expand
    order = preferred_order(visible, holders(physical[-1]), study.reduce.prefer)
    groups = split_and_select(seen, visible, {before[i] for i in parts.coupled}, order)
    constants = assigned_constants(study, model, [name for group in groups for name in group.fixed])
    selection = assignment(seen, visible, constants)
    for step, matrix in zip((physical[-1], elimination, selection), (*matrices[-2:], seen), strict=True):
        check_complete(study, step, matrix, parts.rank)
    steps, units = (*physical, elimination, selection), {p.name: p.unit for p in model.parameters}
    ranks = {stage: partition(m).rank for stage, m in zip(("full", "M1", "M2", "M3"), matrices, strict=True)}
    ranks |= {"M4": parts.rank, "M5": parts.rank}
    told = tell_fates(steps, lambda name: _why_zero(model, name), constants, units)
    proxy = MappingProxyType
    return Reduction(steps, parts, groups, proxy(ranks), proxy(constants), proxy(units), proxy(told), count)


def _why_zero(model: Model, name: str) -> str:
    """Why no reading depends on a parameter."""
    column = model.names.index(name)
    pairs = zip(model.effects, model.effect_slices, strict=True)
    effect, where = next(pair for pair in pairs if pair[1].start <= column < pair[1].stop)
    return effect.why_zero(column - where.start)
