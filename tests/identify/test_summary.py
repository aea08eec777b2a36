"""identify.json and the command lines: what they hold agrees with the fit, and what is wrong writes nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doe.cli import run
from identify.identification import identify
from identify.kinematics import forward
from identify.results import json_text
from identify.summary import identification_json, load_fitted, predict
from identify.tables import load_measurements, measurements_csv, plan_csv
from tests.identify.spoiling import Table
from tests.identify.studies import (
    COMPLIANCE,
    LIGHT,
    PLATE,
    ROOT,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    measured,
    poses,
    ur10_study,
)

STUDY = ROOT / "configs" / "studies" / "kr270.toml"
TRUTH = ROOT / "configs" / "truths" / "kr270.toml"


@pytest.fixture(scope="module", params=[True, False], ids=["absolute", "differences"])
def result(request):
    study = kr270_study(masses=request.param, loads=(UNLOADED, WEIGHT, LIGHT))
    return identify(study, measured(study, np.random.default_rng(1), count=15))


def test_every_key_of_the_contract_is_there(result):
    content = identification_json(result)
    assert set(content) >= {
        "parameters", "covariance", "covariance_kind", "effects", "reference", "frames", "markers", "rank",
        "nonidentifiable", "chi2", "dof", "residual", "heldout", "compensated_percent", "worst", "ignored_columns",
    }  # fmt: skip
    assert set(content["parameters"][0]) >= {"name", "value", "unit", "std", "ci95", "nuisance"}
    assert set(content["heldout"]) >= {"rms_mm", "max_mm", "poses"}
    json.loads(json_text(content), parse_constant=pytest.fail)  # no NaN, no Infinity


def test_covariance_stands_in_the_order_of_the_parameters(result):
    content = identification_json(result)
    std = [p["std"] for p in content["parameters"]]
    np.testing.assert_allclose(np.sqrt(np.diag(content["covariance"])), std, rtol=1e-12)
    np.testing.assert_allclose(content["covariance"], np.transpose(content["covariance"]), rtol=1e-9, atol=1e-15)
    values = {p["name"]: p["value"] for p in content["parameters"]}
    assert {name: values[name] for name in result.parameters} == result.parameters
    for p in content["parameters"]:
        low, high = p["ci95"]
        assert (high - low) / 2 == pytest.approx(result.quantile * p["std"])
        assert (low + high) / 2 == pytest.approx(p["value"], abs=1e-9)
    assert [n["name"] for n in content["nonidentifiable"]] == ["joint_compliance.j1"]


def test_frame_and_markers_are_given_in_mm_and_near_the_truth(result):
    content = identification_json(result)
    np.testing.assert_allclose(
        np.array(content["frames"]["base_T_measurement"])[:3, 3], result.fit.state.base_T_measurement[:3, 3] * 1e3
    )
    for name, position in zip(PLATE.names, PLATE.positions, strict=True):
        np.testing.assert_allclose(content["markers"][name], position * 1e3, atol=0.5)


def test_residuals_by_axis_marker_and_load_combine_to_the_whole(result):
    residual = identification_json(result)["residual"]
    whole = residual["rms_mm"] ** 2
    assert sum(v**2 for v in residual["axis_rms_mm"].values()) == pytest.approx(whole)
    experiment, misfit = result.data.experiment, result.misfit
    assert set(residual["marker_rms_mm"]) == set(PLATE.names)
    size = np.bincount(experiment.row_marker[misfit.rows], minlength=3)
    parts = np.array([residual["marker_rms_mm"][name] ** 2 for name in PLATE.names])
    assert size @ parts / size.sum() == pytest.approx(whole)
    if result.reference == "absolute":
        by_hand = np.sqrt((result.residuals**2).sum(axis=1).mean()) * 1e3
        assert residual["rms_mm"] == pytest.approx(by_hand)
        assert set(residual["load_rms_mm"]) == {"L0", "L1", "L2"}
    else:
        assert set(residual["load_rms_mm"]) == {"L1", "L2"}
    assert residual["max_mm"] >= residual["rms_mm"]


def test_the_residual_of_a_displaced_axis_shows_on_that_axis():
    rng = np.random.default_rng(2)
    study = kr270_study(frame_free=False, markers_fitted=False, reference="absolute")
    data = measured(study, rng)
    moved = data.positions + [0.0, 0.0, 1e-3] * np.where(np.arange(len(data.positions)) % 2, 1, -1)[:, None]
    residual = identification_json(identify(study, replace(data, positions=moved)))["residual"]
    axes = residual["axis_rms_mm"]
    assert axes["z"] > 5 * max(axes["x"], axes["y"])
    assert axes["z"] == pytest.approx(1.0, abs=0.2)


def test_compensated_percent_is_the_share_of_the_deflection_taken_away():
    rng = np.random.default_rng(3)
    study = kr270_study(frame_free=False, markers_fitted=False)
    data = measured(study, rng)
    shape = (12, 2, 3, 3)
    before = np.diff(data.positions.reshape(shape), axis=1)
    frames = forward(study.robot, data.experiment.q)
    rigid = np.stack([frames.point(p) for p in study.markers.positions], axis=1)
    np.testing.assert_allclose(data.positions.reshape(shape)[:, 0], rigid, atol=5e-3)
    result = identify(study, data)
    after = np.diff(result.residuals.reshape(shape), axis=1)
    expected = 100 * (1 - np.sqrt((after**2).sum() / (before**2).sum()))
    assert result.compensated_percent == pytest.approx(expected)
    assert result.compensated_percent > 95


def test_compensation_and_heldout_are_null_where_they_mean_nothing():
    rng = np.random.default_rng(4)
    unloaded = ur10_study(effects=("geometry",), loads=(UNLOADED,))
    assert (
        identification_json(identify(unloaded, measured(unloaded, rng, count=30, values={})))["compensated_percent"]
        is None
    )
    study = kr270_study()
    for count in (9, 10):
        content = identification_json(identify(study, measured(study, rng, count=count)))
        assert (content["heldout"] is None) == (count < 10)
    assert content["heldout"]["poses"] == 4


def test_heldout_judges_poses_that_the_fit_did_not_see(result):
    """Its rms is that of new readings, somewhat above that of fitted ones; its poses are 40 %."""
    content = identification_json(result)
    assert content["heldout"]["poses"] == 6
    assert 0.5 * content["residual"]["rms_mm"] < content["heldout"]["rms_mm"] < 2.5 * content["residual"]["rms_mm"]


def test_worst_rows_come_with_line_ids_and_size():
    rng = np.random.default_rng(5)
    study = kr270_study()
    data = measured(study, rng)
    positions = data.positions.copy()
    positions[31] += [0.0, 0.02, 0.0]
    positions[50] += [0.01, 0.0, 0.0]
    content = identification_json(identify(study, replace(data, positions=positions)))
    first, second = content["worst"]
    ids = ("line", "pose", "load", "marker", "repeat")
    assert tuple(first[key] for key in ids) == (33, "P006", "L0", "M2", 1)
    assert tuple(second[key] for key in ids) == (52, "P009", "L0", "M3", 1)
    assert first["error_mm"] == pytest.approx(20, abs=0.2)
    assert second["error_mm"] == pytest.approx(10, abs=0.2)
    assert first["z"] > second["z"] > 7


def test_predict_reads_the_result_back_and_places_the_markers(result, tmp_path):
    rng = np.random.default_rng(6)
    path = tmp_path / "identify.json"
    path.write_text(json_text(identification_json(result)), encoding="utf-8")
    fitted = load_fitted(path, result.study)
    position, std = predict(fitted, result.data.experiment)
    error = np.linalg.norm(position - result.data.positions, axis=1)
    assert np.sqrt((error**2).mean()) < 0.15e-3
    assert (std > 0).all()
    assert std.max() < 0.2e-3
    fresh = experiment_of(result.study, poses(result.study, 3, rng))
    assert predict(fitted, fresh)[0].shape == (27, 3)


# ---- the command


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """measurements.csv of 12 poses of the shipped study and truth, by the command."""
    folder = tmp_path_factory.mktemp("simulated")
    study = kr270_study()
    plan = folder / "plan.csv"
    plan.write_text(plan_csv(experiment_of(study, poses(study, 12, np.random.default_rng(7))), study), encoding="utf-8")
    code = run(["simulate", str(STUDY), str(plan), "--truth", str(TRUTH), "--out", str(folder / "out"), "--quiet"])
    assert code == 0
    return folder / "out" / "measurements.csv"


def command(path, out, *more):
    return run(["identify", str(STUDY), str(path), "--out", str(out), *more])


def test_the_command_finds_the_truth_of_the_simulation(simulated, tmp_path):
    assert command(simulated, tmp_path / "out") == 0
    content = json.loads((tmp_path / "out" / "identify.json").read_text(encoding="utf-8"))
    assert content["schema"] == 1
    assert content["reference"] == "differences"  # the masses of this arm are unknown
    truth = {**COMPLIANCE, "joint_compliance.j4": 2.7}
    asked = [p for p in content["parameters"] if not p["nuisance"]]
    assert [p["name"] for p in asked] == [f"joint_compliance.j{j}" for j in range(2, 7)]
    for p in asked:
        assert abs(p["value"] - truth[p["name"]]) < 4 * p["std"]
    assert set(content["provenance"]["inputs"]) == {"kr270.toml", "kr270_r2700.toml", "measurements.csv"}


def test_json_on_stdout_is_one_object_and_nothing_else(simulated, tmp_path, capsys):
    assert command(simulated, tmp_path / "out", "--json") == 0
    out = capsys.readouterr().out
    assert json.loads(out) == json.loads((tmp_path / "out" / "identify.json").read_text(encoding="utf-8"))


def test_people_get_a_table_with_values_and_reasons(simulated, tmp_path, capsys):
    assert command(simulated, tmp_path / "out") == 0
    out = capsys.readouterr().out
    for part in ("joint_compliance.j2", "vertical loads put no torque on joint 1", "held-out poses", "compensated"):
        assert part in out


def test_the_same_seed_gives_the_same_bytes(simulated, tmp_path):
    files = []
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert command(simulated, tmp_path / name, "--seed", seed, "--quiet") == 0
        files.append((tmp_path / name / "identify.json").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


@pytest.mark.parametrize("wrong", ["missing", "nan", "column", "marker", "metres", "twice"])
def test_bad_input_exits_2_with_one_message_and_writes_nothing(simulated, tmp_path, capsys, wrong):
    table = Table.read(simulated.read_text(encoding="utf-8"))
    path = tmp_path / "bad.csv"
    x = table.header.index("x_mm")
    if wrong == "nan":
        table.rows[4][x] = "nan"
    elif wrong == "column":
        table.header[x] = "x"
    elif wrong == "marker":
        table.rows[2][table.header.index("marker")] = "M9"
    elif wrong == "metres":
        for row in table.rows:
            row[x : x + 3] = [repr(float(v) / 1000) for v in row[x : x + 3]]
    elif wrong == "twice":
        table.rows.append([*table.rows[0][:x], "1.0", *table.rows[0][x + 1 :]])
    if wrong != "missing":
        table.write(path)
    assert command(path, tmp_path / "out") == 2
    caught = capsys.readouterr()
    assert caught.out == ""
    assert caught.err.startswith("error: ")
    assert "bad.csv" in caught.err
    assert "Traceback" not in caught.err
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_done_exits_3_and_writes_nothing(simulated, tmp_path, capsys):
    """Unloaded rows alone, with unknown masses: no compliance can be told."""
    table = Table.read(simulated.read_text(encoding="utf-8"))
    load = table.header.index("load")
    table.rows = [row for row in table.rows if row[load] == "L0"]
    path = table.write(tmp_path / "unloaded.csv")
    assert command(path, tmp_path / "out") == 3
    assert "joint_compliance.j2" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_results_are_replaced_by_force_only(simulated, tmp_path, capsys):
    out = tmp_path / "out"
    assert command(simulated, out, "--quiet") == 0
    before = (out / "identify.json").read_bytes()
    assert command(simulated, out, "--seed", "9") == 2
    assert "--force" in capsys.readouterr().err
    assert (out / "identify.json").read_bytes() == before
    assert command(simulated, out, "--seed", "9", "--force", "--quiet") == 0
    assert (out / "identify.json").read_bytes() != before


def test_a_spoilt_file_is_fitted_and_its_lines_are_named(simulated, tmp_path):
    table = Table.read(simulated.read_text(encoding="utf-8"))
    for row in (6, 40):
        table.add(row, "y_mm", 12.0)
    assert command(table.write(tmp_path / "bad.csv"), tmp_path / "out", "--quiet") == 0
    content = json.loads((tmp_path / "out" / "identify.json").read_text(encoding="utf-8"))
    assert {row["line"] for row in content["worst"]} == {8, 42}


def test_a_written_file_gives_the_same_result_as_the_data_in_memory(tmp_path):
    study = kr270_study()
    data = measured(study, np.random.default_rng(8))
    path = tmp_path / "measurements.csv"
    path.write_text(measurements_csv(data, study), encoding="utf-8")
    expected = identify(study, data).parameters
    for name, value in identify(study, load_measurements(path, study)).parameters.items():
        assert value == pytest.approx(expected[name], rel=1e-5)  # the file holds nanometres
