"""The commands of this package, from files to files: plan, evaluate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from doe.accuracy import Accuracy, accuracy
from doe.bounds import Bound
from doe.candidates import Candidates
from doe.confusability import SHOWN, confusability
from doe.evaluate import evaluate
from doe.joint_only import joint_only
from doe.objective import Objective
from doe.observations import Observer
from doe.plan import Plan, plan
from identify.arrays import Floats
from identify.commands import Outcome
from identify.config import load_study
from identify.diagnosis.library import Hypothesis
from identify.effects.base import Parameter
from identify.error_radius import radius
from identify.experiment import Experiment, full_experiment
from identify.identifiability import Identifiability, why_not
from identify.study import Study
from identify.tables import load_plan, plan_csv, plan_experiment

__all__ = ["run_evaluate", "run_plan"]

_CONFIDENCE = 0.95
_SHOWN_NAMES = 6
_UNIT = {"test_pose": "mm^2", "G": "mm^2"}


def run_plan(study_file: Path, *, seed: int) -> Outcome:
    """Pick poses and loads for a study file."""
    study = load_study(study_file)
    made = plan(study, seed=seed)
    reached = _accuracy(study, made.pool.objective, made.covariance)
    simple = joint_only(made, seed=seed)
    content = {
        **_judgement(made.pool.observer, made.pool.known, made.pool.objective, made.final, reached),
        "grid": _bound(made.grid),
        "poses": len(made.q),
        "different_poses": len(np.unique(made.q, axis=0)),
        "refinement": _refinement(made),
        "joint_only": None if simple is None else {"value": simple.value, "times": simple.times, "rank": simple.rank},
        "std": _std(made.covariance),
        **_counts(made.pool.candidates),
        "time_s": None,
        "notes": list(made.notes),
    }
    experiment = full_experiment(made.q, made.visit_loads, study.loads, study.markers)
    tables = {"plan.csv": plan_csv(experiment, study)}
    return Outcome("plan", content, study.inputs, tables, _lines(content, len(made.q)))


def run_evaluate(study_file: Path, plan_file: Path, *, seed: int) -> Outcome:
    """Judge a pose file."""
    study = load_study(study_file)
    experiment = plan_experiment(load_plan(plan_file, study), study)
    judged = evaluate(study, experiment, seed=seed)
    aim = judged.objective
    reached = _accuracy(study, aim, judged.covariance)
    content = {
        **_judgement(judged.observer, judged.known, aim, judged.bound, reached),
        "grid": None,
        "poses": judged.visits,
        "different_poses": len(np.unique(experiment.q, axis=0)),
        "test_poses": _test_poses(reached),
        "criteria": {
            name: aim.value(judged.information, name) if name not in _UNIT or aim.rows is not None else None
            for name in ("test_pose", "A", "D", "E", "G")
        },
        "weakest": _weakest(judged.observer, judged.known, aim, judged.covariance),
        "std": _std(judged.covariance),
        **_counts(judged.candidates),
        "confusability": _confusability(study, experiment),
        "time_s": None,
        "notes": [],
    }
    lines = (*_lines(content, judged.visits), *_confusability_lines(content["confusability"]))
    return Outcome("evaluate", content, (*study.inputs, plan_file), {}, lines)


def _confusability(study: Study, experiment: Experiment) -> dict[str, Any]:
    """Every cause that the model does not hold: would it show, and what would it be confused with?"""
    reference, causes = confusability(study, experiment)
    return {
        "reference": reference,
        "shown_at": SHOWN,
        "causes": [
            {
                "name": cause.hypothesis.name,
                "where": cause.hypothesis.where,
                "energy": cause.energy,
                "closest": cause.rival,
                "cosine": cause.cosine,
                "energy_beside_closest": cause.beside_rival,
                "parameters": [
                    {"name": p.name, "unit": p.unit, "typical": typical, "detectable": size}
                    for p, typical, size in zip(_own(cause.hypothesis), cause.typical, cause.detectable, strict=True)
                ],
            }
            for cause in causes
        ],
    }


def _own(hypothesis: Hypothesis) -> list[Parameter]:
    """The parameters of a cause at its place."""
    return [hypothesis.effect.parameters[index] for index in hypothesis.own]


def _confusability_lines(found: dict[str, Any]) -> list[str]:
    """What a diagnosis of this plan would miss or mix up, at typical sizes."""
    entries = {id(c): c["name"] + ("" if c["where"] is None else f"@{c['where']}") for c in found["causes"]}
    seen = {c["name"] for c in found["causes"] if c["energy"] >= found["shown_at"]}
    unseen = sorted({c["name"] for c in found["causes"]} - seen)
    mixed = [c for c in found["causes"] if c["energy"] >= found["shown_at"] > c["energy_beside_closest"]]
    lines = []
    if unseen:
        lines.append(f"would show nowhere at their typical sizes: {_some(unseen)}")
    if mixed:
        pairs = dict.fromkeys(" / ".join(sorted((entries[id(c)], c["closest"]))) for c in mixed)
        lines.append(f"could not be told apart: {_some(list(pairs))}")
    return lines


def _some(names: list[str]) -> str:
    """The first names of a list and how many more there are."""
    more = f" and {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    return ", ".join(names[:_SHOWN_NAMES]) + more


def _accuracy(study: Study, aim: Objective, covariance: Floats) -> Accuracy | None:
    return None if aim.rows is None else accuracy(study, aim.rows, covariance)


def _judgement(
    observer: Observer, known: Identifiability, aim: Objective, bound: Bound, reached: Accuracy | None
) -> dict[str, Any]:
    """What plan.json and evaluate.json have in common."""
    model = observer.model
    return {
        "criterion": {
            "name": aim.criterion,
            "value": bound.value,
            "unit": _UNIT.get(aim.criterion, "units of the parameters"),
            "rms_mm": None if reached is None else reached.rms,
            "rms_total_mm": None if reached is None else reached.rms_total,
        },
        "bound": bound.bound,
        "efficiency": bound.efficiency,
        "efficiency_continuous": None,
        "reference": observer.reference,
        "rank": known.rank,
        "parameters": [model.names[index] for index in known.kept],
        "units": [model.parameters[index].unit for index in known.kept],
        "nonidentifiable": [model.names[dropped.column] for dropped in known.dropped],
        "why_nonidentifiable": {model.names[dropped.column]: why_not(model, dropped) for dropped in known.dropped},
    }


def _bound(bound: Bound) -> dict[str, float]:
    return {"value": bound.value, "bound": bound.bound, "efficiency": bound.efficiency}


def _refinement(made: Plan) -> dict[str, Any] | None:
    """What moving the joint angles off the grid gained."""
    if made.refinement is None:
        return None
    gained = 100.0 * (1.0 - made.final.value / made.grid.value)
    return {"gained_percent": gained, "iterations": made.refinement.iterations, "status": made.refinement.status}


def _std(covariance: Floats) -> Floats:
    """Standard deviations in the order of ``parameters``, in their units."""
    deviation: Floats = np.sqrt(np.diag(covariance))
    return deviation


def _counts(chosen: Candidates | None) -> dict[str, Any]:
    if chosen is None:
        return {"candidates": 0, "rejected": {}}
    return {"candidates": len(chosen.pose), "rejected": dict(chosen.rejected)}


def _test_poses(reached: Accuracy | None) -> list[dict[str, float]]:
    """Error at each test pose: rms and the radius of 95 %, parameters only and with pose jitter, mm."""
    if reached is None:
        return []
    return [
        {
            "rms_mm": float(np.sqrt(np.trace(own))),
            "ci95": radius(own, _CONFIDENCE),
            "rms_total_mm": float(np.sqrt(np.trace(own + jitter))),
            "ci95_total": radius(own + jitter, _CONFIDENCE),
        }
        for own, jitter in zip(reached.covariance, reached.jitter, strict=True)
    ]


def _weakest(observer: Observer, known: Identifiability, aim: Objective, covariance: Floats) -> dict[str, Any]:
    """The parameter that costs most: by its share of the mean square at the test poses, else by its std."""
    if aim.rows is None:
        share = np.diag(covariance) / np.trace(covariance)
    else:
        target = aim.target("test_pose")
        share = np.einsum("rp,pq,rq->p", target, covariance, target)
        share = share / share.sum()
    worst = int(np.argmax(share))
    parameter = observer.model.parameters[known.kept[worst]]
    return {
        "parameter": parameter.name,
        "std": float(np.sqrt(covariance[worst, worst])),
        "unit": parameter.unit,
        "share_of_criterion": float(share[worst]),
    }


def _lines(content: dict[str, Any], count: int) -> tuple[str, ...]:
    criterion = content["criterion"]
    lines = [
        f"{count} experiments at {content['different_poses']} different poses, {content['rank']} parameters, "
        f"reference {content['reference']}"
    ]
    if criterion["rms_mm"] is not None:
        lines.append(
            f"expected error at the test poses: {criterion['rms_mm']:.4f} mm rms "
            f"({criterion['rms_total_mm']:.4f} mm with the robot's repeatability)"
        )
    lines.append(f"criterion {criterion['name']} = {criterion['value']:.5g} {criterion['unit']}")
    lines.append(
        f"proven: no {count} of these poses and the {content['candidates']} candidates reach less than "
        f"{content['bound']:.5g}, so the efficiency is at least {100 * content['efficiency']:.2f} %"
    )
    if content["grid"] is not None:
        lines.append(
            f"before refinement: {content['grid']['value']:.5g}, on the candidates alone at least "
            f"{100 * content['grid']['efficiency']:.2f} % efficient"
        )
    if content.get("refinement") is not None:
        lines.append(f"refining the joint angles gained {content['refinement']['gained_percent']:.1f} %")
    simple = content.get("joint_only")
    if simple is not None:
        missed = content["rank"] - simple["rank"]
        worth = (
            f"would not show {missed} of the {content['rank']} parameters"
            if missed
            else f"is {simple['times']:.3g} times worse"
        )
        lines.append(f"a plan made for joint compliances alone {worth}")
    lines += [f"not identifiable: {name}: {why}" for name, why in content["why_nonidentifiable"].items()]
    rejected = ", ".join(f"{reason} {number}" for reason, number in content["rejected"].items() if number)
    if rejected:
        lines.append(f"poses rejected: {rejected}")
    return (*lines, *(f"note: {note}" for note in content["notes"]))
