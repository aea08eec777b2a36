"""Nominal values that may be wrong: a few draws of them, on which a plan is to be good on average.

A value with a stated percentage is drawn from a lognormal distribution with this mean and standard deviation, so it
keeps its sign; one that is nominally zero from a normal distribution of its typical size. A scrambled Sobol sequence
spreads the few draws over these distributions.
"""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.effects import Parameter
from identify.errors import InputError
from identify.model import Model, model_of
from identify.problems import nearest
from identify.study import Study

__all__ = ["drawn_values"]


def drawn_values(study: Study, seed: int) -> tuple[dict[str, float], ...]:
    """Nominal values by parameter name, in result units, for each of ``plan.draws`` draws.

    Args:
        study: The study.
        seed: Of the draws.

    Raises:
        InputError: A percentage of something that is not in the model or nominally zero, or nothing is uncertain.
    """
    model = model_of(study)
    own = [parameter for parameter in model.parameters if not parameter.nuisance]
    share, typical = _spreads(study, model, own)
    if not (share.any() or typical.any()):
        raise InputError(
            f"{study.path}: [plan] draws = {study.plan.draws}: no nominal value is uncertain; state how much under "
            "[model.nominal_std_percent], by parameter name or by name of an effect"
        )
    normal = np.zeros((study.plan.draws, len(own)))
    uncertain = np.flatnonzero((share > 0.0) | (typical > 0.0))
    normal[:, uncertain] = _spread_out(study.plan.draws, len(uncertain), seed)
    nominal = np.array([parameter.nominal for parameter in own])
    log_std = np.sqrt(np.log1p(share**2))
    values = nominal * np.exp(normal * log_std - 0.5 * log_std**2) + normal * typical
    return tuple({parameter.name: float(value) for parameter, value in zip(own, row, strict=True)} for row in values)


def _spread_out(count: int, size: int, seed: int) -> Floats:
    """(count, size) standard normal points of a scrambled Sobol sequence."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    sequence = qmc.Sobol(size, scramble=True, seed=np.random.default_rng(seed))
    normal: Floats = ndtri(sequence.random_base2((count - 1).bit_length())[:count])
    return normal


def _spreads(study: Study, model: Model, own: list[Parameter]) -> tuple[Floats, Floats]:
    """(p,) relative standard deviation of values that are stated, and (p,) standard deviation of those that are zero.

    Raises:
        InputError: A percentage that does not fit the model.
    """
    share = np.zeros(len(own))
    for name, percent in study.nominal_std_percent.items():
        mine = np.array([name in {parameter.name, parameter.name.partition(".")[0]} for parameter in own])
        stated = mine & np.array([parameter.nominal != 0.0 for parameter in own])
        if not stated.any():
            names = [parameter.name for parameter in own]
            why = (
                "its nominal value is 0; state it under [model.nominal]"
                if mine.any()
                else f"the model has no such parameter or effect{nearest(name, names)}; it has {', '.join(names)}"
            )
            raise InputError(f"{study.path}: [model.nominal_std_percent] {name!r} = {percent:g}: {why}")
        share[stated] = percent / 100.0
    typical = np.array([parameter.typical for parameter in own])
    unstated = (model.nominal[~model.nuisance] == 0.0) & np.isfinite(typical)
    return share, np.where(unstated, typical, 0.0)
