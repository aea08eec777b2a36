"""Which parameters the rows can show, decided by rank in a stated order of preference.

Columns are scaled to unit length; one that lies within `TOLERANCE` of the span of those kept before
it adds nothing, is held at its nominal value and is reported with the columns it cannot be told from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import Parameter
from identify.model import Model

__all__ = [
    "TOLERANCE",
    "Dropped",
    "Identifiability",
    "explained",
    "independent_columns",
    "triangle",
    "why_not",
    "why_zero",
]

TOLERANCE = 1e-9
_CHUNK = 100_000
_ROUNDING = 64 * float(np.finfo(np.float64).eps)  # a column below this share of the largest is rounding noise
_SHARE = 1e-6  # a kept column takes part if it carries this share of a dropped one


@dataclass(frozen=True, eq=False)
class Dropped:
    """A column that adds nothing.

    Attributes:
        column: Its index.
        alike: Indices of the kept columns it is a combination of; empty if it is zero.
        coefficients: The combination: column = sum coefficients * kept columns.
        std: What its standard deviation would at least be, in its unit; infinite if it adds nothing at all.
    """

    column: int
    alike: tuple[int, ...]
    coefficients: Floats
    std: float = float("inf")


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Kept and dropped columns.

    Attributes:
        kept: (rank,) indices of the kept columns, ascending.
        dropped: The others.
    """

    kept: Ints
    dropped: tuple[Dropped, ...]

    @property
    def rank(self) -> int:
        """Number of kept columns."""
        return len(self.kept)


def triangle(parts: Iterable[Floats]) -> Floats:
    """R factor (p, p) of stacked rows, given in parts (K_i, p), without ever stacking them."""
    upper = np.zeros((0, 0))
    for part in parts:
        for start in range(0, max(len(part), 1), _CHUNK):
            rows = part[start : start + _CHUNK]
            stacked = np.vstack([upper, rows]) if upper.size else rows
            upper = np.asarray(np.linalg.qr(stacked, mode="r"))
    return upper


def independent_columns(upper: Floats, limits: Floats | None = None, spread: float = 1.0) -> Identifiability:
    """Keep columns from left to right as long as they add a direction.

    Args:
        upper: (m, p) whitened rows or their R factor.
        limits: (p,) keep a column only if its standard deviation, with all later ones fixed, is within this limit.
        spread: How much larger the scatter is than the unit that the rows are whitened to.
    """
    norms = np.linalg.norm(upper, axis=0)
    norms = np.where(norms > _ROUNDING * norms.max(initial=0.0), norms, 0.0)
    smallest = TOLERANCE * norms if limits is None else np.maximum(TOLERANCE * norms, spread / limits)
    basis = np.zeros(upper.shape, order="F")
    kept: list[int] = []
    dropped: list[tuple[int, float]] = []
    for column in range(upper.shape[1]):
        fresh = upper[:, column]
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            before = basis[:, : len(kept)]
            fresh = fresh - before @ (before.T @ fresh)
        size = np.linalg.norm(fresh)
        if norms[column] > 0 and size > smallest[column]:
            basis[:, len(kept)] = fresh / size
            kept.append(column)
        else:
            dropped.append((column, float(spread / size) if size > TOLERANCE * norms[column] > 0 else float("inf")))
    return Identifiability(np.array(kept, dtype=np.int64), _explained(upper, norms, np.array(kept, np.int64), dropped))


def _explained(upper: Floats, norms: Floats, kept: Ints, dropped: list[tuple[int, float]]) -> tuple[Dropped, ...]:
    """Write dropped columns as combinations of kept ones."""
    visible = [column for column, _ in dropped if norms[column] > 0.0] if len(kept) else []
    unit = upper[:, kept] / norms[kept]
    shares = np.linalg.lstsq(unit, upper[:, visible] / norms[visible], rcond=None)[0] if visible else np.zeros((0, 0))
    made = []
    for column, std in dropped:
        if column not in visible:
            made.append(Dropped(column, (), np.zeros(0), std))
            continue
        share = shares[:, visible.index(column)]
        used = np.abs(share) > _SHARE
        alike = kept[used]
        made.append(Dropped(column, tuple(alike.tolist()), share[used] * norms[column] / norms[alike], std))
    return tuple(made)


def why_not(model: Model, dropped: Dropped) -> str:
    """In words, why a parameter of a model cannot be identified."""
    return explained(model.parameters, dropped, lambda column: why_zero(model, column))


def explained(parameters: Sequence[Parameter], dropped: Dropped, zero: Callable[[int], str]) -> str:
    """In words, why one of these parameters cannot be identified; ``zero`` tells why a column is zero."""
    names = [parameter.name for parameter in parameters]
    if np.isfinite(dropped.std):
        unit = parameters[dropped.column].unit
        return f"these data tell it to no better than {dropped.std:.2g} {unit}; held at its nominal value"
    if dropped.alike:
        others = ", ".join(names[other] for other in dropped.alike[:4])
        more = f" and {len(dropped.alike) - 4} more" if len(dropped.alike) > 4 else ""
        return f"moves the markers exactly like {others}{more}; held at its nominal value"
    return zero(dropped.column)


def why_zero(model: Model, column: int) -> str:
    """In words, why no reading depends on a parameter."""
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if where.start <= column < where.stop:
            return effect.why_zero(column - where.start)
    return "no reading depends on it"
