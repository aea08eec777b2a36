"""Plans and measurements: what is read, what is refused, and that files come back as they were."""

import contextlib
import logging
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identify.alignment import inverse
from identify.arrays import frozen
from identify.csv_file import csv_text, read_csv, write_csv
from identify.errors import InputError
from identify.experiment import Measurements, full_experiment
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.study import Noise, Study
from identify.tables import (
    joint_columns,
    load_measurements,
    load_plan,
    measurements_csv,
    plan_csv,
    plan_experiment,
    predicted_csv,
)
from identify.transforms import roll_pitch_yaw


def make_robot(slide=False, limits=True):
    """An arm of three turning joints, or with a slide in front; reach about 2.5 m."""
    placements = np.tile(np.eye(4), (4, 1, 1))
    placements[0, 2, 3] = 0.5
    placements[1, :3, :3] = roll_pitch_yaw([np.pi / 2, 0, 0])
    placements[2, 0, 3], placements[3, 0, 3] = 1.0, 0.8
    bound = np.radians([170.0, 120.0, 150.0])
    if slide:
        bound[0] = 1.0
    if not limits:
        bound = np.full(3, np.inf)
    return Robot(
        name="arm",
        joints=("j1", "j2", "j3"),
        prismatic=np.array([slide, False, False]),
        placements=placements,
        lower=-bound,
        upper=bound,
        masses=np.full(3, np.nan),
        centres=np.full((3, 3), np.nan),
        efforts=np.full(3, np.nan),
    )


def make_study(frame_free=True, **robot):
    return Study(
        path="study.toml",
        robot=make_robot(**robot),
        loads=(LoadCase("L0"), LoadCase("L1", mass=50.0, attach=frozen([0.1, 0, 0])), LoadCase("L2", mass=80.0)),
        markers=Markers(
            ("M1", "M2", "F1"), np.array([[0.1, 0, 0.05], [0, 0.2, 0], [2.0, 1.0, 0]]), [False, False, True]
        ),
        noise=Noise(reading=3e-5),
        frame_free=frame_free,
    )


STUDY = make_study()
FRAME = np.eye(4)
FRAME[:3, :3] = roll_pitch_yaw([0.3, -0.2, 1.1])
FRAME[:3, 3] = [3.0, -1.0, 0.5]


def make_data(study=STUDY, poses=8, seed=0, scale_q=1.0, scale=1.0):
    """Readings of the rigid robot, all markers under L0 and L1; optionally in other units."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(study.robot.lower, -2.0), np.minimum(study.robot.upper, 2.0)
    q = rng.uniform(lower, upper, (poses, 3))
    e = full_experiment(q, np.tile([0, 1], (poses, 1)), study.loads, study.markers)
    frames = forward(study.robot, q[e.shot_pose[e.row_shot]])
    local = study.markers.positions[e.row_marker]
    points = np.where(study.markers.on_base[e.row_marker, None], local, frames.point(local))
    if study.frame_free:
        back = inverse(FRAME)
        points = points @ back[:3, :3].T + back[:3, 3]
    points = points + rng.normal(scale=1e-4, size=points.shape)
    e = replace(e, q=np.where(study.robot.prismatic, q, q * scale_q))
    return Measurements(e, points * scale, np.arange(len(points)) + 2)


def save(tmp_path, text, name="m.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(tmp_path, text, study=STUDY, load=load_measurements):
    path = save(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load(path, study)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def edit(text, line, column, value):
    """The text with one cell changed; the header is line 1."""
    rows = [row.split(",") for row in text.splitlines()]
    rows[line - 1][rows[0].index(column)] = value
    return "\n".join(",".join(row) for row in rows) + "\n"


def add_columns(text, names, values):
    """The text with more columns, the same values in every row."""
    head, *rows = text.splitlines()
    return "\n".join([f"{head},{names}", *(f"{row},{values}" for row in rows)]) + "\n"


TEXT = measurements_csv(make_data(), STUDY)


def same(a, b):
    """True if two sets of measurements are equal but for lines and source."""
    ea, eb = a.experiment, b.experiment
    keys = ("q", "shot_visit", "shot_pose", "shot_load", "shot_repeat", "row_shot", "row_marker")
    optional = ("wrench", "approach", "time", "temperature")
    equal = ea.visits == eb.visits and all(np.array_equal(getattr(ea, key), getattr(eb, key)) for key in keys)
    for key in optional:
        x, y = getattr(ea, key), getattr(eb, key)
        equal = equal and ((x is None) == (y is None)) and (x is None or np.array_equal(x, y))
    return equal and np.array_equal(a.positions, b.positions)


# ---- measurements


@pytest.mark.parametrize(
    "study", [STUDY, make_study(slide=True), make_study(frame_free=False), make_study(limits=False)]
)
def test_measurements_come_back_as_they_were_written(study, tmp_path):
    data = make_data(study)
    found = load_measurements(save(tmp_path, measurements_csv(data, study)), study)
    e = found.experiment
    assert e.visits == data.experiment.visits
    np.testing.assert_allclose(e.q, data.experiment.q, atol=1e-8)
    np.testing.assert_allclose(found.positions, data.positions, atol=5.1e-10)
    assert e.shot_load.tolist() == data.experiment.shot_load.tolist()
    assert e.row_marker.tolist() == data.experiment.row_marker.tolist()
    assert found.lines.tolist() == list(range(2, 2 + len(found.lines)))
    assert measurements_csv(found, study) == measurements_csv(data, study)


def test_columns_of_a_slide_are_in_mm():
    assert joint_columns(make_study(slide=True)) == ["q1_mm", "q2_deg", "q3_deg"]


def test_optional_columns_come_back_as_they_were_written(tmp_path):
    data = make_data()
    e, rng = data.experiment, np.random.default_rng(1)
    rows, shots = len(e.row_shot), len(e.shot_visit)
    wrench = np.where(e.shot_load[:, None] == 0, 0.0, np.round(rng.normal(size=(shots, 6)), 6))
    quaternion = rng.normal(size=(rows, 4))
    quaternion[:, 0] = abs(quaternion[:, 0])
    quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
    e = replace(
        e,
        wrench=wrench,
        approach=rng.integers(-1, 2, (len(e.visits), 3)),
        time=np.arange(rows) * 2.5,
        temperature=np.full(rows, 21.5),
    )
    data = replace(data, experiment=e, quaternions=quaternion)
    found = load_measurements(save(tmp_path, measurements_csv(data, STUDY)), STUDY)
    for key in ("wrench", "approach", "time", "temperature"):
        np.testing.assert_allclose(getattr(found.experiment, key), getattr(e, key), atol=1e-12)
    np.testing.assert_allclose(found.quaternions, quaternion, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(found.quaternions, axis=1), 1.0, atol=1e-15)
    assert found.experiment.shot_unloaded.sum() == 8


@given(st.randoms(use_true_random=False))
def test_the_order_of_the_rows_does_not_matter(tmp_path_factory, random):
    folder = tmp_path_factory.mktemp("order")
    text = edit(TEXT, 9, "q2_deg", "11.0")  # one row of a pose states another value
    head, *rows = text.splitlines()
    random.shuffle(rows)
    shuffled = "\n".join([head, *rows]) + "\n"
    before = load_measurements(save(folder, text, "a.csv"), STUDY)
    after = load_measurements(save(folder, shuffled, "b.csv"), STUDY)
    assert same(before, after)
    assert [rows[line - 2] for line in after.lines] == [text.splitlines()[line - 1] for line in before.lines]


def test_the_order_of_the_columns_does_not_matter(tmp_path):
    turned = "\n".join(",".join(reversed(row.split(","))) for row in TEXT.splitlines())
    assert same(
        load_measurements(save(tmp_path, turned), STUDY), load_measurements(save(tmp_path, TEXT, "b.csv"), STUDY)
    )


def test_byte_order_mark_crlf_blanks_and_empty_rows_are_fine(tmp_path):
    text = TEXT.replace(",M1,", ", M1 ,").replace("\n", "\r\n") + "\r\n,,,,,,,,,\r\n"
    found = load_measurements(save(tmp_path, b"\xef\xbb\xbf" + text.encode()), STUDY)
    assert same(found, load_measurements(save(tmp_path, TEXT, "b.csv"), STUDY))


def test_a_row_of_a_pose_with_another_joint_value_gets_a_pose_of_its_own(tmp_path):
    found = load_measurements(save(tmp_path, edit(TEXT, 3, "q1_deg", "12.5")), STUDY)
    e = found.experiment
    assert len(e.visits) == 8
    assert len(e.q) == 9
    row = found.lines.tolist().index(3)
    assert np.degrees(e.q[e.shot_pose[e.row_shot[row]], 0]) == pytest.approx(12.5)
    assert e.row_visit[row] == 0
    assert len(e.shot_visit) == 17


def test_missing_readings_are_allowed(tmp_path):
    rows = TEXT.splitlines()
    found = load_measurements(save(tmp_path, "\n".join(rows[:5] + rows[9:])), STUDY)
    assert len(found.lines) == len(rows) - 5


def test_unknown_columns_are_ignored_with_a_warning(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="elastocal"):
        found = load_measurements(save(tmp_path, add_columns(TEXT, "comment,q4_deg", '"a, b",1')), STUDY)
    assert found.ignored_columns == ("comment", "q4_deg")
    assert "unknown columns ignored: comment, q4_deg" in caplog.text


def test_identical_copies_of_a_row_are_used_once_and_this_is_said(tmp_path, caplog):
    rows = TEXT.splitlines()
    with caplog.at_level(logging.WARNING, logger="elastocal"):
        found = load_measurements(save(tmp_path, "\n".join([*rows, rows[3], rows[3]])), STUDY)
    assert len(found.lines) == len(rows) - 1
    assert "2 rows stand there twice and are used once: lines 50, 51" in caplog.text


def test_contradicting_copies_are_refused_with_both_lines(tmp_path):
    rows = TEXT.splitlines()
    found = refused(tmp_path, edit("\n".join([*rows, rows[3]]), 50, "x_mm", "1.0"))
    assert "lines 4 and 50: the same pose, load, marker, repeat (P001, L0, F1, 1) with different numbers" in found
    assert "lines 4 and 50" in refused(tmp_path, edit("\n".join([*rows, rows[3]]), 50, "q1_deg", "1.0"))


BAD_CELLS = [
    ("x_mm", "nan", "line 7, x_mm = 'nan': a finite number"),
    ("y_mm", "inf", "line 7, y_mm = 'inf': a finite number"),
    ("z_mm", "", "line 7, z_mm = '': is empty; leave the whole row out"),
    ("q2_deg", "1,5", "line 7, q2_deg"),
    ("q2_deg", "abc", "line 7, q2_deg = 'abc': a finite number"),
    ("q2_deg", "1_0", "line 7, q2_deg = '1_0': a finite number"),
    ("q2_deg", "٣", "line 7, q2_deg"),
    ("repeat", "1.5", "line 7, repeat = '1.5': a whole number"),
    ("repeat", "-1", "line 7, repeat = '-1': a whole number"),
    ("load", "L9", "line 7, load = 'L9': unknown load in 1 row (did you mean 'L2'?); the study has: L0, L1, L2"),
    ("marker", "m1", "line 7, marker = 'm1': unknown marker in 1 row (did you mean 'M1'?); the study has: M1, M2, F1"),
    ("pose", "P 1", "line 7, pose = 'P 1': an id expected"),
    ("pose", "", "line 7, pose = '': an id expected"),
]


@pytest.mark.parametrize(("column", "value", "part"), BAD_CELLS)
def test_a_cell_that_cannot_be_read_is_named_with_line_and_value(column, value, part, tmp_path):
    cell = f'"{value}"' if "," in value else value
    assert part in refused(tmp_path, edit(TEXT, 7, column, cell))


def test_problems_of_a_table_come_together_and_long_lists_are_cut(tmp_path):
    text = edit(TEXT, 5, "load", "L7")
    for line in range(2, 12):
        text = edit(text, line, "x_mm", "none")
    found = refused(tmp_path, text)
    assert "7 problems" in found
    assert "x_mm: 5 more rows of the same kind" in found
    assert "line 5, load = 'L7'" in found


@pytest.mark.parametrize("column", TEXT.splitlines()[0].split(","))
def test_every_missing_column_is_named(column, tmp_path):
    text = TEXT.replace(column, column + "_old", 1)
    assert f"line 1: missing column {column} (did you mean '{column}_old'?)" in refused(tmp_path, text)


def test_a_table_with_semicolons_is_told_about_commas(tmp_path):
    assert "the separator must be a comma" in refused(tmp_path, TEXT.replace(",", ";"))


@pytest.mark.parametrize(
    ("names", "values", "part"),
    [
        ("fx_N", "0", "missing columns fy_N"),
        ("qw,qx,qy", "1,0,0", "missing column qz"),
        ("approach1", "1", "missing columns approach2"),
        ("approach1,approach2,approach3", "1,0,2", "line 2, approach3 = '2': allowed: -1, 0, 1"),
        ("qw,qx,qy,qz", "1,0.1,0,0", "line 2, qw, qx, qy, qz: length 1.00499, must be 1 within 0.001 (in 48 rows)"),
        ("time_s", "nan", "line 2, time_s = 'nan'"),
        (
            "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm",
            "0,0,1,0,0,0",
            "rows of the unloaded state L0 must hold zeros (in 24 rows)",
        ),
    ],
)
def test_optional_columns_are_checked(names, values, part, tmp_path):
    assert part in refused(tmp_path, add_columns(TEXT, names, values))


def test_quaternions_are_normalised_and_have_one_sign(tmp_path):
    found = load_measurements(save(tmp_path, add_columns(TEXT, "qw,qx,qy,qz", "-0.6004,0.8,0,0")), STUDY)
    np.testing.assert_allclose(found.quaternions[0], np.array([0.6004, -0.8, 0, 0]) / np.hypot(0.6004, 0.8))


def test_differing_approaches_of_a_pose_are_settled_by_the_majority(tmp_path, caplog):
    text = edit(add_columns(TEXT, "approach1,approach2,approach3", "1,0,-1"), 4, "approach1", "-1")
    with caplog.at_level(logging.WARNING, logger="elastocal"):
        found = load_measurements(save(tmp_path, text), STUDY)
    np.testing.assert_array_equal(found.experiment.approach, np.tile([1, 0, -1], (8, 1)))
    assert "different approaches" in caplog.text
    assert "P001" in caplog.text


def test_a_load_without_a_stated_mass_may_carry_measured_wrenches(tmp_path):
    study = replace(STUDY, loads=(LoadCase("L0"), LoadCase("L1", attach=frozen([0.1, 0, 0]))))
    head, *rows = TEXT.splitlines()
    rows = [row + (",0,0,0,0,0,0" if ",L0," in row else ",0,0,-50,0,0,0") for row in rows]
    text = "\n".join([f"{head},fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm", *rows])
    assert load_measurements(save(tmp_path, text), study).experiment.shot_unloaded.sum() == 8


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "the file is empty"),
        (TEXT.splitlines()[0].encode(), "no rows below the header"),
        (TEXT.encode("utf-16"), "no UTF-8 text"),
        (TEXT.encode() + b"P1,L0\n", "line 50: 2 cells, the header has 10"),
        (TEXT.replace("x_mm", "y_mm").encode(), "line 1: column y_mm stands twice"),
        (TEXT.encode() + b'"P1" x,L0\n', "line 50: no CSV"),
        (TEXT.encode() + b"P1," + b"x" * 200_000, "line 50: no CSV: field larger"),
    ],
)
def test_files_that_are_no_table_are_refused(content, part, tmp_path):
    assert part in refused(tmp_path, content)


def test_lines_count_line_breaks_inside_quotes(tmp_path):
    head, first, second, *rest = add_columns(TEXT, "comment", "x").splitlines()
    text = "\n".join([
        head,
        first[:-1] + '"two\nlines"',
        edit(head + "\n" + second, 2, "x_mm", "?").splitlines()[1],
        *rest,
    ])
    assert "line 4, x_mm = '?'" in refused(tmp_path, text)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        load_measurements(tmp_path / "none.csv", STUDY)
    with pytest.raises(InputError, match="is no file"):
        load_measurements(tmp_path, STUDY)


def test_columns_without_a_name_are_ignored_and_named_by_their_place(tmp_path, caplog):
    assert load_measurements(save(tmp_path, add_columns(TEXT, ",", ",")), STUDY).ignored_columns == ()
    assert load_measurements(save(tmp_path, add_columns(TEXT, "", "x")), STUDY).ignored_columns == ("column 11",)


@given(st.binary(max_size=300))
def test_no_bytes_make_anything_but_an_input_error(tmp_path_factory, content):
    path = save(tmp_path_factory.mktemp("fuzz"), content)
    for load in (load_measurements, load_plan):
        with pytest.raises(InputError):
            load(path, STUDY)


@given(st.integers(2, 49), st.sampled_from(TEXT.splitlines()[0].split(",")), st.text(max_size=8))
def test_no_cell_makes_anything_but_data_or_an_input_error(tmp_path_factory, line, column, value):
    quoted = '"' + value.replace('"', '""') + '"'
    path = save(tmp_path_factory.mktemp("fuzz"), edit(TEXT, line, column, quoted).encode("utf-8", "replace"))
    for load in (load_measurements, load_plan):
        with contextlib.suppress(InputError):
            load(path, STUDY)


# ---- wrong units of a whole file

UNITS = [
    ({"scale": 1e-3}, "positions look like m, x_mm, y_mm, z_mm must be in mm"),
    ({"scale": 1e-1}, "positions look like cm"),
    ({"scale": 1 / 25.4}, "positions look like inch"),
    ({"scale": 1e3}, "positions look like um"),
    ({"scale_q": np.pi / 180}, "q columns look like rad, they must be in deg"),
    ({"scale_q": np.pi / 180, "scale": 1e-3}, "q columns look like rad and positions like m"),
    ({"scale_q": 180 / np.pi}, "converted from rad once too often"),
]


@pytest.mark.parametrize(("units", "part"), UNITS)
@pytest.mark.parametrize("frame_free", [True, False])
def test_wrong_units_of_a_whole_file_are_named(units, part, frame_free, tmp_path):
    study = make_study(frame_free=frame_free)
    found = refused(tmp_path, measurements_csv(make_data(study, **units), study), study)
    assert "whole file: " in found
    assert part in found


def test_wrong_units_are_found_in_a_robot_without_limits(tmp_path):
    study = make_study(limits=False)
    assert "rad" in refused(tmp_path, measurements_csv(make_data(study, scale_q=np.pi / 180), study), study)
    assert "outside the limits" in refused(
        tmp_path, measurements_csv(make_data(study, scale_q=180 / np.pi), study), study
    )


def test_readings_of_another_frame_are_no_readings_of_the_base_frame(tmp_path):
    study = make_study(frame_free=False)
    data = make_data(study)
    text = measurements_csv(replace(data, positions=data.positions + 10.0), study)
    assert "32 of 48 positions are out of reach: x_mm, y_mm, z_mm must be in mm, in the base" in refused(
        tmp_path, text, study
    )


def test_limits_are_named_when_most_rows_are_outside(tmp_path):
    text = TEXT
    for line in range(2, 30):
        text = edit(text, line, "q2_deg", "130.0")
    found = refused(tmp_path, text)
    assert (
        "whole file: 28 of 48 rows have joint values outside the limits, most often q2_deg (limits -120 to 120" in found
    )


@given(st.integers(0, 10**6))
def test_less_than_half_of_wild_rows_is_no_bad_input(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    data = make_data(poses=10)
    positions = np.array(data.positions)
    wild = rng.choice(len(positions), 20, replace=False)
    positions[wild] *= rng.choice([1e-3, 1e3, -1.0, 25.4], 20)[:, None]
    path = save(tmp_path_factory.mktemp("wild"), measurements_csv(replace(data, positions=positions), STUDY))
    assert len(load_measurements(path, STUDY).lines) == len(positions)


@pytest.mark.parametrize("poses", [1, 2, 8])
@pytest.mark.parametrize("frame_free", [True, False])
def test_small_motions_in_the_right_units_are_accepted(poses, frame_free, tmp_path):
    study = make_study(frame_free=frame_free)
    data = make_data(study, poses=poses)
    e = replace(data.experiment, q=data.experiment.q * 0.02)
    frames = forward(study.robot, e.q[e.shot_pose[e.row_shot]])
    local = study.markers.positions[e.row_marker]
    points = np.where(study.markers.on_base[e.row_marker, None], local, frames.point(local))
    data = replace(data, experiment=e, positions=points)
    assert len(load_measurements(save(tmp_path, measurements_csv(data, study)), study).lines) == 6 * poses


def test_many_rows_are_read_alike(tmp_path):
    data = make_data(poses=4000)
    text = measurements_csv(data, STUDY)
    found = load_measurements(save(tmp_path, text), STUDY)
    assert len(found.lines) == 24_000
    assert measurements_csv(found, STUDY) == text


# ---- plans

PLAN = """pose,load,q1_deg,q2_deg,q3_deg
B,L0,10,20,30
B,L1,10,20,30
B,L0,10,20,30
A,L0,-10,50,-30
A,L2,-10,50,-30
C,L1,100,5,60
"""


def test_a_plan_keeps_its_order_and_counts_repeated_readings(tmp_path):
    plan = load_plan(save(tmp_path, PLAN), STUDY)
    assert plan.visits == ("B", "A", "C")
    assert plan.row_visit.tolist() == [0, 0, 0, 1, 1, 2]
    assert plan.row_load.tolist() == [0, 1, 0, 0, 2, 1]
    assert plan.row_repeat.tolist() == [1, 1, 2, 1, 1, 1]
    np.testing.assert_allclose(np.degrees(plan.q[3]), [-10, 50, -30])


def test_a_plan_becomes_an_experiment_with_all_markers(tmp_path):
    e = plan_experiment(load_plan(save(tmp_path, PLAN), STUDY), STUDY)
    assert e.row_shot.tolist() == np.repeat(np.arange(6), 3).tolist()
    assert e.row_marker.tolist() == [0, 1, 2] * 6
    assert e.shot_pose.tolist() == [0, 0, 0, 1, 1, 2]
    np.testing.assert_allclose(np.degrees(e.q[:, 0]), [10, -10, 100])


def test_rows_of_a_pose_are_put_together(tmp_path):
    rows = PLAN.splitlines()
    plan = load_plan(save(tmp_path, "\n".join([*rows[:2], *rows[4:], *rows[2:4]])), STUDY)
    assert plan.row_visit.tolist() == [0, 0, 0, 1, 1, 2]
    assert plan.lines.tolist() == [2, 6, 7, 3, 4, 5]


def test_a_plan_comes_back_as_it_was_written(tmp_path):
    for study in (STUDY, make_study(slide=True)):
        e = make_data(study).experiment
        text = plan_csv(e, study)
        again = plan_experiment(load_plan(save(tmp_path, text), study), study)
        np.testing.assert_allclose(again.q, e.q, atol=1e-8)
        assert again.visits == e.visits
        assert again.row_marker.tolist() == e.row_marker.tolist()
        assert plan_csv(again, study) == text


def test_a_plan_may_carry_the_conditions_of_measurements(tmp_path):
    names = "time_s,temperature_C,approach1,approach2,approach3,fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm"
    text = add_columns(PLAN, names, "5,21,1,0,-1,0,0,0,0,0,0")
    e = plan_experiment(load_plan(save(tmp_path, text), STUDY), STUDY)
    assert e.time.tolist() == [5.0] * 18
    assert e.temperature.tolist() == [21.0] * 18
    assert e.approach.tolist() == [[1, 0, -1]] * 3
    assert e.wrench.shape == (6, 6)


def test_a_measurement_file_is_a_plan_too(tmp_path, caplog):
    plan = load_plan(save(tmp_path, TEXT), STUDY)
    data = make_data()
    assert len(plan.lines) == len(data.experiment.shot_visit)
    assert plan.ignored_columns == ("x_mm", "y_mm", "z_mm")
    np.testing.assert_allclose(plan.q, data.experiment.q[data.experiment.shot_pose], atol=1e-8)
    without = "\n".join(",".join(c for i, c in enumerate(row.split(",")) if i != 3) for row in TEXT.splitlines())
    assert load_plan(save(tmp_path, without), STUDY).lines.tolist() == plan.lines.tolist()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (PLAN.replace("q3_deg", "q3"), "missing column q3_deg (did you mean 'q3'?)"),
        (PLAN.replace("L2", "L5"), "line 6, load = 'L5': unknown load"),
        (PLAN.replace("100,5,60", "nan,5,60"), "line 7, q1_deg = 'nan'"),
        (
            PLAN.replace("20,30", "200,30").replace("50,-30", "500,30"),
            "5 of 6 rows have joint values outside the limits",
        ),
        (
            add_columns(PLAN, "repeat", "1").replace("B,L0,10", "B,L0,11", 1),
            "lines 2 and 4: the same pose, load, repeat",
        ),
    ],
)
def test_mistakes_of_a_plan_are_named(text, part, tmp_path):
    assert part in refused(tmp_path, text, load=load_plan)


def test_a_plan_in_radians_is_refused(tmp_path):
    e = make_data(poses=10, scale_q=np.pi / 180).experiment
    found = refused(tmp_path, plan_csv(e, STUDY), load=load_plan)
    assert "they look like rad, q columns are in deg" in found


def test_single_poses_outside_the_limits_stay_in_a_plan(tmp_path):
    assert len(load_plan(save(tmp_path, PLAN.replace("C,L1,100", "C,L1,1000")), STUDY).lines) == 6


# ---- writing


def test_predictions_are_written_in_mm(tmp_path):
    e = plan_experiment(load_plan(save(tmp_path, PLAN), STUDY), STUDY)
    points = np.arange(54.0).reshape(18, 3)
    lines = predicted_csv(e, points, points * 1e-6).splitlines()
    assert lines[0] == "pose,load,marker,x_mm,y_mm,z_mm,sx_mm,sy_mm,sz_mm"
    assert lines[2] == "B,L0,M2,3000.000000,4000.000000,5000.000000,0.003000,0.004000,0.005000"


def test_the_same_table_gives_the_same_bytes_with_lf_and_no_minus_zero(tmp_path):
    text = csv_text(["a", "b"], [["x", "y"], np.array([-1e-9, 2.0])])
    assert text == "a,b\nx,0.000000\ny,2.000000\n"
    write_csv(tmp_path / "t.csv", ["a", "b"], [["x", "y"], np.array([-1e-9, 2.0])])
    assert (tmp_path / "t.csv").read_bytes() == text.encode()


def test_numbers_that_are_not_finite_are_not_written():
    with pytest.raises(InputError, match="column b: nan or inf"):
        csv_text(["b"], [np.array([1.0, np.nan])])


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_written_numbers_come_back_within_half_the_last_digit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    write_csv(path, ["id", "x"], [[f"r{i}" for i in range(len(values))], np.array(values)])
    back = [float(cell) for cell in read_csv(path).cells["x"]]
    np.testing.assert_allclose(back, values, rtol=0, atol=0.51e-6)
