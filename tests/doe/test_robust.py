"""Plans that stay good: against all plans and all losses by enumeration, and on fresh draws of nominal values."""

import json
import logging
from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest

from doe.accuracy import accuracy
from doe.cli import run
from doe.draws import drawn_values
from doe.information import covariance_of, information_of
from doe.losses import after_losses, lost_sets
from doe.objective import objective
from doe.observations import observer
from doe.plan import plan
from doe.robustness import value_that_counts
from identify.config import load_study
from identify.errors import InputError, NotIdentifiable
from tests.doe.study_files import KR270, study, study_file
from tests.doe.two_arm_files import write_both

COMPLIANCES = {"j2": 0.3, "j3": 0.4, "j4": 3.0, "j5": 3.3, "j6": 2.4}
#: Blocks of a wind-up depend on where its knee stands, so on nominal values.
WINDUP = {
    "effects": ["joint_compliance", "joint_windup@j3"],
    "joint_windup": {"fit_knee": True},
    "nominal": {
        **{f"joint_compliance.{joint}": value for joint, value in COMPLIANCES.items()},
        "joint_windup.j3.amplitude": 60.0,
        "joint_windup.j3.knee": 300.0,
    },
    "nominal_std_percent": {"joint_windup": 40.0},
    "reference": "absolute",
}
EXACT = {"measurement": "base", "markers": "exact"}


def windup(folder, **settings):
    """A study whose blocks depend on its nominal values."""
    usual = {"poses": 6, "candidates": 100, "refine": False, "loads": ["L1", "L2"], "max_std_percent": 1e6}
    return study(folder, KR270, model=WINDUP, frames=EXACT, plan={**usual, **settings})


# --- losses


@pytest.mark.parametrize("losses", [0, 1, 2])
def test_what_is_left_is_the_sum_without_the_lost(losses):
    rng = np.random.default_rng(0)
    blocks, prior = rng.normal(size=(6, 4, 3)), np.diag([1.0, 2.0, 3.0])
    expected = [information_of(np.delete(blocks, lost, axis=0)) + prior for lost in combinations(range(6), losses)]
    np.testing.assert_allclose(after_losses(blocks, losses, prior), expected, rtol=1e-12)
    assert [tuple(lost) for lost in lost_sets(6, losses)] == list(combinations(range(6), losses))
    assert after_losses(blocks[:1], 2).shape == (0, 3, 3)


def worst(pool, members, losses):
    """Largest value after losing some of the members, by going through all of them."""
    left = [information_of(pool.blocks[np.delete(members, lost)]) for lost in combinations(range(len(members)), losses)]
    return max(pool.objective.value(information) for information in left)


@pytest.mark.parametrize(("losses", "count"), [(1, 4), (1, 3), (2, 4)])
@pytest.mark.parametrize("criterion", ["test_pose", "D", "G"])
def test_the_search_finds_the_best_of_all_plans_after_the_worst_loss(tmp_path, losses, count, criterion):
    """All multisets of 14 candidates."""
    settings = {"candidates": 14, "poses": count, "refine": False, "criterion": criterion, "max_std_percent": 1e6}
    made = plan(study(tmp_path, KR270, plan={**settings, "robust_to_losses": losses}))
    pool, found = made.pool, made.robust
    every = [np.array(members) for members in combinations_with_replacement(range(14), count)]
    values = [worst(pool, members, losses) for members in every]
    best = min(values)
    assert found.reached.bound <= best * (1 + 1e-9)
    assert best * (1 - 1e-9) <= found.reached.value <= 1.02 * best
    own = pool.observer.blocks(made.q, made.visit_loads)[:, :, pool.known.kept]
    lost = np.delete(own, found.lost, axis=0)
    assert pool.objective.value(information_of(lost)) == pytest.approx(found.reached.value, rel=1e-9)
    nominal = plan(study(tmp_path, KR270, plan=settings))
    theirs = pool.observer.blocks(nominal.q, nominal.visit_loads)[:, :, pool.known.kept]
    usual = value_that_counts(pool, nominal.q, nominal.visit_loads, theirs)
    assert found.reached.value <= usual * (1 + 1e-9)
    assert made.final.bound <= nominal.final.value <= made.final.value * (1 + 1e-6)


def test_without_repeats_no_pose_is_taken_twice(tmp_path):
    settings = {"candidates": 30, "poses": 6, "refine": False, "repeats": False, "robust_to_losses": 1}
    made = plan(study(tmp_path, KR270, plan=settings))
    assert len(np.unique(made.q, axis=0)) == 6
    assert made.robust.reached.bound <= made.robust.reached.value


@pytest.mark.parametrize("refine", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_losing_any_visit_of_a_robust_plan_keeps_the_stated_accuracy(tmp_path, refine):
    settings = {"poses": None, "tolerance_mm": 0.0768, "candidates": 150, "refine": refine}
    whole = study(tmp_path, KR270, plan={**settings, "robust_to_losses": 1})
    made, usual = plan(whole), plan(study(tmp_path, KR270, plan=settings))
    aim, kept = made.pool.objective, made.pool.known.kept

    def radii(found):
        own = found.pool.observer.blocks(found.q, found.visit_loads)[:, :, kept]
        left = [information_of(np.delete(own, visit, axis=0)) for visit in range(len(own))]
        return [accuracy(whole, aim.rows, covariance_of(one)).radius(0.95) for one in left]

    assert max(radii(made)) <= 0.0768
    assert max(radii(usual)) > 0.0768, "the usual plan keeps it only if nothing is lost"
    assert len(made.q) > len(usual.q)
    assert made.robust.losses == 1


def test_a_robust_plan_is_refined_where_that_helps_after_losses_too(tmp_path):
    settings = {"poses": 6, "candidates": 150, "robust_to_losses": 1}
    grid, made = (plan(study(tmp_path, KR270, plan={**settings, "refine": refine})) for refine in (False, True))
    assert made.robust.reached.value < grid.robust.reached.value


def test_too_few_visits_to_lose_one_are_refused(tmp_path):
    model = {"effects": ["joint_compliance", "base_compliance@base"], "reference": "differences"}
    settings = {
        "candidates": 100,
        "refine": False,
        "loads": ["L1", "L2"],
        "robust_to_losses": 1,
        "max_std_percent": 1e6,
    }
    with pytest.raises(NotIdentifiable, match="2 poses are too few"):
        plan(study(tmp_path, KR270, model=model, plan={**settings, "poses": 2}))


# --- uncertain nominal values


def test_draws_have_the_stated_spread_and_keep_their_sign(tmp_path):
    whole = windup(tmp_path, draws=64)
    drawn = drawn_values(whole, 0)
    amplitude = np.array([values["joint_windup.j3.amplitude"] for values in drawn])
    assert len(drawn) == 64
    assert (amplitude > 0).all()
    assert amplitude.mean() == pytest.approx(60.0, rel=0.03)
    assert amplitude.std() == pytest.approx(24.0, rel=0.1)
    assert {values["joint_compliance.j2"] for values in drawn} == {0.3}, "nothing is said about it"
    assert drawn == drawn_values(whole, 0)
    assert drawn != drawn_values(whole, 1)


def test_what_is_nominally_zero_is_drawn_at_its_typical_size(tmp_path):
    model = {"effects": ["joint_compliance", "geometry"], "reference": "absolute"}
    whole = study(tmp_path, KR270, model=model, plan={"draws": 64})
    drawn = drawn_values(whole, 0)
    names = [name for name in drawn[0] if name.startswith("geometry.")]
    spread = [np.std([values[name] for values in drawn]) for name in names]
    np.testing.assert_allclose(spread, 0.5, rtol=0.15)


@pytest.mark.parametrize(
    ("percent", "said"),
    [
        ({"joint_windup.j4": 10.0}, "no such parameter or effect"),
        ({"joint_compliance.j1": 10.0}, "its nominal value is 0; state it under"),
    ],
)
def test_percentages_that_fit_nothing_are_refused(tmp_path, percent, said):
    whole = replace(windup(tmp_path, draws=4), nominal_std_percent=percent)
    with pytest.raises(InputError, match=said):
        plan(whole)


def test_draws_without_anything_uncertain_are_refused(tmp_path):
    with pytest.raises(InputError, match="no nominal value is uncertain"):
        plan(study(tmp_path, KR270, plan={"draws": 4}))


def mean_value(made, values):
    """Mean of the criterion of a plan over other nominal values, computed one by one."""
    whole, known = made.pool.observer.study, made.pool.known
    found = []
    for nominal in values:
        watching = observer(replace(whole, nominal=nominal))
        aim = objective(watching, known, whole.plan.criterion)
        found.append(aim.value(information_of(watching.blocks(made.q, made.visit_loads)[:, :, known.kept])))
    return float(np.mean(found))


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D"])
def test_a_plan_for_draws_is_better_on_average_over_fresh_draws(tmp_path, criterion):
    usual = plan(windup(tmp_path, criterion=criterion))
    whole = windup(tmp_path, criterion=criterion, draws=8)
    made = plan(whole)
    known = drawn_values(whole, 0)
    assert made.robust.draws == 8
    assert made.robust.reached.value == pytest.approx(mean_value(made, known), rel=1e-9)
    assert made.robust.reached.value <= mean_value(usual, known)
    fresh = drawn_values(replace(whole, plan=replace(whole.plan, draws=64)), 99)
    gain = 0.99 if criterion == "test_pose" else 1.0
    assert mean_value(made, fresh) <= gain * mean_value(usual, fresh)
    assert usual.final.value <= made.final.value, "at the nominal values themselves the usual plan is best"


def test_the_bound_of_the_mean_is_never_above_the_best_of_all_plans(tmp_path):
    made = plan(windup(tmp_path, candidates=10, poses=3, draws=4, criterion="D"))
    pool, kept = made.pool, made.pool.known.kept
    best = np.inf
    for members in combinations_with_replacement(range(10), 3):
        values = [draw.objective.value(information_of(draw.blocks[list(members)])) for draw in pool.draws]
        best = min(best, float(np.mean(values)))
    assert len(kept) == pool.objective.size
    assert made.robust.reached.bound <= best * (1 + 1e-9)
    assert best * (1 - 1e-9) <= made.robust.reached.value <= 1.01 * best


def test_draws_and_losses_go_together(tmp_path):
    made = plan(windup(tmp_path, draws=4, robust_to_losses=1))
    pool = made.pool
    own = [draw.observer.blocks(made.q, made.visit_loads)[:, :, pool.known.kept] for draw in pool.draws]
    each = [
        np.mean([
            draw.objective.value(information_of(np.delete(blocks, lost, axis=0)))
            for draw, blocks in zip(pool.draws, own, strict=True)
        ])
        for lost in range(6)
    ]
    assert made.robust.reached.value == pytest.approx(max(each), rel=1e-9)
    assert made.robust.lost == (int(np.argmax(each)),)
    assert made.robust.reached.bound <= made.robust.reached.value


def test_draws_of_values_that_do_not_enter_change_nothing_and_say_so(tmp_path, caplog):
    model = {"nominal": {"joint_compliance.j2": 0.3}, "nominal_std_percent": {"joint_compliance": 30.0}}
    settings = {"candidates": 80, "poses": 5, "refine": False}
    with caplog.at_level(logging.WARNING, "elastocal"):
        made = plan(study(tmp_path, KR270, model=model, plan={**settings, "draws": 4}))
    usual = plan(study(tmp_path, KR270, plan=settings))
    assert "draws change nothing" in caplog.text
    np.testing.assert_array_equal(made.q, usual.q)
    assert made.robust is None


# --- files


def test_plan_json_tells_the_worst_loss(tmp_path, capsys):
    file = study_file(tmp_path, KR270, plan={"candidates": 100, "poses": 5, "robust_to_losses": 2})
    assert run(["plan", str(file), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert (told["robust"]["losses"], told["robust"]["draws"]) == (2, 0)
    assert len(set(told["robust"]["worst_loss"])) == 2
    assert told["robust"]["rms_mm"] > told["criterion"]["rms_mm"]
    assert told["robust"]["rms_mm"] < told["robust"]["rms_total_mm"] < told["robust"]["radius_mm"]
    assert told["robust"]["bound"] <= told["robust"]["value"]
    assert "the worst loss" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"robust_to_losses": 3}, "robust_to_losses = 3"),
        ({"robust_to_losses": -1}, "robust_to_losses = -1"),
        ({"robust_to_losses": 2, "poses": 2}, "must be below poses = 2"),
        ({"robust_to_losses": 1, "criterion": "E"}, "is not for criterion E"),
        ({"draws": 8, "criterion": "E"}, "is not for criterion E"),
        ({"draws": 1.5}, "draws = 1.5"),
    ],
)
def test_wrong_settings_are_refused(tmp_path, settings, said):
    with pytest.raises(InputError, match=said):
        load_study(study_file(tmp_path, KR270, plan=settings))


@pytest.mark.parametrize("key", ["robust_to_losses", "draws"])
def test_two_arms_refuse_what_is_for_one(tmp_path, capsys, key):
    file = write_both(tmp_path, plan={key: 1})
    assert run(["plan", str(file), "--out", str(tmp_path / "out")]) == 2
    assert f"[plan] {key} = 1: is not for two arms" in capsys.readouterr().err
