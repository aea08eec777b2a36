"""Which values of compliance parameters are physically possible: symmetric positive definite matrices of springs.

A parameter is an element of the compliance matrix of a *set* of springs: the six at the end of a link, the joints, the
foot or the tool. Sets fall apart into blocks that no parameter connects; each block has to be positive definite. All is
in units of the prior, ``y_ab = x_ab / sqrt(prior_aa prior_bb)``, so that m/N and rad/Nm may be compared.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.priors import Prior
from identify.reduction_steps import element_of

__all__ = ["Block", "Cone", "cone_of", "is_compliance"]

_JOINT = re.compile(r"joint_compliance\.j(\d+)")
_CROSS = re.compile(r"joint_cross_compliance\.j(\d+)-j(\d+)")
_FOOT = re.compile(r"((?:base|tool)_compliance\.\w+)\.(r?[xyz])")
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_RESULT = 1e-6  # um/N, urad/N and urad/Nm in SI

Spring = tuple[str, int]


@dataclass(frozen=True, eq=False)
class Block:
    """A matrix that has to be positive definite.

    Attributes:
        label: Whose it is: ``link2``, ``joints`` ....
        columns: (k, k) index of the parameter of each element; -1: zero.
    """

    label: str
    columns: Ints

    def matrices(self, y: Floats) -> Floats:
        """(..., k, k) of scaled parameters (..., P)."""
        return np.where(self.columns >= 0, y[..., np.maximum(self.columns, 0)], 0.0)


@dataclass(frozen=True, eq=False)
class Cone:
    """The possible values of parameters.

    Attributes:
        names: (P,) of the parameters.
        scale: (P,) size of each in result units: ``x = scale * y``.
        prior: (P,) scaled values of the prior.
        weight: (P,) 1 for elements on a diagonal, sqrt 2 beside it: what each counts in a matrix norm.
        blocks: What has to be positive definite.
    """

    names: tuple[str, ...]
    scale: Floats
    prior: Floats
    weight: Floats
    blocks: tuple[Block, ...]

    @property
    def diagonal(self) -> Ints:
        """Indices of the parameters on diagonals."""
        found = [np.diag(block.columns) for block in self.blocks]
        return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)

    def smallest(self, y: Floats) -> Floats:
        """(blocks,) smallest eigenvalue of each at scaled parameters (P,)."""
        return np.array([np.linalg.eigvalsh(block.matrices(y))[0] for block in self.blocks])


def is_compliance(name: str) -> bool:
    """True for parameters that the cone knows."""
    return _springs(name) is not None


def cone_of(names: Sequence[str], prior: Prior) -> Cone:
    """The cone of parameters with these names; what is no compliance is left free, in its own unit.

    Raises:
        InputError: Both elements of a mirrored pair are parameters, or a link or joint that the prior lacks.
    """
    pairs = [_springs(name) for name in names]
    known = [pair for pair in pairs if pair is not None]
    if len(set(known)) < len(known):
        raise InputError("both elements of a mirrored pair are parameters; a symmetric template is needed")
    expected = [_expected(name, pair, prior) for name, pair in zip(names, pairs, strict=True)]
    scale = np.array([size for size, _ in expected])
    weight = np.array([1.0 if pair is None or pair[0] == pair[1] else np.sqrt(2.0) for pair in pairs])
    values = np.array([value for _, value in expected])
    return Cone(tuple(names), scale, values / scale, weight, _blocks(pairs))


def _springs(name: str) -> tuple[Spring, Spring] | None:
    """The two springs whose pair a parameter is; None if it is no compliance."""
    link = element_of(name)
    if link is not None:
        return (f"link{link[0]}", min(link[1]) - 1), (f"link{link[0]}", max(link[1]) - 1)
    if found := _JOINT.fullmatch(name):
        return ("joints", int(found[1]) - 1), ("joints", int(found[1]) - 1)
    if found := _CROSS.fullmatch(name):
        ends = sorted((int(found[1]) - 1, int(found[2]) - 1))
        return ("joints", ends[0]), ("joints", ends[1])
    if found := _FOOT.fullmatch(name):
        return (found[1], _AXES.index(found[2])), (found[1], _AXES.index(found[2]))
    return None


def _expected(name: str, pair: tuple[Spring, Spring] | None, prior: Prior) -> tuple[float, float]:
    """Scale and prior value of a parameter, result units."""
    if pair is None:
        return 1.0, 0.0
    (owner, first), (_, second) = pair
    if owner == "joints":
        matrix = np.diag(prior.joints)
    else:
        link = int(owner[4:]) if owner.startswith("link") else -1 if owner.startswith("tool") else 0
        matrix = prior.links[link] if link < len(prior.links) else np.zeros((0, 0))
    if second >= len(matrix):
        raise InputError(f"{name}: the prior has {len(prior.joints)} joints and {len(prior.links)} links")
    size = np.sqrt(matrix[first, first] * matrix[second, second])
    return float(size / _RESULT), float(matrix[first, second] / _RESULT)


def _blocks(pairs: Sequence[tuple[Spring, Spring] | None]) -> tuple[Block, ...]:
    """Connected springs that have a compliance of their own; pairs with a rigid or unmodelled spring stay free."""
    index = {pair: number for number, pair in enumerate(pairs) if pair is not None}
    label = {pair[0]: number for number, pair in enumerate(index) if pair[0] == pair[1]}
    for first, second in index:
        if first in label and second in label:
            old, new = label[second], label[first]
            label = {spring: new if number == old else number for spring, number in label.items()}
    blocks = []
    for number in dict.fromkeys(label.values()):
        springs = sorted(spring for spring, own in label.items() if own == number)
        rows = [[index.get((min(a, b), max(a, b)), -1) for b in springs] for a in springs]
        blocks.append(Block(springs[0][0], np.array(rows, dtype=np.int64)))
    return tuple(blocks)
