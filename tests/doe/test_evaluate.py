"""The verb evaluate: it tells what a plan will reach, whoever made it and however it is written down."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, norm

from doe.commands import run_evaluate, run_plan
from doe.evaluate import evaluate
from doe.plan import plan
from identify.errors import NotIdentifiable
from identify.experiment import full_experiment
from identify.identification import identify
from identify.model import model_of
from identify.simulate import simulate
from identify.tables import load_plan, plan_csv, plan_experiment
from tests.doe.study_files import ARM, KR270, merged, study, study_file

RUNS = 400
TRUE = {f"joint_compliance.j{j + 1}": value for j, value in enumerate((0.35, 0.27, 0.38, 2.7, 3.1, 2.2))}


def visits(whole, q, loads):
    """An experiment that reads these loads at each pose."""
    return full_experiment(q, np.tile(loads, (len(q), 1)), whole.loads, whole.markers)


# --- against Monte Carlo


def test_evaluate_predicts_what_400_simulated_measurements_and_identifications_scatter_with(tmp_path):
    """Standard deviations, mean square error at the test poses and coverage, each within its sampling error.

    400 times a variance ratio is chi-square: bounds at a false alarm rate of 2e-5 for each parameter. The mean square
    is a weighted sum of chi-squares: within four of its standard deviations.
    """
    frames = {"measurement": "base", "markers": "exact"}
    whole = study(tmp_path, KR270, plan={"candidates": 50}, constraints={"floor_mm": None}, frames=frames)
    rng = np.random.default_rng(20)
    q = rng.uniform(np.maximum(whole.robot.lower, -np.pi), np.minimum(whole.robot.upper, np.pi), (9, 6))
    experiment = visits(whole, q, [0, 1])
    predicted = evaluate(whole, experiment)
    model = model_of(whole)
    names = [predicted.observer.model.names[index] for index in predicted.known.kept]
    values, truth = np.array([TRUE[name] for name in model.names]), np.array([TRUE[name] for name in names])
    errors, claimed = [], []
    for _ in range(RUNS):
        found = identify(whole, simulate(model, values, experiment, whole.noise, np.eye(4), rng))
        errors.append(np.array([found.parameters[name] for name in names]) - truth)
        own = [found.model.names.index(name) for name in names]
        claimed.append(np.sqrt(np.diag(found.covariance)[own]))

    deviation = np.sqrt(np.diag(predicted.covariance))
    ratio = (np.array(errors) ** 2).mean(axis=0) / deviation**2
    low, high = chi2(RUNS).ppf([1e-5, 1 - 1e-5]) / RUNS
    assert len(ratio) == 5
    assert ((low < ratio) & (ratio < high)).all(), ratio
    np.testing.assert_allclose(np.median(claimed, axis=0), deviation, rtol=0.02)

    target = predicted.objective.target("test_pose")
    squares = ((np.array(errors) @ target.T) ** 2).sum(axis=1)
    spread = np.linalg.eigvalsh(target @ predicted.covariance @ target.T)
    assert spread.sum() == pytest.approx(predicted.bound.value, rel=1e-9)
    assert abs(squares.mean() - spread.sum()) < 4 * np.sqrt(2 * (spread**2).sum() / RUNS)

    covered = np.abs(errors) < norm.ppf(0.975) * np.array(claimed)
    assert 0.93 < covered.mean() < 0.97


# --- against the plan


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"refine": False},
        {"refine": False, "repeats": False},
        {"criterion": "G"},
        {"criterion": "E"},
        {"criterion": "A", "loads": ["L1", "L2"]},
    ],
)
def test_evaluate_of_a_plan_file_returns_the_plans_own_figures(tmp_path, settings):
    path = study_file(tmp_path, KR270, plan={"candidates": 200, **settings})
    made = run_plan(path, seed=2, out=tmp_path)
    (tmp_path / "plan.csv").write_text(made.tables["plan.csv"])
    judged = run_evaluate(path, tmp_path / "plan.csv", seed=2).content
    for key in ("value", "rms_mm", "rms_total_mm"):
        assert judged["criterion"][key] == pytest.approx(made.content["criterion"][key], rel=1e-9)
    assert judged["bound"] == pytest.approx(made.content["bound"], rel=1e-9)
    assert judged["efficiency"] == pytest.approx(made.content["efficiency"], rel=1e-9)
    np.testing.assert_allclose(judged["std"], made.content["std"], rtol=1e-7)
    for key in ("parameters", "nonidentifiable", "rank", "poses", "candidates", "rejected", "reference"):
        assert judged[key] == made.content[key]
    assert judged["criteria"][settings.get("criterion", "test_pose")] == judged["criterion"]["value"]


def test_random_poses_are_worse_than_the_plan_and_have_the_same_bound(tmp_path):
    whole = study(tmp_path, KR270, plan={"refine": False})
    made = plan(whole)
    rng = np.random.default_rng(1)
    for _ in range(5):
        pick = rng.choice(len(made.pool.candidates), 8, replace=False)
        found = evaluate(whole, visits(whole, made.pool.candidates.visit_q[pick], [0, 1]))
        assert found.bound.value > 1.05 * made.final.value
        assert found.bound.bound == pytest.approx(made.final.bound, rel=3e-6)
        assert 0 < found.bound.efficiency < made.final.efficiency


# --- invariance


def csv_of(whole, q, loads=(0, 1)):
    """A plan file for poses that the study's own file holds exactly."""
    return plan_csv(visits(whole, np.round(q, 3), loads), whole)


def some_poses(whole, count=8, seed=4):
    rng = np.random.default_rng(seed)
    return rng.uniform(np.maximum(whole.robot.lower, -3.0), np.minimum(whole.robot.upper, 3.0), (count, whole.robot.n))


def content_of(folder, text, base=KR270, **changes):
    """Content of evaluate.json for the text of a plan file."""
    path = study_file(folder, base, **merged({"plan": {"candidates": 100}}, changes))
    (folder / "plan.csv").write_text(text)
    return run_evaluate(path, folder / "plan.csv", seed=0).content


def figures(content):
    return [content["bound"], content["criterion"]["rms_mm"], *content["criteria"].values(), *content["std"]]


def test_the_order_of_rows_and_the_names_of_poses_and_markers_do_not_matter(tmp_path):
    whole = study(tmp_path, KR270)
    text = csv_of(whole, some_poses(whole))
    header, *rows = text.strip().split("\n")
    shuffled = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
    renamed = [row.replace("P0", "visit-", 1) for row in rows]
    before = content_of(tmp_path, text)
    for other in (shuffled, renamed):
        after = content_of(tmp_path, "\n".join([header, *other]) + "\n")
        np.testing.assert_allclose(figures(after)[1:], figures(before)[1:], rtol=1e-9)
        assert after["bound"] == pytest.approx(before["bound"], rel=2e-6), "the bound is proven to 1e-6"
    names = dict(zip(("zeta", "a.1", "M-9"), reversed(KR270["markers"].values()), strict=True))
    changed = {**KR270, "markers": names}
    np.testing.assert_allclose(figures(content_of(tmp_path, text, changed)), figures(before), rtol=1e-8)


def test_where_the_instrument_stands_does_not_matter_but_knowing_it_helps(tmp_path):
    """A free frame is fitted whatever it is; under absolute readings a known one saves six unknowns."""
    whole = study(tmp_path, KR270)
    text = csv_of(whole, some_poses(whole))
    free = content_of(tmp_path, text, model={"reference": "absolute"})
    base = content_of(tmp_path, text, model={"reference": "absolute"}, frames={"measurement": "base"})
    assert base["criterion"]["value"] < free["criterion"]["value"]
    changes = content_of(tmp_path, text, model={"reference": "differences"})
    other = content_of(tmp_path, text, model={"reference": "differences"}, frames={"measurement": "base"})
    np.testing.assert_allclose(figures(other), figures(changes), rtol=1e-9)


def test_a_turn_about_the_vertical_does_not_matter_and_a_tilt_does(tmp_path):
    whole = study(tmp_path, KR270)
    text = csv_of(whole, some_poses(whole))
    before = content_of(tmp_path, text)
    pushes = [{**pose, "wrench": [0, 0, -1500, 0, 0, 0]} for pose in KR270["test_poses"]]
    turned = content_of(tmp_path, text, robot={"mount_deg": [0, 0, 73.0]}, test_poses=pushes)
    np.testing.assert_allclose(figures(turned), figures(before), rtol=1e-8)
    tilted = content_of(tmp_path, text, robot={"mount_deg": [0, 30.0, 0]})
    assert tilted["rank"] == before["rank"] + 1
    assert tilted["nonidentifiable"] == []


def test_the_same_load_in_other_words_is_the_same_load(tmp_path):
    whole = study(tmp_path, KR270)
    text = csv_of(whole, some_poses(whole))
    wrench = [0.0, 0.0, -250.0 * 9.80665, 0.0, 0.0, 0.0]
    pushed = [{"id": "L0"}, {"id": "L1", "wrench": wrench, "attach_mm": [200.0, 50.0, -250.0]}, KR270["loads"][2]]
    np.testing.assert_allclose(
        figures(content_of(tmp_path, text, loads=pushed)), figures(content_of(tmp_path, text)), rtol=1e-9
    )


def test_a_measurement_file_is_judged_as_the_plan_that_it_followed(tmp_path):
    whole = study(tmp_path, KR270)
    text = csv_of(whole, some_poses(whole))
    before = content_of(tmp_path, text)
    rows = text.strip().split("\n")[1:]
    lines = ["pose,load,marker,repeat,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm"]
    for row in rows:
        pose, load, joints = row.split(",", 2)
        lines += [f"{pose},{load},{marker},1,{joints},1.0,2.0,3.0" for marker in ("M1", "M2", "M3")]
    np.testing.assert_allclose(figures(content_of(tmp_path, "\n".join(lines) + "\n")), figures(before), rtol=1e-9)


def test_a_plan_measured_four_times_is_twice_as_good(tmp_path):
    whole = study(tmp_path, KR270)
    q = some_poses(whole)
    once = content_of(tmp_path, csv_of(whole, q))
    often = content_of(tmp_path, csv_of(whole, np.tile(q, (4, 1))))
    assert often["criterion"]["value"] == pytest.approx(once["criterion"]["value"] / 4, rel=1e-9)
    assert often["efficiency"] == pytest.approx(once["efficiency"], rel=1e-5)
    np.testing.assert_allclose(often["std"], np.array(once["std"]) / 2, rtol=1e-9)


# --- sets of poses as people bring them


def test_poses_outside_limits_and_below_the_floor_are_judged_all_the_same(tmp_path):
    whole = study(tmp_path, KR270)
    inside = some_poses(whole)
    outside = inside.copy()
    outside[:3, 1] = np.deg2rad([150.0, 155.0, 160.0])
    found = content_of(tmp_path, csv_of(whole, outside))
    assert found["poses"] == 8
    assert 0 < found["efficiency"] <= 1


def test_where_nothing_keeps_to_the_constraints_the_set_is_compared_with_itself(tmp_path, caplog):
    whole = study(tmp_path, KR270)
    found = content_of(tmp_path, csv_of(whole, some_poses(whole)), constraints={"floor_mm": 9000.0})
    assert found["candidates"] == 0
    assert "compared with the given poses only" in caplog.text
    assert 0 < found["bound"] <= found["criterion"]["value"]


def test_what_cannot_be_identified_is_named_and_the_rest_is_judged(tmp_path):
    whole = study(tmp_path, KR270)
    found = content_of(tmp_path, csv_of(whole, some_poses(whole)))
    assert found["nonidentifiable"] == ["joint_compliance.j1"]
    assert "vertical loads put no torque on joint 1" in found["why_nonidentifiable"]["joint_compliance.j1"]
    assert found["weakest"]["parameter"] in found["parameters"]
    assert 0 < found["weakest"]["share_of_criterion"] <= 1
    assert len(found["test_poses"]) == 2
    for pose in found["test_poses"]:
        assert pose["rms_mm"] < pose["ci95"] < 2.0 * pose["rms_mm"]
        assert pose["ci95"] < pose["ci95_total"]


def test_poses_that_do_not_show_what_the_criterion_needs_are_refused(tmp_path):
    """Joint 3 of the arm is never loaded where its link stands upright."""
    upright = "pose,load,q1_deg,q2_deg,q3_deg\nA,L1,0,30,60\nB,L1,0,50,40\nC,L1,0,-20,110\n"
    with pytest.raises(NotIdentifiable, match=r"joint_compliance\.j3") as caught:
        content_of(tmp_path, upright, ARM)
    assert caught.value.exit_code == 3
    rest = content_of(tmp_path, upright, ARM, plan={"criterion": "A"})
    assert rest["parameters"] == ["joint_compliance.j2"]
    assert rest["criteria"]["test_pose"] is None


def test_a_set_that_sees_only_the_test_pose_is_judged_by_what_it_sees(tmp_path):
    """Facts, section 2.3: rank sigma^2 / m, although the parameters are not identifiable."""
    found = content_of(
        tmp_path,
        "pose,load,q1_deg,q2_deg\n" + "".join(f"{name},L0,20,60\n" for name in "ABCD"),
        ARM,
        robot={"model": "planar_2r"},
        loads=[{"id": "L0"}],
        noise={"reading_mm": 1.0},
        model={"effects": ["geometry"]},
        test_poses=[{"joints_deg": [20, 60]}],
    )
    assert found["criterion"]["value"] == pytest.approx(3 / 4, rel=1e-9)
    assert found["rank"] == 3
    assert len(found["nonidentifiable"]) > 8


def test_a_visit_with_more_readings_tells_more(tmp_path):
    whole = study(tmp_path, KR270)
    rows = csv_of(whole, some_poses(whole)).strip().split("\n")
    again = [row for row in rows[1:] if row.startswith("P001,L1")]
    more = content_of(tmp_path, "\n".join([*rows, *again]) + "\n")
    less = content_of(tmp_path, "\n".join(rows) + "\n")
    assert more["poses"] == less["poses"] == 8
    assert more["criterion"]["value"] < less["criterion"]["value"]
    both = "\n".join([*rows, rows[1].replace(",L0,", ",L2,")]) + "\n"
    assert content_of(tmp_path, both)["criterion"]["value"] < less["criterion"]["value"]


def test_a_plan_read_back_is_the_experiment_that_was_written(tmp_path):
    whole = study(tmp_path, KR270)
    experiment = visits(whole, np.deg2rad(np.round(np.rad2deg(some_poses(whole)), 6)), [0, 1])
    path = Path(tmp_path / "p.csv")
    path.write_text(plan_csv(experiment, whole))
    back = plan_experiment(load_plan(path, whole), whole)
    value = evaluate(whole, experiment).bound.value
    assert evaluate(whole, back).bound.value == pytest.approx(value, rel=1e-12)
    assert evaluate(replace(whole, noise=replace(whole.noise, reading=6e-5)), back).bound.value > value
