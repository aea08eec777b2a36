"""Payload diagram, wrist moments and joint torques."""

from dataclasses import replace

import numpy as np
import pytest

from doe.candidates import candidates
from doe.feasible import check
from doe.statics import carried
from identify.cell import PayloadDiagram
from identify.errors import Infeasible
from identify.kinematics import forward, jacobian
from identify.loads import LoadCase
from identify.robot_files import load_robot
from tests.doe.cell_cases import UNLOADED, cell, poses

LIGHT = LoadCase("light", mass=60.0, attach=np.array([0.3, 0.0, 0.0]))
HEAVY = LoadCase("heavy", mass=200.0, attach=np.array([0.3, 0.0, 0.0]))
FAR = LoadCase("far", mass=60.0, attach=np.array([0.0, 0.9, 0.0]))


def test_the_diagram_is_linear_between_its_points_and_ends_at_the_last():
    diagram = PayloadDiagram(np.array([0.2, 0.4]), np.array([200.0, 100.0]))
    np.testing.assert_allclose(diagram.allowed(np.array([0.0, 0.2, 0.3, 0.4, 0.41])), [200, 200, 150, 100, 0])


@pytest.mark.parametrize(("tool", "expected"), [(0.0, [True, True, False, False]), (120.0, [True, True, False, True])])
def test_loads_outside_the_payload_diagram_are_refused(tool, expected):
    """A heavy tool at the flange draws the common centre of a far load in: 60 kg at 0.9 m become 180 kg at 0.3 m."""
    study = cell(
        loads=(UNLOADED, LIGHT, HEAVY, FAR),
        payload_diagram=PayloadDiagram(np.array([0.1, 0.3, 0.5]), np.array([270.0, 180.0, 60.0])),
    )
    study = replace(study, robot=replace(study.robot, tool_mass=tool))
    assert carried(study).tolist() == expected


def test_one_forbidden_load_costs_its_own_visits_only():
    study = cell(
        loads=(UNLOADED, LIGHT, FAR), plan={"candidates": 40},
        payload_diagram=PayloadDiagram(np.array([0.1, 0.5]), np.array([270.0, 60.0])),
    )  # fmt: skip
    found = candidates(study, seed=0)
    assert set(found.visit_loads[:, 1]) == {1}
    assert found.rejected["payload"] > 0
    assert sum(found.rejected.values()) == found.drawn - len(found)


def test_moments_about_the_wrist_are_those_of_tool_and_load():
    robot = replace(load_robot("kr270_r2700"), tool_mass=30.0, tool_centre=np.array([0.1, 0.05, 0.0]))
    pull = LoadCase("pull", mass=100.0, attach=np.array([0.3, 0.1, -0.2]), force=np.array([200.0, 0, 0]))
    study = cell(
        robot=robot, loads=(UNLOADED, pull), wrist_moment=np.array([600.0, 500.0, 200.0]), self_collision=False
    )
    q = poses(study, 400)
    frames = forward(robot, q)
    force = np.tile([200.0, 0, -100 * robot.gravity], (400, 1))
    torque = np.einsum("vin,vi->vn", jacobian(frames, frames.point(pull.attach))[:, :3], force)
    weight = np.tile([0, 0, -30 * robot.gravity], (400, 1))
    tool = np.einsum("vin,vi->vn", jacobian(frames, frames.point(robot.tool_centre))[:, :3], weight)
    over = (np.abs(torque + tool)[:, 3:] > [600.0, 500.0, 200.0]).any(axis=1)
    np.testing.assert_array_equal(np.array(check(study, q, np.full((400, 1), 1)).reasons) == "torque", over)
    assert 20 < over.sum() < 380


def test_torques_of_links_and_load_stay_below_the_rated_share():
    robot = load_robot("planar_2r")
    robot = replace(
        robot, masses=np.array([10.0, 10.0]), centres=np.array([[0.5, 0, 0], [0.5, 0, 0]]),
        efforts=np.array([400.0, np.nan]),
    )  # fmt: skip
    study = cell(robot=robot, loads=(UNLOADED, LoadCase("L", mass=5.0)), torque_share=0.5, self_collision=False)
    q = poses(study, 500)
    frames = forward(robot, q)
    lever = 10 * frames.centre[:, 0] + 10 * frames.centre[:, 1] + 5 * frames.flange_origin
    torque = np.abs(np.cross(lever, robot.gravity_base) @ frames.axis[0, 0])
    refused = np.array(check(study, q, np.full((500, 1), 1)).reasons) == "torque"
    np.testing.assert_array_equal(refused, torque > 200.0)
    assert 50 < refused.sum() < 450


def test_a_torque_limit_that_nothing_meets_is_named():
    study = cell(loads=(UNLOADED, HEAVY), wrist_moment=np.array([1e-3] * 3), plan={"candidates": 20})
    with pytest.raises(Infeasible, match=r"without torque alone, .* could be measured"):
        candidates(study, seed=0)
