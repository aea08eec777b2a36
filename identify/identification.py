"""The public verb `identify`: from readings to parameters with honest intervals."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.errors import InputError, NotIdentifiable
from identify.experiment import Experiment, Measurements
from identify.fit import Fit, State, fit, rows_that_do_not_fit, settled_with, start
from identify.identifiability import why_not
from identify.lack_of_fit import LackOfFit, lack_of_fit
from identify.model import Model, model_of
from identify.selection import load_changes, rows_of_visits, take_rows
from identify.six_d import facing, positions_only, with_turns_read
from identify.study import Study
from identify.tails import norm_ppf, student_ppf
from identify.threads import one_thread
from identify.uncertainty import load_share, stated_covariance, visit_covariance
from identify.whitened_rows import parts_of, predicted

__all__ = ["Heldout", "Identification", "Misfit", "fit_differences", "heldout_misfit", "identify", "misfit_of"]

_REJECTED = 1e-3  # the fit is rejected if chi2 is this improbable
_HELDOUT_SHARE = 0.4
_HELDOUT_LEAST = 10  # poses
_ALTERNATIONS = 4

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Misfit:
    """Errors of a marker after the fit: of its position, or of its change under load (``differences``).

    Attributes:
        error: (K, 3) base frame, m.
        rows: (K,) rows they belong to.
    """

    error: Floats
    rows: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square of the 3-D error, m."""
        return float(np.sqrt((self.error**2).sum(axis=1).mean())) if len(self.error) else float("nan")

    @property
    def maximum(self) -> float:
        """Largest 3-D error, m."""
        return float(np.linalg.norm(self.error, axis=1).max()) if len(self.error) else float("nan")


@dataclass(frozen=True, eq=False)
class Heldout:
    """Misfit on visits that took no part in the fit (rows that do not fit at all left out)."""

    misfit: Misfit
    visits: int


@dataclass(frozen=True, eq=False)
class Identification:
    """The result of `identify`.

    Attributes:
        study: The study.
        data: The readings; where orientations count, each is a row of its own behind that of its position.
        fit: The fit of the parameters.
        values: (p,) all parameters in their units; frame values are those of ``base_T_measurement``.
        kept: (m,) indices of the identified parameters; under ``differences`` frame and markers come from the
            offsets of the visits.
        covariance: (p, p) of the values; zero rows for what was held at its nominal value.
        covariance_kind: ``stated noise`` or ``pose-clustered``.
        quantile: 97.5 % quantile that the intervals use.
        reference: absolute or differences.
        lack_of_fit: Chi2 of the rows that fit, its degrees of freedom and its p value.
        worst: Rows that do not fit, worst first.
        heldout: Misfit on held-out visits, None below 10 visits.
        notes: What the user should know.
        mounts: (M, 3, 3) flange_R_target, where orientations count; how far off it is are parameters.
    """

    study: Study
    data: Measurements
    fit: Fit
    values: Floats
    kept: Ints
    covariance: Floats
    covariance_kind: Literal["stated noise", "pose-clustered"]
    quantile: float
    reference: Literal["absolute", "differences"]
    lack_of_fit: LackOfFit
    worst: np.ndarray
    heldout: Heldout | None
    notes: tuple[str, ...]
    mounts: Floats | None = None

    @property
    def model(self) -> Model:
        """The model that was fitted."""
        return self.fit.model

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the identified parameters that are asked for, by name, in their units."""
        asked = [index for index in self.kept if not self.model.parameters[index].nuisance]
        return {self.model.names[index]: float(self.values[index]) for index in asked}

    @property
    def residuals(self) -> Floats:
        """(R, 3) reading minus model in the base frame, m, of the positions read."""
        residual: Floats = self.fit.residual[~self.data.experiment.turning]
        return residual

    @property
    def turn_residuals(self) -> Floats:
        """(K, 3) turn from model to reading in the base frame, rad, of the orientations that count."""
        residual: Floats = self.fit.residual[self.data.experiment.turning]
        return residual

    @property
    def misfit(self) -> Misfit:
        """Errors of positions after the fit, all rows."""
        return misfit_of(self.data, self.fit.residual, self.reference, np.arange(len(self.fit.residual)))

    @property
    def deflection(self) -> tuple[Misfit, Misfit]:
        """Measured deflection and what the model leaves of it, without `worst`; empty without loads."""
        rows = np.setdiff1d(np.arange(len(self.fit.residual)), self.worst)
        before = misfit_of(self.data, self.fit.reading, "differences", rows)
        return before, misfit_of(self.data, self.fit.residual, "differences", rows)

    @property
    def compensated_percent(self) -> float | None:
        """Share of the measured deflection that the model takes away, per cent; None without loads."""
        before, after = self.deflection
        return float(100.0 * (1.0 - after.rms / before.rms)) if len(before.error) else None


def identify(study: Study, data: Measurements, *, seed: int = 0, found: Fit | None = None) -> Identification:
    """Fit the parameters of a study to readings.

    Loaded and unloaded readings enter one likelihood (reference ``absolute``), or every visit gets a
    free offset of each marker so that only changes between loads inform (``differences``).

    Args:
        study: The study.
        data: The readings.
        seed: Seed of the held-out split.
        found: A fit of the study's model to these readings, which is taken as it is; by default they are fitted.

    Raises:
        NotIdentifiable: No parameter can be identified, or there are fewer rows than unknowns.
        NoConvergence: The fit did not converge.
    """
    with one_thread():
        return _identify(study, data, seed, found)


def _identify(study: Study, data: Measurements, seed: int, known: Fit | None) -> Identification:
    study, data, mounts = _with_orientations(study, data)
    model = model_of(study) if known is None else known.model
    found, reference, notes = _choose_reference(study, model, data) if known is None else _as_it_is(known)
    _check_enough(found)
    worst = rows_that_do_not_fit(found)
    lack = lack_of_fit(found, worst)
    covariance, kind, quantile = _uncertainty(found, lack)
    offsets, kept = _offsets_share(found, study)
    notes = (*notes, *_notes(found, kind, lack, worst), *_unresolved(found, covariance, quantile))
    heldout = _heldout(study, found, reference, worst, seed)
    values = found.state.values.copy()
    if model.frame_size:
        values[:6] = _frame_values(found.state.base_T_measurement)
    return Identification(
        study=study,
        data=data,
        fit=found,
        values=frozen(values),
        kept=frozen(kept, np.int64),
        covariance=frozen(covariance + offsets),
        covariance_kind=kind,
        quantile=quantile,
        reference=reference,
        lack_of_fit=lack,
        worst=worst,
        heldout=heldout,
        notes=notes,
        mounts=mounts,
    )


def _with_orientations(study: Study, data: Measurements) -> tuple[Study, Measurements, Floats | None]:
    """Rows for the orientations of 6-D targets, if the data have them and the study says how good they are."""
    if not study.six_d or data.quaternions is None:
        if study.rows != "vectors":
            missing = "the columns qw, qx, qy, qz" if study.six_d else "[noise] orientation_urad"
            raise InputError(
                f'{study.path}: [model] rows = "{study.rows}" is for poses of 6-D targets, {missing} are missing; '
                'state them, or use rows = "vectors"'
            )
        return positions_only(study), data, None
    model, data = model_of(study), data if data.experiment.row_turns is not None else with_turns_read(data)
    return study, *facing(model, data, start(model, data).base_T_measurement)


def _as_it_is(found: Fit) -> tuple[Fit, Literal["absolute", "differences"], tuple[str, ...]]:
    """A fit that is at hand, with the reference that it was made with."""
    return found, "differences" if found.whitening.cancels else "absolute", ()


def _choose_reference(
    study: Study, model: Model, data: Measurements
) -> tuple[Fit, Literal["absolute", "differences"], tuple[str, ...]]:
    """Absolute or differences, as stated or by the rule of ``auto``."""
    loaded = not data.experiment.shot_unloaded.all()
    elastic = any(effect.yields for effect in model.effects)
    notes: tuple[str, ...] = ()
    wanted = study.reference
    if wanted == "auto" and loaded and elastic and not study.robot.masses_known and _compares_loads(data):
        wanted = "differences"
        notes = ("link masses are unknown: only changes between loads are used (reference differences)",)
    if wanted == "differences":
        return fit_differences(study, model, data), "differences", notes
    if elastic and not study.robot.masses_known:
        notes = ("link masses are unknown: self-weight is left out",)
    parts = parts_of(model, data)
    absolute = fit(model, data, study.noise, start(model, data, parts), parts=parts)
    trusts_geometry = any(effect.name in {"geometry", "transmission_error"} for effect in model.effects)
    if wanted == "absolute" or trusts_geometry or not (loaded and elastic) or not _is_rejected(absolute):
        return absolute, "absolute", notes
    note = "absolute readings contradict the model (geometry is not in it): only changes between loads are used"
    return fit_differences(study, model, data, absolute.state), "differences", (note,)


def _is_rejected(found: Fit) -> bool:
    """True if the rows that fit contradict model and stated noise."""
    return lack_of_fit(found, rows_that_do_not_fit(found)).p_value < _REJECTED


def _compares_loads(data: Measurements) -> bool:
    """True if some marker is read more than once in one visit, so that changes exist."""
    experiment = data.experiment
    key = experiment.row_visit * 2 * len(experiment.markers.names) + experiment.row_channel
    return len(np.unique(key)) < len(key)


def fit_differences(
    study: Study,
    model: Model,
    data: Measurements,
    state: State | None = None,
    *,
    reweigh: bool = True,
    coarse: bool = False,
) -> Fit:
    """Effects from changes within visits, frame and markers from the visits' offsets, in turn until both stand."""
    parts = parts_of(model, data)
    state = state or start(model, data, parts)
    nuisance, noise = model.nuisance, study.noise
    fit_to = partial(fit, model, data, noise, reweigh=reweigh, coarse=coarse)
    begin = _plain(state, model) if reweigh else state
    found = fit_to(begin, free_offsets=True, fitted=~nuisance, parts=parts)
    if not nuisance.any():
        return found
    placed: Fit | None = None
    for _ in range(_ALTERNATIONS):
        earlier, placed = placed, fit_to(found.state, fitted=nuisance, like=placed or found)
        settled = settled_with(found, placed, earlier) if earlier else None
        if settled:
            return settled
        before, begin = found.state, _with_weights(placed.state, found.state)
        found = fit_to(begin, free_offsets=True, fitted=~nuisance, like=found)
        moved = np.abs(found.state.values - before.values)[~nuisance]
        if (moved <= 1e-9 * np.abs(found.state.values[~nuisance])).all():
            break
    return found


def _plain(state: State, model: Model) -> State:
    """A start with all weights one and effects at their nominal values."""
    values = np.where(model.nuisance, state.values, model.nominal)
    return State(values, state.base_T_measurement, np.ones_like(state.weights))


def _with_weights(state: State, weights_of: State) -> State:
    """Values of one state with the weights of another."""
    return State(state.values, state.base_T_measurement, weights_of.weights)


def _check_enough(found: Fit) -> None:
    """Refuse what cannot be concluded.

    Raises:
        NotIdentifiable: Nothing that is asked for can be identified, or there are too few rows for it.
    """
    model, known, rows = found.model, found.identifiability, len(found.whitened)
    dropped = [d for d in known.dropped if found.fitted[d.column]]
    names = tuple(model.names[d.column] for d in dropped)
    if rows <= known.rank and any(d.alike for d in dropped):
        raise NotIdentifiable(
            f"{found.data.source}: {rows} independent equations are too few for {known.rank + len(dropped)} unknowns; "
            "measure more poses or more loads at each pose",
            names,
        )
    asked = found.fitted & ~model.nuisance if model.effects else found.fitted
    if not asked[known.kept].any():
        reasons = "; ".join(f"{model.names[d.column]}: {why_not(model, d)}" for d in dropped[:8])
        raise NotIdentifiable(f"{found.data.source}: no parameter can be identified ({reasons})", names)


def _uncertainty(found: Fit, lack: LackOfFit) -> tuple[Floats, Literal["stated noise", "pose-clustered"], float]:
    """Covariance of all parameters, its kind and the quantile of the intervals."""
    kind: Literal["stated noise", "pose-clustered"] = "stated noise"
    quantile = norm_ppf(0.975)
    if lack.p_value >= _REJECTED:
        covariance = stated_covariance(found)
    else:
        kind = "pose-clustered"
        covariance, clusters = visit_covariance(found)
        quantile = student_ppf(0.975, max(clusters - 1, 1))
    return covariance + load_share(found), kind, quantile


def _offsets_share(found: Fit, study: Study) -> tuple[Floats, Ints]:
    """Covariance (p, p) and kept indices of frame and markers where the fit to changes left them out."""
    if found.fitted.all():
        return np.zeros((len(found.fitted),) * 2), found.identifiability.kept
    placed = found.beside or fit(found.model, found.data, study.noise, found.state, fitted=~found.fitted, like=found)
    kept = np.union1d(found.identifiability.kept, placed.identifiability.kept)
    return visit_covariance(placed)[0], kept


def _notes(found: Fit, kind: str, lack: LackOfFit, worst: np.ndarray) -> tuple[str, ...]:
    notes = []
    if kind == "pose-clustered":
        notes.append(
            f"chi2 {lack.chi2:.4g} with {lack.dof} degrees of freedom rejects model or stated noise; "
            "intervals come from the scatter between poses"
        )
    if found.data.quaternions is not None and found.data.experiment.row_turns is None:
        notes.append("orientations are not used, [noise] orientation_urad is not stated; the fit rests on positions")
    if len(worst):
        notes.append(f"{len(worst)} rows do not fit and have little influence; see worst")
    return tuple(notes)


def misfit_of(data: Measurements, residual: Floats, reference: str, rows: Ints) -> Misfit:
    """Errors of some rows (ascending) that read positions: of these, or of their changes under load."""
    rows = rows[~data.experiment.turning[rows]]
    if reference == "absolute":
        return Misfit(residual[rows], rows)
    error, index = load_changes(take_rows(data, rows).experiment, residual[rows])
    return Misfit(error, rows[index])


def _unresolved(found: Fit, covariance: Floats, quantile: float) -> tuple[str, ...]:
    """Says so where the loads bend the arm too little for the readings to tell how soft it is."""
    model, experiment = found.model, found.data.experiment
    pairs = zip(model.effects, model.effect_slices, strict=True)
    elastic = [k for effect, where in pairs if effect.yields for k in range(where.start, where.stop)]
    asked = np.intersect1d(elastic, found.identifiability.kept)
    dark = [k for k in asked if abs(found.state.values[k]) < quantile * np.sqrt(covariance[k, k])]
    if 2 * len(dark) < len(asked) or not dark or experiment.shot_unloaded.all():
        return ()
    changed = misfit_of(found.data, found.reading, "differences", np.arange(len(found.residual)))
    size = f" (readings change by {changed.rms * 1e3:.3g} mm rms)" if len(changed.error) else ""
    names = ", ".join(model.names[k] for k in dark)
    return (
        f"the deflection under these loads{size} is below what the data resolve: {len(dark)} of {len(asked)} "
        f"compliances have intervals that hold zero ({names}); hang more weight or measure more poses",
    )


def _heldout(study: Study, found: Fit, reference: str, worst: np.ndarray, seed: int) -> Heldout | None:
    """Fit a random 60 % of the visits and judge the others."""
    experiment = found.data.experiment
    present = np.unique(experiment.row_visit)
    if len(present) < _HELDOUT_LEAST:
        return None
    shuffled = np.random.default_rng(seed).permutation(present[_by_joint_values(experiment, present)])
    judged = np.zeros(len(experiment.visits), dtype=bool)
    judged[shuffled[: round(_HELDOUT_SHARE * len(present))]] = True
    fine = np.ones(len(experiment.row_visit), dtype=bool)
    fine[worst] = False
    misfit = heldout_misfit(study, found, reference, judged, fine)
    return Heldout(misfit, int(judged.sum())) if len(misfit.error) else None


def _by_joint_values(experiment: Experiment, visits: Ints) -> Ints:
    """Order of visits that their names have no part in."""
    first = np.zeros(len(experiment.visits), dtype=np.int64)
    first[experiment.shot_visit[::-1]] = np.arange(len(experiment.shot_visit))[::-1]
    q = experiment.q[experiment.shot_pose[first[visits]]]
    order: Ints = np.lexsort(q.T[::-1])
    return order


def heldout_misfit(study: Study, found: Fit, reference: str, judged: np.ndarray, fine: np.ndarray) -> Misfit:
    """Misfit on the judged visits of a fit to the others.

    Args:
        study: The study.
        found: The fit to all visits, where the new fit starts.
        reference: Its reference.
        judged: (V,) True for visits to judge.
        fine: (R,) True for rows that count.
    """
    model = found.model
    rows = rows_of_visits(found.data.experiment, ~judged)
    part = take_rows(found.data, rows)
    begin = State(found.state.values, found.state.base_T_measurement, found.state.weights[rows])
    plain = not found.rows.problem.bending  # as the fit to all visits was made
    if reference == "absolute":
        trained = fit(model, part, study.noise, begin, reweigh=not plain, coarse=plain)
    else:
        trained = fit_differences(study, model, part, begin, reweigh=not plain, coarse=plain)
    expected = predicted(model, found.rows.problem.parts, trained.state.values)
    placement = trained.state.base_T_measurement
    residual = found.data.positions @ placement[:3, :3].T + placement[:3, 3] - expected
    rows = np.flatnonzero(judged[found.data.experiment.row_visit] & fine)
    return misfit_of(found.data, residual, reference, rows)


def _frame_values(placement: Floats) -> Floats:
    """Translation (mm) and rotation vector (mrad) of a placement."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(placement[:3, :3]).as_rotvec()
    return np.concatenate([placement[:3, 3], turn]) * 1e3
