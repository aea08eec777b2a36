"""What plan.json and evaluate.json have in common, for one arm and for two, and the same in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from doe.accuracy import Accuracy
from doe.bounds import Bound
from doe.candidates import Candidates
from doe.closing import BRANCHED
from doe.confusability import SHOWN, confusability
from doe.curve import CurvePoint, Reached
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
    "curve_json",
    "curve_lines",
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
        "bound_source": bound.source,
        "efficiency_continuous": bound.continuous,
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


def broken_notes(broken: Mapping[str, int]) -> list[str]:
    """What a user should know about given visits that break constraints, counted by reason."""
    if not broken:
        return []
    counts = ", ".join(f"{reason} {count}" for reason, count in broken.items())
    return [f"given visits that break a constraint of the study: {counts}"]


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
    lines = _measured_lines(content, count)
    lines.append(
        f"{count} experiments at {content['different_poses']} different poses, {content['rank']} parameters, "
        f"reference {content['reference']}"
    )
    if criterion["rms_mm"] is not None:
        lines.append(
            f"expected error at the test poses: {criterion['rms_mm']:.4f} mm rms "
            f"({criterion['rms_total_mm']:.4f} mm with the robot's repeatability)"
        )
    lines.append(f"criterion {criterion['name']} = {criterion['value']:.5g} {criterion['unit']}")
    if count:
        lines.append(_proof_line(content, count))
    if content["bound_source"] == BRANCHED:
        lines.append(f"proven optimal on these by branch and bound within {_percent(1 - content['efficiency'])}")
    if content["efficiency_continuous"] is not None:
        share = 100 * content["efficiency_continuous"]
        lines.append(f"estimated over all {_varied(content)}, not proven: {share:.2f} % efficient")
    if content["grid"] is not None and count:
        lines.append(
            f"before refinement: {content['grid']['value']:.5g}, on the candidates alone at least "
            f"{100 * content['grid']['efficiency']:.2f} % efficient"
        )
    lines += _robust_lines(content)
    if content.get("refinement") is not None:
        lines.append(f"refining the {_varied(content)} gained {content['refinement']['gained_percent']:.1f} %")
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


def _varied(content: dict[str, Any]) -> str:
    """What varies continuously, in words."""
    return "joint angles" if content.get("load_settings") is None else "joint angles and loads"


def _proof_line(content: dict[str, Any], count: int) -> str:
    """The bound in words."""
    beside = "" if content.get("measured") is None else " beside what was measured"
    no, reach = ("plan within the budget", "reaches") if content.get("budget") else (str(count), "reach")
    return (
        f"proven: no {no} of these poses and the {content['candidates']} candidates{beside} {reach} less than "
        f"{content['bound']:.5g}, so the efficiency is at least {100 * content['efficiency']:.2f} %"
    )


def _robust_lines(content: dict[str, Any]) -> list[str]:
    """What the plan is worth after losses and at other nominal values."""
    robust = content.get("robust")
    if robust is None:
        return []
    when = [f"after losing {' and '.join(robust['worst_loss'])}, the worst loss"] * bool(robust["losses"])
    when += [f"on average over {robust['draws']} draws of the nominal values"] * bool(robust["draws"])
    told = robust["losses"] and robust["rms_mm"] is not None
    error = f" (at the nominal values {robust['rms_mm']:.4f} mm rms at the test poses)" if told else ""
    proof = f"proven: no plan of as many stays below {robust['bound']:.5g}"
    return [f"{', '.join(when)}: {robust['value']:.5g}{error}; {proof}"]


def _measured_lines(content: dict[str, Any], count: int) -> list[str]:
    """What was measured before, and whether that is enough."""
    measured = content.get("measured")
    if measured is None:
        return []
    told = (
        "too little to tell the accuracy"
        if measured["rms_mm"] is None
        else (f"expected error {measured['rms_mm']:.4f} mm rms ({measured['rms_total_mm']:.4f} mm with repeatability)")
    )
    lines = [f"measured already: {measured['visits']} visits, {told}"]
    return lines if count else [*lines, "this keeps the tolerance: nothing more needs to be measured"]


def curve_json(curve: Sequence[CurvePoint], *, given: bool) -> list[dict[str, float | int | None]]:
    """Expected accuracy against the number of experiments, mm; ``given``: visits of a pose file are among it."""

    def three(kind: str, reached: Reached | None) -> dict[str, float | None]:
        values = (None, None, None) if reached is None else (reached.rms, reached.rms_total, reached.radius)
        return dict(zip((f"{kind}_mm", f"{kind}_total_mm", f"{kind}_radius_mm"), values, strict=True))

    return [
        {
            "poses": point.poses,
            "bound_mm": point.bound,
            **three("plan", point.plan),
            **three("random", point.random),
            **(three("own", point.own) if given else {}),
        }
        for point in curve
    ]


def curve_lines(curve: Sequence[Mapping[str, float | int | None]]) -> list[str]:
    """The curve as a small table."""
    kinds = {"bound_mm": "impossible below", "plan_mm": "designed", "random_mm": "random", "own_mm": "these"}
    shown = {key: word for key, word in kinds.items() if any(point.get(key) is not None for point in curve)}
    if not shown:
        return []

    def cell(value: float | None, word: str) -> str:
        return f"{'-' if value is None else f'{value:.4f}':>{len(word) + 2}}"

    head = f"{'experiments':>11}" + "".join(f"  {word}" for word in shown.values()) + "   (rms at the test poses, mm)"
    return [
        head,
        *(f"{point['poses']:>11}" + "".join(cell(point[key], word) for key, word in shown.items()) for point in curve),
    ]


def _percent(share: float) -> str:
    """A small share in percent, never less than what a bound is closed to."""
    return f"{max(100 * share, 1e-4):.2g} %"


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
