"""Rows that are wrong as data: swapped, mislabelled, mistyped, in other units, or simply far off.

A visit that does not fit is read again as it would be without one particular mistake (`identify.diagnosis.edits`). The
mistake that makes it fit as well as the other visits is named. What no such edit mends is left in, unless it is far
beyond anything that the robot could do; then its rows are an outlier.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Ints
from identify.diagnosis.edits import OUTLIER, Edit, Reading, edits, removals
from identify.experiment import Experiment, Measurements
from identify.fit import OUTLYING, Fit
from identify.selection import take_rows
from identify.study import Noise

__all__ = ["Fault", "faults", "without_rows"]

_SHARE = 0.25  # of the visits: where more than this do not fit, the model is wrong and not the rows
_MENDED = 3.0  # an edited visit fits if its chi-square is within this many times that of usual visits
_GAIN = 8.0  # and if the edit makes it this many times smaller
_FEW = 0.1  # of the visits: where more than this are outliers, the model is wrong
_COMPARED = 200  # visits that tell what is usual


@dataclass(frozen=True, eq=False)
class Fault:
    """A wrong row, or several of one visit.

    Attributes:
        visit: Number of the visit.
        marker: Number of the marker, None where more than one is concerned.
        what: What is wrong with it, in words.
        rows: Rows that are left out.
        size: Largest distance from where the rows should be, m.
    """

    visit: int
    marker: int | None
    what: str
    rows: Ints
    size: float

    def where(self, experiment: Experiment) -> str:
        """``P006``, or ``P006/M1``."""
        name = experiment.visits[self.visit]
        return name if self.marker is None else f"{name}/{experiment.markers.names[self.marker]}"


def without_rows(data: Measurements, wrong: tuple[Fault, ...]) -> Measurements:
    """The measurements without faulty rows."""
    keep = np.ones(len(data.positions), dtype=bool)
    for fault in wrong:
        keep[fault.rows] = False
    return data if keep.all() else take_rows(data, np.flatnonzero(keep))


def faults(found: Fit, noise: Noise, *, limit: float, least: float = OUTLYING) -> tuple[Fault, ...]:
    """Faults among the rows of a robust fit.

    Args:
        found: A fit in which rows that do not fit have little influence.
        noise: Its noise.
        limit: Robust sigmas from which on a row that no edit mends is an outlier.
        least: Robust sigmas from which on a row is looked at.
    """
    experiment = found.data.experiment
    far = found.z > least * found.scale
    visits = np.unique(experiment.row_visit[far])
    present = np.unique(experiment.row_visit)
    if not len(visits) or len(visits) > max(_SHARE * len(present), 1):
        return ()
    others = np.setdiff1d(present, visits)[:_COMPARED]
    usual = np.quantile([Reading(found, noise, int(visit)).misfit() for visit in others], 0.9)
    judged = (_fault(found, noise, int(visit), max(float(usual), 1.0), limit) for visit in visits)
    made = [fault for fault in judged if fault is not None]
    outliers = [fault for fault in made if fault.what.startswith(OUTLIER)]
    if len(outliers) > max(_FEW * len(present), 1):
        made = [fault for fault in made if fault not in outliers]
    return tuple(made)


def _fault(found: Fit, noise: Noise, visit: int, usual: float, limit: float) -> Fault | None:
    """What is wrong with one visit, None if it is not the data."""
    reading = Reading(found, noise, visit)
    before = reading.misfit()
    if before <= _MENDED * usual:
        return None
    tried = [(reading.edited(edit), number, edit) for number, edit in enumerate(edits(reading))]
    after, _, best = min(tried, key=lambda item: item[:2])
    if after > _MENDED * usual or after * _GAIN > before:
        if float(found.z[reading.rows].max(initial=0.0)) <= limit * found.scale:
            return None
        best = _outlier(reading, _MENDED * usual)
    return _as_fault(reading, visit, best)


def _outlier(reading: Reading, limit: float) -> Edit:
    """The smallest group of rows without which the visit fits; the whole visit where no smaller one will do."""
    for edit in removals(reading):
        if reading.edited(edit) <= limit:
            return edit
    return Edit(f"{OUTLIER}: all readings", np.ones(len(reading.rows), dtype=bool))


def _as_fault(reading: Reading, visit: int, edit: Edit) -> Fault:
    """The fault that an edit mends."""
    concerned = reading.rows[edit.concerned]
    size = float(np.linalg.norm(reading.residual[edit.concerned], axis=1).max())
    markers = np.unique(reading.data.experiment.row_marker[edit.concerned])
    marker = int(markers[0]) if len(markers) == 1 and len(reading.data.experiment.markers.names) > 1 else None
    return Fault(visit, marker, edit.what, concerned, size)
