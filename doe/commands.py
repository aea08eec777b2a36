"""The commands of this package, from files to files: plan, evaluate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from doe.accuracy import Accuracy, accuracy
from doe.evaluate import evaluate
from doe.information import standard_deviations
from doe.joint_only import joint_only
from doe.judgement import (
    bound_json,
    confusability_json,
    confusability_lines,
    counts,
    criteria,
    errors_at_test_poses,
    judgement,
    judgement_lines,
    weakest,
)
from doe.objective import Objective
from doe.order_report import approach_json, budget_json, budget_lines, order_json, order_lines
from doe.plan import Plan, plan
from doe.schedule import time_as_given
from identify.arrays import Floats
from identify.commands import Outcome
from identify.config import load_study
from identify.study import Study
from identify.tables import load_plan, plan_csv, plan_experiment

__all__ = ["run_evaluate", "run_plan"]


def run_plan(study_file: Path, *, seed: int) -> Outcome:
    """Pick poses and loads for a study file."""
    study = load_study(study_file)
    made = plan(study, seed=seed)
    reached = _accuracy(study, made.pool.objective, made.covariance)
    simple = joint_only(made, seed=seed)
    content = {
        **judgement(made.pool.observer, made.pool.known, made.pool.objective, made.final, reached),
        "grid": bound_json(made.grid),
        "poses": len(made.q),
        "different_poses": len(np.unique(made.q, axis=0)),
        "refinement": _refinement(made),
        "joint_only": None if simple is None else {"value": simple.value, "times": simple.times, "rank": simple.rank},
        "std": standard_deviations(made.information),
        **counts(made.pool.candidates),
        "time_s": made.schedule.time,
        "order": order_json(made.schedule),
        "references": "own_visits" if made.pool.observer.own_visits else "same_visit",
        "approach_deg": approach_json(study),
        "budget": budget_json(made),
        "notes": list(made.notes),
    }
    tables = {"plan.csv": plan_csv(made.schedule.conditions(study), study)}
    lines = (*judgement_lines(content, len(made.q)), *order_lines(made.schedule), *budget_lines(made))
    return Outcome("plan", content, study.inputs, tables, lines)


def run_evaluate(study_file: Path, plan_file: Path, *, seed: int) -> Outcome:
    """Judge a pose file."""
    study = load_study(study_file)
    experiment = plan_experiment(load_plan(plan_file, study), study)
    judged = evaluate(study, experiment, seed=seed)
    aim = judged.objective
    reached = _accuracy(study, aim, judged.covariance)
    content = {
        **judgement(judged.observer, judged.known, aim, judged.bound, reached),
        "grid": None,
        "poses": judged.visits,
        "different_poses": len(np.unique(experiment.q, axis=0)),
        "test_poses": errors_at_test_poses(reached),
        "criteria": criteria(aim, judged.information),
        "weakest": weakest(judged.observer, judged.known, aim, judged.covariance),
        "std": standard_deviations(judged.information),
        **counts(judged.candidates),
        "confusability": confusability_json(study, experiment),
        "time_s": time_as_given(study, experiment),
        "notes": [],
    }
    lines = (*judgement_lines(content, judged.visits), *confusability_lines(content["confusability"]))
    return Outcome("evaluate", content, (*study.inputs, plan_file), {}, lines)


def _accuracy(study: Study, aim: Objective, covariance: Floats) -> Accuracy | None:
    return None if aim.rows is None else accuracy(study, aim.rows, covariance)


def _refinement(made: Plan) -> dict[str, Any] | None:
    """What moving the joint angles off the grid gained."""
    if made.refinement is None:
        return None
    gained = 100.0 * (1.0 - made.final.value / made.grid.value)
    return {"gained_percent": gained, "iterations": made.refinement.iterations, "status": made.refinement.status}
