"""Joint errors: markers move as at the wrong joint values, and the errors are found again in readings."""

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
from identify.robot_files import load_robot
from tests.identify.studies import (
    COMPLIANCE,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    poses,
    random_robot,
    readings,
    study_of,
    ur10_study,
    values_of,
)
from tests.identify.test_effects import ON_BOTH, assert_derivative

OPTIONS = {"transmission_error": {"orders": [1, 2, 0.5], "j2": {"knots_deg": 40.0}, "j3": {"orders": [101]}}}
ALL = ("transmission_error", "wrist_coupling", "approach_hysteresis")


def approached(experiment, rng):
    """The same visits, every joint coming from a random side."""
    return replace(experiment, approach=rng.integers(-1, 2, (len(experiment.visits), experiment.q.shape[1])))


def effect_of(robot, name, **options):
    return bind_effects((name,), robot, options={name.partition("@")[0]: options})[0]


def names_of(effect):
    return [parameter.name for parameter in effect.parameters]


def scene_of(robot, q):
    experiment = full_experiment(q, np.zeros((len(q), 1), dtype=np.int64), (UNLOADED,), ON_BOTH)
    return build_scene(experiment, forward(robot, q), ON_BOTH.positions, self_weight=False)


def turned(robot, q, error):
    """Half the change of all markers between joint values q + error and q - error."""
    ahead, behind = (scene_of(robot, q + sign * error).point for sign in (1, -1))
    return (ahead - behind) / 2


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
def test_derivatives_are_those_of_the_response(equilibrium):
    rng = np.random.default_rng(4)
    study = kr270_study(
        effects=("joint_compliance", *ALL), markers=ON_BOTH, options=OPTIONS, equilibrium=equilibrium, frame_free=False
    )
    model = model_of(study)
    values = values_of(model, COMPLIANCE)
    where = slice(model.effect_slices[1].start, None)
    values[where] = [p.typical * rng.normal() for p in model.parameters[where]]
    experiment = approached(experiment_of(study, poses(study, 5, rng)), rng)
    found = respond(model, experiment, values)
    step = 10.0  # the displacement is linear: any step will do, a large one hides no rounding
    for column in range(where.start, len(values)):
        nudge = step * np.eye(len(values))[column]
        ahead, behind = (respond(model, experiment, values + s * nudge, derivative=False).position for s in (1, -1))
        np.testing.assert_allclose(found.derivative[:, :, column], (ahead - behind) / (2 * step), atol=1e-14)
    assert (np.abs(found.derivative[:, :, where]).max(axis=(0, 1)) > 0).sum() > 35


def test_columns_of_other_parameters_know_of_the_joint_errors():
    """Geometry and markers move the point that the wrong joints turn."""
    rng = np.random.default_rng(6)
    robot = random_robot(rng, (False, False, False, False))
    study = study_of(robot, loads=(UNLOADED, SIDE), markers=ON_BOTH, effects=("geometry", *ALL[:2]))
    assert_derivative(study, rng, {n: 0.4 for n in model_of(study).names if not n.startswith("frame")}, relative=2e-6)


def test_harmonics_displace_as_forward_kinematics_at_the_wrong_joint_values():
    robot = load_robot("ur10")
    q = np.random.default_rng(2).uniform(-3, 3, (6, robot.n))
    effect = effect_of(robot, "transmission_error", orders=[1, 101, 0.5])
    assert names_of(effect)[:6] == [f"transmission_error.j1.{c}" for c in ("s1", "c1", "s101", "c101", "s0.5", "c0.5")]
    values = np.random.default_rng(3).normal(0, 200, (6, 3, 2))  # joint, order, sin and cos; urad
    phase = q[:, :, None] * np.array([1, 101, 0.5])
    error = 1e-6 * (values[..., 0] * np.sin(phase) + values[..., 1] * np.cos(phase)).sum(axis=2)
    moved = effect.displacement(scene_of(robot, q), values.ravel())
    np.testing.assert_allclose(moved, turned(robot, q, error), atol=1e-9)
    assert np.abs(moved).max() > 1e-4


def test_the_free_curve_is_linear_between_its_knots_and_zero_at_the_middle_one():
    robot = load_robot("kr270_r2700")  # joint 5: -122.5 to 122.5 deg
    effect = effect_of(robot, "transmission_error@j5", knots_deg=50.0)
    assert names_of(effect) == [f"transmission_error.j5.k{i}" for i in (0, 1, 3, 4, 5)]
    heights = np.array([100.0, -50.0, 0.0, 200.0, 30.0, -80.0])
    angles = np.array([-122.5, -100.0, -60.0, -22.5, 0.0, 33.3, 122.5])
    q = np.zeros((len(angles), 6))
    q[:, 4] = np.deg2rad(angles)
    error = np.zeros_like(q)
    error[:, 4] = 1e-6 * np.interp(angles, -122.5 + 50.0 * np.arange(6), heights)
    moved = effect.displacement(scene_of(robot, q), np.delete(heights, 2))
    np.testing.assert_allclose(moved, turned(robot, q, error), atol=1e-12)


def test_the_knots_may_be_stated_and_the_curve_is_constant_beyond_them():
    robot, knots = load_robot("kr270_r2700"), [-60, -10.5, 0.0, 40.0]
    effect = effect_of(robot, "transmission_error@j3", knots_deg=knots)
    assert names_of(effect) == [f"transmission_error.j3.k{i}" for i in (0, 2, 3)]
    angles = np.array([-90.0, -60.0, -30.0, -5.0, 0.0, 13.0, 40.0, 100.0])
    q = np.zeros((len(angles), 6))
    q[:, 2] = np.deg2rad(angles)
    error = np.zeros_like(q)
    error[:, 2] = 1e-6 * np.interp(angles, knots, [100.0, 0.0, -70.0, 250.0])
    values, scene = np.array([100.0, -70.0, 250.0]), scene_of(robot, q)
    np.testing.assert_allclose(effect.displacement(scene, values), turned(robot, q, error), atol=1e-12)
    np.testing.assert_allclose(effect.derivative(scene, values) @ values, turned(robot, q, error), atol=1e-12)


def test_knots_span_the_limits_and_two_turns_where_there_are_none():
    robot = load_robot("kr270_r2700")
    assert len(effect_of(robot, "transmission_error@j1", knots_deg=2.0).parameters) == 185  # -185 to 185 deg
    free = replace(robot, lower=np.full(6, -np.inf), upper=np.full(6, np.inf))
    assert len(effect_of(free, "transmission_error@j1", knots_deg=90.0).parameters) == 8


def test_a_wrist_axis_turns_with_the_one_before_it():
    robot = load_robot("kr270_r2700")
    effect = effect_of(robot, "wrist_coupling")
    assert names_of(effect) == [f"wrist_coupling.{pair}" for pair in ("j4-j5", "j4-j6", "j5-j6")]
    q = np.random.default_rng(5).uniform(-1, 1, (5, 6))
    error = np.zeros_like(q)
    error[:, 4], error[:, 5] = 0.3e-3 * q[:, 3], -0.2e-3 * q[:, 3] + 0.7e-3 * q[:, 4]
    moved = effect.displacement(scene_of(robot, q), np.array([0.3, -0.2, 0.7]))
    np.testing.assert_allclose(moved, turned(robot, q, error), atol=1e-9)
    assert names_of(effect_of(load_robot("planar_3r"), "wrist_coupling")) == [
        "wrist_coupling.j1-j2", "wrist_coupling.j2-j3",
    ]  # fmt: skip
    assert len(effect_of(load_robot("sda5f_r1"), "wrist_coupling").parameters) == 3


def test_hysteresis_turns_each_joint_by_the_sign_of_its_approach():
    robot = random_robot(np.random.default_rng(1), (False, True, False))
    effect = effect_of(robot, "approach_hysteresis")
    assert [parameter.unit for parameter in effect.parameters] == ["urad", "um", "urad"]
    q = np.random.default_rng(5).uniform(-1, 1, (4, 3))
    signs = np.array([[1, -1, 0], [0, 0, 0], [-1, 1, 1], [1, 1, -1]])
    scene = scene_of(robot, q)
    scene = replace(scene, experiment=replace(scene.experiment, approach=signs))
    moved = effect.displacement(scene, np.array([60.0, 40.0, 90.0]))
    np.testing.assert_allclose(moved, turned(robot, q, 1e-6 * signs * [60.0, 40.0, 90.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "options", "sizes"),
    [
        ("transmission_error", {"orders": [1, 3]}, {"j2.s1": 150.0, "j2.c1": -90.0, "j3.s3": 120.0, "j5.c3": 200.0}),
        ("transmission_error@j3", {"knots_deg": 20.0}, {"j3.k9": 180.0, "j3.k10": 90.0, "j3.k12": -120.0}),
        ("wrist_coupling", {}, {"j4-j5": 0.6, "j4-j6": -0.8, "j5-j6": 0.5}),
        ("approach_hysteresis", {}, {"j1": 40.0, "j2": 80.0, "j3": -60.0, "j5": 90.0}),
    ],
)
def test_simulated_errors_are_found_within_their_intervals(effect, options, sizes):
    rng = np.random.default_rng(8)
    name = effect.partition("@")[0]
    study = kr270_study(effects=("joint_compliance", effect), options={name: options}, reference="absolute")
    given = {**COMPLIANCE, **{f"{name}.{place}": size for place, size in sizes.items()}}
    experiment = approached(experiment_of(study, poses(study, 70, rng)), rng)
    data = readings(study, experiment, given, rng)
    found = identify(study, data)
    asked = [i for i in found.kept if not found.model.parameters[i].nuisance]
    z = (found.values - values_of(found.model, given))[asked] / np.sqrt(np.diag(found.covariance)[asked])
    assert {f"{name}.{place}" for place in sizes} <= set(found.parameters)
    assert np.abs(z).max() < 4.0
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.7
    assert found.lack_of_fit.p_value > 1e-3
    for place, size in sizes.items():
        index = found.model.names.index(f"{name}.{place}")
        assert abs(size) > 4 * np.sqrt(found.covariance[index, index])


def test_what_the_data_cannot_show_is_listed_with_the_reason():
    rng = np.random.default_rng(9)
    study = ur10_study(effects=("joint_compliance", *ALL), options={"transmission_error": {"knots_deg": 90.0}})
    data = readings(study, experiment_of(study, poses(study, 30, rng)), {}, rng)
    content = {d.column: d for d in identify(study, data).fit.identifiability.dropped}
    model = model_of(study)
    held = {model.names[column] for column in content}
    assert {f"approach_hysteresis.j{i}" for i in range(1, 7)} <= held
    assert {"transmission_error.j1.k0", "transmission_error.j1.k7"} <= held  # no pose is beyond 103 deg
    hysteresis = next(effect for effect in model.effects if effect.name == "approach_hysteresis")
    assert "no columns approach1 ... approach6" in hysteresis.why_zero(0)
    gears = next(effect for effect in model.effects if effect.name == "transmission_error")
    assert gears.why_zero(0).startswith("no pose of these data has joint 1 near -360 deg")
    assert gears.why_zero(6).startswith("no pose of these data has joint 1 near 270 deg")
    changes = identify(replace(study, reference="differences"), data)
    assert not any(name.startswith(ALL) for name in changes.parameters)


@pytest.mark.parametrize(
    ("effect", "options", "words"),
    [
        ("transmission_error@j9", {}, "j9: no such place; allowed are j1 ... j6"),
        ("transmission_error@link2", {}, "link2: no such place"),
        ("transmission_error", {"order": [1]}, r"\[model.transmission_error\] order: unknown key; allowed: orders, kn"),
        ("transmission_error", {"orders": []}, r"orders = \[\]: a list of different positive numbers"),
        ("transmission_error", {"orders": [1, 1.0]}, "different"),
        ("transmission_error", {"orders": [0]}, "positive"),
        ("transmission_error", {"knots_deg": "2"}, "knots_deg = '2': a distance of 0.05 to 180 deg"),
        ("transmission_error", {"knots_deg": 0.001}, "knots_deg = 0.001"),
        ("transmission_error", {"knots_deg": [10.0]}, "two or more joint values expected"),
        ("transmission_error", {"knots_deg": [10.0, 5.0]}, "ascending"),
        ("transmission_error", {"knots_deg": [10.0, "20"]}, "two or more joint values expected"),
        ("transmission_error", {"j2": 3}, "j2 = 3: a table"),
        ("transmission_error", {"j2": {"step": 3}}, r"\[model.transmission_error.j2\] step: unknown key"),
        ("wrist_coupling@j5-j4", {}, "wrist_coupling@j5-j4: no such place; a pair of joints"),
        ("wrist_coupling", {"a": 1}, r"\[model.wrist_coupling\] a: unknown key; this effect has no options"),
        ("approach_hysteresis@base", {}, "base: no such place"),
        ("approach_hysteresis", {"a": 1}, "unknown key"),
    ],
)
def test_wrong_places_and_options_are_refused_in_words(effect, options, words):
    with pytest.raises(InputError, match=words) as caught:
        effect_of(load_robot("kr270_r2700"), effect, **options)
    assert caught.value.exit_code == 2


def test_sliding_joints_have_no_gear_error():
    robot = random_robot(np.random.default_rng(1), (False, True, False))
    assert {name.split(".")[1] for name in names_of(effect_of(robot, "transmission_error"))} == {"j1", "j3"}
    with pytest.raises(InputError, match=r"@j2: joint 2 slides; allowed are joints that turn: j1, j3"):
        effect_of(robot, "transmission_error@j2")
    with pytest.raises(InputError, match=r"wrist_coupling@j2: joint 2 slides"):
        effect_of(robot, "wrist_coupling@j1-j2")
    with pytest.raises(InputError, match="no such pair of turning joints"):
        effect_of(robot, "wrist_coupling")
    slides = random_robot(np.random.default_rng(1), (True, True))
    with pytest.raises(InputError, match="no joint of robot crooked turns"):
        effect_of(slides, "transmission_error")


def test_joint_errors_of_unknown_weights_are_linear_and_sum_up():
    rng = np.random.default_rng(3)
    study = kr270_study(effects=("transmission_error", "wrist_coupling"), loads=(UNLOADED, WEIGHT), frame_free=False)
    model = model_of(study)
    experiment = experiment_of(study, poses(study, 4, rng))
    values = rng.normal(0, 100, len(model.parameters)) * ~model.nuisance
    found = respond(model, experiment, values)
    np.testing.assert_allclose(found.direct @ (values * ~model.nuisance), found.deflection, atol=1e-15)
    assert not model.of_reading.any()
