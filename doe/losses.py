"""What is left of a plan when visits cannot be measured."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np

from identify.arrays import Floats, Ints

__all__ = ["after_losses", "lost_sets"]


def lost_sets(count: int, losses: int) -> Ints:
    """(L, losses) every choice of so many out of ``count`` visits; (1, 0) without losses, (0, losses) with too few."""
    shape = (comb(count, losses), losses)
    return np.fromiter((i for lost in combinations(range(count), losses) for i in lost), np.int64).reshape(shape)


def after_losses(blocks: Floats, losses: int, prior: Floats | None = None) -> Floats:
    """Information of what is left of a plan, whichever visits are lost.

    Args:
        blocks: (n, k, p) whitened rows of the visits.
        losses: Number of lost visits.
        prior: (p, p) information that cannot be lost, or None.

    Returns:
        (L, p, p) in the order of `lost_sets`; each is a sum over what is left, so nothing cancels.
    """
    count, _, p = blocks.shape
    lost = lost_sets(count, losses)
    left = np.ones((len(lost), count))
    left[np.arange(len(lost))[:, None], lost] = 0.0
    own = (blocks.swapaxes(1, 2) @ blocks).reshape(count, p * p)
    information = (left @ own).reshape(-1, p, p)
    return information if prior is None else information + prior
