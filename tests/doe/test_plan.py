"""The verb plan: closed forms, published tables, the degeneracy trap, tolerances and constraints."""

from dataclasses import replace

import numpy as np
import pytest

from doe import approximate_design, exact_design
from doe.accuracy import accuracy
from doe.candidates import rounded
from doe.evaluate import evaluate
from doe.feasible import check, joint_range
from doe.information import standard_deviations
from doe.observations import observer
from doe.plan import plan
from doe.pool import build_pool
from identify.arrays import frozen
from identify.error_radius import radius
from identify.errors import Infeasible, NotIdentifiable
from identify.experiment import full_experiment
from identify.study import TestPose
from tests.doe.study_files import ARM, KR270, study

DOWN, FORWARD = [0, 0, -1, 0, 0, 0], [1, 0, 0, 0, 0, 0]

PUBLISHED = {  # number of poses, test load: rho_0 and the plan (q2, q3) in degrees
    (1, "down"): (1.23596, [(130.8, 70.5)]),
    (2, "down"): (0.74949, [(0, 0), (143.1, 216.9)]),
    (3, "down"): (0.63813, [(338.8, 40.7), (158.8, 40.7), (143.1, 216.9)]),
    (4, "down"): (0.52997, [(36.9, 143.1), (0, 0), (216.9, 143.1), (0, 0)]),
    (1, "forward"): (0.92978, [(82.4, 112.8)]),
    (2, "forward"): (0.62055, [(258.3, 262.1), (216.9, 143.1)]),
    (3, "forward"): (0.49134, [(216.9, 143.1), (143.1, 216.9), (117.4, 86.2)]),
    (4, "forward"): (0.41717, [(323.1, 216.9), (48.2, 284.0), (323.1, 216.9), (216.9, 143.1)]),
}


def arm(folder, load="down", **changes):
    """The three-joint reference arm with one test load."""
    tests = [{"joints_deg": [0, 45, -90], "wrench": DOWN if load == "down" else FORWARD}]
    return study(folder, ARM, test_poses=tests, **changes)


def judged(made, q_deg):
    """Evaluation of poses (m, n) in degrees under the load L1, or unloaded where there is none."""
    q = np.deg2rad(np.array(q_deg, dtype=float))
    pick = next((i for i, load in enumerate(made.loads) if not load.unloaded), 0)
    return evaluate(made, full_experiment(q, np.full((len(q), 1), pick), made.loads, made.markers))


def rms(made):
    """rho_0 of a plan or an evaluation in m: its mean square at the test poses is in mm^2."""
    value = made.final.value if hasattr(made, "final") else made.bound.value
    return value**0.5 / 1e3


# --- closed forms


@pytest.mark.parametrize("count", [1, 3])
def test_one_joint_is_best_measured_level(tmp_path, count):
    """rho_0 = sigma |cos q_0| (F_0 / F) / sqrt(m), std of the compliance sigma / (sqrt(m) F L^2)."""
    tests = [{"joints_deg": [35.0], "wrench": [0, 0, -2.5, 0, 0, 0]}]
    loads = [{"id": "L1", "wrench": [0, 0, -0.7, 0, 0, 0]}]
    made = plan(
        study(
            tmp_path,
            ARM,
            robot={"model": "single_joint"},
            test_poses=tests,
            loads=loads,
            plan={"poses": count, "candidates": 200},
        )
    )
    np.testing.assert_allclose(np.sin(made.q), 0.0, atol=1e-4)
    assert rms(made) == pytest.approx(np.cos(np.deg2rad(35.0)) * (2.5 / 0.7) / count**0.5, rel=1e-7)
    assert made.covariance[0, 0] ** 0.5 == pytest.approx(1e6 / (0.7 * count**0.5), rel=1e-7)
    assert made.final.efficiency > 1 - 1e-5


def planar_blocks(lengths, angles):
    """(N, 2, 2n) rows for errors of the lengths and absolute angles of a planar arm."""
    columns = []
    for length, angle in zip(lengths, angles.T, strict=True):
        columns += [np.stack([np.cos(angle), np.sin(angle)]), length * np.stack([-np.sin(angle), np.cos(angle)])]
    return np.stack(columns).transpose(2, 1, 0)


@pytest.mark.parametrize(("n", "lengths"), [(2, (1.0, 0.8)), (3, (1.0, 0.8, 0.5))])
def test_planar_geometry_has_information_m_and_m_l_squared_and_rho_squared_2n_over_m(n, lengths):
    """Facts, section 3: for every test pose; and this is the best worst case (Kiefer and Wolfowitz)."""
    turns = np.deg2rad([0.0, 120.0, 240.0])
    relative = np.stack(np.meshgrid(*[turns] * (n - 1), indexing="ij"), axis=-1).reshape(-1, n - 1)
    angles = np.cumsum(np.column_stack([np.linspace(0.3, 2.0, len(relative)), relative]), axis=1)
    blocks, m = planar_blocks(lengths, angles), len(relative)
    information = np.einsum("nki,nkj->ij", blocks, blocks)
    np.testing.assert_allclose(
        information, m * np.diag(np.repeat(lengths, 2) ** (2.0 * np.tile([0, 1], n))), atol=1e-12
    )
    tests = planar_blocks(lengths, np.random.default_rng(0).uniform(0, 2 * np.pi, (20, n)))
    rho = [np.trace(rows @ np.linalg.inv(information) @ rows.T) for rows in tests]
    np.testing.assert_allclose(rho, 2 * n / m)
    if n == 2:
        assert m == 3
        assert rho[0] == pytest.approx(4 / 3)
    worst = approximate_design(blocks, blocks, criterion="G")
    assert worst.value == pytest.approx(2 * n, rel=1e-6)
    volume = approximate_design(blocks, None, criterion="D")
    assert volume.value == pytest.approx(np.prod(lengths) ** (-1 / n), rel=1e-6)
    few = exact_design(blocks, blocks, m, criterion="G")
    assert few.value == pytest.approx(2 * n / m, rel=1e-5)


def test_two_poses_close_to_the_test_pose_fall_into_the_trap():
    """Facts, section 2.3: (4 / m) / (1 + cos delta), which tends to 2 / m."""
    target = planar_blocks((1.0, 0.8), np.array([[0.0, 0.4]]))[0]
    for delta, expected in ((60, 1.333333), (30, 1.071797), (10, 1.007654), (1, 1.000076)):
        angles = np.array([[0.0, 0.4 + np.deg2rad(delta)], [0.0, 0.4 - np.deg2rad(delta)]])
        few = exact_design(planar_blocks((1.0, 0.8), angles), target, 2)
        assert few.value == pytest.approx(expected, abs=6e-7)
    itself = exact_design(planar_blocks((1.0, 0.8), np.array([[0.0, 0.4], [0.0, 2.0]])), target, 2)
    assert itself.value == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(("robot", "tests"), [("planar_2r", [20, 90]), ("planar_2r", [-50, -90])])
def test_geometry_of_a_planar_arm_in_space_has_a_closed_form_too(tmp_path, robot, tests):
    """Base, lengths and angles in the plane: rho^2 = 2 (n + 1) / m; five more parameters lead out of the plane.

    Their columns are 1, x, z, cos q2 and sin q2, orthogonal on a regular grid of angles: with the second link
    across the first at the test pose, each of the five adds 1/m.
    """
    made = study(
        tmp_path,
        ARM,
        robot={"model": robot},
        test_poses=[{"joints_deg": tests}],
        loads=[{"id": "L0"}],
        noise={"reading_mm": 1.0},
        model={"effects": ["geometry"]},
        plan={"candidates": 50},
    )
    turns = np.arange(5) * 72.0
    found = judged(made, [(a, b) for a in turns for b in turns])
    assert found.known.rank == 11
    assert found.bound.value == pytest.approx((2 * 3 + 5) / 25, rel=1e-9)


# --- the published tables


@pytest.mark.parametrize(("count", "load"), list(PUBLISHED))
def test_published_plans_evaluate_to_their_published_figures(tmp_path, count, load):
    figure, angles = PUBLISHED[count, load]
    found = judged(arm(tmp_path, load, plan={"candidates": 50}), [(0.0, *pair) for pair in angles])
    assert rms(found) == pytest.approx(figure, abs=0.6e-5)
    assert found.known.rank == 2
    assert [found.observer.model.names[d.column] for d in found.known.dropped] == ["joint_compliance.j1"]


@pytest.mark.parametrize(("count", "load"), list(PUBLISHED))
def test_plans_reach_the_published_figures(tmp_path, count, load):
    """To five digits or better, off a scattered set of candidates, by refinement."""
    made = plan(arm(tmp_path, load, plan={"poses": count, "candidates": 1000}))
    assert rms(made) < PUBLISHED[count, load][0] + 0.6e-5
    assert made.final.bound <= made.final.value < made.grid.value


@pytest.mark.parametrize(("load", "published"), [("down", 1.0586), ("forward", 0.7991)])
def test_the_bound_on_a_fine_grid_is_the_published_one(tmp_path, load, published):
    """All 360 x 360 poses of one degree; the table's bound is good to about 1e-4."""
    made = arm(tmp_path, load, plan={"candidates": 50})
    pool = build_pool(made, seed=0)
    degrees = np.deg2rad(np.arange(0.0, 360.0))
    q = np.stack(np.meshgrid([0.0], degrees, degrees, indexing="ij"), axis=-1).reshape(-1, 3)
    blocks = pool.observer.blocks(q, np.ones((len(q), 1), dtype=np.int64))[:, :, pool.known.kept]
    relaxed = approximate_design(blocks, pool.objective.target())
    assert relaxed.bound**0.5 / 1e3 == pytest.approx(published, abs=1.5e-4)
    for (count, kind), (figure, _) in PUBLISHED.items():
        assert kind != load or figure * count**0.5 * 1e3 > relaxed.bound**0.5


# --- the trap


def planar_geometry(folder, robot="planar_3r", **settings):
    """Geometry of a planar arm, where measuring at the test pose alone gives 3 sigma^2 / m for 11 or 15 parameters."""
    tests = [{"joints_deg": [20, 60, 30][: int(robot[-2])]}]
    return study(
        folder,
        ARM,
        robot={"model": robot},
        test_poses=tests,
        loads=[{"id": "L0"}],
        noise={"reading_mm": 1.0},
        model={"effects": ["geometry"]},
        plan={"poses": 12, "candidates": 500, **settings},
    )


def std_under_the_best_plan_for_the_parameters(made):
    """(p,) by an A plan of the same size on the same candidates."""
    counts = exact_design(made.pool.blocks, None, len(made.q), criterion="A").counts
    return standard_deviations(np.einsum("n,nki,nkj->ij", counts, made.pool.blocks, made.pool.blocks))


@pytest.mark.slow
def test_without_a_guard_the_plan_sees_only_the_test_pose_and_says_so(tmp_path):
    made = plan(planar_geometry(tmp_path, max_std_percent=1e12))
    assert 12 * made.final.value < 3.3, "rank sigma^2 is 3"
    assert (standard_deviations(made.information) > 1e3 * std_under_the_best_plan_for_the_parameters(made)).any()
    assert "this plan sees little but the test poses" in made.notes[0]
    assert "geometry." in made.notes[0]


@pytest.mark.parametrize("robot", ["planar_2r", "planar_3r"])
@pytest.mark.parametrize("refine", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_by_default_no_parameter_is_told_three_times_worse_than_in_the_best_plan(tmp_path, robot, refine):
    made = plan(planar_geometry(tmp_path, robot, refine=refine))
    ratio = standard_deviations(made.information) / std_under_the_best_plan_for_the_parameters(made)
    assert 1.5 < ratio.max() <= 3.0 * (1 + 1e-6)
    assert "max_std_percent = 300 costs" in made.notes[0]
    assert len(made.notes) == 1
    if refine:
        assert made.final.value < 0.97 * made.grid.value


def test_a_guard_that_cannot_be_met_is_explained(tmp_path):
    with pytest.raises(Infeasible, match=r"max_std_percent = 90 cannot be met with 12 poses: .*geometry\."):
        plan(planar_geometry(tmp_path, max_std_percent=90.0))


def test_too_few_poses_are_refused_with_the_names_of_what_they_miss(tmp_path):
    with pytest.raises(NotIdentifiable, match=r"4 poses are too few: .*geometry\.j") as caught:
        plan(planar_geometry(tmp_path, poses=4))
    assert all(str(name).startswith("geometry.") for name in caught.value.missing)


@pytest.mark.parametrize("count", [4, 5, 6])
def test_exchanges_do_not_feed_on_rounding(tmp_path, exchanges, count):
    """15 parameters that seven poses show: with fewer, rounding decides between plans for the test pose."""
    pool = build_pool(planar_geometry(tmp_path, poses=count), 0)
    with pytest.raises(NotIdentifiable, match=f"no plan of {count} experiments"):
        exact_design(pool.blocks, pool.objective.target(), count)
    assert exchanges


def test_plans_that_see_everything_carry_no_note(tmp_path):
    assert plan(study(tmp_path, KR270)).notes == ()


# --- any study


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "E", "G"])
@pytest.mark.parametrize("reference", ["differences", "absolute"])
def test_every_criterion_gives_a_plan_with_a_proof(tmp_path, criterion, reference):
    settings = {"criterion": criterion, "refine": reference == "differences", "candidates": 200}
    made = plan(study(tmp_path, KR270, plan=settings, model={"reference": reference}))
    assert len(made.q) == 8
    for bound in (made.grid, made.final):
        assert 0 < bound.bound <= bound.value
        assert 0.75 < bound.efficiency <= 1
    assert made.final.value <= made.grid.value
    assert made.final.bound <= made.grid.bound * (1 + 2e-6), "the plan's own poses are candidates too"
    own = made.pool.observer.blocks(made.q, made.visit_loads)[:, :, made.pool.known.kept]
    information = np.einsum("nki,nkj->ij", own, own)
    assert made.pool.objective.value(information) == pytest.approx(made.final.value, rel=1e-9)
    np.testing.assert_allclose(made.information, information, rtol=1e-9, atol=1e-9 * np.abs(information).max())


def test_each_criterion_is_best_served_by_its_own_plan(tmp_path):
    names, settings = ("test_pose", "A", "D", "E", "G"), {"refine": False, "candidates": 200}
    plans = {name: plan(study(tmp_path, KR270, plan={"criterion": name, **settings})) for name in names}
    for name in names:
        values = {other: plans[name].pool.objective.value(made.information, name) for other, made in plans.items()}
        assert min(values, key=values.get) == name or values[name] < 1.01 * min(values.values())


def test_several_loads_and_two_of_them_at_each_pose(tmp_path):
    settings = {"loads": ["L1", "L2"], "candidates": 100, "poses": 5, "refine": False}
    single = plan(study(tmp_path, KR270, plan=settings))
    assert set(single.visit_loads[:, 0]) == {0}
    assert set(single.visit_loads[:, 1]) <= {1, 2}
    double = plan(study(tmp_path, KR270, plan={**settings, "loads_per_pose": 2}))
    np.testing.assert_array_equal(double.visit_loads, np.tile([0, 1, 2], (5, 1)))
    assert double.final.value < single.final.value
    bare = plan(study(tmp_path, KR270, plan={**settings, "loads_per_pose": 2, "reference_rows": False}))
    np.testing.assert_array_equal(bare.visit_loads, np.tile([1, 2], (5, 1)))


@pytest.mark.parametrize("refine", [False, True])
def test_without_repeats_no_pose_is_visited_twice(tmp_path, refine):
    settings = {"candidates": 30, "poses": 10, "refine": refine}
    once = plan(study(tmp_path, KR270, plan={**settings, "repeats": False}))
    often = plan(study(tmp_path, KR270, plan=settings))
    assert len(np.unique(once.q, axis=0)) == 10
    assert once.grid.value >= often.grid.value
    assert once.grid.bound > 1.01 * often.grid.bound, "the cap enters the bound"
    assert once.final.bound <= once.final.value
    if not refine:
        assert len(np.unique(often.q, axis=0)) < 10


def inside(made):
    """Every pose of a plan may be measured."""
    whole = made.pool.observer.study
    lower, upper = joint_range(whole)
    assert ((made.q >= lower - 1e-9) & (made.q <= upper + 1e-9)).all()
    assert check(whole, made.q, made.visit_loads).ok.all()
    np.testing.assert_array_equal(rounded(whole, made.q), made.q)


@pytest.mark.parametrize("mount", [[0, 0, 0], [0, 90, 0], [180, 0, 0]], ids=["floor", "wall", "ceiling"])
def test_every_pose_keeps_to_the_constraints_after_refinement(tmp_path, mount):
    lowest = {0: 100.0, 90: -1500.0, 180: -2200.0}[max(mount)]
    whole = study(
        tmp_path, KR270, robot={"mount_deg": mount}, constraints={"floor_mm": lowest}, plan={"candidates": 200}
    )
    made = plan(whole)
    inside(made)
    assert made.refinement is not None
    assert made.final.value < made.grid.value
    assert made.pool.candidates.rejected["floor"] > 0
    # a robot on the wall turns joint 1 against gravity
    assert made.pool.known.rank == (6 if mount[1] else 5)


def test_tight_constraints_bind_and_are_kept(tmp_path):
    few = {"candidates": 150, "poses": 6}
    free = plan(study(tmp_path, KR270, plan=few, constraints={"floor_mm": None, "joint_margin_deg": 0.0}))
    tight = plan(study(tmp_path, KR270, plan=few, constraints={"floor_mm": 900.0, "joint_margin_deg": 25.0}))
    inside(tight)
    assert not check(tight.pool.observer.study, free.q, free.visit_loads).ok.all()
    assert tight.final.value > free.final.value


def test_loads_beyond_the_payload_are_never_planned(tmp_path):
    whole = study(tmp_path, KR270)
    loads = (whole.loads[0], replace(whole.loads[1], mass=500.0))
    with pytest.raises(Infeasible, match="payload rejected"):
        plan(replace(whole, loads=loads))


def test_the_same_seed_gives_the_same_arrays_and_another_one_others(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 80, "poses": 4})
    first, second, other = plan(whole, seed=3), plan(whole, seed=3), plan(whole, seed=4)
    for name in ("q", "visit_loads", "information"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert (first.grid.value, first.final.bound) == (second.grid.value, second.final.bound)
    assert first.q.tobytes() != other.q.tobytes()
    assert other.final.value == pytest.approx(first.final.value, rel=0.1)


def test_more_candidates_are_never_worse_by_more_than_the_search_misses(tmp_path):
    """More candidates continue fewer ones, so the optimum can only fall; the search stays close to it."""
    values, bounds = [], []
    for count in (100, 400, 1600):
        made = plan(study(tmp_path, KR270, plan={"candidates": count, "refine": False}))
        values.append(made.final.value)
        bounds.append(made.final.bound)
    assert values[1] <= 1.01 * values[0]
    assert values[2] <= 1.01 * values[1]
    assert bounds[2] <= bounds[1] * (1 + 2e-6) <= bounds[0] * (1 + 4e-6)


def test_a_plan_beats_random_poses_and_noise_scales_its_error(tmp_path):
    whole = study(tmp_path, KR270, noise={"pose_jitter_urad": 0.0, "reading_jitter_urad": 0.0})
    made = plan(whole)
    pool = made.pool
    picks = np.random.default_rng(0).integers(0, len(pool.blocks), (50, 8))
    random = [pool.objective.value(np.einsum("nki,nkj->ij", *[pool.blocks[pick]] * 2)) for pick in picks]
    assert made.final.value < 0.6 * np.median(random)
    assert made.final.value < min(random)
    double = study(tmp_path, KR270, noise={"reading_mm": 0.06, "pose_jitter_urad": 0.0, "reading_jitter_urad": 0.0})
    assert plan(double).final.value == pytest.approx(4 * made.final.value, rel=1e-3)


# --- tolerance


def widest(made):
    """Largest radius of the total error at a test pose, mm."""
    whole = made.pool.observer.study
    reached = accuracy(whole, made.pool.objective.rows, made.covariance)
    return max(radius(total, whole.plan.confidence) for total in reached.covariance + reached.jitter)


@pytest.mark.parametrize(
    ("tolerance", "settings"),
    [
        pytest.param(0.0768, {}, marks=pytest.mark.slow),
        (0.0768, {"repeats": False, "refine": False}),
        pytest.param(0.0785, {"criterion": "D"}, marks=pytest.mark.slow),
        (0.0772, {"confidence": 0.951, "candidates": 150}),
    ],
)
def test_a_tolerance_is_kept_by_the_smallest_number_of_experiments(tmp_path, tolerance, settings):
    made = plan(study(tmp_path, KR270, plan={"poses": None, "tolerance_mm": tolerance, **settings}))
    count = len(made.q)
    assert count > 1
    assert widest(made) <= tolerance
    fewer = plan(study(tmp_path, KR270, plan={"poses": count - 1, **settings}))
    assert widest(fewer) > tolerance
    same = plan(study(tmp_path, KR270, plan={"poses": count, **settings}))
    np.testing.assert_array_equal(same.q, made.q)


def test_a_tolerance_with_a_guard_is_kept_by_the_guarded_plan(tmp_path):
    settings = {"poses": None, "tolerance_mm": 1.0, "candidates": 80, "refine": False}
    made = plan(planar_geometry(tmp_path, "planar_2r", **settings))
    assert "costs" in made.notes[0], "the guard is at work"
    assert widest(made) <= 1.0
    fewer = plan(planar_geometry(tmp_path, "planar_2r", **{**settings, "poses": len(made.q) - 1, "tolerance_mm": None}))
    assert widest(fewer) > 1.0


def test_a_tolerance_below_the_repeatability_of_the_robot_is_infeasible(tmp_path):
    with pytest.raises(Infeasible, match=r"tolerance_mm = 0.05: the robot's own pose jitter alone gives 0.075"):
        plan(study(tmp_path, KR270, plan={"poses": None, "tolerance_mm": 0.05}))


def test_a_tolerance_that_no_number_of_distinct_poses_keeps_is_infeasible(tmp_path):
    settings = {"poses": None, "tolerance_mm": 0.0752, "candidates": 12, "repeats": False, "refine": False}
    with pytest.raises(Infeasible, match="needs more than 12 experiments"):
        plan(study(tmp_path, KR270, plan=settings))


# --- what cannot be done


def test_a_test_pose_that_no_candidate_shows_ends_the_plan(tmp_path):
    sideways = [{"joints_deg": [0.0, -60.0, 90.0, 0.0, 45.0, 0.0], "wrench": [0, 900.0, 0, 0, 0, 0]}]
    with pytest.raises(NotIdentifiable, match=r"joint_compliance\.j1"):
        plan(study(tmp_path, KR270, test_poses=sideways))


def test_a_pose_is_judged_at_the_tool_of_the_test_not_of_the_load(tmp_path):
    """The same plan serves a point far from the flange worse than the flange itself."""
    whole = study(tmp_path, KR270, plan={"refine": False})
    pose = whole.test_poses[0]
    far = replace(pose, point=frozen([1.5, 0, 0]))
    errors = []
    for test in (pose, far):
        made = plan(replace(whole, test_poses=(test,)))
        errors.append(made.final.value)
        assert isinstance(test, TestPose)
    assert errors[1] > 1.5 * errors[0]


def test_an_unknown_mass_makes_the_plan_compare_loads(tmp_path):
    assert observer(study(tmp_path, KR270)).reference == "differences"
    assert observer(arm(tmp_path, model={"reference": "auto"})).reference == "absolute"


def test_joints_that_are_no_springs_are_planned_by_differences(tmp_path):
    """Where friction, knee and compliance have stated values, the plan shows them all."""
    names = ["joint_hardening@j2", "joint_windup@j3", "backlash@j5", "stiction@j2", "gravity_compensator@j2"]
    nominal = {"joint_compliance.j2": 0.3, "joint_compliance.j3": 0.4, "joint_compliance.j5": 3.0}
    model = {
        "effects": [*(name.replace(".", "@") for name in nominal), *names],
        "nominal": nominal | {"stiction.j2": 50.0, "joint_windup.j3.amplitude": 60.0},
        "joint_windup": {"fit_knee": True},
        "gravity_compensator": {"mode": "harmonics", "orders": [1]},
        "reference": "absolute",
    }
    changes = {"poses": 6, "candidates": 60, "loads": ["L1", "L2"], "loads_per_pose": 2}
    frames, tests = {"measurement": "base", "markers": "exact"}, KR270["test_poses"][:1]
    result = plan(study(tmp_path, KR270, model=model, plan=changes, frames=frames, test_poses=tests))
    assert result.refinement.status == "L-BFGS-B on differences"
    assert result.final.value <= result.grid.value
    names = [result.pool.observer.model.names[i] for i in result.pool.known.kept]
    assert {"joint_hardening.j2", "joint_windup.j3.amplitude", "joint_windup.j3.knee", "backlash.j5"} <= set(names)
    assert {"stiction.j2", "gravity_compensator.j2.s1", "gravity_compensator.j2.c1"} <= set(names)
    assert np.isfinite(result.covariance).all()
    assert result.final.value >= result.final.bound
