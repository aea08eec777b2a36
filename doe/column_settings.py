"""Settings of loads that columns off the grid ask for: a few far apart, and which of them each column takes."""

from __future__ import annotations

import numpy as np

from doe.continuous import Columns
from doe.load_settings import as_hung, values_of, with_setting
from doe.open_loads import LoadSpace
from identify.arrays import Floats, Ints
from identify.study import Study

__all__ = ["nearest_settings", "with_column_settings"]

_GOOD = 0.97  # of the largest sensitivity: columns whose loads count
_APART = 0.15  # of the ranges: loads that are closer are one setting


def with_column_settings(study: Study, space: LoadSpace, columns: Columns) -> tuple[Study, Ints]:
    """The study with settings that the best columns hang, at most ``settings_per_load`` of each load.

    Args:
        study: The study with settings.
        space: The loads of visits.
        columns: The columns.

    Returns:
        The study, and the indices (s,) of these settings in it.
    """
    d = columns.sensitivities(columns.found.blocks)
    good = np.flatnonzero(d >= _GOOD * d.max())
    good = good[np.argsort(-d[good], kind="stable")]
    choice = columns.found.choice[good]
    values = space.values(columns.found.x[good, study.robot.n :], choice)
    base, found = space.bases(study), []
    for kind in np.flatnonzero((space.upper > space.lower).any(axis=1)).tolist():
        own = values[space.choices[choice] == kind]
        first = int(np.argmax(base == kind))
        span = study.load_ranges[study.loads[first].name]
        for wanted in as_hung(study, span, _spread(own / _room(space)[kind], own, study.plan.settings_per_load)):
            study, index = with_setting(study, first, wanted)
            found.append(index)
    return study, np.unique(np.array(found, dtype=np.int64))


def nearest_settings(study: Study, space: LoadSpace, columns: Columns, usable: Ints) -> Ints:
    """(m, S) loads of a study that come nearest to those of the columns, ``usable`` ones where there are any."""
    found = columns.found
    base, values = space.bases(study), np.array([values_of(load) for load in study.loads])
    wanted = space.values(found.x[:, study.robot.n :], found.choice)
    loads = np.empty(wanted.shape[:2], dtype=np.int64)
    for kind, room in enumerate(_room(space)):
        own = np.flatnonzero(base == kind)
        own = np.intersect1d(own, usable) if len(np.intersect1d(own, usable)) else own
        here = space.choices[found.choice] == kind
        far = np.linalg.norm((wanted[here][:, None] - values[own]) / room, axis=2)
        loads[here] = own[np.argmin(far, axis=1)]
    return loads


def _room(space: LoadSpace) -> Floats:
    """(B, 4) lengths of the ranges; 1 where there is no choice."""
    return np.asarray(np.where(space.upper > space.lower, space.upper - space.lower, 1.0))


def _spread(scaled: Floats, values: Floats, count: int) -> Floats:
    """(s, 4) at most ``count`` of the values (m, 4): the first, then the one furthest from those taken, while far."""
    taken: list[int] = []
    far = np.full(len(values), np.inf)
    while len(taken) < min(count, len(values)) and far.max() > _APART:
        taken.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(scaled - scaled[taken[-1]], axis=1))
    return np.asarray(values[taken].reshape(-1, 4))
