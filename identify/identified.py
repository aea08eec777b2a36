"""What was identified, as linear functions of the parameters of a fuller model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.errors import InputError, NotIdentifiable
from identify.identifiability import triangle
from identify.identification import Identification
from identify.partition import coupling
from identify.positive_cone import is_compliance
from identify.reduction import Reduction

__all__ = ["Identified", "identified_by_fit", "identified_values"]


@dataclass(frozen=True, eq=False)
class Identified:
    """Known linear functions of parameters: ``matrix @ x = values``, all in result units.

    Attributes:
        full: Names of the P parameters x.
        names: Names of the r functions: the kept parameters, which stand for all that is coupled with them.
        matrix: (r, P).
        values: (r,).
        covariance: (r, r), or None if it is not known.
        fixed: Names of parameters in ``full`` that the model holds at constants -> their values.
    """

    full: tuple[str, ...]
    names: tuple[str, ...]
    matrix: Floats
    values: Floats
    covariance: Floats | None = None
    fixed: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only.

        Raises:
            InputError: Shapes that do not fit, or values that are not finite.
        """
        rows, columns = len(self.names), len(self.full)
        for key, shape in (("matrix", (rows, columns)), ("values", (rows,)), ("covariance", (rows, rows))):
            if getattr(self, key) is None:
                continue
            array = frozen(getattr(self, key))
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(f"identified {key} of shape {array.shape}: finite numbers of shape {shape} expected")
            object.__setattr__(self, key, array)


def identified_values(reduction: Reduction, values: Floats, covariance: Floats | None = None) -> Identified:
    """Values of the kept parameters as functions of joints and link elements before aggregation (stage M2).

    Args:
        reduction: The chain of reduction.
        values: (r,) kept parameters in result units, with the constants of step M5 held.
        covariance: (r, r) of them.
    """
    matrix, offset = _functions(reduction)
    return Identified(reduction.steps[1].after, reduction.kept, matrix, values - offset, covariance)


def _functions(reduction: Reduction) -> tuple[Floats, Floats]:
    """``kept = matrix x + offset`` for parameters x after M2: (r, P) and (r,)."""
    matrix, offset = np.eye(len(reduction.steps[1].after)), np.zeros(len(reduction.steps[1].after))
    for step in reduction.steps[2:]:
        matrix, offset = step.contract @ matrix, step.reduced(offset)
    return matrix, offset


def identified_by_fit(result: Identification, reduction: Reduction | None = None) -> Identified:
    """What a fit says about all compliances of its model, the coupled ones that it held included.

    Args:
        result: The fit.
        reduction: The reduction that its model comes from; then ``full`` is the model before M3.

    Raises:
        NotIdentifiable: No compliance was identified.
        InputError: The reduction does not know a parameter of the fit.
    """
    model, kept = result.model, result.fit.identifiability.kept
    asked = np.array([i for i, name in enumerate(model.names) if is_compliance(name)], dtype=np.int64)
    own = [i for i in kept.tolist() if i in set(asked.tolist())]
    if not own:
        raise NotIdentifiable(f"{result.study.path}: no compliance was identified, so there is nothing to reconstruct")
    seen = np.union1d(kept, asked)
    shares = coupling(triangle([result.fit.upper[:, seen]]), np.searchsorted(seen, kept))
    matrix = shares[np.ix_(np.searchsorted(kept, own), np.searchsorted(seen, asked))]
    names, values = tuple(model.names[i] for i in own), matrix @ result.values[asked]
    covariance = result.covariance[np.ix_(own, own)]
    full = tuple(model.names[i] for i in asked)
    if reduction is None:
        held = tuple((term.name, value) for effect in model.effects for term, value in effect.held)
        matrix = np.pad(matrix, ((0, 0), (0, len(held))))
        return Identified((*full, *(name for name, _ in held)), names, matrix, values, covariance, held)
    rows, offset = _rows_of(reduction, full)
    return Identified(reduction.steps[1].after, names, matrix @ rows, values - matrix @ offset, covariance)


def _rows_of(reduction: Reduction, names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """The functions of some kept parameters."""
    for name in names:
        if name not in reduction.kept:
            raise InputError(f"{name!r}: the reduction does not keep this parameter of the fit")
    index = [reduction.kept.index(name) for name in names]
    matrix, offset = _functions(reduction)
    return matrix[index], offset[index]
