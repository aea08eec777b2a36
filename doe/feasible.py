"""Which visits may be measured: limits of the joints, the cell, the load and the line of sight, many poses at once.

A visit is one pose and the loads that are read there. Its reason is the first of `REASONS` that applies.

* *joint_limits*: within the limits less the margin.
* *floor*: joint origins, flange, flange markers and the lowest points of the visit's loads stand at or above the
  floor. Points whose height no joint can change (the base column) are left out, see `doe.floor`.
* *walls*, *boxes*: links that move, flange markers, ropes and hung bodies keep the clearance, see `doe.gaps`.
* *self_collision*: capsules around the links keep apart, see `doe.capsules`.
* *load_collision*: ropes and hung bodies keep the clearance to the links, see `doe.weights`.
* *arm_collision*: both keep the clearance to another arm that is parked beside, see `doe.parked`.
* *payload*: hung mass and tool within the stated share of the rated payload and within the payload diagram.
* *torque*: static moments about the last three joints and static joint torques within their limits, `doe.statics`.
* *tracker_range*, *reflector_angle*, *line_of_sight*: enough markers are in range, turned to the tracker, and seen;
  each counts the markers that the one before it has left, see `doe.visibility`.

Under ``[plan] approach = "same"`` the place from which a pose is approached (every joint lower) must keep to all of
this too, but for what the tracker sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from doe.distances import segment_distance
from doe.gaps import Gaps, gaps_of
from doe.hung_frames import Hung, placed
from doe.statics import Statics, statics
from doe.visibility import sight
from identify.arrays import Floats, Ints, frozen
from identify.errors import InputError
from identify.kinematics import Frames, forward
from identify.study import Study

__all__ = [
    "FEASIBLE",
    "REASONS",
    "Feasibility",
    "Screen",
    "approach_of",
    "check",
    "count_reasons",
    "joint_range",
    "screen",
]

#: Why a visit may not be measured, in the order in which the reasons are looked at.
REASONS = (
    "joint_limits", "floor", "walls", "boxes", "self_collision", "load_collision", "arm_collision", "payload", "torque",
    "tracker_range", "reflector_angle", "line_of_sight",
)  # fmt: skip
FEASIBLE = len(REASONS)  # the code of a visit without a reason

_OF_READING = {"tracker_range", "reflector_angle", "line_of_sight"}  # nothing is read on the way

_CHUNK = 4096  # poses at a time
_ROUNDING = 1e-9  # rad or m: limits and gaps hold up to this

Test = Callable[[Floats, Frames], np.ndarray]


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
class Screen:
    """Everything about a study that its poses are checked with.

    Attributes:
        study: The study.
        gaps: The geometry of its cell.
        limits: Its static limits.
        tests: Reason -> ``(q (N, n), frames) -> (N, L) or (N, 1)``, True where it applies; in the order of `REASONS`.
    """

    study: Study
    gaps: Gaps
    limits: Statics
    tests: Mapping[str, Test]

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process builds its own from the study."""
        return screen, (self.study,)

    @property
    def overshoots(self) -> Mapping[str, Callable[[Frames], Floats]]:
        """Reason -> by how much N poses break it, (N, L) or (N, 1): m, or the share of what may be carried.

        Not above 0 where they do not. Reasons that are not there have no measure.
        """
        inside = {reason: _inside(gap) for reason, gap in self.gaps.by_reason.items()}
        return inside | {"payload": self.limits.overload, "torque": self.limits.excess}

    def codes(self, q: Floats, hung: Hung | None = None) -> np.ndarray:
        """First reason against each load at each pose.

        The reason against a visit is the smallest code of its loads.

        Args:
            q: (N, n) joint values, rad or m.
            hung: Values of the loads at each pose in place of the study's. Which pairs touch in every pose is still
                that of the study's.

        Returns:
            (N, loads) index into `REASONS`, or `FEASIBLE`.
        """
        chunks = [slice(start, start + _CHUNK) for start in range(0, len(q), _CHUNK)]
        parts = [self._approached(q[part], None if hung is None else hung.taken(part)) for part in chunks]
        return np.concatenate(parts) if parts else np.empty((0, len(self.study.loads)), dtype=np.int8)

    def check(self, q: Floats, visit_loads: Ints) -> Feasibility:
        """Check visits: (N, n) joint values, rad or m, and (N, L) indices of the loads of each visit."""
        return Feasibility(np.take_along_axis(self.codes(q), visit_loads, axis=1).min(axis=1, initial=FEASIBLE))

    def _approached(self, q: Floats, hung: Hung | None) -> np.ndarray:
        """`codes` of a few poses, and of where they are approached from."""
        codes, below = self._chunk(q, hung, self.tests), approach_of(self.study)
        return np.minimum(codes, self._chunk(q - below, hung, self._of_moving)) if below.any() else codes

    @property
    def _of_moving(self) -> Mapping[str, Test]:
        """The tests of places where nothing is read."""
        return {reason: test for reason, test in self.tests.items() if reason not in _OF_READING}

    def _chunk(self, q: Floats, hung: Hung | None, tests: Mapping[str, Test]) -> np.ndarray:
        """`codes` of a few poses by themselves; what a pose has failed for every load is not looked at further."""
        frames = placed(self.study.robot, q, hung)
        codes = np.full((len(q), len(self.study.loads)), FEASIBLE, dtype=np.int8)
        left = np.arange(len(q))
        for reason, test in tests.items():
            still = (codes[left] == FEASIBLE).any(axis=1)
            if not still.all():
                left = left[still]
                q, frames = q[still], frames.taken(np.flatnonzero(still))
            if not len(left):
                break
            part = codes[left]
            part[test(q, frames) & (part == FEASIBLE)] = REASONS.index(reason)
            codes[left] = part
        return codes

    def failures(self, q: Floats) -> dict[str, np.ndarray]:
        """Every reason on its own: reason -> (N, loads), True where it applies; for few poses ``q`` (N, n)."""
        frames, shape = forward(self.study.robot, q), (len(q), len(self.study.loads))
        found = {reason: np.broadcast_to(test(q, frames), shape) for reason, test in self.tests.items()}
        below = approach_of(self.study)
        if below.any():
            frames = forward(self.study.robot, q - below)
            found |= {reason: found[reason] | test(q - below, frames) for reason, test in self._of_moving.items()}
        return found


def screen(study: Study) -> Screen:
    """What the poses of a study are checked with.

    Raises:
        InputError: The tracker stands inside the arm, or home breaks a constraint.
    """
    gaps, limits = gaps_of(study), statics(study)
    view = sight(study, gaps)
    lower, upper = _limits(study)
    tests: dict[str, Test] = {
        "joint_limits": lambda q, _: np.any((q < lower - _ROUNDING) | (q > upper + _ROUNDING), axis=1, keepdims=True)
    }
    tests |= {reason: _broken(gap) for reason, gap in gaps.by_reason.items()}
    tests["payload"] = lambda _, frames: limits.overload(frames) > 0.0
    tests["torque"] = lambda _, frames: limits.exceeded(frames)
    if view is not None:
        tests |= {reason: _of_frames(test) for reason, test in view.by_reason.items()}
    _check_home(study, gaps)
    _check_tracker(study, gaps)
    return Screen(study, gaps, limits, {reason: tests[reason] for reason in REASONS if reason in tests})


def _broken(gap: Callable[[Frames], Floats]) -> Test:
    """The test of a gap."""
    return lambda _, frames: np.asarray(gap(frames) < -_ROUNDING)


def _inside(gap: Callable[[Frames], Floats]) -> Callable[[Frames], Floats]:
    """By how much a gap is broken."""
    return lambda frames: -gap(frames)


def _of_frames(test: Callable[[Frames], np.ndarray]) -> Test:
    """The test of frames alone."""
    return lambda _, frames: test(frames)


def _check_home(study: Study, gaps: Gaps) -> None:
    """The arm without loads can stand at home.

    Raises:
        InputError: It cannot.
    """
    if study.constraints.home is None:
        return
    frames = forward(study.robot, study.constraints.home)
    bare = [i for i, load in enumerate(study.loads) if load.unloaded and load.depth == 0.0]
    for reason, gap in gaps.by_reason.items():
        value = gap(frames)[0]
        least = value.max() if len(value) == 1 or not bare else value[bare].max()
        if least < -_ROUNDING:
            raise InputError(
                f"{study.path}: [constraints] home_deg: the arm cannot stand there, {reason} is broken by "
                f"{-1000 * least:.0f} mm; state another home or correct the cell"
            )


def _check_tracker(study: Study, gaps: Gaps) -> None:
    """No tracker stands inside the base of the arm, or inside the arm at home.

    Raises:
        InputError: One does.
    """
    if study.constraints.visibility is None:
        return
    home, arm = study.constraints.home, gaps.capsules
    start, end = arm.segments(forward(study.robot, np.zeros(study.robot.n) if home is None else home))
    counted = np.ones(len(arm.names), dtype=bool) if home is not None else ~arm.moving
    places = {f"[[tracker_stations]] {place.name}": place.position for place in study.stations}
    if not places and study.station is not None:
        places = {"[noise.tracker] station_mm": study.station}
    for key, position in places.items():
        inside = counted & (segment_distance(position, position, start[0], end[0]) < arm.radii)
        if inside.any():
            name = arm.names[int(np.argmax(inside))]
            raise InputError(f"{study.path}: {key}: the tracker stands inside the robot ({name}); move it away")


def check(study: Study, q: Floats, visit_loads: Ints) -> Feasibility:
    """Check visits.

    Args:
        study: The study, with its constraints.
        q: (N, n) joint values of each visit, rad or m.
        visit_loads: (N, L) indices of the loads of each visit.

    Raises:
        InputError: ``q`` has the wrong number of columns.
    """
    return screen(study).check(q, visit_loads)


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
