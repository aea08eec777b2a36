"""Where an effect sits: reading of ``name@where``."""

from __future__ import annotations

import re

from identify.errors import InputError
from identify.robot import Robot

__all__ = ["joint_places"]


def joint_places(effect: str, robot: Robot, where: tuple[str, ...]) -> list[int]:
    """Joint numbers (from 0) for places ``j1 ... jn``; all joints if ``where`` is empty.

    Raises:
        InputError: A place is no joint of this robot.
    """
    if not where:
        return list(range(robot.n))
    index = []
    for place in where:
        match = re.fullmatch(r"j([1-9]\d*)", place)
        if not match or int(match.group(1)) > robot.n:
            raise InputError(f"effect {effect}@{place}: no such place; allowed are j1 ... j{robot.n}")
        index.append(int(match.group(1)) - 1)
    return sorted(set(index))
