"""Scatter that noise cannot have: one joint, or one joint's compliance, that differs from pose to pose.

The stated noise shakes all joints alike. A cause that no library holds may depend on anything, so that no smooth
function finds it; but it sits somewhere. For every joint j two random parts are compared with what the noise leaves:
an error of the joint, new in each visit, ``D_j b_i``, and an error of its compliance, new in each visit,
``D_j t_j c_i``. With a_i the whitened column of visit i the score of such a part is

    Q = sum_i (a_i' r_i)^2 ,   distributed as  sum_i a_i'(I - H_i) a_i chi2_1  if it is absent

(the score test of a variance component; Lin, Biometrika 84, 1997), and only more scatter than expected counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.diagnosis.evidence import Evidence
from identify.tails import gamma_sf

__all__ = ["Uneven", "uneven"]

_DRAWS = 20_000
_MANY = 300  # visits from which on a gamma distribution stands for the sum


@dataclass(frozen=True)
class Uneven:
    """A random part and how improbable its scatter is.

    Attributes:
        depends_on: Column of the joint that it sits in.
        p_value: Probability of so much scatter if the part is absent.
    """

    depends_on: str
    p_value: float


def uneven(seen: Evidence, rng: np.random.Generator) -> tuple[Uneven, ...]:
    """Test every joint and every joint's compliance for scatter of its own.

    Args:
        seen: The evidence beside a fit.
        rng: Random numbers of the reference distribution.
    """
    found = seen.found
    scene, experiment = found.response.scene, found.data.experiment
    motion, torque = scene.joints.motion, scene.joints.torque[experiment.row_shot]
    made = []
    for joint in range(motion.shape[1]):
        name = f"q{joint + 1}_{'mm' if found.model.robot.prismatic[joint] else 'deg'}"
        for columns in (motion[:, joint], motion[:, joint] * torque[:, joint, None]):
            made.append(Uneven(name, _probability(seen, found.whitening.apply(columns), rng)))
    return tuple(made)


def _probability(seen: Evidence, column: Floats, rng: np.random.Generator) -> float:
    """Probability of the scatter along a whitened column (K,)."""
    total, weights = 0.0, []
    for index, left in zip(seen.visits.index, seen.left, strict=True):
        part = column[index]
        total += float((np.einsum("gk,gk->g", part, seen.residual[index]) ** 2).sum())
        weights.append(np.einsum("gk,gkl,gl->g", part, left, part))
    return _tail(total, np.concatenate(weights), rng)


def _tail(total: float, weights: Floats, rng: np.random.Generator) -> float:
    """P(sum w_i chi2_1 > total): by gamma with the same two moments; by draws where it is neither small nor clear."""
    mean, spread = weights.sum(), 2.0 * (weights**2).sum()
    if mean <= 0.0:
        return 1.0
    smooth = gamma_sf(total, mean**2 / spread, spread / mean)
    if len(weights) > _MANY or not 1e-6 < smooth < 0.05:
        return smooth
    draws = rng.chisquare(1.0, size=(_DRAWS, len(weights))) @ weights
    return float(max((np.count_nonzero(draws > total) + 1) / (_DRAWS + 1), smooth))
