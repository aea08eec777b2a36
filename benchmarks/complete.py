"""The complete stiffness model: blocks, reduction, and identification of many readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.clock import line, peak_mb, timed
from doe.candidates import candidates
from doe.observations import identifiable, observer
from identify import load_study
from identify.compare import compare
from identify.experiment import full_experiment
from identify.identification import identify
from identify.model import model_of
from identify.reduction import reduce
from identify.simulate import simulate
from identify.tables import load_plan, plan_experiment

STUDY = Path(__file__).parents[1] / "configs" / "studies" / "kr270_complete.toml"
LEVELS = [-100.0, -75.0, -50.0, -25.0, -5.0]


def main() -> None:
    study = load_study(STUDY)
    drawn = candidates(study, seed=0)
    watching = observer(study)
    blocks, wall, cpu = timed(lambda: watching.blocks(drawn.visit_q, drawn.visit_loads))
    what = f"blocks {blocks.shape}, rank {identifiable(blocks).rank}"
    line(what, f"{wall:.2f} s wall {cpu:.2f} s CPU", "under 1 s")
    _, wall, cpu = timed(lambda: reduce(study, configurations=80))
    line("reduction of 258 parameters, 80 configurations", f"{wall:.2f} s wall {cpu:.2f} s CPU", "under 0.5 s")
    twin()
    many()


def twin() -> None:
    """Five models on the twin's 15 poses, held-out fits included."""
    study = load_study(STUDY.with_name("kr270_compare.toml"))
    poses = plan_experiment(load_plan(STUDY.with_name("kr270_compare_poses.csv"), study), study)
    model = model_of(study)
    data = simulate(model, model.nominal, poses, study.noise, np.eye(4), np.random.default_rng(0))
    _, wall, cpu = timed(lambda: compare(study, data, "differences"))
    line("comparison of models, 15 poses, with 5-fold fits", f"{wall:.2f} s wall {cpu:.2f} s CPU", "under 1 s")


def many() -> None:
    """100,000 readings, complete model with levels of joint 2: 30 parameters."""
    study = load_study(STUDY)
    options = {**study.options, "gravity_compensator": {"levels_deg": LEVELS}}
    study = replace(study, effects=(*study.effects, "gravity_compensator@j2"), options=options)
    visits, rng = 16_667, np.random.default_rng(0)
    q = rng.uniform(study.robot.lower, study.robot.upper, (visits, study.robot.n))
    q[:, 1] = np.radians(rng.choice(LEVELS, visits))
    experiment = full_experiment(q, np.tile([0, 1], (visits, 1)), study.loads, study.markers)
    model = model_of(study)
    data = simulate(model, model.nominal, experiment, study.noise, np.eye(4), rng)
    found, wall, cpu = timed(lambda: identify(study, data), repeats=1)
    what = f"{len(data.positions)} readings, {found.fit.identifiability.rank} parameters, held-out fit included"
    line(what, f"{wall:.1f} s wall {cpu:.1f} s CPU", "under 3 s")
    line("peak memory of this process", f"{peak_mb():.0f} MB", "under 1 GB")


if __name__ == "__main__":
    main()
