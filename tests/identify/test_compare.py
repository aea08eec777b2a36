"""Comparison of models: the published order on the twin of a KR 270, what the table says, and bad lists of models."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe.cli import run
from identify.compare import compare, default_choices
from identify.comparison_table import comparison_json, comparison_lines
from identify.config import load_study
from identify.errors import InputError
from identify.identification import identify
from identify.model import model_of
from identify.simulate import simulate
from identify.study import ModelChoice
from identify.tables import load_plan, plan_experiment
from identify.truth import load_truth

CONFIGS = Path(__file__).parents[2] / "configs"
STUDY, POSES = CONFIGS / "studies/kr270_compare.toml", CONFIGS / "studies/kr270_compare_poses.csv"
TRUTH = CONFIGS / "truths/kr270_complete.toml"


@pytest.fixture(scope="module")
def twin():
    """Study and a function that draws its measurements."""
    study = load_study(STUDY)
    truth = load_truth(TRUTH, study)
    model = model_of(replace(study, options=truth.options), truth.effects, {})
    values = np.array([truth.values.get(name, 0.0) for name in model.names])
    experiment = plan_experiment(load_plan(POSES, study), study)
    return study, lambda seed: simulate(
        model, values, experiment, truth.noise, np.eye(4), np.random.default_rng(seed)
    )  # fmt: skip


@pytest.fixture(scope="module")
def draws(twin):
    study, draw = twin
    return [compare(study, draw(seed), "differences") for seed in range(20)]


def test_twenty_draws_show_the_published_order(draws):
    names = [line.choice.name for line in draws[0]]
    assert names == ["none", "J1", "J2", "C1", "C2"]
    assert [line.parameters for line in draws[0]] == [0, 5, 9, 26, 30]
    rms = np.mean([[line.misfit.rms for line in lines] for lines in draws], axis=0)
    assert (np.diff(rms) < 0).all()
    share = dict(zip(names, np.mean([[line.compensated for line in lines] for lines in draws], axis=0), strict=True))
    assert share["none"] == pytest.approx(0.0, abs=1e-9)
    assert 75 < share["J1"] < share["J2"] < 92
    assert 95 < share["C1"] < share["C2"]
    held = np.mean([[line.crossfit.misfit.rms for line in lines] for lines in draws], axis=0)
    assert held[0] > held[1] > held[3]
    assert (held[1:] > rms[1:]).all()
    assert np.mean([lines[3].crossfit.compensated for lines in draws]) > 90
    assert all(line.crossfit.parameters == line.parameters for lines in draws for line in lines)


def test_the_complete_model_leaves_normal_residuals_and_joints_do_not(draws):
    p = np.array([[line.normality.p_value for line in lines] for lines in draws])
    assert np.median(p[:, 3]) > 0.05
    assert (p[:, 1] < 0.01).mean() > 0.9


def test_a_line_is_what_identify_says_of_that_model(twin, draws):
    study, draw = twin
    found = identify(study, draw(0))
    line = draws[0][3]
    assert line.misfit.rms == pytest.approx(found.misfit.rms, rel=1e-6)
    assert line.compensated == pytest.approx(found.compensated_percent, rel=1e-6)


def test_plain_data_and_table(draws):
    content = comparison_json(draws[0])
    for row, line in zip(content, draws[0], strict=True):
        error = line.misfit.error
        assert row["x"]["max_mm"] == pytest.approx(1e3 * np.abs(error[:, 0]).max())
        assert row["z"]["rms_mm"] == pytest.approx(1e3 * np.sqrt((error[:, 2] ** 2).mean()))
        assert all(sum(counts) == len(error) for counts in row["histogram"]["counts"].values())
        assert len(row["histogram"]["edges_mm"]) == 21
    lines = comparison_lines(content)
    assert [text.split()[0] for text in lines[2:7]] == ["none", "J1", "J2", "C1", "C2"]
    content[3]["heldout"]["parameters_least"] = 20
    assert "only 20 of 26 parameters" in comparison_lines(content)[-1]


def test_default_list(twin):
    study, draw = twin
    plain = replace(study, models=())
    assert [line.choice.name for line in compare(plain, draw(0), "differences")] == ["none", "J", "C"]
    levels = {"gravity_compensator": {"mode": "levels", "levels_deg": [-100, -50, -5]}}
    assert [c.name for c in default_choices(replace(plain, options=levels))] == ["J1", "J2", "C1", "C2"]


def test_the_command(tmp_path):
    truth = ["--truth", str(TRUTH), "--out", str(tmp_path / "a"), "--quiet"]
    assert run(["simulate", str(STUDY), str(POSES), *truth]) == 0
    readings = str(tmp_path / "a/measurements.csv")
    assert run(["identify", str(STUDY), readings, "--compare", "--out", str(tmp_path / "b"), "--quiet"]) == 0
    content = json.loads((tmp_path / "b/identify.json").read_text())
    assert [row["name"] for row in content["comparison"]] == ["none", "J1", "J2", "C1", "C2"]
    assert set(content["linear_misses"]) == {"rms_mm", "max_mm", "percent"}


def test_wrong_models_are_refused(tmp_path, twin):
    text = STUDY.read_text().replace("../robots", str(CONFIGS / "robots"))
    wrong = tmp_path / "study.toml"
    wrong.write_text(text + '\n[[models]]\nname = "J1"\neffects = ["joint_complance"]\nknots = 3\n')
    with pytest.raises(InputError) as error:
        load_study(wrong)
    assert "[[models]] 5" in str(error.value)
    wrong.write_text(text + '\n[[models]]\nname = "J1"\neffects = ["joint_complance"]\n')
    with pytest.raises(InputError, match="stands twice") as error:
        load_study(wrong)
    assert "joint_compliance" in str(error.value)
    study, draw = twin
    choice = ModelChoice("X", ("joint_compliance@j9",), {})
    with pytest.raises(InputError, match="model X of the comparison"):
        compare(study, draw(0), "differences", [choice])
