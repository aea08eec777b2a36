"""The commands plan and evaluate for two arms, from files to files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from doe.accuracy import Accuracy
from doe.bounds import efficiencies
from doe.curve import Judge, accuracy_curve, fewest_shown, sizes
from doe.earlier_files import NO_FILES, EarlierFiles
from doe.evaluate import broken_visits
from doe.information import standard_deviations
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
from doe.order_report import approach_json, conditions_of, in_turn, order_json, order_lines, order_notes
from doe.schedule import time_as_given
from doe.two_arm_plan import TwoArmEvaluation, TwoArmPlan, evaluate_both, plan_for_both, relative_accuracy
from identify.arrays import Floats
from identify.commands import Outcome
from identify.errors import InputError
from identify.experiment import Experiment
from identify.tables import load_plan, plan_csv, plan_experiment
from identify.two_arm_config import load_two_arm_study
from identify.two_arm_study import TwoArmStudy

__all__ = ["run_evaluate_both", "run_plan_for_both"]


def run_plan_for_both(study_file: Path, *, seed: int, before: EarlierFiles = NO_FILES) -> Outcome:
    """Pick poses and loads of both arms for a study of two arms.

    Raises:
        InputError: The file is wrong, or something that was measured before is named.
    """
    _without_earlier(study_file, before)
    study = load_two_arm_study(study_file)
    made = plan_for_both(study, seed=seed)
    pool, arms = made.pool, made.choice.arms
    reached = relative_accuracy(study, pool.objective, made.covariance)
    counted = [len(own.q) for own in arms]
    ordered = [conditions_of(own, arm.study) for own, arm in zip(made.schedules, study.arms, strict=True)]
    compared = efficiencies(pool.objective, pool.blocks, made.choice.own, repeats=pool.observer.settings.repeats)
    content = {
        **judgement(pool.observer, pool.known, pool.objective, made.final, reached),
        "grid": bound_json(made.grid),
        "efficiencies": dict(compared.by_criterion),
        "efficiencies_candidates": compared.candidates,
        "poses": sum(counted),
        "arms": _by_arm(study, counted),
        "different_poses": sum(len(np.unique(own.q, axis=0)) for own in arms),
        "refinement": _refinement(made),
        "joint_only": None,
        "std": standard_deviations(made.information),
        **counts(*pool.candidates),
        "curve": _curve_of_plan(study, made, seed),
        "time_s": in_turn(own.time for own in made.schedules if own is not None),
        "order": {
            arm.name: None if own is None else order_json(own, visits.visits)
            for arm, own, visits in zip(study.arms, made.schedules, ordered, strict=True)
        },
        "approach_deg": _by_arm(study, [approach_json(arm.study) for arm in study.arms]),
        "notes": [*made.choice.notes, *_order_notes(study, made, ordered), *_apart(study)],
    }
    tables = {
        _plan_name(arm.name): plan_csv(visits, arm.study) for arm, visits in zip(study.arms, ordered, strict=True)
    }
    lines = [*_lines(content)]
    for arm, own in zip(study.arms, made.schedules, strict=True):
        lines += [f"{arm.name}: {line}" for line in order_lines(own)]
    return Outcome("plan", content, study.inputs, tables, tuple(lines))


def run_evaluate_both(study_file: Path, folder: Path, *, seed: int, before: EarlierFiles = NO_FILES) -> Outcome:
    """Judge the pose files of both arms, which stand in one folder.

    Raises:
        InputError: A file is wrong or missing, or something that was measured before is named.
    """
    _without_earlier(study_file, before)
    study = load_two_arm_study(study_file)
    files = _plan_files(study, folder)
    experiments = [
        plan_experiment(load_plan(file, arm.study), arm.study) for arm, file in zip(study.arms, files, strict=True)
    ]
    judged = evaluate_both(study, experiments, seed=seed)
    aim = judged.objective
    reached = relative_accuracy(study, aim, judged.covariance)
    broken = [broken_visits(arm.study, own) for arm, own in zip(study.arms, experiments, strict=True)]
    confused = [confusability_json(arm.study, own) for arm, own in zip(study.arms, experiments, strict=True)]
    content = {
        **judgement(judged.observer, judged.known, aim, judged.bound, reached),
        "grid": None,
        "poses": sum(judged.visits),
        "arms": _by_arm(study, judged.visits),
        "different_poses": sum(len(np.unique(own.q, axis=0)) for own in experiments),
        "test_poses": errors_at_test_poses(reached),
        "criteria": criteria(aim, judged.information),
        "weakest": weakest(judged.observer, judged.known, aim, judged.covariance),
        "std": standard_deviations(judged.information),
        **counts(*judged.candidates),
        "curve": _curve_of_poses(study, judged, seed),
        "confusability": _by_arm(study, confused),
        "time_s": in_turn(time_as_given(arm.study, e) for arm, e in zip(study.arms, experiments, strict=True)),
        "visits_rejected": _by_arm(study, broken),
        "notes": [
            *(f"{arm.name}: {note}" for arm, own in zip(study.arms, broken, strict=True) for note in broken_notes(own)),
            *_apart(study),
        ],
    }
    lines = list(_lines(content))
    for arm, found in zip(study.arms, confused, strict=True):
        lines += [f"{arm.name}: {line}" for line in confusability_lines(found)]
    return Outcome("evaluate", content, (*study.inputs, *files), {}, tuple(lines))


def _without_earlier(study_file: Path, before: EarlierFiles) -> None:
    """Refuse what was measured before.

    Raises:
        InputError: Something is named.
    """
    if before != NO_FILES:
        raise InputError(
            f"{study_file}: --measured, --result, --earlier and --unreachable belong to a study of one arm; this one "
            "has [[arms]]. Take the study of the arm that is measured, which stands under [[arms]] study"
        )


def _apart(study: TwoArmStudy) -> list[str]:
    """What was looked at between the arms."""
    first, second = study.arms
    told = []
    for arm, other in ((first, second), (second, first)):
        if arm.study.neighbour is None:
            told.append(
                f"collisions of {arm.name} with {other.name} are not checked: keep {other.name} out of the way, "
                f"unloaded and still, and state where it stands ([constraints] home_deg of {other.study.path.name})"
            )
        else:
            told.append(
                f"{arm.name} is checked against {other.name} at the home pose of {other.study.path.name}, unloaded: "
                "keep it there"
            )
    return told


def _by_arm(study: TwoArmStudy, values: Any) -> dict[str, Any]:
    """One value for each arm, by its name."""
    return {arm.name: value for arm, value in zip(study.arms, values, strict=True)}


def _order_notes(study: TwoArmStudy, made: TwoArmPlan, ordered: Sequence[Experiment]) -> list[str]:
    """Moves of each arm that must not be driven straight."""
    return [
        f"{arm.name}: {note}"
        for arm, own, visits in zip(study.arms, made.schedules, ordered, strict=True)
        for note in order_notes(own, visits.visits)
    ]


def _plan_name(arm: str) -> str:
    """Name of the plan file of one arm."""
    return f"plan_{arm}.csv"


def _plan_files(study: TwoArmStudy, folder: Path) -> tuple[Path, ...]:
    """The plan files of both arms.

    Raises:
        InputError: There is no such folder, or a file is missing in it.
    """
    names = [_plan_name(arm.name) for arm in study.arms]
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is no folder; a study of two arms is judged with a plan of each, so name the folder that holds "
            f"{' and '.join(names)}"
        )
    for name in names:
        if not (folder / name).is_file():
            raise InputError(f"{folder}: {name} is missing; the folder must hold {' and '.join(names)}")
    return tuple(folder / name for name in names)


def _lines(content: dict[str, Any]) -> tuple[str, ...]:
    """The summary, with the visits of each arm in front."""
    shares = ", ".join(f"{number} of {name}" for name, number in content["arms"].items())
    lines = judgement_lines(content, content["poses"])
    return (f"experiments by arm: {shares}", *lines, *curve_lines(content["curve"]))


def _curve_of_plan(study: TwoArmStudy, made: TwoArmPlan, seed: int) -> list[dict[str, Any]]:
    """The curve around the size of a plan; empty without tasks or where the study does not want it."""
    aim, count = made.pool.objective, len(made.choice.grid)
    if aim.rows is None or not study.plan.curve:
        return []
    counts = sizes(2 * count, first=fewest_shown(made.pool), also=count)
    guard = made.choice.guard
    return curve_json(
        accuracy_curve(aim, study.plan, _judge(study, aim), counts, seed, pool=made.pool, guard=guard), given=False
    )


def _curve_of_poses(study: TwoArmStudy, judged: TwoArmEvaluation, seed: int) -> list[dict[str, Any]]:
    """Random and designed plans of at most as many visits; the visits of two files have no common order."""
    aim, count = judged.objective, sum(judged.visits)
    if aim.rows is None or not study.plan.curve:
        return []
    return curve_json(
        accuracy_curve(aim, study.plan, _judge(study, aim), sizes(count), seed, pool=judged.pool), given=False
    )


def _judge(study: TwoArmStudy, aim: Objective) -> Judge:
    """``(p, p) covariance -> accuracy`` at the tasks, which the objective has."""

    def judge(covariance: Floats) -> Accuracy:
        found = relative_accuracy(study, aim, covariance)
        assert found is not None, "an objective without tasks"
        return found

    return judge


def _refinement(made: TwoArmPlan) -> dict[str, Any] | None:
    """What moving the joint angles off the grid gained, in all turns together."""
    done = made.choice.refinements
    if not done:
        return None
    return {
        "gained_percent": 100.0 * (1.0 - made.final.value / made.grid.value),
        "iterations": sum(refinement.iterations for refinement in done),
        "status": ", ".join(refinement.status for refinement in done),
    }
