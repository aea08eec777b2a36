"""Scores of blocks beside a fit, held against plain least squares with the blocks really added."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from identify.diagnosis.evidence import evidence
from identify.diagnosis.library import tried
from identify.effects import REGISTRY
from identify.experiment import full_experiment
from identify.selection import take_rows
from tests.identify.diagnosis.cases import (
    arm,
    block,
    conditions,
    fit_of,
    library,
    read,
    rest_of,
    whitened_columns,
)  # fmt: skip

ASKED = {"geometry@j3", "joint_hardening@j2", "link_mass@link3", "load_com", "base_compliance@base", "stiction@j2"}


@pytest.fixture(scope="module")
def case():
    """A fit, some hypotheses and the evidence for them; readings with an effect that the model lacks."""
    study = arm()
    data = read(study, conditions(study, 10, 1), 2, {"geometry.j3.offset": 0.1})
    ragged = take_rows(data, np.setdiff1d(np.arange(len(data.positions)), [4, 21, 22]))  # visits of unequal size
    found = fit_of(study, ragged)
    asked = tuple(h for h in library(study, found) if h.entry in ASKED)
    blocks = tried(found, asked)
    return found, blocks, evidence(found, blocks)


def whitened(found, blocks):
    return [found.whitening.apply(part.columns) for part in blocks]


def drop(found, *columns):
    """How much less chi-square is left once columns were added and everything was fitted again."""
    model = whitened_columns(found)
    before, after = rest_of(found.whitened, model), rest_of(found.whitened, np.hstack([model, *columns]))
    return float(before @ before - after @ after)


def test_a_score_is_what_adding_the_block_takes_off_chi2(case):
    found, blocks, seen = case
    columns = whitened(found, blocks)
    visible = [b for b in range(len(blocks)) if len(seen.columns_of([b])) == columns[b].shape[1]]
    assert len(visible) >= len(ASKED)
    for b in visible:
        assert seen.score(b).value == pytest.approx(drop(found, columns[b]), rel=1e-6, abs=1e-6)
        rank = np.linalg.matrix_rank(rest_of(columns[b], whitened_columns(found)) / np.linalg.norm(columns[b], axis=0))
        assert seen.score(b).dof == rank


def test_a_score_of_a_union_is_what_all_its_blocks_take_off_together(case):
    found, blocks, seen = case
    columns = whitened(found, blocks)
    visible = [b for b in range(len(blocks)) if len(seen.columns_of([b])) == columns[b].shape[1]]
    for one, other in list(combinations(visible, 2))[::5]:
        together, alone = drop(found, columns[one], columns[other]), drop(found, columns[other])
        assert seen.score(one, other).value == pytest.approx(together, rel=1e-5, abs=1e-5)
        assert seen.beyond(one, other).value == pytest.approx(together - alone, rel=1e-4, abs=1e-4)


def test_a_block_adds_nothing_beyond_itself(case):
    _, blocks, seen = case
    for b in range(len(blocks)):
        assert seen.beyond(b, b).dof == 0
        assert seen.beyond(b, b).p_value == 1.0


def test_sizes_and_their_deviations_are_those_of_least_squares(case):
    found, blocks, seen = case
    model, checked = whitened_columns(found), 0
    for b, own in enumerate(whitened(found, blocks)):
        if seen.score(b).dof < own.shape[1]:
            continue
        every = np.hstack([model, own])
        length = np.linalg.norm(every, axis=0)
        upper = np.linalg.qr(every / length)[1]
        size = np.linalg.lstsq(every / length, found.whitened, rcond=None)[0] / length
        inverse = np.linalg.inv(upper)
        spread = np.sqrt((inverse**2).sum(axis=1)) / length
        np.testing.assert_allclose(seen.sizes(b)[0], size[model.shape[1] :], rtol=1e-5)
        np.testing.assert_allclose(seen.sizes(b)[1], spread[model.shape[1] :], rtol=1e-5)
        checked += 1
    assert checked >= len(ASKED)


def test_directions_are_orthonormal_and_orthogonal_to_the_model(case):
    found, blocks, seen = case
    for b in range(len(blocks)):
        basis = seen.directions(b)
        assert basis.shape[1] == seen.score(b).dof
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-8)
        unit = whitened_columns(found) / np.linalg.norm(whitened_columns(found), axis=0)
        assert np.abs(basis.T @ unit).max() < 1e-7


@pytest.mark.parametrize("added", [(), ("geometry@j3",), ("geometry@j3", "load_com")])
def test_the_left_out_error_is_that_of_really_leaving_out_each_visit(case, added):
    found, blocks, seen = case
    index = [next(b for b, part in enumerate(blocks) if part.hypothesis.entry == entry) for entry in added]
    columns = np.hstack([whitened_columns(found), *(found.whitening.apply(blocks[b].columns) for b in index)])
    visit, total = found.whitening.visits(found.data.experiment), 0.0
    columns = columns / np.linalg.norm(columns, axis=0)
    for name in np.unique(visit):
        rest, own = visit != name, visit == name
        size = np.linalg.lstsq(columns[rest], found.whitened[rest], rcond=1e-11)[0]
        total += float(((found.whitened[own] - columns[own] @ size) ** 2).sum())
    assert seen.left_out(*index) == pytest.approx(total, rel=1e-4)


def test_a_visit_judged_by_the_others_has_their_covariance_in_its_chi2(case):
    found, _, seen = case
    columns, visit = whitened_columns(found), found.whitening.visits(found.data.experiment)
    columns = columns / np.linalg.norm(columns, axis=0)
    for name in (0, 3, 9):
        rest, own = visit != name, visit == name
        size = np.linalg.lstsq(columns[rest], found.whitened[rest], rcond=1e-11)[0]
        error = found.whitened[own] - columns[own] @ size
        spread = np.eye(own.sum()) + columns[own] @ np.linalg.pinv(columns[rest].T @ columns[rest]) @ columns[own].T
        expected = error @ np.linalg.solve(spread, error) / own.sum()
        assert seen.outside()[name] == pytest.approx(expected, rel=1e-4)


def test_what_the_model_holds_already_counts_nothing(case):
    found, _, _ = case
    rng = np.random.default_rng(3)
    own = found.response.direct[:, :, found.identifiability.kept]
    mixed = own @ rng.normal(size=(own.shape[2], 3))
    seen = evidence(found, [block(own[:, :, -3:]), block(mixed)])
    for b in (0, 1):
        assert (seen.score(b).value, seen.score(b).dof, seen.score(b).p_value) == (0.0, 0, 1.0)
        assert np.isinf(seen.sizes(b)[1]).all()


def test_what_cannot_be_seen_at_its_largest_plausible_size_counts_nothing(case):
    found, _, _ = case
    columns = np.random.default_rng(4).normal(size=(*found.residual.shape, 1))
    length = np.linalg.norm(rest_of(found.whitening.apply(columns), whitened_columns(found)))
    seen = evidence(found, [block(columns, 0.2 / length), block(columns, 0.4 / length)])
    assert [seen.score(b).dof for b in (0, 1)] == [0, 1]


def test_the_same_column_twice_is_one_direction(case):
    found, _, _ = case
    columns = np.random.default_rng(5).normal(size=(*found.residual.shape, 2))
    seen = evidence(found, [block(columns), block(columns @ [[1.0, 2.0, 0.0], [0.5, 1.0, 3.0]])])
    assert seen.score(1).dof == 2
    assert seen.score(1).value == pytest.approx(seen.score(0).value)


def test_units_of_columns_do_not_matter(case):
    found, blocks, seen = case
    factor = np.array([1e-3, 1e2, 7.0, 1e3, 1e-2, 5.0, 0.1, 1.0])
    scaled = [
        replace(part, columns=part.columns * factor[: part.columns.shape[2]],
                plausible=part.plausible / factor[: part.columns.shape[2]])
        for part in blocks
    ]  # fmt: skip
    again = evidence(found, scaled)
    for b in range(len(blocks)):
        assert again.score(b).dof == seen.score(b).dof
        assert again.score(b).value == pytest.approx(seen.score(b).value, rel=1e-6, abs=1e-9)


def test_the_order_of_visits_does_not_matter():
    study = arm()
    experiment = conditions(study, 9, 6)
    data = read(study, experiment, 7, {"geometry.j3.offset": 0.1})
    order = np.random.default_rng(8).permutation(9)
    loads = np.tile(np.arange(len(study.loads)), (9, 1))
    turned = replace(
        data,
        experiment=full_experiment(experiment.q[order], loads, study.loads, study.markers),
        positions=data.positions.reshape(9, -1, 3)[order].reshape(-1, 3),
    )
    scores = []
    for each in (data, turned):
        found = fit_of(study, each)
        seen = evidence(found, tried(found, library(study, found)))
        scores.append([[seen.score(b).value, seen.left_out(b)] for b in range(len(seen.where))])
    np.testing.assert_allclose(scores[0], scores[1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("differences", [False, True])
def test_without_anything_missing_scores_are_chi2_with_their_degrees_of_freedom(differences):
    """Over draws of simulated readings with pose and reading jitter, each fitted by the project's own fit."""
    study = arm(reference="differences" if differences else "absolute")
    experiment = conditions(study, 10, 9)
    picked = ("load_com", "joint_hardening@j2", "link_compliance@link2")
    picked += () if differences else ("geometry@j3", "gravity_compensator@j2")
    drawn = []
    for seed in range(80):
        found = fit_of(study, read(study, experiment, seed))
        every = library(study, found, without=frozenset(REGISTRY) - {entry.split("@")[0] for entry in picked})
        asked = tuple(next(h for h in every if h.entry == entry) for entry in picked)
        blocks = [block(part.columns) for part in tried(found, asked)]
        seen = evidence(found, blocks)
        drawn.append([(score.value, score.dof) for score in map(seen.score, range(len(blocks)))])
    for values in np.array(drawn).swapaxes(0, 1):
        assert np.ptp(values[:, 1]) == 0
        assert kstest(values[:, 0], chi2(values[0, 1]).cdf).pvalue > 0.01
