"""Before measuring: detectability and the closest rival, against plain least squares on stacked rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import subspace_angles

from doe.commands import run_evaluate
from doe.confusability import SHOWN, confusability
from identify.diagnosis.library import hypotheses, tried
from identify.diagnosis.search import fitted
from identify.experiment import Measurements, full_experiment
from identify.model import model_of
from identify.response import respond
from identify.tables import plan_csv
from tests.doe.study_files import KR270, study, study_file

GIVEN = {f"joint_compliance.j{i}": c for i, c in enumerate((0.35, 0.27, 0.38, 2.7, 3.1, 2.2), 1)}


def some_plan(whole, count=12, seed=1, **fixed):
    """Random poses with all loads; some joints at one angle."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(whole.robot.lower, -2.4), np.minimum(whole.robot.upper, 2.4), (count, 6))
    for name, value in fixed.items():
        q[:, int(name[1:]) - 1] = value
    return full_experiment(q, np.tile([0, 1, 2], (count, 1)), whole.loads, whole.markers)


def off(columns, basis):
    """What least squares leaves of columns."""
    return columns - basis @ np.linalg.lstsq(basis, columns, rcond=None)[0]


def test_energies_and_angles_are_those_of_least_squares_on_the_rows(tmp_path):
    whole = study(tmp_path, KR270, model={"nominal": GIVEN, "reference": "absolute"})
    experiment = some_plan(whole)
    reference, causes = confusability(whole, experiment)
    assert reference == "absolute"
    model = model_of(whole)
    position = respond(model, experiment, model.nominal, derivative=False).position
    found = fitted(whole, Measurements(experiment, position, np.arange(len(position))), differences=False)
    asked = {h.entry: h for h in hypotheses(whole, found.model, found)}
    base = found.columns[:, found.identifiability.kept]
    by_name = {cause.hypothesis.entry: cause for cause in causes}

    def columns(entry):
        (block,) = tried(found, (asked[entry],))
        return off(found.whitening.apply(block.columns), base)

    for entry in ("load_com", "tool_compliance@flange", "load_direction"):
        cause = by_name[entry]
        own = columns(entry)
        assert cause.energy == pytest.approx(((own * cause.typical) ** 2).sum(), rel=1e-6)
        np.testing.assert_allclose(cause.detectable * np.linalg.norm(own, axis=0), np.sqrt(SHOWN), rtol=1e-6)
        other = columns(cause.rival)
        assert cause.beside_rival == pytest.approx(((off(own, other) * cause.typical) ** 2).sum(), rel=1e-5)
        assert cause.cosine == pytest.approx(np.cos(subspace_angles(own, other).min()), abs=1e-4)


def test_one_base_angle_confuses_what_all_base_angles_tell_apart(tmp_path):
    whole = study(tmp_path, KR270, model={"nominal": GIVEN})
    pair = {}
    for name, fixed in (("one", {"q1": 0.3}), ("all", {})):
        reference, causes = confusability(whole, some_plan(whole, **fixed))
        pair[name] = next(c for c in causes if c.hypothesis.entry == "base_compliance@base")
    assert reference == "differences"
    assert pair["one"].rival in {"base_compliance@column", "link_compliance@link1"}
    assert pair["one"].cosine > 0.999
    assert pair["all"].cosine < 0.9


def test_what_no_reading_shows_has_no_energy_and_no_rival(tmp_path):
    whole = study(tmp_path, KR270, model={"nominal": GIVEN})
    _, causes = confusability(whole, some_plan(whole))
    unseen = {c.hypothesis.entry: c for c in causes if c.energy == 0.0}
    assert unseen["geometry@j2"].rival is None  # in differences between loads geometry does not show
    assert not np.isfinite(unseen["geometry@j2"].detectable).any()


def test_evaluate_writes_and_prints_what_a_diagnosis_could_not_tell(tmp_path):
    path = study_file(tmp_path, KR270, plan={"candidates": 50}, model={"nominal": GIVEN})
    whole = study(tmp_path, KR270)
    (tmp_path / "plan.csv").write_text(plan_csv(some_plan(whole, q1=0.3), whole))
    judged = run_evaluate(path, tmp_path / "plan.csv", seed=0)
    found = judged.content["confusability"]
    assert found["reference"] == "differences"
    left = [cause["energy_beside_closest"] for cause in found["causes"]]
    assert left == sorted(left)
    entry = next(c for c in found["causes"] if c["name"] == "base_compliance" and c["where"] == "base")
    assert entry["closest"] in {"base_compliance@column", "link_compliance@link1"}
    assert 0.9 < entry["cosine"] <= 1.0
    assert [p["unit"] for p in entry["parameters"]] == ["urad/Nm"] * 2
    text = "\n".join(judged.lines)
    assert "would show nowhere at their typical sizes: approach_hysteresis, force_sensor_bias, geometry" in text
    assert "could not be told apart" in text


def test_without_any_load_and_without_masses_a_plan_can_still_be_judged(tmp_path):
    whole = study(tmp_path, KR270, loads=[{"id": "L0"}], plan={"loads": None}, model={"effects": ["geometry"]})
    few = some_plan(replace(whole, loads=whole.loads * 3))
    reference, causes = confusability(whole, few)
    assert reference == "absolute"
    assert all(np.isfinite(cause.energy) for cause in causes)
