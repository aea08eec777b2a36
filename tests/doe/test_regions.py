"""Test regions: against dense grids, with test poses and the worst case, and what is no region."""

import json
from itertools import product

import numpy as np
import pytest

from doe.cli import run
from doe.evaluate import evaluate
from doe.feasible import screen
from doe.information import covariance_of
from doe.observations import error_rows
from doe.plan import plan
from doe.pool import build_pool
from doe.regions import check_test_poses, poses_in, with_regions
from identify.config import load_study
from identify.errors import Infeasible, InputError
from identify.experiment import full_experiment
from identify.kinematics import forward
from identify.study import TestPose
from tests.doe.study_files import ARM, KR270, study, study_file

BOX = {
    "joints_min_deg": [0.0, -70.0, 60.0, 0.0, 30.0, 0.0],
    "joints_max_deg": [0.0, -40.0, 100.0, 30.0, 60.0, 0.0],
    "wrench_min": [0.0, 0.0, -1800.0, 0.0, 0.0, 0.0],
    "wrench_max": [0.0, 0.0, -600.0, 0.0, 0.0, 0.0],
    "attach_mm": [300.0, 0.0, 0.0],
}
FLAT = {
    "joints_min_deg": [0.0, 20.0, -110.0],
    "joints_max_deg": [0.0, 80.0, -40.0],
    "wrench_min": [0.2, 0.0, -1.5, 0.0, 0.0, 0.0],
    "wrench_max": [0.8, 0.0, -0.5, 0.0, 0.0, 0.0],
}


def mean_square(whole, found, poses):
    """Mean of the squared error at some poses with their weights, mm^2, pose by pose."""
    covariance = covariance_of(found.information)
    rows = [error_rows(found.observer.model, pose)[:, found.known.kept] * 1e3 for pose in poses]
    weights = np.array([pose.weight for pose in poses])
    return float(np.average([np.trace(row @ covariance @ row.T) for row in rows], weights=weights))


def grid(region, steps):
    """Poses at the middles of the cells of a grid over the joints 2 and 3 and the forces x and z of `FLAT`."""
    share = (np.arange(steps) + 0.5) / steps
    cells = np.array(list(product(share, repeat=4)))
    q = np.tile(region.lower, (len(cells), 1))
    wrench = np.tile(region.wrench_lower, (len(cells), 1))
    q[:, [1, 2]] += cells[:, :2] * (region.upper - region.lower)[[1, 2]]
    wrench[:, [0, 2]] += cells[:, 2:] * (region.wrench_upper - region.wrench_lower)[[0, 2]]
    return [TestPose(a, b, region.in_flange, region.attach, region.point) for a, b in zip(q, wrench, strict=True)]


def test_a_region_is_the_mean_over_a_dense_grid(tmp_path):
    whole = study(tmp_path, ARM, test_poses=None, test_regions=[{**FLAT, "points": 256}])
    q = np.deg2rad([[0.0, 10.0, 30.0], [0.0, 60.0, -80.0], [0.0, 120.0, 60.0]])
    found = evaluate(whole, full_experiment(q, np.ones((3, 1), dtype=np.int64), whole.loads, whole.markers))
    dense = mean_square(whole, found, grid(whole.test_regions[0], 9))
    assert found.bound.value == pytest.approx(dense, rel=0.01)
    few = study(tmp_path, ARM, test_poses=None, test_regions=[FLAT])
    again = evaluate(few, found.experiment)
    assert again.bound.value == pytest.approx(dense, rel=0.03), "64 points by default"


@pytest.mark.slow
def test_a_plan_for_a_region_is_better_there_than_one_for_its_middle(tmp_path):
    region = {**BOX, "points": 32}
    middle = [{
        "joints_deg": [0.5 * (a + b) for a, b in zip(BOX["joints_min_deg"], BOX["joints_max_deg"], strict=True)],
        "wrench": [0.0, 0.0, -1200.0, 0.0, 0.0, 0.0],
        "attach_mm": BOX["attach_mm"],
    }]  # fmt: skip
    settings = {"candidates": 200, "poses": 4}
    made = plan(study(tmp_path, KR270, test_poses=None, test_regions=[region], plan=settings))
    other = plan(study(tmp_path, KR270, test_poses=middle, plan=settings))
    value = made.pool.objective.value
    own = made.pool.observer.blocks(other.q, other.visit_loads)[:, :, made.pool.known.kept]
    assert made.final.value < 0.97 * value(np.einsum("nki,nkj->ij", own, own))
    assert made.final.bound <= made.final.value


@pytest.mark.parametrize("criterion", ["test_pose", "G"])
def test_regions_stand_beside_test_poses_with_their_weight(tmp_path, criterion):
    """Half the weight for the region, half for two poses; the worst case is over all of them."""
    region = {**BOX, "weight": 3.0, "points": 16}
    settings = {"candidates": 100, "poses": 5, "criterion": criterion, "refine": False}
    made = plan(study(tmp_path, KR270, test_regions=[region], plan=settings))
    whole = made.pool.observer.study
    assert len(whole.test_poses) == 2 + 16
    assert whole.test_regions == ()
    assert sum(pose.weight for pose in whole.test_poses[2:]) == pytest.approx(3.0)
    parts = [mean_square(whole, _as_found(made), poses) for poses in (whole.test_poses[:2], whole.test_poses[2:])]
    every = [mean_square(whole, _as_found(made), [pose]) for pose in whole.test_poses]
    expected = max(every) if criterion == "G" else 0.5 * sum(parts)
    assert made.final.value == pytest.approx(expected, rel=1e-9)


def _as_found(made):
    """A plan with the names of an evaluation."""
    made_of = made.pool
    return type("Found", (), {
        "information": made.information, "observer": made_of.observer, "known": made_of.known,
    })  # fmt: skip


def test_points_keep_to_limits_and_apart_from_the_arm(tmp_path):
    wide = {
        "joints_min_deg": [-400.0, -400.0, -400.0, -400.0, -400.0, -400.0],
        "joints_max_deg": [400.0] * 6,
        "wrench_min": [-100.0] * 6,
        "wrench_max": [100.0] * 6,
        "points": 200,
    }
    whole = study(tmp_path, KR270, test_regions=[wide], constraints={"link_radius_mm": 150.0})
    poses = poses_in(whole, 0)
    q = np.stack([pose.q for pose in poses])
    assert len(q) == 200
    assert ((q >= whole.robot.lower) & (q <= whole.robot.upper)).all()
    assert not screen(whole).tests["self_collision"](q, forward(whole.robot, q)).any()
    wrench = np.stack([pose.wrench for pose in poses])
    assert (np.abs(wrench) <= 100).all()
    assert (np.abs(wrench.mean(axis=0)) < 10).all(), "spread over the box"
    np.testing.assert_array_equal(q, [pose.q for pose in poses_in(whole, 0)])


def test_a_region_of_one_pose_is_a_test_pose(tmp_path):
    pose = KR270["test_poses"][0]
    point = {
        "joints_min_deg": pose["joints_deg"],
        "joints_max_deg": pose["joints_deg"],
        "wrench_min": pose["wrench"],
        "wrench_max": pose["wrench"],
        "attach_mm": pose["attach_mm"],
    }
    settings = {"candidates": 60, "poses": 4, "refine": False}
    made = plan(study(tmp_path, KR270, test_poses=None, test_regions=[point], plan=settings))
    same = plan(study(tmp_path, KR270, test_poses=[pose], plan=settings))
    assert len(made.pool.observer.study.test_poses) == 1
    assert made.final.value == pytest.approx(same.final.value, rel=1e-12)


def test_a_region_in_which_the_arm_touches_itself_is_infeasible(tmp_path):
    """The forearm is folded back onto the column; with thinner links it would pass."""
    folded = {"joints_min_deg": [11, -31, 153, -54, -82, -39], "joints_max_deg": [11, -29, 155, -52, -80, -37]}
    whole = study(tmp_path, KR270, test_regions=[{**BOX, **folded}], constraints={"link_radius_mm": 250.0})
    with pytest.raises(Infeasible, match=r"\[\[test_regions\]\] 1: the arm touches itself or the cell in all"):
        with_regions(whole)
    thin = study(tmp_path, KR270, test_regions=[{**BOX, **folded}], constraints={"link_radius_mm": 100.0})
    assert len(with_regions(thin).test_poses) == 2 + 64


def test_poses_behind_a_wall_are_no_test_poses(tmp_path):
    """Half of the region lies behind a wall that the arm would have to pass."""
    free = study(tmp_path, KR270, test_regions=[BOX])
    reach = np.stack([forward(free.robot, pose.q[None]).flange_origin[0] for pose in poses_in(free, 0)])
    middle = float(np.median(reach[:, 0])) * 1e3
    wall = {"name": "wall", "point_mm": [middle, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
    kept = poses_in(study(tmp_path, KR270, test_regions=[BOX], constraints={"walls": [wall]}), 0)
    ends = np.stack([forward(free.robot, pose.q[None]).flange_origin[0] for pose in kept])
    assert 0 < len(kept)
    assert ends[:, 0].max() < middle / 1e3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joints_min_deg": [0, 0]}, r"\[\[test_regions\]\] 1 joints_min_deg = .*6 values expected"),
        ({"joints_max_deg": [0, -80, 100, 30, 60, 0]}, r"joints_max_deg, entry 2 = -80.*below joints_min_deg = -70"),
        (
            {"joints_min_deg": [200, -70, 60, 0, 30, 0], "joints_max_deg": [210, -40, 100, 30, 60, 0]},
            "entry 1.*no pose",
        ),
        ({"wrench_max": [0, 0, -2000, 0, 0, 0]}, "wrench_max, entry 3.*no wrench"),
        ({"points": 0}, "points = 0"),
        ({"weight": 0.0}, "weight = 0"),
        ({"wrench_mni": [0.0] * 6}, "unknown key"),
    ],
)
def test_what_is_no_region_is_refused(tmp_path, change, said):
    with pytest.raises(InputError, match=f"(?s){said}"):
        load_study(study_file(tmp_path, KR270, test_regions=[{**BOX, **change}]))


def test_evaluate_tells_the_error_over_a_region(tmp_path):
    region = {**BOX, "points": 16}
    file = study_file(tmp_path, KR270, test_regions=[region], plan={"candidates": 80, "poses": 5, "refine": False})
    assert run(["plan", str(file), "--out", str(tmp_path / "plan"), "--quiet"]) == 0
    words = [str(file), str(tmp_path / "plan" / "plan.csv"), "--out", str(tmp_path / "out"), "--quiet"]
    assert run(["evaluate", *words]) == 0
    planned = json.loads((tmp_path / "plan" / "plan.json").read_text())
    told = json.loads((tmp_path / "out" / "evaluate.json").read_text())
    assert len(told["test_poses"]) == 2
    (found,) = told["test_regions"]
    assert found["points"] == 16
    assert found["rms_mm"] < found["max_rms_mm"] < found["max_ci95"] < found["max_ci95_total"]
    squares = [pose["rms_mm"] ** 2 for pose in told["test_poses"]]
    mean = (squares[0] + 2 * squares[1] + found["rms_mm"] ** 2) / 4
    assert told["criterion"]["rms_mm"] == pytest.approx(mean**0.5, rel=1e-9)
    assert planned["criterion"]["rms_mm"] == pytest.approx(told["criterion"]["rms_mm"], rel=1e-9)


def test_a_region_is_enough_to_plan_for(tmp_path):
    pool = build_pool(study(tmp_path, KR270, test_poses=None, test_regions=[BOX], plan={"candidates": 40}), 0)
    assert pool.objective.rows.shape[0] == 64


# ---- test poses in the cell


def test_a_test_pose_inside_the_cell_is_refused_and_one_below_the_floor_is_told(tmp_path, caplog):
    inside = {"boxes": [{"name": "post", "centre_mm": [1500.0, 0.0, 1500.0], "size_mm": [400.0, 400.0, 3000.0]}]}
    behind = {"walls": [{"name": "front", "point_mm": [1000.0, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}]}
    for cell in (inside, behind):
        made = study(tmp_path, KR270, constraints={"clearance_mm": 20.0, **cell})
        with pytest.raises(InputError, match=rf"\[\[test_poses\]\] \d joints_deg.* {next(iter(cell))} is broken by"):
            check_test_poses(made)
    check_test_poses(study(tmp_path, KR270))
    assert not caplog.records
    check_test_poses(study(tmp_path, KR270, constraints={"floor_mm": 1900.0}))
    assert "below [constraints] floor_mm" in caplog.text


def test_a_plan_is_not_made_for_a_test_pose_that_cannot_be(tmp_path):
    wall = {"walls": [{"name": "front", "point_mm": [1000.0, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}]}
    made = study(tmp_path, KR270, constraints=wall)
    with pytest.raises(InputError, match="cannot stand there"):
        plan(made)
