"""The algebraic steps of model reduction: what is kept of coupled parameters, and what the others are set to.

Source: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", section 3.2, steps M5a to M5c.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.beams import tube_compliance
from identify.errors import NotIdentifiable
from identify.model import Model
from identify.partition import ROW_TOLERANCE, coupled_groups, coupling, partition, select, unit_columns
from identify.reduction_steps import Step, element_of, keep
from identify.study import Study

__all__ = ["CoupledGroup", "assigned_constants", "assignment", "check_complete", "holders", "split_and_select"]


@dataclass(frozen=True)
class CoupledGroup:
    """Parameters of G3 that are coupled among themselves and with no others (M5a).

    Attributes:
        names: All of them.
        kept: As many as the group has rank, chosen by preference (M5b).
        fixed: The others, assigned to constants (M5c).
    """

    names: tuple[str, ...]
    kept: tuple[str, ...]
    fixed: tuple[str, ...]

    @property
    def rank(self) -> int:
        """Number of parameters of the group that can be identified."""
        return len(self.kept)


def holders(step: Step) -> dict[str, str]:
    """Element -> the joint that M3 merged into it."""
    return {
        step.after[row]: name
        for name in step.removed
        for row in np.flatnonzero(step.contract[:, step.before.index(name)])
    }


def split_and_select(
    matrix: Floats, names: tuple[str, ...], coupled: set[str], order: Iterable[int]
) -> tuple[CoupledGroup, ...]:
    """M5a and M5b: the coupled groups of G3 and what is kept of each."""
    index = np.array([i for i, name in enumerate(names) if name in coupled], dtype=np.int64)
    place = {column: rank for rank, column in enumerate(order)}
    return tuple(_group(matrix, names, index[group], place) for group in coupled_groups(matrix[:, index]))


def _group(matrix: Floats, names: tuple[str, ...], columns: Ints, place: Mapping[int, int]) -> CoupledGroup:
    order = sorted(range(len(columns)), key=lambda i: place[int(columns[i])])
    kept = set(select(matrix[:, columns], order).tolist())
    listed = [names[i] for i in columns]
    return CoupledGroup(
        tuple(listed),
        tuple(name for i, name in enumerate(listed) if i in kept),
        tuple(name for i, name in enumerate(listed) if i not in kept),
    )


def assignment(matrix: Floats, names: tuple[str, ...], constants: Mapping[str, float]) -> Step:
    """M5: the kept parameters take over what the assigned ones do beyond their constants (eq. 21)."""
    after = tuple(name for name in names if name not in constants)
    plain = keep("M5", "splitting, selection and assignment", "eq. 21", names, after)
    contract = coupling(matrix, np.array([names.index(name) for name in after], dtype=np.int64))
    assigned = np.array([constants.get(name, 0.0) for name in names])
    return Step(plain.name, plain.what, plain.source, names, after, plain.expand, contract, assigned)


def assigned_constants(study: Study, model: Model, names: Iterable[str]) -> dict[str, float]:
    """M5c: the value of the beam of its link where one is stated, else zero; in result units."""
    scales = {parameter.name: parameter.scale for parameter in model.parameters}
    tubes = {link: tube_compliance(tube) for link, tube in study.reduce.tubes.items()}
    values = dict.fromkeys(names, 0.0)
    for name in values:
        place = element_of(name)
        if place is not None and place[0] in tubes:
            values[name] = float(tubes[place[0]][place[1][0] - 1, place[1][1] - 1] / scales[name])
    return values


def check_complete(study: Study, step: Step, matrix: Floats, rank: int) -> None:
    """Completeness (eq. 14): the reduced parameters deflect the arm in every way that those before did.

    Raises:
        NotIdentifiable: The rank is not kept, or the reduced parameters do not reproduce the columns before.
    """
    after = matrix @ step.expand
    units, norms = unit_columns(matrix)
    inverse = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    missed = np.linalg.norm(units - after @ (step.contract * inverse), axis=0).max(initial=0.0)
    found = partition(after).rank
    if found != rank or missed > ROW_TOLERANCE:
        raise NotIdentifiable(
            f"{study.path}: step {step.name} of the reduction would be incomplete: rank {found} instead of {rank}, "
            f"columns missed by {missed:.1g}; the rank is not clear, so more or other configurations are needed"
        )
