"""The same work here, in processes and on a Dask cluster with two workers: the same bytes, in the same order."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from doe import candidates, continuous, executor, observations
from doe.candidates import sampled_range
from doe.cli import run
from doe.design_choices import decide
from doe.executor import HERE, executor_of
from doe.feasible import screen
from doe.observations import observer
from identify.config import load_study
from identify.errors import InputError, NotIdentifiable
from tests.doe.study_files import ARM, KR270, study_file

STUDIES = Path(__file__).parents[2] / "configs" / "studies"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A scheduler with two worker processes."""
    folder = str(tmp_path_factory.mktemp("workers"))
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", local_directory=folder, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def inverse(seed):
    return np.linalg.inv(np.random.default_rng(seed).normal(size=(120, 120)))


def test_processes_and_a_cluster_give_the_same_bytes_in_the_same_order(address, monkeypatch):
    monkeypatch.setattr(executor, "_START", 0.0)  # also short work is sent away
    items = list(range(7))
    here = HERE.map(inverse, items)
    with executor_of(2) as processes, executor_of(scheduler=address) as cluster:
        for one, two, three in zip(here, processes.map(inverse, items), cluster.map(inverse, items), strict=True):
            assert one.tobytes() == two.tobytes() == three.tobytes()


def ending(item):
    os._exit(1)


def test_a_process_that_ends_is_told(monkeypatch):
    monkeypatch.setattr(executor, "_START", -1.0)
    with executor_of(2) as two:
        two.seconds[executor._kind(ending)] = 0.0
        with pytest.raises(InputError, match="give fewer workers"):
            list(two.map(ending, range(3)))


def process(item):
    return os.getpid()


def test_processes_are_started_for_work_that_is_worth_it_alone(monkeypatch):
    with executor_of(2) as two:
        assert set(two.map(process, range(8))) == {os.getpid()}
        monkeypatch.setattr(executor, "_START", 0.0)
        assert os.getpid() not in set(two.map(process, range(8)))
        assert set(two.map(process, range(8))) == {os.getpid()}  # by now known to be shorter than the way there
        monkeypatch.setattr(executor, "_SEND", 0.0)
        assert os.getpid() not in set(two.map(process, range(8)))
        assert set(two.map(process, [0])) == {os.getpid()}


#: A plan whose candidates, blocks, ascents, restarts and stations all come in several pieces.
SPLIT = {
    "tracker_stations": [
        {"id": "near", "position_mm": [4000.0, 1000.0, 1000.0]},
        {"id": "far", "position_mm": [9000.0, 1000.0, 1000.0]},
    ],
    "noise": {"reading_mm": None, "tracker": {"radial_um": 5.0, "transverse_um": 10.0, "transverse_um_per_m": 6.0}},
    "plan": {"candidates": 1200, "restarts": 2, "poses": 3, "curve": False, "stations": ["near", "far"]},
    "constraints": {"floor_mm": 0.0},
}


def counted(monkeypatch):
    """Kinds of work that are given to a cluster from now on, with the number of pieces."""
    sent, send = [], executor._Cluster.map

    def counting(self, work, items):
        sent.append((executor._kind(work), len(items)))
        return send(self, work, items)

    monkeypatch.setattr(executor._Cluster, "map", counting)
    return sent


def test_a_plan_split_over_two_workers_of_a_cluster_is_the_local_one_bit_for_bit(address, tmp_path, monkeypatch):
    monkeypatch.setattr(executor, "_START", 0.0)
    monkeypatch.setattr(executor, "_SEND", 0.0)
    for module, name, size in ((observations, "_CHUNK", 300),
                               (candidates, "_GROUPED", 1), (continuous, "TOGETHER", 45)):  # fmt: skip
        monkeypatch.setattr(module, name, size)
    sent = counted(monkeypatch)
    study = study_file(tmp_path, ARM, **SPLIT)
    where = {"here": ["--workers", "1"], "processes": ["--workers", "2"], "cluster": ["--scheduler", address]}
    for name, words in where.items():
        assert run(["plan", str(study), "--out", str(tmp_path / name), "--quiet", *words]) == 0
    several = {kind for kind, pieces in sent if pieces > 1}
    assert several == {
        "doe.design_choices._tried", "doe.candidates._codes", "doe.observations.Observer._piece",
        "doe.continuous._climb", "doe.local_search.iterate",
    }  # fmt: skip
    for file in ("plan.json", "plan.csv", "planned.toml"):
        here, *others = ((tmp_path / name / file).read_bytes() for name in where)
        assert others == [here, here]
    judged = ["evaluate", str(study), str(tmp_path / "here" / "plan.csv"), "--quiet"]
    for name in ("here", "cluster"):
        assert run([*judged, "--out", str(tmp_path / f"judged_{name}"), *where[name]]) == 0
    here, far = ((tmp_path / f"judged_{name}" / "evaluate.json").read_bytes() for name in ("here", "cluster"))
    assert far == here


def test_where_nobody_answers_nothing_is_written(tmp_path, capsys):
    study = study_file(tmp_path, KR270)
    words = ["plan", str(study), "--out", str(tmp_path / "out")]
    assert run([*words, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert run([*words, "--workers", "0"]) == 2
    assert "--workers 0: at least 1 expected" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", sorted(path.name for path in STUDIES.glob("*.toml") if "both" not in path.name))
def test_what_is_sent_away_arrives_as_it_was(name):
    study, _ = decide(load_study(STUDIES / name), seed=0)
    watching = observer(study)
    q = drawn(study, 20)
    loads = np.zeros((20, 1), dtype=np.int64)
    assert pickle.loads(pickle.dumps(watching)).blocks(q, loads).tobytes() == watching.blocks(q, loads).tobytes()
    tests = screen(study)
    assert pickle.loads(pickle.dumps(tests)).codes(q).tobytes() == tests.codes(q).tobytes()


def drawn(study, count):
    return np.random.default_rng(0).uniform(*sampled_range(study), (count, study.robot.n))


def failing(item):
    raise InputError(f"item {item} is wrong")


def test_an_error_comes_back_as_it_is(address):
    for choice in (executor_of(1), executor_of(2), executor_of(scheduler=address)):
        with choice as one, pytest.raises(InputError, match="item 3 is wrong"):
            list(one.map(failing, [3, 3]))


def unseen(item):
    raise NotIdentifiable(f"item {item} is not seen", ("a", item))


def test_what_an_error_holds_comes_back_too(address):
    with executor_of(scheduler=address) as cluster, pytest.raises(NotIdentifiable) as error:
        list(cluster.map(unseen, [5]))
    assert error.value.missing == ("a", 5)


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
