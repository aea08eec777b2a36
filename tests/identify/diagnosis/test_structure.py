"""Unnamed patterns in a residual: silent where nothing is missing, loud along what something depends on."""

from dataclasses import replace

import numpy as np
import pytest

from identify.diagnosis.evidence import evidence
from identify.diagnosis.gates import family_probabilities
from identify.diagnosis.structure import patterns
from tests.identify.diagnosis.cases import arm, conditions, fit_of, read, recorded


@pytest.fixture(scope="module")
def study():
    return arm()


def strongest(study, data, gate="holm"):
    """Family-wise probability of the strongest pattern and what it depends on."""
    found = fit_of(study, data)
    unnamed = patterns(found)
    seen = evidence(found, unnamed)
    probability = family_probabilities(seen, gate, np.random.default_rng(0), np.ones(len(unnamed), dtype=bool))
    scores = [seen.score(b).p_value for b in range(len(unnamed))]
    best = int(np.lexsort((scores, probability))[0])
    return float(probability[best]), unnamed[best].depends_on


def turned(study, data, joint, angle):
    """The readings with a joint turned by (R,) rad more."""
    motion = fit_of(study, data).response.scene.joints.motion[:, joint]
    return replace(data, positions=data.positions + motion * angle[:, None])


def test_no_pattern_is_seen_where_nothing_is_missing(study):
    experiment = recorded(conditions(study, 24, 3))
    smallest = [strongest(study, read(study, experiment, seed))[0] for seed in range(30)]
    assert np.mean(np.array(smallest) < 0.05) <= 0.1
    assert min(smallest) > 1e-3


def test_a_compliance_that_goes_with_the_sine_of_three_times_an_angle_is_seen_along_it(study):
    """No effect of the library is like that."""
    data = read(study, conditions(study, 24, 3), 1)
    experiment = data.experiment
    q3 = experiment.q[experiment.shot_pose[experiment.row_shot], 2]
    torque = fit_of(study, data).response.scene.joints.torque[experiment.row_shot, 2]
    probability, where = strongest(study, turned(study, data, 2, 4e-8 * np.sin(3 * q3) * torque))
    assert probability < 1e-10
    assert where == "q3_deg"


def test_an_error_that_follows_the_temperature_is_seen_along_it(study):
    data = read(study, recorded(conditions(study, 24, 3)), 1)
    warmth = data.experiment.temperature - 22.0
    probability, where = strongest(study, turned(study, data, 1, 3e-5 * warmth))
    assert probability < 1e-10
    assert where == "temperature_C"


def test_an_instrument_that_sways_with_time_is_seen_along_time(study):
    data = read(study, recorded(conditions(study, 24, 3)), 1)
    course = np.sin(3 * 2 * np.pi * data.experiment.time / data.experiment.time.max())
    swayed = replace(data, positions=data.positions + np.outer(course, [1e-4, 0.5e-4, 0.0]))
    probability, where = strongest(study, swayed)
    assert probability < 1e-10
    assert where == "time_s"


def test_patterns_are_functions_of_what_was_recorded_and_of_nothing_else(study):
    plain = patterns(fit_of(study, read(study, conditions(study, 12, 3), 1)))
    assert {pattern.depends_on for pattern in plain} == {f"q{i}_deg" for i in range(1, 7)}
    timed = patterns(fit_of(study, read(study, recorded(conditions(study, 12, 3)), 1)))
    assert {pattern.depends_on for pattern in timed} == {f"q{i}_deg" for i in range(1, 7)} | {
        "time_s", "temperature_C"
    }  # fmt: skip
    still = replace(recorded(conditions(study, 12, 3)), temperature=np.full(12 * 6, 21.0))
    same = patterns(fit_of(study, read(study, still, 1)))
    assert "temperature_C" not in {pattern.depends_on for pattern in same}


def test_columns_are_in_milliradians_of_the_joint(study):
    found = fit_of(study, read(study, conditions(study, 12, 3), 1))
    turned, loaded = patterns(found)[2:4]  # sines and cosines of q1, turning joint 2, and yielding of joint 2
    shot = found.data.experiment.row_shot
    q1 = found.data.experiment.q[found.data.experiment.shot_pose[shot], 0]
    expected = 1e-3 * found.response.scene.joints.motion[:, 1] * np.sin(q1)[:, None]
    np.testing.assert_allclose(turned.columns[:, :, 0], expected, atol=1e-15)
    assert turned.columns.shape[2] == 6
    torque = found.response.scene.joints.torque[:, 1]
    share = (torque / np.abs(torque).max())[shot]
    np.testing.assert_allclose(loaded.columns, turned.columns * share[:, None, None], atol=1e-15)
