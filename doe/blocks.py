"""Streaming access to the candidate blocks: read in chunks, never changed, never copied whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from doe.storage import Stacked
from identify.arrays import Floats, Ints
from identify.errors import InputError

__all__ = ["Blocks", "sensitivities"]

T = TypeVar("T")
CHUNK = 1 << 17  # numbers per chunk: 1 MB of float64 stays in a core's cache
MANY = 1 << 24  # numbers that are worth a second thread


class Blocks:
    """The whitened observation rows ``A_i`` (k, p) of N candidates.

    Attributes:
        array: (N, k, p) as given by the caller, any float dtype, possibly read-only or memory-mapped.
        eps: Rounding unit of the numbers as they were stored.
    """

    def __init__(self, blocks: Any) -> None:
        """Check shape and type; the numbers are looked at by `gram` and `peak`.

        Raises:
            InputError: ``blocks`` is not a real (N, k, p) array with N, k, p >= 1.
        """
        array = blocks if isinstance(blocks, np.ndarray | Stacked) else np.asarray(blocks)
        if array.ndim != 3 or 0 in array.shape:
            raise InputError(f"blocks have shape {array.shape}, needed: (N, k, p) with N, k, p >= 1")
        if array.dtype.kind not in "fiu":
            raise InputError(f"blocks have dtype {array.dtype}, needed: real numbers, for example float64")
        self.array: NDArray[Any] | Stacked = array
        stored = np.finfo(array.dtype).eps if array.dtype.kind == "f" else 0.0
        self.eps = max(float(stored), float(np.finfo(np.float64).eps))

    def __len__(self) -> int:
        """Number of candidates N."""
        return int(self.array.shape[0])

    @property
    def k(self) -> int:
        """Rows of one block."""
        return int(self.array.shape[1])

    @property
    def p(self) -> int:
        """Number of parameters."""
        return int(self.array.shape[2])

    def chunks(
        self, first: int = 0, end: int | None = None, index: Ints | None = None
    ) -> Iterator[tuple[slice, Floats]]:
        """Candidates from ``first`` to before ``end`` and their rows ((m k), p) in float64, some at a time.

        With ``index`` the places are those in this list of candidates.
        """
        step, end = max(1, CHUNK // (self.k * self.p)), len(self) if end is None else end
        for start in range(first, end, step):
            part = slice(start, min(start + step, end))
            some = self.array[part] if index is None else self.array[index[part]]
            yield part, np.ascontiguousarray(some, dtype=np.float64).reshape(-1, self.p)

    def take(self, index: Ints, basis: Floats) -> Floats:
        """Blocks of some candidates in new coordinates: ``A_i @ basis``, (m, k, q)."""
        rows = np.ascontiguousarray(self.array[index], dtype=np.float64).reshape(-1, self.p)
        product: Floats = rows @ basis
        return product.reshape(len(index), self.k, basis.shape[1])

    def gram(self, basis: Floats) -> Floats:
        """Sum over all candidates of ``(A_i basis)' (A_i basis)``, (q, q); one of (p,) scales the columns.

        Numbers that are not finite, or that overflow when squared, leave a diagonal that is not finite.
        """

        def total(first: int, end: int) -> Floats:
            result = np.zeros(basis.shape[-1:] * 2)
            for _, rows in self.chunks(first, end):
                with np.errstate(over="ignore", invalid="ignore"):
                    turned = rows * basis if basis.ndim == 1 else rows @ basis
                    result += turned.T @ turned
            return result

        return sum(self._in_parts(total, len(self)), np.zeros(basis.shape[-1:] * 2))

    def sensitivities(self, factor: Floats, index: Ints | None = None) -> Floats:
        """``d_i = |A_i factor|^2`` of all candidates (N,), or of those in ``index`` (m,), for ``factor`` (p, q)."""
        result = np.empty(len(self) if index is None else len(index))

        def fill(first: int, end: int) -> None:
            for part, rows in self.chunks(first, end, index):
                result[part] = _squares(rows @ factor, self.k)

        self._in_parts(fill, len(result))
        return result

    def peak(self) -> Floats:
        """Largest absolute value of each column, (p,).

        Raises:
            InputError: A number is NaN or infinite; the first one is named.
        """
        peak = np.zeros(self.p)
        for part, rows in self.chunks():
            # max and min hand NaN on, so no boolean copy of the chunk is needed
            here = np.maximum(rows.max(axis=0), -rows.min(axis=0))
            if not np.isfinite(here).all():
                self._refuse(part.start, rows)
            peak = np.maximum(peak, here)
        return peak

    def _in_parts(self, work: Callable[[int, int], T], count: int) -> list[T]:
        """``work(first, end)`` for all of ``count`` candidates, or for two halves of them at once where they are many.

        The parts depend on the size alone, so every number is the same whoever computes it.
        """
        if count * self.k * self.p < MANY:
            return [work(0, count)]
        with ThreadPoolExecutor(2) as threads:  # numpy works outside the interpreter's lock
            return list(threads.map(work, (0, count // 2), (count // 2, count)))

    def _refuse(self, start: int, rows: Floats) -> None:
        """Name the first entry that is not finite."""
        row, column = np.argwhere(~np.isfinite(rows))[0]
        where = (start + row // self.k, row % self.k, column)
        raise InputError(f"blocks[{where[0]}, {where[1]}, {where[2]}] is {rows[row, column]}, needed: finite numbers")


def sensitivities(blocks: Floats, factor: Floats) -> Floats:
    """``d_i = |A_i factor|^2`` of blocks (m, k, p) held in memory, (m,)."""
    return _squares(blocks.reshape(-1, blocks.shape[2]) @ factor, blocks.shape[1])


def _squares(rows: Floats, k: int) -> Floats:
    """Sums of squares over groups of k rows."""
    grouped = rows.reshape(-1, k * rows.shape[1])
    result: Floats = np.einsum("ij,ij->i", grouped, grouped)
    return result
