"""Two arms: the one that is not measured stands at its home pose, and the other one keeps clear of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doe.cli import run
from doe.feasible import check, screen
from doe.gaps import gaps_of
from doe.moves import free_moves
from identify.kinematics import forward
from identify.units import DEG
from tests.doe.two_arm_files import both, write_both

HOME = [10.0, 60.0, -70.0]
BLOCK = {"id": "L1", "mass_kg": 1.0, "attach_mm": [0.0, 0.0, 0.0], "size_mm": [200.0, 200.0, 300.0], "hang_mm": 200.0}
LOADS = {"loads": [{"id": "L0"}, BLOCK]}
PARKED = {"second": {"constraints": {"home_deg": HOME}}}
APART = {"arms": [{"name": "A", "study": "a.toml"}, {"name": "B", "study": "b.toml", "base_mm": [300.0, 400.0, 100.0]}],
         "waist": {"shared_joints": 0}, "test_poses": None, "plan": {"criterion": "A"}}  # fmt: skip
CASES = pytest.mark.parametrize("changes", [{}, APART], ids=["waist", "side by side"])


def along(robot, q, links):
    """(N, K, 60, 3) points along links, each between two joint origins or the flange (K, 2), base frame, m."""
    frames = forward(robot, q)
    corners = np.concatenate([frames.origin, frames.flange_origin[:, None]], axis=1)
    start, end = corners[:, links[:, 0], None], corners[:, links[:, 1], None]
    return start + np.linspace(0.0, 1.0, 60)[:, None] * (end - start)


def sampled(study, q, own_links, other_links):
    """(N, K) distance of links of the first arm at q (N, n) from links of the second at home, m.

    Each arm is placed in the world by its own kinematics, the second with the shared joints of the first.
    """
    first, second = study.arms
    turned = np.tile(second.study.constraints.home, (len(q), 1))
    turned[:, : study.shared] = q[:, : study.shared]
    own, other = first.study.robot, second.study.robot
    a = first.base + along(own, q, own_links) @ own.world_R_base.T
    b = second.base + along(other, turned, other_links) @ other.world_R_base.T
    return np.linalg.norm(a[:, :, :, None] - b[:, :, None], axis=4).min(axis=(2, 3))


@CASES
def test_the_gap_is_the_distance_of_both_arms_as_they_stand_in_the_world(tmp_path, changes):
    study = both(tmp_path, **PARKED, **changes)
    arm = study.arms[0].study
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (60, 3))
    found = gaps_of(arm).parked
    assert found.always == (() if study.shared == 0 else ("q2..q3 and B's q2..q3",)), "shoulders at one place"
    distance = found.link_gaps(forward(arm.robot, q)) + found.arm.radii[found.first] + found.radii[found.second]
    truth = sampled(study, q, found.arm.frames[found.first], found.hung.capsules.frames[found.second])
    assert truth.shape[1] >= 3
    assert (distance <= truth + 1e-9).all()
    np.testing.assert_allclose(distance, truth, atol=0.04)
    assert (np.ptp(truth, axis=0) > 0.1).all()


def test_a_parked_arm_on_the_same_waist_turns_along(tmp_path):
    arm = both(tmp_path, **PARKED).arms[0].study
    q = np.random.default_rng(2).uniform(-2.0, 2.0, (20, 3))
    turned = q + np.array([1.3, 0.0, 0.0])
    gaps = gaps_of(arm)
    np.testing.assert_allclose(*(gaps.to_parked(forward(arm.robot, values)) for values in (q, turned)), atol=1e-12)


def test_what_hangs_keeps_clear_too(tmp_path):
    """The weight below the tip meets the parked arm where the links alone do not."""
    arm = both(tmp_path, first=LOADS, **PARKED, **APART).arms[0].study
    gaps = gaps_of(arm)
    q = np.random.default_rng(3).uniform(-2.5, 2.5, (800, 3))
    bare, loaded = gaps.to_parked(forward(arm.robot, q)).T
    assert (loaded <= bare + 1e-12).all()
    meets = np.flatnonzero((loaded < 0.0) & (bare > 0.05))
    assert len(meets)
    centre = gaps.weights.centres(gaps.weights.tops(forward(arm.robot, q[meets])))[:, 1]
    size = np.linalg.norm(arm.loads[1].size) / 2 + arm.loads[1].hang + gaps.parked.radii.max()
    start, end = gaps.parked.segments(forward(arm.robot, q[meets]))
    share = np.linspace(0.0, 1.0, 40)[:, None, None]
    near = np.linalg.norm(start[:, None] + share * (end - start)[:, None] - centre[:, None, None], axis=3)
    assert (near.min(axis=(1, 2)) < size).all()


def test_moves_keep_clear_of_the_parked_arm(tmp_path):
    arm = both(tmp_path, **PARKED, **APART).arms[0].study
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.5, 2.5, (400, 3))
    q = q[gaps_of(arm).to_parked(forward(arm.robot, q))[:, 0] > 0.03][:60]
    q_from, q_to = q[:30], q[30:60]
    free = free_moves(arm, q_from, q_to)
    share = np.linspace(0.0, 1.0, 300)[:, None]
    least = np.array([
        gaps_of(arm).to_parked(forward(arm.robot, a + share * (b - a))).min() for a, b in zip(q_from, q_to, strict=True)
    ])
    assert not free[least < -0.02].any()
    assert 0 < free.sum() < 30
    alone = replace(arm, neighbour=None)
    assert free_moves(alone, q_from, q_to)[least < -0.02].any(), "it is the parked arm that is in the way"


def test_plan_counts_what_meets_the_parked_arm_and_evaluate_finds_it_again(tmp_path, capsys):
    path = write_both(tmp_path, **PARKED, plan={"candidates": 120, "poses": 8, "criterion": "A"})
    assert run(["plan", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    made = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert made["rejected"]["arm_collision"] > 0
    printed = capsys.readouterr().out
    assert "note: A is checked against B at the home pose of b.toml" in printed
    assert "note: collisions of B with A are not checked" in printed
    assert "home_deg of a.toml" in printed

    study = both(tmp_path, **PARKED)
    arm = study.arms[0].study
    rows = [line.split(",") for line in (tmp_path / "out" / "plan_A.csv").read_text().splitlines()[1:]]
    q = np.array([[float(cell) for cell in row[2:5]] for row in rows]) * DEG
    assert check(arm, q, np.ones((len(q), 1), dtype=int)).ok.all()

    bad = np.random.default_rng(5).uniform(-2.5, 2.5, (300, 3))
    bad = bad[screen(arm).failures(bad)["arm_collision"][:, 1]][:4] / DEG
    bad[:, 0] = 0.0
    lines = [f"P{i},L1,{','.join(f'{value:.6f}' for value in pose)}" for i, pose in enumerate(bad)]
    with (tmp_path / "out" / "plan_A.csv").open("a") as stream:
        stream.write("\n".join(line.replace("P", "X", 1) for line in add_time(lines, rows)) + "\n")
    assert run(["evaluate", str(path), str(tmp_path / "out"), "--out", str(tmp_path / "judged"), "--quiet"]) == 0
    told = json.loads((tmp_path / "judged" / "evaluate.json").read_text())
    assert told["visits_rejected"] == {"A": {"arm_collision": 4}, "B": {}}
    assert "note: A: given visits that break a constraint of the study: arm_collision 4" in capsys.readouterr().out


def add_time(lines, rows):
    """The lines with as many columns as the rows of the plan have."""
    return [line + ",0" * (len(rows[0]) - 5) for line in lines]


def test_a_home_pose_in_the_other_arm_is_refused(tmp_path, capsys):
    """Both arms of one waist at the same joint values are at one place."""
    same = {"constraints": {"home_deg": HOME}}
    path = write_both(tmp_path, first=same, second=same)
    assert run(["plan", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert "home_deg: the arm cannot stand there, arm_collision is broken" in capsys.readouterr().err


def test_without_a_home_pose_nothing_is_parked(tmp_path):
    study = both(tmp_path)
    assert [arm.study.neighbour for arm in study.arms] == [None, None]
    assert np.isinf(gaps_of(study.arms[0].study).to_parked(forward(study.arms[0].study.robot, np.zeros(3)))).all()
