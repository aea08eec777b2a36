"""Off the grid: ascent, column generation over all poses, and plans that are exchanged and polished there."""

from pathlib import Path

import numpy as np
import pytest
from reference_cases import continuous_case

from doe import approximate_design, exact_design
from doe.ascent import Region, ascend, pulled_back
from doe.blocks import Blocks
from doe.commands import run_plan
from doe.continuous import Sample, continuous_columns
from doe.plan import plan
from doe.polish import polish
from doe.pool import build_pool
from doe.reach import reach_of
from tests.doe.study_files import ARM, KR270, study, study_file

ROOT = Path(__file__).parents[2]


def single(lower=-np.pi, upper=np.pi, floor=-np.inf):
    """One joint of unit arm under a unit load: A = cos q (-sin q, cos q), best at q = 0; ``floor`` bounds sin q."""

    def blocks(x, choice):
        q = x[:, 0]
        return (np.cos(q) * np.stack([-np.sin(q), np.cos(q)]))[..., None].transpose(1, 0, 2)

    def excess(x, choice):
        return np.maximum(floor - np.sin(x[:, 0]), 0.0)

    return Region(blocks, excess, np.array([lower]), np.array([upper]), np.ones(1))


def sample(region, x, choice=None):
    choice = np.zeros(len(x), dtype=np.int64) if choice is None else choice
    return Sample(x, choice, region.blocks(x, choice))


# --- ascent


def test_ascent_finds_the_level_arm_from_both_sides():
    starts = np.array([[0.9], [-1.2], [2.6], [-2.0]])
    x, d = ascend(single(), np.eye(1), starts, np.zeros(4, dtype=np.int64))
    np.testing.assert_allclose(np.sin(x), 0.0, atol=1e-4)
    np.testing.assert_allclose(d, 1.0, rtol=1e-8)


def test_ascent_ends_at_a_bound_that_binds():
    x, d = ascend(single(lower=0.5), np.eye(1), np.array([[1.1], [0.6]]), np.zeros(2, dtype=np.int64))
    np.testing.assert_allclose(x, 0.5, atol=1e-9)
    np.testing.assert_allclose(d, np.cos(0.5) ** 2, rtol=1e-9)


def test_ascent_stops_at_a_floor_and_stays_above_it():
    region = single(floor=0.3)
    x, d = ascend(region, np.eye(1), np.array([[1.3], [2.0]]), np.zeros(2, dtype=np.int64))
    assert (region.excess(x, None) == 0.0).all()
    np.testing.assert_allclose(np.sin(x), 0.3, atol=1e-4)
    np.testing.assert_allclose(d, 1 - 0.3**2, rtol=1e-4)


def test_ascent_never_loses_and_never_leaves_what_may_be_measured():
    region, drawn, _ = continuous_case(26)
    starts = drawn(60)
    factor = np.random.default_rng(1).normal(size=(26, 8))
    before = np.sum((starts.blocks @ factor) ** 2, axis=(1, 2))
    x, d = ascend(region, factor, starts.x, starts.choice)
    assert (d >= before * (1 - 1e-12)).all()
    assert np.median(d / before) > 2
    np.testing.assert_allclose(np.sum((region.blocks(x, starts.choice) @ factor) ** 2, axis=(1, 2)), d, rtol=1e-9)
    assert (region.excess(x, starts.choice) == 0.0).all()
    assert ((x >= region.lower) & (x <= region.upper)).all()
    nearby = np.clip(x + 1e-3 * np.random.default_rng(2).normal(size=(40, *x.shape)), region.lower, region.upper)
    choice = np.tile(starts.choice, 40)
    flat = nearby.reshape(-1, 6)
    around = np.sum((region.blocks(flat, choice) @ factor) ** 2, axis=(1, 2))
    around[region.excess(flat, choice) > 0.0] = 0.0
    best = around.reshape(40, -1).max(axis=0)
    assert np.quantile(best / d, 0.9) < 1 + 1e-3, "nine of ten are at a local maximum"


def test_points_are_pulled_back_to_the_edge():
    region = single(floor=0.3)
    x = pulled_back(region, np.array([[0.0], [1.0]]), np.array([[1.5], [1.5]]), np.zeros(2))
    assert np.sin(x[0, 0]) == pytest.approx(0.3, abs=1e-4)
    assert region.excess(x, None).max() == 0.0
    assert x[1, 0] == 1.0, "what may be measured stays"


def test_a_variable_of_scale_zero_stays():
    region, drawn, _ = continuous_case(6)
    held = Region(region.blocks, region.excess, region.lower, region.upper, np.array([1, 0, 1, 1, 1, 1, 0]))
    starts = drawn(20)
    x, _ = ascend(held, np.eye(6), starts.x, starts.choice)
    np.testing.assert_array_equal(x[:, [1, 6]], starts.x[:, [1, 6]])
    assert (np.abs(x - starts.x).max(axis=0)[[0, 2, 3, 4, 5]] > 1e-3).all()


# --- the estimate


@pytest.mark.parametrize("prior", [None, 0.3])
def test_the_estimate_of_one_joint_is_the_closed_form(prior):
    region = single()
    grid = sample(region, np.array([[0.4], [-0.7], [1.0]]))
    known = None if prior is None else np.array([[prior]])
    found = continuous_columns(region, grid, np.array([[0.5]]), "test_pose", np.random.default_rng(0), prior=known)
    assert found.bound == pytest.approx(0.25 / (1.0 + (prior or 0.0)), rel=1e-4)
    assert found.value == pytest.approx(found.bound, rel=1e-4)


def test_the_estimate_beside_a_prior_is_that_of_a_dense_grid():
    region, drawn, target = continuous_case(6)
    known = 2.0 * np.einsum("nkp,nkq->pq", drawn(3).blocks, drawn(3).blocks)
    found = continuous_columns(region, drawn(500), target, "test_pose", np.random.default_rng(0), prior=known, tol=1e-3)
    dense = approximate_design(drawn(20_000).blocks, target, prior=known)
    assert found.bound <= dense.bound
    assert found.bound > 0.9 * dense.bound
    assert found.gap < 0.01


PUBLISHED = {"down": ([0, 0, -1, 0, 0, 0], 1.0586), "forward": ([1, 0, 0, 0, 0, 0], 0.7991)}


@pytest.mark.parametrize("load", ["down", "forward"])
def test_the_estimate_of_the_three_joint_arm_is_that_of_a_fine_grid(tmp_path, load):
    """Facts of the arm: rho_0 sqrt(m) of the relaxed design on a grid of one degree, for any m."""
    wrench, figure = PUBLISHED[load]
    made = study(tmp_path, ARM, test_poses=[{"joints_deg": [0, 45, -90], "wrench": wrench}], plan={"candidates": 300})
    found = reach_of(build_pool(made, seed=0), 0).columns
    assert found.bound**0.5 / 1e3 == pytest.approx(figure, rel=1e-3)
    assert found.bound <= (figure * 1e3) ** 2 * (1 + 5e-4), "a fine grid shows nothing below it"


def test_the_estimate_is_never_above_any_grid_and_seeds_agree():
    region, drawn, target = continuous_case(6)
    found = [
        continuous_columns(region, drawn(2000), target, "test_pose", np.random.default_rng(seed)) for seed in range(2)
    ]
    assert found[0].bound == pytest.approx(found[1].bound, rel=2e-3)
    dense = approximate_design(drawn(30_000).blocks, target)
    for columns in found:
        assert columns.bound <= dense.bound
        assert columns.bound <= columns.value <= dense.value
        assert columns.gap < 1e-2
        assert (region.excess(columns.found.x, columns.found.choice) == 0.0).all()
        again = approximate_design(columns.found.blocks, target)
        assert again.value <= columns.value * (1 + 1e-3)
        own = region.blocks(columns.found.x, columns.found.choice)
        np.testing.assert_array_equal(own, columns.found.blocks)


@pytest.mark.parametrize("criterion", ["A", "D", "E", "G"])
def test_every_criterion_has_an_estimate_below_its_grid(criterion):
    region, drawn, target = continuous_case(6)
    grid = drawn(500)
    rows = target.reshape(20, 3, 6) if criterion == "G" else target
    relaxed = approximate_design(grid.blocks, rows, criterion=criterion)
    found = continuous_columns(region, grid, rows, criterion, np.random.default_rng(0), tol=1e-3)
    assert found.value < 0.99 * relaxed.bound, "there is more off the grid"
    assert found.bound <= found.value
    assert found.gap < 0.02


# --- plans


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "E", "G"])
def test_polishing_gains_and_keeps_the_constraints(criterion):
    region, drawn, target = continuous_case(6)
    grid = drawn(500)
    rows = target.reshape(20, 3, 6) if criterion == "G" else target
    start = exact_design(grid.blocks, rows, 8, criterion=criterion)
    chosen = np.repeat(np.arange(500), start.counts)
    x, steps = polish(region, grid.x[chosen], grid.choice[chosen], rows, criterion)
    after = exact_design(region.blocks(x, grid.choice[chosen]), rows, 8, criterion=criterion, repeats=False)
    assert steps > 0
    assert after.value < 0.98 * start.value
    assert (region.excess(x, grid.choice[chosen]) == 0.0).all()
    assert ((x >= region.lower) & (x <= region.upper)).all()


def test_a_plan_that_shows_too_little_is_left_alone():
    region, drawn, target = continuous_case(26)
    few = drawn(2)
    x, steps = polish(region, few.x, few.choice, target, "test_pose")
    np.testing.assert_array_equal(x, few.x)
    assert steps == 0


def test_off_the_grid_plans_come_within_a_percent_of_the_estimate_and_beat_random_ones():
    region, drawn, target = continuous_case(6)
    grid = drawn(2000)
    columns = continuous_columns(region, grid, target, "test_pose", np.random.default_rng(0), tol=1e-3)
    pool = columns.found.plus(grid)
    design = exact_design(pool.blocks, target, 20)
    chosen = np.repeat(np.arange(len(pool.x)), design.counts)
    x, _ = polish(region, pool.x[chosen], pool.choice[chosen], target, "test_pose")
    own = region.blocks(x, pool.choice[chosen])

    def value(blocks):
        return np.trace(target @ np.linalg.solve(np.einsum("nki,nkj->ij", blocks, blocks), target.T))

    on_grid = exact_design(grid.blocks, target, 20)
    assert columns.bound / 20 <= value(own) <= 1.005 * columns.bound / 20
    assert value(own) < 0.93 * on_grid.value
    picks = np.random.default_rng(0).integers(0, 2000, (100, 20))
    assert value(own) < 0.25 * np.median([value(grid.blocks[pick]) for pick in picks])


def test_a_plan_tells_both_efficiencies_and_how_good_it_is_by_every_criterion(tmp_path):
    made = plan(study(tmp_path, KR270))
    assert made.final.source == "branch_and_bound"
    assert made.final.efficiency > 1 - 1e-4, "proven optimal on candidates and its own poses"
    assert 0.95 < made.final.continuous <= made.final.efficiency
    assert made.grid.estimate == made.final.estimate
    assert made.grid.continuous < made.final.continuous
    found = made.compared.by_criterion
    assert set(found) == {"test_pose", "A", "D", "E", "G"}
    assert all(0.0 < share <= 1.0 for share in found.values())
    assert found["test_pose"] == pytest.approx(made.final.efficiency, abs=0.02), "relaxed here, branched there"
    other = plan(study(tmp_path, KR270, plan={"criterion": "D"})).compared.by_criterion
    assert other["D"] > found["D"]
    assert other["test_pose"] < found["test_pose"]


def test_without_refinement_there_is_no_estimate(tmp_path):
    made = plan(study(tmp_path, KR270, plan={"refine": False, "candidates": 100}))
    assert made.final.continuous is None
    assert made.refinement is None


def test_effects_without_symbolic_columns_leave_the_grid_too(tmp_path):
    model = {"effects": ["joint_compliance", "joint_hardening@j2"], "nominal": {"joint_compliance.j2": 0.3}}
    changes = {"poses": 8, "candidates": 200, "loads": ["L1", "L2"], "loads_per_pose": 2}
    made = plan(study(tmp_path, KR270, model=model, plan=changes))
    assert made.refinement.status == "L-BFGS-B on differences"
    assert made.final.value < 0.97 * made.grid.value
    assert made.final.continuous > 0.9


@pytest.mark.slow
def test_plan_json_and_its_words_tell_what_is_proven_and_what_is_estimated(tmp_path):
    outcome = run_plan(study_file(tmp_path, KR270), seed=0, out=tmp_path / "out")
    content, words = outcome.content, "\n".join(outcome.lines)
    formats = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    for key in ("bound_source", "efficiency_continuous", "efficiencies", "efficiencies_candidates"):
        assert key in content
        assert f"`{key}`" in formats
    assert set(content["efficiencies"]) == {"test_pose", "A", "D", "E", "G"}
    assert content["efficiencies_candidates"] == 400
    assert "proven optimal on these by branch and bound within" in words
    assert f"estimated over all joint angles, not proven: {100 * content['efficiency_continuous']:.2f} %" in words
    again = run_plan(study_file(tmp_path, KR270), seed=0, out=tmp_path / "out")
    assert again.tables == outcome.tables


def test_halves_of_many_candidates_are_priced_as_one(monkeypatch):
    blocks = np.random.default_rng(0).normal(size=(1001, 3, 5))
    factor = np.random.default_rng(1).normal(size=(5, 2))
    alone = Blocks(blocks).sensitivities(factor)
    monkeypatch.setattr("doe.blocks.MANY", 10)
    np.testing.assert_allclose(Blocks(blocks).sensitivities(factor), alone, rtol=1e-13)
