"""Base, tool and cross compliances: the same as elements of the link model, exact, recovered, and refused in words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identify.arrays import skew
from identify.effects import bind_effects, build_scene
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.identification import identify
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import model_of
from identify.response import effect_columns, respond
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.simulate import simulate
from identify.springs import base_springs, motion, self_weight_torque
from identify.study import Noise, Study
from identify.transforms import axis_frame, roll_pitch_yaw, translation

MARKERS = Markers(
    ("M1", "M2", "floor"),
    np.array([[0.18, 0.0, -0.17], [0.02, 0.09, 0.22], [1.0, 0.2, 0.1]]),
    np.array([False, False, True]),
)
LOADS = (
    LoadCase("L0"),
    LoadCase("hung", mass=250.0, attach=np.array([0.3, 0.05, -0.1])),
    LoadCase("pulled", 0.0, np.array([0.1, 0.2, 0.0]), np.array([900.0, -700.0, 300.0]), np.array([50.0, 80.0, -60.0])),
)


def crooked(prismatic=(False, True, False, False), seed=3):
    """A robot with masses, a tool and a tilted base, in no special position."""
    rng = np.random.default_rng(seed)
    n = len(prismatic)
    return Robot(
        name="crooked",
        joints=tuple(f"j{i + 1}" for i in range(n)),
        prismatic=np.array(prismatic),
        placements=np.array([
            translation(rng.normal(0, 0.5, 3)) @ axis_frame(rng.normal(size=3)) for _ in range(n + 1)
        ]),
        lower=np.full(n, -1.0),
        upper=np.full(n, 1.0),
        masses=rng.uniform(5, 50, n),
        centres=rng.normal(0, 0.3, (n, 3)),
        efforts=np.full(n, np.nan),
        world_R_base=roll_pitch_yaw([0.2, -0.3, 1.0]),
        tool_mass=8.0,
        tool_centre=np.array([0.1, 0.0, 0.2]),
    )


def scene_of(robot, count=7, seed=1):
    q = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, robot.n))
    experiment = full_experiment(q, np.tile(np.arange(len(LOADS)), (count, 1)), LOADS, MARKERS)
    return build_scene(experiment, forward(robot, q), MARKERS.positions, self_weight=robot.masses_known)


def columns(scene, robot, *effects, **options):
    """Columns (R, 3, p) by name of the parameter."""
    found = {}
    for effect in bind_effects(effects, robot, options=options):
        derivative = effect.derivative(scene, np.zeros(len(effect.parameters)))
        found |= {parameter.name: derivative[:, :, i] for i, parameter in enumerate(effect.parameters)}
    return found


@pytest.fixture(params=["kr270_2", "ur10", "crooked"])
def robot(request):
    return crooked() if request.param == "crooked" else load_robot(request.param, mount=(0.1, 0.2, 0.3))


def test_base_and_tool_springs_are_elements_of_the_first_and_last_link(robot):
    scene, n = scene_of(robot), robot.n
    every = {"components": ["x", "y", "z", "rx", "ry", "rz"]}
    special = columns(
        scene, robot, "base_compliance@base", "tool_compliance", base_compliance=every, tool_compliance=every
    )
    links = columns(scene, robot, "link_compliance", link_compliance={"template": "symmetric"})
    for i, component in enumerate(every["components"], 1):
        np.testing.assert_array_equal(
            special[f"base_compliance.base.{component}"], links[f"link_compliance.link0.k{i}{i}"]
        )
        np.testing.assert_array_equal(
            special[f"tool_compliance.flange.{component}"], links[f"link_compliance.link{n}.k{i}{i}"]
        )


def test_a_joint_along_a_link_axis_is_the_turning_element_of_that_link():
    robot = load_robot("kr270_2")
    scene = scene_of(robot)
    joints = columns(scene, robot, "joint_compliance")
    links = columns(scene, robot, "link_compliance", link_compliance={"template": "symmetric"})
    about = ("k66", "k55", "k55", "k44", "k55", "k44")
    for joint, element in enumerate(about):
        np.testing.assert_allclose(
            links[f"link_compliance.link{joint}.{element}"], joints[f"joint_compliance.j{joint + 1}"], atol=1e-15
        )


def test_defaults_are_tilts_of_the_base_and_bending_of_the_tool():
    scene, robot = scene_of(load_robot("kr270_2")), load_robot("kr270_2")
    names = [f"base_compliance.{place}.{axis}" for place in ("base", "column") for axis in ("rx", "ry")]
    assert list(columns(scene, robot, "base_compliance")) == names
    assert list(columns(scene, robot, "base_compliance@column")) == names[2:]
    assert list(columns(scene, robot, "tool_compliance")) == ["tool_compliance.flange.ry", "tool_compliance.flange.rz"]
    pairs = [f"joint_cross_compliance.j{i}-j{i + 1}" for i in range(1, 6)]
    assert list(columns(scene, robot, "joint_cross_compliance")) == pairs
    assert list(columns(scene, robot, "joint_cross_compliance@j4-j6")) == ["joint_cross_compliance.j4-j6"]


def test_the_column_is_the_base_at_zero_and_turns_with_joint_one():
    robot = load_robot("kr270_2")
    q = np.array([[0.0, -1.0, 1.0, 0.4, 0.5, 0.6], [np.pi / 2, -1.0, 1.0, 0.4, 0.5, 0.6]])  # A1 is positive clockwise
    springs = base_springs(forward(robot, q))
    np.testing.assert_allclose(springs.axis[0, 6:], springs.axis[0, :6], atol=1e-15)
    np.testing.assert_allclose(springs.axis[1, 9], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(springs.axis[1, 10], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(springs.origin[:, 6:], springs.origin[:, :6], atol=1e-15)


def test_column_springs_of_a_crooked_robot_move_and_bear_what_virtual_displacements_say():
    for kinds in ((False, False, True, False), (True, False, False, False), (False,)):
        robot = crooked(kinds)
        q = np.random.default_rng(2).uniform(-1, 1, (4, robot.n))
        frames = forward(robot, q)
        springs = base_springs(frames)
        zero = base_springs(forward(robot, np.zeros((1, robot.n))))
        point = frames.point(np.array([0.1, 0.2, 0.3]))
        fields = motion(springs, point[:, None])[:, 0, 6:]
        # A small displacement after joint 1, in axes that are link 0's at zero: put into the placement behind it.
        turn = forward(robot, np.zeros((1, robot.n))).rotation[0, 0].T @ robot.link_rotations[0]
        np.testing.assert_allclose(springs.axis[:, :6], np.broadcast_to(zero.axis[:, :6], (4, 6, 3)), atol=1e-14)
        for i in range(6):
            screw = np.zeros((4, 4))
            if i < 3:
                screw[:3, 3] = turn[:, i]
            else:
                screw[:3, :3] = skew(turn[:, i - 3])
            moved = []
            for step in (1e-6, -1e-6):
                placements = robot.placements.copy()
                placements[1] = (np.eye(4) + step * screw) @ placements[1]
                moved.append(forward(replace(robot, placements=placements), q).point(np.array([0.1, 0.2, 0.3])))
            slope = (moved[0] - moved[1]) / 2e-6
            np.testing.assert_allclose(slope, fields[:, i], atol=1e-8)
        weight = self_weight_torque(springs, frames)
        total = (robot.masses.sum() + robot.tool_mass) * robot.gravity_base
        np.testing.assert_allclose(weight[:, 6:9], springs.axis[:, 6:9] @ total, atol=1e-9)


def test_cross_compliance_is_reciprocal_and_the_sum_of_both_directions(robot):
    scene = scene_of(robot)
    fields = scene.joints
    found = columns(scene, robot, "joint_cross_compliance@j2-j4")["joint_cross_compliance.j2-j4"]
    shot = scene.experiment.row_shot
    expected = fields.motion[:, 1] * fields.torque[shot, 3, None] + fields.motion[:, 3] * fields.torque[shot, 1, None]
    np.testing.assert_allclose(found, 1e-6 * expected, rtol=1e-13)


def test_units_follow_the_kind_of_the_joints():
    robot = crooked((True, False, True, False))
    pairs = {"j1-j2": "urad/N", "j1-j3": "um/N", "j2-j4": "urad/Nm"}
    effects = tuple(f"joint_cross_compliance@{pair}" for pair in pairs)
    assert [parameter.unit for parameter in bind_effects(effects, robot)[0].parameters] == list(pairs.values())


def study_of(robot, effects, **changes):
    settings = {"noise": Noise(reading=3e-5), "effects": effects, "reference": "differences"} | changes
    return Study(Path("study.toml"), robot, LOADS, MARKERS, **settings)


EFFECTS = ("joint_compliance", "base_compliance", "tool_compliance", "joint_cross_compliance@j4-j5")


def test_derivatives_are_exact(robot):
    if robot.n < 5:
        effects = (*EFFECTS[:3], "joint_cross_compliance")
    else:
        effects = EFFECTS
    model = model_of(study_of(robot, effects, frame_free=False, markers_fitted=False))
    scene = scene_of(robot)
    values = np.random.default_rng(0).uniform(0.1, 2.0, len(model.names))
    found = effect_columns(model, scene, values)
    for i in range(len(values)):
        steps = [
            respond(model, scene.experiment, values + step * np.eye(len(values))[i]).deflection for step in (1, -1)
        ]
        np.testing.assert_allclose(found[:, :, i], (steps[0] - steps[1]) / 2, atol=1e-13)
    fixed = MARKERS.on_base[scene.experiment.row_marker]
    assert fixed.any()
    assert not found[fixed].any()


def poses(robot, count, seed):
    q = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.n))
    return full_experiment(q, np.tile(np.arange(len(LOADS)), (count, 1)), LOADS, MARKERS)


@pytest.mark.parametrize("noise", [0.0, 3e-5])
def test_known_compliances_are_recovered(noise):
    robot = load_robot("kr270_r2700")
    study = study_of(robot, ("joint_compliance", "base_compliance@base", *EFFECTS[2:]))
    model = model_of(study)
    truth = {"joint_compliance": 1.5, "base_compliance": 0.05, "tool_compliance": 0.6, "joint_cross_compliance": 0.3}
    values = np.array([truth.get(name.partition(".")[0], 0.0) for name in model.names])
    data = simulate(
        model, values, poses(robot, 60, 5), Noise(reading=noise or 1e-12), np.eye(4), np.random.default_rng(9)
    )
    result = identify(study, data)
    asked = [i for i in result.kept if not model.parameters[i].nuisance]
    error = result.values[asked] - values[asked]
    assert len(asked) == 11
    if noise:
        z = error / np.sqrt(np.diag(result.covariance)[asked])
        assert np.abs(z).max() < 4.0
        assert 0.3 < np.sqrt(np.mean(z**2)) < 1.8
    else:
        np.testing.assert_allclose(error, 0.0, atol=1e-8)


def test_equal_tilts_of_base_and_column_are_the_same_and_this_is_said():
    robot = load_robot("kr270_r2700")
    study = study_of(robot, ("base_compliance",))
    model = model_of(study)
    values = np.array([{"base": 0.06, "column": 0.02}.get(name.split(".")[1], 0.0) for name in model.names])
    data = simulate(model, values, poses(robot, 30, 5), Noise(reading=1e-12), np.eye(4), np.random.default_rng(9))
    result = identify(study, data)
    assert list(result.parameters) == [f"base_compliance.{name}" for name in ("base.rx", "base.ry", "column.rx")]
    np.testing.assert_allclose(list(result.parameters.values()), [0.08, 0.08, 0.0], atol=1e-8)
    assert result.misfit.maximum < 1e-10


@pytest.mark.parametrize(
    ("effect", "options", "words"),
    [
        ("base_compliance@foot", {}, "base_compliance@foot: no such place; allowed: base, column"),
        ("tool_compliance@j6", {}, "allowed: flange"),
        (
            "tool_compliance",
            {"components": ["rw"]},
            r"\[model.tool_compliance\] components = \['rw'\]: a list of x, y, z",
        ),
        ("base_compliance", {"components": []}, "components = "),
        ("base_compliance", {"axes": ["rx"]}, r"\[model.base_compliance\] axes: unknown key; allowed: components"),
        ("joint_cross_compliance@j4-j9", {}, "j4-j9: no such place; a pair of joints of j1 ... j6"),
        ("joint_cross_compliance@j5-j4", {}, "ascending order"),
        ("joint_cross_compliance@j4", {}, "for example j1-j2"),
    ],
)
def test_what_is_wrong_is_said(effect, options, words):
    with pytest.raises(InputError, match=words) as caught:
        bind_effects((effect,), load_robot("kr270_2"), options={effect.partition("@")[0]: options})
    assert caught.value.exit_code == 2


def test_a_single_joint_has_no_pair():
    with pytest.raises(InputError, match="has one joint, a pair needs two"):
        bind_effects(("joint_cross_compliance",), load_robot("single_joint"))


def test_a_column_of_zeros_is_explained():
    robot = load_robot("kr270_2")
    effects = bind_effects(("base_compliance", "joint_cross_compliance"), robot)
    assert "turns about x of the base" in effects[0].why_zero(0)
    assert "joint 1 or joint 2" in effects[1].why_zero(0)
