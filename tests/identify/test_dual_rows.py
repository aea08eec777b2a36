"""The road of dual quaternions through the shared identifier, against the ordinary one."""

from dataclasses import replace

import numpy as np
import pytest

from identify.dual_quaternions.screws import DEVIATION_OF_TWIST
from identify.dual_rows import dual_respond
from identify.errors import InputError
from identify.fit import fit, start
from identify.identification import identify
from identify.loads import LoadCase, Markers
from identify.model import model_of
from identify.noise import whitening
from identify.response import respond
from identify.robot_files import load_robot
from identify.six_d import with_turns, with_turns_read
from identify.study import Noise
from tests.identify.studies import (
    COMPLIANCE,
    ROBOTS,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    measured,
    poses,
    random_robot,
    study_of,
    values_of,
)
from tests.identify.test_effects import everywhere

SIX_D = Noise(reading=0.02e-3, pose_jitter=12e-6, reading_jitter=1.5e-6, orientation=40e-6)
TARGETS = Markers(
    ("T", "S", "F"), np.array([[0.1, 0.05, 0.12], [0.0, 0.1, -0.1], [1.0, 0.3, 0.1]]), np.array([False, False, True])
)


def both_ways(study, rng, count=12, **options):
    data = measured(study, rng, count=count, **options)
    return identify(study, data), identify(replace(study, rows="dual_quaternions"), data), data


@pytest.mark.parametrize("slides", [(False,) * 6, (False, True, False, True, False)])
def test_readings_and_columns_are_those_of_the_ordinary_road(slides):
    rng = np.random.default_rng(len(slides))
    study = study_of(
        random_robot(rng, slides), loads=(UNLOADED, WEIGHT, SIDE), markers=TARGETS, noise=SIX_D, rows="dual_quaternions"
    )
    model = model_of(study)
    values = values_of(model, everywhere(study, rng, soft=0.3))
    read = with_turns(experiment_of(study, poses(study, 6, rng)))
    dual, plain = dual_respond(model, read, values), respond(model, read, values)
    np.testing.assert_allclose(dual.position, plain.position, atol=1e-12)
    np.testing.assert_allclose(dual.turned, plain.turned, atol=1e-12)
    np.testing.assert_allclose(dual.deflection, plain.deflection, atol=1e-13)
    np.testing.assert_allclose(dual.derivative, plain.derivative, atol=1e-12)
    np.testing.assert_allclose(dual.direct, plain.direct, atol=1e-12)


def test_measured_wrenches_act_alike():
    rng = np.random.default_rng(3)
    study = kr270_study(markers=TARGETS, noise=SIX_D, rows="dual_quaternions")
    model, plain = model_of(study), experiment_of(study, poses(study, 5, rng))
    wrench = rng.normal(0, 300, (len(plain.shot_visit), 6)) * ~plain.shot_unloaded[:, None]
    fixed = np.arange(len(wrench)) % 2 == 0
    read = with_turns(replace(plain, wrench=wrench, wrench_in_world=fixed))
    values = values_of(model, COMPLIANCE)
    np.testing.assert_allclose(
        dual_respond(model, read, values).deflection, respond(model, read, values).deflection, atol=1e-13
    )


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("frame_free", [True, False])
def test_the_same_residual_gives_the_same_estimates(reference, frame_free):
    """To 1e-8 of each value, with the same intervals."""
    study = kr270_study(markers=TARGETS, noise=SIX_D, reference=reference, frame_free=frame_free)
    ordinary, dual, _ = both_ways(study, np.random.default_rng(5), values=COMPLIANCE)
    assert set(dual.parameters) == set(ordinary.parameters)
    for name, value in ordinary.parameters.items():
        assert dual.parameters[name] == pytest.approx(value, rel=1e-8), name
    np.testing.assert_allclose(dual.covariance, ordinary.covariance, rtol=1e-6, atol=1e-12)
    assert dual.lack_of_fit.chi2 == pytest.approx(ordinary.lack_of_fit.chi2, rel=1e-8)


def test_the_residual_of_the_paper_differs_in_second_order():
    """Half of all deflections and errors, a quarter of the difference of the estimates: zero offsets that it lacks."""
    study = kr270_study(markers=TARGETS, noise=SIX_D, frame_free=False, markers_fitted=False, reference="absolute")
    truth = replace(study, effects=("joint_compliance", "geometry"))
    exact = replace(SIX_D, reading=1e-12, orientation=1e-12, pose_jitter=0.0, reading_jitter=0.0)
    differences = []
    for share in (1.0, 0.5, 0.25):
        offsets = {f"geometry.j{j}.offset": size * share for j, size in ((2, 8.0), (3, -8.0), (4, 8.0), (5, -8.0))}
        softer = {name: share * value for name, value in COMPLIANCE.items()}
        data = measured(truth, np.random.default_rng(9), count=10, values={**softer, **offsets}, noise=exact)
        data = with_turns_read(data)
        found = []
        for rows in ("vectors", "dual_quaternions", "dual_quaternion_deviations"):
            model = model_of(replace(study, rows=rows))
            found.append(fit(model, data, study.noise, start(model, data), reweigh=False).state.values)
        np.testing.assert_allclose(found[1], found[0], rtol=1e-8)
        differences.append(np.abs(found[2] - found[0]).max())
    assert differences[0] > 1e-4  # urad/Nm
    np.testing.assert_allclose(np.divide(differences[1:], differences[:-1]), 0.25, rtol=0.1)


def test_whitening_six_numbers_is_whitening_eight_by_the_pseudo_inverse_of_their_covariance():
    """One shot of one target: the eight rows of the deviation with the covariance of rank six that they inherit."""
    rng = np.random.default_rng(2)
    study = kr270_study(
        markers=Markers(("T",), np.array([[0.1, 0.05, 0.12]]), np.array([False])), noise=SIX_D, loads=(WEIGHT,),
        frame_free=False, markers_fitted=False, rows="dual_quaternions",
    )  # fmt: skip
    model = model_of(study)
    read = with_turns(experiment_of(study, poses(study, 1, rng)))
    response = dual_respond(model, read, values_of(model, COMPLIANCE))
    operators = whitening(response.scene, study.noise, np.zeros(3), free_offsets=False)
    (six,) = (operator[0] for _, operator in operators.groups)
    covariance = np.linalg.inv(six.T @ six)
    p = response.scene.point[0]
    back = np.eye(6)  # (position, turn) -> twist about the base origin
    back[:3, 3:] = [[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]]
    onto = DEVIATION_OF_TWIST @ back
    weight = np.linalg.pinv(onto @ covariance @ onto.T, rcond=1e-12, hermitian=True)
    rows = response.derivative.reshape(6, -1)
    expected = (onto @ rows).T @ weight @ (onto @ rows)
    whitened = operators.apply(response.derivative)
    np.testing.assert_allclose(whitened.T @ whitened, expected, rtol=1e-7)


@pytest.mark.parametrize("arm", ["sda5f_r1", "sda5f_r2"])
def test_a_joint_that_sees_no_moment_gets_no_number(arm):
    """Joint 8 under 5 kg on its own axis, and the waist under a vertical load."""
    robot = load_robot(ROBOTS / f"{arm}.toml")
    load = LoadCase("L5", mass=5.0, attach=np.array([0.0, 0.0, 0.1]))
    target = Markers(("T",), np.array([[0.0, 0.0, 0.06]]), np.array([False]))
    study = study_of(robot, loads=(UNLOADED, load), markers=target, noise=SIX_D)
    true = {f"joint_compliance.j{i + 1}": c for i, c in enumerate((10.0, 17.0, 10.0, 14.0, 20.0, 33.0, 5.0, 0.1))}
    ordinary, dual, _ = both_ways(study, np.random.default_rng(1), count=25, values=true)
    for found in (ordinary, dual):
        assert set(found.parameters) == {f"joint_compliance.j{j}" for j in range(2, 8)}


def test_what_the_road_does_not_know_is_refused():
    rng = np.random.default_rng(0)
    study = kr270_study(markers=TARGETS, noise=SIX_D)
    data = measured(study, rng, count=6)
    with pytest.raises(InputError, match="geometry"):
        identify(replace(study, effects=("joint_compliance", "geometry"), rows="dual_quaternions"), data)
    with pytest.raises(InputError, match="loaded"):
        identify(replace(study, equilibrium="loaded", rows="dual_quaternions"), data)
    with pytest.raises(InputError, match="qw, qx, qy, qz"):
        identify(replace(study, rows="dual_quaternions"), replace(data, quaternions=None))
    with pytest.raises(InputError, match="orientation_urad"):
        identify(replace(study, noise=replace(SIX_D, orientation=0.0), rows="dual_quaternions"), data)
