"""Accuracy against the number of experiments: against plans made one by one, bounds, and pictures of it."""

import json
import math
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from doe import view
from doe.accuracy import accuracy
from doe.cli import run
from doe.curve import accuracy_curve, sizes
from doe.evaluate import evaluate
from doe.plan import plan
from doe.pool import build_pool
from identify.experiment import full_experiment
from tests.doe.study_files import KR270, study, study_file


def curve_of(whole, counts, **more):
    pool = build_pool(whole, 0)
    judge = partial(accuracy, whole, pool.objective.rows)
    return accuracy_curve(pool.objective, whole.plan, judge, counts, 0, pool=pool, **more)


def test_sizes_spread_over_the_range_and_hold_the_plan():
    assert sizes(30, also=15) == [1, 2, 3, 4, 7, 11, 15, 18, 30]
    assert sizes(12, first=3, also=6)[0] == 3
    assert sizes(0) == [1]


@pytest.mark.parametrize("criterion", ["test_pose", "D", "G"])
@pytest.mark.parametrize("repeats", [True, False])
def test_nothing_is_below_the_bound_and_more_experiments_tell_more(tmp_path, criterion, repeats):
    settings = {"criterion": criterion, "repeats": repeats, "candidates": 150, "refine": False}
    whole = study(tmp_path, KR270, plan=settings)
    points = curve_of(whole, [1, 2, 4, 8, 16])
    for point in points:
        for reached in (point.plan, point.random):
            if reached is not None:
                assert point.bound <= reached.rms * (1 + 1e-9)
                assert reached.rms < reached.rms_total < reached.radius
    assert points[0].random is not None
    for kind in ("plan", "random"):
        rms = [getattr(point, kind).rms for point in points if getattr(point, kind) is not None]
        assert all(a > b for a, b in pairwise(rms))
    assert points[-1].plan.rms < 0.8 * points[-1].random.rms
    if criterion == "test_pose":
        assert points[3].plan.rms < 1.02 * plan(whole).grid.value ** 0.5


def test_the_bound_of_a_size_is_that_of_a_plan_of_this_size(tmp_path):
    for repeats in (True, False):
        whole = study(tmp_path, KR270, plan={"candidates": 30, "refine": False, "repeats": repeats})
        made = plan(whole)
        (point,) = curve_of(whole, [8])
        assert point.bound == pytest.approx(math.sqrt(made.grid.bound), rel=1e-5)
    capped, beyond = curve_of(whole, [30, 31])
    assert capped.bound is not None
    assert beyond.bound is beyond.plan is beyond.random is None, "31 different ones of 30"


def test_given_visits_are_judged_in_their_order(tmp_path):
    """The first k visits of a file are worth what a file of these k is worth, whatever their layout."""
    whole = study(tmp_path, KR270, plan={"candidates": 100})
    q = build_pool(whole, 0).candidates.visit_q[[5, 40, 7, 80, 33, 21]]
    loads = np.tile([0, 1], (6, 1))
    experiment = full_experiment(q, loads, whole.loads, whole.markers)
    ragged = experiment.with_rows(np.delete(np.arange(len(experiment.row_shot)), [2, 20]))  # two readings are missing
    for given in (experiment, ragged):
        judged = evaluate(whole, given)
        judge = partial(accuracy, whole, judged.objective.rows)
        points = accuracy_curve(judged.objective, whole.plan, judge, [2, 3, 5, 6], 0, pool=judged.pool, own=judged.own)
        for point in points:
            first = given.of_rows(np.flatnonzero(given.row_visit < point.poses))
            alone = evaluate(whole, first)
            assert point.own.rms == pytest.approx(math.sqrt(alone.objective.value(alone.information)), rel=1e-9)
            assert point.bound <= point.own.rms


def test_too_few_visits_for_the_parameters_have_no_accuracy(tmp_path):
    model = {"effects": ["joint_compliance", "base_compliance@base"], "reference": "differences"}
    whole = study(tmp_path, KR270, model=model, plan={"candidates": 200, "loads": ["L1", "L2"]})
    drawn = build_pool(whole, 0).candidates
    many = full_experiment(drawn.visit_q[:9], drawn.visit_loads[:9], whole.loads, whole.markers)
    judged = evaluate(whole, many)
    judge = partial(accuracy, whole, judged.objective.rows)
    first, last = accuracy_curve(judged.objective, whole.plan, judge, [1, 9], 0, pool=None, own=judged.own)
    assert first.own is None
    assert last.own is not None
    assert last.plan is last.random is None, "there is nothing to choose from"


def read(folder, name):
    return json.loads((folder / name).read_text(encoding="utf-8"))


def test_plan_and_evaluate_write_the_curve_and_the_report_draws_it(tmp_path, capsys):
    file = study_file(tmp_path, KR270, plan={"candidates": 100, "poses": 6})
    out = tmp_path / "out"
    assert run(["plan", str(file), "--out", str(out), "--quiet"]) == 0
    assert "impossible below  designed  random" in capsys.readouterr().out
    points = read(out, "plan.json")["curve"]
    assert {"poses", "bound_mm", "plan_mm", "plan_total_mm", "plan_radius_mm", "random_mm"} <= set(points[0])
    assert 6 in [point["poses"] for point in points]
    assert all(point["bound_mm"] <= point["plan_mm"] for point in points if point["plan_mm"])
    judged = tmp_path / "judged"
    assert run(["evaluate", str(file), str(out / "plan.csv"), "--out", str(judged), "--quiet"]) == 0
    last = read(judged, "evaluate.json")
    assert last["curve"][-1]["own_mm"] == pytest.approx(last["criterion"]["rms_mm"], rel=1e-9)
    assert run(["report", str(judged), "--quiet"]) == 0
    page = (judged / "report.html").read_text(encoding="utf-8")
    assert "accuracy against the number of experiments" in page
    assert "these poses, first ones first" in page


def test_a_study_can_do_without_the_curve(tmp_path):
    file = study_file(tmp_path, KR270, plan={"candidates": 100, "poses": 6, "refine": False, "curve": False})
    assert run(["plan", str(file), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert read(tmp_path / "out", "plan.json")["curve"] == []


def test_the_picture_shows_every_series_and_the_tolerance():
    counts = np.array([1, 2, 4, 8])
    bound = 0.02 / np.sqrt(counts)
    errors = {"designed": 1.02 * bound, "random": np.array([np.nan, 0.1, 0.05, 0.02]), "my poses": 2 * bound}
    figure = view.accuracy_curve(counts, bound, errors, tolerance=0.05)
    shown = [text.get_text() for text in figure.axes[0].legend_.texts]
    assert shown == ["impossible", "designed", "random", "my poses", "tolerance 0.05 mm"]
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), errors["designed"])
