"""Station and markers as part of the design: what is tried, what wins, what is written."""

import json
import tomllib
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from doe import design_choices
from doe.commands import run_evaluate, run_plan
from doe.design_choices import decide, open_choices
from doe.feasible import check
from doe.plan import plan
from doe.two_arm_pool import drawn
from identify.commands import run_simulate
from identify.config import load_study
from identify.errors import Infeasible, InputError
from tests.doe.study_files import KR270, study_file

STATIONS = [
    {"id": "near", "position_mm": [4000.0, 1000.0, 1000.0]},
    {"id": "far", "position_mm": [14000.0, 1000.0, 1000.0]},
]
TRACKER = {
    "reading_mm": None,
    "tracker": {"radial_um": 5.0, "radial_um_per_m": 1.0, "transverse_um": 10.0, "transverse_um_per_m": 6.0},
}
CHOICES = {
    "M2": [50.0, 100.0, -60.0],
    "M3": [50.0, -100.0, -60.0],
    "M4": [52.0, 1.0, 118.0],
    "M5": [-60.0, 0.0, -10.0],
    "M6": [400.0, 100.0, 100.0],
}
OPEN = {
    "markers": {"M2": None, "M3": None},
    "marker_choices": CHOICES,
    "tracker_stations": STATIONS,
    "noise": TRACKER,
    "plan": {"markers": 2, "candidates": 150, "refine": False, "poses": 6},
}


def choosing(folder, **changes):
    return study_file(folder, KR270, **{**OPEN, **changes})


def test_the_best_of_all_options_is_taken_and_its_worth_told(tmp_path):
    study = load_study(choosing(tmp_path))
    assert open_choices(study)
    chosen, decision = decide(study, seed=0)
    assert decision.complete
    options = {(option.station, option.markers): option for option in decision.tried}
    expected = {(s, pair) for s in ("near", "far") for pair in combinations(CHOICES, 2)}
    assert set(options) == expected
    assert decision.best.value == min(option.value for option in decision.tried)
    assert decision.best.station == "near"
    for pair in combinations(CHOICES, 2):
        assert options["near", pair].value < options["far", pair].value
    assert "M6" in decision.best.markers, "the longest lever tells most"
    told = decision.as_json
    assert told["value"] < told["median"] < told["worst"]
    assert told["gain_percent"] == pytest.approx(100 * (1 - told["value"] / told["median"]))
    json.dumps(told, allow_nan=False)
    assert not open_choices(chosen)
    assert chosen.markers.names == ("M1", *decision.best.markers)
    np.testing.assert_allclose(chosen.noise.tracker.station, [4.0, 1.0, 1.0])
    assert decide(chosen, seed=0) == (chosen, None)


def test_exchange_finds_what_trying_all_finds(tmp_path, monkeypatch):
    study = load_study(choosing(tmp_path))
    everything = decide(study, seed=0)[1]
    monkeypatch.setattr(design_choices, "_TRIED", 5)
    exchanged = decide(study, seed=0)[1]
    assert not exchanged.complete
    assert exchanged.best == everything.best
    assert {(o.station, o.markers) for o in exchanged.tried} <= {(o.station, o.markers) for o in everything.tried}


def test_an_option_that_sees_nothing_is_not_taken_and_said(tmp_path):
    limits = {"visibility": {"min_range_mm": 9000.0}}
    study = load_study(
        choosing(tmp_path, constraints=limits, marker_choices=None, plan={"candidates": 60, "markers": None})
    )
    _, decision = decide(study, seed=0)
    assert decision.best.station == "far"
    blind = decision.tried[-1]
    assert (blind.station, blind.value) == ("near", np.inf)
    assert "tracker_range" in blind.why
    assert decision.as_json["tried"][-1]["value"] is None
    nowhere = replace(study, constraints=replace(study.constraints, floor=9.0))
    with pytest.raises(Infeasible, match="floor"):
        decide(nowhere, seed=0)


def test_a_plan_leaves_a_study_with_the_choices_made_that_gives_the_same_figures(tmp_path):
    path = choosing(tmp_path)
    made = run_plan(path, seed=1, out=tmp_path / "out")
    choices = made.content["choices"]
    assert made.content["chosen_study"] == "planned.toml"
    assert made.lines[0].startswith(f"chosen: tracker at {choices['station']} and markers ")
    chosen = tomllib.loads(made.tables["planned.toml"])
    assert set(chosen["markers"]) == {"M1", *choices["markers"]}
    assert [place["id"] for place in chosen["tracker_stations"]] == [choices["station"]]
    assert not {"markers", "stations"} & set(chosen["plan"])
    (tmp_path / "planned.toml").write_text(made.tables["planned.toml"])
    (tmp_path / "plan.csv").write_text(made.tables["plan.csv"])
    again = run_plan(tmp_path / "planned.toml", seed=1, out=tmp_path / "out")
    assert again.tables["plan.csv"] == made.tables["plan.csv"]
    assert again.content["choices"] is None
    for study_path in (path, tmp_path / "planned.toml"):
        judged = run_evaluate(study_path, tmp_path / "plan.csv", seed=1).content
        assert judged["criterion"]["value"] == pytest.approx(made.content["criterion"]["value"], rel=1e-9)
        assert judged["visits_rejected"] == {}
    read = run_simulate(tmp_path / "planned.toml", tmp_path / "plan.csv", None, seed=0).tables["measurements.csv"]
    assert {line.split(",")[2] for line in read.splitlines()[1:]} == set(chosen["markers"])


@pytest.mark.slow
def test_refined_poses_keep_every_constraint_of_the_cell(tmp_path):
    limits = {
        "clearance_mm": 30.0,
        "walls": [{"name": "back", "point_mm": [-900.0, 0, 0], "normal": [1.0, 0, 0]}],
        "boxes": [{"name": "rack", "centre_mm": [1500.0, 1500.0, 800.0], "size_mm": [700.0, 700.0, 1600.0]}],
        "visibility": {"acceptance_deg": 75.0},
    }
    changes = {
        "tracker_stations": STATIONS[:1], "noise": TRACKER, "constraints": limits,
        "marker_normals": {"M1": [1.0, 0.0, 0.0]}, "plan": {"candidates": 200, "poses": 6},
    }  # fmt: skip
    study = load_study(study_file(tmp_path, KR270, **changes))
    made = plan(study, seed=0)
    assert made.decision is None
    assert check(study, made.q, made.visit_loads).ok.all()
    assert made.final.value < 0.98 * made.grid.value
    free = plan(load_study(study_file(tmp_path, KR270, **{**changes, "constraints": {}})), seed=0)
    assert not check(study, free.q, free.visit_loads).ok.all(), "the constraints matter"


def test_two_arms_need_their_choices_made(tmp_path):
    arm = load_study(choosing(tmp_path))
    with pytest.raises(InputError, match="plan this arm alone first"):
        drawn(SimpleNamespace(arms=(SimpleNamespace(study=arm),)), 0, 0)


def test_a_single_named_station_is_no_choice(tmp_path):
    study = load_study(choosing(tmp_path, marker_choices=None, plan={"stations": ["far"], "markers": None}))
    np.testing.assert_allclose(study.station, [14.0, 1.0, 1.0])
    np.testing.assert_allclose(study.noise.tracker.station, [14.0, 1.0, 1.0])
    assert decide(study, seed=0) == (study, None)


def test_trying_options_warns_of_nothing(tmp_path, caplog):
    limits = {"visibility": {"min_range_mm": 9000.0}}
    study = load_study(
        choosing(tmp_path, constraints=limits, marker_choices=None, plan={"candidates": 60, "markers": None})
    )
    with caplog.at_level("WARNING", "elastocal"):
        decide(study, seed=0)
    assert not caplog.records
