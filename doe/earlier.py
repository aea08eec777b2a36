"""What is there before a plan is made: visits that were measured, and poses that could not be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from doe.candidates import Candidates
from identify.arrays import Floats, frozen
from identify.errors import Infeasible
from identify.experiment import Experiment
from identify.study import Study

__all__ = ["NEIGHBOURHOOD", "NOTHING", "Earlier", "without_refused"]

#: Joint distance, in deg (mm of a sliding joint), below which a pose counts as one that could not be measured.
NEIGHBOURHOOD = 5.0


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

    @property
    def selective(self) -> bool:
        """True if there are poses that are not clear."""
        return bool(len(self.refused)) or self.reached is not None

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
    """The candidates that are in reach and clear of poses that could not be measured; others count as ``unreachable``.

    Raises:
        Infeasible: None is left.
    """
    if not earlier.selective:
        return drawn
    clear = earlier.clear(study, drawn.q)
    kept = clear[drawn.pose]
    if not kept.any():
        raise Infeasible(
            f"{study.path}: all {len(drawn)} candidates lie within {NEIGHBOURHOOD:g} deg of poses that could not be "
            "measured, or cannot be reached from the home pose; ask for more [plan] candidates, or state another home"
        )
    place = np.cumsum(clear) - 1
    rejected = {**drawn.rejected, "unreachable": int(len(drawn) - kept.sum())}
    return Candidates(
        drawn.q[clear], place[drawn.pose[kept]], drawn.visit_loads[kept], drawn.drawn, rejected, drawn.unchecked
    )
