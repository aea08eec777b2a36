"""Warming up: links that grow, offsets that move, with the temperature or with the time."""

from dataclasses import replace

import numpy as np
import pytest

from identify.effects import bind_effects, build_scene
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.identification import identify
from identify.kinematics import forward
from identify.model import model_of
from identify.response import respond
from identify.results import json_text
from identify.robot_files import load_robot
from identify.summary import identification_json, load_fitted, predict
from tests.identify.studies import (
    COMPLIANCE,
    UNLOADED,
    experiment_of,
    kr270_study,
    poses,
    random_robot,
    readings,
    values_of,
)
from tests.identify.test_effects import ON_BOTH

HOURS = 3600.0


def effect_of(robot, name="thermal_growth", **options):
    return bind_effects((name,), robot, options={"thermal_growth": options})[0]


def scene_of(robot, q, **conditions):
    experiment = full_experiment(q, np.zeros((len(q), 1), dtype=np.int64), (UNLOADED,), ON_BOTH)
    experiment = replace(experiment, **conditions)
    return build_scene(experiment, forward(robot, q), ON_BOTH.positions, self_weight=False)


def warming(experiment, rng, *, hours=3.0):
    """Rows read one after the other; the arm warms up from 21 to 41 degC."""
    time = 1.7e9 + np.linspace(0, hours * HOURS, len(experiment.row_shot))
    return replace(experiment, time=time, temperature=21.0 + 20 * (1 - np.exp(-(time - time[0]) / (0.8 * HOURS))))


def stretched(robot, links, share):
    """The robot with some links longer by a share: placement k starts where joint k is."""
    placements = robot.placements.copy()
    for link in links:
        placements[link, :3, 3] *= 1 + share
    return replace(robot, placements=placements)


@pytest.mark.parametrize(("place", "links"), [("all", range(5)), ("link0", [0]), ("link2", [2]), ("link4", [4])])
def test_growing_links_are_longer_placements(place, links):
    robot = random_robot(np.random.default_rng(2), (False,) * 4)
    q = np.random.default_rng(3).uniform(-2, 2, (5, 4))
    temperature = np.repeat(20 + np.array([0.0, 3.0, 10.0, -4.0, 25.0]), 3)
    moved = effect_of(robot, f"thermal_growth@{place}").displacement(
        scene_of(robot, q, temperature=temperature), np.array([12.0])
    )
    for i, kelvin in enumerate(temperature[::3] - 20):
        warm = stretched(robot, links, 12e-6 * kelvin)
        expected = scene_of(warm, q).point - scene_of(robot, q).point
        np.testing.assert_allclose(moved[3 * i : 3 * i + 3], expected[3 * i : 3 * i + 3], atol=2e-15)
    assert np.abs(moved).max() > 2e-5


def test_a_sliding_joint_grows_with_its_link_and_moves_in_um_per_kelvin():
    robot = random_robot(np.random.default_rng(2), (False, True, False))
    effect = effect_of(robot)
    assert [(p.name, p.unit) for p in effect.parameters] == [
        ("thermal_growth.all", "ppm/K"), ("thermal_growth.j2", "um/K"), ("thermal_growth.j3", "urad/K"),
    ]  # fmt: skip
    q = np.random.default_rng(3).uniform(-2, 2, (4, 3))
    scene = scene_of(robot, q, temperature=np.full(12, 30.0))
    moved = effect.displacement(scene, np.array([0.0, 7.0, 5.0]))
    ahead, behind = (scene_of(robot, q + sign * np.array([0, 7e-5, 5e-5])).point for sign in (1, -1))
    np.testing.assert_allclose(moved, (ahead - behind) / 2, atol=1e-12)
    whole = effect.displacement(scene, np.array([10.0, 0.0, 0.0]))
    flange = scene.frames.flange_origin[scene.row_pose] * ~ON_BOTH.on_base[scene.experiment.row_marker, None]
    np.testing.assert_allclose(whole, 1e-4 * flange, atol=2e-15)
    assert [p.name for p in effect_of(load_robot("single_joint")).parameters] == ["thermal_growth.all"]


def test_without_temperatures_the_arm_warms_up_from_the_first_reading_on():
    robot = load_robot("kr270_r2700")
    q = np.random.default_rng(3).uniform(-1, 1, (5, 6))
    time = 1.7e9 + HOURS * np.repeat([0.0, 0.5, 1.0, 4.0, 50.0], 3)
    share = np.repeat(1 - np.exp([0.0, -0.25, -0.5, -2.0, -25.0]), 3)
    full = effect_of(robot).displacement(scene_of(robot, q, temperature=np.full(15, 21.0)), np.array([1.0, 2.0, 3.0]))
    half = effect_of(robot, tau_h=2.0).displacement(scene_of(robot, q, time=time), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(half, share[:, None] * full, atol=1e-18)
    both = {"time": time, "temperature": np.full(15, 21.0)}
    values = np.array([1.0, 2.0, 3.0])
    for driver, expected in (("auto", full), ("temperature", full), ("time", half)):
        chosen = effect_of(robot, driver=driver, tau_h=2.0)
        np.testing.assert_allclose(chosen.displacement(scene_of(robot, q, **both), values), expected, atol=1e-18)
        units = [p.unit for p in chosen.parameters]
        assert units == (["ppm", "urad", "urad"] if driver == "time" else ["ppm/K", "urad/K", "urad/K"])
    assert not effect_of(robot, driver="temperature").displacement(scene_of(robot, q, time=time), values).any()


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
def test_derivatives_are_those_of_the_response(equilibrium):
    rng = np.random.default_rng(4)
    study = kr270_study(
        effects=("joint_compliance", *(f"thermal_growth@{place}" for place in ("all", "link3", "j2", "j5"))),
        markers=ON_BOTH,
        frame_free=False,
        equilibrium=equilibrium,
    )
    model = model_of(study)
    values = values_of(model, {**COMPLIANCE, "thermal_growth.all": 11.0})
    experiment = warming(experiment_of(study, poses(study, 4, rng)), rng)
    found = respond(model, experiment, values)
    for column in range(model.effect_slices[1].start, len(values)):
        nudge = 5.0 * np.eye(len(values))[column]
        ahead, behind = (respond(model, experiment, values + s * nudge, derivative=False).position for s in (1, -1))
        np.testing.assert_allclose(found.derivative[:, :, column], (ahead - behind) / 10, atol=1e-14)
        assert found.derivative[:, :, column].any()


@pytest.mark.parametrize("driver", ["temperature", "time"])
def test_growth_is_found_within_its_intervals(driver):
    rng = np.random.default_rng(12)
    options = {"thermal_growth": {"driver": driver, "tau_h": 0.8}}
    study = kr270_study(effects=("joint_compliance", "thermal_growth"), options=options, reference="absolute")
    size = 1.0 if driver == "temperature" else 20.0
    given = {**COMPLIANCE, "thermal_growth.all": 12.0 * size, "thermal_growth.j2": 4.0 * size}
    data = readings(study, warming(experiment_of(study, poses(study, 40, rng)), rng), given, rng)
    found = identify(study, data)
    asked = [i for i in found.kept if not found.model.parameters[i].nuisance]
    z = (found.values - values_of(found.model, given))[asked] / np.sqrt(np.diag(found.covariance)[asked])
    assert {"thermal_growth.all", "thermal_growth.j2", "thermal_growth.j3"} <= set(found.parameters)
    assert np.abs(z).max() < 4.0
    assert found.lack_of_fit.p_value > 1e-3
    index = found.model.names.index("thermal_growth.all")
    assert given["thermal_growth.all"] > 5 * np.sqrt(found.covariance[index, index])
    # the held-out fit counts its warm-up from the first reading of all
    assert found.heldout.misfit.rms < 0.12e-3


def test_without_times_and_temperatures_nothing_grows_and_this_is_said():
    rng = np.random.default_rng(9)
    study = kr270_study(effects=("joint_compliance", "thermal_growth"))
    data = readings(study, experiment_of(study, poses(study, 12, rng)), COMPLIANCE, rng)
    found = identify(study, data)
    held = {found.model.names[d.column]: d for d in found.fit.identifiability.dropped}
    assert {"thermal_growth.all", "thermal_growth.j2", "thermal_growth.j3"} <= set(held)
    assert held["thermal_growth.all"].alike == ()
    effect = found.model.effects[1]
    assert "neither column temperature_C nor time_s" in effect.why_zero(0)
    assert "no marker moves with j3" in effect.why_zero(2)
    assert not effect.yields


def test_predictions_take_warmth_as_the_fit_took_it(tmp_path):
    """A plan without temperatures must not read kelvins as hours, nor the other way round."""
    rng = np.random.default_rng(5)
    study = kr270_study(effects=("joint_compliance", "thermal_growth"), frame_free=False, reference="absolute")
    experiment = warming(experiment_of(study, poses(study, 25, rng)), rng)
    given = {**COMPLIANCE, "thermal_growth.all": 12.0, "thermal_growth.j2": 6.0}

    def fitted(**changes):
        found = identify(study, readings(study, replace(experiment, **changes), given, rng))
        path = tmp_path / "identify.json"
        path.write_text(json_text(identification_json(found)))
        return load_fitted(path, study)

    by_kelvin, by_hours = fitted(), fitted(temperature=None)
    cold = {"temperature": None, "time": None, "start": None}
    plain = [predict(f, replace(experiment, **cold))[0] for f in (by_kelvin, by_hours)]
    timed = [predict(f, replace(experiment, temperature=None))[0] for f in (by_kelvin, by_hours)]
    warm = [predict(f, experiment)[0] for f in (by_kelvin, by_hours)]
    np.testing.assert_array_equal(timed[0], plain[0])
    np.testing.assert_array_equal(timed[1], warm[1])
    assert np.abs(warm[0] - plain[0]).max() > 2e-4
    assert np.abs(warm[1] - plain[1]).max() > 1e-5
    assert np.abs(warm[1] - plain[1]).max() < 1e-4


@pytest.mark.parametrize(
    ("effect", "options", "words"),
    [
        ("thermal_growth@link9", {}, "link9: no such place; allowed: all, link0, link1, .* link6, j1, .* j6"),
        ("thermal_growth@base", {}, "base: no such place"),
        ("thermal_growth", {"tau": 1}, r"\[model.thermal_growth\] tau: unknown key; allowed: driver, tau_h"),
        ("thermal_growth", {"tau_h": 0.0}, "tau_h = 0.0: a finite number above 0 expected"),
        ("thermal_growth", {"tau_h": "1"}, "tau_h = '1'"),
        ("thermal_growth", {"driver": "sun"}, "driver = 'sun': allowed: auto, temperature, time"),
    ],
)
def test_wrong_places_and_options_are_refused_in_words(effect, options, words):
    with pytest.raises(InputError, match=words):
        effect_of(load_robot("kr270_r2700"), effect, **options)
