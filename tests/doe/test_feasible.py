"""Limits, floor, self-collision and payload, against loops over single poses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from doe import feasible
from doe.capsules import capsules
from doe.distances import segment_distance
from doe.feasible import REASONS, check, joint_range, screen
from doe.floor import floor_points
from identify.errors import InputError
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.study import Constraints, Noise, Study
from identify.transforms import roll_pitch_yaw, rotation, translation
from identify.units import DEG

UNLOADED = LoadCase("L0")
HOOK = LoadCase("L1", mass=20.0, attach=np.array([0.3, 0.0, -0.4]))
MARKERS = Markers(
    ("M1", "M2", "F1"),
    np.array([[0.3, 0.12, -0.08], [0.3, -0.1, 0.2], [1.0, 1.0, -5.0]]),
    np.array([False, False, True]),
)
ALL = np.inf  # a limit that is not known


def chain(*steps, slides=None, lower=-np.pi, upper=np.pi, **fields):
    """Robot of joints about (or along) the z axis of the given (4, 4) placements; the last one is the flange."""
    n = len(steps) - 1
    nan = np.full(n, np.nan)
    return Robot(
        name="chain",
        joints=tuple(f"j{i + 1}" for i in range(n)),
        prismatic=np.zeros(n, bool) if slides is None else np.array(slides),
        placements=np.array(steps),
        lower=np.broadcast_to(lower, (n,)),
        upper=np.broadcast_to(upper, (n,)),
        masses=nan,
        centres=np.full((n, 3), np.nan),
        efforts=nan,
        **fields,
    )


def study_of(robot, loads=(UNLOADED, HOOK), markers=MARKERS, **constraints):
    if isinstance(robot, str):
        robot = load_robot(robot)
    return Study(Path("s.toml"), robot, loads, markers, Noise(1e-5), constraints=Constraints(**constraints))


def poses_of(robot, count, seed=0):
    span = np.where(robot.prismatic, 0.5, np.pi)
    lower, upper = np.maximum(robot.lower, -span), np.minimum(robot.upper, span)
    return np.random.default_rng(seed).uniform(lower, upper, (count, robot.n))


def visits(count, *loads):
    return np.tile(np.array(loads, dtype=np.int64), (count, 1))


# ---- distance of segments


def point_to_segment(x, p, q):
    d = q - p
    s = 0.0 if not d.any() else np.clip((x - p) @ d / (d @ d), 0.0, 1.0)
    return np.linalg.norm(x - p - s * d)


def slow_distance(p1, q1, p2, q2):
    """The least of the four end distances and, where it exists, the distance of two inner points."""
    ends = [point_to_segment(x, p2, q2) for x in (p1, q1)] + [point_to_segment(x, p1, q1) for x in (p2, q2)]
    d1, d2 = q1 - p1, q2 - p2
    (s, t), *_ = np.linalg.lstsq(np.column_stack([d1, -d2]), p2 - p1, rcond=None)
    if 0 <= s <= 1 and 0 <= t <= 1:
        ends.append(np.linalg.norm(p1 + s * d1 - p2 - t * d2))
    return min(ends)


def test_distance_of_random_segments_is_that_of_a_fine_grid():
    rng = np.random.default_rng(1)
    p1, q1, p2, q2 = rng.normal(size=(4, 50, 3))
    s = np.linspace(0, 1, 201)[:, None, None]
    first, second = p1 + s * (q1 - p1), p2 + s * (q2 - p2)
    grid = np.linalg.norm(first[:, None] - second[None], axis=-1).min(axis=(0, 1))
    distance = segment_distance(p1, q1, p2, q2)
    assert (distance <= grid + 1e-12).all()
    assert (distance >= grid - 0.04).all()


@settings(max_examples=300, deadline=None)
@given(arrays(np.float64, (4, 3), elements=st.integers(-3, 3).map(float)))
def test_distance_of_segments_on_a_lattice_with_points_and_parallels(ends):
    """Small whole numbers make points, parallel, touching and crossing segments often."""
    distance = segment_distance(*ends)
    assert distance == pytest.approx(slow_distance(*ends), abs=1e-7)
    p1, q1, p2, q2 = ends
    for other in ((q1, p1, p2, q2), (p1, q1, q2, p2), (p2, q2, p1, q1)):
        assert segment_distance(*other) == pytest.approx(distance, abs=1e-7)


@settings(max_examples=200, deadline=None)
@given(arrays(np.float64, (4, 3), elements=st.floats(-2, 2, width=32)), st.integers(0, 10_000))
def test_distance_does_not_depend_on_the_frame(ends, seed):
    rng = np.random.default_rng(seed)
    moved = ends @ roll_pitch_yaw(rng.uniform(-3, 3, 3)).T + rng.normal(size=3)
    assert segment_distance(*moved) == pytest.approx(segment_distance(*ends), abs=1e-5)
    assert segment_distance(*ends) == pytest.approx(slow_distance(*ends), abs=1e-5)


# ---- joint limits


def test_limits_hold_with_the_margin_of_each_kind_of_joint():
    robot = chain(np.eye(4), np.eye(4), translation([0.5, 0, 0]), slides=[False, True], lower=[-2, 0.1], upper=[2, 0.9])
    study = study_of(robot, joint_margin=0.25, joint_margin_slide=0.05)
    lower, upper = joint_range(study)
    np.testing.assert_allclose([lower, upper], [[-1.75, 0.15], [1.75, 0.85]], rtol=0, atol=1e-15)
    q = np.array([lower, upper, [-1.76, 0.5], [1.76, 0.5], [0, 0.14], [0, 0.86], [0, 0.5]])
    result = check(study, q, visits(7, 0))
    assert result.reasons == ("", "", *["joint_limits"] * 4, "")
    assert result.rejected == {**dict.fromkeys(REASONS, 0), "joint_limits": 4}


def test_unknown_limits_allow_every_value():
    study = study_of(chain(np.eye(4), translation([1.0, 0, 0]), lower=-ALL, upper=ALL), joint_margin=0.1)
    assert check(study, np.array([[-100.0], [100.0]]), visits(2, 0)).ok.all()


def test_a_wrong_number_of_joint_values_is_an_error():
    with pytest.raises(InputError, match="5 joint values per pose given, robot KUKA KR 270 R2700 has 6"):
        check(study_of("kr270_r2700"), np.zeros((2, 5)), visits(2, 0))


def test_no_visits_are_no_problem():
    result = check(study_of("kr270_r2700", floor=0.1), np.zeros((0, 6)), visits(0, 0, 1))
    assert result.codes.shape == (0,)
    assert result.reasons == ()
    assert not any(result.rejected.values())


# ---- floor


@pytest.mark.parametrize(
    ("name", "mount_deg", "joints"),
    [
        ("kr270_r2700", (0, 0, 0), ["A3", "A4", "A5", "A6"]),  # A1 and A2 turn with the column
        ("kr270_r2700", (180, 0, 0), ["A3", "A4", "A5", "A6"]),  # hanging from the ceiling
        ("kr270_r2700", (0, 90, 0), ["A2", "A3", "A4", "A5", "A6"]),  # on the wall: A1 lifts A2
        ("ur10", (0, 0, 0), ["elbow", "wrist_1", "wrist_2", "wrist_3"]),
        ("ur10", (0, 90, 0), ["elbow", "wrist_1", "wrist_2", "wrist_3"]),  # the shoulder lies on the first axis
        ("ur10", (0, 30, 0), ["elbow", "wrist_1", "wrist_2", "wrist_3"]),
        ("planar_3r", (0, 0, 0), ["q2", "q3"]),
        ("planar_3r", (90, 0, 0), []),  # lying flat: no joint changes a height
    ],
)
def test_points_of_the_column_do_not_count(name, mount_deg, joints):
    robot = load_robot(name, mount=np.array(mount_deg) * DEG)
    points = floor_points(study_of(robot))
    assert [robot.joints[i] for i in points.joints] == joints
    if name == "planar_3r" and not joints:
        assert not points.local.size
    else:
        np.testing.assert_array_equal(points.local, [[0, 0, 0], [0.3, 0.12, -0.08], [0.3, -0.1, 0.2]])


def test_the_column_may_stand_below_the_floor_and_the_arm_may_not():
    study = study_of("kr270_r2700", floor=1.0, self_collision=False)
    q = np.array([[0, -90, 90, 0, 0, 0], [0, -20, 60, 0, 0, 0]]) * DEG
    assert check(study, q, visits(2, 0)).reasons == ("", "floor")


def test_angles_that_a_file_rounds_still_make_a_column():
    """URDF files write 1.5708 for a right angle; the column then moves by micrometres."""
    tilt = translation([0, 0, 0])
    tilt[:3, :3] = roll_pitch_yaw([1.5708, 0, 0])
    robot = chain(np.eye(4), translation([0.35, 0, 0.7]) @ tilt, translation([1.2, 0, 0]), world_R_base=tilt[:3, :3].T)
    upright = replace(robot, placements=np.array([tilt, *robot.placements[1:]]))
    assert floor_points(study_of(upright)).joints.tolist() == []
    assert floor_points(study_of(replace(upright, world_R_base=np.eye(3)))).joints.tolist() == [1]


def random_chain(seed):
    """A chain with quarter turns, zero offsets and sliding joints, so that fixed heights happen often."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    steps = []
    for _ in range(n + 1):
        turn = rotation("x", float(rng.choice([0, 90, -90, 180]))) @ rotation("y", float(rng.choice([0, 90, 30])))
        steps.append(translation(rng.choice([0, 0, 0.4, -0.7], 3)) @ turn)
    mount = roll_pitch_yaw(rng.choice([0, np.pi / 2, np.pi, 0.3], 3))
    return chain(*steps, slides=rng.random(n) < 0.3, world_R_base=mount)


@pytest.mark.parametrize("seed", range(80))
def test_floor_points_are_those_whose_height_varies(seed):
    study = study_of(random_chain(seed))
    robot = study.robot
    frames = forward(robot, np.random.default_rng(seed).uniform(-3, 3, (100, robot.n)))
    points = floor_points(study, [0, 1])
    up = robot.world_R_base[2]
    varies = np.ptp(frames.origin @ up, axis=0) > 1e-9
    assert points.joints.tolist() == np.flatnonzero(varies).tolist()
    local = [np.zeros(3), *MARKERS.positions[:2], UNLOADED.attach, HOOK.attach]
    kept = [p.tolist() for p in local if np.ptp(frames.point(p) @ up) > 1e-9]
    assert points.local.tolist() == kept
    heights = [frames.origin[:, i] @ up for i in points.joints] + [frames.point(p) @ up for p in points.local]
    np.testing.assert_allclose(points.heights(frames), np.reshape(heights, (-1, 100)).T, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("mount_deg", "floor"), [((0, 0, 0), -0.3), ((180, 0, 0), -2.2), ((10, 90, 40), -0.3)])
def test_a_visit_keeps_to_the_floor_with_its_own_loads(mount_deg, floor):
    robot = load_robot("kr270_r2700", mount=np.array(mount_deg) * DEG)
    study = study_of(robot, floor=floor, self_collision=False)
    q = poses_of(robot, 400)
    frames, up = forward(robot, q), robot.world_R_base[2]
    flange = [np.zeros(3), *MARKERS.positions[:2]]
    first = 2 if mount_deg[1] == 0 else 1
    arm = np.min([*(frames.origin[:, first:] @ up).T, *(frames.point(p) @ up for p in flange)], axis=0)
    hook = frames.point(HOOK.attach) @ up
    without, with_hook = check(study, q, visits(400, 0)), check(study, q, visits(400, 0, 1))
    np.testing.assert_array_equal(without.ok, arm >= floor)
    np.testing.assert_array_equal(with_hook.ok, np.minimum(arm, hook) >= floor)
    assert 0 < with_hook.ok.sum() < without.ok.sum() < 400


def test_a_pose_on_the_floor_stands_above_it():
    study = study_of("single_joint", markers=replace(MARKERS, positions=np.zeros((3, 3))), floor=0.0)
    assert check(study, np.array([[0.0], [-0.001]]), visits(2, 0)).reasons == ("", "floor")


# ---- self-collision


@pytest.mark.parametrize("name", ["kr270_r2700", "kr270_2", "ur10", "sda5f_r1", "planar_3r"])
def test_collisions_are_those_of_a_loop_over_the_links(name):
    study = study_of(name)
    robot, arm = study.robot, capsules(study)
    q = poses_of(robot, 150)
    frames = forward(robot, q)
    lengths = np.linalg.norm(robot.placements[:, :3, 3], axis=1)
    (radius,) = np.unique(arm.radii)
    expected = np.zeros(len(q), dtype=bool)
    for v in range(len(q)):
        points = np.vstack([np.zeros(3), frames.origin[v], frames.flange_origin[v]])
        for i in range(robot.n + 1):
            for j in range(i + 1, robot.n + 1):
                if lengths[i] and lengths[j] and lengths[i + 1 : j].sum() >= 2 * radius:
                    gap = slow_distance(points[i], points[i + 1], points[j], points[j + 1])
                    expected[v] |= gap < 2 * radius
    assert not arm.always
    np.testing.assert_array_equal(check(study, q, visits(150, 0)).ok, ~expected)
    assert not expected.all()


def test_a_folded_planar_arm_collides_and_a_stretched_one_does_not():
    study = study_of("planar_3r")
    assert capsules(study).radii == pytest.approx(0.03 * 2.4)
    q = np.array([[0, 0, 0], [0, 120, 150], [0, 90, 90], [0, 150, -60]]) * DEG
    assert check(study, q, visits(4, 0)).reasons == ("", "self_collision", "", "")


def test_the_radius_is_the_studys_then_the_robots_then_a_share_of_the_reach():
    assert (capsules(study_of("ur10")).radii == 0.075).all()
    assert (capsules(study_of("ur10", link_radius=0.05)).radii == 0.05).all()
    robot = load_robot("kr270_r2700")
    assert capsules(study_of(robot)).radii == pytest.approx(0.03 * robot.reach)
    endless = chain(np.eye(4), translation([2.0, 0, 0]), slides=[True], lower=-ALL, upper=ALL)
    assert capsules(study_of(endless)).radii == pytest.approx(0.06)


@pytest.mark.parametrize("constraints", [{"self_collision": False}, {}])
def test_nothing_is_checked_where_this_is_asked_for(constraints):
    robot = load_robot("planar_3r")
    if not constraints:
        robot = replace(robot, link_radius=0.0)
    study = study_of(robot, **constraints)
    assert capsules(study).first.size == 0
    assert check(study, np.array([[0, 120, 150]]) * DEG, visits(1, 0)).ok.all()


def test_short_links_make_neighbours():
    """A wrist of 0.1 m between two links is no gap for capsules of 0.12 m diameter."""
    steps = [np.eye(4), translation([1, 0, 0]), translation([0.1, 0, 0]), translation([1, 0, 0])]
    assert capsules(study_of(chain(*steps), link_radius=0.06)).first.size == 0
    thin = capsules(study_of(chain(*steps), link_radius=0.04))
    assert [thin.names[thin.first[0]], thin.names[thin.second[0]]] == ["j1..j2", "j3..flange"]
    assert thin.first.size == 1


def test_coinciding_joints_draw_no_capsule():
    arm = capsules(study_of("kr270_r2700"))
    assert arm.names == ("base..A1", "A1..A2", "A2..A3", "A3..A4", "A6..flange")  # A4, A5 and A6 meet in the wrist
    assert capsules(study_of("arm_3dof")).first.size == 0


def test_links_that_touch_in_every_pose_are_left_out_and_named():
    """A gooseneck: the rigid link between j1 and j3 comes back to the base column, whatever the joints do."""
    steps = [translation([0, 0, 1]), translation([0.4, 0, 0]), translation([-0.4, 0, 0]), translation([0, 0, -0.3])]
    robot = chain(*steps, lower=-1e-3, upper=1e-3)
    arm = capsules(study_of(robot, link_radius=0.1))
    assert arm.always == ("base..j1 and j2..j3", "base..j1 and j3..flange", "j1..j2 and j3..flange")
    assert check(study_of(robot, link_radius=0.1), np.zeros((1, 3)), visits(1, 0)).ok.all()


def test_a_sliding_joint_is_a_link_of_changing_length():
    """SCARA: the drawn-in spindle is no collision of the forearm with the flange."""
    steps = [translation([0, 0, 0.5]), translation([0.4, 0, 0]), translation([0.3, 0, 0]), translation([0, 0, -0.05])]
    robot = chain(*steps, slides=[False, False, True], lower=[-3, -3, -0.3], upper=[3, 3, 0])
    study = study_of(robot, floor=0.2, markers=replace(MARKERS, positions=np.zeros((3, 3))))
    assert check(study, np.array([[0, 1.0, 0.0], [0, 1.0, -0.2], [0, 1.0, -0.26]]), visits(3, 0)).reasons == (
        "",
        "",
        "floor",
    )


# ---- payload


@pytest.mark.parametrize(
    ("mass", "tool", "share", "allowed"),
    [(270, 0, 1.0, True), (270.1, 0, 1.0, False), (200, 71, 1.0, False), (200, 70, 1.0, True), (140, 0, 0.5, False)],
)
def test_hung_mass_and_tool_keep_to_the_rated_payload(mass, tool, share, allowed):
    robot = replace(load_robot("kr270_r2700"), tool_mass=tool)
    study = study_of(robot, (UNLOADED, LoadCase("L1", mass=mass)), payload_share=share)
    q = np.array([[0, -90, 90, 0, 0, 0]]) * DEG
    assert check(study, q, visits(1, 0, 1)).reasons == ("" if allowed else "payload",)
    assert check(study, q, visits(1, 0)).ok.all()


def test_an_unknown_payload_allows_every_load():
    study = study_of("planar_2r", (UNLOADED, LoadCase("L1", mass=1e6)), payload_share=0.1)
    assert check(study, np.zeros((1, 2)), visits(1, 1)).ok.all()


# ---- together


def test_the_first_reason_counts():
    heavy = LoadCase("L2", mass=999.0)
    study = study_of("kr270_r2700", (UNLOADED, HOOK, heavy), floor=-0.2, link_radius=0.2)
    q = np.array([
        [0, -200, 90, 0, 0, 0],  # beyond the limits of A2, whatever else
        [0, -10, 110, 0, 0, 0],  # under the floor
        [0, -130, 155, 0, 60, 0],  # folded over the column
        [0, -90, 90, 0, 0, 0],
    ]) * DEG  # fmt: skip
    study_without_load = check(study, q, visits(4, 0))
    first = ("joint_limits", "floor", "self_collision")
    assert study_without_load.reasons == (*first, "")
    result = check(study, q, visits(4, 0, 2))
    assert result.reasons == (*first, "payload")
    assert {reason for reason, count in result.rejected.items() if count} == set(result.reasons)
    assert tuple(result.rejected) == REASONS
    with pytest.raises(ValueError, match="read-only"):
        result.codes[0] = 0


def test_chunks_do_not_show(monkeypatch):
    study = study_of("ur10", floor=0.0)
    q = poses_of(study.robot, 100)
    whole = screen(study).codes(q)
    monkeypatch.setattr(feasible, "_CHUNK", 7)
    np.testing.assert_array_equal(screen(study).codes(q), whole)
    assert set(np.unique(whole)) >= {REASONS.index("floor"), REASONS.index("self_collision"), len(REASONS)}


@pytest.mark.parametrize("yaw", [0.7, 2.0])
def test_turning_the_cell_about_the_vertical_changes_nothing(yaw):
    robot = load_robot("ur10", mount=(0.2, 0.4, 0.0))
    turned = load_robot("ur10", mount=(0.2, 0.4, yaw))
    q = poses_of(robot, 300)
    first, second = (check(study_of(r, floor=0.1), q, visits(300, 0, 1)).codes for r in (robot, turned))
    np.testing.assert_array_equal(first, second)
