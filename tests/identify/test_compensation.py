"""Compensated targets of a loaded arm: by joints, by mirrored poses, sample by sample; how sure the rest is; maps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from identify.alignment import inverse
from identify.arrays import skew
from identify.compensation import compensate, joint_matrix
from identify.equilibrium import equilibrium
from identify.error_map import error_map, hung_weight, spread_poses
from identify.errors import Infeasible, InputError, NoConvergence
from identify.experiment import full_experiment
from identify.identification import identify
from identify.inverse_kinematics import joints_near, least_motion
from identify.kinematics import flange_poses, forward, jacobian
from identify.loads import LoadCase, Markers
from identify.loop_compensator import loop_compensator
from identify.model import model_of
from identify.robot_files import load_robot
from identify.rotations import pose_errors, quaternions
from identify.tool_response import Targets, arm_of, point_covariances, tool_poses, tool_response
from tests.identify.reference_robots import gantry
from tests.identify.studies import (
    COMPLIANCE,
    geometry_errors,
    kr270_study,
    measured,
    poses,
    random_robot,
    study_of,
    values_of,
)

KNOWN = {"frame_free": False, "markers_fitted": False}
COMPLETE = ("joint_compliance", "link_compliance", "gravity_compensator", "geometry", "transmission_error@j2")
OPTIONS = {"gravity_compensator": {"mode": "harmonics"}, "link_compliance": {"template": "beam"}}


def arm_with(study, values, spread=0.02):
    """The arm of a stated model; ``spread``: relative standard deviation of its parameters."""
    model = model_of(study)
    stated = values_of(model, values)
    return arm_of(model, stated, np.diag((spread * np.abs(stated)) ** 2))


def targets_of(study, count, *, seed=1, force=1200.0, moment=0.0, q=None):
    """Random poses under forces of one size in any direction, half of them turning with the flange."""
    rng = np.random.default_rng(seed)
    given = poses(study, count, rng) if q is None else q
    if q is None and study.robot.n == 6:
        given[:, 4] = np.where(np.abs(given[:, 4]) < 0.1, 0.6, given[:, 4])  # away from the singular wrist
    wrench = rng.normal(size=(count, 2, 3))
    wrench *= np.array([force, moment])[:, None] / np.linalg.norm(wrench, axis=2, keepdims=True)
    attach = np.tile([0.1, -0.03, 0.2], (count, 1))
    names = tuple(f"T{i + 1}" for i in range(count))
    return Targets(names, given, wrench.reshape(count, 6), np.arange(count) % 2 == 0, attach)


def complete(rng, **changes):
    """A heavy arm in which everything yields, and its parameters."""
    study = kr270_study(**KNOWN, effects=COMPLETE, options=OPTIONS, **changes)
    values = {**COMPLIANCE, **geometry_errors(study.robot, rng)}
    for p in model_of(study).parameters:
        if p.name.startswith("link_compliance") and p.name[-2] == p.name[-1]:
            values[p.name] = float(rng.uniform(0.5, 1.0)) * {"um/N": 0.01, "urad/Nm": 0.1}[p.unit]
        elif p.name.startswith(("gravity_compensator", "transmission_error")):
            values[p.name] = float(rng.normal(0, 80.0))
    known = {parameter.name for parameter in model_of(study).parameters}
    return study, {name: value for name, value in values.items() if name in known}


def size(vectors):
    return np.linalg.norm(vectors, axis=1)


# ---- real poses


def test_quaternions_have_a_positive_real_part_and_give_the_rotation_back():
    turns = Rotation.random(30, rng=2)
    found = quaternions(turns.as_matrix())
    assert (found[:, 0] >= 0).all()
    np.testing.assert_allclose(Rotation.from_quat(found[:, [1, 2, 3, 0]]).as_matrix(), turns.as_matrix(), atol=1e-14)


def test_an_arm_that_does_not_yield_stands_at_its_nominal_pose():
    study = kr270_study(**KNOWN)
    targets = targets_of(study, 20)
    expected = flange_poses(study.robot, targets.q)
    np.testing.assert_allclose(tool_poses(arm_with(study, {}), targets), expected, atol=1e-14)


@pytest.mark.parametrize("in_flange", [True, False], ids=["flange", "world"])
@pytest.mark.parametrize("loaded", ["linear", "loaded"])
def test_real_poses_carry_markers_where_the_same_load_case_does(loaded, in_flange):
    study = kr270_study(**KNOWN, equilibrium=loaded, mount=(0.3, -0.5, 1.0))
    targets = targets_of(study, 6, moment=200.0)
    wrench, attach = targets.wrench[0], np.array([0.3, 0.1, -0.2])
    same = replace(
        targets, wrench=np.tile(wrench, (6, 1)), in_flange=np.full(6, in_flange), attach=np.tile(attach, (6, 1))
    )
    arm = arm_with(study, COMPLIANCE)
    load = LoadCase("L1", attach=attach, force=wrench[:3], moment=wrench[3:], in_flange=in_flange)
    points = Markers(("A", "B"), np.array([[0.0, 0, 0], [0.2, -0.1, 0.3]]), np.zeros(2, dtype=bool))
    experiment = full_experiment(targets.q, np.zeros((6, 1), dtype=np.int64), (load,), points)
    found = tool_poses(arm, same)
    carried = found[:, None, :3, 3] + points.positions @ found[:, :3, :3].swapaxes(1, 2)
    if loaded == "loaded":
        expected = equilibrium(arm.model, experiment, arm.values).positions.reshape(6, 2, 3)
        np.testing.assert_allclose(carried, expected, atol=1e-11)
        return
    torque = np.einsum("ij,vi->vj", np.eye(6), _torques(study.robot, targets.q, load))
    yielded = torque * np.array(list(COMPLIANCE.values())) * 1e-6
    moved = np.einsum("vij,vj->vi", jacobian(forward(study.robot, targets.q), found[:, :3, 3]), yielded)
    np.testing.assert_allclose(
        found[:, :3, 3] - flange_poses(study.robot, targets.q)[:, :3, 3], moved[:, :3], atol=3e-5
    )
    turned = pose_errors(found, flange_poses(study.robot, targets.q))[:, 3:]
    np.testing.assert_allclose(turned, moved[:, 3:], atol=1e-7)


def _torques(robot, q, load):
    """Load and self-weight on each joint, by the principle of virtual work on single bodies."""
    frames = forward(robot, q)
    turn = frames.flange_rotation if load.in_flange else np.broadcast_to(robot.world_R_base.T, (len(q), 3, 3))
    there = jacobian(frames, frames.point(load.attach))
    torque = np.einsum("vij,vi->vj", there[:, :3], turn @ load.force) + np.einsum(
        "vij,vi->vj", there[:, 3:], turn @ load.moment
    )
    for link, mass in enumerate(robot.masses):
        centre = jacobian(frames, frames.centre[:, link])[:, :3, : link + 1]
        torque[:, : link + 1] += mass * np.einsum("vij,i->vj", centre, robot.gravity_base)
    return torque


@pytest.mark.parametrize("loaded", ["linear", "loaded"])
def test_the_derivative_of_a_pose_is_what_changed_parameters_do(loaded):
    study, values = complete(np.random.default_rng(3), equilibrium=loaded)
    arm = arm_with(study, values)
    targets = targets_of(study, 4, moment=100.0)
    derivative = tool_response(arm, targets).derivative
    largest = np.abs(derivative).max(axis=(0, 1))
    for column in range(len(arm.values)):
        step = 1e-3 * np.eye(len(arm.values))[column]
        ahead, behind = (tool_poses(replace(arm, values=arm.values + sign * step), targets) for sign in (1, -1))
        change = pose_errors(ahead, behind) / 2e-3
        # effects without springs count on the undeflected arm in the derivative of the others: second order
        tolerance = 0.02 * largest[column] + 1e-12
        np.testing.assert_allclose(derivative[:, :, column], change, atol=tolerance, err_msg=arm.model.names[column])


@pytest.mark.parametrize("softer", [1.0, 30.0])
def test_turns_are_differentiated_to_the_share_that_the_deflection_is_of_a_radian(softer):
    study = kr270_study(**KNOWN)
    arm = arm_with(study, {name: softer * value for name, value in COMPLIANCE.items()})
    targets = targets_of(study, 5)
    derivative = tool_response(arm, targets).derivative[:, :, 2]
    step = 1e-3 * np.eye(6)[2]
    ahead, behind = (tool_poses(replace(arm, values=arm.values + sign * step), targets) for sign in (1, -1))
    turned = pose_errors(tool_poses(arm, targets), flange_poses(study.robot, targets.q))[:, 3:]
    off = np.abs(derivative - pose_errors(ahead, behind) / 2e-3).max() / np.abs(derivative).max()
    assert off < np.linalg.norm(turned, axis=1).max() + 1e-9


def test_instrument_and_wrong_measured_loads_do_not_move_the_arm():
    effects = ("tracker_scale", "joint_compliance", "load_scale", "load_com", "marker_seating")
    study = kr270_study(**KNOWN, effects=effects)
    values = {**COMPLIANCE, "tracker_scale.all": 300.0, "load_scale.all": 5.0, "load_com.x": 40.0}
    values = {name: value for name, value in values.items() if name in model_of(study).names}
    assert len(values) > len(COMPLIANCE)
    targets = targets_of(study, 5)
    found = arm_with(study, values)
    assert [effect.name for effect in found.model.effects] == ["joint_compliance"]
    np.testing.assert_array_equal(
        tool_poses(found, targets), tool_poses(arm_with(kr270_study(**KNOWN), COMPLIANCE), targets)
    )


# ---- the two forms


@pytest.mark.parametrize("form", ["joint", "mirror"])
def test_one_pass_of_a_linear_arm_leaves_a_thousandth_and_more_passes_nothing(form):
    study = kr270_study(**KNOWN)
    arm, targets = arm_with(study, COMPLIANCE), targets_of(study, 200)
    one, two, settled = (compensate(arm, targets, form, passes) for passes in (1, 2, 10))
    assert 1e-3 < size(one.before).mean() < 5e-3
    assert size(one.residual).max() < 0.01 * size(one.before).max()
    assert size(one.residual).mean() < 3e-3 * size(one.before).mean()
    assert size(two.residual).max() < 1e-3 * size(two.before).max()
    assert size(settled.residual).max() < 1e-8
    assert settled.residual_turn.max() < 1e-8
    assert settled.passes < 10


def test_the_joint_form_is_exact_in_one_shot_on_the_loaded_arm():
    study = kr270_study(**KNOWN, equilibrium="loaded")
    arm, targets = arm_with(study, COMPLIANCE), targets_of(study, 100)
    found = compensate(arm, targets, "joint", passes=1)
    assert size(found.before).min() > 1e-5
    assert size(found.residual).max() < 1e-11
    mirrored = compensate(arm, targets, "mirror", passes=2)
    assert size(mirrored.residual).max() < 1e-6
    np.testing.assert_allclose(mirrored.command, found.command, atol=1e-6)


@pytest.mark.parametrize("form", ["joint", "mirror"])
@pytest.mark.parametrize("loaded", ["linear", "loaded"])
def test_a_complete_model_is_compensated_to_less_than_a_micrometre(loaded, form):
    study, values = complete(np.random.default_rng(5), equilibrium=loaded)
    targets = targets_of(study, 40, moment=150.0)
    found = compensate(arm_with(study, values), targets, form)
    assert size(found.before).mean() > 1e-3
    assert size(found.residual).max() < 1e-6
    assert found.residual_turn.max() < 1e-6
    np.testing.assert_allclose(found.command, flange_poses(study.robot, found.q), atol=1e-15)


@pytest.mark.parametrize(
    "robot",
    [random_robot(np.random.default_rng(4), (False, True, False, True, False, False)), gantry()],
    ids=["crooked", "gantry"],
)
def test_sliding_joints_are_corrected_too(robot):
    study = study_of(
        replace(robot, lower=np.full(robot.n, -9.0), upper=np.full(robot.n, 9.0)), **KNOWN, equilibrium="loaded"
    )
    values = {p.name: (0.3 if p.unit == "um/N" else 2.0) for p in model_of(study).parameters}
    targets = targets_of(study, 30, force=600.0)
    found = compensate(arm_with(study, values), targets, passes=1)
    slides = study.robot.prismatic
    assert np.abs((found.q - targets.q)[:, slides]).max() > 1e-5
    assert size(found.residual).max() < 1e-11


def test_a_redundant_arm_takes_what_joints_do_not_do_by_the_least_motion():
    robot = replace(load_robot("sda5f_r1"), masses=np.full(8, np.nan))
    study = study_of(robot, **KNOWN, effects=("link_compliance",))
    values = {p.name: 0.05 for p in model_of(study).parameters if p.unit == "um/N" and p.name[-2] == p.name[-1]}
    targets = targets_of(study, 20, force=60.0, q=np.random.default_rng(3).uniform(-0.9, 0.9, (20, 8)))
    found = compensate(arm_with(study, values), targets)
    assert size(found.residual).max() < 1e-9
    frames = forward(robot, targets.q)
    jac = jacobian(frames, frames.flange_origin)
    change = found.q - targets.q
    null = np.eye(8) - np.linalg.pinv(jac) @ jac
    assert size((null @ change[..., None])[..., 0]).max() < 1e-3 * size(change).max()


def test_joints_of_a_redundant_arm_come_back_to_their_own_values():
    study = study_of(load_robot("sda5f_r1"), **KNOWN, equilibrium="loaded")
    arm = arm_with(study, {p.name: 20.0 for p in model_of(study).parameters})
    targets = targets_of(study, 10, force=60.0, q=np.random.default_rng(3).uniform(-0.9, 0.9, (10, 8)))
    found = compensate(arm, targets, passes=1)
    scene = tool_response(arm, targets.at(found.q), derivative=False).scene
    np.testing.assert_allclose(found.q + scene.torque("joints") @ joint_matrix(arm).T, targets.q, atol=1e-12)


def test_compensation_with_an_identified_model_removes_nine_tenths_of_a_true_deflection():
    study = kr270_study(frame_free=True)
    result = identify(study, measured(study, np.random.default_rng(8), count=15))
    covariance = np.zeros((len(result.values),) * 2)
    covariance[np.ix_(result.kept, result.kept)] = result.covariance[np.ix_(result.kept, result.kept)]
    fitted = arm_of(result.model, result.values, covariance)
    targets = targets_of(study, 100)
    down = replace(targets, wrench=np.tile([0.0, 0, -1500, 0, 0, 0], (100, 1)), in_flange=np.zeros(100, dtype=bool))
    found = compensate(fitted, down)
    truth = arm_with(study, COMPLIANCE)
    remains = tool_poses(truth, down.at(found.q))[:, :3, 3] - flange_poses(study.robot, down.q)[:, :3, 3]
    before = tool_poses(truth, down)[:, :3, 3] - flange_poses(study.robot, down.q)[:, :3, 3]
    assert size(remains).max() < 0.1 * size(before).max()
    assert (fitted.held == [name.endswith("j1") for name in fitted.model.names]).all()


def test_the_stated_radius_holds_95_percent_of_the_errors():
    study = kr270_study(**KNOWN)
    rng = np.random.default_rng(6)
    root = np.tril(rng.normal(0, 0.02, (6, 6))) * np.array(list(COMPLIANCE.values()))[:, None]
    model = model_of(study)
    arm = arm_of(model, values_of(model, COMPLIANCE), root @ root.T)
    targets = targets_of(study, 25)
    found = compensate(arm, targets)
    wished = flange_poses(study.robot, targets.q)
    lever = targets.attach[..., None]
    inside = np.zeros(25)
    for _ in range(400):
        other = replace(arm, values=arm.values + root @ rng.normal(size=6))
        real = tool_poses(other, targets.at(found.q))
        error = (real[:, :3] - wished[:, :3]) @ np.concatenate([lever, np.ones((25, 1, 1))], axis=1)
        inside += size(error[..., 0]) <= found.radius95
    assert 0.93 < inside.mean() / 400 < 0.97


def test_covariance_is_that_of_the_attach_point():
    study = kr270_study(**KNOWN)
    arm, targets = arm_with(study, COMPLIANCE), targets_of(study, 5)
    covariance, answer = point_covariances(arm, targets)
    response = tool_response(arm, targets)
    lever = (response.pose[:, :3, :3] @ targets.attach[..., None])[..., 0]
    rows = response.derivative[:, :3] - skew(lever) @ response.derivative[:, 3:]
    np.testing.assert_allclose(covariance, rows @ arm.covariance @ rows.swapaxes(1, 2), rtol=1e-12)
    np.testing.assert_allclose(answer, np.linalg.norm(rows, axis=1).max(axis=0), rtol=1e-12)


# ---- what cannot be done


def test_a_command_outside_the_joint_limits_is_refused_with_joint_and_value():
    study = kr270_study(**KNOWN, masses=False)
    targets = targets_of(study, 3)
    q = targets.q.copy()
    q[1] = np.radians([0.0, -140.0, 0.0, 0.0, 30.0, 0.0])  # leaning back, at the limit; a force upwards sets it upright
    upwards = np.tile([0.0, 0, 3000.0, 0, 0, 0], (3, 1))
    with pytest.raises(
        Infeasible, match=r"target T2: joint 2 would be commanded to -140\.\d+ deg, allowed are -140 to -5 deg"
    ):
        compensate(
            arm_with(study, COMPLIANCE), replace(targets, q=q, wrench=upwards, in_flange=np.zeros(3, dtype=bool))
        )


def test_a_mirrored_pose_that_an_arm_with_few_joints_cannot_take_is_refused():
    study = study_of(load_robot("arm_3dof"), **KNOWN)
    arm = arm_with(study, {p.name: 5.0 for p in model_of(study).parameters})
    targets = targets_of(study, 2, q=np.array([[0.3, 0.4, 0.5], [0.1, -0.3, 0.8]]))
    with pytest.raises(Infeasible, match=r"target T1 \(and 1 more\): its mirrored pose is not reached"):
        compensate(arm, targets, "mirror")
    found = compensate(arm, targets, "joint")
    assert size(found.residual).max() < 0.01 * size(found.before).min()


def yielding_foot():
    """An arm on a foot that tilts by 1 mrad for each kNm, and a target with a singular wrist."""
    study = kr270_study(**KNOWN, effects=("base_compliance@base",), equilibrium="loaded", masses=False)
    arm = arm_with(study, {"base_compliance.base.rx": 1.0, "base_compliance.base.ry": 1.0})
    targets = targets_of(study, 2, q=np.radians([[20.0, -60, 90, 30, 40, 10], [20.0, -60, 90, 30, 0, 10]]))
    down = np.tile([300.0, 500.0, -1500.0, 0, 0, 0], (2, 1))
    return arm, replace(targets, wrench=down, in_flange=np.zeros(2, dtype=bool))


def test_a_singular_wrist_is_not_thrown_around_for_what_it_cannot_do():
    arm, targets = yielding_foot()
    found = compensate(arm, targets)
    assert size(found.before).min() > 1e-3
    assert np.abs(found.q - targets.q).max() < 0.05
    assert size(found.residual)[0] < 1e-8
    assert size(found.residual)[1] < 0.02 * size(found.before)[1]  # position first
    assert found.residual_turn[1] > 1e-4


def test_a_command_far_from_its_target_is_refused():
    arm, targets = yielding_foot()
    with pytest.raises(Infeasible, match=r"target T2: joint [46] would be moved by -?\d+\.?\d* deg .*nearly singular"):
        compensate(arm, targets, "mirror")
    soft = arm_with(kr270_study(**KNOWN, masses=False), {"joint_compliance.j2": 900.0})
    with pytest.raises(Infeasible, match="joint 2 would be moved by"):
        compensate(soft, targets)


def test_directions_that_ask_for_too_much_are_left_out():
    robot = kr270_study().robot
    q = np.radians([[10.0, -60, 90, 30, 0.5, 10]])
    wanted = np.array([[1e-3, 0, 0, 0, 0, 1e-3]])
    frames = forward(robot, q)
    jac = jacobian(frames, frames.flange_origin)[0]
    exact = least_motion(robot, q, wanted)[0]
    np.testing.assert_allclose(jac @ exact, wanted[0], atol=1e-12)
    assert np.abs(exact).max() > 0.02
    small = least_motion(robot, q, wanted, largest=0.01)[0]
    assert np.abs(small).max() < 0.01
    assert np.linalg.norm(jac[:3] @ small - wanted[0, :3]) < 0.02e-3


def test_inverse_kinematics_finds_the_branch_it_starts_from():
    study = kr270_study()
    q = poses(study, 30, np.random.default_rng(2))
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.3, 0.5, q[:, 4])
    found = joints_near(study.robot, flange_poses(study.robot, q), q + 0.01)
    np.testing.assert_allclose(found, q, atol=1e-8)
    away = flange_poses(study.robot, q)
    away[3, :3, 3] += 9.0
    with pytest.raises(NoConvergence) as error:
        joints_near(study.robot, away, q)
    np.testing.assert_array_equal(np.flatnonzero(error.value.best), [3])


def test_the_least_motion_of_a_short_arm_favours_position():
    robot = load_robot("arm_3dof")
    q = np.array([[0.3, 0.4, 0.5]])
    frames = forward(robot, q)
    wanted = np.array([[1e-4, -2e-4, 1e-4, 0.0, 0.0, 0.0]])
    moved = jacobian(frames, frames.flange_origin)[0] @ least_motion(robot, q, wanted)[0]
    assert np.linalg.norm(moved[:3] - wanted[0, :3]) < 0.1 * np.linalg.norm(wanted)


@pytest.mark.parametrize(("key", "value", "message"), [
    ("wrench", np.zeros((3, 5)), r"wrench has shape \(3, 5\), expected \(3, 6\)"),
    ("q", np.full((3, 6), np.nan), r"q of target T1 is not finite"),
    ("attach", np.zeros((2, 3)), r"attach has shape \(2, 3\), expected \(3, 3\)"),
])  # fmt: skip
def test_malformed_targets_are_refused(key, value, message):
    with pytest.raises(InputError, match=message):
        replace(targets_of(kr270_study(), 3), **{key: value})


def test_no_targets_are_refused():
    nothing = np.zeros((0, 6))
    with pytest.raises(InputError, match="targets: there are none"):
        Targets((), nothing, nothing, np.zeros(0, dtype=bool), np.zeros((0, 3)))
    arm = arm_with(kr270_study(**KNOWN), COMPLIANCE)
    with pytest.raises(InputError, match="targets: there are none"):
        error_map(arm, nothing, np.zeros(6))


def test_more_targets_than_are_computed_at_once_are_the_same(monkeypatch):
    study, values = complete(np.random.default_rng(5))
    arm, targets = arm_with(study, values), targets_of(study, 11)
    whole = compensate(arm, targets)
    monkeypatch.setattr("identify.tool_response._CHUNK", 4)
    parts = compensate(arm, targets)
    np.testing.assert_allclose(parts.q, whole.q, atol=1e-13)
    np.testing.assert_allclose(parts.radius95, whole.radius95, rtol=1e-9)


def test_no_pass_and_unknown_forms_are_refused():
    study = kr270_study(**KNOWN)
    with pytest.raises(InputError, match="form = 'both': allowed are joint, mirror"):
        compensate(arm_with(study, COMPLIANCE), targets_of(study, 1), "both")
    with pytest.raises(InputError, match="passes = 0: at least 1 expected"):
        compensate(arm_with(study, COMPLIANCE), targets_of(study, 1), passes=0)


def test_placements_are_inverted_many_at_a_time():
    placements = flange_poses(kr270_study().robot, poses(kr270_study(), 5, np.random.default_rng(0)))
    np.testing.assert_allclose(inverse(placements) @ placements, np.broadcast_to(np.eye(4), (5, 4, 4)), atol=1e-14)
    np.testing.assert_array_equal(inverse(placements)[2], inverse(placements[2]))


# ---- the control loop


@pytest.mark.parametrize("slides", [False, True])
def test_a_loop_corrects_like_the_joint_form(slides):
    robot = random_robot(np.random.default_rng(4), (False, slides, False, False, False, False))
    study = study_of(robot, **KNOWN, effects=("joint_compliance", "joint_cross_compliance@j2-j3"))
    values = {p.name: 2.0 for p in model_of(study).parameters}
    arm, targets = arm_with(study, values), targets_of(study, 10, force=300.0, moment=40.0)
    targets = replace(targets, in_flange=np.ones(10, dtype=bool), q=0.5 * targets.q)
    together = compensate(arm, targets, passes=1)
    loop = loop_compensator(arm, targets.attach[0])
    for row in range(10):
        sample = loop.correction(targets.q[row], targets.wrench[row])
        np.testing.assert_allclose(sample.q, together.q[row], atol=1e-14)
        np.testing.assert_allclose(sample.pose, together.command[row], atol=1e-13)
        np.testing.assert_array_equal(sample.q, targets.q[row] + sample.change)


def test_a_loop_refuses_effects_it_cannot_take_back():
    study, values = complete(np.random.default_rng(1))
    with pytest.raises(
        InputError, match="the model holds link_compliance, gravity_compensator, geometry, transmission_error"
    ):
        loop_compensator(arm_with(study, values))


@pytest.mark.parametrize("wrench", [[0.0, 0, np.nan, 0, 0, 0], [0.0, 0, 0], np.zeros((1, 6))])
def test_a_loop_does_not_move_on_a_broken_sample(wrench):
    study = kr270_study(**KNOWN)
    with pytest.raises(InputError, match="6 finite numbers expected"):
        loop_compensator(arm_with(study, COMPLIANCE)).correction(np.zeros(6), wrench)


# ---- maps


def test_a_map_shows_the_errors_of_the_real_poses():
    study = kr270_study(**KNOWN)
    arm = arm_with(study, COMPLIANCE)
    q = spread_poses(study.robot, 50, np.random.default_rng(0))
    weight = hung_weight(study.robot, 100.0)
    attach = np.array([0.0, 0.1, 0.2])
    found = error_map(arm, q, weight, attach=attach)
    np.testing.assert_allclose(weight, [0, 0, -980.665, 0, 0, 0])
    targets = Targets(("P",) * 50, q, np.tile(weight, (50, 1)), np.zeros(50, dtype=bool), np.tile(attach, (50, 1)))
    errors = pose_errors(tool_poses(arm, targets), flange_poses(study.robot, q))
    np.testing.assert_allclose(found.position, size(errors[:, :3]), rtol=1e-12)
    np.testing.assert_allclose(found.orientation, size(errors[:, 3:]), rtol=1e-9)
    np.testing.assert_allclose(found.place, flange_poses(study.robot, q)[:, :3, 3])


def test_against_the_unloaded_arm_self_weight_does_not_count():
    study = kr270_study(**KNOWN)
    arm = arm_with(study, COMPLIANCE)
    light = arm_with(kr270_study(**KNOWN, masses=False), COMPLIANCE)
    q = spread_poses(study.robot, 30, np.random.default_rng(1))
    force = np.array([0.0, 400.0, -900.0, 0.0, 0.0, 0.0])
    loaded = error_map(arm, q, force, against="unloaded")
    np.testing.assert_allclose(loaded.position, error_map(light, q, force).position, rtol=5e-3, atol=1e-6)
    assert error_map(arm, q, 0.0 * force, against="unloaded").position.max() == 0.0
    assert error_map(arm, q, 0.0 * force).position.max() > 1e-4


def test_poses_of_a_map_fill_the_joint_limits_and_need_them():
    robot = kr270_study().robot
    q = spread_poses(robot, 500, np.random.default_rng(0))
    assert ((q >= robot.lower) & (q <= robot.upper)).all()
    np.testing.assert_allclose(q.mean(axis=0), (robot.lower + robot.upper) / 2, atol=0.02 * np.ptp(q))
    with pytest.raises(InputError, match="limits of joint 1 are unknown"):
        spread_poses(gantry(), 10, np.random.default_rng(0))
    with pytest.raises(InputError, match="0 poses asked for"):
        spread_poses(robot, 0, np.random.default_rng(0))
