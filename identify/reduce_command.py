"""The command `reduce`: the chain of a study, what became of each parameter, and the model that remains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from identify.algebraic_steps import CoupledGroup
from identify.commands import Outcome
from identify.config import load_study
from identify.effects.templates import element_name
from identify.reduction import Reduction, reduce
from identify.reduction_steps import element_of
from identify.study import Study

__all__ = ["reduced_model", "reduction_json", "run_reduce"]

_STAGES = {
    "full": "every joint, 36 elements a link",
    "M1": "symmetric matrices",
    "M2": "elements of the templates",
    "M3": "joints in the links before them",
    "M4": "without what shows in no reading",
    "M5": "one parameter for each that can be identified",
}


def run_reduce(study_file: Path, *, seed: int) -> Outcome:
    """Reduce the complete model of a study file."""
    study = load_study(study_file)
    reduction = reduce(study, seed=seed)
    content = reduction_json(study, reduction)
    fragment = _HEADER + tomli_w.dumps({"model": reduced_model(study, reduction)})
    return Outcome("reduce", content, study.inputs, {"reduced.toml": fragment}, _lines(reduction))


_HEADER = """\
# The complete and irreducible model that elastocal reduce found. Put these tables in place of [model] and
# [model.link_compliance] of the study.

"""


def reduction_json(study: Study, reduction: Reduction) -> dict[str, Any]:
    """The content of ``reduce.json`` (without schema and provenance)."""
    parts = reduction.partition
    last, first = parts.gap
    return {
        "chain": reduction.chain,
        "groups": {group: len(names) for group, names in reduction.groups.items()},
        "rank": reduction.rank,
        "ranks": dict(reduction.ranks),
        "gap": {"tolerance": parts.tolerance, "last_counted": last, "first_dropped": first},
        "singular_values": parts.singular_values,
        "parameters": [{"name": name, "unit": reduction.units[name]} for name in reduction.kept],
        "group_names": reduction.groups,
        "coupled_groups": [
            {"rank": group.rank, "names": group.names, "kept": group.kept, "fixed": group.fixed}
            for group in reduction.coupled
        ],
        "constants": {
            name: {"value": value, "unit": reduction.units[name]} for name, value in reduction.constants.items()
        },
        "names": reduction.names,
        "fates": dict(reduction.fates),
        "conditions": {
            "configurations": reduction.configurations,
            "markers": [n for n, base in zip(study.markers.names, study.markers.on_base, strict=True) if not base],
            "loads": [load.name for load in study.loads if not load.unloaded],
            "directions": study.reduce.directions,
            "targets": study.reduce.targets,
            "prefer": study.reduce.prefer,
        },
    }


def reduced_model(study: Study, reduction: Reduction) -> dict[str, Any]:
    """The tables ``[model]`` and ``[model.link_compliance]`` in which exactly the kept parameters are fitted.

    Effects that the reduction does not look at (geometry ...) stay in the list.
    """
    links: dict[str, list[str]] = {f"link{i}": [] for i in range(study.robot.n + 1)}
    joints: list[str] = []
    for name in reduction.kept:
        place = element_of(name)
        if place is not None:
            links[f"link{place[0]}"].append(element_name(place[1]))
        elif name.startswith("joint_compliance."):
            joints.append(f"joint_compliance@{name.partition('.')[2]}")
    others = [e for e in study.effects if e.partition("@")[0] not in {"joint_compliance", "link_compliance"}]
    fixed = {name.removeprefix("link_compliance."): value for name, value in reduction.constants.items() if value}
    options: dict[str, Any] = {"constants": fixed} if fixed else {}
    options |= {link: {"template": elements} for link, elements in links.items()}
    model: dict[str, Any] = {"effects": [*joints, "link_compliance", *others], "reference": study.reference}
    nominal = {name: value for name, value in study.nominal.items() if name in reduction.kept}
    if nominal:
        model["nominal"] = nominal
    return {**model, "link_compliance": options}


def _lines(reduction: Reduction) -> tuple[str, ...]:
    """The chain and the groups for people."""
    lines = [f"{'step':<6}{'parameters':>10}{'rank':>6}"]
    lines += [
        f"{stage:<6}{count:>10}{reduction.ranks[stage]:>6}  {_STAGES[stage]}"
        for stage, count in reduction.chain.items()
    ]
    last, first = reduction.partition.gap
    lines.append(
        f"rank {reduction.rank}: relative singular values {last:.1e} and {first:.1e} on either side of "
        f"{reduction.partition.tolerance:.0e}"
    )
    groups = reduction.groups
    lines.append(f"G1 identifiable ({len(groups['G1'])}): {_short(groups['G1'])}")
    lines.append(f"G2 not identifiable ({len(groups['G2'])}): {_short(groups['G2'])}")
    lines.append(f"G3 coupled ({len(groups['G3'])}) in {len(reduction.coupled)} groups")
    for group in reduction.coupled:
        lines += _group_lines(group, reduction)
    return tuple(lines)


def _group_lines(group: CoupledGroup, reduction: Reduction) -> list[str]:
    constants = [
        f"{_short((name,))} = {reduction.constants[name]:.3g} {reduction.units[name]}"
        for name in group.fixed
        if reduction.constants[name]
    ]
    zero = [name for name in group.fixed if not reduction.constants[name]]
    lines = [f"  {group.rank} of {len(group.names)}: keep {_short(group.kept)}"]
    if zero:
        lines.append(f"    zero: {_short(zero)}")
    return lines + [f"    constant: {', '.join(constants)}"] * bool(constants)


def _short(names: tuple[str, ...] | list[str]) -> str:
    """Names without the word that most of them begin with."""
    return ", ".join(name.removeprefix("link_compliance.") for name in names) or "none"
