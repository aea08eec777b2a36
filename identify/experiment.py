"""What is measured and under which conditions: visits of poses, shots under loads, rows of markers.

A *visit* is one approach of a pose; a *shot* is one load and one repeat within a visit; a *row* is one
marker within a shot. Pose jitter is new for each visit, reading jitter for each shot, instrument
noise for each row. A row reads the position of its marker, or the turn of the flange if the marker is a 6-D target.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.loads import LoadCase, Markers
from identify.rotations import matrices_of

__all__ = ["Experiment", "Measurements", "full_experiment"]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Conditions of R rows in S shots of V visits.

    Attributes:
        visits: (V,) names of the visits.
        q: (C, n) joint values, rad or m, robot file's convention. Usually one row a visit; more where
            the rows of one visit state different values.
        loads: The load cases that shots refer to.
        markers: The markers that rows refer to.
        shot_visit: (S,) index into ``visits``.
        shot_pose: (S,) index into ``q``.
        shot_load: (S,) index into ``loads``.
        shot_repeat: (S,) number of the repeated reading.
        row_shot: (R,) index into shots; rows of one visit stand together.
        row_marker: (R,) index into ``markers``.
        row_turns: (R,) True for rows that read how a 6-D target is turned (a rotation vector, rad) instead of where it
            is; None where there are no such rows.
        wrench: (S, 6) measured wrench at the attach point of the shot's load, deflected flange frame,
            N and Nm; replaces the loads where given.
        wrench_in_world: (S,) True for wrenches that are fixed in the world instead: they do not turn with the flange.
            None: all turn with it.
        approach: (V, n) sign of the last motion of each joint, or None.
        time: (R,) s, or None.
        temperature: (R,) degC, or None.
        start: The time from which drift and warm-up count, s: by default the first reading. A part of an experiment
            keeps that of the whole.
    """

    visits: tuple[str, ...]
    q: Floats
    loads: tuple[LoadCase, ...]
    markers: Markers
    shot_visit: Ints
    shot_pose: Ints
    shot_load: Ints
    shot_repeat: Ints
    row_shot: Ints
    row_marker: Ints
    wrench: Floats | None = None
    wrench_in_world: np.ndarray | None = None
    approach: Floats | None = None
    time: Floats | None = None
    temperature: Floats | None = None
    row_turns: np.ndarray | None = None
    start: float | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("shot_visit", "shot_pose", "shot_load", "shot_repeat", "row_shot", "row_marker"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))
        for key in ("q", "wrench", "approach", "time", "temperature"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, frozen(getattr(self, key)))
        if self.row_turns is not None:
            object.__setattr__(self, "row_turns", frozen(self.row_turns, bool))
        if self.wrench_in_world is not None:
            object.__setattr__(self, "wrench_in_world", frozen(self.wrench_in_world, bool))
        if self.start is None and self.time is not None and len(self.time):
            object.__setattr__(self, "start", float(self.time.min()))

    @property
    def elapsed(self) -> Floats | None:
        """(R,) time since `start`, s; None where no time was noted."""
        return None if self.time is None or self.start is None else self.time - self.start

    @property
    def row_visit(self) -> Ints:
        """(R,) visit of each row."""
        visit: Ints = self.shot_visit[self.row_shot]
        return visit

    @property
    def turning(self) -> np.ndarray:
        """(R,) True for rows that read a turn."""
        return np.zeros(len(self.row_shot), dtype=bool) if self.row_turns is None else self.row_turns

    @property
    def row_channel(self) -> Ints:
        """(R,) what is read: the markers' positions, then their turns."""
        channel: Ints = self.row_marker + len(self.markers.names) * self.turning
        return channel

    @property
    def shot_unloaded(self) -> np.ndarray:
        """(S,) True where nothing hangs on the flange."""
        if self.wrench is not None:
            return np.asarray(~self.wrench.any(axis=1))
        return np.array([load.unloaded for load in self.loads])[self.shot_load]

    def of_rows(self, rows: Ints) -> Experiment:
        """The experiment of some rows (ascending) with their shots and poses alone; visits keep their numbers."""
        shots, row_shot = np.unique(self.row_shot[rows], return_inverse=True)
        poses, shot_pose = np.unique(self.shot_pose[shots], return_inverse=True)
        return replace(
            self.with_rows(rows),
            q=self.q[poses],
            shot_pose=shot_pose.ravel(),
            **{key: getattr(self, key)[shots] for key in ("shot_visit", "shot_load", "shot_repeat")},
            row_shot=row_shot.ravel(),
            wrench=None if self.wrench is None else self.wrench[shots],
            wrench_in_world=None if self.wrench_in_world is None else self.wrench_in_world[shots],
        )

    def with_rows(self, rows: Ints) -> Experiment:
        """The same visits and shots with other rows, each of them one of the old ones."""
        return replace(
            self,
            row_shot=self.row_shot[rows],
            row_marker=self.row_marker[rows],
            time=None if self.time is None else self.time[rows],
            temperature=None if self.temperature is None else self.temperature[rows],
            row_turns=None if self.row_turns is None else self.row_turns[rows],
        )


@dataclass(frozen=True, eq=False)
class Measurements:
    """Positions read under the conditions of an experiment.

    Attributes:
        experiment: The conditions, R rows.
        positions: (R, 3) m, in the frame of the measurements.
        quaternions: (R, 4) w, x, y, z of a 6-D target, or None.
        lines: (R,) line of each row in the file (the header is line 1).
        source: Path of the file, or a word for where the rows come from.
        ignored_columns: Columns of the file that were not used.
    """

    experiment: Experiment
    positions: Floats
    lines: Ints
    quaternions: Floats | None = None
    source: str = ""
    ignored_columns: tuple[str, ...] = ()

    def orientations(self, rows: np.ndarray) -> Floats:
        """(K, 3, 3) orientations of some rows (indices or mask), in the frame of the measurements."""
        assert self.quaternions is not None
        return matrices_of(self.quaternions[rows])

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "positions", frozen(self.positions))
        object.__setattr__(self, "lines", frozen(self.lines, np.int64))
        if self.quaternions is not None:
            object.__setattr__(self, "quaternions", frozen(self.quaternions))


def full_experiment(
    q: Floats, visit_loads: Ints, loads: tuple[LoadCase, ...], markers: Markers, visits: tuple[str, ...] | None = None
) -> Experiment:
    """The regular experiment: every visit takes ``visit_loads`` shots and every shot reads all markers.

    Args:
        q: (V, n) joint values.
        visit_loads: (V, L) index of the load of each shot, in the order of measuring.
        loads: Load cases.
        markers: Markers.
        visits: Names; P001, P002, ... by default.
    """
    count, shots = visit_loads.shape
    rows = count * shots * len(markers.names)
    width = max(3, len(str(count)))
    return Experiment(
        visits=visits or tuple(f"P{i + 1:0{width}d}" for i in range(count)),
        q=q,
        loads=loads,
        markers=markers,
        shot_visit=np.repeat(np.arange(count), shots),
        shot_pose=np.repeat(np.arange(count), shots),
        shot_load=visit_loads.ravel(),
        shot_repeat=np.ones(count * shots, dtype=np.int64),
        row_shot=np.repeat(np.arange(count * shots), len(markers.names)),
        row_marker=np.tile(np.arange(len(markers.names)), rows // max(len(markers.names), 1)),
    )
