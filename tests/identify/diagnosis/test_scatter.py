"""Scatter of one joint, or of its compliance, from pose to pose."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from identify.diagnosis.evidence import evidence
from identify.diagnosis.gates import holm_probabilities
from identify.diagnosis.scatter import uneven
from tests.identify.diagnosis.cases import arm, conditions, fit_of, read


@pytest.fixture(scope="module")
def study():
    return arm()


def parts(study, data):
    """Probabilities of a joint's scatter and of its compliance's scatter in turn, joint by joint."""
    return uneven(evidence(fit_of(study, data), ()), np.random.default_rng(0))


def shaken(study, data, joint, size, rng, *, by_torque=False):
    """The readings with one joint turned anew in each visit, or with another compliance of it in each visit."""
    found, experiment = fit_of(study, data), data.experiment
    turn = (size * rng.normal(size=len(experiment.visits)))[experiment.row_visit]
    if by_torque:
        turn = turn * found.response.scene.joints.torque[experiment.row_shot, joint]
    return replace(data, positions=data.positions + found.response.scene.joints.motion[:, joint] * turn[:, None])


def test_the_stated_noise_alone_shows_no_scatter_of_its_own(study):
    """Each probability is uniform, and the smallest of all, by Holm's rule, keeps its level."""
    experiment, smallest, second = conditions(study, 24, 3), [], []
    for seed in range(60):
        values = np.array([part.p_value for part in parts(study, read(study, experiment, seed))])
        smallest.append(holm_probabilities(values).min())
        second.append(values[2:8])
    assert np.mean(np.array(smallest) < 0.05) <= 0.12
    for column in np.array(second).T:
        assert kstest(column, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("joint", [1, 2, 4])
def test_one_shaking_joint_is_found_and_is_the_most_uneven(study, joint):
    """By 150 urad, twelve times what shakes every joint."""
    data = shaken(study, read(study, conditions(study, 24, 3), 1), joint, 1.5e-4, np.random.default_rng(2))
    found = parts(study, data)
    strongest = min(found, key=lambda part: part.p_value)
    assert strongest.depends_on == f"q{joint + 1}_deg"
    assert strongest.p_value < 1e-4


def test_a_compliance_that_differs_from_pose_to_pose_is_found_as_such(study):
    """By 10 % of the joint's; the part that grows with the torque shows it better than one that does not."""
    data = read(study, conditions(study, 24, 3), 1)
    found = parts(study, shaken(study, data, 2, 4e-8, np.random.default_rng(2), by_torque=True))
    turn, compliance = found[4], found[5]
    assert turn.depends_on == compliance.depends_on == "q3_deg"
    assert compliance.p_value < 1e-6
    assert compliance.p_value < turn.p_value


def test_less_scatter_than_stated_is_no_sign_of_anything(study):
    quiet = replace(study.noise, pose_jitter=0.1 * study.noise.pose_jitter, reading=0.3 * study.noise.reading)
    found = parts(study, read(study, conditions(study, 24, 3), 1, noise=quiet))
    assert min(part.p_value for part in found[2:]) > 0.5
