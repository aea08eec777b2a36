"""The commands of this package, from files to files: plan, evaluate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from doe.accuracy import Accuracy, accuracy
from doe.curve import accuracy_curve, fewest_shown, sizes
from doe.design_choices import choice_lines, decide
from doe.earlier import Earlier
from doe.earlier_files import NO_FILES, EarlierFiles, load_earlier
from doe.evaluate import evaluate
from doe.executor import HERE, Executor
from doe.information import covariance_of, standard_deviations
from doe.joint_only import joint_only
from doe.judgement import (
    bound_json,
    broken_notes,
    confusability_json,
    confusability_lines,
    counts,
    criteria,
    curve_json,
    curve_lines,
    errors_at_test_poses,
    judgement,
    judgement_lines,
    weakest,
)
from doe.objective import Objective
from doe.order_report import (
    approach_json,
    budget_json,
    budget_lines,
    conditions_of,
    order_json,
    order_lines,
    order_notes,
)
from doe.plan import Plan, plan
from doe.planned_study import planned_toml, setting_lines, settings_json, used_settings
from doe.regions import poses_in
from doe.schedule import time_as_given
from doe.study_notes import study_notes, work_notes
from identify.arrays import Floats
from identify.commands import Outcome
from identify.config import load_study
from identify.study import Study
from identify.tables import load_plan, plan_csv, plan_experiment

__all__ = ["PLANNED", "run_evaluate", "run_plan"]

PLANNED = "planned.toml"  # the study with everything chosen


def run_plan(
    study_file: Path, *, seed: int, out: Path, before: EarlierFiles = NO_FILES, executor: Executor = HERE
) -> Outcome:
    """Pick poses and loads for a study file, beside what was measured before.

    Args:
        study_file: The study.
        seed: Seed of candidates and search.
        out: The folder that the results will stand in.
        before: What was measured, fitted or tried before.
        executor: Who does independent pieces of work.
    """
    study, earlier, told = load_earlier(load_study(study_file), before)
    made = plan(study, seed=seed, earlier=earlier, executor=executor)
    study = made.pool.observer.study  # station, markers and loads are chosen
    used, left_open = used_settings(made), made.decision is not None or bool(study.load_ranges)
    reached = _accuracy(study, made.pool.objective, made.covariance)
    simple = joint_only(made, seed=seed)
    experiment = conditions_of(made.schedule, study, earlier.names)
    content = {
        **judgement(made.pool.observer, made.pool.known, made.pool.objective, made.final, reached),
        "grid": bound_json(made.grid),
        "efficiencies": None if made.compared is None else dict(made.compared.by_criterion),
        "efficiencies_candidates": None if made.compared is None else made.compared.candidates,
        "poses": len(made.q),
        "different_poses": len(np.unique(made.q, axis=0)),
        "refinement": _refinement(made),
        "joint_only": None if simple is None else {"value": simple.value, "times": simple.times, "rank": simple.rank},
        "std": standard_deviations(made.information),
        **counts(made.pool.candidates),
        "choices": None if made.decision is None else made.decision.as_json,
        "load_settings": settings_json(used) if study.load_ranges else None,
        "chosen_study": PLANNED if left_open else None,
        "curve": _curve_of_plan(study, made, seed),
        "robust": _robust(study, made, experiment.visits),
        "measured": _measured(study, made.pool.objective, earlier, made.pool.prior),
        "unreachable": list(before.unreachable),
        "time_s": None if made.schedule is None else made.schedule.time,
        "order": None if made.schedule is None else order_json(made.schedule, experiment.visits),
        "references": "own_visits" if made.pool.observer.own_visits else "same_visit",
        "approach_deg": approach_json(study),
        "budget": budget_json(made),
        "notes": [
            *told,
            *study_notes(study),
            *work_notes(reached),
            *made.notes,
            *order_notes(made.schedule, experiment.visits),
        ],
    }
    tables = {"plan.csv": plan_csv(experiment, study)}
    lines = (*judgement_lines(content, len(made.q)), *order_lines(made.schedule), *budget_lines(made),
             *curve_lines(content["curve"]))  # fmt: skip
    if left_open:
        best = None if made.decision is None else made.decision.best
        tables[PLANNED] = planned_toml(study_file, out, best, used)
        chosen = () if made.decision is None else choice_lines(made.decision)
        lines = (*chosen, *setting_lines(used), *lines)
    return Outcome("plan", content, (*study.inputs, *before.paths), tables, lines)


def run_evaluate(
    study_file: Path, plan_file: Path, *, seed: int, before: EarlierFiles = NO_FILES, executor: Executor = HERE
) -> Outcome:
    """Judge a pose file, beside what was measured before.

    Args:
        study_file: The study.
        plan_file: The poses.
        seed: Seed of the candidates that they are compared with.
        before: What was measured or fitted before.
        executor: Who does independent pieces of work.
    """
    study, earlier, told = load_earlier(load_study(study_file), before)
    study, decision = decide(study, seed=seed, executor=executor)
    experiment = plan_experiment(load_plan(plan_file, study), study)
    judged = evaluate(study, experiment, seed=seed, earlier=earlier, executor=executor)
    stated, study = study, judged.observer.study
    aim = judged.objective
    reached = _accuracy(study, aim, judged.covariance)
    content = {
        **judgement(judged.observer, judged.known, aim, judged.bound, reached),
        "grid": None,
        "poses": judged.visits,
        "different_poses": len(np.unique(experiment.q, axis=0)),
        "test_poses": errors_at_test_poses(reached)[: len(stated.test_poses)],
        "test_regions": _regions(stated, reached),
        "criteria": criteria(aim, judged.information),
        "weakest": weakest(judged.observer, judged.known, aim, judged.covariance),
        "std": standard_deviations(judged.information),
        **counts(None if judged.pool is None else judged.pool.candidates),
        "visits_rejected": dict(judged.broken),
        "choices": None if decision is None else decision.as_json,
        "curve": _curve(study, aim, sizes(judged.visits), seed, pool=judged.pool, own=judged.own, prior=judged.prior),
        "confusability": confusability_json(study, experiment),
        "measured": _measured(study, aim, earlier, judged.prior),
        "time_s": time_as_given(study, experiment),
        "notes": [*told, *study_notes(stated), *work_notes(reached), *broken_notes(judged.broken)],
    }
    lines = (
        *judgement_lines(content, judged.visits),
        *curve_lines(content["curve"]),
        *confusability_lines(content["confusability"]),
    )
    return Outcome("evaluate", content, (*study.inputs, plan_file, *before.paths), {}, lines)


def _regions(stated: Study, reached: Accuracy | None) -> list[dict[str, Any]]:
    """Error over each test region: rms, and at its worst point."""
    errors, found, start = errors_at_test_poses(reached), [], len(stated.test_poses)
    for region in range(len(stated.test_regions)):
        own = errors[start : start + len(poses_in(stated, region))]
        start += len(own)
        found.append({
            "points": len(own),
            **{key: float(np.sqrt(np.mean([each[key] ** 2 for each in own]))) for key in ("rms_mm", "rms_total_mm")},
            **{f"max_{key}": max(each[key] for each in own) for key in ("rms_mm", "ci95", "ci95_total")},
        })
    return found


def _robust(study: Study, made: Plan, names: tuple[str, ...]) -> dict[str, Any] | None:
    """What the plan is worth after losses and at other nominal values; None if not asked for."""
    found, aim = made.robust, made.pool.objective
    if found is None:
        return None
    left = [] if aim.rows is None else [accuracy(study, aim.rows, covariance_of(one)) for one in found.left]
    return {
        "losses": found.losses,
        "draws": found.draws,
        **bound_json(found.reached),
        "worst_loss": [names[visit] for visit in found.lost],
        "rms_mm": max((each.rms for each in left), default=None),
        "rms_total_mm": max((each.rms_total for each in left), default=None),
        "radius_mm": max((each.radius(study.plan.confidence) for each in left), default=None),
    }


def _measured(study: Study, aim: Objective, earlier: Earlier, prior: Floats | None) -> dict[str, Any] | None:
    """What the measured visits alone reach; None without any."""
    if earlier.measured is None or prior is None:
        return None
    value = aim.value(prior)
    reached = _accuracy(study, aim, covariance_of(prior)) if np.isfinite(value) else None
    return {
        "visits": len(np.unique(earlier.measured.row_visit)),
        "value": value,
        "rms_mm": None if reached is None else reached.rms,
        "rms_total_mm": None if reached is None else reached.rms_total,
    }


def _curve_of_plan(study: Study, made: Plan, seed: int) -> list[dict[str, Any]]:
    """The curve around the size of a plan."""
    count = len(made.q)
    shown = sizes(2 * count, first=fewest_shown(made.pool), also=count)
    return _curve(study, made.pool.objective, shown, seed, pool=made.pool, guard=made.guard)


def _curve(study: Study, aim: Objective, shown: list[int], seed: int, **of: Any) -> list[dict[str, Any]]:
    """The curve at some sizes; empty without test poses or where the study does not want it.

    ``of`` are the candidates, the guard of a plan, the visits of a pose file and what was measured, as `accuracy_curve`
    takes them.
    """
    if aim.rows is None or not study.plan.curve:
        return []
    curve = accuracy_curve(aim, study.plan, partial(accuracy, study, aim.rows), shown, seed, **of)
    return curve_json(curve, given="own" in of)


def _accuracy(study: Study, aim: Objective, covariance: Floats) -> Accuracy | None:
    return None if aim.rows is None else accuracy(study, aim.rows, covariance)


def _refinement(made: Plan) -> dict[str, Any] | None:
    """What moving the joint angles off the grid gained."""
    if made.refinement is None:
        return None
    gained = 100.0 * (1.0 - made.final.value / made.grid.value)
    return {"gained_percent": gained, "iterations": made.refinement.iterations, "status": made.refinement.status}
