"""Parts of an experiment: rows of some visits, and changes of readings between loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats, Ints
from identify.experiment import Experiment, Measurements

__all__ = ["distinct_rows", "load_changes", "only_visit", "rows_of_visits", "take_rows"]


def rows_of_visits(experiment: Experiment, visits: np.ndarray) -> Ints:
    """Rows that belong to the marked visits, (V,) bool -> indices."""
    return np.flatnonzero(visits[experiment.row_visit])


def take_rows(data: Measurements, rows: Ints) -> Measurements:
    """The measurements of some rows (ascending); visits, shots and loads keep their numbers."""
    return _numbers_of(data, rows, data.experiment.with_rows(rows))


def _numbers_of(data: Measurements, rows: Ints, experiment: Experiment) -> Measurements:
    """The numbers that were read in some rows, under the conditions of an experiment."""
    quaternions = None if data.quaternions is None else data.quaternions[rows]
    return replace(
        data, experiment=experiment, positions=data.positions[rows], lines=data.lines[rows], quaternions=quaternions
    )


def distinct_rows(data: Measurements) -> Ints:
    """Rows (ascending) without copies: the same numbers for the same marker, load and joint values as an earlier row.

    Copies hold no noise of their own. Counted as readings they make every score larger and leave chi2 per degree of
    freedom as it is, so that nothing would tell.
    """
    experiment = data.experiment
    shot = experiment.row_shot
    keys = [experiment.q[experiment.shot_pose[shot]], experiment.shot_load[shot, None], experiment.row_marker[:, None]]
    first = np.unique(np.hstack([*keys, data.positions]), axis=0, return_index=True)[1]
    rows: Ints = np.sort(first)
    return rows


def load_changes(experiment: Experiment, rows: Floats) -> tuple[Floats, Ints]:
    """What loading changed: (R, 3) values relative to the unloaded rows of the same visit and marker.

    Where a visit has no unloaded row of the marker, its loaded rows are taken relative to their own mean.

    Returns:
        (K, 3) changes and their (K,) rows: loaded ones that have something to be compared with.
    """
    key = experiment.row_visit * 2 * len(experiment.markers.names) + experiment.row_channel
    _, group = np.unique(key, return_inverse=True)
    unloaded = experiment.shot_unloaded[experiment.row_shot]
    count = group.max(initial=-1) + 1
    references = np.bincount(group, unloaded, count)
    members = np.bincount(group, minlength=count)
    use = np.where(references[group] > 0, unloaded, True)
    total = np.stack([np.bincount(group, rows[:, axis] * use, count) for axis in range(3)], axis=1)
    mean = total / np.bincount(group, use, count)[:, None]
    loaded = np.flatnonzero(~unloaded & ((references[group] > 0) | (members[group] > 1)))
    return (rows - mean[group])[loaded], loaded


def only_visit(data: Measurements, visit: int) -> Measurements:
    """The rows of one visit alone: its shots and poses are counted anew."""
    experiment = data.experiment
    rows = np.flatnonzero(experiment.row_visit == visit)
    shots, row_shot = np.unique(experiment.row_shot[rows], return_inverse=True)
    poses, shot_pose = np.unique(experiment.shot_pose[shots], return_inverse=True)
    part = replace(
        experiment.with_rows(rows),
        visits=(experiment.visits[visit],),
        q=experiment.q[poses],
        shot_visit=np.zeros(len(shots), dtype=np.int64),
        shot_pose=shot_pose,
        shot_load=experiment.shot_load[shots],
        shot_repeat=experiment.shot_repeat[shots],
        row_shot=row_shot,
        wrench=None if experiment.wrench is None else experiment.wrench[shots],
        wrench_in_world=None if experiment.wrench_in_world is None else experiment.wrench_in_world[shots],
        approach=None if experiment.approach is None else experiment.approach[[visit]],
    )
    return _numbers_of(data, rows, part)
