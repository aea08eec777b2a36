"""What is tried, where and with which options."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from identify.diagnosis.library import finer, hypotheses, merged_options, tried
from identify.diagnosis.search import with_causes
from identify.effects import REGISTRY
from identify.model import model_of
from identify.response import respond
from identify.simulate import simulate
from tests.identify.diagnosis.cases import (
    STEP_S,
    arm,
    conditions,
    fit_of,
    library,
    read,
    recorded,
    with_wrench,
)  # fmt: skip
from tests.identify.studies import experiment_of, poses, random_robot, study_of, values_of

JOINTS = {f"j{i}" for i in range(1, 7)}
LINKS = {f"link{i}" for i in range(1, 6)}


@pytest.fixture(scope="module")
def case():
    """A study whose readings have everything that can be recorded, its fit and its hypotheses."""
    study = arm()
    data = read(study, with_wrench(recorded(conditions(study, 12, 1))), 2)
    found = fit_of(study, data)
    return study, found, library(study, found)


def places(asked, name):
    return {h.where for h in asked if h.name == name}


def test_every_registered_effect_is_tried(case):
    _, _, asked = case
    assert {h.name for h in asked} == set(REGISTRY) - {"joint_compliance"}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("approach_hysteresis", JOINTS),
        ("backlash", JOINTS),
        ("base_compliance", {"base", "column"}),
        ("force_sensor_bias", {None}),
        ("geometry", JOINTS | {None}),
        ("gravity_compensator", {"j2"}),
        ("joint_cross_compliance", {f"j{i}-j{i + 1}" for i in range(1, 6)}),
        ("joint_hardening", JOINTS),
        ("joint_windup", JOINTS),
        ("link_compliance", LINKS),
        ("link_mass", LINKS | {"link6"}),
        ("load_com", {None}),
        ("load_direction", {None}),
        ("load_level", {"L1"}),
        ("load_scale", {None}),
        ("marker_seating", {"M1", "M2", "M3"}),
        ("thermal_growth", {None, "j2", "j3"}),
        ("tool_compliance", {"flange"}),
        ("tracker_drift", {None}),
        ("tracker_scale", {None}),
        ("tracker_step", {None}),
        ("transmission_error", JOINTS),
        ("wrist_coupling", {None, "j5-j6", "j4-j5", "j4-j6"}),
    ],
)
def test_effects_are_tried_at_all_their_places(case, name, expected):
    _, found, asked = case
    if name in {"joint_hardening", "joint_windup", "backlash"}:
        torque = np.abs(found.response.scene.joints.torque).max(axis=0)
        assert {f"j{i + 1}" for i in np.flatnonzero(torque > 1e-3)} <= places(asked, name) <= expected
    else:
        assert places(asked, name) == expected


def test_what_needs_times_or_temperatures_is_only_tried_with_them():
    study = arm()
    asked = library(study, fit_of(study, read(study, conditions(study, 10, 1), 2)))
    assert not {"tracker_step", "thermal_growth"} & {h.name for h in asked}
    timed = replace(recorded(conditions(study, 10, 1)), temperature=None)
    warmed = [h for h in library(study, fit_of(study, read(study, timed, 2))) if h.name == "thermal_growth"]
    assert {h.options["driver"] for h in warmed} == {"time"}
    assert len({h.options["tau_h"] for h in warmed}) == 3


def test_what_the_model_holds_is_not_tried_again(case):
    study, found, _ = case
    held = replace(study, effects=("joint_compliance", "geometry@j3", "transmission_error@j2", "load_com"))
    within = fit_of(held, found.data)
    asked = library(held, within)
    names = {parameter for h in asked for parameter in (h.effect.parameters[i].name for i in h.own)}
    assert not names & set(within.model.names)
    assert "j3" not in places(asked, "geometry")
    assert "j2" not in places(asked, "transmission_error")
    assert not places(asked, "load_com")
    assert "j4" in places(asked, "geometry")


def test_effects_can_be_left_out(case):
    study, found, asked = case
    left = hypotheses(study, found.model, found, without=frozenset({"geometry", "stiction"}))
    assert [h.entry for h in left] == [h.entry for h in asked if h.name not in {"geometry", "stiction"}]


def test_every_hypothesis_enters_the_study_with_its_options_and_brings_its_parameters(case):
    study, _, asked = case
    before = set(model_of(study).names)
    for h in asked:
        larger = model_of(with_causes(study, (h,)))
        own = [h.effect.parameters[index].name for index in h.own]
        assert set(own) <= set(larger.names) - before, h.entry
        if h.where is not None:
            assert set(own) == set(larger.names) - before, h.entry


def test_columns_are_derivatives_of_the_extended_model(case):
    """By the model with the cause in it, at zero size; what bends through geometry is of second order."""
    study, found, asked = case
    picked = [h for h in asked if not h.chord and h.entry in
              {"geometry@j3", "tracker_drift", "load_com", "link_mass@link3", "transmission_error@j3"}]  # fmt: skip
    for h, part in zip(picked, tried(found, tuple(picked)), strict=True):
        model = model_of(with_causes(study, (h,)))
        known = dict(zip(found.model.names, found.state.values.tolist(), strict=True))
        response = respond(model, found.data.experiment, values_of(model, known))
        index = [model.names.index(h.effect.parameters[i].name) for i in h.own]
        scale = np.abs(part.columns).max()
        np.testing.assert_allclose(part.columns, response.direct[:, :, index], atol=1e-5 * scale)


def test_the_chord_of_friction_is_its_whole_displacement_by_its_size(case):
    _, found, asked = case
    chords = [h for h in asked if h.name == "stiction" and h.chord and h.where == "j2"]
    assert len({h.chord for h in chords}) == 3
    largest = np.abs(found.response.scene.load_on_joints[:, 1]).max()
    for h, part in zip(chords, tried(found, tuple(chords)), strict=True):
        torque = found.response.scene.load_on_joints[found.data.experiment.row_shot, 1]
        compliance = found.state.values[found.model.names.index("joint_compliance.j2")] * 1e-6
        held = -compliance * np.clip(torque, -h.chord, h.chord) / h.chord
        expected = found.response.scene.joints.motion[:, 1] * held[:, None]
        np.testing.assert_allclose(part.columns[:, :, 0], expected, rtol=1e-6, atol=1e-12)
        assert 0 < h.chord < largest


def test_options_of_two_places_of_one_effect_stand_side_by_side(case):
    study, _, asked = case
    one = next(h for h in asked if h.entry == "transmission_error@j2" and h.options["orders"] == [1.0])
    two = next(h for h in asked if h.entry == "transmission_error@j3" and h.options["orders"] == [1.0, 2.0])
    both = with_causes(study, (one, two))
    assert both.options["transmission_error"] == {"j2": {"orders": [1.0]}, "j3": {"orders": [1.0, 2.0]}}
    added = [name for name in model_of(both).names if name.startswith("transmission")]
    assert added == [f"transmission_error.{name}" for name in ("j2.s1", "j2.c1", "j3.s1", "j3.c1", "j3.s2", "j3.c2")]


def test_merged_options_keep_those_of_the_study(case):
    _, _, asked = case
    given = MappingProxyType({"gravity_compensator": {"mode": "harmonics"}, "joint_windup": {"j1": {"knee_Nm": 5.0}}})
    windup = next(h for h in asked if h.entry == "joint_windup@j2")
    made = merged_options(given, windup)
    assert made["gravity_compensator"] == given["gravity_compensator"]
    assert made["joint_windup"] == {"j1": {"knee_Nm": 5.0}, "j2": dict(windup.options)}
    assert merged_options(given, next(h for h in asked if h.name == "load_com")) is given


def test_finer_values_lie_on_both_sides_of_the_one_found(case):
    study, found, asked = case
    for name, key in (("joint_windup", "knee_Nm"), ("joint_hardening", "saturation_Nm")):
        h = next(h for h in asked if h.entry == f"{name}@j2" and key in h.options)
        values = [other.options[key] for other in finer(h, study, found)]
        assert min(values) < h.options[key] < max(values)
        assert min(values) <= 0.6 * h.options[key]
        assert max(values) >= 1.6 * h.options[key]
        for other in finer(h, study, found):
            assert other.entry == h.entry
            assert [other.effect.parameters[i].name for i in other.own] == [h.effect.parameters[i].name for i in h.own]


def test_finer_times_lie_between_all_neighbouring_readings(case):
    study, found, asked = case
    steps = [h for h in asked if h.name == "tracker_step"]
    assert all(0.4 * STEP_S < h.options["time_s"] % STEP_S < 0.6 * STEP_S for h in steps)
    times = sorted(other.options["time_s"] for other in finer(steps[0], study, found))
    np.testing.assert_allclose(times, STEP_S * (np.arange(11) + 0.5))


def test_what_has_no_such_number_has_no_finer_values(case):
    study, found, asked = case
    assert finer(next(h for h in asked if h.name == "load_com"), study, found) == ()


def test_sliding_joints_have_no_gear_errors_and_knees_in_newton():
    study = study_of(random_robot(np.random.default_rng(7), (False, True, False, False)), reference="absolute")
    rng = np.random.default_rng(8)
    experiment = experiment_of(study, poses(study, 10, rng))
    soft = {f"joint_compliance.j{i}": 0.3 for i in range(1, 5)}
    model = model_of(study)
    data = simulate(model, values_of(model, soft), experiment, study.noise, np.eye(4), rng)
    asked = library(study, fit_of(study, data))
    assert places(asked, "transmission_error") == {"j1", "j3", "j4"}
    assert not places(asked, "gravity_compensator")
    for h in asked:
        if h.name == "joint_windup":
            assert set(h.options) == {"knee_N" if h.where == "j2" else "knee_Nm"}
    assert "j2" in places(asked, "joint_windup")


@pytest.mark.parametrize("slides", [(True, True, True), (False,), (False, True, False, True)])
def test_arms_that_cannot_have_an_effect_are_not_offered_it(slides):
    """Sliding joints have no gears that turn; a pair needs two joints that do."""
    study = study_of(random_robot(np.random.default_rng(9), slides), reference="absolute")
    rng = np.random.default_rng(10)
    experiment = experiment_of(study, poses(study, 9, rng))
    data = simulate(model_of(study), model_of(study).nominal, experiment, study.noise, np.eye(4), rng)
    asked = library(study, fit_of(study, data))
    turning = {f"j{i + 1}" for i, slide in enumerate(slides) if not slide}
    assert places(asked, "transmission_error") == turning
    assert not places(asked, "wrist_coupling")
    assert len(slides) > 1 or not places(asked, "joint_cross_compliance")


def test_a_rigid_arm_is_offered_compliance_and_no_friction():
    study = arm(effects=("geometry@j1",))
    asked = library(study, fit_of(study, read(arm(), conditions(study, 10, 1), 2)))
    assert not places(asked, "stiction")
    assert set(places(asked, "joint_compliance")) == {*JOINTS, None}  # each alone, and all at once


def test_every_hypothesis_binds_in_its_study_where_no_temperature_was_read():
    study = arm()
    data = read(study, replace(recorded(conditions(study, 10, 1)), temperature=None), 2)
    asked = library(study, fit_of(study, data))
    assert {h.where for h in asked if h.name == "thermal_growth"} == {None, "j2", "j3"}
    for h in asked:
        larger = model_of(with_causes(study, (h,)))
        assert {h.effect.parameters[index].name for index in h.own} <= set(larger.names), h.entry
