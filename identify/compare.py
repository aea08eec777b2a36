"""Several models of one robot, fitted to the same readings and judged side by side.

The table is that of Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", table 2: for
each model its parameters, the largest and the rms error of each coordinate and of the position, and how much of the
deflection it takes away; beside it the same on poses that took no part in the fit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from identify.arrays import Floats, frozen
from identify.effects.compensator import NAME as COMPENSATOR
from identify.effects.compensator_options import mode_of, options_of
from identify.errors import InputError, NoConvergence
from identify.experiment import Measurements
from identify.fit import Fit, State, fit, start
from identify.identification import Misfit, fit_differences, misfit_of
from identify.model import model_of
from identify.response import respond
from identify.selection import load_changes, rows_of_visits, take_rows
from identify.study import ModelChoice, Study

__all__ = ["Comparison", "CrossFit", "Normality", "compare", "default_choices"]

_FOLDS = 5
_LEAST_VISITS = 3
_SHAPIRO_MOST = 5000  # values; beyond, the p value of Shapiro and Wilk is not accurate


@dataclass(frozen=True)
class Normality:
    """Are the whitened residuals normal?

    Attributes:
        test: Shapiro-Wilk, or D'Agostino's K^2 above 5000 values.
        statistic: Its statistic.
        p_value: Small if they are not.
    """

    test: str
    statistic: float
    p_value: float


@dataclass(frozen=True, eq=False)
class CrossFit:
    """Errors on poses that took no part in the fit: each fold of the poses is judged by a fit to the others.

    Attributes:
        misfit: Errors of all poses.
        compensated: Share of the measured deflection taken away, per cent; None without loads.
        folds: Number of folds.
        parameters: Fewest parameters that the poses of a fit could tell; the others were nominal there.
    """

    misfit: Misfit
    compensated: float | None
    folds: int
    parameters: int


@dataclass(frozen=True, eq=False)
class Comparison:
    """One line of the table.

    Attributes:
        choice: The model.
        parameters: Number of identified parameters, frame and markers left out.
        misfit: Errors on the fitted poses.
        compensated: Share of the measured deflection taken away, per cent; None without loads.
        whitened: (K,) residuals in stated sigmas.
        normality: Test of these; None for fewer than eight.
        crossfit: Errors on held-out poses; None below three poses or if a fit failed.
    """

    choice: ModelChoice
    parameters: int
    misfit: Misfit
    compensated: float | None
    whitened: Floats
    normality: Normality | None
    crossfit: CrossFit | None


def default_choices(study: Study) -> tuple[ModelChoice, ...]:
    """Joints (J) and links (C), with levels of the compensator too where the study has options for them (J2, C2)."""
    parts = {"J": "joint_compliance", "C": "link_compliance"}
    options = study.options.get(COMPENSATOR)
    places = [effect for effect in study.effects if effect.partition("@")[0] == COMPENSATOR] or [COMPENSATOR]
    if options is None or mode_of(options_of(options, 1)) != "levels":
        return tuple(ModelChoice(name, (effect,), study.options) for name, effect in parts.items())
    return tuple(
        ModelChoice(f"{name}{1 + bool(extra)}", (effect, *extra), study.options)
        for name, effect in parts.items()
        for extra in ((), tuple(places))
    )


def compare(
    study: Study,
    data: Measurements,
    reference: str,
    choices: Iterable[ModelChoice] | None = None,
    *,
    seed: int = 0,
) -> tuple[Comparison, ...]:
    """Fit several models to the same readings.

    Args:
        study: The study; robot, noise, frames and nominal values are common to all models.
        data: The readings.
        reference: ``absolute`` or ``differences``, the same for all models.
        choices: The models; by default those of the study, else `default_choices`. A rigid robot, ``none``, is put in
            front.
        seed: Seed of the folds.

    Raises:
        InputError: A model that the robot cannot have.
        NoConvergence: A fit did not converge.
    """
    given = tuple(choices or study.models or default_choices(study))
    rigid = () if any(not choice.effects for choice in given) else (ModelChoice("none", (), MappingProxyType({})),)
    return tuple(_line(study, data, reference, choice, seed) for choice in (*rigid, *given))


def _line(study: Study, data: Measurements, reference: str, choice: ModelChoice, seed: int) -> Comparison:
    """Fit one model."""
    own = replace(study, effects=choice.effects, options=choice.options, nominal={})
    try:
        names = model_of(own).names
        own = replace(own, nominal={name: value for name, value in study.nominal.items() if name in names})
        found = _fitted(own, data, reference)
    except InputError as error:
        raise InputError(f"{study.path}: model {choice.name} of the comparison: {error}") from None
    return Comparison(
        choice=choice,
        parameters=_identified(found),
        misfit=misfit_of(data, found.residual, reference, np.arange(len(found.residual))),
        compensated=_compensated(data, found, found.residual),
        whitened=frozen(found.whitened),
        normality=_normality(found.whitened),
        crossfit=_crossfit(own, found, reference, seed),
    )


def _fitted(study: Study, data: Measurements, reference: str, state: State | None = None) -> Fit:
    """Fit the study's model, from its nominal values."""
    model = model_of(study)
    if reference == "differences":
        return fit_differences(study, model, data, state)
    return fit(model, data, study.noise, state or start(model, data))


def _identified(found: Fit) -> int:
    """Number of identified parameters that are asked for."""
    return int((~found.model.nuisance[found.identifiability.kept]).sum())


def _compensated(data: Measurements, found: Fit, residual: Floats) -> float | None:
    """Share of the measured deflection that a residual lacks, per cent."""
    before, _ = load_changes(data.experiment, found.reading)
    after, _ = load_changes(data.experiment, residual)
    return float(100.0 * (1.0 - np.sqrt((after**2).sum() / (before**2).sum()))) if len(before) else None


def _normality(whitened: Floats) -> Normality | None:
    """Test the residuals."""
    from scipy.stats import normaltest, shapiro

    if len(whitened) < 8 or not np.ptp(whitened) > 0:
        return None
    small = len(whitened) <= _SHAPIRO_MOST
    found = shapiro(whitened) if small else normaltest(whitened)
    return Normality("Shapiro-Wilk" if small else "D'Agostino K2", float(found.statistic), float(found.pvalue))


def _crossfit(study: Study, found: Fit, reference: str, seed: int) -> CrossFit | None:
    """Judge every fold of the visits by a fit to the others."""
    data = found.data
    present = np.random.default_rng(seed).permutation(np.unique(data.experiment.row_visit))
    if len(present) < _LEAST_VISITS:
        return None
    residual, parameters = np.zeros_like(found.residual), _identified(found)
    folds = np.array_split(present, min(_FOLDS, len(present)))
    for fold in folds:
        judged = np.zeros(len(data.experiment.visits), dtype=bool)
        judged[fold] = True
        try:
            trained = _without(study, found, reference, judged)
        except NoConvergence:
            return None
        rows = rows_of_visits(data.experiment, judged)
        residual[rows] = _residual(trained, data)[rows]
        parameters = min(parameters, _identified(trained))
    misfit = misfit_of(data, residual, reference, np.arange(len(residual)))
    return CrossFit(misfit, _compensated(data, found, residual), len(folds), parameters)


def _without(study: Study, found: Fit, reference: str, judged: np.ndarray) -> Fit:
    """Fit to the other visits, with effects from their nominal values."""
    rows = rows_of_visits(found.data.experiment, ~judged)
    values = np.where(found.model.nuisance, found.state.values, found.model.nominal)
    begin = State(values, found.state.base_T_measurement, np.ones(len(rows)))
    return _fitted(study, take_rows(found.data, rows), reference, begin)


def _residual(trained: Fit, data: Measurements) -> Floats:
    """(R, 3) reading minus a fitted model, base frame, m."""
    placement = trained.state.base_T_measurement
    expected = respond(trained.model, data.experiment, trained.state.values, derivative=False).position
    residual: Floats = data.positions @ placement[:3, :3].T + placement[:3, 3] - expected
    return residual
