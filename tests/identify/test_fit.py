"""The fit finds what noise-free readings were made from, whatever robot, frame, load or marker."""

from dataclasses import replace

import numpy as np
import pytest

from identify.fit import OUTLYING, fit, rows_that_do_not_fit, start
from identify.identification import identify
from identify.kinematics import forward
from identify.loads import Markers
from identify.model import model_of
from tests.identify.studies import (
    COMPLIANCE,
    EXACT,
    LIGHT,
    PLATE,
    SIDE,
    SOFT,
    UNLOADED,
    WEIGHT,
    experiment_of,
    geometry_errors,
    kr270_study,
    measured,
    moved_markers,
    placement_of,
    poses,
    random_robot,
    readings,
    study_of,
    ur10_study,
)


def assert_recovered(result, truth, names=None, tolerance=1e-8):
    found = result.parameters
    assert set(names if names is not None else truth) <= set(found)
    for name, value in found.items():
        assert value == pytest.approx(truth.get(name, 0.0), abs=tolerance * max(1.0, abs(truth.get(name, 0.0)))), name


SEEN = [f"joint_compliance.j{j}" for j in range(2, 7)]


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("frame_free", [True, False])
@pytest.mark.parametrize("markers_fitted", [True, False])
def test_noise_free_readings_give_the_truth_back(reference, frame_free, markers_fitted):
    rng = np.random.default_rng(1)
    study = kr270_study(reference=reference, frame_free=frame_free, markers_fitted=markers_fitted)
    truth = {**COMPLIANCE, **(moved_markers(study, rng) if markers_fitted else {})}
    result = identify(study, measured(study, rng, values=truth, noise=EXACT))
    assert result.reference == reference
    assert_recovered(result, truth, SEEN)
    if markers_fitted:
        model = result.model
        np.testing.assert_allclose(
            result.values[model.frame_size : model.frame_size + 9],
            [truth[name] for name in model.names[model.frame_size : model.frame_size + 9]],
            atol=1e-6,
        )


@pytest.mark.parametrize("masses", [True, False])
def test_the_frame_is_found_wherever_the_tracker_stands(masses):
    rng = np.random.default_rng(2)
    study = kr270_study(masses=masses)
    placement = placement_of(rng)
    result = identify(study, measured(study, rng, noise=EXACT, placement=placement))
    np.testing.assert_allclose(result.fit.state.base_T_measurement, placement, atol=1e-9)


def test_a_tilted_base_loads_the_first_joint_and_its_compliance_is_found():
    rng = np.random.default_rng(3)
    study = kr270_study(mount=(0.3, 0.2, 0.1))
    assert_recovered(identify(study, measured(study, rng, noise=EXACT)), COMPLIANCE)


@pytest.mark.parametrize("loads", [(UNLOADED, SIDE), (UNLOADED, WEIGHT, LIGHT, SIDE)])
def test_wrenches_that_turn_with_the_flange_show_every_joint(loads):
    rng = np.random.default_rng(4)
    study = kr270_study(loads=loads)
    assert_recovered(identify(study, measured(study, rng, noise=EXACT)), COMPLIANCE)


def test_wrenches_in_the_world_add_to_the_hung_mass():
    """A mass is the wrench of its weight at the same point, also on a turned base."""
    rng = np.random.default_rng(5)
    weight = np.array([0.0, 0.0, -250.0 * 9.80665])
    pulled = replace(WEIGHT, mass=0.0, force=weight)
    half = replace(WEIGHT, mass=125.0, force=weight / 2)
    study = kr270_study(mount=(0.3, 0.2, 0.1))
    experiment = experiment_of(study, poses(study, 10, rng))
    expected = readings(study, experiment, COMPLIANCE, np.random.default_rng(0), placement=np.eye(4)).positions
    for load in (pulled, half):
        other = replace(study, loads=(UNLOADED, load))
        data = readings(other, experiment, COMPLIANCE, np.random.default_rng(0), placement=np.eye(4))
        np.testing.assert_allclose(data.positions, expected, atol=1e-12)


def test_measured_wrench_columns_say_the_same_as_the_hung_mass():
    """The sensor turns with the flange: it sees the weight as R' F; its columns replace the study's loads."""
    rng = np.random.default_rng(6)
    study = kr270_study(mount=(0.0, 0.25, 0.0))
    data = measured(study, rng, noise=EXACT)
    experiment = data.experiment
    turn = forward(study.robot, experiment.q).flange_rotation[experiment.shot_pose]
    wrench = np.zeros((len(experiment.shot_load), 6))
    wrench[:, :3] = np.einsum("sji,j->si", turn, WEIGHT.mass * study.robot.gravity_base)
    wrench[experiment.shot_unloaded] = 0.0
    wrong = replace(WEIGHT, mass=100.0)
    by_sensor = replace(data, experiment=replace(experiment, wrench=wrench, loads=(UNLOADED, wrong)))
    result = identify(replace(study, loads=(UNLOADED, wrong)), by_sensor)
    assert_recovered(result, COMPLIANCE)
    np.testing.assert_allclose(result.values, identify(study, data).values, atol=1e-8)
    misled = identify(
        replace(study, loads=(UNLOADED, wrong)), replace(data, experiment=replace(experiment, loads=(UNLOADED, wrong)))
    )
    assert misled.parameters["joint_compliance.j2"] > 1.5 * COMPLIANCE["joint_compliance.j2"]


def test_a_wrench_sensor_with_side_forces_shows_joint_one_and_full_moments_count():
    rng = np.random.default_rng(7)
    study = kr270_study()
    experiment = experiment_of(study, poses(study, 12, rng))
    wrench = np.where(experiment.shot_unloaded[:, None], 0.0, rng.normal(0, 600, (len(experiment.shot_load), 6)))
    experiment = replace(experiment, wrench=wrench)
    assert_recovered(identify(study, readings(study, experiment, COMPLIANCE, rng, noise=EXACT)), COMPLIANCE)


def test_targets_on_the_base_hold_the_frame():
    """With one marker on the flange, three on the floor and markers exact, floor targets alone fix the frame."""
    rng = np.random.default_rng(8)
    floor = np.array([[1.5, 0.5, 0.0], [-0.8, 1.2, 0.3], [0.4, -1.4, 0.1]])
    markers = Markers(
        ("M1", "F1", "F2", "F3"), np.vstack([PLATE.positions[:1], floor]), np.array([False, True, True, True])
    )
    study = kr270_study(markers=markers, markers_fitted=False)
    placement = placement_of(rng)
    data = measured(study, rng, noise=EXACT, placement=placement)
    result = identify(study, data)
    assert_recovered(result, COMPLIANCE, SEEN)
    model = result.model
    only = np.array([name.startswith("frame") for name in model.names])
    on_floor = data.experiment.row_marker > 0
    columns = result.fit.response.derivative[on_floor][:, :, only].reshape(-1, 6)
    assert np.linalg.matrix_rank(columns / np.linalg.norm(columns, axis=0)) == 6
    np.testing.assert_allclose(result.fit.state.base_T_measurement, placement, atol=1e-9)


@pytest.mark.parametrize("slides", [(False, True, False, False), (True, True, True), (True, False, False, True)])
def test_sliding_joints_have_compliances_too(slides):
    rng = np.random.default_rng([9, len(slides)])
    robot = random_robot(rng, slides)
    study = study_of(robot, loads=(UNLOADED, SIDE))
    names = model_of(study).names[-len(slides) :]
    truth = {name: float(rng.uniform(0.5, 5)) for name in names}
    units = [p.unit for p in model_of(study).parameters[-len(slides) :]]
    assert units == ["um/N" if slide else "urad/Nm" for slide in slides]
    assert_recovered(identify(study, measured(study, rng, values=truth, noise=EXACT)), truth)


@pytest.mark.parametrize("make", [kr270_study, ur10_study])
def test_geometry_and_compliance_are_found_together(make):
    """What is held at nominal is given to the truth as nominal, so that the rest can be compared."""
    rng = np.random.default_rng(10)
    study = make(effects=("joint_compliance", "geometry"))
    compliance = COMPLIANCE if make is kr270_study else SOFT
    errors = geometry_errors(study.robot, rng)
    blank = identify(study, measured(study, rng, count=40, values=compliance, noise=EXACT))
    held = {blank.model.names[d.column] for d in blank.fit.identifiability.dropped}
    truth = {name: v for name, v in {**compliance, **errors}.items() if name not in held}
    result = identify(study, measured(study, rng, count=40, values=truth, noise=EXACT))
    assert {result.model.names[d.column] for d in result.fit.identifiability.dropped} == held
    assert_recovered(result, truth, tolerance=1e-7)
    assert len(result.parameters) > 20


def test_exact_markers_leave_the_flange_to_geometry():
    rng = np.random.default_rng(11)
    study = ur10_study(effects=("geometry",), loads=(UNLOADED,), markers_fitted=False)
    truth = {"geometry.flange.x": 0.4, "geometry.flange.z": -0.3, "geometry.j3.a": 0.5, "geometry.flange.ry": 0.8}
    data = measured(study, rng, count=30, values=truth, noise=EXACT)
    result = identify(study, data)
    assert result.fit.whitened @ result.fit.whitened < 1e-10
    assert_recovered(
        identify(replace(study, effects=("geometry@j3",), markers_fitted=True), data),
        {"geometry.j3.a": 0.5},
        tolerance=1e-6,
    )


def test_a_start_far_from_the_solution_converges_to_the_same_point():
    rng = np.random.default_rng(12)
    study = kr270_study()
    data = measured(study, rng)
    model = model_of(study)
    near = fit(model, data, study.noise, start(model, data))
    far = start(model, data)
    tilted = far.base_T_measurement @ placement_of(rng)
    values = far.values + rng.normal(0, 2.0, len(far.values)) * ~model.nuisance
    values[model.names.index("joint_compliance.j1")] = 0.0  # not identifiable: it stays where it starts
    other = fit(model, data, study.noise, replace(far, values=values, base_T_measurement=tilted))
    np.testing.assert_allclose(other.state.values, near.state.values, atol=1e-8)
    assert other.chi2 == pytest.approx(near.chi2, rel=1e-10)


def test_good_rows_keep_full_weight_and_one_wild_row_loses_almost_all():
    rng = np.random.default_rng(13)
    study = kr270_study()
    data = measured(study, rng)
    model = model_of(study)
    clean = fit(model, data, study.noise, start(model, data))
    assert (clean.state.weights == 1.0).all()
    assert not len(rows_that_do_not_fit(clean))
    assert 0.7 < clean.scale < 1.3
    positions = data.positions.copy()
    positions[17] += [0.3, -0.2, 0.5]
    bad = replace(data, positions=positions)
    found = fit(model, bad, study.noise, start(model, bad))
    assert rows_that_do_not_fit(found).tolist() == [17]
    assert found.state.weights[17] < (2 * OUTLYING * 0.03 / 600) ** 2
    assert (np.delete(found.state.weights, 17) == 1.0).all()
    assert found.z[17] == pytest.approx(np.linalg.norm([0.3, -0.2, 0.5]) / 0.03e-3, rel=0.15)
