"""The bound of a mean of criteria: against the exact optimum of one large problem, and against many designs."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from doe import approximate_design
from doe.averaged import averaged_bound
from doe.problem import make_problem

N, K, P, DRAWS = 60, 2, 4, 3


def drawn(seed):
    """(DRAWS, N, K, P) blocks that differ from draw to draw, and (DRAWS, 3, P) targets."""
    rng = np.random.default_rng(seed)
    blocks = rng.normal(size=(N, K, P)) + 0.5 * rng.normal(size=(DRAWS, N, K, P))
    return blocks, rng.normal(size=(DRAWS, 3, P))


def bound(blocks, targets, criterion, prior=None, cap=None):
    problems = [
        make_problem(own, target, criterion, None, prior, cap) for own, target in zip(blocks, targets, strict=True)
    ]
    start = [approximate_design(own, target, criterion=criterion, prior=prior, max_weight=cap).weights
             for own, target in zip(blocks, targets, strict=True)]  # fmt: skip
    return averaged_bound(problems, np.mean(start, axis=0)), problems


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("prior", [None, 0.3])
@pytest.mark.parametrize("cap", [None, 0.05])
def test_the_bound_is_just_below_the_exact_optimum(seed, prior, cap):
    """The mean of test_pose over draws is test_pose of one problem in which every draw has columns of its own."""
    blocks, targets = drawn(seed)
    known = None if prior is None else prior * np.eye(P)
    found, _ = bound(blocks, targets, "test_pose", known, cap)
    whole = np.zeros((N, DRAWS * K, DRAWS * P))
    for draw, own in enumerate(blocks):
        whole[:, draw * K : (draw + 1) * K, draw * P : (draw + 1) * P] = own
    exact = approximate_design(
        whole,
        block_diag(*targets) / np.sqrt(DRAWS),
        prior=None if prior is None else prior * np.eye(DRAWS * P),
        max_weight=cap,
    )
    assert found <= exact.value * (1 + 1e-9)
    assert found > (0.99 if cap is None else 0.8) * exact.value


@pytest.mark.parametrize("criterion", ["test_pose", "A", "D", "G"])
def test_no_design_is_below_the_bound(criterion):
    blocks, targets = drawn(2)
    if criterion == "G":
        targets = np.stack([targets, targets[::-1]], axis=1)
    found, problems = bound(blocks, targets, criterion)
    rng, everyone = np.random.default_rng(0), np.arange(N)
    single = [approximate_design(own, target, criterion=criterion) for own, target in zip(blocks, targets, strict=True)]
    designs = [rng.dirichlet(np.full(N, 0.1)) for _ in range(300)]
    designs += [np.mean([each.weights for each in single], axis=0)]
    values = [np.mean([p.criterion.value(p.information(everyone, weights)) for p in problems]) for weights in designs]
    assert min(values) >= found * (1 - 1e-12)
    assert found > 0.9 * min(values)
    assert found >= 0.99 * np.mean([each.bound for each in single]), "hardly below the mean of the draws' own bounds"
