"""Measuring in steps: what was measured counts, enough is said to be enough, and poses that cannot be are kept out."""

import json
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest

from doe.accuracy import accuracy
from doe.cli import run
from doe.earlier import NEIGHBOURHOOD, Earlier, without_refused
from doe.earlier_files import EarlierFiles, load_earlier
from doe.evaluate import evaluate
from doe.observations import stacked_visits
from doe.plan import plan
from doe.pool import build_pool
from identify.config import load_study
from identify.errors import Infeasible, InputError, NotIdentifiable
from identify.experiment import full_experiment
from tests.doe.study_files import KR270, merged, study, study_file
from tests.doe.two_arm_files import write_both

ABSOLUTE = {"reference": "absolute"}


def taken(whole, count, seed=0):
    """Some random candidates as if they had been measured."""
    drawn = build_pool(whole, 0).candidates
    pick = np.random.default_rng(seed).choice(len(drawn), count, replace=False)
    return full_experiment(drawn.visit_q[pick], drawn.visit_loads[pick], whole.loads, whole.markers)


def both(whole, first, made):
    """The measured visits and those of a plan as one experiment."""
    q = np.concatenate([first.q, made.q])
    loads = np.concatenate([first.shot_load.reshape(len(first.q), -1), made.visit_loads])
    return full_experiment(q, loads, whole.loads, whole.markers)


# --- information


@pytest.mark.parametrize("model", [{}, ABSOLUTE], ids=["differences", "absolute"])
@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "E", "G"])
def test_measured_and_new_visits_are_worth_what_they_are_worth_in_one_file(tmp_path, model, criterion):
    """Under ``absolute`` this holds only if frame and markers are the same unknowns for both."""
    settings = {"candidates": 100, "poses": 4, "criterion": criterion, "max_std_percent": 1e6}
    settings["refine"] = criterion == "test_pose"
    whole = study(tmp_path, KR270, model=model, plan=settings)
    first = taken(whole, 5)
    made = plan(whole, earlier=Earlier(measured=first))
    judged = evaluate(whole, both(whole, first, made))
    assert made.pool.observer.reference == (model.get("reference") or "differences")
    assert len(made.q) == 4
    assert judged.bound.value == pytest.approx(made.final.value, rel=1e-6)
    assert made.final.bound <= made.final.value
    assert made.final.value <= made.pool.objective.value(made.pool.prior) * (1 + 1e-9), "more never worsens"


def test_only_rows_that_were_read_count(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 100, "poses": 3, "refine": False})
    first = taken(whole, 5)
    part = first.of_rows(np.flatnonzero(first.row_marker > 0))
    less, all_ = (build_pool(whole, 0, Earlier(measured=one)) for one in (part, first))
    assert less.objective.value(less.prior) > 1.05 * all_.objective.value(all_.prior)
    rows = stacked_visits(less.observer, part)[:, :, less.known.kept].reshape(-1, less.known.rank)
    np.testing.assert_allclose(less.prior, rows.T @ rows, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_measuring_more_never_worsens(tmp_path, seed):
    whole = study(tmp_path, KR270, plan={"candidates": 60, "refine": False, "max_std_percent": 1e6})
    first = taken(whole, 4, seed)
    values = []
    for count in (1, 2, 4):
        asked = replace(whole, plan=replace(whole.plan, poses=count))
        made = plan(asked, earlier=Earlier(measured=first))
        values.append(made.final.value)
        assert made.final.bound <= made.final.value
    start = made.pool.objective.value(made.pool.prior)
    assert start > values[0] > values[1] > values[2]


def test_all_poses_are_searched_beside_what_was_measured(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 80, "poses": 2, "criterion": "G", "curve": False})
    first = taken(whole, 3, 1)
    free = plan(whole, earlier=Earlier(measured=first))
    assert 0.9 < free.final.continuous <= 1.0
    assert free.final.value < free.grid.value
    again = free.pool.information(free.pool.observer.blocks(free.q, free.visit_loads)[:, :, free.pool.known.kept])
    assert free.pool.objective.value(again) == pytest.approx(free.final.value, rel=1e-9)
    clear = Earlier(measured=first, refused=free.q)
    other = plan(whole, earlier=clear)
    assert clear.clear(whole, other.q).all()
    assert not clear.clear(whole, free.q).any()
    assert other.final.value >= free.final.value * (1 - 2e-3)


@pytest.mark.parametrize("model", [{}, ABSOLUTE], ids=["differences", "absolute"])
@pytest.mark.parametrize("repeats", [True, False])
def test_the_bound_beside_measured_visits_is_never_above_the_best_of_all_plans(tmp_path, model, repeats):
    settings = {"candidates": 12, "poses": 2, "refine": False, "repeats": repeats, "max_std_percent": 1e6}
    whole = study(tmp_path, KR270, model=model, plan=settings)
    first = taken(replace(whole, plan=replace(whole.plan, candidates=300)), 6, seed=1)
    made = plan(whole, earlier=Earlier(measured=first))
    pool = made.pool
    pairs = [pair for pair in combinations_with_replacement(range(12), 2) if repeats or len(set(pair)) == 2]
    best = min(pool.objective.value(pool.information(pool.blocks[list(pair)])) for pair in pairs)
    assert made.final.bound <= best * (1 + 1e-9)
    assert made.final.value == pytest.approx(best, rel=1e-9)
    assert made.final.efficiency > 0.9


def test_what_only_measured_visits_show_is_known(tmp_path):
    """Joint 1 was pulled sideways, which the loads of the plan do not do; the test pose needs it."""
    sideways = {"id": "L3", "wrench": [0.0, 900.0, 0.0, 0.0, 0.0, 0.0], "attach_mm": [300.0, 0.0, 0.0]}
    tests = [{"joints_deg": [0.0, -60.0, 90.0, 0.0, 45.0, 0.0], "wrench": [0, 900.0, 0, 0, 0, 0]}]
    settings = {"candidates": 60, "poses": 3, "refine": False}
    whole = study(tmp_path, KR270, loads=[*KR270["loads"], sideways], test_poses=tests, plan=settings)
    rich = taken(replace(whole, plan=replace(whole.plan, loads=("L3",))), 6)
    with pytest.raises(NotIdentifiable, match=r"joint_compliance\.j1"):
        plan(whole)
    made = plan(whole, earlier=Earlier(measured=rich))
    assert "joint_compliance.j1" in [made.pool.observer.names[column] for column in made.pool.known.kept]
    assert 0.0 < made.final.bound <= made.final.value < made.pool.objective.value(made.pool.prior)


# --- tolerance


def tolerance(folder, value, **more):
    return study(folder, KR270, plan={"poses": None, "tolerance_mm": value, "candidates": 150, **more})


def test_the_fewest_more_visits_are_planned_and_none_where_it_is_enough(tmp_path):
    whole = tolerance(tmp_path, 0.0768)
    alone = plan(whole)
    first = taken(whole, 4)
    made = plan(whole, earlier=Earlier(measured=first))
    assert 0 < len(made.q) < len(alone.q)
    reached = accuracy(whole, made.pool.objective.rows, made.covariance)
    assert reached.radius(0.95) <= 0.0768
    done = plan(whole, earlier=Earlier(measured=both(whole, first, made)))
    assert len(done.q) == 0
    assert done.final.bound == done.final.value == pytest.approx(made.final.value, rel=1e-6)


def test_one_visit_less_would_not_keep_the_tolerance(tmp_path):
    whole = tolerance(tmp_path, 0.0762, refine=False)
    first = taken(whole, 4)
    made = plan(whole, earlier=Earlier(measured=first))
    assert len(made.q) > 1
    fewer = replace(whole, plan=replace(whole.plan, poses=len(made.q) - 1, tolerance=None))
    worse = plan(fewer, earlier=Earlier(measured=first))
    assert accuracy(whole, worse.pool.objective.rows, worse.covariance).radius(0.95) > 0.0762


# --- poses that could not be measured


def test_refused_poses_and_their_neighbours_are_kept_out(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 100, "poses": 3})
    free = plan(whole)
    refused = Earlier(refused=free.q[:2])
    made = plan(whole, earlier=refused)
    assert not refused.clear(whole, free.q[:2]).any()
    assert refused.clear(whole, made.q).all()
    for pose in free.q[:2]:
        apart = np.rad2deg(np.abs((made.q - pose + np.pi) % (2 * np.pi) - np.pi)).max(axis=1)
        assert (apart >= NEIGHBOURHOOD).all()
    assert len(made.q) == 3
    assert made.final.value < 1.5 * free.final.value, "others take their place"


def test_neighbourhood_counts_every_joint_and_full_turns(tmp_path):
    whole = study(tmp_path, KR270)
    pose = np.deg2rad([0.0, -60.0, 90.0, 0.0, 45.0, 175.0])
    refused = Earlier(refused=pose[None])
    near = pose + np.deg2rad([4.9, -4.9, 0.0, 4.0, 0.0, 0.0])
    turned = pose + np.deg2rad([0.0, 0.0, 0.0, 0.0, 0.0, -356.0])
    far = pose + np.deg2rad([0.0, 5.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(refused.clear(whole, np.stack([near, turned, far])), [False, False, True])


def test_the_candidates_that_are_left_keep_their_loads_and_are_counted(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 60, "loads": ["L1", "L2"]})
    drawn = build_pool(whole, 0).candidates
    left = without_refused(whole, drawn, Earlier(refused=drawn.q[[3, 10]]))
    gone = np.isin(drawn.pose, [3, 10])
    np.testing.assert_array_equal(left.visit_q, drawn.visit_q[~gone])
    np.testing.assert_array_equal(left.visit_loads, drawn.visit_loads[~gone])
    assert left.rejected["unreachable"] == gone.sum()
    with pytest.raises(Infeasible, match="could not be measured; ask for more"):
        without_refused(whole, drawn, Earlier(refused=drawn.q))


# --- a first fit


def result_file(folder, **values):
    """An identify.json with some values."""
    listed = [
        {"name": f"joint_compliance.{joint}", "value": value, "unit": "urad/Nm", "std": 0.1, "nuisance": False}
        for joint, value in values.items()
    ]
    content = {
        "effects": ["joint_compliance"],
        "parameters": listed,
        "covariance": (0.01 * np.eye(len(listed))).tolist(),
        "frames": {"base_T_measurement": np.eye(4).tolist()},
        "reference": "differences",
        "options": {},
    }
    path = folder / "identify.json"
    path.write_text(json.dumps(content))
    return path


def test_values_of_a_first_fit_are_planned_with(tmp_path):
    """What a sticking joint holds back is its friction times its compliance, so the blocks change."""
    model = {
        "effects": ["joint_compliance", "stiction@j2"],
        "nominal": {"joint_compliance.j2": 0.3, "stiction.j2": 50.0},
    }
    frames = {"measurement": "base", "markers": "exact"}
    whole = study(tmp_path, KR270, model=model, plan={"candidates": 80, "poses": 6}, frames=frames)
    fitted, earlier, notes = load_earlier(whole, EarlierFiles(result=result_file(tmp_path, j2=0.6, j3=0.4)))
    assert fitted.nominal["joint_compliance.j2"] == 0.6
    assert fitted.nominal["joint_compliance.j3"] == 0.4
    assert fitted.reference == "differences"
    assert (earlier.measured, earlier.names, notes) == (None, (), ())
    before, after = (build_pool(one, 0) for one in (replace(whole, reference="differences"), fitted))
    assert after.observer.model.nominal[after.observer.names.index("joint_compliance.j2")] == 0.6
    assert before.observer.names[before.known.kept[-1]] == "stiction.j2"
    np.testing.assert_allclose(after.blocks[:, :, -1], 2.0 * before.blocks[:, :, -1], rtol=1e-9)


def test_what_a_result_holds_beyond_the_model_is_said(tmp_path):
    whole = study(tmp_path, KR270, model={"effects": ["joint_compliance@j2"]})
    fitted, _, notes = load_earlier(whole, EarlierFiles(result=result_file(tmp_path, j2=0.6, j3=0.4)))
    assert "joint_compliance.j3" not in fitted.nominal
    assert "joint_compliance.j3" in notes[0]


# --- the command


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A folder with a study, a plan of six poses, its measurements and the fit."""
    folder = tmp_path_factory.mktemp("measured")
    file = study_file(folder, KR270, plan={"candidates": 100, "poses": 6})
    (folder / "truth.toml").write_text('[truth.values]\n"joint_compliance.j2" = 0.3\n"joint_compliance.j3" = 0.4\n')
    for words in (
        ["plan", file, "--out", folder / "plan"],
        ["simulate", file, folder / "plan/plan.csv", "--truth", folder / "truth.toml", "--out", folder / "read"],
        ["identify", file, folder / "read/measurements.csv", "--out", folder / "fit"],
    ):
        assert run([*map(str, words), "--quiet"]) == 0
    return folder


def planned(folder, out, *words, file="study.toml"):
    """plan.json and the lines of plan.csv of a further plan."""
    assert run(["plan", str(folder / file), *map(str, words), "--out", str(out), "--quiet"]) == 0
    return json.loads((out / "plan.json").read_text()), (out / "plan.csv").read_text().splitlines()


def test_a_further_plan_continues_the_first(measured, tmp_path, capsys):
    rows, fit = measured / "read/measurements.csv", measured / "fit/identify.json"
    words = [
        "--measured",
        rows,
        "--result",
        fit,
        "--earlier",
        measured / "plan/plan.csv",
        "--unreachable",
        "P002, P005",
    ]
    told, lines = planned(measured, tmp_path / "out", *words)
    first = json.loads((measured / "plan/plan.json").read_text())
    assert [line.split(",")[0] for line in lines[1::2]] == [f"P{i:03d}" for i in range(7, 13)]
    assert told["measured"]["visits"] == 6
    assert told["measured"]["rms_mm"] == pytest.approx(first["criterion"]["rms_mm"], rel=1e-6)
    assert told["criterion"]["rms_mm"] < 0.8 * told["measured"]["rms_mm"]
    assert told["unreachable"] == ["P002", "P005"]
    assert {"measurements.csv", "identify.json", "plan.csv"} <= set(told["provenance"]["inputs"])
    assert told["joint_only"] is None
    assert told["curve"][0]["bound_mm"] < told["measured"]["rms_mm"]
    assert "beside what was measured" in capsys.readouterr().out
    whole = load_study(measured / "study.toml")
    _, earlier, _ = load_earlier(whole, EarlierFiles(rows, None, None, ("P002", "P005")))
    q = np.deg2rad([[float(cell) for cell in line.split(",")[2:]] for line in lines[1:]])
    assert earlier.clear(whole, q).all()


def test_enough_is_said_to_be_enough(measured, tmp_path, capsys):
    easy = merged(KR270, {"plan": {"poses": None, "tolerance_mm": 0.2, "candidates": 100}})
    study_file(measured, easy, name="easy.toml")
    told, lines = planned(
        measured, tmp_path / "out", "--measured", measured / "read/measurements.csv", file="easy.toml"
    )
    assert told["poses"] == 0
    assert told["bound"] == told["criterion"]["value"]
    assert len(lines) == 1
    assert "nothing more needs to be measured" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--unreachable", "P002"], "name the plan it stands in with --earlier"),
        (["--unreachable", "P02", "--earlier", "plan/plan.csv"], "--unreachable P02: no such pose"),
        (["--measured", "nothing.csv"], "nothing.csv cannot be read"),
        (["--result", "plan/plan.json"], "no result of identify"),
    ],
)
def test_wrong_words_are_refused(measured, tmp_path, capsys, monkeypatch, words, said):
    monkeypatch.chdir(measured)
    assert run(["plan", "study.toml", *words, "--out", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [["plan", "--unreachable", "P002"], ["evaluate", "plans", "--measured", "read.csv"]])
def test_two_arms_are_not_continued(tmp_path, capsys, words):
    command, *rest = words
    assert run([command, str(write_both(tmp_path)), *rest, "--out", str(tmp_path / "out")]) == 2
    assert "belong to a study of one arm" in capsys.readouterr().err


def test_poses_are_judged_beside_what_was_measured_as_the_plan_was(measured, tmp_path, capsys):
    """The further plan, judged from its file, is worth what it was planned to be worth."""
    words = ["--measured", measured / "read/measurements.csv", "--result", measured / "fit/identify.json"]
    file = study_file(measured, KR270, name="grid.toml", plan={"candidates": 100, "poses": 6, "refine": False})
    told, _ = planned(measured, tmp_path / "more", *words, file=file.name)
    judge = ["evaluate", file, tmp_path / "more/plan.csv", "--quiet"]
    for out, more in (("beside", words), ("alone", [])):
        assert run([*map(str, [*judge, *more, "--out", tmp_path / out])]) == 0
    found, alone = (json.loads((tmp_path / out / "evaluate.json").read_text()) for out in ("beside", "alone"))
    assert found["criterion"]["value"] == pytest.approx(told["criterion"]["value"], rel=1e-6)
    assert found["measured"] == pytest.approx(told["measured"], rel=1e-9)
    assert found["std"] == pytest.approx(told["std"], rel=1e-6)
    assert found["bound"] <= found["criterion"]["value"] < alone["criterion"]["value"]
    assert found["bound"] < alone["bound"], "more information than any plan alone can have"
    assert found["criterion"]["rms_mm"] < found["curve"][0]["own_mm"] < found["measured"]["rms_mm"]
    assert alone["measured"] is None
    assert {"measurements.csv", "identify.json"} <= set(found["provenance"]["inputs"])
    assert "measured already: 6 visits" in capsys.readouterr().out


def test_poses_that_show_too_little_alone_are_judged_beside_what_was_measured(measured, tmp_path):
    rows = (measured / "plan/plan.csv").read_text().splitlines()
    (tmp_path / "one.csv").write_text("\n".join(rows[:3]) + "\n")
    judge = ["evaluate", str(measured / "study.toml"), str(tmp_path / "one.csv"), "--quiet"]
    told = ["--measured", str(measured / "read/measurements.csv")]
    assert run([*judge, *told, "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "evaluate.json").read_text())
    assert found["poses"] == 1
    assert found["rank"] == 5
    assert found["criterion"]["rms_mm"] < found["measured"]["rms_mm"]


def test_orientations_that_the_study_counts_on_must_be_there(measured, tmp_path):
    whole = study(tmp_path, KR270, noise={"orientation_urad": 50.0})
    with pytest.raises(InputError, match="columns qw, qx, qy, qz are missing"):
        load_earlier(whole, EarlierFiles(measured=measured / "read/measurements.csv"))


# --- with the order of measuring


def test_what_was_measured_keeps_its_own_jitter_where_new_readings_are_visits_of_their_own(tmp_path):
    whole = study(tmp_path, KR270, model=ABSOLUTE, plan={"candidates": 100, "poses": 4, "refine": False})
    apart = replace(whole, plan=replace(whole.plan, references="own_visits"))
    earlier = Earlier(measured=taken(whole, 5))
    within, made = build_pool(whole, 0, earlier), plan(apart, earlier=earlier)
    assert made.pool.observer.own_visits
    assert made.pool.prior == pytest.approx(within.prior, rel=1e-9)
    assert len(made.schedule.q) == 8
    judged = evaluate(whole, both(whole, earlier.measured, made))
    assert judged.bound.value != pytest.approx(made.final.value, rel=1e-3), "new readings share no jitter"


def test_a_budget_beside_what_was_measured(tmp_path):
    whole = study(tmp_path, KR270, plan={"candidates": 100, "poses": None, "cost_budget": 8.0, "pose_cost": 2.0})
    first = taken(whole, 5)
    made = plan(whole, earlier=Earlier(measured=first))
    assert len(made.q) == 4
    assert made.bought.spent <= 8.0
    assert evaluate(whole, both(whole, first, made)).bound.value == pytest.approx(made.final.value, rel=1e-6)
    assert 0.5 * made.final.value < made.final.bound <= made.final.value
