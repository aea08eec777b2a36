"""Is a whole file in the wrong units? Joint values against limits, positions against the robot's reach.

Single wild rows are not looked at here: they stay in the data and are found by the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from identify.alignment import align
from identify.arrays import Floats, Ints
from identify.kinematics import forward
from identify.study import Study
from identify.units import DEG

__all__ = ["joint_mistakes", "unit_mistakes"]

_MANY_TURNS = 20 * math.pi  # no arm turns that far, whatever its file says about limits
_SLACK = 0.5 * DEG  # rad or m beyond the limits that a reading may be
_SAMPLE = 2000  # rows that units are judged on
_UNITS = ((1000.0, "m"), (10.0, "cm"), (25.4, "inch"), (0.001, "um"))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of flange markers: joint values (R, n) rad or m, marker (R, 3) m, position (R, 3) m."""

    study: Study
    q: Floats
    marker: Floats
    position: Floats

    def predicted(self, q: Floats) -> Floats:
        """(R, 3) where the markers would be, base frame, m."""
        return forward(self.study.robot, q).point(self.marker)

    def misfit(self, q: Floats, scale: float) -> float:
        """Median distance between predicted and measured positions if the units were others, m."""
        source, target = self.predicted(q), self.position * scale
        if self.study.frame_free:
            placement = align(source, target)
            source = source @ placement[:3, :3].T + placement[:3, 3]
        return float(np.median(np.linalg.norm(source - target, axis=1)))


def joint_mistakes(study: Study, q: Floats) -> list[str]:
    """What speaks against joint values (R, n) being in deg (mm), from limits and size alone."""
    outside = _outside_limits(study, q).any(axis=1)
    if outside.mean() > 0.5:
        return [_limits_message(study, q, int(outside.sum()))]
    turning = q[:, ~study.robot.prismatic]
    poses = len(np.unique(turning, axis=0))
    if poses >= 5 and turning.shape[1] >= 3 and _like_radians(turning) and np.sqrt(np.mean(turning**2)) > 0.3 * DEG:
        largest = np.abs(turning).max() / DEG
        return [f"all joint values lie within {largest:.3g} deg of zero: they look like rad, q columns are in deg"]
    return []


def unit_mistakes(study: Study, q: Floats, marker: Ints, position: Floats) -> list[str]:
    """What speaks against the units of a measurement file.

    Args:
        study: Robot, markers and frame.
        q: (R, n) joint values, rad or m.
        marker: (R,) index into the markers.
        position: (R, 3) readings, m.

    Returns:
        Messages; none if the file is plausible.
    """
    outside = _outside_limits(study, q).any(axis=1)
    far = _outside_reach(study, q, marker, position)
    messages = []
    if (outside | far).mean() > 0.5:
        if outside.any():
            messages.append(_limits_message(study, q, int(outside.sum())))
        if far.any():
            frame = "" if study.frame_free else ", in the base frame (else state [frames] measurement = 'free')"
            messages.append(
                f"{far.sum()} of {len(far)} positions are out of reach: x_mm, y_mm, z_mm must be in mm{frame}"
            )
    on_flange = np.flatnonzero(~study.markers.on_base[marker])
    if not len(on_flange):
        return messages
    sample = on_flange[:: -(-len(on_flange) // _SAMPLE)]
    rows = _Rows(study, q[sample], study.markers.positions[marker[sample]], position[sample])
    return messages + _other_units(rows)


def _other_units(rows: _Rows) -> list[str]:
    """Units that fit the readings far better than the stated ones."""
    expected, found = _spread(rows.predicted(rows.q)), _spread(rows.position)
    turning = ~rows.study.robot.prismatic
    radians = rows.q.copy()
    radians[:, turning] /= DEG
    options: list[tuple[Floats, float, str]] = []
    if _like_radians(rows.q[:, turning]):
        options = [(radians, 1.0, "q columns look like rad, they must be in deg")]
        options += [
            (radians, scale, f"q columns look like rad and positions like {unit}, they must be in deg and mm")
            for scale, unit in _UNITS
        ]
    if not 0.2 * expected <= found <= 5 * expected:
        text = "positions look like {}, x_mm, y_mm, z_mm must be in mm"
        options += [(rows.q, scale, text.format(unit)) for scale, unit in _UNITS]
    if options and len(np.unique(rows.position, axis=0)) >= 4:
        fits = [rows.misfit(q, scale) for q, scale, _ in options]
        best = int(np.argmin(fits))
        if fits[best] < 0.1 * min(rows.misfit(rows.q, 1.0), _spread(rows.predicted(options[best][0]))):
            return [f"{options[best][2]} (they then fit to {fits[best] * 1e3:.3g} mm)"]
    if expected > 0.01 and found < expected / 100:
        return [
            f"positions spread by {found * 1e3:.3g} mm where the joint values imply {expected * 1e3:.3g} mm: "
            "x_mm, y_mm, z_mm must be in mm (the values look like m)"
        ]
    return []


def _outside_limits(study: Study, q: Floats) -> np.ndarray:
    """(R, n) True where a joint value is beyond the limits."""
    robot = study.robot
    turns = np.where(robot.prismatic, np.inf, _MANY_TURNS)
    low = np.where(np.isfinite(robot.lower), robot.lower, -turns)
    high = np.where(np.isfinite(robot.upper), robot.upper, turns)
    return np.asarray((q < low - _SLACK) | (q > high + _SLACK))


def _outside_reach(study: Study, q: Floats, marker: Ints, position: Floats) -> np.ndarray:
    """(R,) True where a flange marker was read farther away than the robot reaches.

    In a free frame the centre is unknown: there no two readings are farther apart than twice the reach.
    """
    on_flange = ~study.markers.on_base[marker]
    if not on_flange.any():
        return on_flange
    radius = 1.05 * (_reach(study, q) + np.linalg.norm(study.markers.positions[marker], axis=1))
    centre = np.zeros(3)
    if study.frame_free:
        centre, radius = np.median(position[on_flange], axis=0), 2 * radius
    return np.asarray(on_flange & (np.linalg.norm(position - centre, axis=1) > radius))


def _reach(study: Study, q: Floats) -> float:
    """Reach of the flange, m, with the slides of unknown limits as far out as they were."""
    unknown = study.robot.prismatic & ~np.isfinite(study.robot.upper - study.robot.lower)
    return study.robot.reach + float(np.abs(q[:, unknown]).max(axis=0).sum())


def _limits_message(study: Study, q: Floats, count: int) -> str:
    """Says which joint is out most often and what its values look like."""
    robot = study.robot
    outside = _outside_limits(study, q)
    j = int(outside.sum(axis=0).argmax())
    unit = study.joint_units[j]
    name = "mm" if robot.prismatic[j] else "deg"
    text = (
        f"{count} of {len(q)} rows have joint values outside the limits, most often q{j + 1}_{name} (limits "
        f"{robot.lower[j] / unit:.6g} to {robot.upper[j] / unit:.6g}, median {np.median(q[:, j]) / unit:.6g})"
    )
    turning = np.where(robot.prismatic, 1.0, DEG)
    if not robot.prismatic.all():
        if not _outside_limits(study, q / turning).any(axis=1).mean() > 0.5 and _like_radians(q[:, ~robot.prismatic]):
            return f"{text}: the values look like rad, q columns are in deg"
        if not _outside_limits(study, q * turning).any(axis=1).mean() > 0.5:
            return f"{text}: the values look like deg that were converted from rad once too often"
    return f"{text}: q columns are in deg (mm where a joint slides), in the robot file's own convention"


def _like_radians(turning: Floats) -> bool:
    """True if values (R, k), rad after conversion, were all at most one turn *before* it."""
    largest = np.abs(turning).max(initial=0.0) / DEG
    return bool(0 < largest <= 2 * math.pi + 1e-6)


def _spread(points: Floats) -> float:
    """Median distance from the middle, m; a few wild points do not count."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
