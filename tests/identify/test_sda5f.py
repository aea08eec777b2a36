"""The shipped studies of the SDA5F: 5 kg, a 6-D target, and what compensation takes back on a twin with known truth."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe.cli import run
from identify.compensation import compensate
from identify.config import load_study
from identify.dual_quaternions.correction import corrected, pose_error
from identify.error_map import error_map, hung_weight, spread_poses
from identify.identification import identify
from identify.kinematics import flange_poses
from identify.model import model_of
from identify.rotations import pose_errors, quaternions
from identify.simulate import default_placement, simulate
from identify.tables import load_plan, plan_experiment
from identify.targets import load_targets
from identify.tool_response import arm_of, tool_poses
from identify.truth import load_truth

CONFIGS = Path(__file__).parents[2] / "configs"
ARMS = ("r1", "r2")
IDENTIFIED = {f"joint_compliance.j{joint}" for joint in range(2, 8)}


def files(arm):
    studies = CONFIGS / "studies"
    return [studies / f"sda5f_{arm}{rest}" for rest in (".toml", "_poses.csv", "_targets.csv")]


def twin(arm):
    """The study, the true arm, and readings of the measured poses by a seed."""
    study_file, poses, targets = files(arm)
    study = load_study(study_file)
    true = load_truth(CONFIGS / "truths" / f"sda5f_{arm}.toml", study).values
    model = model_of(study)
    values = np.array([true.get(name, nominal) for name, nominal in zip(model.names, model.nominal, strict=True)])
    experiment = plan_experiment(load_plan(poses, study), study)

    def read(seed):
        placement = default_placement(study.noise, frame_free=True)
        return simulate(model, values, experiment, study.noise, placement, np.random.default_rng(seed))

    plain = model_of(replace(study, frame_free=False, markers_fitted=False))
    return study, arm_of(plain, np.array([true[name] for name in plain.names])), read, load_targets(targets, study)


def left_over(real, targets, q):
    """Rms of the true position and turn of the flange against the wished pose, at the targets and at ``q``."""
    wished = flange_poses(real.model.robot, targets.q)
    errors = [pose_errors(tool_poses(real, targets.at(joints)), wished) for joints in (targets.q, q)]
    return [(np.linalg.norm(e[:, :3]), np.linalg.norm(e[:, 3:])) for e in errors]


@pytest.mark.parametrize("arm", ARMS)
def test_known_compliances_take_back_99_percent_in_one_joint_shot_and_two_mirror_shots(arm):
    _, real, _, targets = twin(arm)
    for form, passes in (("joint", 1), ("mirror", 2)):
        before, after = left_over(real, targets, compensate(real, targets, form, passes).q)
        assert after[0] < 0.01 * before[0], form
        assert after[1] < 0.01 * before[1], form


@pytest.mark.parametrize("arm", ARMS)
def test_compliances_identified_with_5_kg_take_back_90_percent(arm):
    study, real, read, targets = twin(arm)
    shares = []
    for seed in range(8):
        found = identify(study, read(seed))
        assert set(found.parameters) == IDENTIFIED
        fitted = arm_of(found.model, found.values, found.covariance)
        before, after = left_over(real, targets, compensate(fitted, targets, passes=1).q)
        shares.append(after[0] / before[0])
    assert np.sqrt(np.mean(np.square(shares))) < 0.1
    assert 1.5e-4 < before[0] / np.sqrt(len(targets.names)) < 7e-4  # about half a millimetre


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("rows", ["vectors", "dual_quaternions"])
def test_wrenches_of_a_wrist_sensor_serve_instead_of_a_known_load(arm, rows):
    """What the sensor reads, with noise of 0.02 N and 1 mNm, in place of 5 kg and where they hang."""
    study, real, read, _ = twin(arm)
    rng, z = np.random.default_rng(5), []
    for seed in range(6):
        data = read(seed)
        experiment = data.experiment
        turn = flange_poses(study.robot, experiment.q)[experiment.shot_pose, :3, :3]
        weight = 5.0 * study.robot.gravity_base
        wrench = np.zeros((len(turn), 6))
        wrench[:, :3] = weight @ turn
        wrench += rng.normal(0, [0.02] * 3 + [1e-3] * 3, wrench.shape)
        wrench[experiment.shot_unloaded] = 0.0
        data = replace(data, experiment=replace(experiment, wrench=wrench))
        found = identify(replace(study, rows=rows), data)
        assert set(found.parameters) >= IDENTIFIED - {"joint_compliance.j7"}
        for name in IDENTIFIED & set(found.parameters):
            column = found.model.names.index(name)
            true = real.values[real.model.names.index(name)]
            z.append((found.values[column] - true) / np.sqrt(found.covariance[column, column]))
    assert np.abs(z).max() < 4.0
    assert 0.6 < np.std(z) < 1.4


@pytest.mark.parametrize("arm", ARMS)
def test_the_sign_of_a_quaternion_changes_nothing(arm):
    study, _, read, _ = twin(arm)
    data = read(3)
    for rows in ("vectors", "dual_quaternions", "dual_quaternion_deviations"):
        own = replace(study, rows=rows)
        here, there = identify(own, data), identify(own, replace(data, quaternions=-data.quaternions))
        assert here.parameters == pytest.approx(there.parameters, rel=1e-12)


def test_a_corrected_pose_command_is_the_mirror_form_in_dual_quaternions():
    from identify.dual_quaternions.placements import from_matrix, to_matrix

    _, real, _, targets = twin("r1")
    wished = flange_poses(real.model.robot, targets.q)
    there = compensate(real, targets, "mirror", 1)
    nominal, actual = from_matrix(wished), from_matrix(tool_poses(real, targets))
    for sign in (1.0, -1.0):
        command = corrected(nominal, pose_error(nominal, sign * actual))
        np.testing.assert_allclose(to_matrix(command), there.command, atol=1e-8)


@pytest.mark.parametrize("arm", ARMS)
def test_the_chain_of_commands_runs_on_the_shipped_files(arm, tmp_path, capsys):
    study, poses, targets = map(str, files(arm))
    truth = str(CONFIGS / "truths" / f"sda5f_{arm}.toml")
    m, i, c = (str(tmp_path / name) for name in "mic")
    assert run(["simulate", study, poses, "--truth", truth, "--out", m, "--quiet"]) == 0
    assert run(["identify", study, f"{m}/measurements.csv", "--out", i, "--quiet"]) == 0
    content = json.loads((tmp_path / "i" / "identify.json").read_text())
    assert [item["name"] for item in content["nonidentifiable"]] == ["joint_compliance.j1", "joint_compliance.j8"]
    assert content["orientation"]["rms_mrad"] < 0.3
    assert content["linear_misses"]["percent"] < 1.0
    for form in ("joint", "mirror"):
        out = str(Path(c) / form)
        assert run(["compensate", study, f"{i}/identify.json", targets, "--form", form, "--out", out, "--quiet"]) == 0
        with (Path(out) / "compensated.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 10
        assert all(float(row["residual_mm"]) < 1e-3 < float(row["residual_ci95_mm"]) < 0.05 for row in rows)
    capsys.readouterr()


@pytest.mark.parametrize("arm", ARMS)
def test_the_dumbbell_of_the_paper_is_below_what_the_data_resolve(arm, tmp_path, capsys):
    study, poses, _ = files(arm)
    light = tmp_path / "poses.csv"
    light.write_text(poses.read_text().replace(",L5,", ",D153,"))
    truth = str(CONFIGS / "truths" / f"sda5f_{arm}.toml")
    assert run(["simulate", str(study), str(light), "--truth", truth, "--out", str(tmp_path / "m"), "--quiet"]) == 0
    measured = str(tmp_path / "m" / "measurements.csv")
    assert run(["identify", str(study), measured, "--out", str(tmp_path / "i"), "--quiet"]) == 0
    assert run(["report", str(tmp_path / "i"), "--quiet"]) == 0
    assert "below what the data resolve" in capsys.readouterr().out
    assert "below what the data resolve" in (tmp_path / "i" / "report.html").read_text()


def test_deflections_of_the_paper_do_not_follow_from_its_stiffness():
    """The figures of docs/theory.md."""
    printed = {
        "r1": [0.45, 0.06, 0.10, 0.07, 0.05, 0.03, 0.21, 9.95],
        "r2": [0.02, 0.10, 0.23, 0.06, 0.20, 0.02, 0.15, 9.50],
    }
    text = " ".join((CONFIGS.parent / "docs" / "theory.md").read_text(encoding="utf-8").split())
    told = []
    for arm in ARMS:
        study, real, _, targets = twin(arm)
        arm_of_paper = replace(real, values=1.0 / np.array(printed[arm]))
        q = spread_poses(study.robot, 20_000, np.random.default_rng(1))
        small, large = (
            error_map(arm_of_paper, q, hung_weight(study.robot, mass), attach=targets.attach[0])
            for mass in (0.153, 5.0)
        )
        told.append((small.position.max() * 1e3, small.orientation.max() * 1e3, large.position.max() * 1e3))
    (a, b, c), (d, e, f) = told
    assert f"{a:.3f} mm and {b:.3f} mrad (R1) or {d:.3f} mm and {e:.3f} mrad (R2)" in text
    assert f"5 kg gives up to {c:.2f} and {f:.2f} mm" in text


def test_orientations_survive_the_files(tmp_path, capsys):
    study, poses, _ = files("r1")
    assert run(["simulate", str(study), str(poses), "--out", str(tmp_path / "m"), "--quiet"]) == 0
    with (tmp_path / "m" / "measurements.csv").open() as file:
        rows = list(csv.DictReader(file))
    read = np.array([[float(row[key]) for key in ("qw", "qx", "qy", "qz")] for row in rows])
    loaded = load_study(study)
    q = np.deg2rad([[float(row[f"q{k}_deg"]) for k in range(1, 9)] for row in rows])
    expected = quaternions(flange_poses(loaded.robot, q)[:, :3, :3])  # the frame has the axes of the base
    assert np.abs(np.abs((read * expected).sum(axis=1)) - 1).max() < 1e-5
    capsys.readouterr()
