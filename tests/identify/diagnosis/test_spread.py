"""Sizes of the noise as found in residuals, and noise that grows with the distance."""

from dataclasses import replace

import numpy as np
import pytest

from identify.diagnosis.spread import NoiseFound, noise_found, range_noise, scaled, wider
from identify.study import Noise, Tracker
from tests.identify.diagnosis.cases import COMPLIANCE, NOISE, arm, conditions, fit_of, read
from tests.identify.studies import readings

STATED = replace(NOISE, reading_jitter=6e-6)
DRAWS = range(8)


def found_sizes(stated, true, *, differences=False):
    """Mean over draws of (reading, reading jitter, pose jitter), as multiples of what was stated."""
    study = arm(noise=stated, reference="differences" if differences else "absolute")
    experiment = conditions(study, 40, 3)
    drawn = [noise_found(fit_of(study, read(study, experiment, seed, noise=true)), stated) for seed in DRAWS]
    return np.mean([[d.reading, d.reading_jitter, d.pose_jitter] for d in drawn], axis=0)


@pytest.mark.parametrize(
    ("part", "factor"),
    [("", 1.0), ("reading", 1.5), ("reading_jitter", 2.0), ("pose_jitter", 2.0)],
    ids=["as stated", "reading", "reading jitter", "pose jitter"],
)
def test_each_part_of_the_noise_is_found_in_its_size(part, factor):
    """The others stay at one. Single sizes scatter by 0.035, 0.25 and 0.15; the mean of eight by a third of it."""
    true = replace(STATED, **{part: factor * getattr(STATED, part)}) if part else STATED
    expected = [factor if name == part else 1.0 for name in ("reading", "reading_jitter", "pose_jitter")]
    found = found_sizes(STATED, true)
    assert abs(found[0] - expected[0]) < 0.04
    assert abs(found[1] - expected[1]) < 0.3
    assert abs(found[2] - expected[2]) < 0.25


def test_what_the_fit_took_up_is_made_good():
    """Ten poses against some 25 unknowns: the residual alone would make the noise 7 % smaller than it is."""
    study = arm(noise=Noise(reading=NOISE.reading))
    experiment = conditions(study, 10, 3)
    drawn = [noise_found(fit_of(study, read(study, experiment, seed)), study.noise).reading for seed in range(30)]
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.03)


def test_changes_between_loads_show_the_reading_and_hide_the_pose_jitter():
    found = found_sizes(STATED, replace(STATED, reading=1.5 * STATED.reading), differences=True)
    assert abs(found[0] - 1.5) < 0.06
    assert found[2] == 1.0
    assert abs(found[1] - 1.0) < 0.4


def test_jitters_that_are_not_stated_are_not_estimated():
    plain = Noise(reading=NOISE.reading)
    found = found_sizes(plain, replace(plain, reading=2.0 * plain.reading))
    assert found[1] == found[2] == 1.0
    assert abs(found[0] - 2.0) < 0.06


def test_noise_is_scaled_part_by_part_and_made_no_smaller_where_asked():
    assert scaled(STATED, NoiseFound(0.5, 3.0, 1.0)).reading == 0.5 * STATED.reading
    made = scaled(STATED, wider(NoiseFound(0.5, 3.0, 1.0)))
    assert made.reading == STATED.reading
    assert made.reading_jitter == pytest.approx(3.0 * STATED.reading_jitter)
    assert made.pose_jitter == STATED.pose_jitter
    instrument = Tracker(1e-5, 2e-6, 3e-5, 4e-6)
    louder = scaled(replace(STATED, tracker=instrument), NoiseFound(2.0, 1.0, 1.0)).tracker
    assert (louder.radial, louder.radial_per_m) == pytest.approx((2e-5, 4e-6))
    assert (louder.transverse, louder.transverse_per_m) == pytest.approx((6e-5, 8e-6))


def test_the_noise_as_found_is_consistent_with_the_residual():
    """Fitted again with it, chi2 is about its degrees of freedom."""
    study = arm(noise=STATED)
    true = replace(STATED, reading=1.7 * STATED.reading, pose_jitter=1.7 * STATED.pose_jitter)
    found = fit_of(study, read(study, conditions(study, 30, 4), 5, noise=true))
    assert found.chi2 > 2.0 * found.dof
    wider = replace(study, noise=scaled(STATED, noise_found(found, STATED)))
    again = fit_of(wider, found.data)
    assert 0.85 < again.chi2 / again.dof < 1.15


# --- the distance to the instrument


def seen_from_aside(study, seed, noise, count=30):
    """Readings of an instrument that stands near one side of the robot."""
    placement = np.eye(4)
    placement[:3, 3] = [2.5, -1.5, 0.5]
    rng = np.random.default_rng(seed)
    return readings(study, conditions(study, count, seed), COMPLIANCE, rng, noise=noise, placement=placement)


def test_constant_noise_is_rarely_said_to_grow():
    study, values = arm(), []
    for seed in range(40):
        found = range_noise(fit_of(study, seen_from_aside(study, seed, study.noise)), study.noise)
        values.append(found.p_value)
    assert np.mean(np.array(values) < 0.05) <= 0.125
    assert np.mean(np.array(values) < 0.5) >= 0.3
    assert min(values) > 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_grows_with_the_distance_is_found_with_about_its_size(seed):
    study, true = arm(), Tracker(5e-6, 15e-6, 5e-6, 15e-6)
    data = seen_from_aside(study, seed, replace(study.noise, reading=0.0, tracker=true), count=60)
    found = range_noise(fit_of(study, data), study.noise)
    assert found.p_value < 1e-3
    made = found.noise.tracker
    assert found.noise.reading == 0.0
    assert made.radial == made.transverse
    for distance in (2.0, 4.0):  # m, about the nearest and the farthest
        size = made.radial + made.radial_per_m * distance
        assert size == pytest.approx(true.radial + true.radial_per_m * distance, rel=0.3)


def test_the_question_is_not_asked_where_it_has_no_answer():
    study = arm()
    stated = replace(study, noise=replace(study.noise, reading=0.0, tracker=Tracker(2e-5, 1e-6, 2e-5, 1e-6)))
    assert range_noise(fit_of(stated, seen_from_aside(study, 1, study.noise)), stated.noise) is None
    few = seen_from_aside(study, 1, study.noise, count=8)
    assert range_noise(fit_of(study, few), study.noise) is None
    fixed = arm(frame_free=False)
    assert range_noise(fit_of(fixed, read(fixed, conditions(fixed, 20, 1), 1)), fixed.noise) is None
