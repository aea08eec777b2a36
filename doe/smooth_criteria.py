"""The smooth criteria: test_pose and A (a mean), D (a volume); formulas in `doe.criteria`."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from doe.criterion import Certificate, Criterion, Local, eliminated, inverse_root, packed, products, short
from identify.arrays import Floats

__all__ = ["Mean", "Volume"]


class Mean(Criterion):
    """test_pose and A: ``trace(C M^-1 C')``."""

    def __init__(self, target: Floats) -> None:
        """Keep the target rows (r, p), at most p of them."""
        self.target = short(target)

    def value(self, information: Floats) -> float:
        """See `Criterion.value`."""
        half = solve_triangular(np.linalg.cholesky(information), self.target.T, lower=True)
        return float(np.sum(half * half))

    def objective(self, information: Floats, mu: float) -> float:
        """See `Criterion.objective`; ``mu`` is not used."""
        return self.value(information)

    def certificate(self, information: Floats, dual: Floats | None) -> Certificate:
        """See `Criterion.certificate`."""
        return self.local(information, 0.0, None).certificate

    def local(self, information: Floats, mu: float, dual: Floats | None) -> Local:
        """See `Criterion.local`."""
        root = inverse_root(information)
        half = root.T @ self.target.T
        factor, value = root @ half, float(np.sum(half * half))

        def curvature(blocks: Floats) -> Floats:
            result: Floats = np.sqrt(2.0) * products(blocks, root, factor)
            return result

        return Local(Certificate(value, factor, value * value), curvature, lambda change: (None, 1.0))

    def after_adding(self, information: Floats, rows: Floats) -> Floats:
        """See `Criterion.after_adding`: the value falls by ``tr (I + A P A')^-1 A P C'C P A'``, P = M^-1."""
        root = inverse_root(information)
        half = root.T @ self.target.T
        pivots, turned = eliminated(rows, root, root @ half)
        gain = np.sum(np.einsum("qkn,qkn->kn", turned, turned) / pivots, axis=0)
        return np.asarray(float(np.sum(half * half)) - gain)

    def prospect(self, information: Floats, goal: float) -> tuple[Floats, float]:
        """See `Criterion.prospect`: leaving out the inverse in `after_adding` only raises the gain."""
        certificate = self.certificate(information, None)
        return certificate.factor, certificate.value - goal


class Volume(Criterion):
    """D: ``det(M)^(-1/p)``; the smooth function is -log det M."""

    def __init__(self, basis: Floats) -> None:
        """Keep the volume of the coordinates ``basis`` (p, p)."""
        self.log_volume = float(np.linalg.slogdet(basis)[1])

    def value(self, information: Floats) -> float:
        """See `Criterion.value`."""
        return float(np.exp((self.objective(information, 0.0) + 2.0 * self.log_volume) / len(information)))

    def objective(self, information: Floats, mu: float) -> float:
        """See `Criterion.objective`; ``mu`` is not used."""
        return -2.0 * float(np.sum(np.log(np.diag(np.linalg.cholesky(information)))))

    def certificate(self, information: Floats, dual: Floats | None) -> Certificate:
        """See `Criterion.certificate`."""
        return self.local(information, 0.0, None).certificate

    def local(self, information: Floats, mu: float, dual: Floats | None) -> Local:
        """See `Criterion.local`."""
        root, value = inverse_root(information), self.value(information)

        def curvature(blocks: Floats) -> Floats:
            return packed(products(blocks, root, root))

        return Local(Certificate(value, root, len(root) * value), curvature, lambda change: (None, 1.0))

    def after_adding(self, information: Floats, rows: Floats) -> Floats:
        """See `Criterion.after_adding`: log det M grows by ``log det (I + A P A')``, P = M^-1."""
        root = inverse_root(information)
        pivots, _ = eliminated(rows, root, np.zeros((len(root), 0)))
        growth = np.sum(np.log(pivots), axis=0)
        values: Floats = self.value(information) * np.exp(-growth / len(root))
        return values

    def prospect(self, information: Floats, goal: float) -> tuple[Floats, float]:
        """See `Criterion.prospect`: ``log det (I + S) <= tr S``."""
        root = inverse_root(information)
        return root, len(root) * float(np.log(self.value(information) / goal))
