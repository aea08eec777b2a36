"""Blocks and target rows against dense formulas written out in the test."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from doe.objective import objective
from doe.observations import identifiable, keep_columns, observer, stacked_visits, target_rows
from identify.arrays import frozen
from identify.errors import InputError, NotIdentifiable
from identify.experiment import full_experiment
from identify.kinematics import forward, jacobian
from identify.study import TestPose, Tracker
from tests.doe.study_files import ARM, KR270, study

MICRO = 1e-6


def poses_of(robot, count, seed):
    """Random joint values within the limits and one turn."""
    rng = np.random.default_rng(seed)
    return rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (count, robot.n))


def wrench_of(load, frames, robot):
    """Force (N, 3) and moment (N, 3) of a load about its attach point, base frame."""
    turn = (
        frames.flange_rotation if load.in_flange else np.broadcast_to(robot.world_R_base.T, (len(frames.origin), 3, 3))
    )
    weight = load.mass * robot.gravity_base
    return turn @ load.force + weight, turn @ load.moment


def marker_jacobian(frames, local):
    """(N, 3, n) motion of a point of the flange."""
    return jacobian(frames, frames.point(np.broadcast_to(local, (len(frames.origin), 3))))[:, :3]


def joint_torque(frames, load, robot):
    """(N, n) torque of a load on every joint: J' W at the attach point."""
    at_load = jacobian(frames, frames.point(np.broadcast_to(load.attach, (len(frames.origin), 3))))
    force, moment = wrench_of(load, frames, robot)
    return np.einsum("nij,ni->nj", at_load, np.concatenate([force, moment], axis=1))


def dense_rows(made, q, visit_loads):
    """For each visit the readings' derivative (3 m, p) with frame and markers, and their covariance (3 m, 3 m)."""
    robot, markers, noise = made.robot, made.markers, made.noise
    frames = forward(robot, q)
    shots, reflectors = visit_loads.shape[1], len(markers.names)
    size = 3 * shots * reflectors
    columns = np.zeros((len(q), shots, reflectors, 3, 6 + 3 * reflectors + robot.n))
    motion = np.stack([marker_jacobian(frames, local) for local in markers.positions], axis=1)
    point = np.stack([frames.point(np.broadcast_to(local, (len(q), 3))) for local in markers.positions], axis=1)
    for visit in range(len(q)):
        for shot, load in enumerate(visit_loads[visit]):
            torque = joint_torque(frames, made.loads[load], robot)[visit]
            for k in range(reflectors):
                rows = columns[visit, shot, k]
                x, y, z = point[visit, k]
                rows[:, :3] = 1e-3 * np.eye(3)
                rows[:, 3:6] = 1e-3 * np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
                rows[:, 6 + 3 * k : 9 + 3 * k] = 1e-3 * frames.flange_rotation[visit]
                rows[:, 6 + 3 * reflectors :] = MICRO * motion[visit, k] * torque
    covariance = np.zeros((len(q), size, size))
    for visit in range(len(q)):
        spread = np.tile(motion[visit].reshape(-1, robot.n), (shots, 1))
        own = np.kron(np.eye(shots), np.ones((3 * reflectors, 3 * reflectors)))
        covariance[visit] = (noise.pose_jitter**2 + noise.reading_jitter**2 * own) * (spread @ spread.T)
        for row in range(shots * reflectors):
            part = slice(3 * row, 3 * row + 3)
            covariance[visit, part, part] += instrument(noise, point[visit, row % reflectors])
    return columns.reshape(len(q), size, -1), covariance


def instrument(noise, point):
    """Covariance of one reading, (3, 3)."""
    if noise.tracker is None:
        return noise.reading**2 * np.eye(3)
    beam = point - noise.tracker.station
    distance = np.linalg.norm(beam)
    along = np.outer(beam, beam) / distance**2
    radial = noise.tracker.radial + noise.tracker.radial_per_m * distance
    transverse = noise.tracker.transverse + noise.tracker.transverse_per_m * distance
    return radial**2 * along + transverse**2 * (np.eye(3) - along)


def kr270(folder, **changes):
    """The heavy arm at zero nominal compliance, so that markers do not bend it."""
    return study(folder, KR270, **changes)


def with_tracker(made):
    """The same study read by a tracker that stands beside the robot."""
    tracker = Tracker(8e-6, 3e-6, 15e-6, 9e-6, frozen([2.5, -1.5, 0.8]))
    return replace(made, noise=replace(made.noise, tracker=tracker))


@pytest.mark.parametrize("tracker", [False, True], ids=["plain", "tracker"])
def test_absolute_blocks_carry_the_information_of_the_explicit_covariance(tmp_path, tracker):
    made = kr270(tmp_path, model={"reference": "absolute"}, robot={"mount_deg": [20.0, -30.0, 40.0]})
    made = with_tracker(made) if tracker else made
    q = poses_of(made.robot, 5, seed=1)
    loads = np.array([[0, 1, 2]] * 3 + [[0, 2, 1]] * 2)
    watching = observer(made)
    blocks = watching.blocks(q, loads)
    assert watching.model.names[:6] == tuple(f"frame.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))
    assert blocks.shape == (5, 27, 6 + 9 + 6)
    for block, rows, covariance in zip(blocks, *dense_rows(made, q, loads), strict=True):
        expected = rows.T @ np.linalg.inv(covariance) @ rows
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-300
        np.testing.assert_allclose((block.T @ block) / scale, expected / scale, atol=1e-9)


@pytest.mark.parametrize("tracker", [False, True], ids=["plain", "tracker"])
def test_blocks_of_differences_are_those_of_free_offsets(tmp_path, tracker):
    """A free offset of each marker in each visit, projected out of the full covariance."""
    made = kr270(tmp_path, model={"reference": "differences"}, robot={"mount_deg": [0.0, 180.0, 10.0]})
    made = with_tracker(made) if tracker else made
    q = poses_of(made.robot, 5, seed=2)
    loads = np.array([[0, 1, 2]] * 5)
    watching = observer(made)
    blocks = watching.blocks(q, loads)
    assert watching.model.names == tuple(f"joint_compliance.j{j + 1}" for j in range(6))
    assert blocks.shape == (5, 18, 6)
    offsets = np.tile(np.eye(9), (3, 1))
    for block, rows, covariance in zip(blocks, *dense_rows(made, q, loads), strict=True):
        weight = np.linalg.inv(covariance)
        middle = np.linalg.inv(offsets.T @ weight @ offsets)
        elastic = rows[:, 15:]
        expected = elastic.T @ (weight - weight @ offsets @ middle @ offsets.T @ weight) @ elastic
        scale = np.linalg.norm(expected)
        np.testing.assert_allclose(block.T @ block, expected, atol=1e-9 * scale)


def test_pose_jitter_is_common_to_a_visit_and_cancels_from_differences(tmp_path):
    made = kr270(tmp_path, model={"reference": "differences"})
    q, loads = poses_of(made.robot, 4, seed=3), np.array([[0, 1]] * 4)
    calm = replace(made, noise=replace(made.noise, pose_jitter=0.0))
    np.testing.assert_allclose(observer(made).blocks(q, loads), observer(calm).blocks(q, loads), rtol=1e-9)
    shaky = replace(made, noise=replace(made.noise, reading_jitter=1e-4))
    less = np.linalg.norm(observer(shaky).blocks(q, loads)) / np.linalg.norm(observer(made).blocks(q, loads))
    assert less < 0.5


def test_visits_of_different_layouts_carry_what_they_carry_alone(tmp_path):
    made = kr270(tmp_path, model={"reference": "differences"})
    q = poses_of(made.robot, 6, seed=4)
    watching = observer(made)
    short = full_experiment(q[:3], np.array([[0, 1]] * 3), made.loads, made.markers)
    long = full_experiment(q[3:], np.array([[0, 1, 2]] * 3), made.loads, made.markers)
    count, shots = len(short.visits), len(short.shot_visit)
    both = replace(
        short,
        visits=tuple(f"P{i}" for i in range(6)),
        q=q,
        shot_visit=np.append(short.shot_visit, count + long.shot_visit),
        shot_pose=np.append(short.shot_pose, count + long.shot_pose),
        shot_load=np.append(short.shot_load, long.shot_load),
        shot_repeat=np.append(short.shot_repeat, long.shot_repeat),
        row_shot=np.append(short.row_shot, shots + long.row_shot),
        row_marker=np.append(short.row_marker, long.row_marker),
    )
    blocks = stacked_visits(watching, both)
    assert blocks.shape == (6, 18, 6)
    alone = np.concatenate([stacked_visits(watching, part).reshape(-1, 6) for part in (short, long)])
    rows = blocks.reshape(-1, 6)
    np.testing.assert_allclose(rows.T @ rows, alone.T @ alone, rtol=1e-12)


def test_a_tracker_without_station_cannot_be_planned(tmp_path):
    made = kr270(tmp_path, noise={"reading_mm": None, "tracker": {"radial_um": 10.0, "transverse_um": 15.0}})
    with pytest.raises(InputError, match=r"\[noise.tracker\] station_mm is missing"):
        observer(made).blocks(poses_of(made.robot, 1, seed=0), np.array([[0, 1]]))


# --- test poses


def test_target_rows_are_the_jacobian_times_the_torques_of_the_wrench(tmp_path):
    """Facts: A_0 = J diag(J' w), J at the point that counts, J' w at the attach point, gravity not in it."""
    made = kr270(tmp_path, robot={"mount_deg": [10.0, 90.0, -20.0]}, model={"reference": "differences"})
    q = poses_of(made.robot, 2, seed=5)
    wrench = np.array([100.0, -200.0, -1500.0, 30.0, 20.0, -10.0])
    attach, point = np.array([0.3, 0.1, -0.1]), np.array([0.1, 0.0, 0.2])
    tests = tuple(TestPose(row, wrench, flange, attach, point) for row, flange in zip(q, (False, True), strict=True))
    made = replace(made, test_poses=tests)
    watching = observer(made)
    loads = np.array([[0, 1]] * 20)
    known = identifiable(watching.blocks(poses_of(made.robot, 20, seed=6), loads))
    assert known.rank == 6, "a robot on the wall can be shown every joint"
    rows = target_rows(watching, known)
    frames = forward(made.robot, q)
    push = jacobian(frames, frames.point(np.tile(attach, (2, 1))))
    moved = jacobian(frames, frames.point(np.tile(point, (2, 1))))[:, :3]
    for index, turn in enumerate((made.robot.world_R_base.T, frames.flange_rotation[1])):
        torque = push[index].T @ np.concatenate([turn @ wrench[:3], turn @ wrench[3:]])
        np.testing.assert_allclose(rows[index], MICRO * moved[index] @ np.diag(torque), rtol=1e-10, atol=1e-18)


def test_target_rows_of_the_reference_arm_are_those_written_in_closed_form(tmp_path):
    made = study(tmp_path, ARM, loads=[{"id": "L1", "wrench": [0.3, 0.4, -1.0, 0, 0, 0]}])
    q = np.deg2rad([[30.0, 45.0, -100.0]])
    force = np.array([0.5, -0.7, 0.2])
    made = replace(made, test_poses=(TestPose(q[0], np.append(force, np.zeros(3)), False, np.zeros(3), np.zeros(3)),))
    c1, s1 = np.cos(q[0, 0]), np.sin(q[0, 0])
    r3, z3 = 0.8 * np.cos(q[0, 1] + q[0, 2]), 0.8 * np.sin(q[0, 1] + q[0, 2])
    r, z = np.cos(q[0, 1]) + r3, np.sin(q[0, 1]) + z3
    dense = np.array([[-r * s1, -z * c1, -z3 * c1], [r * c1, -z * s1, -z3 * s1], [0, r, r3]])
    watching = observer(made)
    pick = np.tile([made.load_index("L1")], (20, 1))
    known = identifiable(watching.blocks(poses_of(made.robot, 20, seed=7), pick))
    np.testing.assert_allclose(target_rows(watching, known)[0], MICRO * dense @ np.diag(dense.T @ force), atol=1e-18)


def test_wrong_masses_count_at_test_poses_and_wrong_loads_do_not(tmp_path):
    """Facts: ``sum_j c_j D_j a_j . ((c_3 - o_j) x g)`` per kg of link 3."""
    compliance = {f"joint_compliance.j{i + 1}": float(c) for i, c in enumerate((0.3, 0.3, 0.4, 2.0, 3.0, 2.5))}
    effects = ["joint_compliance", "link_mass@link3", "load_com", "load_scale", "load_direction"]
    made = kr270(tmp_path, model={"effects": effects, "nominal": compliance})
    robot = replace(made.robot, masses=frozen(np.full(6, 50.0)), centres=frozen(np.full((6, 3), 0.1)))
    made = replace(made, robot=robot)
    watching = observer(made)
    assert watching.reference == "absolute"
    q, names = poses_of(robot, 60, seed=9), list(watching.model.names)
    known = identifiable(watching.blocks(q, np.array([[0, 1]] * 60)))
    kept = [names[column] for column in known.kept]
    rows = target_rows(watching, known)[0]
    frames = forward(robot, made.test_poses[0].q[None])
    moved = marker_jacobian(frames, made.test_poses[0].point)[0]
    g = robot.gravity_base
    torque = np.cross(frames.centre[0, 2] - frames.origin[0], g)
    torque = np.einsum("ji,ji->j", frames.axis[0], torque) * (np.arange(6) < 3)
    expected = moved @ (MICRO * np.array(list(compliance.values())) * torque)
    np.testing.assert_allclose(rows[:, kept.index("link_mass.link3")], expected, rtol=1e-8, atol=1e-14)
    assert np.abs(expected).max() > 1e-7
    assert np.abs(rows[:, kept.index("load_direction.x")]).max() > 1e-7
    for name in ("load_com.x", "load_com.y", "load_com.z", "load_scale.all"):
        assert not rows[:, kept.index(name)].any(), name


def horizontal(made):
    """A test pose with a sideways push, which turns joint 1."""
    wrench = np.array([0.0, 800.0, 0.0, 0.0, 0.0, 0.0])
    return replace(made, test_poses=(replace(made.test_poses[0], wrench=wrench),))


def test_a_test_pose_that_turns_joint_1_cannot_be_told_from_hung_weights(tmp_path):
    made = horizontal(kr270(tmp_path))
    watching = observer(made)
    known = identifiable(watching.blocks(poses_of(made.robot, 50, seed=8), np.array([[0, 1]] * 50)))
    with pytest.raises(NotIdentifiable, match="vertical loads put no torque on joint 1") as caught:
        target_rows(watching, known)
    assert caught.value.missing == ("joint_compliance.j1",)
    assert caught.value.exit_code == 3


def test_an_axis_that_a_robot_file_rounds_off_the_vertical_tells_nothing(tmp_path):
    """URDF files write 3.14159: the tilt of 1e-6 gives joint 1 a column that no fit could use."""
    made = kr270(tmp_path)
    tilt = np.eye(4)
    tilt[1, 2], tilt[2, 1] = -1.5e-6, 1.5e-6
    placements = np.concatenate([(tilt @ made.robot.placements[0])[None], made.robot.placements[1:]])
    made = replace(made, robot=replace(made.robot, placements=placements))
    watching = observer(made)
    blocks = watching.blocks(poses_of(made.robot, 50, seed=8), np.array([[0, 1]] * 50))
    names = watching.model.names
    assert names[identifiable(blocks).kept[0]] == "joint_compliance.j1"
    known = identifiable(blocks, parameters=watching.parameters)
    (dropped,) = known.dropped
    assert names[dropped.column] == "joint_compliance.j1"
    assert dropped.std == pytest.approx(1.0 / np.linalg.norm(blocks[:, :, 0]), rel=0.1)
    assert target_rows(watching, known).shape == (2, 3, 5)
    with pytest.raises(NotIdentifiable, match="to no better than"):
        target_rows(observer(horizontal(made)), known)


def test_criteria_that_do_not_need_the_test_poses_go_on_without_them(tmp_path, caplog):
    made = horizontal(kr270(tmp_path))
    watching = observer(made)
    known = identifiable(watching.blocks(poses_of(made.robot, 50, seed=8), np.array([[0, 1]] * 50)))
    aim = objective(watching, known, "A")
    assert aim.rows is None
    assert "accuracy at the test poses cannot be told" in caplog.text
    for criterion in ("test_pose", "G"):
        with pytest.raises(NotIdentifiable):
            objective(watching, known, criterion)


def test_without_test_poses_only_their_criteria_are_refused(tmp_path):
    made = kr270(tmp_path, test_poses=None)
    watching = observer(made)
    known = identifiable(watching.blocks(poses_of(made.robot, 50, seed=8), np.array([[0, 1]] * 50)))
    assert objective(watching, known, "D").size == 5
    with pytest.raises(InputError, match=r"\[\[test_poses\]\] is missing"):
        objective(watching, known, "test_pose")


def test_where_nothing_can_be_seen_every_parameter_is_named(tmp_path):
    made = kr270(tmp_path, model={"reference": "differences"}, plan={"reference_rows": False})
    watching = observer(made)
    blocks = watching.blocks(poses_of(made.robot, 30, seed=9), np.array([[1]] * 30))
    with pytest.raises(NotIdentifiable, match="no parameter can be identified") as caught:
        objective(watching, identifiable(blocks), "A")
    assert caught.value.missing == watching.model.names


# --- memory


def test_columns_are_kept_in_the_same_memory():
    rng = np.random.default_rng(10)
    blocks = rng.normal(size=(10_001, 4, 7))
    kept = np.array([0, 2, 3, 6])
    expected = blocks[:, :, kept].copy()
    left = keep_columns(blocks, kept)
    np.testing.assert_array_equal(left, expected)
    assert np.shares_memory(left, blocks)
    assert left.flags.c_contiguous
    everything = rng.normal(size=(10, 4, 7))
    assert keep_columns(everything, np.arange(7)) is everything
    assert keep_columns(everything, np.arange(0)).shape == (10, 4, 0)


def test_blocks_of_many_candidates_are_never_held_twice(tmp_path):
    """What is needed beside the result is the fields of one chunk, however many candidates there are."""
    made = kr270(tmp_path)
    watching = observer(made)
    beside = []
    for count in (10_000, 60_000):
        q, loads = poses_of(made.robot, count, seed=11), np.tile([0, 1], (count, 1))
        tracemalloc.start()
        blocks = watching.blocks(q, loads)
        left = keep_columns(blocks, np.arange(1, 6))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert left.nbytes == 5 / 6 * blocks.nbytes
        beside.append(peak - blocks.nbytes)
    assert abs(beside[1] - beside[0]) < 0.05 * blocks.nbytes


def test_blocks_do_not_depend_on_how_many_are_asked_for_at_once(tmp_path):
    made = kr270(tmp_path)
    q = poses_of(made.robot, 5000, seed=12)
    loads = np.tile([0, 1], (len(q), 1))
    watching = observer(made)
    together = watching.blocks(q, loads)
    picked = [0, 4095, 4096, 4999]
    apart = np.concatenate([watching.blocks(q[[i]], loads[[i]]) for i in picked])
    np.testing.assert_allclose(together[picked], apart, rtol=1e-9, atol=1e-9 * np.abs(together).max())
