"""The steps of model reduction as linear maps between parameter vectors, which can be chained.

Physical steps: symmetrisation (M1), sparsing by a template (M2), aggregation of joints into links (M3).
Source: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", section 3.1, eq. 10 to 13.
The algebraic steps M4 and M5 are maps of the same kind, made in `identify.reduction`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.effects.templates import Elements, element_name
from identify.robot import Robot
from identify.springs import link_turns

__all__ = ["Step", "aggregation", "element_of", "keep", "link_name", "sparsing", "symmetrisation"]

_ELEMENT = re.compile(r"link_compliance\.link(\d+)\.k([1-6])([1-6])")
_JOINT = re.compile(r"joint_compliance\.j(\d+)")
_PARALLEL = 1e-9  # a component of a unit axis below this is zero


@dataclass(frozen=True, eq=False)
class Step:
    """One reduction ``pi -> pi'``: two affine maps, so that steps can be chained.

    Attributes:
        name: M1 ... M5.
        what: What it does, in words.
        source: Where it stands in the paper.
        before: Names of the b parameters it starts from.
        after: Names of the a parameters it leaves.
        expand: (b, a): ``pi = expand pi' + constant``; the observation matrix becomes ``A expand``.
        contract: (a, b): ``pi' = contract (pi - constant)``, parameters that deflect the arm like ``pi``.
        constant: (b,) what the left out parameters are set to, zero for the others.
    """

    name: str
    what: str
    source: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    expand: Floats
    contract: Floats
    constant: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("expand", "contract", "constant"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def removed(self) -> tuple[str, ...]:
        """Names that the step leaves out, in their order."""
        left = set(self.after)
        return tuple(name for name in self.before if name not in left)

    def reduced(self, values: Floats) -> Floats:
        """Reduced parameters (a,) of given ones (b,)."""
        result: Floats = self.contract @ (values - self.constant)
        return result

    def expanded(self, values: Floats) -> Floats:
        """Parameters (b,) of reduced ones (a,)."""
        result: Floats = self.expand @ values + self.constant
        return result


def keep(name: str, what: str, source: str, before: tuple[str, ...], after: tuple[str, ...]) -> Step:
    """The step that leaves out all parameters but ``after``; what the others did is lost."""
    expand = np.zeros((len(before), len(after)))
    expand[[before.index(name) for name in after], np.arange(len(after))] = 1.0
    return Step(name, what, source, before, after, expand, expand.T, np.zeros(len(before)))


def element_of(name: str) -> tuple[int, tuple[int, int]] | None:
    """Link and element (a, b) of a link parameter; None for any other name."""
    found = _ELEMENT.fullmatch(name)
    return (int(found[1]), (int(found[2]), int(found[3]))) if found else None


def link_name(link: int, element: tuple[int, int]) -> str:
    """Name of an element of a link's compliance matrix."""
    return f"link_compliance.link{link}.{element_name(element)}"


def symmetrisation(before: tuple[str, ...]) -> Step:
    """M1: one parameter ``k_ij`` (i < j) for each pair ``k_ij, k_ji`` (eq. 10 to 12)."""
    merged = {name: _upper(name) for name in before}
    after = tuple(dict.fromkeys(merged.values()))
    column = {name: index for index, name in enumerate(after)}
    expand = np.zeros((len(before), len(after)))
    expand[np.arange(len(before)), [column[merged[name]] for name in before]] = 1.0
    contract = expand.T / expand.sum(axis=0)[:, None]
    return Step("M1", "symmetrisation", "eq. 10-12", before, after, expand, contract, np.zeros(len(before)))


def _upper(name: str) -> str:
    """The name of the element of the same pair that lies on or above the diagonal."""
    found = element_of(name)
    return name if found is None else link_name(found[0], (min(found[1]), max(found[1])))


def sparsing(before: tuple[str, ...], templates: Mapping[int, Elements]) -> Step:
    """M2: link elements that the template of their link does not have are zero (eq. 13).

    Args:
        before: Names after M1.
        templates: Elements of each link; either side of a mirrored pair.
    """
    after = tuple(name for name in before if _in_template(name, templates))
    return keep("M2", "sparsing", "eq. 13", before, after)


def _in_template(name: str, templates: Mapping[int, Elements]) -> bool:
    found = element_of(name)
    return found is None or bool({found[1], found[1][::-1]} & set(templates[found[0]]))


def aggregation(before: tuple[str, ...], robot: Robot, stay: Collection[str] = ()) -> Step:
    """M3: the compliance of a joint becomes part of the link before it, wherever that link has all elements it needs.

    A joint with compliance c about the unit axis a (in the local frame of the link at whose end it stands) adds
    ``c a_i a_j`` to the elements (i, j) of that link; a sliding joint to those of its translations. Joints whose link
    lacks such an element stay.

    Args:
        before: Names after M2.
        robot: The robot.
        stay: Joint parameters that may not be merged.
    """
    shares = {name: _joint_share(name, robot) for name in before if name not in stay}
    merged = {name: share for name, share in shares.items() if share and set(share) <= set(before)}
    after = tuple(name for name in before if name not in merged)
    step = keep("M3", "aggregation", "section 3.1", before, after)
    contract = step.contract.copy()
    for name, share in merged.items():
        for element, part in share.items():
            contract[after.index(element), before.index(name)] = part
    return Step("M3", step.what, step.source, before, after, step.expand, contract, step.constant)


def _joint_share(name: str, robot: Robot) -> dict[str, float]:
    """What a unit compliance of a joint adds to the elements of the link before it; empty for other parameters."""
    found = _JOINT.fullmatch(name)
    if not found:
        return {}
    joint = int(found[1]) - 1
    axis = link_turns(robot)[joint, 2]  # the joint's z axis, seen from the link frame
    first = 1 if robot.prismatic[joint] else 4
    used = [i for i in range(3) if abs(axis[i]) > _PARALLEL]
    return {link_name(joint, (first + i, first + j)): float(axis[i] * axis[j]) for i in used for j in used if i <= j}
