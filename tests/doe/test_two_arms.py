"""Two arms that face one task: rows against a brute-force waist, plans with proof, spread of the relative error."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe.approximate import approximate_design
from doe.cli import run
from doe.evaluate import evaluate
from doe.exact import exact_design
from doe.information import covariance_of, information_of, standard_deviations
from doe.observations import observer
from doe.plan import plan
from doe.two_arm_plan import evaluate_both, plan_for_both, relative_accuracy
from doe.two_arm_pool import build_two_arm_pool, drawn
from doe.two_arms import relative_jitter, two_arm_observer
from identify.config import load_study
from identify.errors import Infeasible, NotIdentifiable
from identify.experiment import full_experiment
from identify.identification import identify
from identify.kinematics import forward
from identify.model import model_of
from identify.simulate import default_placement, simulate
from identify.truth import load_truth
from identify.two_arm_config import load_two_arm_study
from identify.two_arm_study import task_points
from identify.units import MM, URAD
from tests.doe.two_arm_files import DOWN, PULL, PUSH, SDA5F, TRUTHS, UP, both, write_both

# --- a brute-force model: two chains on springs, the shared ones loaded by both


def world_point(arm, q, local):
    """(3,) a point of the flange in the world."""
    robot = arm.study.robot
    return arm.base + robot.world_R_base @ forward(robot, q[None]).point(local)[0]


def work(arm, pose, q, *, shared):
    """Work that load and self-weight of one arm can do at joint values q; the waist weighs nothing where not shared."""
    robot = arm.study.robot
    force = turn_of(arm, pose.q) @ pose.wrench[:3] if pose.in_flange else pose.wrench[:3]
    masses = np.where(np.isfinite(robot.masses), robot.masses, 0.0)
    masses[0] *= shared
    return force @ world_point(arm, q, pose.attach) + masses @ (forward(robot, q[None]).centre[0] @ robot.gravity_base)


def turn_of(arm, q):
    """(3, 3) flange frame in the world."""
    return arm.study.robot.world_R_base @ forward(arm.study.robot, q[None]).flange_rotation[0]


def torques(arm, pose, *, shared):
    """(n,) torque of load and self-weight on each joint, by differences of the work."""
    ends = [[work(arm, pose, pose.q + sign * h, shared=shared) for sign in (1, -1)] for h in 1e-6 * np.eye(len(pose.q))]
    return np.diff(ends, axis=1)[:, 0] / -2e-6


def brute_rows(study, task):
    """{name: (3,)} d(p2 - p1)/d(compliance), m per urad/Nm, of two chains with one common first joint."""
    t = [
        torques(arm, pose, shared=side == 0)
        for side, (arm, pose) in enumerate(zip(study.arms, task.poses, strict=True))
    ]
    waist = t[0][0] + t[1][0]

    def error(turns):
        points = [
            world_point(arm, pose.q + turn, pose.point)
            for arm, pose, turn in zip(study.arms, task.poses, turns, strict=True)
        ]
        return points[1] - points[0]

    def slope(turns):
        return (error([1e-6 * turn for turn in turns]) - error([-1e-6 * turn for turn in turns])) / 2e-6 * URAD

    n = [arm.study.robot.n for arm in study.arms]
    rows = {"joint_compliance.j1": slope([waist * np.eye(n[0])[0], waist * np.eye(n[1])[0]])}
    for side, arm in enumerate(study.arms):
        for joint in range(1, n[side]):
            turns = [np.zeros(n[0]), np.zeros(n[1])]
            turns[side] = t[side][joint] * np.eye(n[side])[joint]
            rows[f"{arm.name}.joint_compliance.j{joint + 1}"] = slope(turns)
    return rows


def heavy(study):
    """The same arms with links that weigh something, the common waist the same in both."""
    arms = []
    for arm in study.arms:
        robot = arm.study.robot
        centres = np.tile([0.2, -0.1, 0.15], (robot.n, 1)) * np.arange(1, robot.n + 1)[:, None]
        arms.append(
            replace(arm, study=replace(arm.study, robot=replace(robot, masses=np.full(robot.n, 0.05), centres=centres)))
        )
    return replace(study, arms=tuple(arms))


def lying(folder, **changes):
    """Two arms whose common waist lies, so that self-weight turns it."""
    mount = {"robot": {"mount_deg": [90, 20, 0]}, "model": {"reference": "differences"}}
    return both(folder, first=mount, second=mount, **changes)


CASES = {
    "upright": both,
    "lying and heavy": lambda folder: heavy(lying(folder)),
    "load in the flange": lambda folder: both(
        folder,
        test_poses=[
            {
                "A": {"joints_deg": UP, "wrench": PUSH, "frame": "flange", "attach_mm": [10, 20, 30]},
                "B": {"joints_deg": [20, 10, 40], "wrench": PULL},
            }
        ],
    ),
    "sda5f": lambda folder: pushed_askew(load_two_arm_study(SDA5F)),
}


OFFSET = np.array([0.02, 0.01, 0.03])  # m


def pushed_askew(study):
    """The shipped tasks with loads that turn the waist, and points that do not meet."""
    tasks = []
    for task in study.tasks:
        first, second = task.poses
        first = replace(first, wrench=np.array([5.0, 8.0, -3.0, 0, 0, 0]), point=first.point + OFFSET)
        tasks.append(replace(task, poses=(first, second)))
    return replace(study, tasks=tuple(tasks))


@pytest.mark.parametrize("case", list(CASES))
def test_rows_of_the_relative_error_are_those_of_two_chains_on_one_spring(tmp_path, case):
    study = CASES[case](tmp_path)
    watching = two_arm_observer(study)
    rows = watching.test_rows() * 1.0
    assert len(rows) == len(study.tasks)
    scale = np.abs(rows).max()
    for found, task in zip(rows, study.tasks, strict=True):
        expected = brute_rows(study, task)
        assert set(expected) == set(watching.names)
        for name, column in expected.items():
            np.testing.assert_allclose(found[:, watching.names.index(name)], column, atol=2e-8 * scale, err_msg=name)
    waist = rows[:, :, watching.names.index("joint_compliance.j1")]
    assert np.abs(waist).max() > 1e-3 * scale, "the case does turn the waist"


def test_the_waist_cancels_where_the_tool_points_coincide_whatever_pulls(tmp_path):
    task = {"A": {"joints_deg": UP, "wrench": PUSH}, "B": {"joints_deg": DOWN, "wrench": PULL}}
    study = both(tmp_path, test_poses=[task])
    first, second = study.tasks[0].poses
    reach = [world_point(arm, pose.q, np.zeros(3)) for arm, pose in zip(study.arms, (first, second), strict=True)]
    second = replace(second, point=turn_of(study.arms[1], second.q).T @ (reach[0] - reach[1]))
    study = replace(study, tasks=(replace(study.tasks[0], poses=(first, second)),))
    assert np.abs(np.diff(task_points(study), axis=1)).max() < 1e-15
    watching = two_arm_observer(study)
    waist, own = watching.names.index("joint_compliance.j1"), watching.names.index("A.joint_compliance.j2")
    rows = watching.test_rows()[0]
    assert np.abs(rows[:, waist]).max() < 1e-14 * np.abs(rows[:, own]).max()
    alone = [abs(torques(arm, pose, shared=True)[0]) for arm, pose in zip(study.arms, (first, second), strict=True)]
    assert min(alone) > 0.1, "each load turns the waist"
    apart = replace(study, tasks=(replace(study.tasks[0], poses=(first, replace(second, point=second.point + 0.05))),))
    assert np.abs(two_arm_observer(apart).test_rows()[0][:, waist]).max() > 1e-3 * np.abs(rows[:, own]).max()


def test_errors_of_the_waist_that_no_load_causes_turn_both_points_once(tmp_path):
    changes = {"model": {"effects": ["joint_compliance", "transmission_error@j1"]}}
    study = both(tmp_path, first=changes, second=changes)
    watching = two_arm_observer(study)
    columns = [i for i, name in enumerate(watching.names) if name.startswith("transmission_error.j1.")]
    assert len(columns) == 4
    rows, (first, second) = watching.test_rows()[0], task_points(study)[0]
    turned = np.cross([0.0, 0.0, 1.0], second - first)
    sizes = [rows[:, column] @ turned / (turned @ turned) for column in columns]
    for column, size in zip(columns, sizes, strict=True):
        np.testing.assert_allclose(rows[:, column], size * turned, atol=1e-15)
    angles = np.deg2rad([20.0, 40.0])  # of one and two waves a turn at 20 deg
    np.testing.assert_allclose(np.sort(sizes), np.sort([*np.sin(angles), *np.cos(angles)]) * URAD)


def test_shipped_tasks_need_no_waist_though_one_arm_alone_would():
    study = load_two_arm_study(SDA5F)
    watching = two_arm_observer(study)
    rows = np.abs(watching.test_rows()).max(axis=(0, 1))
    named = dict(zip(watching.names, rows, strict=True))
    assert named["joint_compliance.j1"] < 1e-12 * rows.max()
    assert named["R1.joint_compliance.j8"] + named["R2.joint_compliance.j8"] < 1e-12 * rows.max()
    alone = replace(study.arms[0].study, test_poses=tuple(task.poses[0] for task in study.tasks))
    with pytest.raises(NotIdentifiable, match=r"depend on joint_compliance\.j1, which no candidate shows"):
        plan(replace(alone, plan=replace(alone.plan, candidates=200)))


# --- embedding


def test_blocks_of_each_arm_stand_on_its_own_and_the_shared_columns(tmp_path):
    study = both(tmp_path, first={"frames": {"measurement": "free", "markers": "nominal"}})
    watching = two_arm_observer(study)
    frame = [f"A.frame.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]
    assert watching.names == (
        *frame,
        *(f"A.marker.M1.{axis}" for axis in "xyz"),
        "joint_compliance.j1",
        "A.joint_compliance.j2",
        "A.joint_compliance.j3",
        "B.joint_compliance.j2",
        "B.joint_compliance.j3",
    )
    assert watching.nuisance.sum() == 9
    rng = np.random.default_rng(0)
    for side, arm in enumerate(study.arms):
        q, loads = rng.uniform(-1.5, 1.5, (5, 3)), np.ones((5, 1), dtype=np.int64)
        own = observer(arm.study)
        expected, found = own.blocks(q, loads), watching.blocks(side, q, loads)
        stacked = {name: np.zeros(expected.shape[:2]) for name in watching.names}
        for column, name in enumerate(own.names):
            stacked[name if name == "joint_compliance.j1" else f"{arm.name}.{name}"] = expected[:, :, column]
        np.testing.assert_array_equal(found, np.stack(list(stacked.values()), axis=2))


def test_shared_joints_learn_from_both_arms_and_other_parameters_from_their_own(tmp_path):
    study = both(tmp_path)
    made = plan_for_both(study)
    names = [made.pool.observer.names[index] for index in made.pool.known.kept]
    total = np.zeros((len(names), len(names)))
    for arm, visits in zip(study.arms, made.choice.arms, strict=True):
        own = observer(arm.study)
        information = information_of(own.blocks(visits.q, visits.visit_loads))
        place = [names.index(n if n == "joint_compliance.j1" else f"{arm.name}.{n}") for n in own.names]
        total[np.ix_(place, place)] += information
    np.testing.assert_allclose(made.information, total, rtol=1e-9, atol=1e-9 * np.abs(total).max())
    a, b = (names.index(f"{arm}.joint_compliance.j2") for arm in "AB")
    assert total[a, b] == 0.0
    assert made.information[names.index("joint_compliance.j1"), a] != 0.0


def test_shared_joints_one_arm_cannot_show_are_known_from_the_other(tmp_path):
    """Arm A is loaded straight down, so that only loads of B turn the waist."""
    down = {"loads": [{"id": "L0"}, {"id": "L1", "wrench": [0, 0, -1, 0, 0, 0]}]}
    study = both(tmp_path, first=down)
    made = plan_for_both(study)
    assert made.pool.known.rank == 5
    with pytest.raises(NotIdentifiable, match=r"joint_compliance\.j1, which no candidate shows: vertical loads put no"):
        plan_for_both(both(tmp_path, first=down, second=down))


# --- two robots side by side


def test_robots_side_by_side_have_their_own_parameters_and_bases(tmp_path):
    turned = {"robot": {"mount_deg": [0, 0, 180]}}
    study = both(
        tmp_path,
        second=turned,
        waist={"shared_joints": 0},
        arms=[{"name": "A", "study": "a.toml"}, {"name": "B", "study": "b.toml", "base_mm": [2000, 100, 50]}],
        test_poses=[
            {
                "A": {"joints_deg": [10, 40, -50], "wrench": PUSH},
                "B": {"joints_deg": [-25, 60, -80], "wrench": PULL, "point_mm": [10, 20, 30]},
            }
        ],
    )
    watching = two_arm_observer(study)
    assert watching.names == tuple(f"{arm}.joint_compliance.j{j}" for arm in "AB" for j in (1, 2, 3))
    rows, task = watching.test_rows()[0], study.tasks[0]
    for side, (arm, pose) in enumerate(zip(study.arms, task.poses, strict=True)):
        for joint, torque in enumerate(torques(arm, pose, shared=True)):
            step = 1e-6 * np.eye(3)[joint]
            moved = (world_point(arm, pose.q + step, pose.point) - world_point(arm, pose.q - step, pose.point)) / 2e-6
            np.testing.assert_allclose(
                rows[:, 3 * side + joint], (2 * side - 1) * moved * torque * URAD, atol=1e-8 * np.abs(rows).max()
            )
    np.testing.assert_allclose(
        task_points(study)[0, 1], world_point(study.arms[1], task.poses[1].q, task.poses[1].point)
    )


# --- the robots' own repeatability


def test_relative_jitter_is_the_scatter_of_the_points_with_one_draw_of_the_shared_joint(tmp_path):
    study = both(tmp_path, first={"noise": {"pose_jitter_urad": 200.0}}, second={"noise": {"pose_jitter_urad": 300.0}})
    rng, draws = np.random.default_rng(0), 20_000
    for task, expected in zip(study.tasks, relative_jitter(study), strict=True):
        waist = 300e-6 * rng.standard_normal((draws, 1))
        points = []
        for arm, pose, size in zip(study.arms, task.poses, (200e-6, 300e-6), strict=True):
            q = pose.q + np.hstack([waist, size * rng.standard_normal((draws, 2))])
            points.append(forward(arm.study.robot, q).point(pose.point))
        scatter = np.cov((points[1] - points[0]).T / MM)
        np.testing.assert_allclose(scatter, expected, atol=0.03 * np.trace(expected))


# --- plans


def certified(blocks, target, weights, count):
    """Lower bound of trace(C M^-1 C') for any n experiments, from any weights that sum to 1."""
    inverse = np.linalg.inv(np.einsum("n,nki,nkj->ij", weights, blocks, blocks))
    value = np.trace(target @ inverse @ target.T)
    gains = ((blocks @ (inverse @ target.T)) ** 2).sum(axis=(1, 2))
    return value**2 / gains.max() / count


def test_the_bound_is_below_the_value_and_follows_from_the_weights(tmp_path):
    made = plan_for_both(both(tmp_path, plan={"max_std_percent": 1e6}))
    aim, blocks = made.pool.objective, made.pool.blocks
    relaxed = approximate_design(blocks, aim.target())
    bound = certified(blocks, aim.target(), relaxed.weights, 7)
    assert made.grid.bound == pytest.approx(bound, rel=1e-4)
    assert bound <= made.grid.value == pytest.approx(aim.value(information_of(made.choice.grid)))
    assert 0.85 < made.grid.efficiency <= 1.0
    sides = np.arange(len(blocks)) >= len(made.pool.candidates[0])
    assert 0.1 < relaxed.weights[sides].sum() < 0.9, "both arms are measured"


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "G"])
def test_refined_plans_are_better_keep_their_limits_and_carry_a_proof(tmp_path, criterion):
    study = both(tmp_path, plan={"refine": True, "criterion": criterion, "candidates": 120, "poses": 6})
    made = plan_for_both(study)
    assert made.final.bound <= made.final.value < made.grid.value
    watching, kept = made.pool.observer, made.pool.known.kept
    parts = [watching.blocks(i, a.q, a.visit_loads)[:, :, kept] for i, a in enumerate(made.choice.arms)]
    information = sum(information_of(part) for part in parts)
    assert made.pool.objective.value(information) == pytest.approx(made.final.value, rel=1e-9)
    for arm, visits in zip(study.arms, made.choice.arms, strict=True):
        assert (np.abs(visits.q) <= arm.study.robot.upper + 1e-9).all()


def test_the_guard_looks_at_both_arms(tmp_path):
    task = {
        "A": {"joints_deg": UP, "wrench": PUSH},
        "B": {"joints_deg": [20.0, 10.0, 40.0], "wrench": [0, 0, 0.01, 0, 0, 0]},
    }
    settings = {"poses": 12, "max_std_percent": 1e6}
    free = plan_for_both(both(tmp_path, test_poses=[task], plan=settings))
    assert any("sees little but the test poses: it tells B.joint_compliance." in note for note in free.choice.notes)
    guarded = plan_for_both(both(tmp_path, test_poses=[task], plan={**settings, "max_std_percent": 300.0}))
    assert any("max_std_percent = 300 costs" in note for note in guarded.choice.notes)
    best = standard_deviations(exact_information(free.pool.blocks, 12))
    assert (standard_deviations(free.information) / best).max() > 3.0
    assert (standard_deviations(guarded.information) / best).max() <= 3.0 * (1 + 1e-6)
    assert guarded.final.value > free.final.value


def exact_information(blocks, count):
    """Information of the best plan for the parameters."""
    counts = exact_design(blocks, None, count, criterion="A").counts
    return np.einsum("n,nki,nkj->ij", counts, blocks, blocks)


def sda5f(**settings):
    """The shipped study with fewer candidates, on the grid."""
    study = load_two_arm_study(SDA5F)
    given = {"candidates": 600, "poses": 12, "refine": False, "max_std_percent": 1e6, **settings}
    return replace(study, plan=replace(study.plan, **given))


def judged(study, visits):
    """Evaluation of joint values and loads of each arm."""
    experiments = [
        full_experiment(q, loads, arm.study.loads, arm.study.markers)
        for arm, (q, loads) in zip(study.arms, visits, strict=True)
    ]
    return evaluate_both(study, experiments)


def alone(study, count, **changes):
    """Joint values and loads of each arm's own plan: half the experiments, for its own absolute error at the tasks."""
    found = []
    for side, arm in enumerate(study.arms):
        settings = {
            "poses": count // 2,
            "candidates": study.plan.candidates // 2,
            "refine": False,
            "max_std_percent": 1e6,
        }
        own = replace(
            arm.study,
            test_poses=tuple(task.poses[side] for task in study.tasks),
            plan=replace(arm.study.plan, **settings),
            **changes,
        )
        made = plan(own)
        found.append((made.q, made.visit_loads))
    return found


def test_a_plan_for_both_is_better_than_random_poses():
    study = sda5f()
    made = plan_for_both(study)
    again = judged(study, [(a.q, a.visit_loads) for a in made.choice.arms])
    assert again.bound.value == pytest.approx(made.final.value, rel=1e-9)
    assert again.visits == tuple(len(a.q) for a in made.choice.arms)
    pools, rng = [drawn(study, side, 0) for side in (0, 1)], np.random.default_rng(0)
    for _ in range(3):
        picks = [rng.choice(len(pool), 6, replace=False) for pool in pools]
        random = judged(study, [(p.visit_q[i], p.visit_loads[i]) for p, i in zip(pools, picks, strict=True)])
        assert random.bound.value > 3.0 * made.final.value


def test_a_plan_for_both_is_better_than_a_plan_of_each_arm_for_itself(tmp_path):
    """One waist for two arms need not be told twice."""
    study = both(tmp_path, plan={"poses": 8, "max_std_percent": 1e6})
    made = plan_for_both(study)
    assert judged(study, alone(study, 8)).bound.value > 1.1 * made.final.value


def test_arms_without_a_common_unknown_are_best_planned_one_by_one():
    """No load turns the waist of the SDA5F: the relative error is the sum of two, and equal halves are right here."""
    study = sda5f()
    made = plan_for_both(study)
    assert [len(a.q) for a in made.choice.arms] == [6, 6]
    own = alone(study, 12, effects=tuple(f"joint_compliance@j{j}" for j in range(2, 9)), nominal={})
    assert judged(study, own).bound.value == pytest.approx(made.final.value, rel=1e-2)


def test_arms_of_unequal_noise_get_unequal_shares(tmp_path):
    """Each arm's variance is sigma^2 / n times the same number, so n goes as sigma (Neyman's rule)."""
    noisy = {"noise": {"reading_mm": 4000.0}}
    task = {"A": {"joints_deg": UP, "wrench": PUSH}, "B": {"joints_deg": UP, "wrench": PUSH}}
    settings = {"poses": 30, "max_std_percent": 1e6}
    arms = [{"name": "A", "study": "a.toml"}, {"name": "B", "study": "b.toml", "base_mm": [100, 0, 0]}]
    apart = {"waist": {"shared_joints": 0}, "arms": arms}
    study = both(tmp_path, second=noisy, test_poses=[task], plan=settings, **apart)
    made = plan_for_both(study)
    assert [len(a.q) for a in made.choice.arms] == [6, 24]


def test_a_tolerance_asks_for_the_fewest_experiments_of_both(tmp_path):
    study = both(tmp_path, plan={"poses": None, "tolerance_mm": 1500.0, "max_std_percent": 1e6})
    made = plan_for_both(study)
    count = len(made.choice.own)
    worst = plan_for_both(replace(study, plan=replace(study.plan, poses=count - 1, tolerance=None)))
    reached = [errors(study, p) for p in (made, worst)]
    assert reached[0] <= 1500.0 < reached[1]
    jittery = {"noise": {"pose_jitter_urad": 1e6}}
    with pytest.raises(Infeasible, match="pose jitter alone gives"):
        plan_for_both(both(tmp_path, first=jittery, plan={"poses": None, "tolerance_mm": 1500.0}))


def errors(study, made):
    """Largest 95 % radius at a task, mm."""
    from identify.error_radius import radius

    reached = relative_accuracy(study, made.pool.objective, made.covariance)
    return max(radius(total, 0.95) for total in reached.covariance + reached.jitter)


# --- the prediction


def test_the_spread_of_the_relative_error_is_the_predicted_one():
    """Both arms identified from simulated readings of their plans, 40 times, with fixed draws."""
    study = sda5f(candidates=300, max_std_percent=300.0)
    made = plan_for_both(study)
    aim, names = made.pool.objective, [made.pool.observer.names[i] for i in made.pool.known.kept]
    predicted = relative_accuracy(study, aim, made.covariance).rms
    rng, wrong = np.random.default_rng(1), np.zeros((40, len(names)))
    for arm, visits, truth_file in zip(study.arms, made.choice.arms, TRUTHS, strict=True):
        truth, model = load_truth(truth_file, arm.study), model_of(arm.study)
        values = model.nominal.copy()
        for name, value in truth.values.items():
            values[model.names.index(name)] = value
        experiment = full_experiment(visits.q, visits.visit_loads, arm.study.loads, arm.study.markers)
        placement = default_placement(arm.study.noise, frame_free=arm.study.frame_free)
        for draw in wrong:
            data = simulate(model, values, experiment, arm.study.noise, placement, rng)
            found = identify(arm.study, data).parameters
            for column, name in enumerate(names):
                owner, _, own = name.partition(".")
                if owner == arm.name:
                    draw[column] = found[own] - truth.values[own]
    spread = np.einsum("trp,mp->mtr", aim.rows, wrong)
    rms = np.sqrt(np.einsum("t,mtr->", aim.weights, spread**2) / len(wrong))
    assert rms == pytest.approx(predicted, rel=0.25)


# --- the commands


@pytest.fixture
def shipped(tmp_path):
    """A copy of the shipped studies and robots, with small plans."""
    for folder in ("studies", "robots", "truths"):
        (tmp_path / "configs" / folder).mkdir(parents=True)
        for file in (SDA5F.parents[1] / folder).glob("sda5f*"):
            shutil.copy(file, tmp_path / "configs" / folder)
    path = tmp_path / "configs" / "studies" / "sda5f_both.toml"
    text = path.read_text().replace("candidates = 6000", "candidates = 300\nrefine = false").replace("= 24 ", "= 12 ")
    path.write_text(text)
    for name in ("r1", "r2"):
        own = path.with_name(f"sda5f_{name}.toml")
        own.write_text(own.read_text().replace("candidates = 4000", "candidates = 200"))
    return tmp_path


def test_the_commands_from_plan_to_identified_arms(shipped, capsys):
    studies, out = shipped / "configs" / "studies", shipped / "out"
    two = str(studies / "sda5f_both.toml")
    assert run(["plan", two, "--out", str(out), "--quiet"]) == 0
    assert sorted(file.name for file in out.iterdir()) == ["plan.json", "plan_R1.csv", "plan_R2.csv"]
    made = json.loads((out / "plan.json").read_text())
    assert sum(made["arms"].values()) == made["poses"] == 12
    assert set(made["arms"]) == {"R1", "R2"}
    assert made["bound"] <= made["criterion"]["value"]
    assert made["nonidentifiable"] == ["joint_compliance.j1", "R1.joint_compliance.j8", "R2.joint_compliance.j8"]
    assert made["rank"] == 12 == len(made["std"])
    assert "R2.joint_compliance.j2" in made["parameters"]
    assert {"sda5f_both.toml", "sda5f_r1.toml", "sda5f_r2.toml"} <= set(made["provenance"]["inputs"])
    assert any("collisions of R1 with R2 are not checked" in note for note in made["notes"])
    assert "experiments by arm:" in capsys.readouterr().out

    assert run(["evaluate", two, str(out), "--out", str(shipped / "evaluated"), "--quiet"]) == 0
    again = json.loads((shipped / "evaluated" / "evaluate.json").read_text())
    assert again["criterion"]["value"] == pytest.approx(made["criterion"]["value"], rel=1e-6)
    assert again["arms"] == made["arms"]
    assert "note: collisions of R2 with R1 are not checked" in capsys.readouterr().out
    assert len(again["test_poses"]) == 3
    assert set(again["confusability"]) == {"R1", "R2"}
    assert again["weakest"]["parameter"] in made["parameters"]
    assert run(["report", str(out), "--quiet"]) == 0
    assert "R1.joint_compliance.j8" in (out / "report.html").read_text()

    for name in ("r1", "r2"):
        study, truth = studies / f"sda5f_{name}.toml", shipped / "configs" / "truths" / f"sda5f_{name}.toml"
        poses, read = out / f"plan_{name.upper()}.csv", shipped / f"read_{name}"
        fitted = shipped / f"fitted_{name}"
        assert run(["simulate", str(study), str(poses), "--truth", str(truth), "--out", str(read), "--quiet"]) == 0
        assert run(["identify", str(study), str(read / "measurements.csv"), "--out", str(fitted), "--quiet"]) == 0
        found = json.loads((fitted / "identify.json").read_text())
        assert [entry["name"] for entry in found["nonidentifiable"]] == ["joint_compliance.j1", "joint_compliance.j8"]
        sure = [p for p in found["parameters"] if not p["nuisance"] and p["std"] < 0.25 * p["value"]]
        true = load_truth(truth, load_study(study)).values
        assert len(sure) >= 3
        for parameter in sure:
            assert abs(parameter["value"] - true[parameter["name"]]) < 4 * parameter["std"]
        assert evaluate(load_study(study), full_plan(poses, load_study(study))).known.rank == 6


def full_plan(path, study):
    """The experiment of a plan file."""
    from identify.tables import load_plan, plan_experiment

    return plan_experiment(load_plan(path, study), study)


def test_the_same_seed_gives_the_same_files(tmp_path):
    path = write_both(tmp_path, plan={"refine": True, "candidates": 60, "poses": 5})
    for name in ("one", "two"):
        assert run(["plan", str(path), "--out", str(tmp_path / name), "--quiet", "--seed", "3"]) == 0
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


def test_evaluate_wants_the_folder_with_both_plans(tmp_path, capsys):
    path = write_both(tmp_path)
    for given, part in ((tmp_path / "plan_A.csv", "is no folder"), (tmp_path, "plan_A.csv is missing")):
        assert run(["evaluate", str(path), str(given), "--out", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert part in message
        assert "plan_A.csv and plan_B.csv" in message


@pytest.mark.parametrize(
    "command", [["simulate", "{}", "p.csv"], ["identify", "{}", "m.csv"], ["diagnose", "{}", "m.csv"], ["reduce", "{}"]]
)
def test_other_commands_ask_for_the_study_of_one_arm(tmp_path, capsys, command):
    path = write_both(tmp_path)
    assert run([*(part.format(path) for part in command), "--out", str(tmp_path / "out")]) == 2
    assert "study of two arms, which only plan and evaluate take; give the study of one" in capsys.readouterr().err


def test_plans_without_tasks_are_for_the_parameters(tmp_path):
    study = both(tmp_path, test_poses=None, plan={"criterion": "A"})
    made = plan_for_both(study)
    assert made.pool.objective.rows is None
    assert relative_accuracy(study, made.pool.objective, made.covariance) is None
    assert np.trace(covariance_of(made.information)) == pytest.approx(made.final.value)
    assert build_two_arm_pool(study, 0).known.rank == 5
    assert Path(study.path).name == "both.toml"
