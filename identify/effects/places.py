"""Where an effect sits: reading of ``name@where``."""

from __future__ import annotations

from identify.errors import InputError
from identify.robot import Robot

__all__ = ["chain_places", "joint_pair", "joint_places", "named_places", "turning_places"]


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


def turning_places(effect: str, robot: Robot, where: tuple[str, ...]) -> list[int]:
    """Numbers (from 0) of turning joints; all of them if ``where`` is empty.

    Raises:
        InputError: A place is no joint of this robot, or a sliding one, or no joint turns.
    """
    turning = [f"j{joint + 1}" for joint in range(robot.n) if not robot.prismatic[joint]]
    for joint in joint_places(effect, robot, where):
        if where and robot.prismatic[joint]:
            raise InputError(
                f"effect {effect}@j{joint + 1}: joint {joint + 1} slides; allowed are joints that turn: "
                f"{', '.join(turning) or 'none'}"
            )
    if not turning:
        raise InputError(f"effect {effect}: no joint of robot {robot.name} turns; leave the effect out")
    return joint_places(effect, robot, where or tuple(turning))


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


def joint_pair(effect: str, robot: Robot, place: str) -> tuple[int, int]:
    """Joint numbers (from 0) of a place such as ``j4-j5``.

    Raises:
        InputError: It is no pair of two joints of this robot in ascending order.
    """
    names = [f"j{joint + 1}" for joint in range(robot.n)]
    first, _, second = place.partition("-")
    if first not in names or second not in names or names.index(first) >= names.index(second):
        raise InputError(
            f"effect {effect}@{place}: no such place; a pair of joints of {names[0]} ... {names[-1]} "
            "in ascending order is expected, for example j1-j2"
        )
    return names.index(first), names.index(second)
