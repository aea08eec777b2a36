"""Study and truth files: what is read, and that every mistake is named with its key."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identify.config import load_study
from identify.errors import InputError
from identify.schema import EFFECT_NAMES
from identify.truth import load_truth

ROBOT = """
name = "slider"
convention = "dh_standard"
source = "made up for the tests"
payload_kg = 10.0
[[joints]]
name = "j1"
d_mm = 500.0
lower_deg = -170.0
upper_deg = 170.0
[[joints]]
name = "j2"
type = "prismatic"
a_mm = 100.0
lower_mm = 0.0
upper_mm = 800.0
"""

BASE = {
    "robot": 'model = "robot.toml"',
    "markers": "M1 = [10.0, 20.0, 30.0]",
    "noise": "reading_mm = 0.03",
}


def write(folder, text="", name="study.toml", **tables):
    """A study file: the tables of BASE, some replaced or (None) left out, and more text."""
    (folder / "robot.toml").write_text(ROBOT)
    parts = [f"[{key}]\n{value}\n" for key, value in {**BASE, **tables}.items() if value is not None]
    path = folder / name
    path.write_text("".join(parts) + text)
    return path


def message(folder, text="", **tables):
    """The message of the error that such a file gives."""
    path = write(folder, text, **tables)
    with pytest.raises(InputError) as caught:
        load_study(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert caught.value.exit_code == 2
    return str(caught.value)


def test_a_small_study_gets_the_documented_defaults(tmp_path):
    study = load_study(write(tmp_path))
    assert [load.name for load in study.loads] == ["L0"]
    assert study.loads[0].unloaded
    assert (study.frame_free, study.markers_fitted, study.reference) == (True, True, "auto")
    assert study.effects == ("joint_compliance",)
    assert (study.plan.poses, study.plan.tolerance, study.plan.loads) == (15, None, ())
    assert study.plan.repeats
    assert study.constraints.self_collision
    assert study.inputs == (tmp_path / "study.toml", tmp_path / "robot.toml")
    np.testing.assert_allclose(study.markers.positions, [[0.01, 0.02, 0.03]])


def test_every_value_arrives_in_si(tmp_path):
    path = write(
        tmp_path,
        """
[fixed_markers]
F1 = [1000.0, 0.0, 0.0]
[tool]
mass_kg = 2.0
com_mm = [0.0, 0.0, 50.0]
[[loads]]
id = "L0"
[[loads]]
id = "L1"
mass_kg = 5.0
mass_std_kg = 0.01
attach_mm = [100.0, 0.0, -50.0]
attach_std_mm = 0.5
wrench = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
frame = "flange"
[frames]
measurement = "base"
markers = "exact"
[model]
effects = ["joint_compliance", "geometry@j2", "marker_seating@P006/M1"]
reference = "absolute"
[model.nominal]
"joint_compliance.j1" = 0.3
[model.transmission_error]
orders = [1, 2]
[[test_poses]]
joints_deg = [90.0, 400.0]
wrench = [0.0, 0.0, -100.0, 0.0, 0.0, 0.0]
attach_mm = [0.0, 0.0, 20.0]
weight = 2.0
[plan]
tolerance_mm = 0.15
confidence = 0.9
loads = ["L1"]
criterion = "D"
repeats = false
[constraints]
joint_margin_deg = 2.0
joint_margin_mm = 5.0
floor_mm = 100.0
payload_share = 0.9
self_collision = false
link_radius_mm = 60.0
""",
        robot='model = "robot.toml"\nmount_deg = [0.0, 180.0, 0.0]\ngravity_ms2 = 9.81',
        noise="pose_jitter_urad = 12.0\nreading_jitter_urad = 1.5\norientation_urad = 20.0\n[noise.tracker]\n"
        "radial_um = 5.0\nradial_um_per_m = 0.15\ntransverse_um = 7.5\ntransverse_um_per_m = 3.0\n"
        "station_mm = [3000.0, 0.0, 500.0]",
    )
    study = load_study(path)
    np.testing.assert_allclose(study.robot.gravity_base, [0, 0, 9.81], atol=1e-12)
    assert study.robot.tool_mass == 2.0
    np.testing.assert_allclose(study.robot.tool_centre, [0, 0, 0.05])
    load = study.loads[study.load_index("L1")]
    np.testing.assert_allclose(load.attach, [0.1, 0, -0.05])
    np.testing.assert_allclose([*load.force, *load.moment], [1, 2, 3, 4, 5, 6])
    assert (load.in_flange, load.mass_std, load.attach_std) == (True, 0.01, pytest.approx(5e-4))
    assert study.markers.names == ("M1", "F1")
    assert study.markers.on_base.tolist() == [False, True]
    assert (study.frame_free, study.markers_fitted) == (False, False)
    assert dict(study.nominal) == {"joint_compliance.j1": 0.3}
    assert study.options["transmission_error"]["orders"] == [1, 2]
    pose = study.test_poses[0]
    np.testing.assert_allclose(pose.q, [math.pi / 2, 0.4])
    np.testing.assert_allclose(pose.point, [0, 0, 0.02])  # the attach point by default
    assert (study.plan.poses, study.plan.tolerance, study.plan.loads) == (None, pytest.approx(1.5e-4), ("L1",))
    assert study.constraints.joint_margin == pytest.approx(math.radians(2))
    assert study.constraints.joint_margin_slide == pytest.approx(0.005)
    assert study.constraints.floor == pytest.approx(0.1)
    assert study.constraints.link_radius == pytest.approx(0.06)
    tracker = study.noise.tracker
    assert study.noise.pose_jitter == pytest.approx(12e-6)
    assert tracker.transverse_per_m == pytest.approx(3e-6)
    np.testing.assert_allclose(tracker.station, [3, 0, 0.5])


def test_a_path_may_be_a_text_and_a_shipped_robot_needs_no_path(tmp_path):
    assert load_study(str(write(tmp_path, robot='model = "ur10"'))).robot.n == 6


def test_an_unloaded_state_is_added_where_all_loads_are_loaded(tmp_path):
    study = load_study(write(tmp_path, '[[loads]]\nid = "L1"\nmass_kg = 5.0\n'))
    assert [load.name for load in study.loads] == ["L0", "L1"]
    assert study.plan.loads == ("L1",)


def test_dotted_names_without_quotes_are_names_too(tmp_path):
    study = load_study(write(tmp_path, "[model.nominal]\njoint_compliance.j1 = 0.3\ngeometry.j1.dx = 1\n"))
    assert dict(study.nominal) == {"joint_compliance.j1": 0.3, "geometry.j1.dx": 1.0}


def test_records_of_a_study_cannot_be_changed(tmp_path):
    study = load_study(write(tmp_path))
    with pytest.raises(TypeError):
        study.nominal["x"] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        study.markers.positions[0] = 0.0


L1 = '[[loads]]\nid = "L0"\n[[loads]]\nid = "L1"\nmass_kg = 5.0\n'

BAD = {
    "unknown key": ("[plan]\nposses = 3", ["[plan] posses = 3: unknown key (did you mean 'poses'?)", "tolerance_mm"]),
    "unknown table": ("[maker]\n", ["[maker]: unknown table (did you mean 'markers'?)"]),
    "unknown key of a load": (
        '[[loads]]\nid = "L0"\n[[loads]]\nid = "L1"\nmas_kg = 1',
        ["[[loads]] 2 mas_kg = 1: unknown key (did you mean 'mass_kg'?)"],
    ),
    "negative mass": ('[[loads]]\nid = "L1"\nmass_kg = -3.0', ["[[loads]] 1 mass_kg = -3.0: must be at least 0"]),
    "nan": ('[[loads]]\nid = "L1"\nmass_kg = nan', ["[[loads]] 1 mass_kg = nan: a finite number expected"]),
    "inf in a list": ("[fixed_markers]\nF1 = [0, inf, 0]", ["[fixed_markers] F1, entry 2 = inf: a finite number"]),
    "nan in options": ("[model.geometry]\nx = [nan]", ["[model.geometry] x, entry 1 = nan: a finite number"]),
    "nan nominal": ('[model.nominal]\n"a.b" = nan', ["[model.nominal] a.b = nan"]),
    "text for a number": ('[plan]\nposes = "15"', ["[plan] poses = '15': a whole number expected"]),
    "truth for a number": ('[[loads]]\nid = "L1"\nmass_kg = true', ["mass_kg = True: a number expected"]),
    "number for truth": ("[plan]\nrefine = 1", ["[plan] refine = 1: true or false expected"]),
    "short vector": ("[tool]\ncom_mm = [1, 2]", ["[tool] com_mm = [1, 2]: 3 numbers expected, 2 given"]),
    "long wrench": (
        "[[test_poses]]\njoints_deg = [0, 0]\nwrench = [0, 0, 0, 0, 0, 0, 0]",
        ["[[test_poses]] 1 wrench", "6 numbers expected, 7 given"],
    ),
    "same load twice": ('[[loads]]\nid = "A"\n[[loads]]\nid = "A"', ["[[loads]] 2 id = 'A': [[loads]] 1 has this id"]),
    "load id": ('[[loads]]\nid = "L 1"', ["[[loads]] 1 id = 'L 1': allowed are letters, digits"]),
    "load without id": ("[[loads]]\nmass_kg = 1", ["[[loads]] 1 id: is missing"]),
    "one load": ('[loads]\nid = "L1"', ["[loads]: a list of tables expected, each begins with [[loads]]"]),
    "same marker twice": ("[fixed_markers]\nM1 = [0, 0, 0]", ["[fixed_markers] M1: this id stands in [markers] too"]),
    "marker id": ('[fixed_markers]\n"F 1" = [0, 0, 0]', ["[fixed_markers] F 1", "letters, digits"]),
    "frame word": (
        '[frames]\nmeasurement = "fre"',
        ["[frames] measurement = 'fre': allowed: free, base (did you mean"],
    ),
    "criterion": ('[plan]\ncriterion = "test_poses"', ["allowed: test_pose, A, D, E, G (did you mean 'test_pose'?)"]),
    "reference": ('[model]\nreference = "difference"', ["allowed: absolute, differences, auto (did you mean 'differ"]),
    "zero poses": ("[plan]\nposes = 0", ["[plan] poses = 0: must be above 0"]),
    "negative poses": ("[plan]\nposes = -4", ["[plan] poses = -4: must be above 0"]),
    "poses and tolerance": ("[plan]\nposes = 9\ntolerance_mm = 0.1", ["[plan] poses = 9: give poses or tolerance_mm"]),
    "confidence": ("[plan]\nconfidence = 1.0", ["[plan] confidence = 1.0: must be below 1"]),
    "unknown load": (
        L1 + '[plan]\nloads = ["L2"]',
        ["[plan] loads, entry 1 = 'L2': unknown load (did you mean 'L1'?)"],
    ),
    "load twice": (L1 + '[plan]\nloads = ["L1", "L1"]', ["[plan] loads, entry 2 = 'L1': stands twice"]),
    "no loaded load": (L1 + '[plan]\nloads = ["L0"]', ["[plan] loads = ['L0']: no load among them", "loaded are: L1"]),
    "no loads": ("[plan]\nloads = []", ["[plan] loads = []: at least one entry expected"]),
    "more loads a pose than loads": (
        L1 + '[plan]\nloads = ["L1"]\nloads_per_pose = 2',
        ["[plan] loads_per_pose = 2: at most 1"],
    ),
    "above payload": (
        '[[loads]]\nid = "L1"\nmass_kg = 11.0',
        ["[[loads]] 1 mass_kg = 11.0: load above payload", "10 kg"],
    ),
    "above payload with tool": (
        '[tool]\nmass_kg = 6.0\n[[loads]]\nid = "L1"\nmass_kg = 5.0',
        ["load above payload with 6 kg of tool: at most 10 kg"],
    ),
    "tool above payload": ("[tool]\nmass_kg = 12.0", ["[tool] mass_kg = 12.0: load above payload: at most 10 kg"]),
    "above the share": (
        '[constraints]\npayload_share = 0.5\n[[loads]]\nid = "L1"\nmass_kg = 6.0',
        ["load above payload: at most 5 kg (0.5 of the rated payload 10 kg)"],
    ),
    "joint count": ("[[test_poses]]\njoints_deg = [0.0]", ["[[test_poses]] 1 joints_deg = [0.0]: 2 values expected"]),
    "joint limit": (
        "[[test_poses]]\njoints_deg = [0, 0]\n[[test_poses]]\njoints_deg = [171, 900]",
        [
            "[[test_poses]] 2 joints_deg, entry 1 = 171.0: outside the limits -170 to 170 deg of j1",
            "[[test_poses]] 2 joints_deg, entry 2 = 900.0: outside the limits 0 to 800 mm of j2",
        ],
    ),
    "zero weight": (
        "[[test_poses]]\njoints_deg = [0, 0]\nweight = 0.0",
        ["[[test_poses]] 1 weight = 0.0: must be above 0"],
    ),
    "margin": (
        "[constraints]\njoint_margin_deg = 170.0",
        ["[constraints] joint_margin_deg = 170.0: leaves no range", "j1"],
    ),
    "effect": (
        '[model]\neffects = ["geometri"]',
        ["[model] effects, entry 1 = 'geometri': unknown effect", "'geometry'?"],
    ),
    "effect place": ('[model]\neffects = ["geometry@"]', ["'geometry@': write name or name@where"]),
    "effect twice": (
        '[model]\neffects = ["geometry", "geometry"]',
        ["[model] effects, entry 2 = 'geometry': stands twice"],
    ),
    "options of nothing": ("[model.geomtry]\nx = 1", ["[model] geomtry: unknown key (did you mean 'geometry'?)"]),
    "options no table": ("[model]\nbacklash = 1", ["[model] backlash = 1: a table of options expected"]),
    "huge number": ('[[loads]]\nid = "L1"\nmass_kg = 1' + "0" * 400, ["mass_kg = 1000", "a number expected"]),
}


@pytest.mark.parametrize("case", BAD)
def test_each_mistake_is_named_with_its_key_its_value_and_what_is_allowed(case, tmp_path):
    text, parts = BAD[case]
    found = message(tmp_path, text)
    for part in parts:
        assert part in found


BAD_TABLES = {
    "no robot": ({"robot": None}, "[robot]: is missing"),
    "no model": ({"robot": ""}, "[robot] model: is missing"),
    "robot file": ({"robot": 'model = "none.urdf"'}, "[robot] model = 'none.urdf': robot file"),
    "mount": ({"robot": 'model = "robot.toml"\nmount_deg = [0, 0]'}, "[robot] mount_deg = [0, 0]: 3 numbers expected"),
    "gravity": (
        {"robot": 'model = "robot.toml"\ngravity_ms2 = -9.8'},
        "[robot] gravity_ms2 = -9.8: must be at least 0",
    ),
    "no markers": ({"markers": None}, "[markers]: is missing"),
    "empty markers": ({"markers": ""}, "[markers]: at least one marker expected"),
    "no noise": ({"noise": None}, "[noise]: is missing"),
    "empty noise": ({"noise": ""}, "[noise] reading_mm: is missing; give it, or the table [noise.tracker]"),
    "zero noise": ({"noise": "reading_mm = 0.0\npose_jitter_urad = 5.0"}, "[noise] reading_mm = 0.0: must be above 0"),
    "negative noise": ({"noise": "reading_mm = -1.0"}, "[noise] reading_mm = -1.0: must be at least 0"),
    "two instruments": (
        {"noise": "reading_mm = 0.1\n[noise.tracker]\nradial_um = 1\ntransverse_um = 1"},
        "[noise] reading_mm = 0.1: give reading_mm or the table [noise.tracker], not both",
    ),
    "zero tracker": (
        {"noise": "[noise.tracker]\nradial_um = 1"},
        "[noise.tracker] transverse_um = 0.0: this or its _per_m",
    ),
    "tracker key": (
        {"noise": "[noise.tracker]\nradial_mm = 1"},
        "[noise.tracker] radial_mm = 1: unknown key (did you mean 'radial_um'?)",
    ),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_each_missing_or_wrong_table_is_named(case, tmp_path):
    tables, part = BAD_TABLES[case]
    assert part in message(tmp_path, **tables)


def test_all_problems_of_a_file_come_together(tmp_path):
    text = '[plan]\nposes = 0\n[model]\nreference = "x"\neffects = ["geometri"]\n'
    text += "[[test_poses]]\njoints_deg = [0]\nweight = 0"
    found = message(tmp_path, text, noise="readings_mm = 1")
    assert found.splitlines()[0].endswith(": 6 problems")
    assert len(found.splitlines()) == 7


def test_a_syntax_error_is_given_with_its_line(tmp_path):
    assert "no TOML" in (found := message(tmp_path, "[plan]\nposes = = 3"))
    assert "line 8" in found


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"\xff\xfe[robot]", "byte 1 is no UTF-8 text"),
        (b"x = " + b"[" * 5000, "nested too deeply"),
        (b"x = 1" + b"0" * 5000, "a value cannot be read"),
        (b"[robot]\n[robot]", "no TOML"),
        (b" " * 10_000_001, "at most 10000000"),
    ],
)
def test_hostile_files_are_refused(content, part, tmp_path):
    path = tmp_path / "study.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=part):
        load_study(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        load_study(tmp_path / "none.toml")
    with pytest.raises(InputError, match="is no file"):
        load_study(tmp_path)


def test_a_message_does_not_grow_without_end(tmp_path):
    found = message(tmp_path, "[[loads]]\n" * 70)
    assert ": 70 problems" in found
    assert found.endswith("... and 20 more")


def test_byte_order_mark_and_crlf_are_fine(tmp_path):
    path = write(tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert load_study(path).noise.reading == pytest.approx(3e-5)


def test_a_study_without_rated_payload_takes_any_load(tmp_path):
    path = write(tmp_path, '[[loads]]\nid = "L1"\nmass_kg = 5000.0')
    (tmp_path / "robot.toml").write_text(ROBOT.replace("payload_kg = 10.0", ""))
    assert load_study(path).loads[1].mass == 5000.0


@given(st.text(max_size=200))
def test_no_text_makes_anything_but_a_study_or_an_input_error(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("fuzz") / "study.toml"
    path.write_text(text, encoding="utf-8", newline="")
    with pytest.raises(InputError):
        load_study(path)


json_like = st.recursive(
    st.one_of(st.booleans(), st.integers(-(10**20), 10**20), st.floats(), st.sampled_from(["", "L1", "geometry", "x"])),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["id", "M1", "poses", "x"]), inner, max_size=2)
    ),
    max_leaves=6,
)


@given(
    st.dictionaries(st.sampled_from([*BASE, "loads", "model", "plan", "test_poses", "tool", "constraints"]), json_like)
)
def test_no_values_make_anything_but_a_study_or_an_input_error(tmp_path_factory, data):
    import tomli_w

    path = tmp_path_factory.mktemp("fuzz") / "study.toml"
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    with pytest.raises(InputError):
        load_study(path)


def test_effect_names_are_those_of_the_contract_without_repetition():
    assert len(set(EFFECT_NAMES)) == len(EFFECT_NAMES) == 27


# ---- truth files


def truth(folder, text, study_text=""):
    study = load_study(write(folder, study_text))
    path = folder / "T.toml"
    path.write_text(text)
    return load_truth(path, study)


def test_an_empty_truth_is_the_study(tmp_path):
    found = truth(tmp_path, "")
    assert (found.effects, found.noise, dict(found.values), dict(found.options)) == (None, None, {}, {})
    assert found.path == Path(tmp_path / "T.toml")


def test_a_truth_states_effects_values_noise_and_options(tmp_path):
    text = """
[truth]
effects = ["joint_compliance", "backlash@j2"]
[truth.values]
"joint_compliance.j1" = 0.4
backlash.j2 = 80.0
[truth.backlash]
knots = 3
[noise]
reading_mm = 0.0
"""
    found = truth(tmp_path, text, "[model.backlash]\nknots = 2\nother = 1\n")
    assert found.effects == ("joint_compliance", "backlash@j2")
    assert dict(found.values) == {"joint_compliance.j1": 0.4, "backlash.j2": 80.0}
    assert dict(found.options["backlash"]) == {"knots": 3, "other": 1}
    assert found.noise.reading == 0.0


def test_noise_that_a_truth_does_not_state_is_that_of_the_study(tmp_path):
    found = truth(tmp_path, "[noise]\npose_jitter_urad = 7.0")
    assert (found.noise.reading, found.noise.pose_jitter) == (pytest.approx(3e-5), pytest.approx(7e-6))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[truths]\n", "[truths]: unknown table (did you mean 'truth'?)"),
        ("[truth]\nvalue = 1", "[truth] value: unknown key (did you mean 'values'?)"),
        (
            '[truth]\neffects = ["backlsh"]',
            "[truth] effects, entry 1 = 'backlsh': unknown effect (did you mean 'backlash'?)",
        ),
        ('[truth.values]\n"a.b" = nan', "[truth.values] a.b = nan: a finite number expected"),
        ('[truth.values]\n"a.b" = "1"', "[truth.values] a.b = '1': a number expected"),
        ("[noise]\nreading_mm = -1", "[noise] reading_mm = -1: must be at least 0"),
    ],
)
def test_mistakes_of_a_truth_are_named(text, part, tmp_path):
    with pytest.raises(InputError) as caught:
        truth(tmp_path, text)
    assert part in str(caught.value)
