"""Studies, readings and fits that the tests of the diagnosis share: a heavy arm of known masses under two loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from identify.arrays import Floats
from identify.diagnosis.evidence import Evidence, evidence
from identify.diagnosis.gates import LEVELS, Gate, family_probabilities
from identify.diagnosis.library import Hypothesis, Tried, hypotheses, tried
from identify.diagnosis.search import fitted, with_noise_found
from identify.experiment import Experiment, Measurements
from identify.fit import Fit
from identify.study import Noise, Study
from tests.identify.studies import COMPLIANCE, NOISE, experiment_of, kr270_study, poses, readings

STEP_S = 120.0  # from visit to visit


def arm(**changes: Any) -> Study:
    """The heavy arm; absolute readings, instrument in the base frame unless changed."""
    return kr270_study(**{"reference": "absolute", **changes})


def conditions(study: Study, count: int, seed: int, **fixed: float) -> Experiment:
    """Random poses under all loads; some joints at one angle."""
    q = poses(study, count, np.random.default_rng(seed))
    for name, value in fixed.items():
        q[:, int(name[1:]) - 1] = value
    return experiment_of(study, q)


def recorded(experiment: Experiment, seed: int = 0) -> Experiment:
    """The same with times, temperatures that go up and down, and random directions of approach."""
    rng, shape = np.random.default_rng(seed), (len(experiment.visits), experiment.q.shape[1])
    visit = experiment.row_visit
    return replace(
        experiment,
        time=STEP_S * visit,
        temperature=22.0 + 4.0 * np.sin(2.4 * visit),
        approach=rng.choice([-1.0, 1.0], size=shape),
    )


def with_wrench(experiment: Experiment) -> Experiment:
    """The same with the forces of the loads as measured by a sensor in the flange."""
    from identify.kinematics import forward
    from tests.identify.studies import kr270

    turn = forward(kr270(), experiment.q).flange_rotation[experiment.shot_pose]
    mass = np.array([load.mass for load in experiment.loads])[experiment.shot_load]
    force = np.einsum("sji,j->si", turn, [0.0, 0.0, -9.81]) * mass[:, None]
    return replace(experiment, wrench=np.hstack([force, np.zeros_like(force)]))


def read(
    study: Study,
    experiment: Experiment,
    seed: int,
    hidden: Mapping[str, float] = {},
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    noise: Noise | None = None,
) -> Measurements:
    """Readings of an arm with hidden effects, named by their parameters; the noise is that of the study or another.

    Args:
        study: The study, which does not know the effects.
        experiment: The conditions.
        seed: Seed of the noise.
        hidden: Sizes by parameter: ``geometry.j3.offset``.
        options: Options of hidden effects.
        noise: The true noise.
    """
    entries = dict.fromkeys(entry_of(name) for name in hidden)
    truth = replace(study, effects=(*study.effects, *entries), options={**study.options, **(options or {})})
    values = {**COMPLIANCE, **hidden}
    return readings(truth, experiment, values, np.random.default_rng(seed), noise=noise, placement=np.eye(4))


def entry_of(parameter: str) -> str:
    """The entry of an effect that brings a parameter; effects without places stand alone."""
    name, place = parameter.split(".")[:2]
    alone = {"load_com", "load_scale", "load_direction", "force_sensor_bias"}
    return name if name in alone else f"{name}@{place}"


def fit_of(study: Study, data: Measurements) -> Fit:
    """The fit in which all rows count alike."""
    return fitted(study, data, differences=study.reference == "differences")


def library(study: Study, found: Fit, **options: Any) -> tuple[Hypothesis, ...]:
    """All hypotheses beside a fit."""
    return hypotheses(study, found.model, found, **options)


def block(columns: Floats, plausible: float = np.inf) -> SimpleNamespace:
    """Any columns (R, 3, b) as a block."""
    return SimpleNamespace(columns=columns, plausible=np.full(columns.shape[2], plausible))


def whitened_columns(found: Fit) -> Floats:
    """(K, r) columns of the model that were fitted."""
    return found.columns[:, found.identifiability.kept]


def rest_of(right: Floats, columns: Floats) -> Floats:
    """What plain least squares leaves."""
    if not columns.shape[1]:
        return right
    unit = columns / np.linalg.norm(columns, axis=0)
    return right - unit @ np.linalg.lstsq(unit, right, rcond=1e-11)[0]


def entries(causes: Any) -> list[str]:
    """The entries of causes or hypotheses, in their order."""
    return [getattr(cause, "hypothesis", cause).entry for cause in causes]


class Trials:
    """False names in many draws of readings that the model explains; the columns are computed once."""

    def __init__(self, study: Study, experiment: Experiment) -> None:
        """Prepare the blocks beside a fit to readings without a hidden effect."""
        self.study, self.experiment = study, experiment
        found = fit_of(study, read(study, experiment, 0))
        self.blocks: tuple[Tried, ...] = tried(found, library(study, found))

    def seen(self, seed: int, gate: Gate, noise: Noise | None = None, spoil: Any = None) -> Evidence:
        """The evidence of one draw: with the stated noise for Holm's rule, with the noise as found for flips."""
        data = read(self.study, self.experiment, seed, noise=noise)
        if spoil is not None:
            data = replace(data, positions=spoil(data, np.random.default_rng(10_000 + seed)))
        _, found = with_noise_found(self.study, fit_of(self.study, data), gate)
        return evidence(found, self.blocks)

    def named(self, seen: Evidence, gate: Gate, seed: int = 0) -> bool:
        """True if any block is significant."""
        every = np.ones(len(self.blocks), dtype=bool)
        found = family_probabilities(seen, gate, np.random.default_rng(seed), every)
        return bool((found < LEVELS[gate]).any())


__all__ = [
    "COMPLIANCE", "NOISE", "STEP_S", "Trials", "arm", "block", "conditions", "entries", "fit_of", "library", "read",
    "recorded", "rest_of", "whitened_columns", "with_wrench",
]  # fmt: skip
