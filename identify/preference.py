"""Which of several coupled parameters is kept: those that the user names, then what is physically most telling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from identify.effects.templates import FULL
from identify.errors import InputError
from identify.reduction_steps import element_of

__all__ = ["check_patterns", "preferred_order"]

_BENDING = ((5, 5), (6, 6))
_TORSION = ((4, 4),)
_COUPLING = ((2, 6), (3, 5))
_SIDEWAYS = ((2, 2), (3, 3))
_AXIAL = ((1, 1),)
#: Elements from the most to the least preferred: what turns before what shifts, a beam's elements before others.
_CLASSES = (_BENDING, _TORSION, _COUPLING, _SIDEWAYS, _AXIAL)


def preferred_order(names: Sequence[str], holders: Mapping[str, str], patterns: Sequence[str] = ()) -> list[int]:
    """Indices of ``names`` from the most to the least preferred; equals stay in their order.

    After the user's patterns come parameters of joints, link elements that hold the compliance of a joint, bending,
    torsion, coupling of bending, deflections across and along the beam, and what no beam has.

    Args:
        names: Parameters to order.
        holders: Link element -> joint parameter that was merged into it.
        patterns: Names with the wildcards ``*``, ``?`` and ``[...]``, most preferred first.
    """

    def rank(index: int) -> tuple[int, int, int]:
        name = names[index]
        stated = next((i for i, p in enumerate(patterns) if fnmatchcase(name, p)), len(patterns))
        return stated, _physical_rank(name, holders), index

    return sorted(range(len(names)), key=rank)


def _physical_rank(name: str, holders: Mapping[str, str]) -> int:
    found = element_of(name)
    if found is None:
        return 0
    if name in holders:
        return 1
    for rank, elements in enumerate(_CLASSES):
        if found[1] in elements:
            return 2 + rank
    return 2 + len(_CLASSES) + FULL.index(found[1])


def check_patterns(patterns: Sequence[str], names: Sequence[str], key: str) -> None:
    """Refuse a pattern that no parameter has.

    Args:
        patterns: The user's patterns.
        names: All names that can be meant.
        key: Where the patterns stand, for the message.

    Raises:
        InputError: A pattern without a match.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(
                f"{key} {pattern!r}: no parameter of the full model has this name; they are called "
                f"{names[0]} ... {names[-1]}, and patterns such as '*.link2.k55' are allowed"
            )
