"""Blocks in memory, in a file, and one array behind another."""

import json
import tracemalloc

import numpy as np
import pytest

from doe import approximate_design, exact_design, observations, storage
from doe.cli import run
from doe.storage import gathered, joined, stacked
from tests.doe.study_files import KR270, study_file


def some(count, k=3, p=4, seed=0):
    return np.random.default_rng(seed).normal(size=(count, k, p))


def test_stacked_blocks_are_read_like_one_array():
    first, second = some(7), some(5, k=2, seed=1)
    both, whole = stacked(first, second), joined(first, second)
    assert both.shape == whole.shape == (12, 3, 4)
    assert (whole[7:, 2] == 0.0).all()
    for key in (slice(0, 3), slice(5, 9), slice(8, 20), slice(None), slice(3, 3), slice(None, None, 5), slice(2, 9, 3)):
        np.testing.assert_array_equal(both[key], whole[key])
    np.testing.assert_array_equal(both[np.array([11, 0, 7, 7, 6])], whole[[11, 0, 7, 7, 6]])
    assert stacked(first, second[:0]) is first
    assert stacked(first[:0], second) is second


def test_the_first_of_stacked_blocks_is_not_copied():
    first, second = some(20_000), some(2, seed=1)
    tracemalloc.start()
    design = approximate_design(stacked(first, second), None, criterion="D")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.75 * first.nbytes + 4e6
    assert design.value == approximate_design(joined(first, second), None, criterion="D").value
    assert exact_design(stacked(first, second), None, 5, criterion="D").counts.sum() == 5


@pytest.mark.parametrize("held", [1 << 20, 10])
def test_parts_are_gathered_in_memory_or_in_a_file(held, monkeypatch):
    monkeypatch.setattr(storage, "HELD", held)
    whole = some(11)
    found = gathered((whole[start : start + 4] for start in (0, 4, 8)), 11)
    assert type(found) is np.ndarray
    np.testing.assert_array_equal(found, whole)
    with pytest.raises(ValueError, match="8 blocks came, 11 were expected"):
        gathered([whole[:4], whole[4:8]], 11)


def test_a_plan_does_not_depend_on_where_its_blocks_stand(tmp_path, monkeypatch):
    study = study_file(tmp_path, KR270, plan={"candidates": 600, "refine": False, "curve": False})
    assert run(["plan", str(study), "--out", str(tmp_path / "memory"), "--quiet"]) == 0
    for module, name in ((storage, "HELD"), (observations, "_CHUNK")):
        monkeypatch.setattr(module, name, 200)
    assert run(["plan", str(study), "--out", str(tmp_path / "file"), "--quiet"]) == 0
    assert (tmp_path / "memory" / "plan.json").read_bytes() == (tmp_path / "file" / "plan.json").read_bytes()
    assert json.loads((tmp_path / "file" / "plan.json").read_text())["candidates"] == 600
