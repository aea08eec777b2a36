"""Candidate visits: what is drawn, what is kept and what is said when little is left."""

import logging
import tracemalloc
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from doe.candidates import candidates, load_choices, rounded, sampled_range
from doe.feasible import check, joint_range
from identify.errors import Infeasible, InputError
from identify.experiment import full_experiment
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.study import Constraints, Noise, PlanSettings, Study
from identify.tables import load_plan, plan_csv
from identify.units import DEG

MARKERS = Markers(("M1",), np.array([[0.1, 0.05, 0.0]]), np.array([False]))
LOADS = (LoadCase("L0"), *(LoadCase(f"L{i}", mass=2.0 * i, attach=np.array([0.1, 0, -0.1 * i])) for i in (1, 2, 3)))


def study_of(robot="ur10", loads=LOADS, plan=None, **constraints):
    if isinstance(robot, str):
        robot = load_robot(robot)
    return Study(
        Path("s.toml"), robot, loads, MARKERS, Noise(1e-5),
        plan=PlanSettings(**(plan or {})), constraints=Constraints(**constraints),
    )  # fmt: skip


def gantry(lower=0.0, upper=1.5):
    """Three sliding joints along x, y, z of the base and a turning one, on a portal 2 m high."""
    x, y, z, flange = np.eye(4), np.eye(4), np.eye(4), np.eye(4)
    x[:3, :3], x[2, 3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]], 2.0
    y[:3, :3] = z[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    flange[2, 3] = -0.2
    nan = np.full(4, np.nan)
    return Robot(
        "gantry", ("x", "y", "z", "c"), np.array([True, True, True, False]), np.array([x, y, z, np.eye(4), flange]),
        np.array([lower, lower, -1.9, -np.pi]), np.array([upper, upper, 0.0, np.pi]), nan, np.full((4, 3), np.nan), nan,
    )  # fmt: skip


# ---- number and order


@pytest.mark.parametrize(
    ("plan", "choices"),
    [
        ({}, [[0, 1], [0, 2], [0, 3]]),
        ({"loads": ("L2",)}, [[0, 2]]),
        ({"loads": ("L3", "L1")}, [[0, 3], [0, 1]]),
        ({"loads_per_pose": 2}, [[0, 1, 2], [0, 1, 3], [0, 2, 3]]),
        ({"loads_per_pose": 3}, [[0, 1, 2, 3]]),
        ({"reference_rows": False}, [[1], [2], [3]]),
        ({"loads": ("L0", "L1")}, [[0, 1]]),  # the unloaded state is read anyway
        ({"loads": ("L0", "L1"), "reference_rows": False}, [[0], [1]]),
    ],
)
def test_choices_of_loads(plan, choices):
    assert load_choices(study_of(plan=plan)).tolist() == choices


@pytest.mark.parametrize("reference", [True, False])
def test_without_loaded_loads_the_unloaded_state_is_read(reference):
    study = study_of(loads=LOADS[:1], plan={"reference_rows": reference, "candidates": 10})
    assert candidates(study, seed=0).visit_loads.tolist() == [[0]] * 10


@pytest.mark.parametrize(("wanted", "poses"), [(1, 1), (2, 1), (3, 1), (7, 2), (100, 33), (5000, 1666)])
def test_every_pose_comes_with_every_choice(wanted, poses):
    study = study_of(plan={"candidates": wanted})
    found = candidates(study, seed=3)
    assert len(found) == 3 * poses == len(found.pose) == len(found.visit_loads)
    assert found.q.shape == (poses, 6)
    np.testing.assert_array_equal(found.pose, np.repeat(np.arange(poses), 3))
    np.testing.assert_array_equal(found.visit_loads, np.tile(load_choices(study), (poses, 1)))
    np.testing.assert_array_equal(found.visit_q, np.repeat(found.q, 3, axis=0))


def test_a_load_that_hangs_too_low_costs_only_its_own_visits():
    study = study_of(plan={"candidates": 600}, floor=-0.2)
    deep = LoadCase("L1", mass=2.0, attach=np.array([0.0, 0.0, 0.9]))
    study = replace(study, loads=(LOADS[0], deep, LOADS[2], LOADS[3]))
    found = candidates(study, seed=1)
    share = np.bincount(found.visit_loads[:, 1], minlength=4)
    assert 590 < len(found) <= 600
    assert 0 < share[1] < 0.97 * share[2]
    assert set(found.pose) == set(range(len(found.q)))


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(["ur10", "kr270_r2700", "sda5f_r2", "planar_2r", "planar_3r", "single_joint", "gantry"]),
    wanted=st.integers(1, 300),
    loads_per_pose=st.integers(1, 3),
    reference=st.booleans(),
    floor=st.sampled_from([None, -0.5, 0.1]),
    roll=st.sampled_from([0.0, np.pi, 1.0]),
    seed=st.integers(0, 2**32),
)
def test_candidates_are_feasible_counted_and_on_the_grid_of_the_file(
    name, wanted, loads_per_pose, reference, floor, roll, seed
):
    robot = gantry() if name == "gantry" else load_robot(name, mount=(roll, 0, 0))
    plan = {"candidates": wanted, "loads_per_pose": loads_per_pose, "reference_rows": reference}
    floor = floor if floor is None or roll == 0 else floor - 2.2  # below the ceiling
    study = study_of(robot, plan=plan, floor=floor, joint_margin=0.02, joint_margin_slide=0.01)
    found = candidates(study, seed=seed)
    result = check(study, found.visit_q, found.visit_loads)
    assert result.ok.all()
    assert found.drawn == len(found) + sum(found.rejected.values())
    choices = load_choices(study)
    assert len(found) <= max(wanted, len(choices))
    assert len(found) > wanted - len(choices)
    assert choices.shape[1] == loads_per_pose + reference
    lower, upper = joint_range(study)
    assert ((found.q >= lower - 1e-11) & (found.q <= upper + 1e-11)).all()
    np.testing.assert_array_equal(rounded(study, found.q), found.q)
    assert found.rejected["joint_limits"] == 0


def test_all_sets_of_loads_stand_at_a_pose():
    found = candidates(study_of(plan={"candidates": 5, "loads_per_pose": 2}), seed=0)
    assert [tuple(loads) for loads in found.visit_loads] == [(0, *pair) for pair in combinations((1, 2, 3), 2)]


# ---- the sequence


def test_the_same_seed_gives_the_same_arrays_and_another_seed_others():
    study = study_of(plan={"candidates": 500}, floor=0.0)
    first, second, other = (candidates(study, seed=seed) for seed in (5, 5, 6))
    for key in ("q", "pose", "visit_loads"):
        assert getattr(first, key).tobytes() == getattr(second, key).tobytes()
        assert not getattr(first, key).flags.writeable
    assert first.rejected == second.rejected
    assert first.q.tobytes() != other.q.tobytes()


def test_more_candidates_continue_fewer():
    few, many = (candidates(study_of(plan={"candidates": n}, floor=0.0), seed=2) for n in (300, 20_000))
    np.testing.assert_array_equal(many.q[: len(few.q)], few.q)


def test_poses_fill_the_range_evenly():
    study = study_of("kr270_r2700", plan={"candidates": 4096 * 3}, self_collision=False)
    q = candidates(study, seed=0).q
    lower, upper = sampled_range(study)
    share = (q - lower) / (upper - lower)
    for column in share.T:
        np.testing.assert_array_equal(np.histogram(column, bins=16, range=(0, 1))[0], 256)


def test_one_turn_around_the_middle_is_sampled():
    study = study_of("ur10", joint_margin=2 * DEG)
    lower, upper = (limit / DEG for limit in sampled_range(study))
    np.testing.assert_allclose(upper, [180, 180, 178, 180, 180, 180])
    np.testing.assert_allclose(lower, -upper)
    np.testing.assert_allclose(sampled_range(study_of("kr270_r2700"))[0][1] / DEG, -140)
    shifted = replace(load_robot("planar_2r"), lower=np.array([-1.0, 0.0]), upper=np.array([9.0, 2.0]))
    np.testing.assert_allclose(sampled_range(study_of(shifted)), [[4 - np.pi, 0], [4 + np.pi, 2]])


def test_a_continuous_joint_is_sampled_over_one_turn_around_zero():
    robot = load_robot("planar_2r")
    free = replace(robot, lower=np.array([-np.inf, 0.0]), upper=np.array([np.inf, 2.0]))
    with pytest.raises(InputError, match="no limits are stated of joint"):
        sampled_range(study_of(free))
    turning = replace(free, continuous=np.array([True, False]))
    np.testing.assert_allclose(sampled_range(study_of(turning, joint_margin=0.1)), [[-np.pi, 0.1], [np.pi, 1.9]])


# ---- rounding


@pytest.mark.parametrize("robot", ["kr270_r2700", "ur10", gantry(lower=0.1234567891, upper=1.4999999999)])
def test_a_plan_file_holds_exactly_what_was_evaluated(tmp_path, robot):
    study = study_of(robot, plan={"candidates": 300})
    found = candidates(study, seed=4)
    path = tmp_path / "plan.csv"
    path.write_text(plan_csv(full_experiment(found.visit_q, found.visit_loads, study.loads, MARKERS), study))
    read = load_plan(path, study).q
    np.testing.assert_array_equal(read.reshape(len(found), -1, study.robot.n)[:, 0], found.visit_q)


@settings(max_examples=200, deadline=None)
@given(st.floats(-3.2, 3.2), st.floats(-3.0, 3.0), st.floats(1e-3, 1.0), st.floats(0, 4e-4))
def test_rounded_values_stay_inside_and_near(value, lower, span, margin):
    robot = replace(load_robot("single_joint"), lower=np.array([lower]), upper=np.array([lower + span]))
    study = study_of(robot, joint_margin=margin)
    inside = np.clip(value, lower + margin, lower + span - margin)
    q = rounded(study, np.array([inside]))
    assert abs(q[0] - inside) <= 1.001e-6 * DEG
    assert lower + margin - 1.01e-9 * DEG <= q[0] <= lower + span - margin + 1.01e-9 * DEG
    np.testing.assert_array_equal(rounded(study, q), q)


def test_limits_of_the_file_are_reached_and_unknown_ones_do_no_harm():
    study = study_of("kr270_r2700")
    robot = study.robot
    np.testing.assert_allclose(rounded(study, robot.lower), robot.lower, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rounded(study, robot.upper), robot.upper, rtol=0, atol=1e-15)
    endless = replace(robot, lower=np.full(6, -np.inf), upper=np.full(6, np.inf))
    np.testing.assert_allclose(rounded(study_of(endless), np.full(6, 123.0)), 123.0, rtol=0, atol=1e-8)


# ---- little or nothing left


def test_every_reason_is_counted():
    heavy = LoadCase("L4", mass=11.0)
    study = study_of(loads=(*LOADS, heavy), plan={"candidates": 400}, floor=0.0)
    found = candidates(study, seed=0)
    counts = found.rejected
    assert counts["floor"] > 0
    assert counts["self_collision"] > 0
    # the heavy load fails at every pose that is otherwise good
    assert counts["payload"] > 0
    assert 4 not in found.visit_loads
    assert found.drawn == len(found) + sum(counts.values())


def test_nothing_feasible_says_which_constraint_and_what_to_change():
    with pytest.raises(Infeasible) as error:
        candidates(study_of(plan={"candidates": 20}, floor=5.0), seed=0)
    words = str(error.value)
    assert words.startswith("s.toml: none of ")
    assert "floor rejected" in words
    assert "a lower floor_mm" in words
    assert "payload" not in words


def test_loads_above_the_payload_leave_nothing():
    study = study_of(plan={"candidates": 20}, payload_share=0.1)
    with pytest.raises(Infeasible, match=r"payload rejected .*lighter loads or a larger payload_share"):
        candidates(study, seed=0)


def test_too_few_are_used_with_a_warning(caplog):
    study = study_of("single_joint", plan={"candidates": 6000, "loads": ("L1",)}, floor=0.9995)
    with caplog.at_level(logging.WARNING, "elastocal"):
        found = candidates(study, seed=0)
    assert 0 < len(found) < 6000
    assert (
        f"s.toml: only {len(found)} of 6000 candidates found among {found.drawn} drawn: floor rejected" in caplog.text
    )
    assert check(study, found.visit_q, found.visit_loads).ok.all()


def test_links_that_always_touch_are_reported(caplog):
    robot = load_robot("planar_3r")
    robot = replace(robot, lower=np.array([-3, 2.1, 2.6]), upper=np.array([3, 2.2, 2.7]))
    with caplog.at_level(logging.WARNING, "elastocal"):
        found = candidates(study_of(robot, plan={"candidates": 30}), seed=0)
    assert found.unchecked == ("q1..q2 and q3..flange",)
    assert "touch in every pose and are not checked against each other: q1..q2 and q3..flange" in caplog.text


def test_nothing_is_said_when_all_is_well(caplog):
    with caplog.at_level(logging.WARNING, "elastocal"):
        candidates(study_of("kr270_r2700", plan={"candidates": 100}, floor=0.1), seed=0)
    assert not caplog.records


# ---- bad input


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_robot_without_limits_names_joint_file_and_remedy(side):
    robot = load_robot("ur10")
    limits = getattr(robot, side).copy()
    limits[[1, 4]] = -np.inf if side == "lower" else np.inf
    study = replace(study_of(replace(robot, **{side: limits})), inputs=(Path("s.toml"), Path("arm.urdf")))
    with pytest.raises(InputError) as error:
        candidates(study, seed=0)
    words = str(error.value)
    assert words.startswith("arm.urdf: no limits are stated of joint shoulder, wrist_2 of Universal Robots UR10")
    assert "lower_deg and upper_deg" in words


def test_a_margin_that_leaves_no_range():
    with pytest.raises(InputError, match=r"s.toml: \[constraints\] joint margin leaves no range to joint A2"):
        candidates(study_of("kr270_r2700", joint_margin=70 * DEG), seed=0)


@pytest.mark.parametrize(
    ("loads", "plan", "words"),
    [
        (LOADS[1:], {}, "add a load of 0 kg under .* or set reference_rows = false"),
        (LOADS, {"loads_per_pose": 4}, "loads_per_pose = 4, allowed are 1 to 3: .* L1, L2, L3"),
        (LOADS, {"loads": ("L0", "L1"), "loads_per_pose": 2}, "loads_per_pose = 2, allowed are 1 to 1: .* L1"),
        (
            (LOADS[0], *(LoadCase(f"W{i}", mass=1.0) for i in range(40))),
            {"loads_per_pose": 20},
            "137846528820 choices at each pose",
        ),
    ],
)
def test_loads_that_the_plan_cannot_use(loads, plan, words):
    with pytest.raises(InputError, match=r"^s.toml: \[plan\] .*" + words):
        candidates(study_of(loads=loads, plan=plan), seed=0)


def test_without_the_unloaded_state_plans_without_reference_rows_work():
    found = candidates(study_of(loads=LOADS[1:], plan={"reference_rows": False, "candidates": 6}), seed=0)
    assert found.visit_loads.tolist() == [[0], [1], [2]] * 2


# ---- size


def test_memory_of_many_candidates_is_that_of_the_result():
    study = study_of("kr270_r2700", plan={"candidates": 60_000}, floor=0.1)
    candidates(replace(study, plan=PlanSettings(candidates=10)), seed=0)  # imports
    tracemalloc.start()
    found = candidates(study, seed=0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == 60_000
    assert peak < 60e6
