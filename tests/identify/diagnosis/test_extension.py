"""The extended study as a file: it runs where it stands and holds the same model."""

import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from identify.config import load_study
from identify.diagnosis import diagnose
from identify.diagnosis.content import diagnosis_json
from identify.diagnosis.extension import extended_toml
from identify.diagnosis.search import Cause, with_causes
from identify.effects import REGISTRY
from identify.identification import identify
from identify.model import model_of
from identify.study import Tracker
from tests.doe.study_files import KR270, study_file
from tests.identify.diagnosis.cases import COMPLIANCE, STEP_S, conditions, library, recorded
from tests.identify.studies import ROBOTS, readings

SETTINGS = {"model": {"reference": "absolute"}, "plan": None}


def written(folder, **changes):
    """A study file and its study."""
    path = study_file(folder, KR270, **{**SETTINGS, **changes})
    return path, load_study(path)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """A study of a file, readings with times, and their diagnosis, which names nothing."""
    _, study = written(tmp_path_factory.mktemp("study"))
    experiment = replace(recorded(conditions(study, 14, 1)), temperature=None)
    data = readings(study, experiment, COMPLIANCE, np.random.default_rng(2), placement=np.eye(4))
    return study, data, diagnose(study, data)


def extended(found, hypotheses):
    """The diagnosis as if causes had been found."""
    study = with_causes(found.study, hypotheses)
    causes = tuple(Cause(h, 1e-6) for h in hypotheses)
    search = replace(found.search, study=study, causes=causes)
    return replace(found, search=search, identification=identify(study, found.data))


def read_back(found, folder):
    path = folder / "extended.toml"
    path.write_text(extended_toml(found, folder), encoding="utf-8")
    return load_study(path)


PICKED = {
    "orders of a gear": lambda h: h.entry == "transmission_error@j3" and len(h.options["orders"]) == 2,
    "knee": lambda h: h.entry == "joint_windup@j2",
    "final stiffness": lambda h: h.entry == "joint_hardening@j3" and h.options,
    "template of a link": lambda h: h.entry == "link_compliance@link2" and isinstance(h.options["template"], list),
    "beam": lambda h: h.entry == "link_compliance@link3" and h.options["template"] == "beam",
    "harmonics": lambda h: h.entry == "gravity_compensator@j2",
    "time of a step": lambda h: h.entry == "tracker_step" and h.options["time_s"] > 6 * STEP_S,
    "warm-up": lambda h: h.name == "thermal_growth" and h.where is None,
    "components of a mass": lambda h: h.entry == "link_mass@link3" and len(h.options["components"]) == 4,
    "no options": lambda h: h.entry == "geometry@j3",
}


def pick(found, *whose):
    asked = library(found.study, found.search.first)
    return tuple(next(h for h in asked if PICKED[name](h)) for name in whose)


@pytest.mark.parametrize("whose", PICKED)
def test_a_cause_with_options_is_read_back_as_the_same_model(clean, whose, tmp_path):
    _, data, found = clean
    longer = extended(found, pick(found, whose))
    study = read_back(longer, tmp_path)
    assert study.effects == (*found.study.effects, longer.causes[0].hypothesis.entry)
    assert study.reference == "absolute"
    same = model_of(study)
    assert same.names == longer.identification.model.names
    np.testing.assert_allclose(same.nominal[~same.nuisance], longer.identification.values[~same.nuisance], rtol=1e-9)
    again = identify(study, data)
    assert again.lack_of_fit.chi2 == pytest.approx(longer.identification.lack_of_fit.chi2, rel=1e-6)


def test_two_causes_of_one_effect_keep_their_own_options(clean, tmp_path):
    _, _, found = clean
    asked = library(found.study, found.search.first)
    gears = tuple(
        next(h for h in asked if h.entry == f"transmission_error@{place}" and h.options["orders"] == orders)
        for place, orders in (("j2", [1.0]), ("j4", [1.0, 2.0]))
    )
    longer = extended(found, gears)
    study = read_back(longer, tmp_path)
    assert model_of(study).names == longer.identification.model.names
    assert study.options["transmission_error"]["j4"]["orders"] == [1.0, 2.0]


def test_options_and_starting_values_of_the_study_stay(tmp_path):
    given = {
        "effects": ["joint_compliance", "link_compliance@link2"],
        "link_compliance": {"template": ["k44"]},
        "nominal": {"joint_compliance": {"j1": 0.4}},
    }
    _, study = written(tmp_path, model=given)
    data = readings(study, conditions(study, 14, 1), COMPLIANCE, np.random.default_rng(2), placement=np.eye(4))
    longer = extended(diagnose(study, data), ())
    longer = extended(longer, pick(longer, "orders of a gear", "beam"))
    back = read_back(longer, tmp_path)
    assert back.options["link_compliance"]["template"] == ["k44"]
    assert back.options["link_compliance"]["link3"] == {"template": "beam"}
    assert model_of(back).names == longer.identification.model.names
    assert "link_compliance.link2.k44" in model_of(back).names


def test_a_robot_file_beside_the_study_is_found_from_another_folder(tmp_path):
    robots, out = tmp_path / "here" / "robots", tmp_path / "there" / "deep"
    robots.mkdir(parents=True)
    out.mkdir(parents=True)
    shutil.copy(ROBOTS / "kr270_r2700.toml", robots / "ours.toml")
    _, study = written(tmp_path / "here", robot={"model": "robots/ours.toml"})
    data = readings(study, conditions(study, 12, 1), COMPLIANCE, np.random.default_rng(2), placement=np.eye(4))
    found = diagnose(study, data)
    longer = extended(found, pick(found, "no options"))
    back = read_back(longer, out)
    np.testing.assert_array_equal(back.robot.placements, study.robot.placements)
    assert "../../here/robots/ours.toml" in (out / "extended.toml").read_text()
    assert identify(back, data).lack_of_fit.dof == longer.identification.lack_of_fit.dof


def test_noise_that_grows_with_the_distance_replaces_the_stated_one(tmp_path):
    _, study = written(tmp_path, noise={"reading_mm": 0.03, "pose_jitter_urad": 12.0})
    placement = np.eye(4)
    placement[:3, 3] = [2.5, -1.5, 0.5]
    true = replace(study.noise, reading=0.0, tracker=Tracker(1e-6, 20e-6, 1e-6, 20e-6))
    made = partial(readings, study, conditions(study, 60, 1), COMPLIANCE, np.random.default_rng(3))
    few = frozenset(REGISTRY) - {"geometry", "load_com", "joint_hardening"}
    found = diagnose(study, made(noise=true, placement=placement), without=few)
    assert found.range_noise is not None
    assert found.verdict == "cause_found"
    assert found.causes == ()
    back = read_back(found, tmp_path)
    for part in ("radial", "radial_per_m", "transverse", "transverse_per_m"):
        assert getattr(back.noise.tracker, part) == pytest.approx(getattr(found.range_noise.noise.tracker, part))
    assert back.noise.reading == 0.0
    assert back.noise.pose_jitter == study.noise.pose_jitter


def test_what_a_diagnosis_says_its_model_is_stands_in_the_file(clean, tmp_path):
    _, _, found = clean
    longer = extended(found, pick(found, "orders of a gear", "time of a step"))
    assert diagnosis_json(longer)["extended_model"] == list(read_back(longer, tmp_path).effects)
