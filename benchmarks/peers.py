"""The design engine beside tools that others made, each on the same blocks in the same run.

pydex and pyDOE3 are used where they are installed (`pip install pydex pyDOE3`); FIGAROH 1.0.2 brings a gigabyte of
packages, so what it does is written here in cvxpy: the weights that maximise the determinant, then the candidates with
the largest weights. Values are the mean variance at the test poses of all plans by the same formula; times are CPU
seconds.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.clock import line, timed
from benchmarks.design import reference_case
from doe import approximate_design, exact_design

SEED = 1


def value(blocks: np.ndarray, rows: np.ndarray, chosen: np.ndarray) -> float:
    """Variance at the test poses of a plan of ``chosen`` candidates."""
    picked = blocks[chosen].reshape(-1, blocks.shape[2])
    scale = np.linalg.norm(picked, axis=0)
    root = np.linalg.pinv(picked / scale, rcond=1e-10)
    return float(np.sum(((rows / scale) @ root) ** 2))


def members(counts: np.ndarray) -> np.ndarray:
    return np.repeat(np.arange(len(counts)), counts)


def grams_of(blocks: np.ndarray) -> np.ndarray:
    return np.einsum("nki,nkj->nij", blocks, blocks)


def figaroh(n: int) -> None:
    """FIGAROH's selection: D-optimal weights, then the largest; on whitened blocks, which it does not have."""
    import cvxpy as cp

    blocks, rows = reference_case(500, 6, seed=SEED)
    scale = np.linalg.norm(blocks, axis=(0, 1)) / np.sqrt(len(blocks))
    grams, size = grams_of(blocks / scale), blocks.shape[2]

    def select() -> np.ndarray:
        w = cp.Variable(len(blocks), nonneg=True)
        flat = grams.reshape(len(blocks), -1)
        matrix = cp.reshape(flat.T @ w, (size, size), order="C")
        cp.Problem(cp.Maximize(cp.log_det(0.5 * (matrix + matrix.T))), [cp.sum(w) <= 1]).solve(solver=cp.CLARABEL)
        return np.argsort(-w.value)[:n]

    theirs, _, cpu = timed(select, repeats=1)
    ours, _, own = timed(lambda: exact_design(blocks, rows, n, effort="low"), repeats=1)
    kept = value(blocks, rows, theirs) / value(blocks, rows, members(ours.counts))
    line(f"FIGAROH's selection in cvxpy, N = 500, n = {n}", f"{cpu:.1f} s, variance x {kept:.2f}", "worse than ours")
    line("exact_design, effort low, on the same blocks", f"{own:.2f} s, {100 * ours.efficiency:.1f} % proven", "1 s")


def random_plans(n: int) -> None:
    """The median of 200 random plans of the same size."""
    blocks, rows = reference_case(10_000, 26, seed=SEED)
    ours, _, own = timed(lambda: exact_design(blocks, rows, n), repeats=1)
    rng = np.random.default_rng(SEED)
    best = value(blocks, rows, members(ours.counts))
    times = [value(blocks, rows, rng.choice(len(blocks), n, replace=False)) / best for _ in range(200)]
    text = f"{np.median(times):.1f} times the variance"
    line(f"200 random plans, p = 26, n = {n}, against {own:.1f} s", text, "at least 4")


def pydex(count: int) -> None:
    """A-optimal weights by pydex with its cvxpy engine, on parameters whitened for it."""
    if find_spec("pydex") is None:
        line("pydex", "not installed", "any")
        return
    from pydex.core.designer import Designer

    blocks, _ = reference_case(count, 6, seed=SEED)
    information = np.einsum("nki,nkj->ij", blocks, blocks) / count
    blocks = blocks @ np.linalg.inv(np.linalg.cholesky(information)).T
    designer: Any = Designer()

    def simulate(ti_controls: Any, model_parameters: Any) -> Any:
        return blocks[int(ti_controls[0])] @ model_parameters

    designer.simulate = simulate
    designer.model_parameters = np.ones(6)
    designer.ti_controls_candidates = np.arange(count, dtype=float)[:, None]
    designer.error_cov = np.eye(blocks.shape[1])

    def design() -> np.ndarray:
        with contextlib.redirect_stdout(io.StringIO()):
            designer.initialize(verbose=0)
            designer.design_experiment(designer.a_opt_criterion, package="cvxpy", optimizer="CLARABEL")
        return np.asarray(designer.efforts).ravel()

    weights, _, cpu = timed(design, repeats=1)
    ours, _, own = timed(lambda: approximate_design(blocks, np.eye(6), criterion="A"), repeats=1)
    matrix = np.einsum("n,nki,nkj->ij", weights, blocks, blocks)
    off = float(np.trace(np.linalg.inv(matrix))) / ours.value - 1
    line(f"pydex, A-optimal weights, p = 6, N = {count}", f"{cpu:.1f} s, {off:+.1e} off", "slower")
    line("approximate_design on the same blocks", f"{own:.3f} s, {cpu / own:.0f} times less", "0.1 s")


def pydoe3(count: int, n: int) -> None:
    """Fedorov's exchange of pyDOE3: one row a candidate, a model linear in its columns, A-optimal."""
    if find_spec("pyDOE3") is None:
        line("pyDOE3", "not installed", "any")
        return
    from pyDOE3.doe_optimal.algorithms import fedorov
    from pyDOE3.doe_optimal.model import build_design_matrix

    points = reference_case(count, 6, seed=SEED)[0][:, 0, 1:4]
    points = points / np.abs(points).max(axis=0)

    def a_value(chosen: np.ndarray) -> float:
        matrix = build_design_matrix(chosen, 1)
        return float(np.trace(np.linalg.inv(matrix.T @ matrix)))

    with warnings.catch_warnings(action="ignore"):  # it inverts singular matrices on the way
        theirs, _, cpu = timed(lambda: fedorov(points, n, 1, "A"), repeats=1)
    rows = build_design_matrix(points, 1)[:, None]
    ours, _, own = timed(lambda: exact_design(rows, np.eye(rows.shape[2]), n, criterion="A", repeats=False), repeats=1)
    better = a_value(theirs) / ours.value - 1
    line(f"pyDOE3, Fedorov, 4 columns, N = {count}, n = {n}", f"{cpu:.2f} s, {100 * better:+.2f} % off", "not below")
    line("exact_design on the same rows", f"{own:.2f} s, {100 * ours.efficiency:.1f} % proven", "1 s")


def main() -> None:
    approximate_design(*reference_case(50, 6))  # imports
    figaroh(12)
    figaroh(20)
    random_plans(20)
    pydex(300)
    pydoe3(100, 12)


if __name__ == "__main__":
    main()
