"""The criteria that are a worst case: G over test poses, E over directions; formulas in `doe.criteria`."""

from __future__ import annotations

import numpy as np

from doe.criterion import (
    Certificate,
    Criterion,
    Local,
    central_slack,
    eliminated,
    inverse_root,
    products,
    short,
    step_inside,
)
from identify.arrays import Floats

__all__ = ["MinimumEigenvalue", "Worst"]


class Worst(Criterion):
    """G: ``max_t trace(C_t M^-1 C_t')``."""

    smooth = False

    def __init__(self, target: Floats) -> None:
        """Keep the targets (t, r, p)."""
        self.target = np.stack([short(rows) for rows in target])

    def value(self, information: Floats) -> float:
        """See `Criterion.value`."""
        return float(self._values(self._solved(information)).max())

    def objective(self, information: Floats, mu: float) -> float:
        """See `Criterion.objective`."""
        values = self._values(self._solved(information))
        slack = central_slack(values.max() - values, mu)
        return float(values[0] + slack[0] - mu * np.sum(np.log(slack)))

    def certificate(self, information: Floats, dual: Floats | None) -> Certificate:
        """See `Criterion.certificate`."""
        if dual is None:
            raise ValueError("G needs a mixture")
        return self._certificate(self._solved(information), dual)

    def local(self, information: Floats, mu: float, dual: Floats | None) -> Local:
        """See `Criterion.local`."""
        root, solved = inverse_root(information), self._solved(information)
        values = self._values(solved)
        slack = central_slack(values.max() - values, mu)
        central = mu / slack
        mixture = central if dual is None else dual
        stiffness = mixture / slack
        mean = stiffness / stiffness.sum()  # how tau follows the values
        bent = self._certificate(solved, mixture).factor

        def curvature(blocks: Floats) -> Floats:
            slopes = self._grouped((blocks.reshape(-1, len(root)) @ solved) ** 2)
            slopes = slopes.reshape(len(blocks), -1, len(mixture)).sum(axis=1)
            spread = (slopes - (slopes @ mean)[:, None]) * np.sqrt(stiffness)
            return np.hstack([np.sqrt(2.0) * products(blocks, root, bent), spread])

        def predict(change: Floats) -> tuple[Floats | None, float]:
            slopes = -self._grouped(np.sum(solved * (change @ solved), axis=0)[None])[0]
            step = central - mixture - stiffness * (slopes @ mean - slopes)
            reach = step_inside(float(np.min(step / mixture)))
            moved = mixture + reach * step
            return moved / moved.sum(), reach

        return Local(self._certificate(solved, central), curvature, predict)

    def after_adding(self, information: Floats, rows: Floats) -> Floats:
        """See `Criterion.after_adding`: as for `Mean`, for each test pose."""
        solved = self._solved(information)
        pivots, turned = eliminated(rows, inverse_root(information), solved)
        gain = self._grouped(np.einsum("qkn,kn->nq", turned * turned, 1.0 / pivots))
        return np.asarray((self._values(solved) - gain).max(axis=1))

    def prospect(self, information: Floats, goal: float) -> tuple[Floats, float]:
        """See `Criterion.prospect`: the test pose that is worst now has to come down too."""
        solved = self._solved(information)
        values = self._values(solved)
        worst, r = int(np.argmax(values)), self.target.shape[1]
        return solved[:, worst * r : (worst + 1) * r], float(values[worst]) - goal

    def _solved(self, information: Floats) -> Floats:
        """``M^-1 C_t'`` of all t side by side, (p, t r)."""
        root = inverse_root(information)
        result: Floats = root @ (root.T @ self.target.reshape(-1, len(root)).T)
        return result

    def _values(self, solved: Floats) -> Floats:
        """Value of each test pose, (t,)."""
        values: Floats = self._grouped(np.sum(self.target.reshape(-1, len(solved)).T * solved, axis=0)[None])[0]
        return values

    def _grouped(self, columns: Floats) -> Floats:
        """Sums over the columns of each test pose: (m, t r) -> (m, t)."""
        return np.asarray(columns.reshape(len(columns), *self.target.shape[:2]).sum(axis=2))

    def _certificate(self, solved: Floats, mixture: Floats) -> Certificate:
        """Certificate of a mixture."""
        values = self._values(solved)
        factor = short((solved * np.repeat(np.sqrt(mixture), self.target.shape[1])).T).T
        return Certificate(float(values.max()), factor, float(mixture @ values) ** 2, mixture)


class MinimumEigenvalue(Criterion):
    """E: ``1/lambda_min`` of M in the parameters' own coordinates; the smooth function approximates -lambda_min."""

    smooth = False

    def __init__(self, basis: Floats) -> None:
        """Keep the coordinates ``basis`` T (p, p): the parameters' covariance is ``T M^-1 T'``."""
        self.basis = basis

    def value(self, information: Floats) -> float:
        """See `Criterion.value`."""
        return float(np.linalg.norm(self.basis @ inverse_root(information), 2) ** 2)

    def unit(self, information: Floats) -> float:
        """See `Criterion.unit`: the objective is an eigenvalue, the value its inverse."""
        return 1.0 / self.value(information)

    def objective(self, information: Floats, mu: float) -> float:
        """See `Criterion.objective`."""
        root = inverse_root(information)
        eigenvalues = 1.0 / np.linalg.svd(self.basis @ root, compute_uv=False) ** 2
        slack = central_slack(eigenvalues - eigenvalues[0], mu)
        # M - tau T'T = L (I - tau L^-1 T'T L^-T) L', and its determinant is that of M times prod(slack/eigenvalue)
        log_det = float(np.sum(np.log(slack / eigenvalues)) - 2.0 * np.sum(np.log(np.diag(root))))
        return float(slack[0] - eigenvalues[0]) - mu * log_det

    def certificate(self, information: Floats, dual: Floats | None) -> Certificate:
        """See `Criterion.certificate`."""
        if dual is None:
            raise ValueError("E needs a dual matrix")
        return Certificate(self.value(information), dual, 1.0, dual)

    def after_adding(self, information: Floats, rows: Floats) -> Floats:
        """See `Criterion.after_adding`: candidates in the order of an upper bound of lambda_min, as far as needed."""
        direction, least = self._weakest(information)
        ceiling = least + np.einsum("knq,knq->n", rows @ direction, rows @ direction)
        order = np.argsort(-ceiling, kind="stable")
        own = np.linalg.inv(self.basis)
        start, own_rows = own.T @ information @ own, rows @ own
        values, best = np.full(rows.shape[1], np.inf), 0.0
        for part in np.array_split(order, max(1, len(order) // 64)):
            if ceiling[part[0]] <= best:
                break
            chosen = own_rows[:, part].swapaxes(0, 1)
            smallest = np.linalg.eigvalsh(start + chosen.swapaxes(1, 2) @ chosen)[:, 0]
            values[part] = 1.0 / np.maximum(smallest, 1e-300)
            best = max(best, float(smallest.max()))
        return values

    def prospect(self, information: Floats, goal: float) -> tuple[Floats, float]:
        """See `Criterion.prospect`: ``lambda_min(M + G) <= x'(M + G)x`` for M's weakest direction x."""
        direction, least = self._weakest(information)
        return direction, 1.0 / goal - least

    def _weakest(self, information: Floats) -> tuple[Floats, float]:
        """Direction (p, 1) of the smallest eigenvalue, in row-space coordinates, and that eigenvalue."""
        root = inverse_root(information)
        _, spread, turn = np.linalg.svd(self.basis @ root)
        return root @ turn[:1].T / spread[0], float(1.0 / spread[0] ** 2)

    def published(self, dual: Floats | None) -> Floats | None:
        """See `Criterion.published`: X = T R R' T', trace 1."""
        if dual is None:
            return None
        own = self.basis @ dual
        square: Floats = own @ own.T / np.sum(own * own)
        return square

    def local(self, information: Floats, mu: float, dual: Floats | None) -> Local:
        """See `Criterion.local`."""
        root = inverse_root(information)
        _, spread, turn = np.linalg.svd(self.basis @ root)
        eigenvalues = 1.0 / spread**2  # of M in its own coordinates, smallest first
        slack = central_slack(eigenvalues - eigenvalues[0], mu)
        central = (root @ turn.T) * (np.sqrt(mu / slack) / spread)  # a factor of mu (M - tau T'T)^-1
        bent = central if dual is None else dual
        along = (self.basis @ bent).T @ (self.basis @ central)  # T'T as the curvature sees it
        along /= np.linalg.norm(along)

        def curvature(blocks: Floats) -> Floats:
            # tau moves along with M, which takes out the part along T'T
            rows, flat = products(blocks, bent, central), along.ravel()
            result: Floats = (rows - np.outer(rows @ flat, flat)) / np.sqrt(mu)
            return result

        def predict(change: Floats) -> tuple[Floats | None, float]:
            turned = bent.T @ change @ central
            turned -= np.sum(turned * along) * along
            # in coordinates where the present dual is I: the step of Helmberg, Kojima and Monteiro
            turn_in = np.linalg.solve(bent, central)
            step = turn_in @ turn_in.T - np.eye(len(spread))
            half = turned @ turn_in.T / mu
            step -= 0.5 * (half + half.T)
            values, vectors = np.linalg.eigh(step)
            reach = step_inside(float(values[0]))
            moved = bent @ (vectors * np.sqrt(1.0 + reach * values))
            return moved / np.linalg.norm(self.basis @ moved), reach

        return Local(Certificate(float(spread[0] ** 2), central, 1.0, central), curvature, predict)
