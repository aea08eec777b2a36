"""Plans in the order of measuring: drift in simulated readings, times, visits of their own, approaches."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe import order_search
from doe.cli import run
from doe.commands import run_evaluate, run_plan
from doe.drift import drift_of_readings, typical_drift, yardstick
from doe.evaluate import evaluate
from doe.feasible import check, joint_range
from doe.information import covariance_of, information_of
from doe.lifts import hung_states, lifts_of
from doe.observations import observer, stacked_visits
from doe.plan import plan
from doe.schedule import STEP, time_as_given
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.model import effects_of, with_effect
from identify.schema import PlanSection, TimesSection
from identify.simulate import default_placement, simulate
from identify.study import Noise
from identify.tables import load_plan, plan_csv, plan_experiment
from identify.units import DEG, HOUR
from tests.doe.study_files import ARM, KR270, study, study_file

SMALL = {"candidates": 150, "poses": 12, "refine": False}
DOCS = Path(__file__).parents[2] / "docs"
TIMES = {"pose_s": 60.0, "reading_s": 15.0, "load_change_s": 300.0, "speed_deg_s": 20.0, "start_s": 600.0}
ABSOLUTE = {"effects": ["joint_compliance"], "reference": "absolute"}


def kr270(folder, **changes):
    """A small KR 270 study."""
    return study(folder, KR270, **{**changes, "plan": {**SMALL, **changes.get("plan", {})}})


def bias_of_drift(made, made_study, experiment, rate):
    """Error at the test poses, mm rms, that drift alone makes in an estimate from simulated readings."""
    watching, kept = made.pool.observer, made.pool.known.kept
    model = watching.model
    drifting = with_effect(model, *effects_of(made_study, ("tracker_drift",)))
    values = np.concatenate([model.nominal, rate])
    placement = default_placement(made_study.noise, frame_free=made_study.frame_free)
    noise = Noise(reading=1e-12)
    read = simulate(drifting, values, experiment, noise, placement, np.random.default_rng(0)).positions
    still = simulate(model, model.nominal, experiment, noise, placement, np.random.default_rng(0)).positions
    blocks = stacked_visits(watching, experiment, lambda scene: (read - still)[:, :, None])
    own, moved = blocks[:, :, kept], blocks[:, :, -1]
    bias = covariance_of(information_of(own)) @ np.einsum("vkp,vk->p", own, moved)
    return float(np.linalg.norm(made.pool.objective.target("test_pose") @ bias))


@pytest.mark.parametrize("model", [{}, {"reference": "absolute"}], ids=["differences", "absolute"])
def test_drift_in_simulated_readings_cancels_in_the_ordered_plan(tmp_path, model):
    made_study = kr270(tmp_path, times=TIMES, model={"effects": ["joint_compliance"], **model})
    made = plan(made_study)
    rate = np.array([0.2, -0.3, 0.25, 0.02, -0.01, 0.02])
    ordered = made.schedule.conditions(made_study)
    naive = full_experiment(made.q, np.sort(made.visit_loads, axis=1), made_study.loads, made_study.markers)
    late = 660.0 + np.arange(len(naive.shot_visit)) * (STEP + 300.0)
    naive = replace(naive, time=late[naive.row_shot], start=None)
    own = made.final.value**0.5
    assert bias_of_drift(made, made_study, ordered, rate) < 0.5 * own
    assert bias_of_drift(made, made_study, ordered, rate) < 0.2 * bias_of_drift(made, made_study, naive, rate)
    assert made.schedule.left.shift < 0.2 * made.schedule.as_found.shift


def test_what_drift_leaves_is_what_simulated_drift_does(tmp_path):
    made_study = kr270(tmp_path, times=TIMES, model=ABSOLUTE)
    made = plan(made_study)
    ordered = made.schedule
    measure = yardstick(made.pool.objective, made.covariance)
    kept, gain = made.pool.known.kept, measure.rows @ made.covariance
    effect = drift_of_readings(made.pool.observer, ordered.q, ordered.visit_loads, kept, gain)
    late = (ordered.times - ordered.times[0, 0]) / HOUR
    for freedom, rate in enumerate(np.eye(6)):
        total = np.linalg.norm(np.einsum("vs,vsr->r", late, effect[..., freedom]))
        simulated = bias_of_drift(made, made_study, ordered.conditions(made_study), rate)
        assert total == pytest.approx(simulated, rel=1e-3, abs=1e-7)


def test_order_does_not_change_what_a_plan_is_worth(tmp_path):
    path = study_file(tmp_path, KR270, plan=SMALL, times=TIMES)
    told = run_plan(path, seed=0, out=tmp_path)
    (tmp_path / "plan.csv").write_text(told.tables["plan.csv"])
    judged = run_evaluate(path, tmp_path / "plan.csv", seed=0).content
    assert judged["criterion"]["value"] == pytest.approx(told.content["criterion"]["value"], rel=1e-9)
    assert judged["time_s"] == pytest.approx(told.content["time_s"], rel=1e-9)


def test_plan_csv_is_in_the_order_of_measuring_with_times(tmp_path):
    path = study_file(tmp_path, KR270, plan={**SMALL, "loads": ["L1", "L2"]}, times=TIMES)
    told = run_plan(path, seed=0, out=tmp_path)
    rows = [line.split(",") for line in told.tables["plan.csv"].splitlines()]
    time = rows[0].index("time_s")
    names = {"L0": 0, "L1": 1, "L2": 2}
    states = hung_states(np.array([names[row[1]] for row in rows[1:]]), np.array([True, False, False]))
    assert told.content["order"]["lifts"] == lifts_of(states) == told.content["order"]["lifts_fewest"]
    assert told.content["order"]["lifts_proven"]
    assert (np.diff([float(row[time]) for row in rows[1:]]) > 0).all()
    assert float(rows[-1][time]) == pytest.approx(told.content["time_s"])
    assert told.content["order"]["travel_s"] == pytest.approx(told.content["order"]["travel_deg"] / 20.0)
    assert any("crane operations" in line for line in told.lines)


def test_without_times_there_is_an_order_but_no_time(tmp_path):
    told = run_plan(study_file(tmp_path, KR270, plan=SMALL), seed=0, out=tmp_path)
    assert told.content["time_s"] is None
    assert told.content["order"]["reading_times"] == f"equal steps of {STEP:g} s"
    assert "time_s" not in told.tables["plan.csv"]
    assert told.content["order"]["lifts"] == 12


def test_speeds_alone_give_the_time_of_travel(tmp_path):
    made = plan(kr270(tmp_path, times={"speed_deg_s": 10.0, "start_s": 100.0}))
    assert made.schedule.time == pytest.approx(100.0 + made.schedule.travel_deg / 10.0)
    assert not made.schedule.stated


def test_the_time_of_a_plan_as_it_stands(tmp_path):
    made = kr270(tmp_path, times=TIMES)
    q = np.deg2rad([[0.0, -60.0, 90.0, 0.0, 45.0, 0.0], [20.0, -60.0, 90.0, 0.0, 45.0, 0.0]])
    experiment = full_experiment(q, np.array([[0, 1], [0, 2]]), made.loads, made.markers)
    assert time_as_given(made, experiment) == pytest.approx(600 + 2 * 60 + 2 * 15 + 1.0 + 3 * 300)
    assert time_as_given(replace(made, times=None), experiment) is None


def test_criteria_without_test_poses_measure_drift_in_standard_deviations(tmp_path):
    made = plan(kr270(tmp_path, test_poses=None, plan={"criterion": "A"}))
    assert made.schedule.unit == "std"
    assert made.schedule.left.shift < 0.3 * made.schedule.as_found.shift


def test_a_wall_between_poses_and_no_way_around_is_refused(tmp_path):
    from identify.errors import Infeasible

    made = kr270(tmp_path, plan={"poses": 6, "candidates": 100})
    with pytest.raises(Infeasible, match="home_deg"):
        plan(made, free=lambda first, second, _: np.zeros(len(first), dtype=bool))
    told = plan(made, free=lambda first, second, _: (first[:, 0] * second[:, 0]) >= 0, home=np.zeros(6))
    assert len(told.q) == 6


# --- unloaded visits of their own


def test_own_visits_know_that_jitter_no_longer_cancels(tmp_path):
    """The information of a plan is that of its visits as they are measured, each with a jitter of its own."""
    made_study = kr270(tmp_path, model=ABSOLUTE, times=TIMES, plan={"references": "own_visits"})
    made = plan(made_study)
    ordered = made.schedule
    assert len(ordered.q) == 2 * len(made.q)
    assert ordered.visit_loads.shape[1] == 1
    assert ordered.lifts == 2
    (tmp_path / "plan.csv").write_text(plan_csv(ordered.conditions(made_study), made_study))
    experiment = plan_experiment(load_plan(tmp_path / "plan.csv", made_study), made_study)
    judged = evaluate(made_study, experiment)
    assert judged.visits == 24
    assert judged.bound.value == pytest.approx(made.final.value, rel=1e-9)
    shared = observer(made_study).blocks(made.q, made.visit_loads)[:, :, made.pool.known.kept]
    alone = made.pool.observer.blocks(made.q, made.visit_loads)[:, :, made.pool.known.kept]
    assert np.abs(information_of(shared) / information_of(alone) - 1).max() > 0.1


def test_own_visits_let_drift_cancel_around_the_weights(tmp_path):
    made = plan(kr270(tmp_path, model=ABSOLUTE, times=TIMES, plan={"references": "own_visits", "loads": ["L1", "L2"]}))
    assert made.schedule.lifts <= 4
    assert made.schedule.left.shift < 0.2 * made.schedule.as_found.shift


@pytest.mark.slow
def test_own_visits_can_be_refined(tmp_path):
    """The symbolic blocks know the jitter of own visits too."""
    made = plan(kr270(tmp_path, model=ABSOLUTE, plan={"references": "own_visits", "refine": True, "poses": 6}))
    assert made.refinement.status != "not run"
    assert made.final.value < made.grid.value


@pytest.mark.slow
def test_auto_takes_the_better_way_within_the_time(tmp_path):
    noise = {"reading_mm": 1000.0, "pose_jitter_urad": 2e5}
    asked = {"poses": None, "time_budget_s": 3000.0, "candidates": 60, "refine": False, "reference_rows": True}
    made = {
        way: plan(study(tmp_path, ARM, noise=noise, times=TIMES, plan={**asked, "references": way}))
        for way in ("same_visit", "own_visits", "auto")
    }
    values = {way: own.final.value for way, own in made.items()}
    assert values["auto"] == min(values["same_visit"], values["own_visits"])
    assert values["same_visit"] != pytest.approx(values["own_visits"], rel=1e-3)
    assert any("auto" in note for note in made["auto"].notes)


def test_auto_stays_with_one_visit_where_readings_are_compared(tmp_path):
    whole = kr270(tmp_path, model={"reference": "differences"}, plan={"references": "auto", "poses": 6})
    assert not plan(whole).pool.observer.own_visits


def test_own_visits_are_refused_where_masses_are_unknown(tmp_path):
    whole = kr270(tmp_path, plan={"references": "own_visits"})
    with pytest.raises(InputError, match=r"own_visits.*the mass of a moved link is unknown.*same_visit"):
        plan(replace(whole, robot=replace(whole.robot, masses=np.full_like(whole.robot.masses, np.nan))))


# --- one approach


@pytest.mark.slow
def test_every_joint_has_room_to_come_from_below(tmp_path):
    made_study = kr270(tmp_path, plan={"approach": "same", "approach_deg": 3.0, "refine": True, "poses": 6})
    told = run_plan(made_study.path, seed=0, out=tmp_path)
    np.testing.assert_allclose(told.content["approach_deg"], 3.0)
    header, *rows = (line.split(",") for line in told.tables["plan.csv"].splitlines())
    columns = [header.index(f"approach{i + 1}") for i in range(6)]
    assert all(row[c] == "1" for row in rows for c in columns)
    made = plan(made_study)
    below = made.q - 3.0 * DEG
    assert (below >= joint_range(replace(made_study, plan=replace(made_study.plan, approach="any")))[0] - 1e-9).all()
    anywhere = replace(made_study, plan=replace(made_study.plan, approach="any"))
    assert check(anywhere, below, made.visit_loads).ok.all()
    assert "approach1" not in run_plan(study_file(tmp_path, KR270, plan=SMALL), seed=0, out=tmp_path).tables["plan.csv"]


def test_poses_that_are_reached_from_below_the_floor_are_rejected(tmp_path):
    whole = kr270(tmp_path, plan={"approach": "same", "approach_deg": 10.0})
    anywhere = replace(whole, plan=replace(whole.plan, approach="any"))
    lower, upper = joint_range(whole)
    q = np.random.default_rng(0).uniform(lower, upper, (400, 6))
    loads = np.zeros((400, 1), dtype=np.int64)
    both = check(anywhere, q, loads).ok & check(anywhere, q - 10.0 * DEG, loads).ok
    assert (check(whole, q, loads).ok == both).all()
    assert both.sum() < check(anywhere, q, loads).ok.sum()


# --- the command line


BAD = {
    "own visits and differences": (
        {"plan": {"references": "own_visits"}, "model": {"reference": "differences"}},
        ["[plan] references = 'own_visits'", "differences", "same_visit"],
    ),
    "own visits without references": (
        {"plan": {"references": "own_visits", "reference_rows": False}},
        ["[plan] references", "reference_rows = true"],
    ),
    "time without a pose": (
        {"plan": {"poses": None, "time_budget_s": 900.0}, "times": {"load_change_s": 5.0}},
        ["[times] pose_s", "time_budget_s"],
    ),
    "negative time": ({"plan": {"poses": None, "time_budget_s": -5.0}}, ["[plan] time_budget_s = -5", "above 0"]),
    "negative cost": ({"plan": {"poses": None, "cost_budget": -1.0}}, ["[plan] cost_budget = -1", "above 0"]),
    "free poses": ({"plan": {"poses": None, "cost_budget": 10.0}}, ["[plan] cost_budget", "pose_cost", "L1"]),
    "start takes it all": (
        {"plan": {"poses": None, "time_budget_s": 500.0}, "times": TIMES},
        ["[plan] time_budget_s = 500", "start_s = 600"],
    ),
    "poses and time": (
        {"plan": {"time_budget_s": 9000.0}, "times": TIMES},
        ["[plan] poses = 12", "poses or time_budget_s, not both"],
    ),
    "losses and a budget": (
        {"plan": {"poses": None, "cost_budget": 10.0, "pose_cost": 1.0, "robust_to_losses": 1}},
        ["[plan] robust_to_losses = 1", "cost_budget", "give poses or tolerance_mm"],
    ),
    "draws and a budget": (
        {"plan": {"poses": None, "time_budget_s": 9000.0, "draws": 4}, "times": TIMES},
        ["[plan] draws = 4", "time_budget_s", "give poses or tolerance_mm"],
    ),
    "losses and own visits": (
        {"plan": {"references": "auto", "robust_to_losses": 1}},
        ["[plan] robust_to_losses = 1", "auto", "same_visit"],
    ),
    "backwards": ({"times": {"pose_s": -1.0}}, ["[times] pose_s = -1"]),
    "standing still": ({"times": {"speed_deg_s": 0.0}}, ["[times] speed_deg_s = 0", "above 0"]),
    "no room": ({"plan": {"approach": "same", "approach_deg": 400.0}}, ["[plan] approach_deg = 400", "no range"]),
    "unknown key": ({"times": {"pose_ms": 4.0}}, ["[times] pose_ms", "unknown key"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_with_its_key(tmp_path, name, capsys):
    changes, parts = BAD[name]
    path = study_file(tmp_path, KR270, **{**changes, "plan": {**SMALL, **changes.get("plan", {})}})
    assert run(["plan", str(path), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert not [part for part in parts if part not in message], message
    assert not (tmp_path / "out").exists()


def test_an_impossible_budget_cannot_be_done_as_stated(tmp_path, capsys):
    path = study_file(tmp_path, KR270, plan={**SMALL, "poses": None, "time_budget_s": 700.0}, times=TIMES)
    assert run(["plan", str(path), "--out", str(tmp_path / "out")]) == 3
    assert "[plan] time_budget_s = 700 is too small: one experiment takes at least 975" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    path = study_file(tmp_path, KR270, plan={**SMALL, "loads": ["L1", "L2"]}, times=TIMES)
    for name in ("a", "b"):
        assert run(["plan", str(path), "--out", str(tmp_path / name), "--seed", "4", "--quiet"]) == 0
    for file in ("plan.json", "plan.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    told = json.loads((tmp_path / "a" / "plan.json").read_text())
    assert told["order"]["lifts"] == told["order"]["lifts_fewest"]


# --- what the pages say


def test_every_key_and_weight_is_documented(tmp_path):
    path = study_file(tmp_path, KR270, plan={**SMALL, "poses": None, "time_budget_s": 3600.0}, times=TIMES)
    content = run_plan(path, seed=0, out=tmp_path).content
    formats = (DOCS / "formats.md").read_text(encoding="utf-8")
    section = formats[formats.index("**Order of a plan**") : formats.index("**Reduction**")]
    order = content["order"]
    keys = {
        "time_s",
        "order",
        "references",
        "approach_deg",
        "budget",
        *order,
        *order["drift_leftover"],
        *content["budget"],
    }
    assert not [key for key in sorted(keys) if f"`{key}`" not in section]
    tables = formats[formats.index("## The study") : formats.index("Other keys are errors")]
    assert not [key for key in (*TimesSection.model_fields, *PlanSection.model_fields) if f"`{key}`" not in tables]
    assert f"equal steps of {STEP:g} s" in section
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    assert f"travel / travel_0 + {order_search._OWN:g} drift / own + {order_search._NAIVE:g} drift / naive" in theory
    typical = typical_drift(observer(kr270(tmp_path)))
    assert f"({typical[0]:g} mm/h, {typical[3]:g} mrad/h)" in " ".join(theory.split())
