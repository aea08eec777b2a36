"""Which visits may be measured: joint limits, floor, self-collision and rated payload, many poses at once.

A visit is one pose and the loads that are read there. Its reason is the first of `REASONS` that applies.

* *joint_limits*: within the limits less the margin.
* *floor*: joint origins, flange, flange markers and the attach points of the visit's loads stand at or above the
  floor. Points whose height no joint can change (the base column) are left out, see `floor_points`.
* *self_collision*: capsules around the links keep apart, see `doe.capsules`.
* *payload*: hung mass and tool within the stated share of the rated payload, where that is known.

Under ``[plan] approach = "same"`` the place from which a pose is approached (every joint lower) must keep to limits,
floor and self-collision too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from doe.capsules import Capsules, capsules
from identify.arrays import Floats, Ints, frozen
from identify.kinematics import Frames, forward
from identify.robot import Robot
from identify.study import Study

__all__ = [
    "FEASIBLE",
    "REASONS",
    "Feasibility",
    "FloorPoints",
    "Screen",
    "approach_of",
    "check",
    "count_reasons",
    "floor_points",
    "joint_range",
    "screen",
]

#: Why a visit may not be measured, in the order in which the reasons are looked at.
REASONS = ("joint_limits", "floor", "self_collision", "payload")
FEASIBLE = len(REASONS)  # the code of a visit without a reason

_CHUNK = 4096  # poses at a time
_ROUNDING = 1e-9  # rad or m: limits and heights hold up to this
_STILL = 1e-4  # m: a height that changes by less does not depend on the joints (files round angles to 1e-5 or so)


@dataclass(frozen=True, eq=False)
class Feasibility:
    """Which of N visits may be measured.

    Attributes:
        codes: (N,) index into `REASONS` of the first reason against a visit; `FEASIBLE` if there is none.
    """

    codes: np.ndarray

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "codes", frozen(self.codes, np.int8))

    @property
    def ok(self) -> np.ndarray:
        """(N,) True where a visit may be measured."""
        return np.asarray(self.codes == FEASIBLE)

    @property
    def reasons(self) -> tuple[str, ...]:
        """(N,) first reason against each visit; empty text if there is none."""
        words = (*REASONS, "")
        return tuple(words[code] for code in self.codes)

    @property
    def rejected(self) -> dict[str, int]:
        """Number of visits by reason."""
        return count_reasons(self.codes)


@dataclass(frozen=True, eq=False)
class FloorPoints:
    """Points of the arm that must stay above the floor and whose height depends on the joints.

    Attributes:
        joints: (J,) joints whose origin counts.
        local: (P, 3) points in the flange frame, m: flange origin, flange markers, attach points.
    """

    joints: Ints
    local: Floats

    def heights(self, frames: Frames) -> Floats:
        """(N, J + P) world heights from the base origin, m."""
        up = frames.robot.world_R_base[2]
        up_in_flange = np.einsum("i,vij->vj", up, frames.flange_rotation)
        flange = (frames.flange_origin @ up)[:, None] + up_in_flange @ self.local.T
        return np.concatenate([frames.origin[:, self.joints] @ up, flange], axis=1)


@dataclass(frozen=True, eq=False)
class Screen:
    """Everything about a study that its poses are checked with.

    Attributes:
        study: The study.
        arm: Points of the arm above the floor, without the loads.
        attached: For each load of the study, its points above the floor.
        capsules: The arm's capsules.
        carried: (loads,) True where the rated payload allows a load.
    """

    study: Study
    arm: FloorPoints
    attached: tuple[FloorPoints, ...]
    capsules: Capsules
    carried: np.ndarray

    def codes(self, q: Floats) -> np.ndarray:
        """First reason against each load at each pose.

        The reason against a visit is the smallest code of its loads.

        Args:
            q: (N, n) joint values, rad or m.

        Returns:
            (N, loads) index into `REASONS`, or `FEASIBLE`.
        """
        parts = [self._approached(q[start : start + _CHUNK]) for start in range(0, len(q), _CHUNK)]
        return np.concatenate(parts) if parts else np.empty((0, len(self.carried)), dtype=np.int8)

    def _approached(self, q: Floats) -> np.ndarray:
        """`codes` of a few poses, and of where they are approached from."""
        codes, below = self._chunk(q), approach_of(self.study)
        return np.minimum(codes, self._chunk(q - below)) if below.any() else codes

    def _chunk(self, q: Floats) -> np.ndarray:
        """`codes` of a few poses by themselves; the later a check is written, the less it counts."""
        frames = forward(self.study.robot, q)
        codes = np.full((len(q), len(self.carried)), FEASIBLE, dtype=np.int8)
        codes[:, ~self.carried] = REASONS.index("payload")
        codes[self._colliding(frames)] = REASONS.index("self_collision")
        codes[self._below(frames)] = REASONS.index("floor")
        lower, upper = _limits(self.study)
        outside = (q < lower - _ROUNDING) | (q > upper + _ROUNDING)
        codes[outside.any(axis=1)] = REASONS.index("joint_limits")
        return codes

    def _colliding(self, frames: Frames) -> np.ndarray:
        """(N,) True where capsules touch."""
        if not self.capsules.first.size:
            return np.zeros(len(frames.origin), dtype=bool)
        return np.asarray(self.capsules.touching(frames).any(axis=1))

    def _below(self, frames: Frames) -> np.ndarray:
        """(N, loads) True where a point of the arm or of the load is below the floor."""
        floor = self.study.constraints.floor
        if floor is None:
            return np.zeros((len(frames.origin), len(self.carried)), dtype=bool)
        lowest = [points.heights(frames).min(axis=1, initial=np.inf) for points in (self.arm, *self.attached)]
        arm, *loads = (height < floor - _ROUNDING for height in lowest)
        return np.stack([arm | load for load in loads], axis=1) if loads else np.empty((len(arm), 0), dtype=bool)


def screen(study: Study) -> Screen:
    """What the poses of a study are checked with."""
    robot, payload = study.robot, study.robot.payload * study.constraints.payload_share
    hung = np.array([load.mass for load in study.loads]) + robot.tool_mass
    return Screen(
        study=study,
        arm=floor_points(study),
        attached=tuple(FloorPoints(_NO_JOINTS, _rising(robot, load.attach[None])) for load in study.loads),
        capsules=capsules(study),
        carried=np.asarray(~(hung > payload * (1 + 1e-9))),  # an unknown payload (nan) allows everything
    )


def check(study: Study, q: Floats, visit_loads: Ints) -> Feasibility:
    """Check visits.

    Args:
        study: The study, with its constraints.
        q: (N, n) joint values of each visit, rad or m.
        visit_loads: (N, L) indices of the loads of each visit.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    by_load = screen(study).codes(q)
    return Feasibility(np.take_along_axis(by_load, visit_loads, axis=1).min(axis=1, initial=FEASIBLE))


def count_reasons(codes: np.ndarray) -> dict[str, int]:
    """Number of codes by reason, any shape; reasons that never apply count 0."""
    counts = np.bincount(np.ravel(codes), minlength=FEASIBLE)
    return {reason: int(count) for reason, count in zip(REASONS, counts, strict=False)}


def joint_range(study: Study) -> tuple[Floats, Floats]:
    """(n,) lower and (n,) upper ends of poses: joint limits less the margin, and room to come from below; rad or m.

    Infinite if unknown.
    """
    lower, upper = _limits(study)
    return lower + approach_of(study), upper


def approach_of(study: Study) -> Floats:
    """(n,) how far below a pose each joint comes from, rad or m; zero if poses are approached from anywhere."""
    plan = study.plan
    if plan.approach == "any":
        return np.zeros(study.robot.n)
    return np.where(study.robot.prismatic, plan.approach_slide, plan.approach_turn)


def _limits(study: Study) -> tuple[Floats, Floats]:
    """(n,) lower and (n,) upper joint limits less the margin, rad or m; infinite if unknown."""
    robot, constraints = study.robot, study.constraints
    margin = np.where(robot.prismatic, constraints.joint_margin_slide, constraints.joint_margin)
    return robot.lower + margin, robot.upper - margin


# ---- floor


_NO_JOINTS = frozen([], np.int64)


def floor_points(study: Study, loads: Iterable[int] = ()) -> FloorPoints:
    """Points that must stay above the floor, without those whose height no joint can change.

    Args:
        study: The study.
        loads: Indices of the loads of a visit.

    Returns:
        Joint origins, flange origin, flange markers and attach points, in this order.
    """
    robot, markers = study.robot, study.markers
    moved = [_moves(spread, robot.placements[i, :3, 3]) for i, spread in enumerate(_height_spreads(robot))]
    attach = [study.loads[i].attach for i in loads]
    local = np.vstack([np.zeros((1, 3)), markers.positions[~markers.on_base], *attach])
    return FloorPoints(frozen(np.flatnonzero(moved[: robot.n]), np.int64), frozen(_rising(robot, local)))


def _rising(robot: Robot, local: Floats) -> Floats:
    """Those points (P, 3) of the flange frame whose height depends on the joints."""
    *_, spread = _height_spreads(robot)
    flange = robot.placements[robot.n]
    points = local @ flange[:3, :3].T + flange[:3, 3]
    return local[[_moves(spread, point) for point in points]]


def _moves(spread: Floats, point: Floats) -> bool:
    """True if the height of a point (3,) depends on the joints, see `_height_spreads`."""
    return bool(np.linalg.norm(spread @ np.append(point, 1.0)) > _STILL)


def _height_spreads(robot: Robot) -> Iterator[Floats]:
    """For each placement, how the heights of points depend on the joints before it.

    The height of a point x of the moved frame of joint i - 1 is ``w(q) . (x, 1)`` with a row w of four numbers. Every
    joint multiplies it by ``K + cos(q) C + sin(q) S`` (or ``I + q E`` where it slides). The joints are independent and
    1, cos, sin are too, so all ``w(q) - w(0)`` together span the products with C, S and those of the span before with
    K, C, S. The height is constant exactly if (x, 1) is orthogonal to that span: no sample of poses is needed.

    Yields:
        (at most 4, 4) rows that span it; their products with (x, 1) are about the amplitudes of the height, m.
    """
    along, across, quarter, shift = np.zeros((4, 4, 4))
    along[[2, 3], [2, 3]] = across[[0, 1], [0, 1]] = shift[2, 3] = quarter[1, 0] = 1.0
    quarter[0, 1] = -1.0
    row, spread = np.append(robot.world_R_base[2], 0.0)[None], np.zeros((0, 4))
    for placement, slides in zip(robot.placements, [*robot.prismatic, False], strict=True):
        yield spread
        row, spread = row @ placement, spread @ placement
        if slides:
            spread = np.vstack([spread, spread @ shift, row @ shift])
        else:
            spread = np.vstack([spread @ along, spread @ across, spread @ quarter, row @ across, row @ quarter])
        _, sizes, directions = np.linalg.svd(spread, full_matrices=False)
        spread = sizes[:, None] * directions
