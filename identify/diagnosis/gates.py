"""Which blocks are significant when many are tried: Holm's rule, and flips of whole visits.

Holm (1979) needs scores whose distribution is known, that is a covariance that can be trusted. Where the stated one
cannot be right (gate ``flip``), its parts are estimated from the residual first, and what passes Holm's rule with them
must also pass a test that needs no covariance at all, only visits that are independent and scores that are symmetric
about zero when nothing is missing: with s_i the share of visit i in a block's score and g_i = +-1,

    T(g) = (sum g_i s_i)' (sum s_i s_i')^+ (sum g_i s_i),

and the observed T, g = 1, is compared with the largest T of all blocks over many random flips (Westfall and Young
1993; Hemerik, Goeman and Finos, J. R. Stat. Soc. B 82, 2020). Blocks of different size meet on the scale of their
chi-square probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from identify.arrays import Floats, Ints
from identify.diagnosis.evidence import Evidence
from identify.tails import chi2_sf

__all__ = ["LEVELS", "Gate", "family_probabilities", "flip_probabilities", "holm_probabilities"]

Gate = Literal["holm", "flip"]
#: A block is significant if its family-wise probability is below this.
LEVELS: dict[str, float] = {"holm": 0.005, "flip": 0.005}
_FLIP_LEVEL = 0.05  # of the flips, among the blocks that pass Holm's rule

_FLIPS = 1000
_FLIPS_MANY = 300
_MANY = 2000  # visits
_TINY = 1e-300


def holm_probabilities(single: Floats) -> Floats:
    """Holm's adjusted probabilities of (m,) single ones."""
    order = np.argsort(single, kind="stable")
    count = len(single)
    adjusted = np.maximum.accumulate(single[order] * np.arange(count, 0, -1))
    found = np.empty(count)
    found[order] = np.minimum(adjusted, 1.0)
    return found


def family_probabilities(evidence: Evidence, gate: Gate, rng: np.random.Generator, possible: np.ndarray) -> Floats:
    """Family-wise probability of every block, 1 for those that are out of the question.

    Args:
        evidence: The blocks beside a fit; with ``flip`` a fit with the noise as found.
        gate: What decides.
        rng: Random numbers of the flips.
        possible: (m,) False for blocks that are no explanation however well they fit.
    """
    scores = [evidence.score(block) for block in range(len(possible))]
    dof = np.array([score.dof for score in scores])
    single = np.where(dof > 0, chi2_sf([score.value for score in scores], np.maximum(dof, 1)), 1.0)
    found = np.where(possible, holm_probabilities(single), 1.0)
    if gate == "flip":
        passed = np.flatnonzero(found < LEVELS[gate])
        flipped = flip_probabilities(evidence, passed, rng)
        found[passed] = np.maximum(found[passed], flipped * LEVELS[gate] / _FLIP_LEVEL)
    return found


def flip_probabilities(evidence: Evidence, blocks: Sequence[int] | Ints, rng: np.random.Generator) -> Floats:
    """Family-wise probabilities of some blocks by flipping the signs of visits, (m,).

    Args:
        evidence: The blocks beside a fit.
        blocks: Those that are asked for.
        rng: Random numbers.
    """
    count = evidence.visits.count
    flips = rng.choice([-1.0, 1.0], size=(_FLIPS if count < _MANY else _FLIPS_MANY, count))
    flips[0] = 1.0
    smallest = np.ones(len(flips))
    observed = np.ones(len(blocks))
    for number, block in enumerate(blocks):
        logs = _log_probabilities(evidence, int(block), flips)
        observed[number] = logs[0]
        smallest = np.minimum(smallest, logs)
    return np.array([(smallest <= value + 1e-12).mean() for value in observed])


def _log_probabilities(evidence: Evidence, block: int, flips: Floats) -> Floats:
    """Logarithm of the chi-square probability of T for every flip; 0 where the block adds nothing."""
    directions = evidence.directions(block)
    if not directions.shape[1]:
        return np.zeros(len(flips))
    shares = evidence.visits.sums(directions * evidence.residual[:, None])
    values, vectors = np.linalg.eigh(shares.T @ shares)
    seen = values > 1e-12 * values.max(initial=0.0)
    if not seen.any():
        return np.zeros(len(flips))
    turned = shares @ (vectors[:, seen] / np.sqrt(values[seen]))
    size = ((flips @ turned) ** 2).sum(axis=1)
    logs: Floats = np.log(np.maximum(chi2_sf(size, int(seen.sum())), _TINY))
    return logs
