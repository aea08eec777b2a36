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

import numpy as np

from identify.alignment import align, inverse
from identify.arrays import Floats, Ints
from identify.errors import InputError, NoConvergence
from identify.experiment import Experiment, Measurements
from identify.identifiability import Dropped, Identifiability, independent_columns, triangle
from identify.model import Model, Response, frame_displacement, respond
from identify.noise import Whitening, instrument_covariance, whitening
from identify.study import Noise

__all__ = ["OUTLYING", "Fit", "State", "absorb_frame", "fit", "start"]

OUTLYING = 7.0  # P(chi(3) > 7) = 1.3e-10; model errors of real robots reach 6 robust sigmas
_MEDIAN_CHI2_3 = 2.365974
_STEP = 1e-8  # converged when no step moves the fit by more than this many sigmas
_NEARLY = 1e-4  # good enough where rounding does not let it come closer
_CORNER = 1e-2  # sigmas: where only damped steps as short as this descend, and less than one is left to gain
_FIRST_STEPS = 3  # before rows are judged anew
_MAX_STEPS = 60
_MAX_REWEIGHTS = 50
_MAX_CHOICES = 8
_ROUNDING = 1e-10  # of chi2: readings of some m, exact to 1e-16, are compared with um


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
class Fit:
    """A converged fit.

    Attributes:
        model: The model.
        data: The rows.
        state: Values, frame and weights.
        response: The model at the solution.
        residual: (R, 3) reading minus model, base frame, m.
        whitening: Operators at the solution.
        columns: (K, p) whitened derivative.
        whitened: (K,) whitened residual.
        identifiability: Kept and dropped parameters (indices of all p).
        fitted: (p,) True for parameters that this fit was allowed to move.
        z: (R,) distance of each row from what the others say, in stated sigmas.
        scale: Robust scale of ``z``: 1 if the stated noise is right.
    """

    model: Model
    data: Measurements
    state: State
    response: Response
    residual: Floats
    whitening: Whitening
    columns: Floats
    whitened: Floats
    identifiability: Identifiability
    fitted: np.ndarray
    z: Floats
    scale: float

    @property
    def chi2(self) -> float:
        """Weighted sum of squares of the whitened residual."""
        return float(self.whitened @ self.whitened)

    @property
    def dof(self) -> int:
        """Whitened rows minus rank."""
        return len(self.whitened) - self.identifiability.rank


@dataclass(frozen=True, eq=False)
class _Problem:
    """What does not change during a fit."""

    model: Model
    data: Measurements
    noise: Noise
    free_offsets: bool
    free: np.ndarray


def start(model: Model, data: Measurements) -> State:
    """Nominal values and, for a free frame, the rigid alignment of the readings with the nominal model.

    Raises:
        InputError: There are no rows.
    """
    if not len(data.positions):
        raise InputError(f"{data.source}: no rows to fit")
    predicted = respond(model, data.experiment, model.nominal, derivative=False).position
    placement = align(data.positions, predicted) if model.frame_size else np.eye(4)
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

    Raises:
        NoConvergence: No convergence in the allowed steps; ``best`` holds the last fit.
    """
    free = np.ones(len(model.parameters), dtype=bool) if fitted is None else fitted
    problem = _Problem(model, data, noise, free_offsets, free)
    found = _evaluate(problem, state)
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


def _settled(problem: _Problem, found: Fit, steps: int) -> Fit:
    """Fit at fixed weights what can be identified where the fit ends; the rest is held at its nominal value.

    A few steps are enough as long as the weights still change: bad rows are found before the fit has
    followed them. A column that vanished on the way (a knee below all torques) would come back at the nominal value
    and vanish again; it stays out.
    """
    vanished: dict[int, Dropped] = {}
    for _ in range(_MAX_CHOICES):
        found = _gauss_newton(problem, _held(problem, found), steps)
        known = _without(_identifiable(problem, found), vanished)
        was_kept = found.identifiability.kept
        vanished |= {
            d.column: d for d in known.dropped if d.column in was_kept and not found.columns[:, d.column].any()
        }
        settled = np.array_equal(known.kept, found.identifiability.kept)
        found = replace(found, identifiability=known)
        if settled:
            return found
    return _gauss_newton(problem, _held(problem, found), steps)


def _without(known: Identifiability, left_out: dict[int, Dropped]) -> Identifiability:
    """The same decision, but for some columns that are dropped in any case."""
    others = tuple(d for d in known.dropped if d.column not in left_out)
    return Identifiability(np.setdiff1d(known.kept, list(left_out)), (*others, *left_out.values()))


def _held(problem: _Problem, found: Fit) -> Fit:
    """The same with nominal values for the parameters that cannot be identified."""
    dropped = [d.column for d in found.identifiability.dropped if problem.free[d.column]]
    values = found.state.values.copy()
    values[dropped] = problem.model.nominal[dropped]
    if np.array_equal(values, found.state.values):
        return found
    return _evaluate(problem, replace(found.state, values=values), found.identifiability)


def _gauss_newton(problem: _Problem, current: Fit, steps: int) -> Fit:
    """Steps for the parameters that are kept, damped (Marquardt) only where the plain step does not descend."""
    damping = 0.0
    for _ in range(steps):
        step, size = _step(current, damping)
        spread = max(1.0, (current.chi2 / max(current.dof, 1)) ** 0.5)
        if size < _STEP * spread:
            return current
        trial = _evaluate(problem, _moved(current, step), current.identifiability)
        descends = _chi2_seen_from(current, trial) < current.chi2 * (1.0 + _ROUNDING)
        short = bool(damping) and np.linalg.norm(current.columns @ step) < _CORNER * spread
        if size < spread and short:
            return trial if descends else current  # along an edge (friction) each side points across it to the other
        if descends:
            current, damping = trial, damping / 100 if damping > 1e-8 else 0.0
        elif size**2 < 10 * _ROUNDING * current.chi2:
            return current  # what is left to gain is lost in rounding
        else:
            damping = max(100 * damping, 1e-10)
    if size < _NEARLY * spread or steps < _MAX_STEPS:
        return current
    raise NoConvergence(
        f"{current.data.source}: the fit still moves by {size:.2g} sigma after {_MAX_STEPS} steps; check units, "
        "marker positions and joint conventions",
        current,
    )


def _chi2_seen_from(current: Fit, trial: Fit) -> float:
    """Sum of squares of a trial in the frame and under the covariance of the current state, which the step assumed."""
    turn = current.state.base_T_measurement[:3, :3] @ trial.state.base_T_measurement[:3, :3].T
    whitened = current.whitening.apply(trial.residual @ turn.T)
    return float(whitened @ whitened)


def _evaluate(problem: _Problem, state: State, known: Identifiability | None = None) -> Fit:
    """Residuals, whitening, columns and row distances at a state; what is identifiable is decided if not given."""
    model, data, noise, free = problem.model, problem.data, problem.noise, problem.free
    response = respond(model, data.experiment, state.values, wanted=free)
    placement = state.base_T_measurement
    residual = data.positions @ placement[:3, :3].T + placement[:3, 3] - response.position
    station = _station(noise, placement)
    operators = whitening(response.scene, noise, station, free_offsets=problem.free_offsets, weights=state.weights)
    columns = operators.apply(response.derivative)
    columns[:, ~free] = 0.0
    whitened = operators.apply(residual)
    known = known or _decided(problem, response, operators, columns, whitened)
    own = instrument_covariance(noise, response.scene.point, station)
    z = _row_distances(operators, residual, own, state.weights)
    scale = _robust_scale(z, len(columns), known.rank)
    if problem.free_offsets:
        z = _one_of_two(data.experiment, residual, z, OUTLYING * scale)
    return Fit(model, data, state, response, residual, operators, columns, whitened, known, free, z, scale)


def _identifiable(problem: _Problem, found: Fit) -> Identifiability:
    """What can be identified at a state that was evaluated with another decision."""
    return _decided(problem, found.response, found.whitening, found.columns, found.whitened)


def _decided(
    problem: _Problem, response: Response, operators: Whitening, columns: Floats, whitened: Floats
) -> Identifiability:
    """What the direct columns can show of the parameters that may move."""
    direct = columns if response.direct is response.derivative else operators.apply(response.direct)
    spread = max(1.0, float(np.sqrt(whitened @ whitened / max(len(whitened), 1))))
    limits = np.array([parameter.limit for parameter in problem.model.parameters])
    chosen = np.flatnonzero(problem.free)
    found = independent_columns(triangle([direct[:, chosen]]), limits[chosen], spread)
    return Identifiability(
        chosen[found.kept],
        tuple(
            replace(d, column=int(chosen[d.column]), alike=tuple(chosen[list(d.alike)].tolist())) for d in found.dropped
        ),
    )


def _station(noise: Noise, placement: Floats) -> Floats:
    """The instrument in the base frame: as stated, else the origin of the measurement frame."""
    if noise.tracker is not None and noise.tracker.station is not None and np.array_equal(placement, np.eye(4)):
        return noise.tracker.station
    origin: Floats = placement[:3, 3]
    return origin


def _step(current: Fit, damping: float) -> tuple[Floats, float]:
    """Step (p,) on unit columns, and the length in sigmas that the undamped step would take off."""
    step = np.zeros(len(current.model.parameters))
    kept = current.identifiability.kept
    kept = kept[current.columns[:, kept].any(axis=0)]  # a nonlinear effect may lose its column on the way
    if not len(kept):
        return step, 0.0
    columns = current.columns[:, kept]
    norms = np.linalg.norm(columns, axis=0)
    q, r = np.linalg.qr(columns / norms)
    target = q.T @ current.whitened
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


def _row_distances(operators: Whitening, residual: Floats, own: Floats, weights: Floats) -> Floats:
    """Distance of each row from what the others of its visit and the model say, in stated sigmas, (R,).

    With P = N'N and u = P e, the mean shift of row i is ``P_ii^-1 u_i`` with covariance ``P_ii^-1``; the
    inflation that the row's weight put into it is taken out again.
    """
    z = np.zeros(len(residual))
    for index, operator in operators.groups:
        count, size = index.shape
        if operator.shape[1] == 0:
            continue
        error = residual[index].reshape(count, 3 * size, 1)
        score = (operator.swapaxes(1, 2) @ (operator @ error)).reshape(count, size, 3)
        split = operator.reshape(count, operator.shape[1], size, 3).transpose(0, 2, 3, 1)
        precision = split @ split.swapaxes(2, 3)
        z[index] = _shift_distance(precision, score, own[index], weights[index])
    return z


def _shift_distance(precision: Floats, score: Floats, own: Floats, weights: Floats) -> Floats:
    """Mahalanobis length of the mean shifts, (G, m); zero where a row has nothing to be compared with."""
    alone = np.linalg.norm(precision, axis=(2, 3)) * np.linalg.norm(own, axis=(2, 3)) < 1e-12
    precision = np.where(alone[:, :, None, None], np.eye(3), precision)
    spread = np.linalg.inv(precision)
    shift = (spread @ score[..., None])[..., 0]
    spread = spread + own * (1.0 - 1.0 / weights)[:, :, None, None]
    square = np.einsum("gmi,gmi->gm", shift, np.linalg.solve(spread, shift[..., None])[..., 0])
    return np.where(alone, 0.0, np.sqrt(np.maximum(square, 0.0)))


def _one_of_two(experiment: Experiment, residual: Floats, z: Floats, limit: float) -> Floats:
    """Where two rows contradict each other and nothing else compares them, only one of them is accused.

    Changes cannot tell which of the two is wrong; the one near where the model and the visit's other
    markers put it is believed, if it is at least twice as near as the other.
    """
    z = z.copy()
    key = experiment.row_visit * len(experiment.markers.names) + experiment.row_marker
    group = np.unique(key, return_inverse=True)[1]
    contradict = (np.bincount(group) == 2) & (np.bincount(group, z > limit) == 2)
    rows = np.flatnonzero(contradict[group])
    for one, other in rows[np.argsort(group[rows], kind="stable")].reshape(-1, 2):
        beside = (experiment.row_visit == experiment.row_visit[one]) & (group != group[one])
        expected = np.median(residual[beside], axis=0) if beside.any() else np.zeros(3)
        distance = np.linalg.norm(residual[[one, other]] - expected, axis=1)
        if distance.min() < 0.5 * distance.max():
            z[[one, other][int(distance.argmin())]] = 0.0
    return z


def _robust_scale(z: Floats, rows: int, rank: int) -> float:
    """Scale of the row distances from their median, corrected for the parameters fitted."""
    compared = z[z > 0]
    if not len(compared) or rows <= rank:
        return 1.0
    spread = np.median(compared**2) / _MEDIAN_CHI2_3 * rows / (rows - rank)
    return float(np.sqrt(max(spread, 1e-6)))


def rows_that_do_not_fit(found: Fit) -> Ints:
    """Rows beyond `OUTLYING` robust sigmas, worst first."""
    far = np.flatnonzero(found.z > OUTLYING * found.scale)
    order: Ints = far[np.argsort(-found.z[far], kind="stable")]
    return order
