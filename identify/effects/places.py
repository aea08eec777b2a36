"""Where an effect sits: reading of ``name@where``."""

from __future__ import annotations

from identify.errors import InputError
from identify.robot import Robot

__all__ = ["chain_places", "joint_places", "named_places"]


def joint_places(effect: str, robot: Robot, where: tuple[str, ...]) -> list[int]:
    """Joint numbers (from 0) for places ``j1 ... jn``; all joints if ``where`` is empty.

    Raises:
        InputError: A place is no joint of this robot.
    """
    return chain_places(effect, "j", robot.n, where, first=1)


def chain_places(effect: str, word: str, count: int, where: tuple[str, ...], *, first: int) -> list[int]:
    """Numbers from 0 for ``count`` places ``<word><first> ...``; all if ``where`` is empty.

    Raises:
        InputError: A place does not exist.
    """
    names = [f"{word}{first + number}" for number in range(count)]
    for place in where:
        if place not in names:
            raise InputError(f"effect {effect}@{place}: no such place; allowed are {names[0]} ... {names[-1]}")
    return [number for number, name in enumerate(names) if not where or name in where]


def named_places(effect: str, allowed: tuple[str, ...], where: tuple[str, ...]) -> tuple[str, ...]:
    """Places that have names instead of numbers; all if ``where`` is empty. Nothing ``allowed``: it has no places.

    Raises:
        InputError: A place does not exist.
    """
    for place in where:
        if place not in allowed:
            known = f"allowed: {', '.join(allowed)}" if allowed else f"it has no places, write {effect}"
            raise InputError(f"effect {effect}@{place}: no such place; {known}")
    return tuple(place for place in allowed if not where or place in where)
