"""Generalised least squares on raw readings, iterated, with bounded influence of bad rows.

The residual of a row is the reading, brought to the base frame, minus the model's prediction. Rows
are whitened visit by visit (`identify.noise`) and the parameters follow from Gauss-Newton steps on an
orthogonal factorisation of the columns that can be identified.

Rows that do not fit lose influence: a row whose distance z from what the others say exceeds
`OUTLYING` times the robust scale of all rows gets its instrument covariance multiplied by
``(z / OUTLYING)^2``. With good rows only, every weight is one and the fit is ordinary GLS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identify.alignment import align, inverse
from identify.arrays import Floats, Ints
from identify.errors import InputError, NoConvergence
from identify.experiment import Measurements
from identify.identifiability import Dropped, Identifiability, independent_columns
from identify.model import Model
from identify.noise import Whitening
from identify.response import Response, frame_displacement, respond
from identify.row_distances import one_of_two, robust_scale
from identify.study import Noise
from identify.whitened_rows import Part, Problem, Rows, State, parts_of, predicted, rows_at, stepped

__all__ = ["OUTLYING", "Fit", "State", "absorb_frame", "fit", "settled_with", "start"]

OUTLYING = 7.0  # P(chi(3) > 7) = 1.3e-10; model errors of real robots reach 6 robust sigmas
_STEP = 1e-8  # converged when no step moves the fit by more than this many sigmas
_SURELY = 0.1  # of this, where it is only foreseen
_COARSE = 1e-3  # the same where a search compares models
_NEARLY = 1e-4  # good enough where rounding does not let it come closer
_CORNER = 1e-2  # sigmas: where only damped steps as short as this descend, and less than one is left to gain
_FIRST_STEPS = 3  # before rows are judged anew
_MAX_STEPS = 60
_MAX_REWEIGHTS = 50
_MAX_CHOICES = 8
_EXACT = 64 * float(np.finfo(np.float64).eps)  # share of the residual that a step on the triangle may miss
_ROUNDING = 1e-10  # of chi2: readings of some m, exact to 1e-16, are compared with um


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged fit.

    Attributes:
        rows: All rows at the solution, and the problem.
        identifiability: Kept and dropped parameters (indices of all p).
        went: How far the fit went from its start, in sigmas: the length of its longest step.
        rate: How much shorter each step came out than the one before it.
        beside: The fit of the other parameters, at the same state, if there is one.
    """

    rows: Rows
    identifiability: Identifiability
    went: float = 0.0
    rate: float = 1.0
    beside: Fit | None = None

    @property
    def model(self) -> Model:
        """The model."""
        return self.rows.problem.model

    @property
    def data(self) -> Measurements:
        """The rows."""
        return self.rows.problem.data

    @property
    def state(self) -> State:
        """Values, frame and weights."""
        return self.rows.state

    @property
    def fitted(self) -> np.ndarray:
        """(p,) True for parameters that this fit was allowed to move."""
        return self.rows.problem.free

    @cached_property
    def response(self) -> Response:
        """The model at the solution, all rows and columns at once."""
        bending = self.rows.problem.bending
        return respond(self.model, self.data.experiment, self.state.values, wanted=self.fitted, bending=bending)

    @property
    def reading(self) -> Floats:
        """(R, 3) readings of positions in the base frame, m."""
        placement = self.state.base_T_measurement
        position: Floats = self.data.positions @ placement[:3, :3].T + placement[:3, 3]
        return position

    @property
    def residual(self) -> Floats:
        """(R, 3) reading minus model, base frame, m (rad in rows that read a turn)."""
        return self.rows.residual

    @property
    def whitening(self) -> Whitening:
        """Operators at the solution."""
        return self.rows.whitening

    @property
    def whitened(self) -> Floats:
        """(K,) whitened residual."""
        return self.rows.whitened

    @cached_property
    def columns(self) -> Floats:
        """(K, p) whitened derivative, all rows at once; `upper` and `Rows.each` do without."""
        return np.concatenate(self.rows.each(lambda _, columns, rows: columns))

    @property
    def upper(self) -> Floats:
        """(m, p) R factor of the columns up to rounding."""
        return self.rows.upper[:, :-1]

    @cached_property
    def z(self) -> Floats:
        """(R,) distance of each row from what the others say, in stated sigmas."""
        z = self.rows.distances
        if self.rows.problem.free_offsets:
            return one_of_two(self.data.experiment, self.residual, z, OUTLYING * self._scale_of(z))
        return z

    @cached_property
    def scale(self) -> float:
        """Robust scale of the distances: 1 if the stated noise is right."""
        return self._scale_of(self.rows.distances)

    def _scale_of(self, z: Floats) -> float:
        return robust_scale(z, len(self.whitened), self.identifiability.rank)

    @property
    def chi2(self) -> float:
        """Weighted sum of squares of the whitened residual."""
        return float(self.whitened @ self.whitened)

    @property
    def dof(self) -> int:
        """Whitened rows minus rank."""
        return len(self.whitened) - self.identifiability.rank


def start(model: Model, data: Measurements, parts: tuple[Part, ...] | None = None) -> State:
    """Nominal values and, for a free frame, the rigid alignment of the readings with the nominal model.

    Args:
        model: The model.
        data: The rows.
        parts: The same in parts, where they are at hand.

    Raises:
        InputError: There are no rows.
    """
    if not len(data.positions):
        raise InputError(f"{data.source}: no rows to fit")
    placement = np.eye(4)
    if model.frame_size:
        places = ~data.experiment.turning
        expected = predicted(model, parts or parts_of(model, data), model.nominal)
        placement = align(data.positions[places], expected[places])
    return State(model.nominal, placement, np.ones(len(data.positions)))


def fit(
    model: Model,
    data: Measurements,
    noise: Noise,
    state: State,
    *,
    free_offsets: bool = False,
    fitted: np.ndarray | None = None,
    reweigh: bool = True,
    like: Fit | None = None,
    coarse: bool = False,
    parts: tuple[Part, ...] | None = None,
) -> Fit:
    """Fit the parameters of a model.

    Args:
        model: The model.
        data: The rows.
        noise: Their stated noise.
        state: Where to start (`start`).
        free_offsets: Only changes within a visit inform (reference ``differences``).
        fitted: (p,) True for parameters to move; all by default.
        reweigh: Take influence from rows that do not fit; else the weights of ``state`` stay.
        like: Another fit of this model to these data, whose rows are in parts already.
        coarse: Columns of first order and steps down to a thousandth of a sigma are enough, as for a search.
        parts: The rows in parts, where they are at hand.

    Raises:
        NoConvergence: No convergence in the allowed steps; ``best`` holds the last fit.
    """
    free = np.ones(len(model.parameters), dtype=bool) if fitted is None else fitted
    if like is not None:
        parts = like.rows.problem.parts
    problem = Problem(model, data, noise, free_offsets, free, parts or parts_of(model, data), bending=not coarse)
    found = _evaluate(problem, state)
    if like is not None and np.array_equal(like.fitted, free):
        found = replace(found, rate=like.rate)
    for _ in range(_MAX_REWEIGHTS if reweigh else 0):
        weights = _weights(found)
        if _differ(weights, found.state.weights):
            found = _settled(problem, _evaluate(problem, replace(found.state, weights=weights)), _FIRST_STEPS)
            continue
        found = _settled(problem, found, _MAX_STEPS)
        if not _differ(_weights(found), weights):
            return found
    return _settled(problem, found, _MAX_STEPS)


def _weights(found: Fit) -> Floats:
    """Weights of the rows by their distances."""
    limit = OUTLYING * found.scale
    weights: Floats = (limit / np.maximum(found.z, limit)) ** 2
    return weights


def _differ(weights: Floats, others: Floats) -> bool:
    return bool(np.abs(np.log(weights / others)).max() >= 0.02)


def _settled(problem: Problem, found: Fit, steps: int) -> Fit:
    """Fit at fixed weights what can be identified where the fit ends; the rest is held at its nominal value.

    A few steps are enough as long as the weights still change: bad rows are found before the fit has
    followed them. A column that vanished on the way (a knee below all torques) would come back at the nominal value
    and vanish again; it stays out.
    """
    vanished: dict[int, Dropped] = {}
    for _ in range(_MAX_CHOICES):
        found = _gauss_newton(_held(problem, found), steps)
        known = _without(_decided(found.rows), vanished)
        was_kept = found.identifiability.kept
        vanished |= {d.column: d for d in known.dropped if d.column in was_kept and not found.upper[:, d.column].any()}
        settled = np.array_equal(known.kept, found.identifiability.kept)
        found = replace(found, identifiability=known)
        if settled:
            return found
    return _gauss_newton(_held(problem, found), steps)


def _without(known: Identifiability, left_out: dict[int, Dropped]) -> Identifiability:
    """The same decision, but for some columns that are dropped in any case."""
    others = tuple(d for d in known.dropped if d.column not in left_out)
    return Identifiability(np.setdiff1d(known.kept, list(left_out)), (*others, *left_out.values()))


def _held(problem: Problem, found: Fit) -> Fit:
    """The same with nominal values for the parameters that cannot be identified."""
    dropped = [d.column for d in found.identifiability.dropped if problem.free[d.column]]
    values = found.state.values.copy()
    values[dropped] = problem.model.nominal[dropped]
    if np.array_equal(values, found.state.values):
        return found
    return _evaluate(problem, replace(found.state, values=values), found.identifiability)


def _gauss_newton(current: Fit, steps: int) -> Fit:
    """Steps for the parameters that are kept, damped (Marquardt) only where the plain step does not descend."""
    damping, before = 0.0, 0.0
    enough = _STEP if current.rows.problem.bending else _COARSE
    for _ in range(steps):
        step, size = _step(current, damping)
        spread = max(1.0, (current.chi2 / max(current.dof, 1)) ** 0.5)
        if size < enough * spread:
            return current
        rate = 1.0 if damping else min(size / before, 1.0) if before else current.rate
        left = max(0.0 if current.rows.problem.linear else rate * size, _EXACT * current.chi2**0.5)
        before, current = size, replace(current, went=max(current.went, size), rate=rate)
        trial = _trial(current, step, last=left < _SURELY * enough * spread)
        descends = _chi2_seen_from(current, trial) < current.chi2 * (1.0 + _ROUNDING)
        short = bool(damping) and np.linalg.norm(current.upper @ step) < _CORNER * spread
        if size < spread and short:
            return trial if descends else current  # along an edge (friction) each side points across it to the other
        if descends:
            current, damping = trial, damping / 100 if damping > 1e-8 else 0.0
        elif size**2 < 10 * _ROUNDING * current.chi2:
            return current  # what is left to gain is lost in rounding
        else:
            damping = max(100 * damping, 1e-10)
    if size < max(_NEARLY, enough) * spread or steps < _MAX_STEPS:
        return current
    raise NoConvergence(
        f"{current.data.source}: the fit still moves by {size:.2g} sigma after {_MAX_STEPS} steps; check units, "
        "marker positions and joint conventions",
        current,
    )


def _trial(current: Fit, step: Floats, *, last: bool) -> Fit:
    """The fit after a step; after the last one nothing is left to gain from another look at the columns."""
    state = _moved(current, step)
    rows = stepped(current.rows, state, step) if last else rows_at(current.rows.problem, state)
    return replace(current, rows=rows)


def settled_with(found: Fit, placed: Fit, earlier: Fit) -> Fit | None:
    """The fit of some parameters after another moved the rest, if that was too little to move these again.

    What they moved when the rest went ``earlier.went`` says what they will do now that it goes ``placed.went``.

    Args:
        found: The fit after the rest was placed as in ``earlier``.
        placed: The fit of the rest that started from there.
        earlier: The fit of the rest before.

    Returns:
        The fit at the state of ``placed``, or None if it has to be done.
    """
    plain = (found.state.weights == 1.0).all() and (placed.state.weights == 1.0).all()
    if not plain or found.went * placed.went > _SURELY * _STEP * earlier.went:
        return None
    return replace(found, rows=stepped(found.rows, placed.state, np.zeros(len(found.fitted))), beside=placed)


def _chi2_seen_from(current: Fit, trial: Fit) -> float:
    """Sum of squares of a trial in the frame and under the covariance of the current state, which the step assumed."""
    if trial.rows.operators is current.rows.operators:
        return trial.chi2
    turn = current.state.base_T_measurement[:3, :3] @ trial.state.base_T_measurement[:3, :3].T
    whitened = current.whitening.apply(trial.residual @ turn.T)
    return float(whitened @ whitened)


def _evaluate(problem: Problem, state: State, known: Identifiability | None = None) -> Fit:
    """All rows at a state; what is identifiable is decided if not given."""
    rows = rows_at(problem, state)
    return Fit(rows, known or _decided(rows))


def _decided(rows: Rows) -> Identifiability:
    """What the direct columns can show of the parameters that may move."""
    problem, whitened = rows.problem, rows.whitened
    spread = max(1.0, float(np.sqrt(whitened @ whitened / max(len(whitened), 1))))
    limits = np.array([parameter.limit for parameter in problem.model.parameters])
    chosen = np.flatnonzero(problem.free)
    found = independent_columns(rows.direct[:, chosen], limits[chosen], spread)
    return Identifiability(
        chosen[found.kept],
        tuple(
            replace(d, column=int(chosen[d.column]), alike=tuple(chosen[list(d.alike)].tolist())) for d in found.dropped
        ),
    )


def _step(current: Fit, damping: float) -> tuple[Floats, float]:
    """Step (p,) on unit columns, and the length in sigmas that the undamped step would take off."""
    step = np.zeros(len(current.model.parameters))
    kept = current.identifiability.kept
    kept = kept[current.upper[:, kept].any(axis=0)]  # a nonlinear effect may lose its column on the way
    if not len(kept):
        return step, 0.0
    columns = current.upper[:, kept]
    norms = np.linalg.norm(columns, axis=0)
    q, r = np.linalg.qr(columns / norms)
    target = q.T @ current.rows.upper[:, -1]
    damped = np.vstack([r, np.sqrt(damping) * np.eye(len(kept))])
    step[kept] = np.linalg.lstsq(damped, np.append(target, np.zeros(len(kept))), rcond=None)[0] / norms
    return step, float(np.linalg.norm(target))


def _moved(current: Fit, step: Floats) -> State:
    """Values after a step; the frame's part goes into the placement."""
    state = current.state
    values, placement = absorb_frame(current.model, state.values + step, state.base_T_measurement)
    return replace(state, values=values, base_T_measurement=placement)


def absorb_frame(model: Model, values: Floats, placement: Floats) -> tuple[Floats, Floats]:
    """The same readings with frame parameters of zero: their displacement goes into the placement.

    Args:
        model: The model.
        values: (p,) parameters in their units.
        placement: (4, 4) base_T_measurement, m.

    Returns:
        (p,) values and (4, 4) placement.
    """
    if not model.frame_size:
        return values, placement
    displaced = np.eye(4)
    displaced[:3, :3], displaced[:3, 3] = frame_displacement(model, values)
    values = values.copy()
    values[: model.frame_size] = 0.0
    return values, inverse(displaced) @ placement


def rows_that_do_not_fit(found: Fit) -> Ints:
    """Rows beyond `OUTLYING` robust sigmas, worst first."""
    far = np.flatnonzero(found.z > OUTLYING * found.scale)
    order: Ints = far[np.argsort(-found.z[far], kind="stable")]
    return order
