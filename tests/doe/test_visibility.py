"""Line of sight: against rays that are walked along, and one occluder of each kind."""

from dataclasses import replace

import numpy as np
import pytest

from doe.capsules import capsules
from doe.feasible import check, screen
from doe.gaps import gaps_of
from doe.visibility import sight
from identify.cell import Box, Station, Visibility
from identify.errors import InputError
from identify.kinematics import forward
from identify.loads import Markers
from identify.units import DEG
from tests.doe.cell_cases import BLOCK, CABINET, MARKERS, UNLOADED, cell, poses

TRACKER = np.array([3.5, 0.4, 0.9])
READY = np.array([[0, -90, 90, 0, 0, 0]]) * DEG


def seen_of(study, q):
    found = sight(study, gaps_of(study))
    return found, found.seen(forward(study.robot, q))


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.2, 0.1, -0.5)])
def test_occlusion_is_that_of_a_ray_walked_in_small_steps(mount):
    study = cell(station=TRACKER, mount=mount, boxes=(CABINET,), visibility=Visibility())
    q = poses(study, 250)
    found, seen = seen_of(study, q)
    turn, frames, arm = study.robot.world_R_base, forward(study.robot, q), capsules(study)
    markers = (frames.flange_origin[:, None] + MARKERS.positions @ frames.flange_rotation.swapaxes(1, 2)) @ turn.T
    steps = np.linspace(0.0, 1.0, 800)[:, None, None, None]
    ray = markers + steps * (TRACKER @ turn.T - markers)  # (K, N, M, 3) world
    start, end = (points @ turn.T for points in arm.segments(frames))
    axis = end - start
    length = np.einsum("nsi,nsi->ns", axis, axis)
    hidden = np.zeros(seen.shape, dtype=bool)
    depth = np.full(seen.shape, np.inf)  # how sure it is
    for s in range(len(arm.names)):
        along = np.einsum("knmi,ni->knm", ray - start[:, None, s], axis[:, s]) / np.maximum(length[:, s, None], 1e-12)
        nearest = start[:, None, s] + along.clip(0, 1)[..., None] * axis[:, None, s]
        gap = np.linalg.norm(ray - nearest, axis=-1) - arm.radii[s]
        own = (gap[0] < 0) & arm.at_flange[s]
        depth = np.minimum(depth, np.where(own, np.inf, np.abs(gap.min(axis=0)))[..., None])
        hidden |= ((gap.min(axis=0) < 0) & ~own)[..., None]
    inside = (np.abs(CABINET.local(ray)) < CABINET.half).all(axis=-1).any(axis=0)
    hidden |= inside[..., None]
    tops = frames.point(BLOCK.attach) @ turn.T - [0, 0, BLOCK.hang + BLOCK.size[2] / 2]
    hidden[:, :, 1] |= (np.abs(ray - tops[:, None]) < BLOCK.size / 2).all(axis=-1).any(axis=0)
    sure = depth > 2e-3
    assert not (seen & hidden)[sure].any()
    assert (~seen & ~hidden)[sure].mean() < 0.005, "only corners that a ray cuts between two steps"
    assert 0.1 < hidden.mean() < 0.9
    assert hidden[..., 1].sum() > hidden[..., 0].sum()
    assert found.required == 3


def test_the_cone_of_a_reflector_is_its_half_angle():
    study = cell(station=TRACKER, visibility=Visibility(acceptance=30 * DEG, occlusion=False))
    q = poses(study, 500)
    frames = forward(study.robot, q)
    found, _ = seen_of(study, q)
    turned = found.turned_here(frames)
    for m in (0, 1):
        beam = TRACKER - frames.point(MARKERS.positions[m])
        look = frames.flange_rotation @ MARKERS.normals[m]
        angle = np.degrees(np.arccos(np.einsum("vi,vi->v", beam, look) / np.linalg.norm(beam, axis=1)))
        np.testing.assert_array_equal(turned[:, m], angle <= 30.0)
    assert turned[:, 2].all(), "without a direction every angle is good"
    assert 5 < turned[:, 0].sum() < 200


def test_range_required_and_reasons_in_their_order():
    study = cell(station=TRACKER, loads=(UNLOADED,), visibility=Visibility(farthest=2.0, occlusion=False))
    q = poses(study, 300)
    distance = np.linalg.norm(
        TRACKER
        - (
            forward(study.robot, q).flange_origin[:, None]
            + MARKERS.positions @ forward(study.robot, q).flange_rotation.swapaxes(1, 2)
        ),
        axis=2,
    )
    loads = np.zeros((300, 1), dtype=np.int64)
    for required in (1, 2, None):
        limits = Visibility(farthest=2.0, required=required, acceptance=60 * DEG)
        own = replace(study, constraints=replace(study.constraints, visibility=limits, self_collision=False))
        far = (distance <= 2.0).sum(axis=1) < (required or 3)
        reasons = np.array(check(own, q, loads).reasons)
        np.testing.assert_array_equal(reasons == "tracker_range", far)
        assert set(reasons[~far]) <= {"reflector_angle", "line_of_sight", ""}
        assert (reasons == "reflector_angle").any()


def test_one_occluder_hides_what_stands_behind_it():
    study = cell(station=TRACKER, loads=(UNLOADED,), visibility=Visibility())
    none = np.zeros((1, 1), dtype=np.int64)
    assert check(study, READY, none).ok.all()
    pillar = Box("pillar", np.array([2.8, 0.2, 1.4]), np.array([0.05, 0.3, 0.5]), np.eye(3))
    blocked = replace(study, constraints=replace(study.constraints, boxes=(pillar,)))
    assert check(blocked, READY, none).reasons == ("line_of_sight",)
    open_ = replace(blocked.constraints, visibility=Visibility(occlusion=False))
    assert check(replace(blocked, constraints=open_), READY, none).ok.all()


def test_fixed_markers_need_no_line_of_sight_and_undecided_ones_are_not_required():
    fixed = Markers(("M1", "F1"), np.array([[0.06, 0, 0.16], [0, 0, -5.0]]), np.array([False, True]))
    study = cell(station=TRACKER, markers=fixed, visibility=Visibility())
    assert screen(study).tests.keys() >= {"line_of_sight"}
    assert sight(study, gaps_of(study)).required == 1
    undecided = replace(
        cell(station=TRACKER, visibility=Visibility(), plan={"stations": ("S1",), "markers": 1}),
        marker_choices=("M2", "M3"),
    )
    assert sight(undecided, gaps_of(undecided)).required == 2


def test_a_tracker_in_the_base_or_in_the_arm_at_home_is_bad_input():
    inside = cell(station=(0.0, 0.0, 0.3), visibility=Visibility())
    with pytest.raises(
        InputError, match=r"\[\[tracker_stations\]\] S1: the tracker stands inside the robot \(base..A1\)"
    ):
        screen(inside)
    at_home = cell(station=(0.4, 0.0, 1.2), visibility=Visibility(), home=READY[0])
    with pytest.raises(InputError, match="stands inside the robot"):
        screen(at_home)
    screen(cell(station=TRACKER, visibility=Visibility(), home=READY[0]))
    two = replace(
        cell(station=TRACKER, visibility=Visibility()),
        stations=(Station("S1", TRACKER), Station("B", np.array([0, 0, 0.3]))),
    )
    with pytest.raises(InputError, match="B: the tracker stands inside"):
        screen(two)


def test_without_a_station_nothing_can_be_seen():
    with pytest.raises(InputError, match="the tracker stands nowhere"):
        screen(cell(visibility=Visibility()))
