"""The gravity compensator: against its energy, exact derivatives, the published counts, known truths, bad input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from identify.effects import bind_effects, build_scene
from identify.effects.compensator import nearest_level
from identify.effects.joint_turns import axis_compliance
from identify.errors import InputError, NotIdentifiable
from identify.experiment import full_experiment
from identify.gravity_spring import SpringGeometry, spring_basis, spring_from_levels, spring_slopes
from identify.identification import identify
from identify.joint_levels import joint_levels
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import model_of
from identify.response import effect_columns, respond
from identify.robot_files import load_robot
from identify.simulate import simulate
from identify.study import Noise, Study

LEVELS = [-100.0, -75.0, -50.0, -25.0, -5.0]
MARKERS = Markers(
    ("M1", "M2", "M3"), np.array([[0.18, 0.0, -0.17], [0.25, 0.0, 0.05], [0.02, 0.09, 0.22]]), np.zeros(3, dtype=bool)
)
LOADS = (LoadCase("L0"), LoadCase("L1", mass=250.0, attach=np.array([0.3, 0.05, -0.1])))
SPRING = {"a_x_mm": 685.9, "a_y_mm": 121.0, "radius_mm": 184.7}  # level of a KR 270 (recalled)
FIXED = ("joint_compliance", "gravity_compensator@j2")


def energy(k_c, s_0, geometry, q):
    """Of the spring between two anchors, by their places in the plane."""
    moving = geometry.radius * np.array([np.cos(q), np.sin(q)])
    length = np.linalg.norm(moving.T + np.array([geometry.a_x, geometry.a_y]), axis=-1)
    return k_c / 2 * (length - s_0) ** 2


# --- the spring


def test_published_check_value():
    geometry = SpringGeometry(0.7 * np.cos(0.17), 0.7 * np.sin(0.17), 0.18)
    stiffness = spring_basis(geometry, np.array([-0.9]))[1, 0] @ [1.3, 1.3 * 0.45]
    assert stiffness == pytest.approx(-0.0206758, abs=5e-8)


def test_published_formulas():
    rng = np.random.default_rng(0)
    q = rng.uniform(-3, 3, 50)
    a, radius, s_0, alpha, k_c = 0.7, 0.18, 0.45, 0.17, 1.3
    phi = alpha - q
    s = np.sqrt(a**2 + radius**2 + 2 * a * radius * np.cos(phi))
    eta = (s_0 / s) * ((a * radius / s**2) * np.sin(phi) ** 2 + np.cos(phi)) - np.cos(phi)
    moment = k_c * (1 - s_0 / s) * a * radius * np.sin(phi)
    found = spring_basis(SpringGeometry(a * np.cos(alpha), a * np.sin(alpha), radius), q) @ [k_c, k_c * s_0]
    np.testing.assert_allclose(found, [moment, k_c * a * radius * eta], atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_torque_and_stiffness_are_derivatives_of_the_energy(seed):
    rng = np.random.default_rng(seed)
    geometry = SpringGeometry(*rng.uniform(-0.8, 0.8, 2), rng.uniform(0.1, 0.3))
    k_c, s_0, q, h = rng.uniform(1, 5), rng.uniform(0.2, 0.6), rng.uniform(-3, 3, 30), 1e-3
    u = [energy(k_c, s_0, geometry, q + step * h) for step in (-2, -1, 0, 1, 2)]
    slope = (u[0] - 8 * u[1] + 8 * u[3] - u[4]) / (12 * h)
    bend = (-u[0] + 16 * u[1] - 30 * u[2] + 16 * u[3] - u[4]) / (12 * h**2)
    moment, stiffness = spring_basis(geometry, q) @ [k_c, k_c * s_0]
    np.testing.assert_allclose(moment, slope, atol=1e-8)
    np.testing.assert_allclose(stiffness, bend, atol=1e-6)


def test_slopes_by_the_geometry_are_exact():
    q, place = np.linspace(-3, 3, 20), np.array([0.65, 0.1, 0.18])
    found = spring_slopes(SpringGeometry(*place), q)
    for i in range(3):
        high, low = (spring_basis(SpringGeometry(*(place + step * np.eye(3)[i])), q) for step in (1e-6, -1e-6))
        np.testing.assert_allclose(found[..., i], (high - low) / 2e-6, atol=1e-8)


# --- the effect


def scene_of(robot, q, loads=LOADS):
    experiment = full_experiment(q, np.tile(np.arange(len(loads)), (len(q), 1)), loads, MARKERS)
    return build_scene(experiment, forward(robot, q), MARKERS.positions, self_weight=robot.masses_known)


def study_of(robot, effects=FIXED, loads=LOADS, **options):
    noise = options.pop("noise", Noise(reading=3e-5))
    settings = {
        key: options.pop(key) for key in ("reference", "nominal", "frame_free", "markers_fitted") if key in options
    }
    settings = {"reference": "differences"} | settings
    return Study(
        Path("study.toml"),
        robot,
        loads,
        MARKERS,
        noise,
        effects=effects,
        options={"gravity_compensator": options},
        **settings,
    )


def weighing(robot):
    """The same robot with link masses."""
    masses = np.array([400.0, 300.0, 250.0, 60.0, 40.0, 20.0])
    centres = np.array([[0.1, 0, -0.1], [0.5, 0, 0.1], [0.3, 0, 0], [0.2, 0, 0], [0, 0, 0], [0.05, 0, 0]])
    return replace(robot, masses=masses, centres=centres)


def random_values(model, seed=0):
    sizes = {"k_c": 150.0, "k_c_s0": 60000.0, "a_x": 650.0, "a_y": 130.0, "radius": 190.0}
    sizes |= {f"{kind}{order}": 3000.0 / order for kind in "sc" for order in (1, 2, 3)}
    rng = np.random.default_rng(seed)
    return np.array([
        sizes.get(name.split(".")[-1].split("_", 1)[-1] if "s1_" in name or "s2_" in name else name.split(".")[-1], 2.0)
        * rng.uniform(0.8, 1.2)
        for name in model.names
    ])


MODES = {
    "levels": {"levels_deg": LEVELS},
    "spring": SPRING,
    "free length known": SPRING | {"s0_mm": 458.0},
    "geometry fitted": SPRING | {"fit_geometry": True},
    "two springs": {"springs": [SPRING, {"a_x_mm": 600.0, "a_y_mm": -200.0, "radius_mm": 150.0, "s0_mm": 400.0}]},
    "harmonics": {"mode": "harmonics"},
    "two joints": {"j2": SPRING, "j3": {"a_x_mm": 300.0, "a_y_mm": 50.0, "radius_mm": 100.0, "fit_geometry": True}},
}


@pytest.mark.parametrize("base", [("joint_compliance",), ("link_compliance",), ("link_compliance", "joint_compliance")])
@pytest.mark.parametrize("mode", MODES)
def test_derivatives_are_exact_also_by_the_borrowed_compliance(mode, base):
    robot = weighing(load_robot("kr270_r2700"))
    where = ("gravity_compensator@j2", "gravity_compensator@j3") if mode == "two joints" else ("gravity_compensator",)
    study = study_of(robot, (where[0], *base, *where[1:]), frame_free=False, markers_fitted=False, **MODES[mode])
    model = model_of(study)
    q = np.random.default_rng(3).uniform(robot.lower, robot.upper, (6, 6))
    scene, values = scene_of(robot, q), random_values(model)
    found = effect_columns(model, scene, values)
    for i, value in enumerate(values):
        step = 1e-4 * value
        high, low = (
            respond(model, scene.experiment, values + sign * step * np.eye(len(values))[i]) for sign in (1, -1)
        )
        expected = (high.deflection - low.deflection) / (2 * step)
        np.testing.assert_allclose(found[:, :, i], expected, rtol=0, atol=1e-6 * np.abs(expected).max() + 1e-14)


def test_the_joint_settles_where_all_torques_balance():
    """Against a root finder in the angle of joint 2: motor spring, weight and load, compensator (to second order)."""
    robot = weighing(load_robot("kr270_r2700"))
    study = study_of(
        robot, ("joint_compliance@j2", "gravity_compensator"), frame_free=False, markers_fitted=False, **SPRING
    )
    model = model_of(study)
    values = np.array([2.0, 150.0, 60000.0])
    geometry = SpringGeometry(0.6859, 0.121, 0.1847)
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (8, 6))
    scene = scene_of(robot, q)
    moved = respond(model, scene.experiment, values).deflection
    for shot in range(16):
        pose, torque = scene.experiment.shot_pose[shot], scene.joints.torque[shot, 1]

        def balance(angle, pose=pose, torque=torque):
            h = 1e-5
            high, low = (energy(150e3, 0.4, geometry, q[pose, 1] + angle + step) for step in (h, -h))
            return torque - angle / 2e-6 - (high - low) / (2 * h)

        angle = brentq(balance, -0.1, 0.1)
        rows = scene.experiment.row_shot == shot
        expected = scene.joints.motion[rows, 1] * angle
        np.testing.assert_allclose(moved[rows], expected, atol=2e-3 * np.abs(expected).max())


def test_nothing_is_added_at_zero_and_in_rigid_joints():
    robot = load_robot("kr270_2")
    q = np.random.default_rng(1).uniform(-1, 1, (4, 6))
    with_spring, plain = (study_of(robot, effects, **SPRING) for effects in (FIXED, ("joint_compliance",)))
    scene = scene_of(robot, q)
    size = {name: 2.0 for name in model_of(plain).names if name.startswith("joint")}
    values = [np.array([size.get(name, 0.0) for name in model_of(study).names]) for study in (with_spring, plain)]
    both = [
        respond(model_of(s), scene.experiment, v).deflection for s, v in zip((with_spring, plain), values, strict=True)
    ]
    np.testing.assert_array_equal(*both)
    rigid = model_of(study_of(robot, nominal={"gravity_compensator.j2.k_c": 100.0}, **SPRING))
    assert not respond(rigid, scene.experiment, rigid.nominal).deflection.any()
    assert "state joint_compliance.j2 and gravity_compensator.j2.k_c under [model.nominal]" in rigid.effects[
        1
    ].why_zero(1)


def test_the_static_torque_loads_the_unloaded_state_and_cancels_in_differences_but_for_the_stiffness():
    robot = load_robot("kr270_r2700")  # masses unknown: only the spring acts in the unloaded state
    model = model_of(study_of(robot, frame_free=False, markers_fitted=False, **SPRING))
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (5, 6))
    scene = scene_of(robot, q)
    values = np.zeros(len(model.names))
    values[[1, 6, 7]] = 2.0, 150.0, 60000.0
    moved = respond(model, scene.experiment, values).deflection
    geometry = SpringGeometry(0.6859, 0.121, 0.1847)
    moment, stiffness = spring_basis(geometry, q[:, 1]) @ [150e3, 60e3]
    c_eff = 2e-6 / (1 + 2e-6 * stiffness)
    unloaded = scene.experiment.row_shot % 2 == 0
    pose = scene.row_pose
    torque = scene.joints.torque[1::2, 1]
    motion = scene.joints.motion[:, 1]
    np.testing.assert_allclose(moved[unloaded], (motion * (-c_eff * moment)[pose, None])[unloaded], atol=1e-12)
    change = moved[~unloaded] - moved[unloaded]
    np.testing.assert_allclose(change, (motion * (c_eff * torque)[pose, None])[~unloaded], atol=1e-12)


def test_what_yields_about_the_axis_is_the_joint_and_the_turning_elements_of_the_link_before_it():
    robot = load_robot("kr270_2")
    effects = bind_effects(
        ("joint_compliance", "link_compliance", "base_compliance", "tool_compliance", "joint_cross_compliance"),
        robot,
        options={"link_compliance": {"template": "symmetric"}},
    )
    shares, held = axis_compliance(effects, robot, 1)
    assert held == 0.0
    assert shares == pytest.approx({"joint_compliance.j2": 1e-6, "link_compliance.link1.k55": 1e-6})
    turned = load_robot("ur10")
    shares, _ = axis_compliance(bind_effects(("link_compliance",), turned), turned, 0)
    assert set(shares) == {"link_compliance.link0.k66"}
    constants = {"template": [], "constants": {"link1": {"k55": 0.4}}}
    stiff = bind_effects(("link_compliance",), robot, options={"link_compliance": constants})
    assert axis_compliance(stiff, robot, 1) == ({}, pytest.approx(4e-7))


# --- harmonics


def test_harmonics_turn_the_joint_as_their_torque_and_its_slope_say():
    robot = weighing(load_robot("kr270_r2700"))
    effects = ("joint_compliance@j2", "gravity_compensator")
    model = model_of(study_of(robot, effects, frame_free=False, markers_fitted=False, orders=[1, 4]))
    assert [name.split(".")[-1] for name in model.names[1:]] == ["s1", "c1", "s4", "c4"]
    assert {(p.unit, p.plausible) for p in model.parameters[1:]} == {("Nm", 20000.0)}
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (5, 6))
    scene, values = scene_of(robot, q), np.array([0.8, 4000.0, -2500.0, 300.0, 200.0])

    def torque(at):
        return 4000 * np.sin(at) - 2500 * np.cos(at) + 300 * np.sin(4 * at) + 200 * np.cos(4 * at)

    angles, h = q[scene.experiment.shot_pose, 1], 1e-5
    stiffness = (torque(angles + h) - torque(angles - h)) / (2 * h)
    turned = (scene.joints.torque[:, 1] - torque(angles)) / (1 / 0.8e-6 + stiffness)
    expected = scene.joints.motion[:, 1] * turned[scene.experiment.row_shot, None]
    np.testing.assert_allclose(respond(model, scene.experiment, values).deflection, expected, atol=1e-11)


def test_harmonics_show_at_zero_where_the_joint_yields_and_say_so_where_it_does_not():
    robot = weighing(load_robot("kr270_r2700"))
    study = study_of(robot, ("joint_compliance@j2", "gravity_compensator"), mode="harmonics")
    model = model_of(study)
    scene = scene_of(robot, np.random.default_rng(1).uniform(robot.lower, robot.upper, (5, 6)))
    values = model.nominal.copy()
    values[model.names.index("joint_compliance.j2")] = 0.5
    columns = effect_columns(model, scene, values)[:, :, model.names.index("gravity_compensator.j2.s1") :]
    assert (np.abs(columns).max(axis=(0, 1)) > 1e-8).all()
    assert "joint 2 is rigid; state joint_compliance.j2 under [model.nominal]" in model.effects[1].why_zero(0)


@pytest.mark.parametrize("reading", [1e-12, 3e-5])
def test_harmonics_are_recovered(reading):
    robot = weighing(load_robot("kr270_r2700"))
    truth = JOINTS | {f"gravity_compensator.j2.{key}": v for key, v in HARMONICS.items()}
    study = study_of(robot, reference="absolute", mode="harmonics", noise=Noise(reading=max(reading, 1e-9)))
    result = identify(study, readings(study, truth, levelled(robot, 4, np.linspace(-139, -6, 12)), reading))
    assert {name for name in result.parameters if name.startswith("gravity")} == set(truth) - set(JOINTS)
    assert_covered(result, truth)


HARMONICS = {"s1": 5000.0, "c1": -2000.0, "s2": -900.0, "c2": 400.0, "s3": 150.0, "c3": -80.0}


def test_harmonics_reproduce_the_deflections_of_a_real_spring():
    """Anchors 0.7 m and 0.18 m from the axis, joint 2 over its whole range."""
    robot = weighing(load_robot("kr270_r2700"))
    geometry = {"a_x_mm": 700 * np.cos(0.17), "a_y_mm": 700 * np.sin(0.17), "radius_mm": 180.0}
    truth = study_of(robot, ("joint_compliance", "gravity_compensator"), reference="absolute", **geometry)
    experiment = levelled(robot, 2, np.linspace(-139, -6, 20))
    data = readings(truth, JOINTS | TRUE_SPRING, experiment, 1e-9)
    spring, plain = (
        respond(model_of(truth), experiment, np.array([given.get(n, 0.0) for n in model_of(truth).names])).deflection
        for given in (JOINTS | TRUE_SPRING, JOINTS)
    )
    share = {}
    for orders in ([1], [1, 2], [1, 2, 3]):
        study = study_of(robot, FIXED, reference="absolute", frame_free=False, markers_fitted=False, orders=orders)
        result = identify(study, data)
        left = result.misfit.rms / np.sqrt(((spring - plain) ** 2).sum(axis=1).mean())
        share[len(orders)] = float(left)
    told = f"left of the spring's deflection, by orders: { {n: f'{100 * s:.3f} %' for n, s in share.items()} }"
    assert share[3] < 0.002, told
    assert share[3] < 0.3 * share[2], told
    assert share[2] < 0.3 * share[1], told


# --- published counts


def groups(columns):
    """Number of columns, rank, and how many are identifiable, not identifiable and coupled (rules of the paper)."""
    norms = np.linalg.norm(columns, axis=0)
    _, size, v = np.linalg.svd(columns / np.where(norms > 0, norms, 1.0), full_matrices=True)
    rank = int((size > 1e-9 * size[0]).sum())
    alone, unseen = (np.linalg.norm(part, axis=0) < 1e-7 for part in (v[rank:], v[:rank]))
    return columns.shape[1], rank, int(alone.sum()), int(unseen.sum()), int((~alone & ~unseen).sum())


OTHERS = tuple(f"joint_compliance@j{i}" for i in (1, 3, 4, 5, 6))


@pytest.mark.parametrize("name", ["kr270_2", "kr270_r2700"])
@pytest.mark.parametrize(
    ("effects", "counts"),
    [
        (("link_compliance",), (56, 26, 1, 10, 45)),
        (("link_compliance", "gravity_compensator@j2"), (61, 30, 1, 10, 50)),
        (("joint_compliance",), (6, 5, 5, 1, 0)),
        ((*OTHERS, "gravity_compensator@j2"), (10, 9, 9, 1, 0)),
        (("joint_compliance", "gravity_compensator@j2"), (11, 9, 4, 1, 6)),
    ],
)
def test_published_numbers_of_parameters(name, effects, counts):
    robot = load_robot(name)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (15, 6))
    q[:, 1] = np.radians(np.repeat(LEVELS, 3))
    scene = scene_of(robot, q, LOADS[1:])
    bound = bind_effects(effects, robot, options={"gravity_compensator": {"levels_deg": LEVELS}})
    columns = np.concatenate([e.derivative(scene, np.zeros(len(e.parameters))) for e in bound], axis=2)
    assert groups(columns.reshape(-1, columns.shape[2])) == counts


# --- known truths


def levelled(robot, count, levels=LEVELS, seed=4):
    q = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count * len(levels), 6))
    q[:, 1] = np.radians(np.repeat(levels, count))
    return full_experiment(q, np.tile([0, 1], (len(q), 1)), LOADS, MARKERS)


JOINTS = {f"joint_compliance.j{i}": value for i, value in enumerate((0.0, 0.5, 0.4, 3.0, 3.3, 2.4), 1)}
TRUE_SPRING = {"gravity_compensator.j2.k_c": 150.0, "gravity_compensator.j2.k_c_s0": 150.0 * 458.0}


def readings(study, truth, experiment, reading, seed=8):
    model = model_of(study)
    values = np.array([
        truth.get(name, parameter.nominal) for name, parameter in zip(model.names, model.parameters, strict=True)
    ])
    return simulate(model, values, experiment, Noise(reading=reading), np.eye(4), np.random.default_rng(seed))


def assert_covered(result, truth):
    for name, value in result.parameters.items():
        std = result.covariance[result.model.names.index(name), result.model.names.index(name)] ** 0.5
        assert abs(value - truth[name]) < 4 * std + 1e-9 * abs(truth[name]), name


@pytest.mark.parametrize("reading", [1e-12, 3e-5])
@pytest.mark.parametrize("reference", ["differences", "absolute"])
def test_the_spring_is_recovered(reference, reading):
    robot = weighing(load_robot("kr270_r2700"))
    free = reference == "absolute"  # in differences what frame and markers lack would show in so small a change
    placed = {"frame_free": free, "markers_fitted": free}
    study = study_of(robot, reference=reference, noise=Noise(reading=max(reading, 1e-9)), **placed, **SPRING)
    result = identify(study, readings(study, JOINTS | TRUE_SPRING, levelled(robot, 4), reading))
    expected = {name: value for name, value in (JOINTS | TRUE_SPRING).items() if name != "joint_compliance.j1"}
    assert list(result.parameters) == list(expected)
    assert_covered(result, expected)
    if reading < 1e-9:
        np.testing.assert_allclose(list(result.parameters.values()), list(expected.values()), rtol=1e-4)


def test_absolute_readings_know_the_spring_far_better_than_differences():
    robot = weighing(load_robot("kr270_r2700"))
    spread = {}
    for reference in ("absolute", "differences"):
        study = study_of(robot, reference=reference, **SPRING)
        result = identify(study, readings(study, JOINTS | TRUE_SPRING, levelled(robot, 4), 3e-5))
        index = result.model.names.index("gravity_compensator.j2.k_c")
        spread[reference] = result.covariance[index, index] ** 0.5
    assert spread["absolute"] < 0.05 * spread["differences"]


def test_known_free_length_leaves_one_unknown():
    robot = weighing(load_robot("kr270_r2700"))
    study = study_of(robot, reference="absolute", s0_mm=458.0, **SPRING)
    result = identify(study, readings(study, JOINTS | {"gravity_compensator.j2.k_c": 150.0}, levelled(robot, 4), 3e-5))
    assert list(result.parameters)[-1] == "gravity_compensator.j2.k_c"
    assert_covered(result, JOINTS | TRUE_SPRING)


def test_the_geometry_is_fitted_up_to_its_scale():
    """a, L -> x a, x L with K_c / x^2 and K_c s_0 / x changes nothing, so without s_0 the radius is held."""
    robot = weighing(load_robot("kr270_r2700"))
    truth = JOINTS | {"gravity_compensator.j2.k_c": 150.0, "gravity_compensator.j2.k_c_s0": 150.0 * 458.0}
    experiment = levelled(robot, 2, np.linspace(-139, -6, 12))
    data = readings(study_of(robot, reference="absolute", **SPRING), truth, experiment, 1e-8)
    wrong = {"a_x_mm": 660.0, "a_y_mm": 135.0, "fit_geometry": True}
    exact = {"noise": Noise(reading=1e-8), "reference": "absolute"}
    free = identify(study_of(robot, **exact, **SPRING | wrong), data)
    assert "gravity_compensator.j2.radius" not in free.parameters
    assert free.misfit.rms < 1e-7
    known = identify(study_of(robot, **exact, s0_mm=458.0, **SPRING | wrong | {"radius_mm": 180.0}), data)
    found = [known.parameters[f"gravity_compensator.j2.{key}"] for key in ("k_c", "a_x", "a_y", "radius")]
    np.testing.assert_allclose(found, [150.0, 685.9, 121.0, 184.7], rtol=0.02)


def test_levels_and_the_two_step_fit_recover_the_spring():
    robot = load_robot("kr270_r2700")
    placed = {"frame_free": False, "markers_fitted": False}
    spring = study_of(robot, **placed, **SPRING)
    truth = JOINTS | TRUE_SPRING
    for reading in (1e-12, 3e-5):
        data = readings(spring, truth, levelled(robot, 12), reading)
        noise = Noise(reading=max(reading, 1e-9))
        result = identify(study_of(robot, levels_deg=LEVELS, noise=noise, **placed), data)
        assert sum(name.startswith("gravity") for name in result.parameters) == 4
        found = joint_levels(result)
        geometry = SpringGeometry(0.6859, 0.121, 0.1847)
        k = spring_basis(geometry, found.q)[1] @ [150e3, 150e3 * 0.458]
        step = spring_from_levels(*found, geometry)
        expected = np.array([1 / 0.5e-6, 150e3, 150e3 * 0.458])
        error = np.array([step.stiffness, step.spring, step.preload]) - expected
        if reading < 1e-9:
            np.testing.assert_allclose(found.compliance, 1 / (1 / 0.5e-6 + k), rtol=1e-6)
            np.testing.assert_allclose(error / expected, 0, atol=1e-4)
            assert step.free_length == pytest.approx(0.458, rel=1e-4)
        else:
            assert error @ np.linalg.solve(step.covariance, error) < 16.3  # chi2, 3 degrees of freedom, 0.1 %
            assert step.dof == 2
            assert step.chi2 < 13.8


def test_two_step_covariance_is_the_scatter_of_many_draws():
    geometry, q = SpringGeometry(0.6859, 0.121, 0.1847), np.radians(LEVELS)
    true = np.array([4e5, 9e5, 4.1e5])
    compliance = 1 / (true[0] + spring_basis(geometry, q)[1] @ true[1:])
    covariance = np.diag((1e-3 * compliance) ** 2) + 1e-7 * np.outer(compliance, compliance)
    rng = np.random.default_rng(5)
    draws = [
        spring_from_levels(q, c, covariance, geometry) for c in rng.multivariate_normal(compliance, covariance, 2000)
    ]
    found = np.array([[d.stiffness, d.spring, d.preload] for d in draws])
    scale = np.sqrt(np.diag(draws[0].covariance))
    np.testing.assert_allclose(
        np.cov(found.T) / np.outer(scale, scale), draws[0].covariance / np.outer(scale, scale), atol=0.1
    )
    assert np.abs((found.mean(axis=0) - true) / scale).max() < 0.2
    assert np.mean([d.chi2 for d in draws]) == pytest.approx(2.0, abs=0.2)


def test_a_level_that_no_pose_visits_is_reported_and_left_out_of_the_second_step():
    robot = load_robot("kr270_r2700")
    spring = study_of(robot, **SPRING)
    data = readings(spring, JOINTS | TRUE_SPRING, levelled(robot, 6, LEVELS[:4]), 1e-12)
    result = identify(study_of(robot, levels_deg=LEVELS), data)
    found = joint_levels(result)
    np.testing.assert_allclose(found.q, np.radians(LEVELS[:4]))
    dropped = result.fit.identifiability.dropped
    names = [result.model.names[d.column] for d in dropped]
    assert {"gravity_compensator.j2.l4", "gravity_compensator.j2.l5"} <= set(names)
    assert "no pose of these data is nearest to the level -5 deg" in result.model.effects[1].why_zero(4)


# --- bad input


@pytest.mark.parametrize(
    ("entry", "options", "words"),
    [
        ("gravity_compensator@j9", SPRING, "gravity_compensator@j9: no such place; allowed are j1 ... j6"),
        ("gravity_compensator@link2", SPRING, "no such place"),
        ("gravity_compensator", {}, r'\[model.gravity_compensator\] mode is missing: "levels" \(with levels_deg\)'),
        ("gravity_compensator", {"mode": "gas"}, "mode = 'gas' is unknown"),
        ("gravity_compensator", SPRING | {"levels_deg": LEVELS}, "mode is missing"),
        ("gravity_compensator", SPRING | {"mode": "levels"}, 'a_x_mm: has no meaning with mode = "levels"'),
        ("gravity_compensator", {"mode": "spring"}, "a_x_mm is missing; a spring needs a_x_mm, a_y_mm and radius_mm"),
        ("gravity_compensator", {"a_x_mm": 600.0, "a_y_mm": 100.0}, "radius_mm is missing"),
        ("gravity_compensator", SPRING | {"radius_mm": -1.0}, "radius_mm = -1: must be above 0"),
        ("gravity_compensator", SPRING | {"s0_mm": 0}, "s0_mm = 0: must be above 0"),
        ("gravity_compensator", SPRING | {"a_x_mm": "far"}, "a_x_mm = 'far': a number"),
        ("gravity_compensator", SPRING | {"a_x_mm": 0.0, "a_y_mm": 0.0}, "no length or no lever"),
        ("gravity_compensator", SPRING | {"fit_geometry": 1}, "fit_geometry = 1: true or false"),
        ("gravity_compensator", SPRING | {"anchor": 1}, "anchor: unknown key; allowed: mode, levels_deg"),
        ("gravity_compensator", {"springs": []}, r"springs = \[\]: a list of tables"),
        ("gravity_compensator", {"springs": [SPRING], "a_x_mm": 1.0}, "give it in each entry of springs"),
        ("gravity_compensator", {"springs": [SPRING, {"a_x_mm": 1.0}]}, "springs, entry 2, a_y_mm is missing"),
        ("gravity_compensator", {"j2": {"radius_mm": 5.0}}, "a_x_mm is missing"),
        ("gravity_compensator", {"orders": []}, r"orders = \[\]: a list of different whole numbers from 1 to 12"),
        ("gravity_compensator", {"orders": [0, 1]}, "order 0 would be a zero offset of the joint"),
        ("gravity_compensator", {"orders": [1, 1]}, "orders = "),
        ("gravity_compensator", {"orders": [1.5]}, "orders = "),
        ("gravity_compensator", {"orders": 3}, "orders = 3"),
        (
            "gravity_compensator",
            {"mode": "harmonics", "levels_deg": LEVELS},
            'levels_deg: has no meaning with mode = "ha',
        ),
        ("gravity_compensator", {"mode": "spring", "orders": [1]}, 'orders: has no meaning with mode = "spring"'),
        ("gravity_compensator", {"orders": [1], "levels_deg": LEVELS}, "mode is missing"),
        ("gravity_compensator", {"levels_deg": [-50]}, "levels_deg = .*two or more different values"),
        ("gravity_compensator", {"levels_deg": [-50, -50]}, "two or more different values"),
        ("gravity_compensator", {"levels_deg": [-50, "x"]}, "two or more different values"),
        ("gravity_compensator", {"levels_deg": LEVELS, "tolerance_deg": 0}, "tolerance_deg = 0: a number above 0"),
    ],
)
def test_wrong_options_are_bad_input(entry, options, words):
    with pytest.raises(InputError, match=words) as caught:
        model_of(study_of(load_robot("kr270_2"), ("joint_compliance", entry), **options))
    assert caught.value.exit_code == 2


def test_a_spring_needs_a_joint_that_turns_and_yields():
    robot = load_robot("kr270_2")
    with pytest.raises(InputError, match=r"nothing in this model lets joint 2 yield.*add joint_compliance@j2"):
        model_of(study_of(robot, ("joint_compliance@j3", "gravity_compensator@j2"), **SPRING))
    sliding = replace(robot, prismatic=np.array([False, True, *[False] * 4]))
    with pytest.raises(InputError, match="nothing in this model lets joint 2 yield"):
        model_of(study_of(robot, ("gravity_compensator@j2",), mode="harmonics"))
    with pytest.raises(InputError, match="joint 2 slides"):
        model_of(study_of(sliding, **SPRING))


def test_poses_between_levels_belong_to_the_nearest_or_are_refused():
    levels = np.radians([-100.0, -50.0, -5.0])
    np.testing.assert_array_equal(
        nearest_level(levels, np.radians([-120.0, -76.0, -74.0, -20.0, 30.0])), [0, 0, 1, 2, 2]
    )
    with pytest.raises(InputError, match=r"tolerance_deg = 2: a pose has -74 deg, levels_deg are -100, -50, -5"):
        nearest_level(levels, np.radians([-100.0, -74.0]), np.radians(2.0))


@pytest.mark.parametrize(
    ("levels", "compliance", "kind", "words"),
    [
        ([-100, -50], [1e-6, 1e-6], InputError, "2 levels of the joint .* for 3 unknowns"),
        ([-100, -50, -50], [1e-6] * 3, InputError, "2 levels of the joint"),
        ([-100, -50, -5], [1e-6, -1e-7, 1e-6], InputError, "-50 deg is not positive"),
        ([-100, 260, -50], [1e-6] * 3, NotIdentifiable, "cannot tell K_2.*apart"),
    ],
)
def test_levels_that_cannot_give_a_spring_are_refused(levels, compliance, kind, words):
    q = np.radians(np.array(levels, dtype=float))
    with pytest.raises(kind, match=words) as caught:
        spring_from_levels(q, np.array(compliance), np.eye(len(q)) * 1e-16, SpringGeometry(0.6859, 0.121, 0.1847))
    assert caught.value.exit_code == (2 if kind is InputError else 3)


def test_fewer_levels_than_unknowns_in_the_data_are_named():
    robot = load_robot("kr270_r2700")
    study = study_of(robot, **SPRING)
    data = readings(study, JOINTS | TRUE_SPRING, levelled(robot, 8, LEVELS[:2]), 1e-6)
    result = identify(study, data)
    assert "gravity_compensator.j2.k_c_s0" not in result.parameters


def test_levels_asked_of_a_model_without_levels():
    robot = load_robot("kr270_r2700")
    study = study_of(robot, **SPRING)
    result = identify(study, readings(study, JOINTS | TRUE_SPRING, levelled(robot, 4), 1e-6))
    with pytest.raises(InputError, match="gravity_compensator@j2 with levels_deg is not in this model"):
        joint_levels(result)
