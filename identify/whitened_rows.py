"""The rows of a fit, a part of the visits at a time: residuals, whitening, and the triangle of the whitened columns.

All that a least-squares step needs of K whitened columns X and their residual r is the R factor of ``[X r]``. It is
accumulated over parts of some thousand rows, so that the columns of all rows are never held at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from identify.arrays import Floats, Ints
from identify.dual_rows import deviation_residual, dual_respond
from identify.effects import Scene
from identify.experiment import Measurements
from identify.identifiability import triangle
from identify.model import Model
from identify.noise import Whitening, joined, reading_covariance, whitening
from identify.response import Response, respond, undeflected
from identify.rotations import rotation_vectors
from identify.row_distances import row_distances
from identify.selection import take_rows
from identify.study import Noise, RowAlgebra
from identify.threads import one_thread

__all__ = ["Part", "Problem", "Rows", "State", "parts_of", "predicted", "rows_at", "station", "stepped"]

_ROWS = 4096  # of a part: its columns stay in cache; twice as many where two threads would wait for each other
_SERIAL = 4  # parts below which threads do not pay
_WIDE, _WIDE_ROWS = 200, 3000  # parameters from which on a triangle costs so much that threads always pay; rows then
_THREADS = 2

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True, eq=False)
class State:
    """Where a fit stands.

    Attributes:
        values: (p,) parameters in their units; frame parameters are zero, they live in the placement.
        base_T_measurement: (4, 4) placement of the measurement frame, m.
        weights: (R,) weights of the rows, 1 for good ones.
    """

    values: Floats
    base_T_measurement: Floats
    weights: Floats


@dataclass(frozen=True, eq=False)
class Part:
    """Some whole visits.

    Attributes:
        rows: Which rows of the data they are.
        data: These rows, with their own shots and poses.
        scene: The arm under its loads, where no parameter changes it.
    """

    rows: slice
    data: Measurements
    scene: Scene | None


@dataclass(frozen=True, eq=False)
class Problem:
    """What does not change during a fit.

    Attributes:
        model: The model.
        data: The rows.
        noise: Their stated noise.
        free_offsets: Only changes within a visit inform.
        free: (p,) True for parameters that may move.
        parts: The rows in parts.
        bending: Columns count how geometry and markers bend the deflection, a matter of second order.
    """

    model: Model
    data: Measurements
    noise: Noise
    free_offsets: bool
    free: np.ndarray
    parts: tuple[Part, ...]
    bending: bool = True

    @cached_property
    def chosen(self) -> slice | Ints:
        """The parameters that may move; a slice where they stand together, which takes no copy of their columns."""
        found = np.flatnonzero(self.free)
        together = len(found) > 0 and found[-1] - found[0] == len(found) - 1
        return slice(int(found[0]), int(found[-1]) + 1) if together else found

    @property
    def serial(self) -> int:
        """Number of parts below which they are looked at one after another."""
        return _THREADS if len(self.free) > _WIDE else _SERIAL

    @cached_property
    def linear(self) -> bool:
        """True if neither columns nor what is beyond them depend on the values of what may move."""
        model = self.model
        moving = [e for e, where in zip(model.effects, model.effect_slices, strict=True) if self.free[where].any()]
        plain = not model.loaded and self.data.experiment.row_turns is None  # turns add up to first order only
        return plain and not (self.free & model.nuisance).any() and all(e.linear for e in moving)


def parts_of(model: Model, data: Measurements) -> tuple[Part, ...]:
    """The rows of a model's fits in parts of whole visits."""
    visit = data.experiment.row_visit
    count = len(visit)
    starts = np.flatnonzero(np.diff(visit, prepend=-1))
    if len(model.parameters) > _WIDE:
        size = max(-(-count // (_THREADS * max(1, round(count / (_THREADS * _WIDE_ROWS))))), 1)
    else:
        size = 2 * _ROWS if count >= 2 * _SERIAL * _ROWS else _ROWS
    cuts = np.unique(starts[np.searchsorted(starts, np.arange(0, count, size), side="right") - 1])
    slices = [slice(int(a), int(b)) for a, b in pairwise([*cuts, count])]
    return tuple(_each(slices, lambda rows: _part(model, data, rows)))


def _part(model: Model, data: Measurements, rows: slice) -> Part:
    """Some rows without the shots and poses of the others."""
    inside = data if rows.stop - rows.start == len(data.positions) else _rows_alone(data, rows)
    return Part(rows, inside, undeflected(model, inside.experiment))


def _rows_alone(data: Measurements, rows: slice) -> Measurements:
    """Some rows without the shots and poses of the others."""
    part = take_rows(data, np.arange(rows.start, rows.stop))
    return replace(part, experiment=part.experiment.of_rows(np.arange(rows.stop - rows.start)))


def predicted(model: Model, parts: Sequence[Part], values: Floats) -> Floats:
    """(R, 3) where a model says that all rows are read, base frame, m.

    Args:
        model: The model.
        parts: The rows (`parts_of` of this model).
        values: (p,) parameters in their units.
    """

    def position(part: Part) -> Floats:
        if model.rows != "vectors":
            return dual_respond(model, part.data.experiment, values, derivative=False).position
        return respond(model, part.data.experiment, values, derivative=False, known=part.scene).position

    return np.concatenate(_each(parts, position))


@dataclass(frozen=True, eq=False)
class Rows:
    """All rows at a state.

    Attributes:
        problem: The problem.
        state: The state.
        residual: (R, 3) reading minus model, base frame, m (rad where a turn is read).
        point: (R, 3) undeflected markers, base frame, m.
        operators: The whitening of each part.
        whitened: (K,) whitened residual.
        upper: (m, p + 1) R factor of the whitened columns and residual; columns of what may not move are zero.
        direct: (m, p) the same of the columns that decide on rank (`identify.response.Response.direct`).
    """

    problem: Problem
    state: State
    residual: Floats
    point: Floats
    operators: tuple[Whitening, ...]
    whitened: Floats
    upper: Floats
    direct: Floats

    @cached_property
    def whitening(self) -> Whitening:
        """Operators of all rows."""
        return joined(self.operators, [part.rows.start for part in self.problem.parts])

    @cached_property
    def distances(self) -> Floats:
        """(R,) see `identify.row_distances.row_distances`."""
        noise, at = self.problem.noise, station(self.problem.noise, self.state.base_T_measurement)

        def distances(index: int) -> Floats:
            part = self.problem.parts[index]
            own = reading_covariance(noise, part.data.experiment, self.point[part.rows], at)
            whitened, weights = self.whitened[self.slices[index]], self.state.weights[part.rows]
            return row_distances(self.operators[index], whitened, own, weights)

        return np.concatenate(_each(range(len(self.operators)), distances))

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Where the whitened rows of each part stand."""
        ends = np.cumsum([0, *(operators.size for operators in self.operators)]).tolist()
        return tuple(slice(a, b) for a, b in pairwise(ends))

    def each(self, work: Callable[[Whitening, Floats, slice], U]) -> list[U]:
        """Do something with every part: its whitening, its whitened columns (K_i, p) and where they stand in all K."""

        def on(index: int) -> U:
            operators, problem = self.operators[index], self.problem
            response = _response(problem, problem.parts[index], self.state)
            columns = np.zeros((operators.size, len(problem.free)))
            columns[:, problem.chosen] = operators.apply(response.derivative[:, :, problem.chosen])
            return work(operators, columns, self.slices[index])

        return _each(range(len(self.operators)), on)


def station(noise: Noise, placement: Floats) -> Floats:
    """The instrument in the base frame: as stated, else the origin of the measurement frame."""
    if noise.tracker is not None and noise.tracker.station is not None and np.array_equal(placement, np.eye(4)):
        return noise.tracker.station
    origin: Floats = placement[:3, 3]
    return origin


class _Look(NamedTuple):
    """One part at a state: as in `Rows`."""

    residual: Floats
    point: Floats
    operators: Whitening
    whitened: Floats
    upper: Floats
    direct: Floats | None


def rows_at(problem: Problem, state: State) -> Rows:
    """All rows at a state, with the triangles of their columns."""
    looks = _each(problem.parts, lambda part: _look(problem, part, state), problem.serial)
    residual, point, operators, whitened, uppers, directs = zip(*looks, strict=True)
    upper = _spread(problem, triangle(uppers))
    direct = [part for part in directs if part is not None]
    return Rows(
        problem,
        state,
        np.concatenate(residual),
        np.concatenate(point),
        operators,
        np.concatenate(whitened),
        upper,
        _spread(problem, triangle(direct)) if direct else upper[:, :-1],
    )


def _look(problem: Problem, part: Part, state: State) -> _Look:
    """One part at a state."""
    response = _response(problem, part, state)
    residual = _residual(part, state, response, problem.model.rows)
    operators = _operators(problem, part, state, response)
    whitened = operators.apply(residual)
    columns = operators.apply(response.derivative[:, :, problem.chosen])
    upper = triangle([np.column_stack([columns, whitened])])
    direct = None
    if response.direct is not response.derivative:
        direct = triangle([operators.apply(response.direct[:, :, problem.chosen])])
    return _Look(residual, response.scene.point, operators, whitened, upper, direct)


def stepped(rows: Rows, state: State, step: Floats) -> Rows:
    """The rows after a step (p,) that leaves whitening and columns as they are."""
    problem = rows.problem
    residuals = _each(
        problem.parts,
        lambda part: _residual(part, state, _response(problem, part, state, columns=False), problem.model.rows),
    )
    whitened = [operators.apply(part) for operators, part in zip(rows.operators, residuals, strict=True)]
    upper = rows.upper.copy()
    upper[:, -1] -= upper[:, :-1] @ step
    residual = np.concatenate(residuals)
    return replace(rows, state=state, residual=residual, whitened=np.concatenate(whitened), upper=upper)


def _each(parts: Sequence[T], work: Callable[[T], U], least: int = _SERIAL) -> list[U]:
    """Do the same for every part, for large data on two threads; order and numbers do not depend on that."""
    if len(parts) < least:
        return [work(part) for part in parts]
    with one_thread(), ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(work, parts))


def _response(problem: Problem, part: Part, state: State, *, columns: bool = True) -> Response:
    if problem.model.rows != "vectors":
        return dual_respond(problem.model, part.data.experiment, state.values, derivative=columns)
    return respond(
        problem.model,
        part.data.experiment,
        state.values,
        derivative=columns,
        wanted=problem.free,
        known=part.scene,
        bending=problem.bending,
    )


def _residual(part: Part, state: State, response: Response, rows: RowAlgebra) -> Floats:
    """(R_i, 3) reading minus model, base frame, m; the turn from model to reading, rad, where a turn is read."""
    placement, experiment = state.base_T_measurement, part.data.experiment
    read = part.data.positions @ placement[:3, :3].T + placement[:3, 3]
    if not len(response.turned):
        return np.asarray(read - response.position)
    turned = placement[:3, :3] @ part.data.orientations(experiment.turning)
    if rows == "dual_quaternion_deviations":
        return deviation_residual(response, experiment, read, turned)
    residual: Floats = read - response.position
    residual[experiment.turning] = rotation_vectors(turned @ response.turned.swapaxes(1, 2))
    return residual


def _operators(problem: Problem, part: Part, state: State, response: Response) -> Whitening:
    """Whitening of a part."""
    return whitening(
        response.scene,
        problem.noise,
        station(problem.noise, state.base_T_measurement),
        free_offsets=problem.free_offsets,
        weights=state.weights[part.rows],
    )


def _spread(problem: Problem, upper: Floats) -> Floats:
    """The columns of what may move, and what follows them, in the place of all p (+ 1)."""
    full = np.zeros((len(upper), len(problem.free) + 1))
    where = np.append(problem.free, upper.shape[1] > problem.free.sum())
    full[:, where] = upper
    return full
