"""Keys and numbers that the pages state about plans are those of the code."""

import json
import re
from pathlib import Path

import pytest

from doe import curve, earlier, tolerance
from doe.cli import run
from identify.schema import ModelSection, PlanSection, TestRegionSection
from tests.doe.study_files import KR270, study_file

DOCS = Path(__file__).parents[2] / "docs"
FORMATS = (DOCS / "formats.md").read_text(encoding="utf-8")
THEORY = " ".join((DOCS / "theory.md").read_text(encoding="utf-8").split())


def section(title: str) -> str:
    """The paragraphs of the page about file formats from a bold title to the next one, on one line."""
    start = FORMATS.index(f"**{title}")
    return " ".join(re.split(r"\n\*\*", FORMATS[start + 2 :])[0].split())


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """plan.json of a further plan and evaluate.json, with everything that may stand in them."""
    folder = tmp_path_factory.mktemp("pages")
    box = {
        "joints_min_deg": [0.0, -70.0, 60.0, 0.0, 30.0, 0.0],
        "joints_max_deg": [0.0, -40.0, 100.0, 30.0, 60.0, 0.0],
        "wrench_max": [0.0, 0.0, 900.0, 0.0, 0.0, 0.0],
        "points": 4,
    }
    settings = {"candidates": 60, "poses": 5, "refine": False, "robust_to_losses": 1}
    file = study_file(folder, KR270, plan=settings, test_regions=[box])
    plan, rows = folder / "plan" / "plan.csv", folder / "read" / "measurements.csv"
    for words in (
        ["plan", file, "--out", plan.parent],
        ["simulate", file, plan, "--out", rows.parent],
        ["plan", file, "--measured", rows, "--out", folder / "more"],
        ["evaluate", file, plan, "--out", folder / "judged"],
    ):
        assert run([*map(str, words), "--quiet"]) == 0
    return [
        json.loads(path.read_text()) for path in (folder / "more" / "plan.json", folder / "judged" / "evaluate.json")
    ]


def test_keys_of_results_are_documented(made):
    planned, judged = made
    told = {
        "Accuracy against": [*planned["curve"][:1], *judged["curve"][:1]],
        "Measuring in steps": [planned["measured"], {"measured": 0}],
        "Robust plans": [planned["robust"], {"robust": 0}],
        "Test regions": [judged["test_regions"][0], {"test_regions": 0}],
    }
    for title, tables in told.items():
        for key in {key for table in tables for key in table}:
            stem = re.sub(r"^(random|own)_", "plan_", key)
            assert f"`{key}`" in section(title) or f"`{stem}`" in section(title), (title, key)
    assert "`random_`" in section("Accuracy against")
    assert "`own_`" in section("Accuracy against")


@pytest.mark.parametrize("schema", [PlanSection, TestRegionSection])
def test_keys_of_studies_are_documented(schema):
    table = FORMATS[FORMATS.index("## The study") : FORMATS.index("### Options of effects")]
    assert not [key for key in schema.model_fields if f"`{key}`" not in table]
    assert "`[model.nominal_std_percent]`" in table
    assert "nominal_std_percent" in ModelSection.model_fields


def test_numbers_are_those_of_the_code():
    assert f"median of {curve._DRAWS} plans" in section("Accuracy against")
    assert f"up to {curve._LONGEST} experiments" in section("Accuracy against")
    assert f"closer than {earlier.NEIGHBOURHOOD:g} deg" in section("Measuring in steps")
    assert f"the tolerance that {tolerance._MOST} experiments keep" in THEORY
    points = TestRegionSection.model_fields["points"].default
    assert f"the mean over {points} points" in THEORY
    most = re.search(r"`draws`: draws of uncertain nominal values, up to (\d+)", FORMATS)
    assert most is not None
    (limit,) = [rule.le for rule in PlanSection.model_fields["draws"].metadata if hasattr(rule, "le")]
    assert int(most[1]) == limit
    for option in ("--measured", "--result", "--earlier", "--unreachable"):
        assert f"`{option}`" in section("Measuring in steps")
