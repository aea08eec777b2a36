"""A visit as it would read without one particular mistake."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from identify.arrays import Floats, Ints
from identify.experiment import Experiment, Measurements
from identify.fit import OUTLYING, Fit
from identify.noise import Whitening, whitening
from identify.response import respond
from identify.selection import only_visit, take_rows
from identify.study import Noise
from identify.units import DEG

__all__ = ["OUTLIER", "Edit", "Reading", "edits", "removals"]

OUTLIER = "gross outlier"
_INCH = 25.4
_STEPS = 15  # Newton steps for one mistyped joint value
_TYPED = 1e-9  # rad: no more to gain
_LEAST_TYPED = 1e-3  # rad or m: smaller differences are errors of the robot, not of a typist


@dataclass(frozen=True, eq=False)
class Edit:
    """One mistake undone.

    Attributes:
        what: The mistake, in words.
        concerned: (m,) rows of the visit that it concerns.
        positions: (m, 3) readings without it, None: the concerned rows are left out.
        experiment: Conditions without it, None: as they stand.
    """

    what: str
    concerned: np.ndarray
    positions: Floats | None = None
    experiment: Experiment | None = None


class Reading:
    """One visit, held against a fit in which it had little part.

    Attributes:
        found: The fit.
        data: The m rows of the visit.
        rows: (m,) their numbers among all rows.
        residual: (m, 3) reading minus model, base frame, m.
        far: (m,) rows that do not fit.
    """

    def __init__(self, found: Fit, noise: Noise, visit: int) -> None:
        """Take the visit out of the data of a fit."""
        self.found, self._noise = found, noise
        self.rows = np.flatnonzero(found.data.experiment.row_visit == visit)
        self.data = only_visit(found.data, visit)
        self.predicted, self._operators = self._model(self.data)
        self.residual = self._placed(self.data.positions) - self.predicted
        self.far = found.z[self.rows] > OUTLYING * found.scale

    def misfit(self) -> float:
        """Chi-square per whitened row, as the visit stands."""
        return _size(self._operators, self.residual)

    def edited(self, edit: Edit) -> float:
        """The same with one mistake undone."""
        if edit.experiment is not None:
            data = replace(self.data, experiment=edit.experiment)
            predicted, operators = self._model(data)
            return _size(operators, self._placed(data.positions) - predicted)
        if edit.positions is not None:
            return _size(self._operators, self._placed(edit.positions) - self.predicted)
        rest = np.flatnonzero(~edit.concerned)
        if not len(rest):
            return float("inf")
        data = take_rows(self.data, rest)
        predicted, operators = self._model(data)
        return _size(operators, self._placed(data.positions) - predicted)

    def position(self, q: Floats) -> Floats:
        """(m, 3) predicted readings at other joint values (n,), base frame."""
        experiment = replace(self.data.experiment, q=np.broadcast_to(q, self.data.experiment.q.shape))
        return respond(self.found.model, experiment, self.found.state.values, derivative=False).position

    def _placed(self, positions: Floats) -> Floats:
        """Readings in the base frame."""
        placement = self.found.state.base_T_measurement
        placed: Floats = positions @ placement[:3, :3].T + placement[:3, 3]
        return placed

    def _model(self, data: Measurements) -> tuple[Floats, Whitening]:
        """Predicted readings of some rows and their whitening."""
        response = respond(self.found.model, data.experiment, self.found.state.values, derivative=False)
        station = self.found.state.base_T_measurement[:3, 3]
        cancels = self.found.whitening.cancels
        return response.position, whitening(response.scene, self._noise, station, free_offsets=cancels)


def _size(operators: Whitening, residual: Floats) -> float:
    """Chi-square per whitened row."""
    whitened = operators.apply(residual)
    return float(whitened @ whitened) / len(whitened) if len(whitened) else float("inf")


def edits(reading: Reading) -> Iterator[Edit]:
    """Mistakes that people make, undone one at a time."""
    yield from _copied(reading)
    yield from _loads(reading)
    yield from _joints(reading)
    for rows, whose in _groups(reading):
        yield from _numbers(reading, rows, whose)
    yield from _swapped(reading)


def removals(reading: Reading) -> Iterator[Edit]:
    """Groups of rows left out, the smallest first."""
    experiment, far = reading.data.experiment, reading.far
    count = len(reading.rows)
    groups = [np.arange(count) == row for row in np.flatnonzero(far)]
    groups += [far]
    groups += [experiment.row_marker == marker for marker in np.unique(experiment.row_marker)]
    groups += [experiment.row_shot == shot for shot in np.unique(experiment.row_shot)]
    for rows in sorted(groups, key=lambda rows: int(rows.sum())):
        if 0 < rows.sum() < count:
            yield Edit(OUTLIER, rows)


def _everything(reading: Reading) -> np.ndarray:
    return np.ones(len(reading.rows), dtype=bool)


def _copied(reading: Reading) -> Iterator[Edit]:
    """Readings that stand under another visit too."""
    every = reading.found.data
    same = (every.positions[:, None] == reading.data.positions[None]).all(axis=2)
    same[reading.rows] = False
    twice = same.any(axis=0)
    if twice.any():
        source = every.experiment.row_visit[np.flatnonzero(same.any(axis=1))[0]]
        # what such a visit really read is not known: a reading that fits stands for it
        yield Edit(
            f"repeated row: the readings are those of {every.experiment.visits[source]}",
            twice,
            positions=_fitting(reading, twice),
        )


def _fitting(reading: Reading, rows: np.ndarray) -> Floats:
    """Readings with some rows put where the model expects them."""
    placement = reading.found.state.base_T_measurement
    there = (reading.predicted - placement[:3, 3]) @ placement[:3, :3]
    positions: Floats = np.where(rows[:, None], there, reading.data.positions)
    return positions


def _loads(reading: Reading) -> Iterator[Edit]:
    """Labels of loads exchanged between two shots, or one label wrong."""
    experiment = reading.data.experiment
    if experiment.wrench is not None:
        return
    load, names = experiment.shot_load, [case.name for case in experiment.loads]
    for a, b in combinations(range(len(load)), 2):
        if load[a] != load[b]:
            changed = load.copy()
            changed[[a, b]] = load[[b, a]]
            rows = np.isin(experiment.row_shot, [a, b])
            what = f"wrong load label: {names[load[a]]} and {names[load[b]]} exchanged"
            yield Edit(what, rows, experiment=replace(experiment, shot_load=changed))
    for shot in range(len(load)):
        for other in range(len(names)):
            if other != load[shot]:
                changed = load.copy()
                changed[shot] = other
                what = f"wrong load label: {names[load[shot]]} instead of {names[other]}"
                yield Edit(what, experiment.row_shot == shot, experiment=replace(experiment, shot_load=changed))


def _joints(reading: Reading) -> Iterator[Edit]:
    """Joint values in other units, or one of them mistyped."""
    experiment, whole = reading.data.experiment, _everything(reading)
    turning = ~reading.found.model.robot.prismatic
    in_deg = np.where(turning, experiment.q / DEG, experiment.q)
    yield Edit("joint values in rad instead of deg", whole, experiment=replace(experiment, q=in_deg))
    for joint in range(experiment.q.shape[1]):
        for begin in (experiment.q[0, joint], -experiment.q[0, joint], 0.0):
            q = _typed(reading, joint, float(begin))
            if abs(q - experiment.q[0, joint]) < _LEAST_TYPED:
                continue
            changed = experiment.q.copy()
            changed[:, joint] = q
            shown = f"{q / DEG:.3f} deg" if turning[joint] else f"{1e3 * q:.3f} mm"
            what = f"typing error: joint {joint + 1} was at {shown}"
            yield Edit(what, whole, experiment=replace(experiment, q=changed))


def _typed(reading: Reading, joint: int, value: float) -> float:
    """The value of one joint that fits the readings best, by Gauss-Newton from a start."""
    q = reading.data.experiment.q[0].copy()
    target = reading.predicted + reading.residual
    for _ in range(_STEPS):
        q[joint] = value
        here = reading.position(q)
        q[joint] = value + 1e-6
        slope = (reading.position(q) - here).ravel() / 1e-6
        power = float(slope @ slope)
        if power == 0.0:
            return value
        step = float(slope @ (target - here).ravel()) / power
        value += float(np.clip(step, -0.5, 0.5))
        if abs(step) < _TYPED:
            break
    return float((value + np.pi) % (2 * np.pi) - np.pi) if not reading.found.model.robot.prismatic[joint] else value


def _groups(reading: Reading) -> Iterator[tuple[np.ndarray, str]]:
    """Groups of rows that one slip of the pen concerns."""
    experiment, whole = reading.data.experiment, _everything(reading)
    groups = [(whole, "the whole visit"), (reading.far, "the rows that do not fit")]
    groups += [
        (experiment.row_marker == m, f"marker {experiment.markers.names[m]}") for m in np.unique(experiment.row_marker)
    ]
    groups += [
        (experiment.row_shot == s, f"load {experiment.loads[experiment.shot_load[s]].name}")
        for s in np.unique(experiment.row_shot)
    ]
    seen: list[bytes] = []
    for rows, whose in groups:
        if rows.any() and rows.tobytes() not in seen:
            seen.append(rows.tobytes())
            yield rows, whose


def _numbers(reading: Reading, rows: np.ndarray, whose: str) -> Iterator[Edit]:
    """Signs, units and order of coordinates."""
    given = reading.data.positions

    def edit(what: str, changed: Floats) -> Edit:
        return Edit(f"{what} ({whose})", rows, positions=np.where(rows[:, None], changed, given))

    for axis in range(3):
        sign = np.ones(3)
        sign[axis] = -1.0
        yield edit(f"wrong sign of {'xyz'[axis]}", given * sign)
    for what, factor in (("inch instead of mm", _INCH), ("mm read as inch", 1 / _INCH), ("m instead of mm", 1e3)):
        yield edit(what, given * factor)
    for a, b in combinations(range(3), 2):
        order = [0, 1, 2]
        order[a], order[b] = b, a
        yield edit(f"{'xyz'[a]} and {'xyz'[b]} exchanged", given[:, order])


def _swapped(reading: Reading) -> Iterator[Edit]:
    """Two markers exchanged, in the whole visit or in one shot."""
    experiment, given = reading.data.experiment, reading.data.positions
    names = experiment.markers.names
    shots = np.unique(experiment.row_shot)
    scopes: list[Ints] = [shots, *(shots[number : number + 1] for number in range(len(shots)) if len(shots) > 1)]
    for scope in scopes:
        inside = np.isin(experiment.row_shot, scope)
        for a, b in combinations(np.unique(experiment.row_marker[inside]), 2):
            changed, rows = given.copy(), np.zeros(len(given), dtype=bool)
            for shot in scope:
                pair = [np.flatnonzero((experiment.row_shot == shot) & (experiment.row_marker == m)) for m in (a, b)]
                if all(len(index) == 1 for index in pair):
                    first, second = int(pair[0][0]), int(pair[1][0])
                    changed[[first, second]] = given[[second, first]]
                    rows[[first, second]] = True
            if rows.any():
                yield Edit(f"swapped markers: {names[a]} and {names[b]} exchanged", rows, positions=changed)
