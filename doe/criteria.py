"""The five criteria: value, sensitivities and the numerator of the proven bound.

Every criterion is a convex function of the information ``M(w) = sum_i w_i A_i'A_i + P``. At any M it
gives a factor R with sensitivities ``d_i = |A_i R|^2``, and for every feasible w'

    value(w') >= numerator / (max over feasible w of sum_i w_i d_i + <P, R R'>)

(Pukelsheim, Optimal Design of Experiments, 1993, chapter 7; the maximum is over a linear function, so
caps and costs enter there and nowhere else). The table gives R and the numerator; Y = M^-1 C'.

    test_pose  trace(C M^-1 C')            R = Y                       value^2
    A          the same with C = I
    D          det(M)^(-1/p)               R R' = M^-1                 p value
    G          max_t trace(C_t M^-1 C_t')  R R' = sum v_t Y_t Y_t'     (sum v_t value_t)^2
    E          1/lambda_min(M)             R R' = X                    1

v >= 0 with sum 1 and X >= 0 with trace 1 are the duals of G and E. They come from the smooth function

    min over tau of   tau - mu sum_t log(tau - value_t)       or      -tau - mu log det(M - tau I)

whose weights ``v_t = mu/(tau - value_t)`` and ``X = mu (M - tau I)^-1`` tend to the optimal dual as mu -> 0
(the barrier of Nesterov and Nemirovskii, 1994). A, D and test_pose are smooth and do not use mu.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from doe.criterion import Certificate, Criterion, Local
from doe.minimax_criteria import MinimumEigenvalue, Worst
from doe.row_space import RowSpace
from doe.smooth_criteria import Mean, Volume
from identify.arrays import Floats
from identify.errors import InputError, NotIdentifiable

__all__ = [
    "NAMES",
    "Certificate",
    "Criterion",
    "Local",
    "Mean",
    "MinimumEigenvalue",
    "Volume",
    "Worst",
    "criterion_for",
]

NAMES = ("test_pose", "A", "D", "E", "G")


def criterion_for(name: str, space: RowSpace, target: Floats | None) -> Criterion:
    """The criterion ``name`` in the coordinates of ``space``.

    Args:
        name: test_pose, A, D, E or G.
        space: Row space of the candidates.
        target: (r, p) rows for test_pose, (t, r, p) for G, ignored otherwise.

    Raises:
        InputError: Unknown name, or a target that is missing, of the wrong shape, not finite or zero.
        NotIdentifiable: The target leaves the row space, or A, D or E need parameters that nobody sees.
    """
    if name not in NAMES:
        raise InputError(f"criterion is {name!r}, allowed: {', '.join(NAMES)}")
    p = len(space.norms)
    if name == "test_pose":
        return Mean(space.reduce(_checked_target(target, p, 2)))
    if name == "G":
        return Worst(space.reduce(_checked_target(target, p, 3)))
    if not space.full:
        missing = space.unseen()
        raise NotIdentifiable(
            f"criterion {name} needs all {p} parameters, the candidates see {space.basis.shape[1]} directions; "
            f"columns {list(missing)} are not or not separately seen",
            missing,
        )
    kinds: dict[str, Callable[[Floats], Criterion]] = {"A": Mean, "D": Volume, "E": MinimumEigenvalue}
    return kinds[name](space.basis)


def _checked_target(target: Floats | None, p: int, dimensions: int) -> Floats:
    """The target as float64 array of the right shape."""
    shape = "(r, p)" if dimensions == 2 else "(t, r, p)"
    if target is None:
        raise InputError(f"target is missing, needed: {shape} with p = {p}")
    rows = np.asarray(target)
    if rows.dtype.kind not in "fiu" or rows.ndim != dimensions or 0 in rows.shape or rows.shape[-1] != p:
        raise InputError(f"target has shape {rows.shape} and dtype {rows.dtype}, needed: real {shape} with p = {p}")
    rows = rows.astype(np.float64)
    if not np.isfinite(rows).all():
        raise InputError("target holds NaN or infinity, needed: finite numbers")
    if not rows.any():
        raise InputError("target has only zeros: every plan would be optimal")
    return rows
