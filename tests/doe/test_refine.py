"""Refinement off the grid: the published tables of the three-joint arm, all limits, and never a worse plan."""

from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
import pytest

from doe.floor import floor_points
from doe.observations import identifiable, observer, target_rows
from doe.refine import Others, can_refine, refine
from identify.arrays import frozen
from identify.errors import InputError
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.study import Noise, Study, TestPose

DOWN, FORWARD, SLANTED = (
    np.array([0.0, 0.0, -1.0]),
    np.array([1.0, 0.0, 0.0]),
    np.array([0.5, 0.5, -1.0]) / np.sqrt(1.5),
)
TIP = Markers(("tip",), np.zeros((1, 3)), np.array([False]))
THREE = Markers(
    ("m1", "m2", "m3"), np.array([[0.1, 0, 0.05], [-0.06, 0.1, 0.05], [-0.06, -0.1, 0.05]]), np.zeros(3, bool)
)
UNBOUNDED = {"lower": np.full(3, -np.inf), "upper": np.full(3, np.inf)}
MICRO = 1e-6  # one urad/Nm under 1 N moves the tip by some um: with a noise of 1 um, sigma is 1


def arm_study(test_force, load_force=DOWN, **changes):
    """The three-joint arm of the published tables: unit load at the tip, unit noise."""
    settings = {"robot": load_robot("arm_3dof"), "effects": ("joint_compliance@j2", "joint_compliance@j3")} | changes
    pose = np.zeros(settings["robot"].n)
    pose[1:3] = np.deg2rad([45.0, -90.0])
    wrench = np.concatenate([test_force, np.zeros(3)])
    return Study(
        path=Path("study.toml"),
        loads=(LoadCase("unit", force=load_force, in_flange=settings["robot"].n > 3),),
        markers=TIP,
        noise=Noise(reading=MICRO),
        frame_free=False,
        markers_fitted=False,
        reference="absolute",
        test_poses=(TestPose(pose, wrench, False, np.zeros(3), np.zeros(3)),),
        **settings,
    )


def heavy_study(**changes):
    """A KR 270 with three markers, 150 kg and five test poses."""
    robot = load_robot("kr270_r2700")
    q = random_poses(robot, 5, seed=7)
    pushes = np.random.default_rng(8).normal(size=(5, 3)) * [0.0, 0.0, 500.0]
    tests = tuple(
        TestPose(pose, np.append(push, np.zeros(3)), False, np.zeros(3), np.zeros(3))
        for pose, push in zip(q, pushes, strict=True)
    )
    settings = {
        "robot": robot,
        "loads": (LoadCase("none"), LoadCase("plate", mass=150.0, attach=np.array([0.2, 0.1, 0.1]))),
        "markers": THREE,
        "noise": Noise(reading=3e-5, pose_jitter=2e-5, reading_jitter=1e-5),
        "reference": "differences",
        "test_poses": tests,
    }
    return Study(Path("study.toml"), **(settings | changes))


def random_poses(robot, count, seed=0, floor=0.3):
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (50 * count, robot.n))
    frames = forward(robot, q)
    low = np.minimum(frames.origin[:, 2:, 2].min(axis=1), frames.flange_origin[:, 2] - 0.3)
    return q[low > floor][:count]


def prepared(study, count=8, seed=0):
    """Observer, poses, loads, kept columns, stacked target and limits of a random plan."""
    watching = observer(study)
    q = random_poses(study.robot, count, seed)
    loads = np.tile(np.arange(len(study.loads)), (count, 1))
    known = identifiable(watching.blocks(random_poses(study.robot, 100), np.tile(loads[0], (100, 1))))
    target = target_rows(watching, known) * 1e3
    bounds = {"lower": np.maximum(study.robot.lower, -np.pi), "upper": np.minimum(study.robot.upper, np.pi)}
    return watching, q, loads, known.kept, target, bounds


def trace_value(watching, q, loads, kept, target):
    """trace(C M^-1 C') by the exact blocks, in another way than the code under test."""
    rows = watching.blocks(q, loads)[:, :, kept].reshape(-1, len(kept))
    return float(np.sum((target.reshape(-1, len(kept)) @ np.linalg.pinv(rows, rcond=1e-13)) ** 2))


# --- published tables ------------------------------------------------------------------------------------------------


def best_of(study, count, starts, seed=0):
    """Smallest rho_0 over random starts."""
    watching = observer(study)
    kept = np.arange(len(watching.model.parameters))
    target = np.zeros((3, len(kept)))
    target[:] = target_rows(watching, identifiable(np.eye(len(kept))[None]))[0] / MICRO
    free = {"lower": np.full(study.robot.n, -np.inf), "upper": np.full(study.robot.n, np.inf)}
    rng = np.random.default_rng(seed)
    loads = np.zeros((count, 1), dtype=np.int64)
    results = [
        refine(watching, rng.uniform(-np.pi, np.pi, (count, study.robot.n)), loads, kept, target, **free)
        for _ in range(starts)
    ]
    return min(result.value_after for result in results) ** 0.5


@pytest.mark.parametrize(
    ("force", "count", "published"),
    [
        (DOWN, 1, 1.23596), (DOWN, 2, 0.74949), (DOWN, 3, 0.63813), (DOWN, 4, 0.52997),
        (FORWARD, 1, 0.92978), (FORWARD, 2, 0.62055), (FORWARD, 3, 0.49134), (FORWARD, 4, 0.41717),
    ],
)  # fmt: skip
def test_vertical_load_on_the_three_joint_arm(force, count, published):
    """Reference table of the 3-dof arm: best of 200 BFGS starts there, fewer here."""
    assert best_of(arm_study(force), count, starts=10) < published + 0.6e-5


def test_the_published_plan_is_a_stationary_point():
    """The plan for two poses, given in rounded degrees, reproduces its figure and cannot be improved."""
    watching = observer(arm_study(DOWN))
    q = np.deg2rad([[0.0, 0.0, 0.0], [0.0, 143.1, 216.9]])
    target = target_rows(watching, identifiable(np.eye(2)[None]))[0] / MICRO
    result = refine(watching, q, np.zeros((2, 1), dtype=np.int64), np.arange(2), target, **UNBOUNDED)
    assert result.value_before**0.5 == pytest.approx(0.74949, abs=0.6e-5)
    assert result.value_after**0.5 == pytest.approx(0.74949, abs=0.6e-5)


def test_experiments_that_stay_count_and_the_others_move_to_what_they_lack():
    """One pose of the published plan for two, told as rows of another arm in another order, brings forth the second."""
    watching = observer(arm_study(DOWN))
    fixed, start = np.deg2rad([[0.0, 143.1, 216.9]]), np.deg2rad([[0.0, 12.0, -15.0]])
    loads, target = np.zeros((1, 1), dtype=np.int64), target_rows(watching, identifiable(np.eye(2)[None]))[0] / MICRO
    swapped, place = [1, 0], np.array([1, 0])
    others = Others(watching.blocks(fixed, loads)[0][:, swapped], place)
    result = refine(
        watching, start, loads, np.arange(2), target[:, swapped], max_std=np.full(2, 10.0), others=others, **UNBOUNDED
    )
    together = trace_value(watching, np.vstack([start, fixed]), np.zeros((2, 1), dtype=np.int64), [0, 1], target)
    assert result.value_before == pytest.approx(together, rel=1e-9)
    assert result.value_after**0.5 == pytest.approx(0.74949, abs=0.6e-5)
    np.testing.assert_allclose(np.cos(result.q[:, 1:]), 1.0, atol=1e-4)


def with_wrist(robot):
    """Two more joints that turn the flange and leave its origin where it is."""
    across = np.eye(4)
    across[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # z along the former x
    n = robot.n + 2
    return Robot(
        name="arm with wrist",
        joints=(*robot.joints, "w1", "w2"),
        prismatic=np.zeros(n, bool),
        placements=np.concatenate([robot.placements, [across, np.eye(4)]]),
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        masses=np.full(n, np.nan),
        centres=np.full((n, 3), np.nan),
        efforts=np.full(n, np.nan),
    )


@pytest.mark.parametrize(("count", "published"), [(1, 1.16140), (2, 0.72223), (3, 0.56347)])
def test_free_force_direction_on_the_three_joint_arm(count, published):
    """A force that stands still in the flange of a wrist may point anywhere; the wrist itself is rigid."""
    study = arm_study(
        SLANTED,
        load_force=FORWARD,
        robot=with_wrist(load_robot("arm_3dof")),
        effects=("joint_compliance@j1", "joint_compliance@j2", "joint_compliance@j3"),
    )
    assert best_of(study, count, starts=10) < published + 0.6e-5


def test_a_coarse_grid_leaves_at_least_five_percent():
    """The best pair of a 45 deg grid, by trying all of them, is refined to the published figure."""
    watching = observer(arm_study(FORWARD))
    angles = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    grid = np.array([[0.0, a, b] for a in angles for b in angles])
    blocks = watching.blocks(grid, np.zeros((64, 1), dtype=np.int64))
    target = target_rows(watching, identifiable(blocks))[0] / MICRO
    pairs = np.array(list(combinations_with_replacement(range(64), 2)))
    information = np.einsum("nki,nkj->nij", blocks, blocks)[pairs].sum(axis=1)
    visible = np.linalg.det(information) > 1e-9
    covariance = np.linalg.inv(information[visible])
    values = np.einsum("ij,njk,ik->n", target, covariance, target)
    best = grid[pairs[visible][int(np.argmin(values))]]
    result = refine(watching, best, np.zeros((2, 1), dtype=np.int64), np.arange(2), target, **UNBOUNDED)
    assert result.value_before == pytest.approx(values.min(), rel=1e-9)
    assert result.gain > 0.05
    assert result.value_after**0.5 < 0.62055 + 0.6e-5


def test_a_saddle_point_is_left():
    """By symmetry this plan has no slope, and it is not the best one."""
    watching = observer(arm_study(DOWN))
    q = np.deg2rad([[0.0, 0.0, 0.0], [0.0, 0.0, 180.0]])
    target = target_rows(watching, identifiable(np.eye(2)[None]))[0] / MICRO
    result = refine(watching, q, np.zeros((2, 1), dtype=np.int64), np.arange(2), target, **UNBOUNDED)
    assert result.value_before**0.5 == pytest.approx(0.75519, abs=1e-5)
    assert result.value_after**0.5 < 0.74949 + 0.6e-5


def test_same_visits_of_a_long_plan_stay_together_and_count_as_often():
    watching = observer(arm_study(DOWN))
    q = np.repeat(np.deg2rad([[0.0, 0.0, 0.0], [0.0, 0.0, 180.0]]), 25, axis=0)
    target = target_rows(watching, identifiable(np.eye(2)[None]))[0] / MICRO
    asked = []

    def allowed(moved):
        asked.append(moved)
        return np.ones(len(moved), dtype=bool)

    loads = np.zeros((50, 1), dtype=np.int64)
    result = refine(watching, q, loads, np.arange(2), target, **UNBOUNDED, allowed=allowed)
    assert len(np.unique(result.q, axis=0)) == 2
    assert all(moved.shape == (50, 3) for moved in asked)
    assert (result.q[:25] == result.q[0]).all()
    assert (result.q[25:] == result.q[25]).all()
    rows = watching.blocks(result.q, loads).reshape(-1, 2)
    value = np.trace(target @ np.linalg.inv(rows.T @ rows) @ target.T)
    assert result.value_after == pytest.approx(value, rel=1e-9)
    assert (25 * value) ** 0.5 < 0.74949 + 0.6e-5


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "G"])
def test_a_plan_improves_within_limits_and_above_the_floor(criterion):
    study = heavy_study()
    watching, _, loads, kept, target, bounds = prepared(study)
    q = random_poses(study.robot, len(loads), floor=1.3)
    rows = {"test_pose": target.reshape(-1, len(kept)), "G": target}.get(criterion)
    result = refine(watching, q, loads, kept, rows, criterion=criterion, **bounds, floor=0.9)
    assert result.reason is None
    assert result.gain > 0.05
    assert (result.q >= bounds["lower"]).all()
    assert (result.q <= bounds["upper"]).all()
    assert floor_points(study, (1,)).heights(forward(study.robot, result.q)).min() >= 0.9
    free = refine(watching, q, loads, kept, rows, criterion=criterion, **bounds)
    assert floor_points(study, (1,)).heights(forward(study.robot, free.q)).min() < 0.9, "the floor did not matter"


def test_a_weight_on_a_rope_stays_above_the_floor_with_its_lowest_point():
    study = heavy_study()
    hung = replace(study.loads[1], size=np.array([0.2, 0.2, 0.15]), hang=0.25)
    study = replace(study, loads=(study.loads[0], hung, *study.loads[2:]))
    watching, _, loads, kept, target, bounds = prepared(study)
    q = random_poses(study.robot, len(loads), floor=1.3)
    result = refine(watching, q, loads, kept, target.reshape(-1, len(kept)), **bounds, floor=0.9)
    assert result.reason is None
    bare = replace(study, loads=(study.loads[0], replace(hung, size=np.zeros(3), hang=0.0), *study.loads[2:]))
    frames = forward(study.robot, result.q)
    lowest = floor_points(study, (1,)).heights(frames).min()
    assert lowest >= 0.9
    point = frames.point(hung.attach) @ study.robot.world_R_base[2]
    assert lowest <= point.min() - 0.4 + 1e-12
    assert floor_points(bare, (1,)).heights(frames).min() > lowest


def test_poses_that_are_refused_go_back_only_as_far_as_they_must():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    rows = target.reshape(-1, len(kept))
    free = refine(watching, q, loads, kept, rows, **bounds)
    limit = 0.5 * (q[0, 1] + free.q[0, 1])
    side = np.sign(free.q[0, 1] - q[0, 1])

    def allowed(moved):
        good = np.ones(len(moved), dtype=bool)
        good[0] = side * (moved[0, 1] - limit) <= 0
        return good

    held = refine(watching, q, loads, kept, rows, **bounds, allowed=allowed)
    assert allowed(held.q).all()
    assert held.gain > 0.5 * free.gain


def test_a_floor_that_no_joint_can_reach_does_no_harm():
    """An arm in a horizontal plane: no height depends on the joints."""
    robot = replace(load_robot("planar_3r"), world_R_base=np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    pull = LoadCase("pull", force=np.array([100.0, 0.0, 50.0]))
    study = heavy_study(robot=robot, loads=(LoadCase("none"), pull), test_poses=())
    assert len(floor_points(study, (1,)).local) == 0
    q, loads = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 3)), np.tile([0, 1], (4, 1))
    bounds = {"lower": robot.lower, "upper": robot.upper}
    assert refine(observer(study), q, loads, np.arange(3), None, criterion="D", **bounds, floor=0.0).gain > 0.05


def test_values_are_those_of_the_exact_blocks():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    result = refine(watching, q, loads, kept, target.reshape(-1, len(kept)), **bounds)
    assert result.value_before == pytest.approx(trace_value(watching, q, loads, kept, target), rel=1e-6)
    assert result.value_after == pytest.approx(trace_value(watching, result.q, loads, kept, target), rel=1e-6)
    worst = refine(watching, q, loads, kept, target, criterion="G", **bounds)
    values = [trace_value(watching, worst.q, loads, kept, rows) for rows in target]
    assert worst.value_after == pytest.approx(max(values), rel=1e-6)


def test_with_geometry_and_soft_joints_the_exact_blocks_decide():
    """The solver works with derivatives of the bending, the accepted value comes from the differences in it."""
    soft = {f"joint_compliance.j{j + 1}": 3.0 for j in range(6)}
    study = heavy_study(effects=("joint_compliance", "geometry"), reference="absolute", nominal=soft)
    watching, q, loads, kept, target, bounds = prepared(study, count=12)
    result = refine(watching, q, loads, kept, target.reshape(-1, len(kept)), **bounds, floor=0.0, max_iterations=60)
    assert result.gain > 0.05
    assert result.value_after == pytest.approx(trace_value(watching, result.q, loads, kept, target), rel=1e-5)


@pytest.mark.parametrize("iterations", [1, 3, 10])
@pytest.mark.parametrize("seed", range(3))
def test_a_limited_run_never_gives_a_worse_plan(iterations, seed):
    watching, q, loads, kept, target, bounds = prepared(heavy_study(), seed=seed)
    rows = target.reshape(-1, len(kept))
    result = refine(watching, q, loads, kept, rows, **bounds, floor=0.3, max_iterations=iterations)
    assert result.value_after <= result.value_before
    assert trace_value(watching, result.q, loads, kept, target) <= trace_value(watching, q, loads, kept, target) * (
        1 + 1e-9
    )
    assert result.iterations <= iterations


def test_a_refined_plan_stays_as_it_is_or_gets_better():
    watching, q, loads, kept, target, bounds = prepared(heavy_study(), seed=1)
    rows = target.reshape(-1, len(kept))
    first = refine(watching, q, loads, kept, rows, **bounds, max_iterations=2000)
    again = refine(watching, first.q, loads, kept, rows, **bounds, max_iterations=2000)
    assert again.value_after <= first.value_after
    assert again.gain < 1e-6
    if again.reason is not None:
        np.testing.assert_array_equal(again.q, first.q)


def test_a_fixed_plan_says_why_nothing_was_gained():
    watching, q, loads, kept, target, _ = prepared(heavy_study(), count=1)
    rows = target.reshape(-1, len(kept))
    result = refine(watching, q, loads, kept, rows, lower=q[0], upper=q[0])
    assert result.gain == 0.0
    assert "no better plan" in result.reason
    np.testing.assert_array_equal(result.q, q)


def test_joints_without_limits_and_sliding_joints():
    robot = replace(load_robot("kr270_r2700"), prismatic=np.array([0, 0, 1, 0, 0, 0], bool))
    watching, q, loads, kept, target, _ = prepared(heavy_study(robot=robot))
    bounds = {"lower": np.full(6, -np.inf), "upper": np.full(6, np.inf)}
    bounds["lower"][2], bounds["upper"][2] = -0.5, 0.5
    q = np.clip(q, bounds["lower"], bounds["upper"])
    result = refine(watching, q, loads, kept, target.reshape(-1, len(kept)), **bounds)
    assert result.gain > 0.05
    assert (np.abs(result.q[:, 2]) <= 0.5).all()


def test_visits_of_one_pose_may_part():
    watching, q, loads, kept, target, bounds = prepared(heavy_study(), count=2)
    repeated = np.repeat(q, 4, axis=0)
    result = refine(watching, repeated, np.repeat(loads, 4, axis=0), kept, target.reshape(-1, len(kept)), **bounds)
    assert result.gain > 0.2
    assert len(np.unique(result.q.round(6), axis=0)) > 2


def test_poses_that_are_not_allowed_move_less_or_not_at_all():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    rows = target.reshape(-1, len(kept))
    near = refine(watching, q, loads, kept, rows, **bounds, allowed=lambda moved: np.abs(moved - q).max(axis=1) < 0.3)
    assert np.abs(near.q - q).max() < 0.3
    assert near.gain > 0.0
    still = refine(
        watching,
        q,
        loads,
        kept,
        rows,
        **bounds,
        allowed=lambda moved: (moved[:, :] == q).all(axis=1) | (np.arange(len(q)) > 3),
    )
    np.testing.assert_array_equal(still.q[:4], q[:4])
    assert still.gain > 0.0
    none = refine(watching, q, loads, kept, rows, **bounds, allowed=lambda moved: np.zeros(len(q), bool))
    assert none.gain == 0.0


def test_limits_of_standard_deviations_and_guard():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    rows = target[:1].reshape(-1, len(kept))

    def stds(joints):
        block = watching.blocks(joints, loads)[:, :, kept].reshape(-1, len(kept))
        return np.sqrt(np.diag(np.linalg.inv(block.T @ block)))

    free = refine(watching, q, loads, kept, rows, **bounds)
    limits = 1.01 * stds(q)
    assert (stds(free.q) > limits).any(), "the limits did not matter"
    kept_in = refine(watching, q, loads, kept, rows, **bounds, max_std=limits)
    assert (stds(kept_in.q) <= limits * (1 + 1e-9)).all()
    assert kept_in.gain > 0.0
    guard = 10.0 * np.sqrt(free.value_before) * np.diag(1.0 / stds(q))
    guarded = refine(watching, q, loads, kept, rows, **bounds, guard=guard)
    assert guarded.gain > 0.0
    assert np.max(stds(guarded.q) / stds(q)) < np.max(stds(free.q) / stds(q))


# --- the rest --------------------------------------------------------------------------------------------------------


def test_same_input_same_bytes_and_nothing_printed(capfd):
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    results = [refine(watching, q, loads, kept, target.reshape(-1, len(kept)), **bounds, floor=0.3) for _ in range(2)]
    assert results[0].q.tobytes() == results[1].q.tobytes()
    assert results[0].iterations == results[1].iterations
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")
    with pytest.raises(ValueError, match="read-only"):
        results[0].q[0, 0] = 1.0


def test_what_cannot_be_refined_is_left_alone_with_a_reason():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    assert can_refine(watching) is None
    assert can_refine(watching, "E") == "criterion E has no derivative where the smallest eigenvalue repeats"
    result = refine(watching, q, loads, kept, None, criterion="E", **bounds)
    assert (result.status, result.iterations, result.gain) == ("not run", 0, 0.0)
    strange = replace(watching.model.effects[0], name="magic")
    other = replace(watching, model=replace(watching.model, effects=(strange,)))
    assert can_refine(other) == "effect magic has no symbolic columns"
    assert refine(other, q, loads, kept, target[0], **bounds).reason == can_refine(other)


def test_a_plan_that_does_not_show_all_parameters_is_left_alone():
    watching, q, loads, kept, target, bounds = prepared(heavy_study(markers=TIP), count=1)
    same = np.repeat(q, 1, axis=0)
    result = refine(watching, same, loads, kept, target.reshape(-1, len(kept)), **bounds)
    assert "does not show all kept parameters" in result.reason


def test_wrong_shapes_and_names():
    watching, q, loads, kept, target, bounds = prepared(heavy_study())
    with pytest.raises(InputError, match="needed: "):
        refine(watching, q[:, :5], loads, kept, target[0], **bounds)
    with pytest.raises(InputError, match="target of G"):
        refine(watching, q, loads, kept, target[0], criterion="G", **bounds)
    with pytest.raises(InputError, match="criterion is 'V'"):
        refine(watching, q, loads, kept, target[0], criterion="V", **bounds)
    with pytest.raises(InputError, match="guard"):
        refine(watching, q, loads, kept, None, criterion="D", guard=frozen(np.eye(len(kept))), **bounds)
