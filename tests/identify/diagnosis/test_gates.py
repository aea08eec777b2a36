"""What passes the gates when nothing is missing, with noise as stated and with noise stated wrongly."""

from dataclasses import replace

import numpy as np
import pytest
from statsmodels.stats.multitest import multipletests

from identify import whitened_rows
from identify.diagnosis.evidence import evidence
from identify.diagnosis.gates import family_probabilities, flip_probabilities, holm_probabilities
from identify.diagnosis.library import tried
from identify.loads import Markers
from identify.noise import Whitening
from tests.identify.diagnosis.cases import NOISE, Trials, arm, block, conditions, fit_of, library, read

DRAWS = range(1, 41)


@pytest.fixture(scope="module")
def trials():
    study = arm()
    return Trials(study, conditions(study, 15, 1))


@pytest.mark.parametrize("seed", range(5))
def test_holms_rule_is_that_of_statsmodels(seed):
    rng = np.random.default_rng(seed)
    single = np.concatenate([rng.uniform(size=30), rng.uniform(0, 1e-4, 8), [0.0, 1.0, 0.5, 0.5]])
    np.testing.assert_allclose(holm_probabilities(single), multipletests(single, method="holm")[1], rtol=1e-12)


def test_with_the_right_covariance_holms_rule_keeps_its_level(trials):
    assert sum(trials.named(trials.seen(seed, "holm"), "holm") for seed in DRAWS) <= 2


def test_with_pose_jitter_stated_half_as_large_only_holms_rule_names_things(trials):
    """Taking the stated noise at its word names something often; estimating it and flipping visits does not."""
    true = replace(NOISE, pose_jitter=2 * NOISE.pose_jitter)
    assert np.mean([trials.named(trials.seen(seed, "holm", true), "holm") for seed in DRAWS]) > 0.25
    assert np.mean([trials.named(trials.seen(seed, "flip", true), "flip") for seed in DRAWS]) <= 0.05


def test_one_noisy_marker_names_things_by_holms_rule_but_not_by_flips():
    """No size of the stated parts describes such noise; the flips need none."""
    rng = np.random.default_rng(3)
    many = Markers(tuple(f"M{i}" for i in range(1, 9)), rng.uniform(-0.25, 0.25, (8, 3)), np.zeros(8, dtype=bool))
    study = arm(markers=many)
    trials = Trials(study, conditions(study, 12, 1))

    def shaken(data, rng):
        noisy = (data.experiment.row_marker == 1)[:, None]
        return data.positions + noisy * rng.normal(0, 12 * NOISE.reading, data.positions.shape)

    by_holm, by_flips = [], []
    for seed in DRAWS:
        seen = trials.seen(seed, "flip", spoil=shaken)
        by_holm.append(trials.named(seen, "holm"))
        by_flips.append(trials.named(seen, "flip"))
    assert np.mean(by_holm) > 0.4
    assert np.mean(by_flips) < 0.2


def rows_alone(scene, noise, station, **options):
    """Whitening that takes each coordinate of each row for independent, with its right variance."""
    groups = []
    for index, operator in whitening(scene, noise, station, **options).groups:
        variance = (np.linalg.inv(operator) ** 2).sum(axis=2)
        groups.append((index, np.eye(operator.shape[1]) / np.sqrt(variance)[:, :, None]))
    return Whitening(tuple(groups), False)


whitening = whitened_rows.whitening


@pytest.mark.parametrize("together", [True, False], ids=["covariance of visits", "independent rows"])
def test_only_the_covariance_of_whole_visits_keeps_false_names_away(together, monkeypatch):
    """Pose jitter moves all rows of a visit alike; who counts them as independent finds causes in it."""
    study = arm(noise=replace(NOISE, pose_jitter=4 * NOISE.pose_jitter))
    if not together:
        monkeypatch.setattr(whitened_rows, "whitening", rows_alone)
    trials = Trials(study, conditions(study, 15, 1))
    named = sum(trials.named(trials.seen(seed, "holm"), "holm") for seed in range(1, 21))
    assert named <= 1 if together else named >= 14


def test_a_real_cause_passes_both_gates_and_most_others_do_not():
    study = arm()
    found = fit_of(study, read(study, conditions(study, 30, 4), 2, {"geometry.j3.offset": 0.2}))
    asked = library(study, found)
    seen = evidence(found, tried(found, asked))
    own = next(b for b, h in enumerate(asked) if h.entry == "geometry@j3")
    for gate in ("holm", "flip"):
        probability = family_probabilities(seen, gate, np.random.default_rng(0), np.ones(len(asked), dtype=bool))
        assert probability[own] < 0.01
        assert np.mean(probability >= 0.01) > 0.2


def test_what_is_impossible_has_probability_one_and_leaves_the_others_alone(trials):
    data = read(trials.study, trials.experiment, 2, {"geometry.j3.offset": 0.2})
    found = fit_of(trials.study, data)
    seen = evidence(found, trials.blocks)
    every = np.ones(len(trials.blocks), dtype=bool)
    probability = family_probabilities(seen, "holm", np.random.default_rng(0), every)
    best = int(np.argmin(probability))
    every[best] = False
    again = family_probabilities(seen, "holm", np.random.default_rng(0), every)
    assert again[best] == 1.0
    np.testing.assert_array_equal(np.delete(again, best), np.delete(probability, best))


def test_flips_compare_with_the_largest_of_all_blocks(trials):
    """Next to many others a block has to be more extreme than alone; the smallest of many is as rare as it says."""
    rng = np.random.default_rng(5)
    data = read(trials.study, trials.experiment, 3)
    found = fit_of(trials.study, data)
    blocks = [block(rng.normal(size=(*found.residual.shape, 1))) for _ in range(20)]
    seen = evidence(found, blocks)
    alone = [flip_probabilities(seen, [b], np.random.default_rng(0))[0] for b in range(20)]
    together = flip_probabilities(seen, np.arange(20), np.random.default_rng(0))
    assert (together >= np.array(alone) - 1e-12).all()
    assert min(alone) < 0.5 * together.min()
    # independent blocks: the family-wise probability of the smallest is that of a minimum of twenty
    assert together.min() == pytest.approx(1 - (1 - min(alone)) ** 20, abs=0.15)


def test_flips_alone_keep_their_level_over_draws(trials):
    """Family-wise, with noise that is three times as large as stated: no size of it enters."""
    true = replace(NOISE, reading=3 * NOISE.reading, pose_jitter=3 * NOISE.pose_jitter)
    rng = np.random.default_rng(6)
    smallest = []
    for seed in DRAWS:
        found = fit_of(trials.study, read(trials.study, trials.experiment, seed, noise=true))
        seen = evidence(found, trials.blocks[::6])
        smallest.append(flip_probabilities(seen, np.arange(len(seen.where)), rng).min())
    assert np.mean(np.array(smallest) < 0.1) <= 0.2
    assert np.mean(np.array(smallest) < 0.5) >= 0.2
