"""Straight joint moves against a walk in tiny steps."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe.candidates import candidates
from doe.commands import run_plan
from doe.earlier import in_reach, only
from doe.gaps import gaps_of
from doe.lifts import NOTHING, hung_states
from doe.moves import STEP, free_moves
from doe.order import Pace, Visits
from doe.order_search import best_order
from doe.plan import plan
from doe.travel import travel_between
from identify.cell import Box
from identify.config import load_study
from identify.errors import Infeasible, InputError
from identify.kinematics import forward
from identify.loads import LoadCase
from identify.tables import load_plan, plan_experiment
from identify.units import DEG
from tests.doe.cell_cases import BLOCK, CABINET, UNLOADED, cell, poses
from tests.doe.study_files import ARM, KR270, study, study_file

CELL = Path(__file__).parents[2] / "configs" / "studies" / "kr270_cell.toml"


def walked(study, q_from, q_to, load, steps=400):
    """(M,) least gap on the way, m."""
    gaps, share = gaps_of(study), np.linspace(0, 1, steps)[:, None]
    least = []
    for a, b in zip(q_from, q_to, strict=True):
        frames = forward(study.robot, a + share * (b - a))
        own = [gap(frames) for gap in gaps.by_reason.values()]
        least.append(min(g[:, min(load, g.shape[1] - 1)].min() for g in own))
    return np.array(least)


@pytest.mark.parametrize("load", [0, 1])
def test_moves_are_free_where_a_walk_in_small_steps_meets_nothing(load):
    study = cell(boxes=(CABINET,), floor=0.1, loads=(UNLOADED, BLOCK), self_collision=load == 0)
    q = poses(study, 3000)
    ready = [gap(forward(study.robot, q)) for gap in gaps_of(study).by_reason.values()]
    q = q[np.min([g[:, min(load, g.shape[1] - 1)] for g in ready], axis=0) > 0.02][:160]
    q_from, q_to = q[:80], q[80:160]
    free = free_moves(study, q_from, q_to, np.full(80, load))
    least = walked(study, q_from, q_to, load)
    assert not free[least < -STEP].any()
    assert free[least > 0].all()
    assert 5 < free.sum() < 75


def test_a_thin_plate_between_two_poses_is_not_jumped_over():
    plate = Box("plate", np.array([1.6, 0.0, 1.5]), np.array([1.0, 0.0005, 1.5]), np.eye(3))
    study = cell(boxes=(plate,), loads=(UNLOADED,))
    left, right = (np.array([side, -90, 90, 0, 0, 0]) * DEG for side in (-60, 60))
    assert free_moves(study, left, left).all()
    assert not free_moves(study, left, right).any()
    assert free_moves(replace(study, constraints=replace(study.constraints, boxes=())), left, right).all()


def test_a_hung_weight_makes_a_move_impossible_that_is_free_without_it():
    low = Box("table", np.array([2.0, 0.0, 0.5]), np.array([0.6, 0.2, 0.7]), np.eye(3))
    study = cell(boxes=(low,))
    left, right = (np.array([side, -90, 90, 0, 0, 0]) * DEG for side in (-50, 50))
    assert free_moves(study, left, right).tolist() == [True]
    assert free_moves(study, left, right, np.array([0, 1])[:1]).tolist() == [True]
    assert free_moves(study, left, right, np.array([1])).tolist() == [False]


def test_many_moves_from_one_pose_equal_single_ones_and_both_ends_count():
    study = cell(boxes=(CABINET,), floor=0.1, loads=(UNLOADED, LoadCase("P", 10.0)))
    q = poses(study, 40)
    home = np.array([0, -90, 90, 0, 0, 0]) * DEG
    together = free_moves(study, home, q)
    assert together.tolist() == [bool(free_moves(study, home, one)[0]) for one in q]
    np.testing.assert_array_equal(together, free_moves(study, q, home))
    bad = np.array([[0, -5, 150, 0, 0, 0]]) * DEG
    assert not free_moves(study, home, bad).any()
    assert free_moves(study, np.zeros((0, 6)), np.zeros((0, 6))).shape == (0,)


def test_shapes_that_do_not_fit_are_named():
    study = cell()
    with pytest.raises(InputError, match=r"shapes \(2, 6\), \(3, 6\)"):
        free_moves(study, np.zeros((2, 6)), np.zeros((3, 6)))


# --- in the order of a plan


def test_moves_of_a_plan_are_free_with_what_hangs_on_the_way():
    whole = load_study(CELL)
    small = replace(whole.plan, candidates=600, poses=8, refine=False, stations=("front",))
    made = plan(replace(whole, plan=small)).schedule
    study = replace(whole, plan=small)
    states = hung_states(made.visit_loads, np.array([load.unloaded for load in study.loads]))
    q, home = made.q, study.constraints.home
    left, entry = states[:-1, -1], states[1:, 0]
    loaded = np.flatnonzero((left == entry) & (left != NOTHING))
    assert len(loaded)
    for visit in range(len(q) - 1):
        hung = left[[visit]] if visit in loaded else None
        straight = free_moves(study, q[visit], q[visit + 1], hung)[0]
        assert straight or (
            free_moves(study, q[visit], home, hung)[0] and free_moves(study, home, q[visit + 1], hung)[0]
        )
    assert free_moves(study, home, q[0])[0]


FENCES = [  # in front and behind; between them the arm turns freely
    {"name": name, "centre_mm": [x, 0.0, 1500.0], "size_mm": [2400.0, 20.0, 3600.0]}
    for name, x in (("front", 2000.0), ("rear", -2000.0))
]


def fenced(folder, sides, seed=0, **constraints):
    """The summary of a plan among fences, its moves, and which of them are free with what hangs on the way."""
    push = {"wrench": [0.0, 0.0, -1500.0, 0.0, 0.0, 0.0], "attach_mm": [300.0, 0.0, 0.0]}
    path = study_file(
        folder, KR270, plan={"poses": 6, "candidates": 60, "refine": False, "curve": False, "loads": ["L1", "L2"]},
        times={"pose_s": 30.0, "speed_deg_s": 10.0}, constraints={"boxes": FENCES, **constraints},
        test_poses=[{"joints_deg": [side, -60.0, 90.0, 0.0, 45.0, 0.0], **push} for side in sides],
    )  # fmt: skip
    outcome, study = run_plan(path, seed=seed, out=folder / "out"), load_study(path)
    (folder / "plan.csv").write_text(outcome.tables["plan.csv"])
    experiment = plan_experiment(load_plan(folder / "plan.csv", study), study)
    loads = experiment.shot_load.reshape(len(experiment.visits), -1)
    states = hung_states(loads, np.array([load.unloaded for load in study.loads]))
    left, entry = states[:-1, -1], states[1:, 0]
    free = []
    for k, (leaves, enters) in enumerate(zip(left, entry, strict=True)):
        hung = np.array([leaves]) if leaves == enters != NOTHING else None
        free.append(bool(free_moves(study, experiment.q[k], experiment.q[k + 1], hung)[0]))
    return outcome.content, experiment, np.array(free)


def test_moves_are_looked_at_without_a_home_pose_and_those_that_collide_are_named(tmp_path):
    """A fence parts the poses; nobody said where a way around is, so the plan stands and says what not to drive."""
    made, experiment, free = fenced(tmp_path, (-90.0, 90.0), seed=2)
    named = [tuple(pair) for pair in made["order"]["blocked"]]
    names = experiment.visits
    assert named == [(names[k], names[k + 1]) for k in np.flatnonzero(~free)]
    assert 0 < len(named) < len(names) - 1
    assert any(f"{named[0][0]} to {named[0][1]}" in note and "home_deg" in note for note in made["notes"])
    turned = np.abs(np.diff(experiment.q, axis=0)).max(axis=1) / DEG
    assert made["order"]["travel_deg"] == pytest.approx(turned.sum())
    assert made["time_s"] == pytest.approx(6 * 30.0 + turned.sum() / 10.0)


def test_poses_on_one_side_of_a_fence_are_joined_by_free_moves(tmp_path):
    wall = {"name": "side", "point_mm": [0.0, -400.0, 0.0], "normal": [0.0, 1.0, 0.0]}
    made, _, free = fenced(tmp_path, (-90.0,), seed=2, walls=[wall])
    assert made["order"]["blocked"] == []
    assert free.all()
    assert not any("home_deg" in note for note in made["notes"])


def test_a_weight_that_cannot_go_along_is_taken_off_for_the_way():
    q = np.array([[-1.0, 0.0], [1.0, 0.0]])

    def bare_only(first, _, load):
        return np.full(len(first), load is None)

    def ordered(free):
        travel = travel_between(q, np.zeros(2, dtype=bool), free=free, hung=np.array([False, True]))
        visits = Visits([[0, 1], [0, 1]], [True, False], travel, Pace(), np.zeros((2, 2, 1)))
        found, fewest = best_order(visits, np.random.default_rng(0))
        travel.check(found.visit, found.carried, ("P001", "P002"), "study")
        assert fewest.lifts == 2
        return found

    assert ordered(None).lifts == 2
    assert ordered(None).carried.tolist() == [NOTHING, 1]
    assert ordered(bare_only).lifts == 3
    assert ordered(bare_only).carried.tolist() == [NOTHING, NOTHING]


def test_a_weight_that_all_visits_read_is_hung_again_where_it_cannot_go_along():
    """Three poses, the last one out of reach with the weight on: it is taken off and hung again once."""
    q = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])

    def bare_to_the_last(first, second, load):
        return np.full(len(first), load is None) | ((first[:, 0] < 0.5) & (second[:, 0] < 0.5))

    travel = travel_between(q, np.zeros(2, dtype=bool), free=bare_to_the_last, hung=np.array([False, True]))
    pace = Pace(pose=10.0, reading=10.0, load_change=100.0)
    visits = Visits([[1], [1], [1]], [True, False], travel, pace, np.zeros((3, 1, 1)))
    found, fewest = best_order(visits, np.random.default_rng(0))
    travel.check(found.visit, found.carried, ("P001", "P002", "P003"), "study")
    assert (fewest.lifts, found.lifts) == (1, 3)
    assert found.visit[1] != 2
    assert sorted(found.carried.tolist()) == [NOTHING, NOTHING, 1]
    assert found.times.max() == 3 * 10.0 + 3 * 100.0


def test_poses_that_no_order_can_hold_are_left_out(tmp_path):
    """A wall in the way of joint 1: nothing beyond zero is reached, which no constraint on single poses tells."""
    made = study(tmp_path, ARM, plan={"candidates": 200, "curve": False})

    def this_side(first, second, _):
        return (first[:, 0] < 0.0) & (second[:, 0] < 0.0)

    found = plan(made, home=np.array([-0.5, 0.0, 0.0]), free=this_side)
    assert (found.q[:, 0] < 0.0).all()
    assert found.schedule is not None
    assert 50 < found.pool.candidates.rejected["unreachable"] < 150
    assert any(re.search(r"searched again .* costs [0-9.]+ % of the criterion", note) for note in found.notes)
    with pytest.raises(Infeasible, match="can be reached from the home pose"):
        plan(made, home=np.array([-0.5, 0.0, 0.0]), free=lambda first, *_: np.zeros(len(first), dtype=bool))


def test_moves_from_home_are_looked_at_for_the_most_promising_poses_until_there_are_enough(tmp_path, monkeypatch):
    made = study(tmp_path, ARM, plan={"candidates": 60, "curve": False})
    drawn = candidates(made, seed=0)
    best, asked = np.random.default_rng(2).permutation(len(drawn)), []

    def reached(q):
        asked.append(q)
        return q[:, 0] < 0.0

    monkeypatch.setattr("doe.earlier._ENOUGH", 10)
    kept = in_reach(made, drawn, best, reached)
    looked = np.concatenate(asked)
    assert 10 <= len(looked) < len(drawn.q)
    np.testing.assert_array_equal(np.unique(looked, axis=0), np.unique(drawn.visit_q[best[: len(looked)]], axis=0))
    left = only(drawn, kept, unreachable=int(len(kept) - kept.sum()))
    assert len(left.q) >= 5
    np.testing.assert_array_equal(np.unique(left.visit_q, axis=0), np.unique(looked[looked[:, 0] < 0.0], axis=0))
    assert len(left) + left.rejected["unreachable"] == len(drawn)


def test_the_same_pose_is_tested_once_and_long_moves_between_many_poses_go_over_home(monkeypatch):
    asked = []

    def free(start, end, loads):
        asked.append((start, end, loads))
        return np.ones(len(start), dtype=bool)

    home, few = np.zeros(2), np.array([[0.3, 0.0], [0.1, 0.2], [0.3, 0.0], [0.3, 0.0]])
    hung, turning = np.array([False, True]), np.zeros(2, dtype=bool)
    travel = travel_between(few, turning, home=home, free=free, hung=hung)
    assert [len(start) for start, _, _ in asked] == [3, 3]  # two poses and home: with nothing, with the weight
    assert travel.length[0, 0, 2] == 0.0
    assert not travel.detour.any()

    monkeypatch.setattr("doe.travel._TESTED", 100)
    many = np.random.default_rng(3).uniform(-1.0, 1.0, (60, 2))
    asked.clear()
    travel = travel_between(many, turning, home=home, free=free, hung=hung)
    assert all(100 <= len(start) <= 100 + 61 for start, _, _ in asked)
    size = np.abs(many[:, None] - many).max(axis=2)
    over = np.abs(many).max(axis=1)
    far = size > np.sort(size[np.triu_indices(60, 1)])[101]
    np.testing.assert_allclose(travel.length[0, :-1, :-1][far], (over[:, None] + over)[far])
    np.testing.assert_allclose(travel.length[0, :-1, :-1][size < 0.05], size[size < 0.05])
    asked.clear()
    travel_between(many, turning, free=free)  # without a home there is nothing to go over: all are tested
    assert [len(start) for start, _, _ in asked] == [60 * 59 // 2]


def test_a_weight_is_not_tried_on_a_move_that_the_bare_arm_cannot_make():
    loaded = []

    def free(start, end, loads):
        if loads is not None:
            loaded.append(len(start))
        return np.abs(end - start).max(axis=1) < 1.0

    q = np.array([[0.0], [0.9], [1.8]])
    travel = travel_between(q, np.zeros(1, dtype=bool), free=free, hung=np.array([True]))
    assert loaded == [2]
    assert not np.isfinite(travel.length[:, 0, 2]).any()
