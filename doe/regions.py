"""Test regions: a box of poses and wrenches where accuracy counts, integrated by quasi-Monte Carlo.

A region becomes test poses at the points of a scrambled Sobol sequence that always starts the same way, so that plans
and evaluations agree. Joint values beyond the limits are cut off, poses in which the arm touches itself or the cell are
left out, and the points that remain share the weight of the region: the mean square is the mean over its points.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from doe.feasible import screen
from doe.gaps import gaps_of
from identify.arrays import Floats
from identify.errors import Infeasible, InputError
from identify.kinematics import forward
from identify.study import Study, TestPose, TestRegion

__all__ = ["check_test_poses", "poses_in", "with_regions"]

_STANDS = {"walls", "boxes", "self_collision"}  # what forbids a test pose; the floor is that of the measurement
_DRAWS = 64  # poses drawn for each point before the search gives up
_SEED = 0
_TOUCH = 1e-6  # m

log = logging.getLogger("elastocal")


def check_test_poses(study: Study) -> None:
    """Whether the arm alone can stand in the stated test poses; it may come closer there than the clearance.

    Below the floor of the measurement it may stand, which is told.

    Raises:
        InputError: It is in a box or behind a wall.
    """
    if not study.test_poses:
        return
    gaps = gaps_of(replace(study, constraints=replace(study.constraints, clearance=0.0)))
    frames = forward(study.robot, np.array([pose.q for pose in study.test_poses]))
    for reason in ("walls", "boxes", "floor"):
        depth = -gaps.by_reason[reason](frames).max(axis=1)  # with the load that is least in the way
        pose = int(np.argmax(depth))
        if depth[pose] <= _TOUCH:
            continue
        name, broken = f"{study.path}: [[test_poses]] {pose + 1} joints_deg", f"{1e3 * depth[pose]:.4g} mm"
        if reason == "floor":
            log.warning("%s: the arm stands %s below [constraints] floor_mm, where nothing is measured", name, broken)
            continue
        raise InputError(
            f"{name}: the arm cannot stand there, {reason} is broken by {broken}; state another test pose or correct "
            f"[[constraints.{reason}]]"
        )


def with_regions(study: Study) -> Study:
    """The study with the points of its test regions as test poses, behind the stated ones; without regions itself.

    Raises:
        Infeasible: The arm touches itself or the cell everywhere in a region.
    """
    if not study.test_regions:
        return study
    points = [pose for region in range(len(study.test_regions)) for pose in poses_in(study, region)]
    return replace(study, test_poses=(*study.test_poses, *points), test_regions=())


def poses_in(study: Study, index: int) -> tuple[TestPose, ...]:
    """The points of one test region as test poses, each with its share of the weight.

    Args:
        study: The study.
        index: Of the region.

    Raises:
        Infeasible: The arm touches itself or the cell everywhere in it.
    """
    region = study.test_regions[index]
    q, wrench, drawn = _points(study, region)
    name = f"{study.path}: [[test_regions]] {index + 1}"
    if not len(q):
        raise Infeasible(
            f"{name}: the arm touches itself or the cell in all {drawn} poses that were drawn in it; move or widen "
            "the region, make [constraints] link_radius_mm smaller, or set self_collision = false"
        )
    if len(q) < region.points and len(q) > 1:
        log.warning("%s: only %d of %d points found among %d drawn", name, len(q), region.points, drawn)
    weight = region.weight / len(q)
    return tuple(
        TestPose(joints, force, region.in_flange, region.attach, region.point, weight)
        for joints, force in zip(q, wrench, strict=True)
    )


def _points(study: Study, region: TestRegion) -> tuple[Floats, Floats, int]:
    """Joint values (P, n) and wrenches (P, 6) of a region, and the number of poses looked at."""
    from scipy.stats import qmc

    robot = study.robot
    lower = np.concatenate([np.maximum(region.lower, robot.lower), region.wrench_lower])
    upper = np.concatenate([np.minimum(region.upper, robot.upper), region.wrench_upper])
    moving = np.flatnonzero(upper > lower)
    if not len(moving):
        return (*_allowed(study, lower[None]), 1)
    sequence = qmc.Sobol(len(moving), scramble=True, seed=np.random.default_rng(_SEED))
    batch = 1 << (region.points - 1).bit_length()
    q, wrench, drawn = np.zeros((0, robot.n)), np.zeros((0, 6)), 0
    while len(q) < region.points and drawn < _DRAWS * batch:
        values = np.tile(lower, (batch, 1))
        values[:, moving] += (upper - lower)[moving] * sequence.random(batch)
        more_q, more_wrench = _allowed(study, values)
        q, wrench = np.concatenate([q, more_q]), np.concatenate([wrench, more_wrench])
        drawn += batch
    return q[: region.points], wrench[: region.points], drawn


def _allowed(study: Study, values: Floats) -> tuple[Floats, Floats]:
    """Joint values and wrenches of those points (B, n + 6) in which the arm alone can stand."""
    q, tests = values[:, : study.robot.n], screen(study).tests
    frames, free = forward(study.robot, q), np.ones(len(values), dtype=bool)
    for reason in _STANDS & tests.keys():
        free &= ~tests[reason](q, frames).all(axis=1)  # with the load that is least in the way
    return q[free], values[free, study.robot.n :]
