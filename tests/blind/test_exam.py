"""A short blind exam: half its seeds are fixed, half are fresh; promises are refuted beyond chance only."""

import secrets

import pytest

from tests.blind.exam import run_exam
from tests.blind.targets import report

ALPHA = 2e-5  # of each promise; all of them together raise a false alarm less than once in a thousand runs
FIXED = range(20_000, 20_020)


@pytest.fixture(scope="module")
def outcomes():
    fresh = secrets.randbelow(10**6) * 1000 + 10**6
    print(f"fresh seeds from {fresh}")
    return fresh, run_exam([*FIXED, *range(fresh, fresh + 20)], more=False)


def test_no_promise_is_refuted(outcomes):
    fresh, results = outcomes
    text, broken = report(results, ALPHA)
    print(text)
    assert not broken, f"python -m tests.blind --seed {fresh} --cases 20\n{text}"


def test_every_diagnosis_ends_well(outcomes):
    fresh, results = outcomes
    failed = [(o["seed"], o["kind"], o["error"]) for o in results if "error" in o]
    assert not failed, f"fresh seeds from {fresh}"


def test_right_verdicts_predict_as_well_as_the_true_model():
    results = run_exam(range(30_000, 30_004), ["joint_hardening", "tracker_scale", "base_compliance", "load_com"])
    gains = [o["gain"] for o in results if "gain" in o]
    assert len(gains) >= 1
    assert sorted(gains)[len(gains) // 2] <= 1.3
