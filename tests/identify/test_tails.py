"""The tails equal those of scipy.stats."""

import numpy as np
import pytest
from scipy import stats

from identify import tails


@pytest.mark.parametrize("value", [0.0, 0.3, 7.0, 60.0, 900.0])
@pytest.mark.parametrize("dof", [1, 4, 1060])
def test_tails_equal_those_of_scipy_stats(value, dof):
    assert tails.chi2_sf(value, dof) == pytest.approx(stats.chi2.sf(value, dof), rel=1e-12)
    assert tails.f_sf(value, dof, 30) == pytest.approx(stats.f.sf(value, dof, 30), rel=1e-9)
    assert tails.gamma_sf(value, dof / 3, 2.5) == pytest.approx(stats.gamma.sf(value, dof / 3, scale=2.5), rel=1e-12)
    assert tails.student_sf(value, dof) == pytest.approx(stats.t.sf(value, dof), rel=1e-9)


@pytest.mark.parametrize("share", [0.025, 0.5, 0.975, 0.9999])
def test_quantiles_equal_those_of_scipy_stats(share):
    assert tails.norm_ppf(share) == pytest.approx(stats.norm.ppf(share), abs=1e-14)
    assert tails.student_ppf(share, 7) == pytest.approx(stats.t.ppf(share, 7), rel=1e-10, abs=1e-14)


def test_the_rank_correlation_equals_that_of_scipy_stats_with_ties_too():
    rng = np.random.default_rng(5)
    one, other = rng.integers(0, 6, 40).astype(float), rng.standard_normal(40)
    for second in (other, one + other, one, -one):
        expected = stats.spearmanr(one, second)
        found = tails.spearman(one, second)
        assert found[0] == pytest.approx(expected.statistic, abs=1e-12)
        assert found[1] == pytest.approx(expected.pvalue, rel=1e-6, abs=1e-200)
