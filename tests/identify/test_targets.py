"""Target files, the calibrated region, and the command compensate: from files to compensated.csv."""

import inspect
import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doe.cli import run
from identify import calibrated, compensation, inverse_kinematics, targets
from identify.arrays import frozen
from identify.calibrated import calibrated_region, check_region, region_json, region_of
from identify.config import load_study
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.kinematics import flange_poses, forward, jacobian
from identify.loads import LoadCase
from identify.model import model_of
from identify.results import json_text
from identify.summary import load_fitted
from identify.tables import plan_csv
from identify.targets import load_targets
from identify.tool_response import Targets, arm_of, tool_poses
from tests.identify.studies import (
    COMPLIANCE,
    LIGHT,
    ROOT,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    poses,
    random_robot,
    study_of,
    values_of,
)

STUDY = ROOT / "configs" / "studies" / "kr270.toml"
TRUTH = ROOT / "configs" / "truths" / "kr270.toml"
WRENCH = ["fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"]
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
HEADER = ["target", *JOINTS, *WRENCH, "frame", "attach_x_mm", "attach_y_mm", "attach_z_mm"]
ROWS = [
    ["drill-1", 0.0, -60.0, 90.0, 10.0, 45.0, 0.0, 0.0, 0.0, -1500.0, 0.0, 0.0, 0.0, "world", 300.0, 0.0, 0.0],
    ["drill-2", 30.0, -50.0, 70.0, 0.0, 60.0, 20.0, 0.0, 0.0, -1200.0, 0.0, 0.0, 0.0, "world", 300.0, 0.0, 0.0],
    ["drill-3", -40.0, -80.0, 110.0, -40.0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, "flange", 0.0, 0.0, 0.0],
]


def write(path, rows=ROWS, header=HEADER):
    path.write_text("\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n", encoding="utf-8")
    return path


def changed(row, **cells):
    """The rows with some cells of one of them changed."""
    rows = [list(given) for given in ROWS]
    for name, value in cells.items():
        rows[row][HEADER.index(name)] = value
    return rows


def numbers(path, names):
    header, *rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    return np.array([[float(row[header.index(name)]) for name in names] for row in rows])


@pytest.fixture(scope="module")
def study():
    return load_study(STUDY)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """identify.json of simulated readings of the demo's robot."""
    folder = tmp_path_factory.mktemp("fitted")
    study = load_study(STUDY)
    plan = folder / "plan.csv"
    plan.write_text(plan_csv(experiment_of(study, poses(study, 15, np.random.default_rng(7))), study), encoding="utf-8")
    assert run(["simulate", str(STUDY), str(plan), "--truth", str(TRUTH), "--out", str(folder / "sim"), "--quiet"]) == 0
    readings = str(folder / "sim" / "measurements.csv")
    assert run(["identify", str(STUDY), readings, "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out" / "identify.json"


def command(result, targets, out, *more):
    return run(["compensate", str(STUDY), str(result), str(targets), "--out", str(out), *more])


# ---- reading


def test_targets_are_read_in_si(study, tmp_path):
    found = load_targets(write(tmp_path / "targets.csv"), study)
    assert found.names == ("drill-1", "drill-2", "drill-3")
    np.testing.assert_allclose(found.q[1], np.radians([30.0, -50.0, 70.0, 0.0, 60.0, 20.0]))
    np.testing.assert_array_equal(found.wrench[0], [0, 0, -1500, 0, 0, 0])
    np.testing.assert_array_equal(found.in_flange, [False, False, True])
    np.testing.assert_allclose(found.attach[:, 0], [0.3, 0.3, 0.0])


def test_frame_and_attach_point_are_optional_and_unknown_columns_only_warn(study, tmp_path, caplog):
    rows = [[*row[:13], 5] for row in ROWS]
    path = write(tmp_path / "targets.csv", rows, [*HEADER[:13], "speed"])
    with caplog.at_level(logging.WARNING, logger="elastocal"):
        found = load_targets(path, study)
    assert not found.in_flange.any()
    assert not found.attach.any()
    assert "unknown columns ignored: speed" in caplog.text


def test_sliding_joints_are_in_mm(tmp_path):
    robot = random_robot(np.random.default_rng(1), (False, True))
    path = write(tmp_path / "targets.csv", [["a", 30.0, 250.0, *[0.0] * 6]], ["target", "q1_deg", "q2_mm", *WRENCH])
    np.testing.assert_allclose(load_targets(path, study_of(robot)).q, [[np.pi / 6, 0.25]])


@pytest.mark.parametrize(("rows", "message"), [
    (changed(1, target="drill-1"), r"line 3, target = 'drill-1': stands in line 2 too"),
    (changed(1, target="drill 2"), r"line 3, target = 'drill 2': an id expected"),
    (changed(1, frame="tool"), r"line 3, frame = 'tool': unknown frame in 1 row.*allowed are: world, flange"),
    (changed(0, fz_N="nan"), r"line 2, fz_N = 'nan': a finite number"),
    (changed(0, fz_N=""), r"line 2, fz_N = '': is empty"),
    (changed(0, fz_N=1e300), r"line 2, fz_N = 1e\+300: at most 1e\+06 N or Nm expected; are the units wrong"),
    (changed(2, attach_x_mm=2e5), r"line 4, attach_x_mm = 200000.0: at most 100000 mm expected"),
    (changed(1, q2_deg=-150.0), r"line 3, q2_deg = -150.0: target drill-2 is outside the joint limits: allowed are"),
])  # fmt: skip
def test_what_is_wrong_with_a_target_is_named_with_line_and_value(study, tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        load_targets(write(tmp_path / "targets.csv", rows), study)


def test_targets_in_radians_are_refused_as_a_whole(study, tmp_path):
    rows = [[f"T{i}", *np.radians(row[1:7]) + 0.01 * i, *row[7:]] for i, row in enumerate(ROWS * 3)]
    with pytest.raises(InputError, match="whole file"):
        load_targets(write(tmp_path / "targets.csv", rows), study)


@pytest.mark.parametrize(("rows", "header", "message"), [
    ([], HEADER, "no rows below the header"),
    (ROWS, ["target", *JOINTS, "fx", *HEADER[8:]], "missing column fx_N"),
    (ROWS, [*HEADER[:-1], "attach_z"], "missing column attach_z_mm"),
])  # fmt: skip
def test_files_that_are_no_targets_are_refused(study, tmp_path, rows, header, message):
    with pytest.raises(InputError, match=message):
        load_targets(write(tmp_path / "targets.csv", rows, header), study)


# ---- the calibrated region


def test_the_region_holds_what_was_measured_on_every_joint():
    study = kr270_study(loads=(UNLOADED, WEIGHT, LIGHT, SIDE), mount=(0.2, 0.1, 0.0))
    q = poses(study, 8, np.random.default_rng(3))
    found = calibrated_region(study.robot, experiment_of(study, q))
    np.testing.assert_array_equal(found.lower, q.min(axis=0))
    np.testing.assert_array_equal(found.upper, q.max(axis=0))
    frames, torque, moments = forward(study.robot, q), [np.zeros(6)], []
    for load in study.loads:
        turn = frames.flange_rotation if load.in_flange else study.robot.world_R_base.T
        force = turn @ load.force + load.mass * study.robot.gravity_base
        torque += list(
            np.einsum("vij,vi->vj", jacobian(frames, frames.point(load.attach))[:, :3], force * np.ones((8, 3)))
        )
        moments += list(np.linalg.norm(np.cross(frames.flange_rotation @ load.attach, force), axis=1))
    np.testing.assert_allclose(found.load_lower, np.min(torque, axis=0), atol=1e-9)
    np.testing.assert_allclose(found.load_upper, np.max(torque, axis=0), atol=1e-9)
    assert found.force == pytest.approx(250.0 * 9.80665)
    assert found.moment == pytest.approx(max(moments))


def test_a_region_comes_back_from_its_file():
    robot = random_robot(np.random.default_rng(1), (False, True, False))
    study = study_of(robot)
    region = calibrated_region(robot, experiment_of(study, poses(study, 4, np.random.default_rng(0))))
    content = json.loads(json_text({"calibrated": region_json(region, robot)}))["calibrated"]
    assert {"joint", "lower_mm", "upper_mm", "lower_N", "upper_N"} == set(content["joints"][1])
    for key, value in vars(region_of(content, robot)).items():
        np.testing.assert_allclose(value, getattr(region, key), rtol=1e-12)
    with pytest.raises(ValueError, match="3 joints, the robot has 6"):
        region_of(content, kr270_study().robot)


def targets_at(q, force=(0.0, 0.0, -1000.0)):
    count = len(q)
    wrench = np.tile([*force, 0.0, 0.0, 0.0], (count, 1))
    names = tuple(f"T{i}" for i in range(count))
    return Targets(names, q, wrench, np.zeros(count, dtype=bool), np.tile(WEIGHT.attach, (count, 1)))


def test_a_tenth_of_the_range_beyond_is_still_inside():
    study = kr270_study(loads=(UNLOADED, WEIGHT))
    q = poses(study, 12, np.random.default_rng(3))
    region = calibrated_region(study.robot, experiment_of(study, q))
    assert not check_region(region, study.robot, targets_at(q)).outside.any()
    width = region.upper - region.lower
    inside, outside = (
        np.tile(q[:1], (6, 1)) + np.diag(region.upper + share * width - q[0]) for share in (0.099, 0.101)
    )
    weak = (0.0, 0.0, -1.0)
    assert not check_region(region, study.robot, targets_at(inside, weak)).outside.any()
    check = check_region(region, study.robot, targets_at(outside, weak))
    assert check.outside.all()
    assert check.words(2).startswith("joint 3 is ")


def test_a_side_force_turns_a_joint_that_no_load_has_turned():
    study = kr270_study(loads=(UNLOADED, WEIGHT))
    q = poses(study, 12, np.random.default_rng(3))
    region = calibrated_region(study.robot, experiment_of(study, q))
    sideways = np.array([-np.sin(q[0, 0]), -np.cos(q[0, 0]), 0.0])  # joint 1 turns about -z
    check = check_region(region, study.robot, targets_at(q[:1], 300.0 * sideways))
    assert check.outside.all()
    assert "torque of the load on joint 1 is" in check.words(0)
    assert "calibrated are" in check.words(0)


def test_rounded_axes_of_a_robot_file_do_not_count_as_torque():
    study = kr270_study(loads=(UNLOADED, WEIGHT))
    tilted = replace(study.robot, placements=study.robot.placements @ np.eye(4))
    turned = tilted.placements.copy()
    turned[0, :3, :3] = turned[0, :3, :3] @ [[1, 0, 1e-7], [0, 1, 0], [-1e-7, 0, 1]]
    q = poses(study, 6, np.random.default_rng(3))
    region = calibrated_region(study.robot, experiment_of(study, q))
    assert not check_region(region, replace(tilted, placements=frozen(turned)), targets_at(q)).outside.any()


def test_forces_and_moments_beyond_the_largest_are_outside():
    study = kr270_study(loads=(UNLOADED, LoadCase("L1", mass=20.0)))
    q = poses(study, 12, np.random.default_rng(3))
    region = calibrated_region(study.robot, full_experiment(q, np.tile([0, 1], (12, 1)), study.loads, study.markers))
    assert region.moment == 0.0
    targets = replace(targets_at(q[:2]), attach=np.array([[0.0, 0, 0], [0.3, 0.0, 0.0]]), wrench=np.zeros((2, 6)))
    targets = targets.under(np.array([[0.0, 0, -216.0, 0, 0, 0], [0.0, 0, -10.0, 0, 0, 0]]))
    check = check_region(region, study.robot, targets)
    force, moment = check.exceeds[:, -2], check.exceeds[:, -1]
    assert force.tolist() == [True, False]
    assert moment.tolist() == [False, True]


# ---- the command


def test_the_command_writes_commands_that_stand_where_they_are_meant(study, fitted, tmp_path, capsys):
    path = write(tmp_path / "targets.csv")
    assert command(fitted, path, tmp_path / "out") == 0
    out = capsys.readouterr().out
    assert "3 targets, joint form" in out
    assert "self-weight is not taken back" in out
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["compensate.json", "compensated.csv"]
    table = tmp_path / "out" / "compensated.csv"
    assert table.read_text(encoding="utf-8").splitlines()[0] == (
        "target,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz,"
        "residual_mm,residual_ci95_mm,deflection_mm,extrapolated"
    )
    q = np.radians(numbers(table, JOINTS))
    pose = flange_poses(study.robot, q)
    np.testing.assert_allclose(numbers(table, ["x_mm", "y_mm", "z_mm"]), 1e3 * pose[:, :3, 3], atol=2e-4)
    turns = Rotation.from_quat(numbers(table, ["qx", "qy", "qz", "qw"])).as_matrix()
    np.testing.assert_allclose(turns, pose[:, :3, :3], atol=3e-6)

    targets = load_targets(path, study)
    model = model_of(study)
    truth = arm_of(model, values_of(model, {**COMPLIANCE, "joint_compliance.j4": 2.7}))
    wished = flange_poses(study.robot, targets.q)
    points = [(p[:, :3, 3] + (p[:, :3, :3] @ targets.attach[..., None])[..., 0]) for p in
              (wished, tool_poses(truth, targets), tool_poses(truth, targets.at(q)))]  # fmt: skip
    before, after = (np.linalg.norm(point - points[0], axis=1) for point in points[1:])
    deflection, residual, radius = numbers(table, ["deflection_mm", "residual_mm", "residual_ci95_mm"]).T
    np.testing.assert_allclose(deflection, 1e3 * before, rtol=0.1, atol=1e-6)
    assert residual.max() < 1e-3
    assert (1e3 * after < 2.0 * radius + 1e-3).all()
    assert after[:2].max() < 0.1 * before[:2].min()
    assert radius[2] == 0.0  # nothing acts on the third


def test_the_summary_agrees_with_the_table(fitted, tmp_path):
    assert command(fitted, write(tmp_path / "targets.csv"), tmp_path / "out", "--form", "mirror", "--quiet") == 0
    content = json.loads((tmp_path / "out" / "compensate.json").read_text(encoding="utf-8"))
    table = numbers(tmp_path / "out" / "compensated.csv", ["deflection_mm", "residual_mm", "residual_ci95_mm"])
    assert content["schema"] == 1
    assert content["targets"] == 3
    assert content["form"] == "mirror"
    assert 1 <= content["passes"] <= 10
    for key, column in zip(("deflection", "residual", "residual_ci95"), table.T, strict=True):
        assert content[key]["rms_mm"] == pytest.approx(np.sqrt((column**2).mean()), abs=1e-6)
        assert content[key]["max_mm"] == pytest.approx(column.max(), abs=1e-6)
    assert content["removed_percent"] > 99.9
    assert content["extrapolated"] == []
    assert set(content["provenance"]["inputs"]) == {"kr270.toml", "kr270_r2700.toml", "identify.json", "targets.csv"}


def test_one_pass_is_less_than_all(fitted, tmp_path):
    path = write(tmp_path / "targets.csv")
    rms = []
    for passes in ("1", "10"):
        assert command(fitted, path, tmp_path / passes, "--form", "mirror", "--passes", passes, "--quiet") == 0
        rms.append(json.loads((tmp_path / passes / "compensate.json").read_text())["residual"]["rms_mm"])
    assert 1e-5 < rms[0] < 0.05
    assert rms[1] < 1e-3 * rms[0]


def test_targets_outside_the_calibrated_region_need_a_word(fitted, tmp_path, capsys):
    path = write(tmp_path / "targets.csv", changed(1, fy_N=900.0, frame="flange"))
    assert command(fitted, path, tmp_path / "out") == 3
    told = capsys.readouterr().err
    assert "targets.csv: target drill-2: torque of the load on joint 1 is" in told
    assert "--extrapolate" in told
    assert not (tmp_path / "out").exists()
    assert command(fitted, path, tmp_path / "out", "--extrapolate") == 0
    told = capsys.readouterr().out
    assert "outside the calibrated region: drill-2" in told
    assert "not identified, held at nominal: joint_compliance.j1 (0 urad/Nm)" in told
    assert numbers(tmp_path / "out" / "compensated.csv", ["extrapolated"])[:, 0].tolist() == [0, 1, 0]
    content = json.loads((tmp_path / "out" / "compensate.json").read_text(encoding="utf-8"))
    assert content["extrapolated"] == ["drill-2"]


def test_an_older_result_is_used_with_a_note(fitted, tmp_path, capsys):
    content = json.loads(fitted.read_text(encoding="utf-8"))
    del content["calibrated"]
    old = tmp_path / "identify.json"
    old.write_text(json.dumps(content), encoding="utf-8")
    path = write(tmp_path / "targets.csv", changed(1, fy_N=900.0))
    assert command(old, path, tmp_path / "out") == 0
    assert "does not say which poses and loads were measured" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [{"joints": []}, {}, None, {"joints": 3}])
def test_a_broken_region_is_no_result(fitted, tmp_path, wrong):
    content = {**json.loads(fitted.read_text(encoding="utf-8")), "calibrated": wrong}
    path = tmp_path / "identify.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match="no result of identify or diagnose"):
        load_fitted(path, load_study(STUDY))


def test_a_result_says_where_it_was_calibrated(fitted, study):
    content = json.loads(fitted.read_text(encoding="utf-8"))["calibrated"]
    assert [joint["joint"] for joint in content["joints"]] == [f"j{i}" for i in range(1, 7)]
    assert content["force_N"] == pytest.approx(250.0 * study.robot.gravity)
    first = content["joints"][0]
    assert -150 <= first["lower_deg"] < first["upper_deg"] <= 150
    assert abs(first["lower_Nm"]) < 1e-6
    assert abs(first["upper_Nm"]) < 1e-6
    assert content["joints"][1]["upper_Nm"] > 1000.0


@pytest.mark.parametrize(("rows", "code"), [(changed(0, frame="tool"), 2), (changed(1, q2_deg=-150.0), 2), ([], 2)])
def test_bad_targets_exit_2_and_write_nothing(fitted, tmp_path, capsys, rows, code):
    assert command(fitted, write(tmp_path / "targets.csv", rows), tmp_path / "out") == code
    caught = capsys.readouterr()
    assert caught.out == ""
    assert caught.err.startswith("error: ")
    assert "targets.csv" in caught.err
    assert not (tmp_path / "out").exists()


def test_a_target_that_cannot_be_reached_exits_3(fitted, tmp_path, capsys):
    rows = changed(0, q2_deg=-140.0, q3_deg=0.0, fz_N=1500.0)
    code = command(fitted, write(tmp_path / "targets.csv", rows), tmp_path / "out", "--extrapolate")
    assert code == 3
    assert "target drill-1: joint 2 would be commanded to -140." in capsys.readouterr().err


def test_what_a_pose_cannot_take_back_is_told(fitted, tmp_path, capsys):
    """The study with a foot that tilts, and an arm stretched out: nothing moves it further along itself."""
    content = json.loads(fitted.read_text(encoding="utf-8"))
    del content["calibrated"]
    content |= {"effects": ["joint_compliance", "base_compliance@base"], "options": {}, "covariance": [[0.0]]}
    content["parameters"] = [{"name": "base_compliance.base.ry", "value": 1.0}]
    path = tmp_path / "identify.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    stretched = float(np.degrees(-np.arctan2(41.0, 1200.0)))  # the wrist is in line with axes 2 and 3
    rows = changed(0, q1_deg=0.0, q2_deg=-80.0, q3_deg=stretched, q4_deg=0.0, q5_deg=45.0, fx_N=-500.0)
    assert command(path, write(tmp_path / "targets.csv", rows), tmp_path / "out") == 0
    assert "a part of the deflection is not taken back at drill-1 (see residual_mm)" in capsys.readouterr().out


def test_the_same_input_gives_the_same_bytes(fitted, tmp_path):
    path = write(tmp_path / "targets.csv")
    for name in "ab":
        assert command(fitted, path, tmp_path / name, "--quiet") == 0
    for file in ("compensate.json", "compensated.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


# ---- what the pages say


def test_every_key_and_column_is_documented(fitted, tmp_path):
    assert command(fitted, write(tmp_path / "targets.csv"), tmp_path / "out", "--quiet") == 0
    formats = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    told = json.loads((tmp_path / "out" / "compensate.json").read_text(encoding="utf-8"))
    section = formats[formats.index("**Compensation**") : formats.index("**Diagnosis**")]
    assert not [key for key in set(told) - {"schema", "provenance"} if f"`{key}`" not in section]
    region = json.loads(fitted.read_text(encoding="utf-8"))["calibrated"]
    section = formats[formats.index("**Calibrated region**") : formats.index("**Compensation**")]
    assert not [key for key in {*region, *region["joints"][0]} if f"`{key}`" not in section]
    section = " ".join(formats[formats.index("**Targets**") : formats.index("## Results")].split())
    header = (tmp_path / "out" / "compensated.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    for column in {*header, *HEADER} - {f"q{i}_deg" for i in range(2, 7)}:
        assert column in section


def test_limits_on_the_pages_are_those_of_the_code():
    formats, theory = (" ".join((ROOT / "docs" / name).read_text(encoding="utf-8").split())
                       for name in ("formats.md", "theory.md"))  # fmt: skip
    assert f"outside the calibrated region by more than {100 * calibrated.BEYOND:g} % of the range" in formats
    assert f"process wrench on the flange, at most {targets._LARGEST['wrench']:g}".replace("e+0", "e") in formats
    assert f"would have to move by more than {compensation._STEP:g} rad (m)" in theory
    assert f"1 rad counts as {1e3 * inverse_kinematics._LEVER:g} mm there" in theory
    assert f"A command further than {compensation._FAR:g} rad (m) from its target is refused" in theory
    default = inspect.signature(compensation.compensate).parameters["passes"].default
    assert f"repeated, at most {default} times" in formats
