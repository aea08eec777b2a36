"""Simulated readings: what the model says, displaced by jitter and noise of the stated size."""

from dataclasses import replace

import numpy as np
import pytest

from identify.alignment import align, inverse
from identify.model import model_of
from identify.response import respond
from identify.simulate import default_placement
from identify.study import Noise, Tracker
from tests.identify.studies import (
    COMPLIANCE,
    EXACT,
    NOISE,
    experiment_of,
    kr270_study,
    measured,
    placement_of,
    poses,
    readings,
    values_of,
)


def test_without_noise_readings_are_the_model_seen_from_the_measurement_frame():
    rng = np.random.default_rng(1)
    study = kr270_study()
    experiment = experiment_of(study, poses(study, 6, rng))
    placement = placement_of(rng)
    data = readings(study, experiment, COMPLIANCE, rng, noise=EXACT, placement=placement)
    model = model_of(study)
    expected = respond(model, experiment, values_of(model, COMPLIANCE)).position
    np.testing.assert_allclose(data.positions @ placement[:3, :3].T + placement[:3, 3], expected, atol=1e-12)
    assert data.lines.tolist() == list(range(2, 2 + len(expected)))
    assert data.experiment.q is not None
    np.testing.assert_array_equal(data.experiment.q, experiment.q)  # commanded, not jittered


def test_each_kind_of_noise_is_shared_by_the_rows_it_belongs_to():
    rng = np.random.default_rng(2)
    study = kr270_study()
    experiment = experiment_of(study, np.repeat(poses(study, 1, rng), 300, axis=0))
    model = model_of(study)
    exact = respond(model, experiment, model.nominal).position.reshape(300, 2, 3, 3)
    floor = replace(EXACT, reading=1e-12)

    def error(noise):
        data = readings(study, experiment, {}, rng, noise=noise, placement=np.eye(4))
        return data.positions.reshape(300, 2, 3, 3) - exact

    pose = error(replace(floor, pose_jitter=12e-6))
    assert np.abs(pose[:, 0] - pose[:, 1]).max() < 1e-10  # common to the loads of a visit
    assert 1e-5 < pose.std() < 6e-5
    shot = error(replace(floor, reading_jitter=12e-6))
    assert np.corrcoef(shot[:, 0, 0, 2], shot[:, 1, 0, 2])[0, 1] ** 2 < 0.05  # new for each load
    assert np.corrcoef(shot[:, 0, 0, 2], shot[:, 0, 1, 2])[0, 1] > 0.9  # common to its markers
    own = error(Noise(reading=0.03e-3))
    assert own.std() == pytest.approx(0.03e-3, rel=0.03)
    assert np.corrcoef(own[:, 0, 0, 0], own[:, 0, 1, 0])[0, 1] ** 2 < 0.05


def test_the_same_seed_gives_the_same_readings_and_another_seed_others():
    study = kr270_study()
    one, again, other = (measured(study, np.random.default_rng(seed)).positions for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 1e-5


def test_a_free_frame_stands_at_the_station_and_a_base_frame_in_the_base():
    station = np.array([3.0, -1.0, 0.5])
    noise = replace(NOISE, tracker=Tracker(1e-6, 1e-6, 1e-6, 1e-6, station=station))
    np.testing.assert_array_equal(default_placement(noise, frame_free=True)[:3, 3], station)
    np.testing.assert_array_equal(default_placement(noise, frame_free=False), np.eye(4))
    np.testing.assert_array_equal(default_placement(NOISE, frame_free=True), np.eye(4))


def test_alignment_finds_a_placement_through_wild_points_and_inverts():
    rng = np.random.default_rng(7)
    points, placement = rng.normal(0, 1, (60, 3)), placement_of(rng)
    back = inverse(placement)
    seen = points @ back[:3, :3].T + back[:3, 3]
    np.testing.assert_allclose(align(seen, points), placement, atol=1e-12)
    np.testing.assert_allclose(back @ placement, np.eye(4), atol=1e-14)
    seen[:5] += rng.normal(0, 3, (5, 3))
    noisy = seen + rng.normal(0, 1e-3, seen.shape)
    np.testing.assert_allclose(align(noisy, points), placement, atol=0.05)
