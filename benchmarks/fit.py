"""Identification of many readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.clock import line, timed
from identify import load_study
from identify.experiment import full_experiment
from identify.identification import identify
from identify.model import model_of
from identify.simulate import simulate

STUDIES = Path(__file__).parents[1] / "configs" / "studies"


def main() -> None:
    rng = np.random.default_rng(0)
    study = load_study(STUDIES / "kr270.toml")
    model = model_of(study)
    q = rng.uniform(study.robot.lower, study.robot.upper, (15, study.robot.n))
    experiment = full_experiment(q, np.tile([0, 1], (15, 1)), study.loads, study.markers)
    data = simulate(model, model.nominal, experiment, study.noise, np.eye(4), rng)
    _, wall, cpu = timed(lambda: identify(study, data), repeats=5)
    line("KR 270, 15 poses, 90 readings, differences", f"{wall:.3f} s wall {cpu:.3f} s CPU", "-")
    study = load_study(STUDIES / "ur10_series_a.toml")
    model = model_of(study)
    q = rng.uniform(-2.5, 2.5, (12_000, study.robot.n))
    experiment = full_experiment(q, np.zeros((12_000, 1), dtype=np.int64), study.loads, study.markers)
    data = simulate(model, model.nominal, experiment, study.noise, np.eye(4), rng)
    _, wall, cpu = timed(lambda: identify(study, data), repeats=1)
    line("UR10, 12,000 poses, geometry, held-out fit included", f"{wall:.2f} s wall {cpu:.2f} s CPU", "seconds")
