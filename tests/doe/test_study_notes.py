"""Studies that are allowed but can hardly be meant, and words that count."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doe.commands import run_evaluate, run_plan
from doe.guard import _few
from doe.purse import Purse
from doe.study_notes import study_notes
from identify.cell import Station
from identify.loads import Markers
from identify.units import counted
from tests.doe.cell_cases import cell
from tests.doe.study_files import ARM, study_file


def scaled(made, factor):
    placements = np.array(made.robot.placements)
    placements[:, :3, 3] *= factor
    return replace(made, robot=replace(made.robot, placements=placements))


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (1e-3, True), (1e3, True)])
def test_a_robot_in_the_wrong_unit_is_told(factor, told):
    notes = study_notes(scaled(cell(), factor))
    assert any("reaches" in note and "usual are 20 to 20000" in note for note in notes) is told
    assert len(notes) == told


@pytest.mark.parametrize(("spread", "told"), [(0.0, True), (0.9e-3, True), (1.1e-3, False)])
def test_reflectors_in_one_place_are_told(spread, told):
    positions = np.array([[0.1, 0.0, 0.0], [0.1, spread, 0.0], [2.0, 0.0, 0.0]])
    markers = Markers(("A", "B", "base"), positions, np.array([False, False, True]))
    notes = study_notes(replace(cell(), markers=markers))
    assert [note for note in notes if "all 2 markers on the flange" in note] == list(notes)
    assert len(notes) == told


def test_a_tracker_below_the_floor_is_told_with_its_depth():
    stations = (Station("high", np.array([3.0, 0.0, 0.6])), Station("low", np.array([3.0, 0.0, -0.3])))
    made = replace(cell(floor=-0.05), stations=stations)
    assert study_notes(made) == ("tracker station low stands 250 mm below the floor ([constraints] floor_mm)",)
    hung = replace(cell(floor=-0.05, mount=(np.pi, 0.0, 0.0)), stations=stations)
    assert [note.split()[2] for note in study_notes(hung)] == ["high"]


def test_work_that_loads_nothing_stands_in_the_notes_of_plan_and_evaluate(tmp_path):
    weightless = {"test_poses": [{"joints_deg": [0, 0, 0], "wrench": [0, 0, -1e-9, 0, 0, 0]}]}
    file = study_file(tmp_path, ARM, plan={"candidates": 40, "poses": 3, "refine": False, "curve": False}, **weightless)
    made = run_plan(file, seed=0, out=tmp_path)
    (tmp_path / "plan.csv").write_text(made.tables["plan.csv"])
    judged = run_evaluate(file, tmp_path / "plan.csv", seed=0)
    for content in (made.content, judged.content):
        assert any("hardly turn the joints" in note for note in content["notes"])
    usual = study_file(tmp_path, ARM, plan={"candidates": 40, "poses": 3, "refine": False, "curve": False})
    assert json.dumps(run_plan(usual, seed=0, out=tmp_path).content["notes"]).count("hardly") == 0


def test_one_of_something_is_singular():
    assert (counted(1, "pose"), counted(2, "pose"), counted(0, "pose")) == ("1 pose", "2 poses", "0 poses")
    purse = Purse("cost_budget", 3.0, 3.0, np.ones(1))
    assert (_few(1, None), _few(4, None)) == ("1 pose is too few", "4 poses are too few")
    assert _few(None, purse) == "the poses that cost_budget = 3 pays for are too few"
