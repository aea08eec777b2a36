"""What plan.json and evaluate.json have in common, for one arm and for two, and the same in words."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from doe.accuracy import Accuracy
from doe.bounds import Bound
from doe.candidates import Candidates
from doe.confusability import SHOWN, confusability
from doe.objective import Objective
from doe.subject import Subject
from identify.arrays import Floats
from identify.diagnosis.library import Hypothesis
from identify.effects import Parameter
from identify.error_radius import radius
from identify.experiment import Experiment
from identify.identifiability import Identifiability
from identify.study import Criterion, Study

__all__ = [
    "UNITS",
    "bound_json",
    "confusability_json",
    "confusability_lines",
    "counts",
    "criteria",
    "errors_at_test_poses",
    "judgement",
    "judgement_lines",
    "weakest",
]

#: Units of the criteria that do not depend on the parameters'.
UNITS = {"test_pose": "mm^2", "G": "mm^2"}
_CONFIDENCE = 0.95
_SHOWN_NAMES = 6


def judgement(
    observer: Subject, known: Identifiability, aim: Objective, bound: Bound, reached: Accuracy | None
) -> dict[str, Any]:
    """What plan.json and evaluate.json have in common."""
    names = observer.names
    return {
        "criterion": {
            "name": aim.criterion,
            "value": bound.value,
            "unit": UNITS.get(aim.criterion, "units of the parameters"),
            "rms_mm": None if reached is None else reached.rms,
            "rms_total_mm": None if reached is None else reached.rms_total,
        },
        "bound": bound.bound,
        "efficiency": bound.efficiency,
        "efficiency_continuous": None,
        "reference": observer.reference,
        "rank": known.rank,
        "parameters": [names[index] for index in known.kept],
        "units": [observer.parameters[index].unit for index in known.kept],
        "nonidentifiable": [names[dropped.column] for dropped in known.dropped],
        "why_nonidentifiable": {names[dropped.column]: observer.why(dropped) for dropped in known.dropped},
    }


def bound_json(bound: Bound) -> dict[str, float]:
    """A value with its proven bound."""
    return {"value": bound.value, "bound": bound.bound, "efficiency": bound.efficiency}


def errors_at_test_poses(reached: Accuracy | None) -> list[dict[str, float]]:
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


def weakest(observer: Subject, known: Identifiability, aim: Objective, covariance: Floats) -> dict[str, Any]:
    """The parameter that costs most: by its share of the mean square at the test poses, else by its std."""
    if aim.rows is None:
        share = np.diag(covariance) / np.trace(covariance)
    else:
        target = aim.target("test_pose")
        share = np.einsum("rp,pq,rq->p", target, covariance, target)
        share = share / share.sum()
    worst = int(np.argmax(share))
    parameter = observer.parameters[known.kept[worst]]
    return {
        "parameter": parameter.name,
        "std": float(np.sqrt(covariance[worst, worst])),
        "unit": parameter.unit,
        "share_of_criterion": float(share[worst]),
    }


def judgement_lines(content: dict[str, Any], count: int) -> tuple[str, ...]:
    """The content of plan.json or evaluate.json for people; ``count`` experiments."""
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
        f"proven: no {'plan within the budget' if content.get('budget') else count} of these poses and the "
        f"{content['candidates']} candidates reach{'es' if content.get('budget') else ''} less than "
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


def criteria(aim: Objective, information: Floats) -> dict[str, float | None]:
    """Value of every criterion; None for those of test poses where there are none."""
    names: tuple[Criterion, ...] = ("test_pose", "A", "D", "E", "G")
    return {name: aim.value(information, name) if name not in UNITS or aim.rows is not None else None for name in names}


def counts(*drawn: Candidates | None) -> dict[str, Any]:
    """Number of candidates and of rejected ones by reason, of one arm or of several together."""
    found = [chosen for chosen in drawn if chosen is not None]
    rejected: Counter[str] = Counter()
    for chosen in found:
        rejected.update(chosen.rejected)
    return {"candidates": sum(len(chosen) for chosen in found), "rejected": dict(rejected)}


def confusability_json(study: Study, experiment: Experiment) -> dict[str, Any]:
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


def confusability_lines(found: dict[str, Any]) -> list[str]:
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
