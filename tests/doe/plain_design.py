"""Design criteria written out plainly from their definitions, slow and independent of the package."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, combinations_with_replacement

import numpy as np

from identify.arrays import Floats

__all__ = ["bound_of", "brute_force", "information", "plans", "value_of"]


def information(blocks: Floats, weights: Floats, prior: Floats | None = None) -> Floats:
    """``sum_i w_i A_i'A_i + prior``."""
    blocks = np.asarray(blocks, float)
    total = np.einsum("n,nki,nkj->ij", weights, blocks, blocks, optimize=True)
    return total if prior is None else total + prior


def inverse(matrix: Floats) -> tuple[Floats, Floats]:
    """Pseudo-inverse with unit columns, and the projection on the row space."""
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    kept = vectors[:, values > 1e-11 * values[-1]]
    inner = kept @ np.diag(1.0 / values[values > 1e-11 * values[-1]]) @ kept.T
    return inner / np.outer(scale, scale), np.diag(1.0 / scale) @ kept @ kept.T @ np.diag(scale)


def value_of(criterion: str, matrix: Floats, target: Floats | None) -> float:
    """The criterion at M; infinite where M does not show what it needs."""
    p = len(matrix)
    if not matrix.any():
        return np.inf
    inner, seen = inverse(matrix)
    if criterion in ("test_pose", "G"):
        targets = [target] if criterion == "test_pose" else target
        if any(np.linalg.norm(rows - rows @ seen) > 1e-6 * np.linalg.norm(rows) for rows in targets):
            return np.inf
        return max(float(np.trace(rows @ inner @ rows.T)) for rows in targets)
    if np.trace(seen) < p - 0.5:
        return np.inf
    if criterion == "A":
        return float(np.trace(inner))
    if criterion == "D":
        return float(np.exp(np.linalg.slogdet(inner)[1] / p))
    return float(np.linalg.norm(inner, 2))


def bound_of(
    criterion: str,
    blocks: Floats,
    target: Floats | None,
    weights: Floats,
    dual: Floats | None = None,
    max_weight: float | None = None,
    costs: Floats | None = None,
    prior: Floats | None = None,
) -> float:
    """The proven bound, written out from the definition in the contract."""
    blocks = np.asarray(blocks, float)
    p = blocks.shape[2]
    inner, _ = inverse(information(blocks, weights, prior))
    value = value_of(criterion, information(blocks, weights, prior), target)
    base = np.zeros((p, p)) if prior is None else prior
    if criterion in ("test_pose", "A"):
        solved = inner @ (np.eye(p) if criterion == "A" else target.T)
        middle, numerator = solved @ solved.T, value**2
    elif criterion == "D":
        middle, numerator = inner, value * p
    elif criterion == "E":
        middle, numerator = dual, 1.0
    else:
        solved = [inner @ rows.T for rows in target]
        middle = sum(v * y @ y.T for v, y in zip(dual, solved, strict=True))
        numerator = sum(v * np.trace(rows @ y) for v, rows, y in zip(dual, target, solved, strict=True)) ** 2
    d = np.einsum("nki,ij,nkj->n", blocks, middle, blocks, optimize=True)
    return float(numerator / (knapsack(d, costs, max_weight) + np.sum(base * middle)))


def knapsack(d: Floats, costs: Floats | None, cap: float | None) -> float:
    """``max sum w d`` over ``sum c w = 1, 0 <= w <= cap``."""
    costs = np.ones(len(d)) if costs is None else costs
    left, total = 1.0, 0.0
    for i in np.argsort(-d / costs):
        weight = min(np.inf if cap is None else cap, left / costs[i])
        total, left = total + weight * d[i], left - weight * costs[i]
    return total


def plans(
    count: int, n: int | None, repeats: bool, costs: Floats | None = None, budget: float | None = None
) -> Iterator[list[int]]:
    """All plans that keep the limits."""
    choose = combinations_with_replacement if repeats else combinations
    longest = n if n is not None else int(budget / costs.min())
    for length in [n] if n is not None else range(1, longest + 1):
        for plan in choose(range(count), length):
            if budget is None or costs[list(plan)].sum() <= budget:
                yield list(plan)


def brute_force(criterion: str, blocks: Floats, target: Floats | None, prior: Floats | None, every: Iterator) -> float:
    """The least value over all plans."""
    count = len(blocks)
    return min(
        (value_of(criterion, information(blocks, np.bincount(plan, minlength=count), prior), target) for plan in every),
        default=np.inf,
    )
