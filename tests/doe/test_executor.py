"""The same work here, in processes and on a Dask cluster with two workers: the same bytes, in the same order."""

import numpy as np
import pytest
from distributed import LocalCluster

from doe.executor import HERE, executor_of
from identify.errors import InputError


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A scheduler with two worker processes."""
    folder = str(tmp_path_factory.mktemp("workers"))
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=folder, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def inverse(seed):
    return np.linalg.inv(np.random.default_rng(seed).normal(size=(120, 120)))


def test_processes_and_a_cluster_give_the_same_bytes_in_the_same_order(address):
    items = list(range(7))
    here = HERE.map(inverse, items)
    with executor_of(2) as processes:
        there = processes.map(inverse, items)
    with executor_of(scheduler=address) as cluster:
        far = cluster.map(inverse, items)
    for one, two, three in zip(here, there, far, strict=True):
        assert one.tobytes() == two.tobytes() == three.tobytes()


def failing(item):
    raise InputError(f"item {item} is wrong")


def test_an_error_comes_back_as_it_is(address):
    for executor in (executor_of(1), executor_of(2), executor_of(scheduler=address)):
        with executor as one, pytest.raises(InputError, match="item 3 is wrong"):
            one.map(failing, [3, 3])


@pytest.mark.parametrize("scheduler", ["nonsense", "tcp://127.0.0.1:1", "tcp://127.0.0.1", "tcp://127.0.0.1:99999"])
def test_where_nobody_answers_the_address_is_named(scheduler):
    with (
        pytest.raises(InputError, match=f"--scheduler {scheduler}: no Dask scheduler answers"),
        executor_of(scheduler=scheduler),
    ):
        pass


def test_no_workers_are_refused():
    with pytest.raises(InputError, match="--workers 0"):
        executor_of(0)
