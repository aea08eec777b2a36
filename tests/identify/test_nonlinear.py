"""Joints that harden, wind up, have play or stick: formulas, exact slopes, known truths, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from identify.effects import REGISTRY, bind_effects, build_scene
from identify.errors import InputError
from identify.identification import identify
from identify.kinematics import forward
from identify.loads import LoadCase
from identify.model import model_of
from identify.response import effect_columns, respond
from identify.robot_files import load_robot
from tests.identify.studies import (
    COMPLIANCE,
    LIGHT,
    PLATE,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270,
    kr270_study,
    measured,
    poses,
    random_robot,
    readings,
    study_of,
    values_of,
)

NONLINEAR = ("joint_hardening", "joint_windup", "backlash", "stiction")
ARM = np.array([0.3, 0.1, -0.2])
LADDER = (
    UNLOADED,
    LoadCase("A", mass=20.0, attach=ARM),
    LoadCase("B", mass=90.0, attach=ARM),
    WEIGHT,
    LoadCase("C", attach=np.array([0.3, 0.1, 0.1]), force=np.array([200.0, -700.0, 900.0])),
)
SLIDES = (False, True, False, False)


def placed(robot, *effects, **changes):
    """A study with frame and markers known."""
    given = {"loads": (UNLOADED, WEIGHT, SIDE), "frame_free": False, "markers_fitted": False}
    return study_of(robot, effects=effects, **given | changes)


def robot_of(kind, rng):
    return kr270() if kind == "heavy" else random_robot(rng, SLIDES)


def scene_of(study, count=7, seed=1):
    experiment = experiment_of(study, poses(study, count, np.random.default_rng(seed)))
    return build_scene(experiment, forward(study.robot, experiment.q), PLATE.positions, self_weight=True)


def torques(scene):
    """(S, n) of load and self-weight, and of the load alone, by virtual work: turned joints lift points.

    The load acts on the flange; its force does work when a joint moves, and so do the weights of the links it carries.
    """
    frames, robot, experiment = scene.frames, scene.frames.robot, scene.experiment
    total, loads = np.zeros((2, len(experiment.shot_load), robot.n))
    gravity = robot.gravity * (robot.world_R_base.T @ [0.0, 0.0, -1.0])
    for shot, (pose, case) in enumerate(zip(experiment.shot_pose, experiment.shot_load, strict=True)):
        load, turn = experiment.loads[case], frames.flange_rotation[pose]
        to_base = turn if load.in_flange else robot.world_R_base.T
        force, moment = to_base @ load.force + load.mass * gravity, to_base @ load.moment
        point, tool = (turn @ place + frames.flange_origin[pose] for place in (load.attach, robot.tool_centre))
        for joint in range(robot.n):
            axis, origin = frames.rotation[pose, joint, :, 2], frames.origin[pose, joint]

            def moves(at, axis=axis, origin=origin, slides=robot.prismatic[joint]):
                return axis if slides else np.cross(axis, at - origin)

            spin = 0.0 if robot.prismatic[joint] else axis @ moment
            loads[shot, joint] = moves(point) @ force + spin
            weight = sum(moves(frames.centre[pose, k]) @ gravity * robot.masses[k] for k in range(joint, robot.n))
            total[shot, joint] = loads[shot, joint] + weight + moves(tool) @ gravity * robot.tool_mass
    return total, loads


def expected_angle(name, total, loads, values, compliance):
    """One joint's angle by the formulas, SI."""
    if name == "joint_hardening":
        return values[0] * 1e-6 * (total / 1e3) ** 3
    if name == "joint_windup":
        return values[0] * 1e-6 * np.tanh(total / values[1])
    if name == "backlash":
        return values[0] * 1e-6 * np.where(total > 0, 1.0, np.where(total < 0, -1.0, 0.0))
    return -compliance * np.minimum(np.maximum(loads, -values[0]), values[0])


SIZES = {"joint_hardening": (-4.0,), "joint_windup": (90.0, 250.0), "backlash": (70.0,), "stiction": (60.0,)}


@pytest.mark.parametrize("kind", ["heavy", "crooked"])
@pytest.mark.parametrize("name", NONLINEAR)
def test_every_joint_moves_as_its_formula_says(name, kind):
    robot = robot_of(kind, np.random.default_rng(6))
    options = {"joint_windup": {"fit_knee": True}}
    model = model_of(placed(robot, "joint_compliance", name, options=options))
    scene = scene_of(placed(robot))
    values = np.tile(SIZES[name], robot.n)
    if name == "stiction":
        values = np.r_[values, np.full(robot.n, 1.7)]
    moved = model.effects[1].displacement(scene, values)
    total, loads = torques(scene)
    rows = scene.experiment.row_shot
    angle = expected_angle(name, total, loads, SIZES[name], 1.7e-6)
    # joint 1 of an upright arm under vertical loads: nothing but rounding, which has no sign
    angle[np.abs(total) < 1e-6 * np.abs(total).max()] *= 0.0 if name in {"backlash", "joint_windup"} else 1.0
    expected = np.einsum("rji,rj->ri", scene.joints.motion, angle[rows])
    np.testing.assert_allclose(moved, expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["heavy", "crooked"])
@pytest.mark.parametrize("knee", [300.0, 2.0, -50.0])
def test_derivatives_are_exact_also_by_borrowed_compliance_and_knees_below_the_smallest(kind, knee):
    robot = robot_of(kind, np.random.default_rng(6))
    options = {"joint_windup": {"knee_Nm": 300.0, "knee_N": 300.0, "fit_knee": True}}
    study = placed(robot, *NONLINEAR, "joint_compliance", options=options)
    model, rng = model_of(study), np.random.default_rng(2)
    scene = scene_of(study)
    wide = {"joint_hardening": 5.0, "joint_windup": 80.0, "backlash": 80.0, "stiction": 40.0, "joint_compliance": 2.0}
    values = np.array([wide[name.split(".")[0]] for name in model.names]) * rng.uniform(-1.2, 1.2, len(model.names))
    values[[name.endswith("knee") for name in model.names]] = knee
    found = effect_columns(model, scene, values)
    for i, name in enumerate(model.names):
        step = 1e-5 * np.eye(len(values))[i] * max(abs(values[i]), 1.0)
        high, low = (respond(model, scene.experiment, values + sign * step).deflection for sign in (1, -1))
        expected = (high - low) / (2 * step[i])
        np.testing.assert_allclose(
            found[:, :, i], expected, rtol=0, atol=1e-5 * np.abs(expected).max() + 1e-13, err_msg=name
        )


def test_friction_of_zero_shows_its_slope_and_continues_oddly():
    study = placed(kr270(), "joint_compliance", "stiction@j2")
    effect, scene = model_of(study).effects[1], scene_of(study)
    step = 1e-3
    at_zero = effect.derivative(scene, np.array([0.0, 0.3]))[:, :, 0]
    ahead, behind = (effect.displacement(scene, np.array([size, 0.3])) for size in (step, -step))
    assert np.abs(at_zero).max() > 1e-7
    np.testing.assert_allclose(at_zero, ahead / step, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(ahead, -behind)
    assert not at_zero[scene.experiment.row_shot % 3 == 0].any()  # nothing hangs there


def test_torques_that_are_only_rounding_have_no_sign():
    study = placed(kr270(), "backlash@j1", "joint_windup@j1", loads=(UNLOADED, WEIGHT, LIGHT))
    tilted = placed(kr270(mount=(1e-7, 0.0, 0.0)), "backlash@j1", loads=study.loads)
    for some in (study, tilted):
        scene, model = scene_of(some), model_of(some)
        assert np.abs(scene.joints.torque[:, 0]).max() < 2e-3
        assert not effect_columns(model, scene, model.nominal).any()
    leaning = placed(kr270(mount=(0.01, 0.0, 0.0)), "backlash@j1", loads=study.loads)
    assert effect_columns(model_of(leaning), scene_of(leaning), np.zeros(1)).any()
    result = identify(
        kr270_study(effects=("joint_compliance", "backlash")), measured(kr270_study(), np.random.default_rng(0))
    )
    why = {result.model.names[d.column]: d for d in result.fit.identifiability.dropped}
    assert not why["backlash.j1"].alike


TRUTHS = {
    "joint_hardening": {"joint_hardening.j2": -2.0, "joint_hardening.j3": -5.0},
    "joint_windup": {"joint_windup.j2.amplitude": 90.0, "joint_windup.j3.amplitude": -60.0},
    "knees": {
        "joint_windup.j2.amplitude": 90.0, "joint_windup.j3.amplitude": 70.0,
        "joint_windup.j2.knee": 700.0, "joint_windup.j3.knee": 250.0,
    },
    "backlash": {"backlash.j2": 50.0, "backlash.j3": 80.0},
    "stiction": {"stiction.j2": 150.0, "stiction.j3": 90.0},
}  # fmt: skip


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("case", TRUTHS)
def test_a_known_truth_is_recovered_from_loads_of_several_sizes(case, reference):
    name = "joint_windup" if case == "knees" else case
    options = {"joint_windup": {"knee_Nm": 400.0, "fit_knee": case == "knees"}}
    effects = ("joint_compliance", f"{name}@j2", f"{name}@j3")
    study = kr270_study(effects=effects, loads=LADDER, options=options, reference=reference)
    truth = COMPLIANCE | TRUTHS[case]
    data = measured(study, np.random.default_rng(5), count=40, values=truth)
    result = identify(study, data)
    asked = [i for i in result.kept if not result.model.parameters[i].nuisance]
    assert {result.model.names[i] for i in asked} == set(truth)
    std = np.sqrt(np.diag(result.covariance)[asked])
    z = (result.values[asked] - [truth[result.model.names[i]] for i in asked]) / std
    assert np.abs(z).max() < 4.0
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.8
    sizes = np.array([truth[result.model.names[i]] for i in asked])
    assert (std < 0.2 * np.abs(sizes))[6:].all()  # the intervals say something
    assert result.lack_of_fit.p_value > 1e-3


def test_friction_in_all_joints_ends_at_an_edge_from_which_nothing_descends():
    """The sum of squares has an edge wherever a friction equals a torque; fits used to run out of steps there."""
    study = kr270_study(effects=("joint_compliance", "stiction"), loads=LADDER, reference="differences")
    truth = COMPLIANCE | {"stiction.j2": 150.0, "stiction.j3": 90.0, "stiction.j5": 20.0}
    result = identify(study, measured(study, np.random.default_rng(0), count=40, values=truth))
    std = np.sqrt(np.diag(result.covariance))
    for i, name in enumerate(result.model.names):
        if name.startswith("stiction"):
            assert abs(result.values[i] - truth.get(name, 0.0)) < 4 * std[i]
    assert result.lack_of_fit.p_value > 1e-3


@pytest.mark.parametrize("start", [50.0, 400.0])
@pytest.mark.parametrize("reference", ["absolute", "differences"])
def test_play_fitted_as_windup_gives_the_amplitude_and_no_false_knee(start, reference):
    """A knee that runs towards zero loses its column; it is then reported, not a fault."""
    options = {"joint_windup": {"knee_Nm": start, "fit_knee": True}}
    truth = kr270_study(effects=("joint_compliance", "backlash@j2"), loads=LADDER)
    study = kr270_study(
        effects=("joint_compliance", "joint_windup@j2"), loads=LADDER, options=options, reference=reference
    )
    rng = np.random.default_rng(1)
    data = readings(truth, experiment_of(truth, poses(truth, 40, rng)), COMPLIANCE | {"backlash.j2": 80.0}, rng)
    result = identify(study, data)
    assert result.parameters["joint_windup.j2.amplitude"] == pytest.approx(80.0, abs=8.0)
    knee = result.model.names.index("joint_windup.j2.knee")
    spread = result.covariance[knee, knee] ** 0.5
    if knee in result.kept:
        assert result.values[knee] - 2 * spread < 20.0
    else:
        assert result.values[knee] == start


def test_loaded_equilibrium_adds_them_at_first_order():
    effects = ("joint_compliance", *NONLINEAR)
    given = {"joint_hardening.j2": -3.0, "joint_windup.j3.amplitude": 80.0, "backlash.j5": 90.0, "stiction.j2": 100.0}
    moved = {}
    for equilibrium in ("linear", "loaded"):
        for values in (COMPLIANCE, COMPLIANCE | given):
            study = placed(kr270(), *effects, equilibrium=equilibrium)
            model, experiment = model_of(study), experiment_of(study, poses(study, 5, np.random.default_rng(3)))
            response = respond(model, experiment, values_of(model, values))
            assert np.isfinite(response.derivative).all()
            moved[equilibrium, len(values)] = response.deflection
    more, less = len(COMPLIANCE | given), len(COMPLIANCE)
    added = [moved[kind, more] - moved[kind, less] for kind in ("linear", "loaded")]
    assert np.abs(added[0]).max() > 1e-4
    np.testing.assert_allclose(added[1], added[0], atol=1e-15)
    assert np.abs(moved["loaded", less] - moved["linear", less]).max() > 1e-5


def test_names_units_and_sizes():
    robot = load_robot("ur10")
    effects = bind_effects(("joint_compliance", *NONLINEAR), robot)[1:]
    by_name = {p.name: p for effect in effects for p in effect.parameters}
    assert len(by_name) == 4 * robot.n
    assert by_name["joint_hardening.j2"].unit == "urad/kNm^3"
    assert by_name["joint_hardening.j2"].plausible == np.inf
    assert (by_name["joint_windup.j2.amplitude"].unit, by_name["joint_windup.j2.amplitude"].plausible) == ("urad", 600)
    assert (by_name["backlash.j2"].unit, by_name["backlash.j2"].plausible) == ("urad", 600)
    assert (by_name["stiction.j1"].unit, by_name["stiction.j1"].plausible) == ("Nm", pytest.approx(33.0))
    unknown = bind_effects(("joint_compliance", "stiction"), kr270())[1].parameters[0]
    assert unknown.plausible == 1000.0
    sliding = bind_effects(
        NONLINEAR[:3], random_robot(np.random.default_rng(0), SLIDES), options={"joint_windup": {"fit_knee": True}}
    )
    units = [[p.unit for p in effect.parameters if ".j2" in p.name] for effect in sliding]
    assert units == [["um/kN^3"], ["um", "N"], ["um"]]


def test_sizes_beyond_which_other_effects_explain_nothing():
    found = {
        (p.name.split(".")[0], p.unit): p.plausible
        for effect in bind_effects(
            ("geometry", "base_compliance", "tool_compliance", "joint_compliance"),
            kr270(),
            options={"base_compliance": {"components": ["x", "ry"]}},
        )
        for p in effect.parameters
    }
    assert found == {
        ("geometry", "mm"): 5.0, ("geometry", "mrad"): 5.0, ("base_compliance", "um/N"): np.inf,
        ("base_compliance", "urad/Nm"): 5.0, ("tool_compliance", "urad/Nm"): 50.0,
        ("joint_compliance", "urad/Nm"): np.inf,
    }  # fmt: skip


def test_the_usual_knee_is_a_tenth_of_what_the_joint_is_rated_for():
    def knees(robot, **options):
        windup = {"fit_knee": True, **options}
        return [
            p.nominal for p in bind_effects(("joint_windup",), robot, options={"joint_windup": windup})[0].parameters
        ][1::2]

    np.testing.assert_allclose(knees(load_robot("ur10")), [33.0, 33.0, 15.0, 5.6, 5.6, 5.6])
    heavy = knees(kr270())
    assert 400 < heavy[1] < 1200
    assert (np.diff(heavy) <= 0).all()
    assert knees(replace(kr270(), payload=np.nan)) == [100.0] * 6
    assert knees(kr270(), knee_Nm=250, j3={"knee_Nm": 40.0})[:3] == [250.0, 250.0, 40.0]


def test_only_the_amplitude_is_fitted_unless_the_knee_is_asked_for():
    (effect,) = bind_effects(("joint_windup@j3",), kr270())
    assert [p.name for p in effect.parameters] == ["joint_windup.j3.amplitude"]


def test_friction_sits_where_joints_yield():
    names = [p.name for p in bind_effects(("joint_compliance@j3", "stiction"), kr270())[1].parameters]
    assert names == ["stiction.j3"]
    for effects in (("joint_compliance@j3", "stiction@j2"), ("stiction@j2", "geometry")):
        with pytest.raises(
            InputError, match=r"stiction@j2: nothing in this model lets joint 2 yield.*add joint_compliance@j2"
        ):
            bind_effects(effects, kr270())
    with pytest.raises(InputError, match="add joint_compliance@j1"):
        bind_effects(("stiction",), kr270())


@pytest.mark.parametrize(
    ("entry", "options", "words"),
    [
        ("backlash@j7", {}, "backlash@j7: no such place; allowed are j1 ... j6"),
        ("backlash", {"gap": 1.0}, r"\[model.backlash\] gap: unknown key; backlash has no options"),
        ("stiction", {"gap": 1.0}, "stiction has no options"),
        ("joint_hardening", {"power": 3}, "power: unknown key; allowed: saturation_Nm, saturation_N"),
        ("joint_hardening", {"saturation_Nm": 0}, "saturation_Nm = 0: a finite number above 0"),
        ("joint_windup", {"knee": 3}, "knee: unknown key; allowed: knee_Nm, knee_N, fit_knee"),
        ("joint_windup", {"knee_Nm": 0}, r"\[model.joint_windup\] knee_Nm = 0: a number above 0"),
        ("joint_windup", {"knee_Nm": -5.0}, "knee_Nm = -5.0: a number above 0"),
        ("joint_windup", {"knee_Nm": "soft"}, "knee_Nm = 'soft'"),
        ("joint_windup", {"knee_Nm": True}, "knee_Nm = True"),
        ("joint_windup", {"fit_knee": 1}, "fit_knee = 1: true or false"),
        ("joint_windup", {"j3": {"knees": 1}}, "knees: unknown key"),
        ("joint_windup", {"link3": {"knee_Nm": 1}}, "link3: unknown key"),
    ],
)
def test_wrong_options_are_bad_input(entry, options, words):
    with pytest.raises(InputError, match=words) as caught:
        bind_effects(("joint_compliance", entry), kr270(), options={entry.partition("@")[0]: options})
    assert caught.value.exit_code == 2


def test_a_column_of_zeros_is_explained():
    options = {"joint_windup": {"fit_knee": True}}
    bound = {e.name: e for e in bind_effects(("joint_compliance", *NONLINEAR), kr270(), options=options)}
    for name in ("joint_hardening", "backlash", "joint_windup"):
        assert "nothing in these data puts a torque on joint 1" in bound[name].why_zero(0)
    assert "state joint_windup.j1.amplitude under [model.nominal]" in bound["joint_windup"].why_zero(1)
    assert "state joint_compliance.j2 under [model.nominal]" in bound["stiction"].why_zero(1)
    assert set(NONLINEAR) <= set(REGISTRY)


def test_hardening_that_saturates_is_the_cube_below_and_linear_above_its_torque():
    options = {"joint_hardening": {"j2": {"saturation_Nm": 500.0}}}
    study = placed(kr270(), "joint_hardening@j2", options=options)
    model, scene = model_of(study), scene_of(study)
    torque, moved = scene.joints.torque[:, 1], model.effects[0].displacement(scene, np.array([2.0]))
    angle = 2.0e-15 * torque**3 / (1.0 + (torque / 500.0) ** 2)
    assert np.abs(torque).max() > 1000.0
    expected = scene.joints.motion[:, 1] * angle[scene.experiment.row_shot, None]
    np.testing.assert_allclose(moved, expected, rtol=1e-10, atol=1e-15)
