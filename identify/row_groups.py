"""Groups of equal rows of a table, by sorting."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats, Ints

__all__ = ["class_firsts", "classes", "occurrence", "run_firsts", "runs", "take"]


def runs(*keys: np.ndarray) -> Ints:
    """(R,) 0, 1, ... for runs of equal keys in sorted rows."""
    changed = np.zeros(len(keys[0]), dtype=bool)
    for key in keys:
        changed[1:] |= key[1:] != key[:-1]
    return np.cumsum(changed)


def run_firsts(run: Ints) -> Ints:
    """Index of the first row of every run."""
    return np.flatnonzero(np.append(True, run[1:] != run[:-1]))


def classes(*keys: np.ndarray) -> Ints:
    """(R,) number of each row among the distinct keys, in sorted order."""
    order = np.lexsort(keys[::-1])
    label = np.empty(len(order), dtype=np.int64)
    label[order] = runs(*(key[order] for key in keys))
    return label


def class_firsts(label: Ints) -> Ints:
    """Index of the first row of every class."""
    first: Ints = np.unique(label, return_index=True)[1]
    return first


def take(values: Floats | None, rows: Ints) -> Floats | None:
    """Some rows of an optional array."""
    return None if values is None else values[rows]


def occurrence(*keys: Ints) -> Ints:
    """(R,) 1, 2, ... for the rows of equal keys, in their order."""
    order = np.lexsort(keys[::-1])
    group = runs(*(key[order] for key in keys))
    number = np.empty_like(order)
    number[order] = np.arange(len(order)) - run_firsts(group)[group] + 1
    return number
