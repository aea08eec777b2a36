"""The residuals of a diagnosis as a table: what its pictures are drawn from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identify.arrays import Floats
from identify.csv_file import csv_text
from identify.diagnosis.screen import recorded
from identify.diagnosis.verdict import Diagnosis
from identify.fit import Fit
from identify.identification import misfit_of
from identify.response import Response, respond
from identify.units import MM

__all__ = ["residuals_csv"]


def residuals_csv(found: Diagnosis) -> str:
    """Text of ``residuals.csv``: one row a reading (a change under load, for ``differences``), faulty ones included.

    Columns: ids and line of the reading; position of the marker in the base frame as the model puts it, mm; residual
    (reading minus model) before and after the extension, base frame, mm; 1 for a faulty row; joint values, torques,
    approach, time, temperature and distance to the instrument as they are known.
    """
    first, last = found.search.first, found.search.last
    response = _response(first, found)
    every = np.arange(len(found.data.positions))
    reference = found.identification.reference
    before = misfit_of(found.data, _residual(first, found, response), reference, every)
    after = misfit_of(found.data, _residual(last, found, _response(last, found)), reference, every)
    experiment, rows = found.data.experiment, before.rows
    shot = experiment.row_shot[rows]
    columns: list[tuple[str, Sequence[object] | np.ndarray]] = [
        ("pose", [experiment.visits[index] for index in experiment.row_visit[rows]]),
        ("load", [experiment.loads[index].name for index in experiment.shot_load[shot]]),
        ("marker", [experiment.markers.names[index] for index in experiment.row_marker[rows]]),
        ("repeat", experiment.shot_repeat[shot]),
        ("line", found.data.lines[rows]),
        *_axes("{}_mm", response.position[rows]),
        *_axes("before_{}_mm", before.error),
        *_axes("after_{}_mm", after.error),
        ("faulty", _faulty(found)[rows].astype(np.int64)),
    ]
    station = first.state.base_T_measurement[:3, 3]
    columns += [(name, values[rows]) for name, values in recorded(experiment, response.scene, station)]
    return csv_text([name for name, _ in columns], [values for _, values in columns])


def _response(fit: Fit, found: Diagnosis) -> Response:
    """What a fit says about all readings, also those that it did not use."""
    return respond(fit.model, found.data.experiment, fit.state.values, derivative=False)


def _residual(fit: Fit, found: Diagnosis, response: Response) -> Floats:
    """(R, 3) reading minus model, base frame, m."""
    placement = fit.state.base_T_measurement
    residual: Floats = found.data.positions @ placement[:3, :3].T + placement[:3, 3] - response.position
    return residual


def _axes(name: str, values: Floats) -> list[tuple[str, np.ndarray]]:
    """Three columns in mm."""
    return [(name.format(axis), values[:, number] / MM) for number, axis in enumerate("xyz")]


def _faulty(found: Diagnosis) -> np.ndarray:
    """(R,) True for rows that are accused."""
    marked = np.zeros(len(found.data.positions), dtype=bool)
    for fault in found.faults:
        marked[fault.rows] = True
    return marked
