"""Where many blocks stand: gathered from parts, in memory or in a temporary file, and stacked without a copy.

More than `HELD` numbers stand in a file that is mapped into memory, so that as many of them are held as there is room
for. The file lies in the folder for temporary files (``TMPDIR``) and vanishes with its blocks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identify.arrays import Floats, Ints

__all__ = ["HELD", "Stacked", "gathered", "joined", "stacked"]

HELD = 1 << 27  # numbers that are held in memory: 1 GB of float64


@dataclass(frozen=True, eq=False)
class Stacked:
    """Two arrays of blocks, one behind the other, read like one array.

    Attributes:
        first: (N1, k, p), possibly mapped from a file.
        second: (N2, k, p).
    """

    first: NDArray[Any]
    second: NDArray[Any]

    def __len__(self) -> int:
        """Number of blocks of both."""
        return len(self.first) + len(self.second)

    @property
    def ndim(self) -> int:
        """Three."""
        return self.first.ndim

    @property
    def shape(self) -> tuple[int, ...]:
        """(N1 + N2, k, p)."""
        return (len(self), *self.first.shape[1:])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the numbers of both."""
        return np.result_type(self.first, self.second)

    @property
    def size(self) -> int:
        """Number of numbers."""
        return int(self.first.size + self.second.size)

    def __getitem__(self, key: slice | Ints) -> NDArray[Any]:
        """Blocks of a slice or of some numbers; those of the first array alone may be a view."""
        if isinstance(key, slice):
            start, stop, step = key.indices(len(self))
            if step != 1:
                return self[np.arange(start, stop, step)]
            edge = len(self.first)
            own, behind = self.first[start:stop], self.second[max(start - edge, 0) : max(stop - edge, 0)]
            return np.concatenate([own, behind]) if len(behind) else own
        behind = key >= len(self.first)
        found = np.empty((len(key), *self.first.shape[1:]), dtype=self.dtype)
        found[~behind], found[behind] = self.first[key[~behind]], self.second[key[behind] - len(self.first)]
        return found


def stacked(first: Floats, second: Floats) -> Floats | Stacked:
    """Blocks of both; where the second ones are shorter, rows of zeros are added to them.

    Args:
        first: (N1, k, p); copied only if its blocks are the shorter ones.
        second: (N2, k', p).
    """
    if not len(first) or not len(second):
        return second if len(second) else first
    rows = max(first.shape[1], second.shape[1])
    return Stacked(_filled(first, rows), _filled(second, rows))


def joined(first: Floats, second: Floats) -> Floats:
    """The same as one array, a copy where both have blocks."""
    both = stacked(first, second)
    return both[:] if isinstance(both, Stacked) else both


def _filled(blocks: Floats, rows: int) -> Floats:
    """Blocks with so many rows."""
    count, own, columns = blocks.shape
    if own == rows:
        return blocks
    longer = np.zeros((count, rows, columns))
    longer[:, :own] = blocks
    return longer


def gathered(parts: Iterable[Floats], count: int) -> Floats:
    """Parts (m, k, p) in their order as one array (N, k, p) of ``count`` blocks; only one part is held beside it.

    Raises:
        ValueError: The parts do not have so many blocks.
    """
    total, start = None, 0
    for part in parts:
        if len(part) == count:
            return part
        total = _room((count, *part.shape[1:])) if total is None else total
        total[start : start + len(part)] = part
        start += len(part)
    if total is None or start != count:
        raise ValueError(f"{start} blocks came, {count} were expected")
    return total


def _room(shape: tuple[int, ...]) -> Floats:
    """An array to be filled, in memory or in a file."""
    if int(np.prod(shape, dtype=np.int64)) <= HELD:
        return np.empty(shape)
    with TemporaryFile(prefix="elastocal-") as file:  # the map outlives it
        return np.asarray(np.memmap(file, dtype=np.float64, mode="w+", shape=shape))
