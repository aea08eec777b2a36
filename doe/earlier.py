"""What is there before a plan is made: visits that were measured, and poses that could not be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from doe.candidates import Candidates
from identify.arrays import Floats, Ints, frozen
from identify.errors import Infeasible
from identify.experiment import Experiment
from identify.study import Study

__all__ = ["NEIGHBOURHOOD", "NOTHING", "Earlier", "in_reach", "only", "without_refused"]

#: Joint distance, in deg (mm of a sliding joint), below which a pose counts as one that could not be measured.
NEIGHBOURHOOD = 5.0

_ENOUGH = 2000  # poses whose straight moves are looked at together; half of them in reach are enough


@dataclass(frozen=True, eq=False)
class Earlier:
    """What is there already.

    Attributes:
        measured: The readings that were taken, or None.
        refused: (U, n) joint values of poses that could not be measured, rad or m.
        names: Names of poses that are taken.
        reached: ``(N, n) -> (N,)``: True for poses that the arm can come to; None: this was no trouble so far.
    """

    measured: Experiment | None = None
    refused: Floats = field(default_factory=lambda: frozen(np.zeros((0, 0))))
    names: tuple[str, ...] = ()
    reached: Callable[[Floats], np.ndarray] | None = None

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "refused", frozen(self.refused))

    def clear(self, study: Study, q: Floats) -> np.ndarray:
        """(N,) True for poses (N, n) in reach that keep the distance to every refused one in at least one joint."""
        kept = np.ones(len(q), dtype=bool) if self.reached is None else self.reached(q)
        for pose in self.refused:
            apart = np.abs(q - pose)
            turned = np.abs(np.mod(apart + np.pi, 2 * np.pi) - np.pi)  # full turns lead to the same pose
            distance = np.where(study.robot.prismatic, apart, turned) / study.joint_units
            kept &= distance.max(axis=1) >= NEIGHBOURHOOD
        return kept


NOTHING = Earlier()


def without_refused(study: Study, drawn: Candidates, earlier: Earlier) -> Candidates:
    """The candidates that are clear of poses that could not be measured; others count as ``unreachable``.

    Raises:
        Infeasible: None is left.
    """
    if not len(earlier.refused):
        return drawn
    kept = replace(earlier, reached=None).clear(study, drawn.q)[drawn.pose]
    if not kept.any():
        raise Infeasible(
            f"{study.path}: all {len(drawn)} candidates lie within {NEIGHBOURHOOD:g} deg of poses that could not be "
            "measured; ask for more [plan] candidates"
        )
    return only(drawn, kept, unreachable=int(len(drawn) - kept.sum()))


def in_reach(study: Study, drawn: Candidates, best: Ints, reached: Callable[[Floats], np.ndarray]) -> np.ndarray:
    """(N,) True for candidates that the arm can come to; looked at in an order, until there are enough.

    A straight move takes far longer to look at than a pose, so poses that no plan would use are left out unseen.

    Args:
        study: The study.
        drawn: The candidates.
        best: (N,) candidates, the most promising first.
        reached: ``(P, n) -> (P,)``: True for poses that the arm can come to.

    Raises:
        Infeasible: None is left.
    """
    poses = drawn.pose[best]
    poses = poses[np.sort(np.unique(poses, return_index=True)[1])]
    able = np.zeros(len(drawn.q), dtype=bool)
    for begin in range(0, len(poses), _ENOUGH):
        part = poses[begin : begin + _ENOUGH]
        able[part] = reached(drawn.q[part])
        if able.sum() >= _ENOUGH // 2:
            break
    if not able.any():
        raise Infeasible(
            f"{study.path}: none of {len(drawn)} candidates can be reached from the home pose; ask for more [plan] "
            "candidates, or state another home"
        )
    return np.asarray(able[drawn.pose])


def only(drawn: Candidates, kept: np.ndarray, *, unreachable: int) -> Candidates:
    """The candidates that are ``kept`` (N,), and how many of the others cannot be reached."""
    poses, place = np.unique(drawn.pose[kept], return_inverse=True)
    rejected = {**drawn.rejected, "unreachable": drawn.rejected.get("unreachable", 0) + unreachable}
    return replace(drawn, q=drawn.q[poses], pose=place.ravel(), visit_loads=drawn.visit_loads[kept], rejected=rejected)
