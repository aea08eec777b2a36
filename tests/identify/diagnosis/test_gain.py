"""What naming the causes gains: on visits that took no part, with honest intervals."""

from dataclasses import replace

import numpy as np
import pytest

from identify.diagnosis import gain as module
from identify.diagnosis.gain import Gain, gain
from identify.diagnosis.search import search
from identify.effects import REGISTRY
from tests.identify.diagnosis.cases import arm, conditions, read
from tests.identify.studies import EXACT

HIDDEN = {"geometry.j3.offset": 0.4, "geometry.j3.a": 0.3}
FEW = frozenset(REGISTRY) - {"geometry", "load_com", "base_compliance", "transmission_error"}


@pytest.fixture(scope="module")
def study():
    return arm()


def searched(study, data):
    return search(study, data, gate="holm", differences=False, rng=np.random.default_rng(0), without=FEW, rivals=False)


def gained(study, data, seed=0):
    done = searched(study, data)
    return gain(study, done, differences=False, rng=np.random.default_rng(seed), without=FEW)


@pytest.fixture
def judged(monkeypatch):
    """What is finally judged, call by call: squared errors before and after and the visit of each row."""
    calls, plain = [], module._judged

    def kept(before, after, visit, noise, rng):
        calls.append((before, after, visit))
        return plain(before, after, visit, noise, rng)

    monkeypatch.setattr(module, "_judged", kept)
    return calls


def test_every_visit_is_judged_once_by_a_search_that_had_no_part_of_it(study, monkeypatch):
    trained, plain = [], module.search

    def watched(base, part, **options):
        trained.append(set(part.experiment.row_visit.tolist()))
        return plain(base, part, **options)

    monkeypatch.setattr(module, "search", watched)
    found = gained(study, read(study, conditions(study, 17, 3), 4, HIDDEN))
    everything = set(range(17))
    left_out = [everything - visits for visits in trained]
    assert sorted(visit for fold in left_out for visit in fold) == sorted(everything)
    assert [len(fold) for fold in left_out] == [4, 4, 3, 3, 3]
    assert found.visits == 17


def test_a_spoilt_visit_does_not_change_the_errors_of_those_that_are_judged_with_it(study, judged):
    """They are judged by models that have not seen it; all other visits are judged by models that have."""
    data = read(study, conditions(study, 15, 3), 4, HIDDEN)
    positions = data.positions.copy()
    positions[data.experiment.row_visit == 7] += [5e-5, -3e-5, 4e-5]
    for each in (data, replace(data, positions=positions)):
        gained(study, each)
    (before, after, visit), (spoilt, spoilt_after, same) = judged
    np.testing.assert_array_equal(visit, same)
    moved = np.array([np.abs(np.sqrt(spoilt) - np.sqrt(before))[visit == v].max() for v in range(15)])
    moved_after = np.array([np.abs(np.sqrt(spoilt_after) - np.sqrt(after))[visit == v].max() for v in range(15)])
    unmoved = np.flatnonzero(moved < 1e-7)
    assert len(unmoved) == 2  # its fold has three visits
    assert (moved_after[unmoved] < 1e-7).all()
    assert moved[7] > 2e-5
    assert np.delete(moved, [7, *unmoved]).min() > 3e-7


def test_with_the_right_cause_the_error_comes_down_to_the_noise(study):
    found = gained(study, read(study, conditions(study, 25, 3), 4, HIDDEN))
    assert found.before > 3.0 * found.noise
    assert 0.8 < found.after / found.noise < 1.25
    assert found.significant
    assert found.interval[0] < found.after / found.before < found.interval[1]


def test_without_a_cause_no_gain_is_claimed(study):
    found = gained(study, read(study, conditions(study, 20, 3), 4))
    assert found.after == found.before
    assert found.interval == (1.0, 1.0)
    assert not found.significant


@pytest.mark.parametrize(("interval", "claimed"), [((0.5, 0.99), True), ((0.5, 1.0), False), ((0.9, 1.1), False)])
def test_a_gain_is_claimed_only_if_the_interval_lies_below_one(interval, claimed):
    assert Gain(2.0, 1.0, 1.0, 10, interval).significant == claimed


def test_the_interval_is_that_of_resampled_visits():
    """Rows of a visit err together; resampling rows would make the interval far too narrow."""
    rng = np.random.default_rng(5)
    visits, rows = 20, 12
    visit = np.repeat(np.arange(visits), rows)
    before = np.repeat(rng.chisquare(2, visits), rows)
    after = 0.3 * np.repeat(rng.chisquare(1, visits), rows)
    found = module._judged(before, after, visit, 1.0, np.random.default_rng(6))

    def interval(groups):
        ratios = []
        for _ in range(4000):
            chosen = rng.integers(0, len(groups), len(groups))
            index = np.concatenate([groups[g] for g in chosen])
            ratios.append(np.sqrt(after[index].sum() / before[index].sum()))
        return np.quantile(ratios, [0.025, 0.975])

    by_visit = interval([np.flatnonzero(visit == v) for v in range(visits)])
    np.testing.assert_allclose(found.interval, by_visit, rtol=0.06)
    by_row = interval([np.array([row]) for row in range(len(visit))])
    assert np.ptp(found.interval) > 2.0 * np.ptp(by_row)
    assert found.before == pytest.approx(np.sqrt(before.mean()))


def test_the_noise_floor_is_what_the_stated_noise_leaves():
    """Against simulated readings of the true model without any fit."""
    study = arm()
    experiment = conditions(study, 200, 3)
    clean, noisy = (read(study, experiment, 5, noise=noise).positions for noise in (EXACT, study.noise))
    rms = np.sqrt(((noisy - clean) ** 2).sum(axis=1).mean())
    found = searched(study, read(study, conditions(study, 20, 3), 4))
    assert module._noise_rms(found.last, study.noise, "absolute") == pytest.approx(rms, rel=0.1)
