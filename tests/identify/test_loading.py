"""Wrong loads and wrong masses: their columns, what they leave alone, and that they are found."""

from dataclasses import replace

import numpy as np
import pytest

from identify.arrays import rotation_of
from identify.effects import bind_effects
from identify.errors import InputError
from identify.identifiability import Dropped, why_not
from identify.identification import identify
from identify.kinematics import forward
from identify.loads import LoadCase
from identify.model import model_of
from identify.response import respond
from identify.study import Noise
from tests.identify.studies import (
    COMPLIANCE,
    EXACT,
    LIGHT,
    NOISE,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270,
    kr270_study,
    poses,
    random_robot,
    readings,
    study_of,
    values_of,
)
from tests.identify.test_effects import ON_BOTH, differences

LOADS = (UNLOADED, WEIGHT, LIGHT, SIDE)
OF_LOADS = ("load_com", "load_level", "load_scale")
ALL = (*OF_LOADS, "load_direction", "link_mass")
MOMENTS = {"link_mass": {"components": ["mass", "mx", "my", "mz"]}}
WIDE = {"mm": 8.0, "mrad": 8.0, "%": 4.0, "kg": 4.0, "kg m": 2.0, "N": 20.0, "Nm": 4.0}
TILT = (0.4, -0.3, 0.2)


def with_wrenches(study, experiment, rng):
    """The experiment with measured wrenches in its loaded shots."""
    loaded = np.array([not load.unloaded for load in study.loads])[experiment.shot_load]
    wrench = rng.normal(0, [500.0] * 3 + [80.0] * 3, (len(loaded), 6))
    return replace(experiment, wrench=np.where(loaded[:, None], wrench, 0.0))


def some_values(model, rng):
    """Random values of the right order; positive compliances, so that a loaded arm stands."""
    given = {}
    for p in model.parameters:
        if not p.nuisance:
            given[p.name] = rng.uniform(0.2, 1.5) if p.unit in {"urad/Nm", "um/N"} else rng.normal(0, WIDE[p.unit])
    return values_of(model, given)


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("slides", [(False,) * 6, (False, True, False, False)])
def test_columns_equal_central_differences_of_the_response(slides, measured, equilibrium):
    rng = np.random.default_rng([len(slides), measured])
    effects = ("joint_compliance", "geometry@j2", *ALL, *(("force_sensor_bias",) if measured else ()))
    study = study_of(
        random_robot(rng, slides), loads=(UNLOADED, LIGHT, SIDE), markers=ON_BOTH, effects=effects, options=MOMENTS,
        equilibrium=equilibrium,
    )  # fmt: skip
    model = model_of(study)
    values = some_values(model, rng)
    experiment = experiment_of(study, poses(study, 5, rng))
    if measured:
        experiment = with_wrenches(study, experiment, rng)
    analytic, numeric = respond(model, experiment, values).derivative, differences(model, experiment, values)
    scale = np.abs(numeric).max(axis=(0, 1))
    error = np.abs(analytic - numeric).max(axis=(0, 1))
    bad = error > 1e-6 * scale + 1e-15
    assert not bad.any(), [(n, e, s) for n, e, s, b in zip(model.names, error, scale, bad, strict=True) if b]
    assert (scale > 1e-7).sum() > 0.8 * len(scale)


def torque_errors(study, experiment, name, shot, joint):
    """``dt_j`` of one parameter at zero in one shot, from the definitions alone, SI per unit of the parameter."""
    robot = study.robot
    frames = forward(robot, experiment.q[experiment.shot_pose[[shot]]])
    axis, origin, turn = frames.axis[0, joint], frames.origin[0, joint], frames.flange_rotation[0]
    load = experiment.loads[experiment.shot_load[shot]]
    g = robot.gravity * robot.world_R_base.T @ [0.0, 0.0, -1.0]
    wrench = None if experiment.wrench is None else experiment.wrench[shot]
    at = frames.point(load.attach)[0]
    if wrench is not None:
        force, moment, weight = turn @ wrench[:3], turn @ wrench[3:], np.zeros(3)
    else:
        of_load = turn if load.in_flange else robot.world_R_base.T
        weight = load.mass * g
        force, moment = weight + of_load @ load.force, of_load @ load.moment
    effect, *rest = name.split(".")
    if effect == "load_com":
        return 1e-3 * axis @ np.cross(turn[:, "xyz".index(rest[0])], force)
    if effect in {"load_scale", "load_level"}:
        hit = rest[0] in {"all", load.name}
        return 0.01 * hit * axis @ (np.cross(at - origin, force) + moment)
    if effect == "force_sensor_bias":
        along = turn[:, "xyz".index(rest[0][1])]
        felt = axis @ (np.cross(at - origin, along) if rest[0][0] == "f" else along)
        return -felt if wrench.any() else 0.0
    carried = [(robot.masses[k], frames.centre[0, k]) for k in range(joint, robot.n)]
    carried += [(robot.tool_mass, frames.point(robot.tool_centre)[0])]
    if effect == "load_direction":
        e = robot.world_R_base.T[:, "xyz".index(rest[0])]
        terms = [(mass * g, centre) for mass, centre in carried] + [(weight, at)]
        return 1e-3 * sum(axis @ np.cross(p - origin, np.cross(e, w)) for w, p in terms)
    link = int(rest[0].removeprefix("link")) - 1
    if link < joint:
        return 0.0
    if len(rest) == 1:
        return axis @ np.cross(frames.centre[0, link] - origin, g)
    turned = rotation_of(np.array([0.0, 0.0, experiment.q[experiment.shot_pose[shot], link]]))
    rotation = frames.rotation[0, link] @ turned
    return axis @ np.cross(rotation[:, "xyz".index(rest[1][1])], g)


@pytest.mark.parametrize("measured", [False, True])
def test_columns_are_torque_errors_through_the_compliances(measured):
    """``sum_j c_j D_j dt_j`` on a tilted base with a tool, every ``dt_j`` written out by its definition."""
    rng = np.random.default_rng(4)
    robot = replace(kr270(mount=TILT), tool_mass=30.0, tool_centre=np.array([0.1, 0.02, -0.05]))
    effects = ("joint_compliance", *ALL, *(("force_sensor_bias",) if measured else ()))
    study = study_of(robot, loads=LOADS, effects=effects, options=MOMENTS, frame_free=False, markers_fitted=False)
    model = model_of(study)
    experiment = experiment_of(study, poses(study, 3, rng))
    if measured:
        experiment = with_wrenches(study, experiment, rng)
    response = respond(model, experiment, values_of(model, COMPLIANCE))
    motion = response.scene.joints.motion
    c = 1e-6 * np.array(list(COMPLIANCE.values()))
    for column, name in enumerate(model.names[6:], 6):
        dt = np.array([
            [torque_errors(study, experiment, name, s, j) for j in range(6)] for s in range(len(experiment.shot_load))
        ])
        expected = np.einsum("rji,j,rj->ri", motion, c, dt[experiment.row_shot])
        # a tilt is a rotation: its second order is 1e-4 rad / 6 of the column at the step taken
        np.testing.assert_allclose(response.derivative[:, :, column], expected, rtol=1e-8, atol=1e-14, err_msg=name)
        assert np.abs(expected).max() > 1e-8 or name in {"link_mass.link1.mz"}, name


def test_load_effects_leave_unloaded_readings_alone_and_effects_on_weight_do_not():
    rng = np.random.default_rng(1)
    study = kr270_study(loads=LOADS, effects=("joint_compliance", *ALL, "force_sensor_bias"))
    model = model_of(study)
    base = values_of(model, COMPLIANCE)
    for experiment in (
        experiment_of(study, poses(study, 4, rng)),
        with_wrenches(study, experiment_of(study, poses(study, 4, rng)), rng),
    ):
        unloaded = experiment.shot_unloaded[experiment.row_shot]
        still = respond(model, experiment, base, derivative=False).position
        for name, value in zip(model.names, some_values(model, rng), strict=True):
            if not name.startswith(("load_", "force_", "link_mass")):
                continue
            changed = base.copy()
            changed[model.names.index(name)] = value
            moved = np.abs(respond(model, experiment, changed, derivative=False).position - still).max(axis=1)
            if name.startswith(("load_direction", "link_mass")):
                assert moved[unloaded].max() > 1e-8 or name == "link_mass.link1"  # upright axis
            else:
                assert not moved[unloaded].any(), name
                acts = experiment.wrench is not None or not name.startswith("force_sensor_bias")
                assert bool(moved[~unloaded].any()) == acts, name


def test_a_measured_wrench_minus_its_bias_is_the_true_one():
    rng = np.random.default_rng(2)
    study = kr270_study(loads=LOADS, effects=("joint_compliance", "force_sensor_bias"))
    model, bias = model_of(study), np.array([20.0, -10.0, 15.0, 2.0, -3.0, 1.0])
    true = with_wrenches(study, experiment_of(study, poses(study, 4, rng)), rng)
    read = replace(true, wrench=np.where(true.shot_unloaded[:, None], 0.0, true.wrench + bias))
    values = values_of(model, COMPLIANCE)
    expected = respond(model, true, values, derivative=False).position
    values[-6:] = bias
    np.testing.assert_allclose(respond(model, read, values, derivative=False).position, expected, atol=1e-14)


def test_scale_and_level_multiply_measured_wrenches_and_a_tilt_of_gravity_does_not_turn_them():
    rng = np.random.default_rng(3)
    study = kr270_study(
        masses=False, loads=LOADS, effects=("joint_compliance", "load_scale", "load_level@L2", "load_direction")
    )
    model = model_of(study)
    experiment = with_wrenches(study, experiment_of(study, poses(study, 4, rng)), rng)
    given = {"load_scale.all": 5.0, "load_level.L2": -10.0, "load_direction.x": 20.0, "load_direction.y": 9.0}
    factor = np.where(experiment.shot_load == 2, 1.05 * 0.9, 1.05)[:, None]
    larger = replace(experiment, wrench=experiment.wrench * factor)
    found = respond(model, experiment, values_of(model, {**COMPLIANCE, **given}), derivative=False)
    expected = respond(model, larger, values_of(model, COMPLIANCE), derivative=False)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-14)


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
def test_a_tilt_of_gravity_is_a_robot_mounted_otherwise_in_the_world(equilibrium):
    """Turning gravity by R in the world is turning the base by R'."""
    rng = np.random.default_rng(6)
    effects = ("joint_compliance", "load_direction")
    tilted = kr270_study(mount=TILT, loads=(UNLOADED, WEIGHT), effects=effects, equilibrium=equilibrium)
    back = rotation_of(np.array([0.012, -0.02, 0.0])).T
    other = replace(tilted, robot=replace(tilted.robot, world_R_base=back @ tilted.robot.world_R_base))
    model, q = model_of(tilted), poses(tilted, 5, rng)
    given = {"load_direction.x": 12.0, "load_direction.y": -20.0}
    found = respond(model, experiment_of(tilted, q), values_of(model, {**COMPLIANCE, **given}))
    expected = respond(model_of(other), experiment_of(other, q), values_of(model, COMPLIANCE))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-13)
    straight = respond(model, experiment_of(tilted, q), values_of(model, COMPLIANCE))
    assert np.abs(found.position - straight.position).max() > 1e-5


def test_masses_and_first_moments_are_those_of_another_robot_even_at_and_below_zero():
    rng = np.random.default_rng(7)
    effects = ("joint_compliance", "link_mass")
    study = kr270_study(effects=effects, options=MOMENTS, frame_free=False, markers_fitted=False)
    model, experiment = model_of(study), experiment_of(study, poses(study, 4, rng))

    def position(given):
        return respond(model, experiment, values_of(model, {**COMPLIANCE, **given}), derivative=False).position

    heavier = replace(study.robot, masses=study.robot.masses + 25.0 * np.eye(6)[2])
    centres = study.robot.centres.copy()
    centres[2] += [0.02, -0.03, 0.01]
    shifted = replace(study, robot=replace(heavier, centres=centres))
    expected = respond(model_of(shifted), experiment, values_of(model, COMPLIANCE), derivative=False).position
    mass = float(heavier.masses[2])
    moment = {"link_mass.link3.mx": 0.02 * mass, "link_mass.link3.my": -0.03 * mass, "link_mass.link3.mz": 0.01 * mass}
    np.testing.assert_allclose(position({"link_mass.link3": 25.0, **moment}), expected, atol=1e-13)
    at = {size: position({"link_mass.link3": size, **moment}) for size in (0.0, -180.0, -360.0)}
    np.testing.assert_allclose(at[-360.0] - at[-180.0], at[-180.0] - at[0.0], atol=1e-12)


TRUTHS = [
    (("load_com",), {"load_com.x": 18.0, "load_com.y": -11.0, "load_com.z": 25.0}),
    (("load_level",), {"load_level.L1": 2.5, "load_level.L2": -4.0}),
    (("load_scale",), {"load_scale.all": 2.0}),
    (("load_direction",), {"load_direction.x": 8.0, "load_direction.y": -5.0}),
    (("link_mass@link2", "link_mass@link3"), {"link_mass.link2": 40.0, "link_mass.link3": -15.0}),
    (("force_sensor_bias",), {f"force_sensor_bias.{c}": v for c, v in (("fz", 20.0), ("fx", -12.0), ("my", 4.0))}),
]  # fmt: skip


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
@pytest.mark.parametrize(("effects", "truth"), TRUTHS, ids=lambda item: item[0] if isinstance(item, tuple) else "")
def test_a_simulated_truth_is_found_within_its_intervals(effects, truth, equilibrium):
    rng = np.random.default_rng(17)
    quiet = Noise(reading=0.02e-3, pose_jitter=3e-6, reading_jitter=1.5e-6)
    study = kr270_study(loads=LOADS, effects=("joint_compliance", *effects), equilibrium=equilibrium, noise=quiet)
    experiment = experiment_of(study, poses(study, 25, rng))
    if "force_sensor_bias" in effects:
        experiment = with_wrenches(study, experiment, rng)
    data = readings(study, experiment, {**COMPLIANCE, **truth}, rng)
    found = identify(study, data)
    assert found.reference == "absolute"
    std = np.sqrt(np.diag(found.covariance))
    for name in found.model.names[15:]:
        index = found.model.names.index(name)
        true = {**COMPLIANCE, **truth}.get(name, 0.0)
        assert index in found.kept, name
        assert abs(found.values[index] - true) < 4.0 * std[index], (name, found.values[index], true, std[index])
    largest = max(truth, key=lambda name: abs(truth[name]))
    assert std[found.model.names.index(largest)] < 0.3 * abs(truth[largest])


def test_changes_between_loads_cannot_tell_a_scale_of_all_loads_from_compliances():
    rng = np.random.default_rng(8)
    study = kr270_study(
        loads=LOADS, effects=("joint_compliance", "load_scale", "link_mass@link2"), reference="differences"
    )
    experiment = experiment_of(study, poses(study, 20, rng))
    found = identify(study, readings(study, experiment, {**COMPLIANCE, "load_scale.all": 2.0}, rng, noise=NOISE))
    told = {
        found.model.names[d.column]: why_not(found.model, d)
        for d in found.fit.identifiability.dropped
        if found.fit.fitted[d.column]
    }
    assert "exactly like joint_compliance.j1, joint_compliance.j2" in told["load_scale.all"]
    assert "changes between loads hide self-weight" in told["link_mass.link2"]
    assert found.parameters["joint_compliance.j2"] == pytest.approx(1.02 * COMPLIANCE["joint_compliance.j2"], rel=0.01)


def test_unknown_masses_are_named_with_the_remedy():
    rng = np.random.default_rng(9)
    study = kr270_study(masses=False, effects=("joint_compliance", "link_mass", "load_direction"))
    model, experiment = model_of(study), experiment_of(study, poses(study, 3, rng))
    derivative = respond(model, experiment, values_of(model, {**COMPLIANCE, "link_mass.link2": 10.0})).derivative
    column = model.names.index("link_mass.link2")
    assert not derivative[:, :, column].any()
    why = why_not(model, Dropped(column, (), np.zeros(0)))
    assert "the mass of link1, link2, link3" in why
    assert "state mass and centre of mass of every link in the robot file" in why
    loaded = ~experiment.shot_unloaded[experiment.row_shot]
    tilt = derivative[:, :, model.names.index("load_direction.x")]
    assert tilt[loaded].any()
    assert not tilt[~loaded].any()
    parameter = model.parameters[column]
    assert np.isnan(parameter.typical)
    assert parameter.plausible == parameter.limit == np.inf


def test_a_bias_without_wrench_columns_and_loads_on_a_rigid_arm_are_explained():
    rng = np.random.default_rng(10)
    study = kr270_study(effects=("joint_compliance", "force_sensor_bias", *OF_LOADS))
    found = identify(study, readings(study, experiment_of(study, poses(study, 12, rng)), COMPLIANCE, rng))
    told = {found.model.names[d.column]: why_not(found.model, d) for d in found.fit.identifiability.dropped}
    assert "no loaded reading has a measured wrench (columns fx_N ... mz_Nm" in told["force_sensor_bias.mz"]
    rigid = model_of(study)
    response = respond(rigid, experiment_of(study, poses(study, 3, rng)), rigid.nominal)
    where = slice(15 + 6, None)
    assert not response.derivative[:, :, where].any()
    for name in ("load_com.x", "load_level.L1", "load_scale.all"):
        why = why_not(rigid, Dropped(rigid.names.index(name), (), np.zeros(0)))
        assert "state compliances under [model.nominal]" in why


def test_default_places_are_the_loaded_loads_or_all_where_none_is_stated():
    def names(loads, *effects):
        return [p.name for p in model_of(kr270_study(loads=loads, effects=effects)).parameters if not p.nuisance]

    assert names(LOADS, "load_level") == ["load_level.L1", "load_level.L2", "load_level.L3"]
    assert names(LOADS, "load_level@L3", "load_level@L1") == ["load_level.L1", "load_level.L3"]
    assert names((UNLOADED, LoadCase("S")), "load_level") == ["load_level.L0", "load_level.S"]


def test_sizes_are_those_of_the_link_or_the_cause():
    study = kr270_study(effects=ALL, options=MOMENTS)
    sizes = {p.name: (p.unit, p.typical, p.plausible) for p in model_of(study).parameters}
    assert sizes["link_mass.link2"] == ("kg", pytest.approx(32.0), pytest.approx(96.0))
    assert sizes["link_mass.link2.mx"] == ("kg m", pytest.approx(16.0), pytest.approx(64.0))
    assert np.isnan(sizes["link_mass.link1"][1])  # the made-up first link weighs nothing
    assert sizes["load_com.z"] == ("mm", 20.0, 100.0)
    assert sizes["load_level.L1"] == ("%", 3.0, 20.0)
    assert sizes["load_direction.y"] == ("mrad", 10.0, 35.0)


@pytest.mark.parametrize(
    ("effect", "options", "words"),
    [
        ("link_mass@link0", {}, "link_mass@link0: no such place; allowed are link1 ... link6"),
        ("link_mass", {"components": ["ixx"]}, r"components = \['ixx'\]: a list of mass, mx, my, mz expected"),
        ("load_com@L1", {}, "load_com@L1: no such place; it has no places, write load_com"),
        ("load_com", {"axes": 1}, r"\[model.load_com\] axes: unknown key; this effect has no options"),
        ("load_level@L9", {}, "load_level@L9: no such place; allowed: L0, L1, L2, L3"),
        ("load_scale@L1", {}, "load_scale@L1: no such place; allowed: all"),
        ("load_direction@x", {}, "it has no places"),
        ("force_sensor_bias@flange", {}, "it has no places"),
    ],
)
def test_what_is_wrong_is_said(effect, options, words):
    with pytest.raises(InputError, match=words) as caught:
        bind_effects((effect,), kr270(), options={effect.partition("@")[0]: options}, loads=LOADS)
    assert caught.value.exit_code == 2


def test_levels_of_no_loads_are_refused():
    with pytest.raises(InputError, match="the study has no loads whose size could be wrong"):
        bind_effects(("load_level",), kr270())


def test_exact_readings_give_exact_values_of_many_at_once():
    """Everything together, no noise: the fit ends where the truth is."""
    rng = np.random.default_rng(12)
    study = kr270_study(
        loads=LOADS, effects=("joint_compliance", "load_com", "load_level@L2", "load_direction", "link_mass@link3")
    )
    truth = {
        "load_com.x": 12.0,
        "load_com.z": -9.0,
        "load_level.L2": 3.0,
        "load_direction.y": 6.0,
        "link_mass.link3": 20.0,
    }
    data = readings(
        study,
        experiment_of(study, poses(study, 20, rng)),
        {**COMPLIANCE, **truth},
        rng,
        noise=replace(EXACT, reading=1e-9),
    )
    found = identify(study, data)
    for name, value in {**COMPLIANCE, **truth}.items():
        assert found.parameters[name] == pytest.approx(value, rel=1e-3), name
