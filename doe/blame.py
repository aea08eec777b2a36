"""Which constraint leaves no candidate: what each forbids alone, and what dropping one would bring back."""

from __future__ import annotations

import numpy as np

from doe.feasible import Screen
from identify.arrays import Floats, Ints

__all__ = ["REMEDIES", "blame"]

#: What helps against each reason.
REMEDIES = {
    "joint_limits": "smaller joint margins",
    "floor": "a lower floor_mm, a load that hangs less far below the flange",
    "walls": "walls further away, or a smaller clearance_mm",
    "boxes": "boxes further away, or a smaller clearance_mm",
    "self_collision": "a smaller link_radius_mm, or self_collision = false",
    "load_collision": "a smaller size_mm or another hang_mm of the loads, or a smaller clearance_mm",
    "arm_collision": "another home_deg in the study of the other arm, or a smaller clearance_mm",
    "payload": "lighter loads or a larger payload_share, or a wider payload_diagram",
    "torque": "lighter loads, or larger wrist_moment_Nm and torque_share",
    "tracker_range": "another tracker station, or a wider range under visibility",
    "reflector_angle": "other marker_normals, another tracker station, or a larger acceptance_deg",
    "line_of_sight": "another tracker station, other markers, or fewer required ones",
}


def blame(tests: Screen, q: Floats, choices: Ints) -> str:
    """What the constraints do to poses, each on its own.

    Args:
        tests: The checks.
        q: (N, n) poses, rad or m; a few hundred.
        choices: (C, L) loads of the visits.

    Returns:
        One sentence: the constraint whose absence brings most candidates back, if one alone does; else the one that
        forbids most.
    """
    fails = {reason: wrong[:, choices].any(axis=2).ravel() for reason, wrong in tests.failures(q).items()}
    together = np.sum(list(fails.values()), axis=0)
    count = len(together)
    back = {reason: int((wrong & (together == 1)).sum()) for reason, wrong in fails.items()}
    worst = max(back, key=lambda reason: back[reason])
    if back[worst]:
        return f"without {worst} alone, {back[worst]} of {count} could be measured"
    alone = {reason: int(wrong.sum()) for reason, wrong in fails.items()}
    worst = max(alone, key=lambda reason: alone[reason])
    others = ", ".join(f"{reason} {number}" for reason, number in alone.items() if number and reason != worst)
    beside = f" ({others})" if others else ""
    return f"of {count} looked at, {worst} alone forbids {alone[worst]}{beside}; no single one is to blame"
