"""A coil spring beside a joint: its torque, the stiffness it adds, and how both follow from stiffness levels.

The spring runs from an anchor on the link before the joint to an anchor on the link after it. In the plane across
the joint axis, x leads from the axis to the moving anchor at joint value zero and y a quarter turn further in the
positive sense of the joint. With ``(a_x, a_y)`` from the fixed anchor to the axis and the moving anchor at radius L,

    s^2 = a^2 + L^2 + 2 L X,   X = a_x cos q + a_y sin q,   Y = a_y cos q - a_x sin q
    M   = dU/dq   = K_c (1 - s_0/s) L Y                            torque -M acts on the joint
    k   = d2U/dq2 = K_c (-L X) + K_c s_0 (L X / s + (L Y)^2 / s^3)

of the energy ``U = K_c/2 (s - s_0)^2``. With ``a = |(a_x, a_y)|``, ``alpha = atan2(a_y, a_x)`` these are
``X = a cos(alpha - q)``, ``Y = a sin(alpha - q)`` and ``k = K_c a L eta(q)``: the published form, see docs/theory.md.
Everything is linear in ``(K_c, K_c s_0)`` where the geometry is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.errors import InputError, NotIdentifiable

__all__ = ["LevelFit", "SpringGeometry", "harmonic_basis", "spring_basis", "spring_from_levels", "spring_slopes"]

_UNKNOWNS = ("K_2^0", "K_c", "K_c s_0")
_SINGULAR = 1e-9  # smallest singular value of unit columns that still counts


@dataclass(frozen=True)
class SpringGeometry:
    """Where the anchors of a spring are, m.

    Attributes:
        a_x: From the fixed anchor to the joint axis, along x (see the module).
        a_y: The same along y.
        radius: Distance L of the moving anchor from the axis.
    """

    a_x: float
    a_y: float
    radius: float


def spring_basis(geometry: SpringGeometry, q: Floats) -> Floats:
    """M and k per unit of ``K_c`` (N/m) and of ``K_c s_0`` (N), for joint values ``q`` (C,), rad.

    Returns:
        (2, C, 2): first axis M (Nm per unit) and k (Nm/rad per unit), last axis ``K_c`` and ``K_c s_0``.
    """
    along, across, length = _lever(geometry, q)
    moment = np.stack([across, -across / length], axis=-1)
    stiffness = np.stack([-along, along / length + across**2 / length**3], axis=-1)
    return np.stack([moment, stiffness])


def spring_slopes(geometry: SpringGeometry, q: Floats) -> Floats:
    """Derivative of `spring_basis` by ``a_x, a_y, radius``.

    Returns:
        (2, C, 2, 3) per m.
    """
    along, across, length = (part[:, None] for part in _lever(geometry, q))
    c, s, radius = np.cos(q), np.sin(q), geometry.radius
    x, y = along[:, 0] / radius, across[:, 0] / radius
    d_along = np.stack([radius * c, radius * s, x], axis=-1)
    d_across = np.stack([-radius * s, radius * c, y], axis=-1)
    own = np.broadcast_to([geometry.a_x, geometry.a_y, radius], d_along.shape)
    d_length = (own + np.stack([radius * c, radius * s, x], axis=-1)) / length
    moment = np.stack([d_across, across / length**2 * d_length - d_across / length], axis=1)
    bent = d_along / length - along / length**2 * d_length
    bent = bent + 2.0 * across * d_across / length**3 - 3.0 * across**2 / length**4 * d_length
    return np.stack([moment, np.stack([-d_along, bent], axis=1)])


def harmonic_basis(orders: tuple[int, ...], q: Floats) -> Floats:
    """M and k of a spring of unknown geometry, per Nm of each of its harmonics, for joint values ``q`` (C,), rad.

    Returns:
        (2, C, 2 len(orders)): first axis M (Nm) and k = dM/dq (Nm/rad), last axis sine and cosine of each order.
    """
    order = np.array(orders, dtype=np.float64)
    sine, cosine = np.sin(q[:, None] * order), np.cos(q[:, None] * order)
    pairs = np.array([[sine, cosine], [order * cosine, -order * sine]])
    return pairs.transpose(0, 2, 3, 1).reshape(2, len(q), -1)


def _lever(geometry: SpringGeometry, q: Floats) -> tuple[Floats, Floats, Floats]:
    """``L X``, ``L Y`` (m^2) and the length s (m) of the spring, each (C,)."""
    c, s, radius = np.cos(q), np.sin(q), geometry.radius
    along = radius * (geometry.a_x * c + geometry.a_y * s)
    across = radius * (geometry.a_y * c - geometry.a_x * s)
    square = geometry.a_x**2 + geometry.a_y**2 + radius**2 + 2.0 * along
    return along, across, np.sqrt(square)


@dataclass(frozen=True, eq=False)
class LevelFit:
    """A spring found from the stiffness of its joint at several joint values.

    Attributes:
        stiffness: ``K_2^0``, stiffness of the joint without the spring, Nm/rad.
        spring: ``K_c``, N/m.
        preload: ``K_c s_0``, N.
        covariance: (3, 3) of these three.
        chi2: Weighted sum of squares of what is left.
        dof: Levels minus unknowns.
    """

    stiffness: float
    spring: float
    preload: float
    covariance: Floats
    chi2: float
    dof: int

    @property
    def free_length(self) -> float:
        """``s_0``, m."""
        return self.preload / self.spring


def spring_from_levels(q: Floats, compliance: Floats, covariance: Floats, geometry: SpringGeometry) -> LevelFit:
    """Second step of the two-step fit: ``1/c = K_2^0 + K_c a L eta(q)`` by weighted linear least squares.

    The covariance of ``1/c`` is that of c, to first order: ``diag(c^-2) covariance diag(c^-2)``.

    Args:
        q: (l,) levels of the joint, rad.
        compliance: (l,) whole compliance of the joint at each level, rad/Nm.
        covariance: (l, l) of these.
        geometry: Where the anchors are.

    Raises:
        InputError: Shapes do not fit, a compliance is not positive, or there are fewer levels than unknowns.
        NotIdentifiable: These levels cannot tell the three unknowns apart.
    """
    _check_levels(q, compliance, covariance)
    rows = np.column_stack([np.ones(len(q)), spring_basis(geometry, q)[1]])
    inverse = np.diag(compliance**-2.0)
    whiten = np.linalg.inv(np.linalg.cholesky(inverse @ covariance @ inverse))
    columns, target = whiten @ rows, whiten @ (1.0 / compliance)
    norms = np.linalg.norm(columns, axis=0)
    u, size, v = np.linalg.svd(columns / norms, full_matrices=False)
    if size[-1] < _SINGULAR * size[0]:
        raise NotIdentifiable(
            f"the levels {_degrees(q)} cannot tell {', '.join(_UNKNOWNS)} apart; measure at other values of the joint",
            _UNKNOWNS,
        )
    root = (v.T / size) / norms[:, None]
    found = root @ (u.T @ target)
    left = target - columns @ found
    stiffness, spring, preload = found.tolist()
    return LevelFit(stiffness, spring, preload, frozen(root @ root.T), float(left @ left), len(q) - len(found))


def _check_levels(q: Floats, compliance: Floats, covariance: Floats) -> None:
    """Refuse what is no set of levels."""
    if q.ndim != 1 or compliance.shape != q.shape or covariance.shape != (len(q), len(q)):
        raise InputError(
            f"levels have shape {q.shape}, compliances {compliance.shape} and their covariance {covariance.shape}; "
            "needed: (l,), (l,), (l, l)"
        )
    distinct = len(np.unique(np.round(q, 9)))
    if distinct < len(_UNKNOWNS):
        raise InputError(
            f"{distinct} levels of the joint ({_degrees(q)}) for {len(_UNKNOWNS)} unknowns ({', '.join(_UNKNOWNS)}); "
            "measure at three levels or more"
        )
    if not (compliance > 0.0).all():
        level = int(np.argmin(compliance))
        raise InputError(
            f"compliance {compliance[level]:.3g} rad/Nm at level {_degrees(q[level : level + 1])} is not positive, "
            "so it has no stiffness; the level is too poorly known"
        )


def _degrees(q: Floats) -> str:
    return ", ".join(f"{value:.4g}" for value in np.degrees(q)) + " deg"
