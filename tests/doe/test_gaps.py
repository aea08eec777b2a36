"""Batched distances against coal, and what walls, boxes and hung weights forbid."""

from dataclasses import replace

import numpy as np
import pytest

from doe.capsules import capsules
from doe.distances import box_distance, box_gap_axes, crosses_box, segment_box_distance
from doe.feasible import check
from doe.gaps import gaps_of
from doe.weights import weights
from identify.cell import Box, Wall
from identify.errors import InputError
from identify.kinematics import forward
from identify.loads import LoadCase
from identify.robot import Shape
from identify.transforms import roll_pitch_yaw
from identify.units import DEG
from tests.doe.cell_cases import BACK, BLOCK, CABINET, UNLOADED, box, capsule, cell, distance, poses

READY = np.array([[0, -90, 90, 0, 0, 0]]) * DEG


def visits(count, *loads):
    return np.tile(np.array(loads, dtype=np.int64), (count, 1))


# ---- distances


def test_distance_of_segments_to_a_box_is_coals():
    rng = np.random.default_rng(0)
    half, radius = np.array([0.3, 0.5, 0.2]), 0.1
    p, q = rng.normal(0, 0.8, (2, 400, 3))
    q[::5] = p[::5]  # points
    q[1::5, :2] = p[1::5, :2]  # parallel to an edge
    ours = segment_box_distance(p, q, half)
    theirs = np.array([
        distance(capsule(a, b, radius), box(np.zeros(3), half, np.eye(3))) for a, b in zip(p, q, strict=True)
    ])  # fmt: skip
    apart = theirs > 1e-6
    np.testing.assert_allclose(ours[apart] - radius, theirs[apart], atol=2e-5)
    assert (ours[~apart] < radius + 1e-5).all()
    assert 50 < apart.sum() < 350
    np.testing.assert_array_equal(crosses_box(p, q, half), ours < 1e-12)


def test_a_segment_through_a_box_and_one_beside_it():
    half = np.array([1.0, 1.0, 1.0])
    p = np.array([[-3.0, 0, 0], [-3.0, 1.5, 0], [0, 0, 0], [-3.0, 0, 3.0]])
    q = np.array([[3.0, 0, 0], [3.0, 1.5, 0], [0.5, 0, 0], [3.0, 0, 3.0]])
    np.testing.assert_allclose(segment_box_distance(p, q, half), [0, 0.5, 0, 2.0], atol=1e-12)
    assert crosses_box(p, q, half).tolist() == [True, False, True, False]


def test_boxes_overlap_where_coal_says_so_and_the_gap_is_never_more_than_the_distance():
    rng = np.random.default_rng(1)
    upright, half = np.eye(3), np.array([0.2, 0.3, 0.25])
    other, other_half = roll_pitch_yaw([0.4, -0.8, 1.1]), np.array([0.5, 0.1, 0.3])
    axes, reach = box_gap_axes(upright, half, other, other_half)
    centres = rng.normal(0, 0.7, (300, 3))
    gap = (np.abs(centres @ axes.T) - reach).max(axis=1)
    theirs = np.array([
        distance(box(c, half, upright), box(np.zeros(3), other_half, other)) for c in centres
    ])  # fmt: skip
    clear = np.abs(theirs) > 1e-6
    np.testing.assert_array_equal(gap[clear] > 0, theirs[clear] > 0)
    assert (gap[theirs > 0] <= theirs[theirs > 0] + 1e-5).all()
    assert (gap[theirs > 0] >= theirs[theirs > 0] / np.sqrt(3) - 1e-5).all()
    assert 50 < (gap > 0).sum() < 280
    exact = box_distance(centres, upright, half, other, other_half)
    np.testing.assert_allclose(exact[theirs > 1e-6], theirs[theirs > 1e-6], atol=2e-5)
    assert (exact[theirs > 1e-6] > 1.05 * gap[theirs > 1e-6]).sum() > 10  # the gap alone is too small


def test_a_body_beside_a_corner_is_refused_only_within_the_clearance_itself():
    study = cell(boxes=(CABINET,), self_collision=False, clearance=0.1)
    q, robot = poses(study, 400), study.robot
    frames, gaps = forward(robot, q), gaps_of(study)
    tops = gaps.weights.tops(frames)
    load = [case.depth > 0 for case in study.loads].index(True)
    turn = robot.world_R_base
    obstacle = box(CABINET.centre, CABINET.half, CABINET.rotation)
    centres = gaps.weights.centres(tops)[:, load] @ turn.T
    theirs = np.array([distance(box(c, BLOCK.size / 2, np.eye(3)), obstacle) for c in centres])
    alone = replace(gaps, weights=replace(gaps.weights, hang=np.zeros_like(gaps.weights.hang)))
    ours = alone._hung_to_box(gaps.weights.below(tops, gaps.weights.hang), gaps.boxes[0])[:, load]
    near = (theirs > 1e-6) & (theirs < 0.1)
    assert near.sum() > 3
    np.testing.assert_allclose(ours[near], theirs[near], atol=2e-5)
    assert (ours[theirs >= 0.1 + 1e-5] >= 0.1).all()


# ---- the arm in its cell


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.2, 1.0)])
def test_poses_refused_by_boxes_and_weights_are_those_that_coal_refuses(mount):
    study = cell(mount=mount, boxes=(CABINET,), self_collision=False)
    q, robot = poses(study, 300), study.robot
    arm, frames = capsules(study), forward(study.robot, q)
    turn = robot.world_R_base
    starts, ends = (points @ turn.T for points in arm.segments(frames))
    attach = frames.point(BLOCK.attach) @ turn.T
    obstacle = box(CABINET.centre, CABINET.half, CABINET.rotation)
    at_box, at_arm = np.zeros((2, len(q)), dtype=bool)
    hung = weights(study, arm)
    for v in range(len(q)):
        links = [capsule(a, b, r) for a, b, r in zip(starts[v], ends[v], arm.radii, strict=True)]
        top = attach[v] - [0, 0, BLOCK.hang]
        body = box(top - [0, 0, BLOCK.size[2] / 2], BLOCK.size / 2, np.eye(3))
        rope = capsule(attach[v], top, 1e-9)
        moving = [link for link, moves in zip(links, arm.moving, strict=True) if moves]
        markers = [
            capsule(p, p, 1e-9)
            for p in (frames.flange_origin[v] + study.markers.positions @ frames.flange_rotation[v].T) @ turn.T
        ]
        at_box[v] = min(distance(item, obstacle) for item in [*moving, *markers, body, rope]) <= 0
        near = [distance(body, link) for link, on in zip(links, hung.boxed[1], strict=True) if on]
        near += [distance(rope, link) for link, on in zip(links, hung.roped[1], strict=True) if on]
        at_arm[v] = min(near) <= 0
    expected = np.where(at_box, "boxes", np.where(at_arm, "load_collision", ""))
    assert (np.array(check(study, q, visits(len(q), 1)).reasons) == expected).mean() == 1.0
    assert 10 < at_box.sum() < 200
    assert 10 < at_arm.sum() < 200


def test_a_clearance_refuses_nothing_that_stands_further_off():
    """Against coal, with a clearance within which bounds of the distance would refuse more."""
    study = cell(boxes=(CABINET,), self_collision=False, clearance=0.15)
    q, arm, hung = poses(study, 200), capsules(study), weights(study, capsules(study))
    frames = forward(study.robot, q)
    starts, ends = arm.segments(frames)
    attach, obstacle = frames.point(BLOCK.attach), box(CABINET.centre, CABINET.half, CABINET.rotation)
    at_box, at_arm = np.full((2, len(q)), np.inf)
    for v in range(len(q)):
        links = [capsule(a, b, r) for a, b, r in zip(starts[v], ends[v], arm.radii, strict=True)]
        markers = frames.flange_origin[v] + study.markers.positions @ frames.flange_rotation[v].T
        moving = [link for link, moves in zip(links, arm.moving, strict=True) if moves]
        at_box[v] = min(distance(item, obstacle) for item in [*moving, *(capsule(p, p, 1e-9) for p in markers)])
        top = attach[v] - [0, 0, BLOCK.hang]
        body = box(top - [0, 0, BLOCK.size[2] / 2], BLOCK.size / 2, np.eye(3))
        near = [distance(body, link) for link, on in zip(links, hung.boxed[1], strict=True) if on]
        rope = capsule(attach[v], top, 1e-9)
        near += [distance(rope, link) for link, on in zip(links, hung.roped[1], strict=True) if on]
        at_arm[v] = min(near)
    gaps = gaps_of(study)
    np.testing.assert_array_equal(gaps.to_boxes(frames)[:, 0] < 0, at_box < 0.15)
    np.testing.assert_array_equal(gaps.weights_to_links(frames)[:, 1] < 0, at_arm < 0.15)
    assert 5 < (np.abs(at_box - 0.15) < 0.15).sum()
    assert 5 < (np.abs(at_arm - 0.15) < 0.15).sum()


def test_poses_refused_by_a_wall_have_a_point_behind_it():
    study = cell(
        walls=(BACK,), self_collision=False, loads=(UNLOADED, LoadCase("P", mass=5.0, attach=BLOCK.attach), BLOCK)
    )
    q, arm = poses(study, 400), capsules(study)
    frames = forward(study.robot, q)
    starts, ends = arm.segments(frames)
    share = np.linspace(0, 1, 60)[:, None, None, None]
    line = (starts + share * (ends - starts))[:, :, arm.moving] @ BACK.normal - BACK.point @ BACK.normal
    links = (line - arm.radii[arm.moving]).min(axis=(0, 2))
    markers = (
        frames.flange_origin[:, None] + study.markers.positions @ frames.flange_rotation.swapaxes(1, 2)
    ) @ BACK.normal
    bare = np.minimum(links, markers.min(axis=1) - BACK.point @ BACK.normal)
    attach = frames.point(BLOCK.attach)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [0, 2])).reshape(3, -1).T * BLOCK.size / 2
    body = attach[:, None] - [0, 0, BLOCK.depth] + corners
    for load, hung in (
        (0, frames.flange_origin[:, None]),
        (1, attach[:, None]),
        (2, np.concatenate([attach[:, None], body], axis=1)),
    ):
        least = np.minimum(bare, (hung @ BACK.normal - BACK.point @ BACK.normal).min(axis=1))
        refused = np.array(check(study, q, visits(len(q), load)).reasons) == "walls"
        np.testing.assert_array_equal(refused, least < 0)
    assert 20 < refused.sum() < 380


def test_clearance_is_kept_and_a_box_out_of_reach_forbids_nothing():
    near = Box("near", np.array([0.0, 0.0, 3.8]), np.array([0.5, 0.5, 0.1]), np.eye(3))
    up = np.array([[0, -90, 0, 0, 0, 0]]) * DEG  # straight up
    for clearance, reason in ((0.0, ""), (2.0, "boxes")):
        study = cell(boxes=(near,), clearance=clearance, loads=(UNLOADED,), self_collision=False)
        gap = gaps_of(study).to_boxes(forward(study.robot, up))[0, 0]
        assert check(study, up, visits(1, 0)).reasons == (reason,)
    far = replace(near, centre=np.array([9.0, 9.0, 9.0]))
    study = cell(boxes=(far,), loads=(UNLOADED,), self_collision=False)
    assert check(study, poses(study, 200), visits(200, 0)).ok.all()
    assert gap < 0


def test_the_fixed_column_may_stand_behind_a_wall_and_in_a_box():
    pit = Box("pit", np.array([0.0, 0, 0]), np.array([0.4, 0.4, 0.4]), np.eye(3))
    study = cell(boxes=(pit,), walls=(Wall("plinth", np.array([0, 0, 0.1]), np.array([0, 0, 1.0])),))
    assert check(study, READY, visits(1, 0)).ok.all()


def test_a_hung_weight_needs_room_above_the_floor():
    bare, hung = cell(floor=0.9, loads=(UNLOADED, replace(BLOCK, size=np.zeros(3), hang=0.0))), cell(floor=0.9)
    frames = forward(bare.robot, READY)
    height = float(frames.point(BLOCK.attach)[0, 2])
    assert 0.9 < height
    assert height - BLOCK.depth > 0.9
    assert check(hung, READY, visits(1, 1)).ok.all()
    higher = replace(hung.constraints, floor=height - BLOCK.depth + 0.001)
    assert check(replace(hung, constraints=higher), READY, visits(1, 1)).reasons == ("floor",)
    assert check(replace(bare, constraints=higher), READY, visits(1, 1)).ok.all()


def test_a_body_that_touches_a_link_in_every_pose_is_left_out_and_named():
    """A body around the flange itself, without a rope."""
    close = LoadCase("close", mass=50.0, attach=np.array([0.0, 0.0, 0.0]), size=np.array([0.3, 0.3, 0.2]))
    study = cell(loads=(UNLOADED, close))
    assert gaps_of(study).always == ("close and A6..flange",)
    reasons = np.array(check(study, poses(study, 300), visits(300, 1)).reasons)
    assert 0 < (reasons == "load_collision").sum() < 300


def test_stated_shapes_take_the_place_of_the_lines():
    lines = cell(loads=(UNLOADED,))
    thick = Shape("forearm_box", 3, np.array([[0.0, 0, 0], [1.2, 0, 0]]), 0.3)
    shaped = replace(lines, robot=replace(lines.robot, shapes=(thick,)))
    arm = capsules(shaped)
    assert arm.names == ("base..A1", "A1..A2", "A2..A3", "forearm_box", "A6..flange")
    frames = forward(shaped.robot, poses(shaped, 50))
    start, end = arm.segments(frames)
    np.testing.assert_allclose(start[:, 3], frames.origin[:, 2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(end - start, axis=2)[:, 3], 1.2)
    by_radius = replace(shaped, constraints=replace(shaped.constraints, link_radius=0.1))
    assert capsules(by_radius).names == capsules(lines).names


def test_home_that_breaks_a_constraint_is_bad_input():
    study = cell(boxes=(replace(CABINET, centre=np.array([1.5, 0.0, 1.8])),), home=READY[0])
    with pytest.raises(InputError, match=r"home_deg: the arm cannot stand there, boxes is broken by"):
        check(study, READY, visits(1, 0))
