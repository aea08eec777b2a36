"""The cell through the command line: what is refused with which exit code, and that the shipped cell runs."""

import json
from pathlib import Path

import numpy as np
import pytest

from doe import design_choices, moves, refine
from doe.candidates import candidates
from doe.cli import run
from doe.design_choices import decide
from doe.feasible import REASONS, check
from identify.cell_sections import (
    BoxSection,
    ConstraintsSection,
    PayloadDiagramSection,
    StationSection,
    VisibilitySection,
    WallSection,
)
from identify.config import load_study
from identify.tables import load_plan
from tests.doe.study_files import KR270, study_file

ROOT = Path(__file__).parents[2]
BOX = {"name": "rack", "centre_mm": [1500.0, 1500.0, 800.0], "size_mm": [700.0, 700.0, 1600.0]}
WALL = {"name": "back", "point_mm": [-900.0, 0, 0], "normal": [1.0, 0, 0]}
STATION = {"id": "S1", "position_mm": [4000.0, 1000.0, 1000.0]}
SEES = {"tracker_stations": [STATION], "constraints": {"visibility": {}}}


def limits(**constraints):
    return {"constraints": constraints}


BAD = {
    "negative size": (
        limits(boxes=[{**BOX, "size_mm": [700.0, -7.0, 1600.0]}]),
        ["[[constraints.boxes]] 1 size_mm, entry 2 = -7.0: must be above 0"],
    ),
    "unknown key of a box": (
        limits(boxes=[BOX, {**BOX, "name": "b", "rpy": [0, 0, 0]}]),
        ["[[constraints.boxes]] 2 rpy = [0, 0, 0]: unknown key (did you mean 'rpy_deg'?)"],
    ),
    "two boxes of one name": (limits(boxes=[BOX, BOX]), ["[[constraints.boxes]] 2 name = 'rack'", "has this name"]),
    "wall without direction": (
        limits(walls=[{**WALL, "normal": [0.0, 0, 0]}]),
        ["[[constraints.walls]] 1 normal: a direction other than zero expected"],
    ),
    "negative clearance": (limits(clearance_mm=-1.0), ["[constraints] clearance_mm = -1.0: must be at least 0"]),
    "negative load size": (
        {"loads": [{"id": "L0"}, {"id": "L1", "mass_kg": 100.0, "size_mm": [1.0, 1.0, -1.0], "hang_mm": -2.0}]},
        ["[[loads]] 2 size_mm, entry 3 = -1.0: must be above 0", "[[loads]] 2 hang_mm = -2.0: must be at least 0"],
    ),
    "home outside": (
        limits(home_deg=[0.0, 20.0, 0.0, 0.0, 0.0, 0.0]),
        ["[constraints] home_deg, entry 2 = 20.0: outside -138 to -7, the limits of A2 less the margin"],
    ),
    "home of another robot": (limits(home_deg=[0.0]), ["[constraints] home_deg = [0.0]: 6 values expected"]),
    "home in a box": (
        limits(home_deg=[0.0, -90.0, 90.0, 0.0, 0.0, 0.0], boxes=[{**BOX, "centre_mm": [1500.0, 0.0, 1800.0]}]),
        ["[constraints] home_deg: the arm cannot stand there, boxes is broken by"],
    ),
    "diagram": (
        limits(payload_diagram={"distance_mm": [0.0, 300.0, 200.0], "mass_kg": [100.0, 200.0]}),
        ["one mass a distance expected", "ascending distances expected", "must not rise"],
    ),
    "torques without masses": (
        limits(torque_share=1.0),
        ["[constraints] torque_share = 1.0: the robot file states no link masses"],
    ),
    "wrist moments": (limits(wrist_moment_Nm=[1.0, 2.0]), ["[constraints] wrist_moment_Nm", "3 numbers expected"]),
    "ranges that contradict": (
        {**SEES, "constraints": {"visibility": {"min_range_mm": 3000.0, "max_range_mm": 2000.0}}},
        ["[constraints.visibility] min_range_mm = 3000.0: must be below max_range_mm = 2000"],
    ),
    "no station": (limits(visibility={}), ["[constraints.visibility]: the tracker stands nowhere"]),
    "cone without directions": (
        {**SEES, "constraints": {"visibility": {"acceptance_deg": 30.0}}},
        ["[constraints.visibility] acceptance_deg = 30.0: no marker has a direction"],
    ),
    "more seen than mounted": (
        {**SEES, "constraints": {"visibility": {"required": 4}}},
        ["[constraints.visibility] required = 4: at most 3"],
    ),
    "direction of no marker": ({"marker_normals": {"M9": [1.0, 0, 0]}}, ["[marker_normals] M9: unknown marker"]),
    "station that is none": (
        {**SEES, "plan": {"stations": ["S1", "S2"]}},
        ["[plan] stations, entry 2 = 'S2': unknown station (did you mean 'S1'?)"],
    ),
    "two stations of one id": ({"tracker_stations": [STATION, STATION]}, ["[[tracker_stations]] 2 id = 'S1'"]),
    "tracker in a box": (
        {**SEES, "constraints": {"boxes": [{**BOX, "centre_mm": [4000.0, 1000.0, 1000.0]}]}},
        ["[[tracker_stations]] 1 position_mm: the tracker stands inside box rack"],
    ),
    "tracker behind a wall": (
        {**SEES, "constraints": {"walls": [{**WALL, "normal": [-1.0, 0, 0]}]}},
        ["[[tracker_stations]] 1 position_mm: the tracker stands behind wall back"],
    ),
    "tracker in the robot": (
        {**SEES, "tracker_stations": [{**STATION, "position_mm": [0.0, 0.0, 300.0]}]},
        ["[[tracker_stations]] S1: the tracker stands inside the robot (base..A1)"],
    ),
    "station twice": (
        {
            "tracker_stations": [STATION],
            "noise": {
                "reading_mm": None,
                "tracker": {"radial_um": 5.0, "transverse_um": 5.0, "station_mm": [4000.0, 0.0, 1000.0]},
            },
        },
        ["[noise.tracker] station_mm", "give it or [[tracker_stations]], not both"],
    ),
    "choices without a number": (
        {"marker_choices": {"C1": [1.0, 2.0, 3.0]}},
        ["[plan] markers: is missing: how many of the 1 [marker_choices]"],
    ),
    "number without choices": ({"plan": {"markers": 2}}, ["[plan] markers = 2: there are no [marker_choices]"]),
    "too many": (
        {"marker_choices": {"C1": [1.0, 2.0, 3.0]}, "plan": {"markers": 2}},
        ["[plan] markers = 2: at most 1"],
    ),
    "choice that is mounted": (
        {"marker_choices": {"M1": [1.0, 2.0, 3.0]}, "plan": {"markers": 1}},
        ["[marker_choices] M1: this id stands in [markers] too"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_each_wrong_word_about_the_cell_is_named_and_exits_2(case, tmp_path, capsys):
    changes, parts = BAD[case]
    path = study_file(tmp_path, KR270, **changes)
    assert run(["plan", str(path), "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    for part in (*parts, "study.toml"):
        assert part in shown
    assert not (tmp_path / "out").exists()


def test_all_problems_of_a_cell_come_together(tmp_path, capsys):
    changes = {
        "tracker_stations": [STATION],
        "marker_normals": {"M9": [0.0, 0, 0]},
        "constraints": {
            "boxes": [{**BOX, "size_mm": [0.0, 1.0, 1.0]}],
            "clearance_mm": -5.0,
            "visibility": {"min_range_mm": 2.0, "max_range_mm": 1.0},
        },
    }
    assert run(["plan", str(study_file(tmp_path, KR270, **changes)), "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    for key in ("size_mm, entry 1", "clearance_mm", "[marker_normals] M9"):
        assert key in shown


NOTHING_LEFT = {
    "box around the arm": (limits(boxes=[{**BOX, "centre_mm": [0.0, 0.0, 1500.0], "size_mm": [5000.0] * 3}]), "boxes"),
    "wall through the arm": (limits(walls=[{**WALL, "point_mm": [4000.0, 0.0, 0.0]}]), "walls"),
    "weight too deep": (
        {"loads": [{"id": "L0"}, {"id": "L1", "mass_kg": 100.0, "hang_mm": 5000.0}]},
        "floor",
    ),
    "load outside the diagram": (
        limits(payload_diagram={"distance_mm": [0.0, 100.0], "mass_kg": [270.0, 260.0]}),
        "payload",
    ),
    "moment": (limits(wrist_moment_Nm=[0.1, 0.1, 0.1]), "torque"),
    "tracker too far": ({**SEES, "constraints": {"visibility": {"max_range_mm": 500.0}}}, "tracker_range"),
    "reflectors that look away": (
        {
            "tracker_stations": [STATION],
            "marker_normals": {"M1": [1.0, 0, 0], "M2": [-1.0, 0, 0]},
            "constraints": {"visibility": {"acceptance_deg": 30.0}},
        },
        "reflector_angle",
    ),
    "screen before the tracker": (
        {
            **SEES,
            "constraints": {
                "visibility": {},
                "boxes": [{**BOX, "centre_mm": [3900.0, 1000.0, 1000.0], "size_mm": [20.0, 9000.0, 9000.0]}],
            },
        },
        "line_of_sight",
    ),
}


@pytest.mark.parametrize("case", NOTHING_LEFT)
def test_a_cell_that_leaves_nothing_names_the_constraint_and_exits_3(case, tmp_path, capsys):
    changes, reason = NOTHING_LEFT[case]
    path = study_file(tmp_path, KR270, **{**changes, "plan": {"candidates": 20}})
    assert run(["plan", str(path), "--out", str(tmp_path / "out")]) == 3
    shown = capsys.readouterr().err
    assert f"{reason} rejected" in shown
    culprit = shown.split("Each constraint on its own: ")[1]
    assert culprit.startswith(f"without {reason} alone") or f"{reason} alone forbids" in culprit
    assert not (tmp_path / "out").exists()


def test_two_constraints_that_contradict_each_other_are_both_counted(tmp_path, capsys):
    """In front of the plane and behind it."""
    walls = [
        WALL | {"point_mm": [100.0, 0, 0]},
        WALL | {"name": "front", "point_mm": [90.0, 0, 0], "normal": [-1.0, 0, 0]},
    ]
    changes = {"constraints": {"walls": walls}, "plan": {"candidates": 20}}
    assert run(["plan", str(study_file(tmp_path, KR270, **changes)), "--out", str(tmp_path / "out")]) == 3
    assert "without walls alone" in capsys.readouterr().err


def test_the_shipped_cell_has_plenty_of_candidates_and_its_plan_keeps_to_it(tmp_path, capsys):
    text = (ROOT / "configs" / "studies" / "kr270_cell.toml").read_text(encoding="utf-8")
    text = (
        text
        .replace("../robots/", f"{ROOT.as_posix()}/configs/robots/")
        .replace("= 10000\n", "= 400\n")
        .replace("poses = 15", "poses = 7")
    )
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    assert run(["plan", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "chosen: tracker at" in printed
    assert "poses rejected: " in printed
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert tuple(told["rejected"]) == REASONS
    assert {option["station"] for option in told["choices"]["tried"]} == {"front", "side"}
    assert told["efficiency"] > 0.9
    assert (told["refinement"]["gained_percent"] > 0.0) != any("not refined" in note for note in told["notes"])
    study, decision = decide(load_study(path), seed=0)
    assert decision.best.station == told["choices"]["station"]
    found = candidates(study, seed=0)
    assert len(found) > 390
    assert set(found.visit_loads[:, 1]) == {1, 2, 3}
    experiment = load_plan(tmp_path / "out" / "plan.csv", study)
    visits = experiment.q.reshape(7, 2, 6)
    np.testing.assert_array_equal(visits[:, 0], visits[:, 1])
    names = [line.split(",")[1] for line in (tmp_path / "out" / "plan.csv").read_text().splitlines()[1:]]
    loads = np.array([study.load_index(name) for name in names]).reshape(7, 2)
    assert check(study, visits[:, 0], loads).ok.all()


def test_evaluate_counts_given_visits_that_break_the_cell(tmp_path, capsys):
    rows = [f"P{i},{load},{20 * i},{-60 - i},{90 + 3 * i},{10 * i},{40 - 5 * i},{15 * i}"
            for i in range(8) for load in ("L0", "L1")]  # fmt: skip
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(["pose,load,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", *rows]) + "\n")
    walls = [WALL | {"point_mm": [0.0, -300.0, 0], "normal": [0.0, 1.0, 0]}]
    path = study_file(tmp_path, KR270, constraints={"walls": walls}, plan={"candidates": 60})
    assert run(["evaluate", str(path), str(poses), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    told = json.loads((tmp_path / "out" / "evaluate.json").read_text())
    assert 0 < told["visits_rejected"]["walls"] <= 8
    assert "given visits that break a constraint of the study: " in capsys.readouterr().out


def test_every_key_and_limit_of_the_cell_is_documented():
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    words = " ".join(text.split())
    sections = (BoxSection, WallSection, PayloadDiagramSection, VisibilitySection, ConstraintsSection, StationSection)
    keys = {key for section in sections for key in section.model_fields} - {"boxes", "walls"}
    keys -= {"payload_diagram", "visibility"}  # tables of their own
    assert not [key for key in sorted(keys | {"size_mm", "hang_mm", "stations", "markers"}) if f"`{key}`" not in text]
    for table in ("[[constraints.boxes]]", "[[constraints.walls]]", "[constraints.visibility]", "[marker_choices]"):
        assert f"`{table}`" in text
    assert ", ".join(f"`{reason}`" for reason in REASONS) in words
    assert f"on up to {design_choices._CANDIDATES} candidates of its own" in words
    assert f"with more than {design_choices._TRIED} options the markers are exchanged" in words
    theory = " ".join((ROOT / "docs" / "theory.md").read_text(encoding="utf-8").split())
    assert f"Parts of less than {1000 * moves.STEP:g} mm (or the clearance) are not halved" in theory
    assert len(refine._RADII) == 5, "the solver starts again up to four times"


def test_what_a_plan_says_about_its_choice_is_documented(tmp_path):
    changes = {
        "tracker_stations": [STATION, {**STATION, "id": "S2"}],
        "plan": {"candidates": 60, "poses": 6, "refine": False},
    }
    assert run(["plan", str(study_file(tmp_path, KR270, **changes)), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    told = json.loads((tmp_path / "out" / "plan.json").read_text())["choices"]
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    section = text[text.index("**The choice in a plan**") : text.index("**Prediction**")]
    assert not [key for key in {*told, *told["tried"][0]} if f"`{key}`" not in section]
