"""Visits that stand in the data twice: a copy of a reading tells nothing new and counts once."""

from __future__ import annotations

import numpy as np

from identify.experiment import Measurements
from identify.selection import rows_of_visits, take_rows

__all__ = ["without_copies"]


def without_copies(data: Measurements) -> tuple[Measurements, int]:
    """The measurements without visits that repeat another one number by number.

    Two visits are copies if the same loads and markers were read at the same joint values at the very same positions:
    no instrument reads the same last digit everywhere twice.

    Args:
        data: The readings.

    Returns:
        The readings without the later copies, and the number of visits left out.
    """
    experiment = data.experiment
    shot = experiment.row_shot
    table = np.column_stack([
        experiment.shot_load[shot],
        experiment.row_marker,
        experiment.shot_repeat[shot],
        experiment.q[experiment.shot_pose[shot]],
        data.positions,
    ])
    order = np.lexsort((*table[:, :3].T[::-1], experiment.row_visit))
    visit = experiment.row_visit[order]
    starts = np.flatnonzero(np.diff(visit, prepend=-1))
    ends = np.append(starts[1:], len(visit))
    seen: set[bytes] = set()
    keep = np.zeros(len(experiment.visits), dtype=bool)
    for start, end in zip(starts, ends, strict=True):
        content = table[order[start:end]].tobytes()
        keep[visit[start]] = content not in seen
        seen.add(content)
    copies = len(starts) - int(keep.sum())
    return (take_rows(data, rows_of_visits(experiment, keep)) if copies else data), copies
