"""How well an effect shows: its energy in units of the noise, after the base model has taken its share."""

from dataclasses import dataclass, replace

import numpy as np

from tests.blind.physics import Conditions, World, respond
from tests.blind.setting import Noise

STEP = 1e-3  # of a typical size; everything differentiated here is smooth or linear


@dataclass(frozen=True, eq=False)
class Lens:
    """Whitens readings of given conditions and removes what the base model explains."""

    world: World
    given: Conditions
    inverse: np.ndarray  # (P, k, k)
    base: np.ndarray  # (P k, r) orthonormal

    def whiten(self, readings):
        """(P, L, M, 3) -> (P k,)."""
        flat = readings.reshape(len(self.inverse), -1, 1)
        return (self.inverse @ flat).ravel()

    def columns(self, handles, world=None, step=STEP):
        """(P k, h) whitened derivative by typical sizes of each handle."""
        world = self.world if world is None else world
        start = respond(world, self.given)
        moved = [(respond(apply(world, step), self.given) - start) / step for apply in handles]
        return np.stack([self.whiten(part) for part in moved], axis=1)

    def remains(self, vector, others=None):
        """Energy of a whitened vector beyond the base and other whitened columns."""
        rest = vector - self.base @ (self.base.T @ vector)
        if others is not None:
            part = others - self.base @ (self.base.T @ others)
            span = orthonormal(part, np.linalg.norm(others, axis=0))
            rest = rest - span @ (span.T @ rest)
        return float(rest @ rest)


def covariance_root(world: World, given: Conditions, noise: Noise) -> np.ndarray:
    """(P, k, k) inverse Cholesky factors of the covariance of a visit's readings."""
    start = respond(world, given)
    distance = np.linalg.norm(start, axis=-1)
    spread = np.repeat(noise.spread(distance)[..., None], 3, axis=-1)
    bumps = [(respond(world, replace(given, jitter=1e-6 * np.eye(6)[j])) - start) / 1e-6 for j in range(6)]
    jacobian = np.stack(bumps, axis=-1)  # (P, L, M, 3, 6)
    visits, readings = given.load.shape
    tall = jacobian.reshape(visits, -1, 6)
    cov = noise.pose**2 * tall @ tall.swapaxes(1, 2)
    own = jacobian.reshape(visits, readings, -1, 6)
    width = own.shape[2]
    for shot in range(readings):
        rows = slice(shot * width, (shot + 1) * width)
        cov[:, rows, rows] += noise.shot**2 * own[:, shot] @ own[:, shot].swapaxes(1, 2)
    index = np.arange(cov.shape[1])
    cov[:, index, index] += spread.reshape(visits, -1) ** 2
    return np.linalg.inv(np.linalg.cholesky(cov))


def orthonormal(columns, scale=None, tolerance=1e-6):
    """Basis of the columns; directions that keep less than a share of their length do not count."""
    scale = np.linalg.norm(columns, axis=0) if scale is None else scale
    keep = (scale > 0) & (np.linalg.norm(columns, axis=0) > tolerance * scale)
    if not keep.any():
        return columns[:, :0]
    unit = columns[:, keep] / scale[keep]
    left, size, _ = np.linalg.svd(unit, full_matrices=False)
    return left[:, size > tolerance]


def lens_for(world: World, given: Conditions, noise: Noise, base_handles) -> Lens:
    """The lens of one measurement; the base handles are what the study already fits."""
    inverse = covariance_root(world, given, noise)
    bare = Lens(world, given, inverse, np.zeros((inverse.shape[0] * inverse.shape[1], 0)))
    return replace(bare, base=orthonormal(bare.columns(base_handles), tolerance=1e-9))
