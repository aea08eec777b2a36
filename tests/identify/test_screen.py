"""What a diagnosis lays out before and beside causes: replicates, curves over a joint, the table of residuals."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from identify.diagnosis.curves import curves
from identify.diagnosis.library import Hypothesis
from identify.diagnosis.replicates import replicates
from identify.diagnosis.screen import recorded, screen
from identify.diagnosis.search import Cause, fitted
from identify.experiment import full_experiment
from identify.identification import identify
from identify.model import model_of
from tests.identify.studies import COMPLIANCE, EXACT, NOISE, experiment_of, kr270_study, measured, poses, readings

LOADS = np.array([0, 1])


def repeated(study, rng, *, visits=12, repeats=2, again=1, truth=None, values=COMPLIANCE):
    """Readings of random poses, each load read several times in a visit, each pose visited several times."""
    q = np.tile(poses(study, visits, rng), (again, 1))
    which = np.tile(np.repeat(LOADS, repeats), (len(q), 1))
    return readings(truth or study, full_experiment(q, which, study.loads, study.markers), values, rng)


@pytest.mark.parametrize(
    ("repeats", "again", "dof"),
    [(2, 1, 12 * 2 * 9), (3, 1, 12 * 4 * 9), (1, 2, 12 * 18), (2, 3, 12 * 5 * 18)],
)
def test_each_repetition_counts_once(repeats, again, dof):
    study, rng = kr270_study(), np.random.default_rng(3)
    data = repeated(study, rng, repeats=repeats, again=again)
    found = replicates(fitted(study, data, differences=False))
    assert found.dof == dof
    assert found.readings == len(data.positions)
    assert 0.8 < found.chi2 / found.dof < 1.2
    assert 0.8 < found.ratio < 1.25
    assert found.p_value > 0.01


@pytest.mark.parametrize("differences", [False, True])
def test_noise_stated_too_small_is_no_lack_of_fit(differences):
    study, rng = kr270_study(), np.random.default_rng(4)
    small = replace(NOISE, reading=NOISE.reading / 3, pose_jitter=NOISE.pose_jitter / 3, reading_jitter=5e-7)
    data = repeated(study, rng, repeats=3)
    found = fitted(replace(study, noise=small), data, differences=differences)
    against = replicates(found)
    assert found.chi2 > 5 * found.dof
    assert 0.8 < against.ratio < 1.25
    assert against.std == pytest.approx(NOISE.reading, rel=0.15)


def test_a_model_that_lacks_something_is_rejected_by_replicates():
    study, rng = kr270_study(), np.random.default_rng(5)
    truth = replace(study, effects=(*study.effects, "geometry@j3"))
    data = repeated(study, rng, truth=truth, values={**COMPLIANCE, "geometry.j3.offset": 0.5})
    assert replicates(fitted(study, data, differences=False)).p_value < 1e-6
    assert replicates(fitted(truth, data, differences=False)).p_value > 0.01


def test_without_replicates_there_is_no_comparison():
    study, rng = kr270_study(), np.random.default_rng(6)
    assert replicates(fitted(study, measured(study, rng), differences=False)) is None


def test_copies_of_readings_are_no_replicates():
    study, rng = kr270_study(), np.random.default_rng(6)
    data = repeated(study, rng, repeats=1, again=2)
    half = len(data.positions) // 2
    copied = replace(data, positions=np.tile(data.positions[:half], (2, 1)))
    assert replicates(fitted(study, copied, differences=False)) is None


def test_other_approaches_and_wrenches_are_no_replicates():
    study, rng = kr270_study(), np.random.default_rng(7)
    data = repeated(study, rng, repeats=1, again=2)
    experiment = data.experiment
    sides = np.ones((len(experiment.visits), 6))
    sides[12:] = -1.0
    found = fitted(study, replace(data, experiment=replace(experiment, approach=sides)), differences=False)
    assert replicates(found) is None


def identified(entry, values, options=None):
    """An arm with an effect, identified from readings without noise; and the effect as a cause."""
    name, _, where = entry.partition("@")
    study = kr270_study(effects=("joint_compliance", entry), options={name: options} if options else {})
    data = readings(study, experiment_of(study, poses(study, 30, np.random.default_rng(8))), {**COMPLIANCE, **values},
                    np.random.default_rng(9), noise=EXACT)  # fmt: skip
    effect = model_of(study).effects[-1]
    own = np.arange(len(effect.parameters))
    return identify(study, data), (Cause(Hypothesis(name, where, MappingProxyType({}), effect, own), 0.0),)


def test_a_spring_over_its_joint_is_a_curve():
    moment = {"gravity_compensator.j2.s1": -900.0, "gravity_compensator.j2.c2": 250.0}
    result, causes = identified("gravity_compensator@j2", moment, {"mode": "harmonics"})
    (curve,) = curves(result, causes)
    q = curve.value
    torque = -900.0 * np.sin(q) + 250.0 * np.cos(2 * q)  # of the spring, against that of the load
    expected = -COMPLIANCE["joint_compliance.j2"] * 1e-6 * torque
    assert (curve.joint, curve.cause) == (1, "gravity_compensator@j2")
    assert q.min() == result.data.experiment.q[:, 1].min()
    assert np.abs(curve.turn - expected).max() < 0.02 * np.abs(expected).max()
    assert (curve.half > 0).all()


def test_an_error_of_a_gear_is_a_curve():
    waves = {"transmission_error.j3.s1": 80.0, "transmission_error.j3.c2": -120.0}
    (curve,) = curves(*identified("transmission_error@j3", waves))
    expected = 1e-6 * (80.0 * np.sin(curve.value) - 120.0 * np.cos(2 * curve.value))
    assert np.abs(curve.turn - expected).max() < 0.02 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("entry", "values"),
    [
        ("geometry@j3", {"geometry.j3.a": 0.4, "geometry.j3.offset": 0.3}),
        ("joint_hardening@j2", {"joint_hardening.j2": -1.0}),
    ],
)
def test_what_is_no_function_of_one_joint_has_no_curve(entry, values):
    study = kr270_study(effects=("joint_compliance", entry))
    own = [name for name in model_of(study).names if name.startswith(entry.replace("@", "."))]
    given = {name: values.get(name, 0.1) for name in own}
    result, causes = identified(entry, given)
    assert curves(result, causes) == ()


def test_quantities_have_the_units_of_their_names():
    study, rng = kr270_study(), np.random.default_rng(10)
    data = measured(study, rng)
    found = fitted(study, data, differences=False)
    listed = dict(recorded(data.experiment, found.response.scene, found.state.base_T_measurement[:3, 3]))
    shot = data.experiment.row_shot
    assert np.allclose(np.deg2rad(listed["q2_deg"]), data.experiment.q[data.experiment.shot_pose[shot], 1])
    assert np.allclose(listed["t2_Nm"], found.response.scene.joints.torque[shot, 1])
    assert np.allclose(listed["range_m"], np.linalg.norm(data.positions, axis=1), atol=2e-2)
    assert {d.column for d in screen(found, "absolute").dependences} <= set(listed)
