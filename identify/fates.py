"""What became of each parameter of the full model, in words."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from identify.reduction_steps import Step

__all__ = ["tell_fates"]

_SHOWN = 6


def tell_fates(
    steps: Sequence[Step], why: Callable[[str], str], values: Mapping[str, float], units: Mapping[str, str]
) -> dict[str, str]:
    """The fate of every parameter that the first step starts from.

    Args:
        steps: M1 to M5.
        why: Name of an eliminated parameter -> reason why no reading depends on it.
        values: What the assigned parameters are set to.
        units: Unit of each of them.

    Returns:
        name -> ``kept ...``, ``merged with ...``, ``eliminated: ...`` or ``fixed to constant ...``.
    """
    heirs = [_heirs(step) for step in steps]
    told = {name: _kept(name, heirs) for name in steps[-1].after}
    for step, taken in zip(reversed(steps), reversed(heirs), strict=True):
        for name, by in taken.items():
            told[name] = _removed(name, step, by, told, why, f"{values.get(name, 0.0):.6g} {units[name]}")
    return {name: told[name] for name in steps[0].before}


def _removed(
    name: str, step: Step, heirs: list[str], told: Mapping[str, str], why: Callable[[str], str], value: str
) -> str:
    """What a step did to a parameter that it leaves out."""
    if step.name == "M2":
        return "eliminated: zero in the template of its link (M2)"
    if step.name == "M4":
        return f"eliminated: not identifiable because {why(name)} (M4)"
    if step.name == "M5":
        return f"fixed to constant {value} because coupled with {_listed(heirs)}, which act for it (M5)"
    reason = "its mirror image" if step.name == "M1" else "the link before the joint has these elements"
    onward = "; ".join(f"{heir}: {told[heir]}" for heir in heirs)
    return f"merged with {_listed(heirs)}, {reason} ({step.name}); {onward}"


def _kept(name: str, heirs: Sequence[Mapping[str, list[str]]]) -> str:
    """What a kept parameter stands for; ``heirs`` of each step."""
    holds = [other for step in heirs[:3] for other, by in step.items() if name in by]
    coupled = [other for other, by in heirs[-1].items() if name in by]
    parts = ["kept"]
    if holds:
        parts.append(f"merged with {_listed(holds)}")
    if coupled:
        parts.append(f"acts also for {_listed(coupled)}, which cannot be told from it and the other kept ones")
    else:
        parts.append("identifiable by itself")
    return "; ".join(parts)


def _heirs(step: Step) -> dict[str, list[str]]:
    """Parameters that a step leaves out -> those that take over what they did."""
    column = {name: index for index, name in enumerate(step.before)}
    return {name: [step.after[row] for row in np.flatnonzero(step.contract[:, column[name]])] for name in step.removed}


def _listed(names: Collection[str]) -> str:
    """The first names of a list, and how many more there are."""
    shown = ", ".join(list(names)[:_SHOWN])
    return shown if len(names) <= _SHOWN else f"{shown} and {len(names) - _SHOWN} more"
