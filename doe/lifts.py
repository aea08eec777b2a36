"""Crane operations: how many a sequence of readings takes, and the fewest that any sequence of given visits takes.

Weights hang on the flange or do not. Hanging one is an operation, taking it off is another, so that a change from one
weight to another is two; nothing hangs before the first reading, and what hangs at the last one stays. A visit reads
its loads in some order, which ends where the next visit may begin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from identify.arrays import Ints, frozen

__all__ = [
    "NOTHING",
    "Fewest",
    "ReadingOrders",
    "carried_between",
    "fewest_lifts",
    "hung_states",
    "lifts_between",
    "lifts_of",
    "orders_of",
]

NOTHING = -1  # hangs on the flange
_ENUMERATED = 5  # readings of one visit whose orders are all looked at
_STATES = 100_000  # of the search over what is still to be visited, before visits are put aside
_MOST_STATES = 1_000_000  # beyond this there is no search

_Step = tuple[int, int]  # kind of visit, and the order of its readings


@dataclass(frozen=True, eq=False)
class ReadingOrders:
    """Orders in which the readings of one kind of visit may be taken.

    Attributes:
        places: (O, S) reading that is taken first, second, ...; the first row is the stated order if that is kept.
        entry: (O,) what hangs at the first reading.
        exit: (O,) what hangs at the last one.
        lifts: (O,) operations within the visit, the fewest between this entry and exit.
        reverse: (O,) the order that is this one backwards.
    """

    places: Ints
    entry: Ints
    exit: Ints
    lifts: Ints
    reverse: Ints

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("places", "entry", "exit", "lifts", "reverse"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))


@dataclass(frozen=True, eq=False)
class Fewest:
    """The fewest operations and a sequence that takes no more.

    Attributes:
        lifts: Operations.
        steps: Kind of each visit and the order of its readings, one after the other.
        proven: No sequence takes fewer; else none was found.
    """

    lifts: int
    steps: tuple[_Step, ...]
    proven: bool


def hung_states(visit_loads: Ints, unloaded: np.ndarray) -> Ints:
    """What hangs at each reading: its load, or `NOTHING`.

    Args:
        visit_loads: (..., S) indices of loads.
        unloaded: (loads,) True where nothing hangs.
    """
    return np.where(unloaded[visit_loads], NOTHING, visit_loads)


def carried_between(left: Ints, entry: Ints) -> Ints:
    """What hangs on the way from one reading to the next: what stays; a change is made with nothing hung on the way.

    Args:
        left: What hangs at the reading before, any shape.
        entry: What hangs at the next one.
    """
    return np.asarray(np.where(left == entry, left, NOTHING))


def lifts_between(before: Ints, after: Ints) -> Ints:
    """Operations from one state to another, any shape."""
    return np.asarray(((before != NOTHING).astype(np.int64) + (after != NOTHING)) * (before != after))


def lifts_of(states: Ints) -> int:
    """Operations of a sequence of readings, (R,) states, from nothing hung to the last reading."""
    flat = np.append(NOTHING, np.ravel(states))
    return int(lifts_between(flat[:-1], flat[1:]).sum())


def orders_of(states: Ints) -> ReadingOrders:
    """Orders of the readings of one visit, (S,) states: the best ones between each pair of first and last reading.

    Above five readings the stated order and its reverse alone are looked at.
    """
    count = len(states)
    every = list(permutations(range(count))) if count <= _ENUMERATED else [tuple(range(count))]
    if count > _ENUMERATED:
        every.append(every[0][::-1])
    places = np.array(every, dtype=np.int64)
    seen = states[places]
    lifts = lifts_between(seen[:, :-1], seen[:, 1:]).sum(axis=1)
    ends = [(int(first), int(last)) for first, last in seen[:, [0, -1]]]
    best = {end: min(n for n, e in zip(lifts, ends, strict=True) if e == end) for end in set(ends)}
    kept = [i for i, end in enumerate(ends) if lifts[i] == best[end]]
    place = {every[i]: new for new, i in enumerate(kept)}
    reverse = [place[every[i][::-1]] for i in kept]
    return ReadingOrders(places[kept], seen[kept, 0], seen[kept, -1], lifts[kept], np.array(reverse))


def fewest_lifts(kinds: tuple[ReadingOrders, ...], counts: Ints) -> Fewest:
    """The fewest operations that visit everything.

    A search over what is still to be visited and what hangs. Where that is too much, visits of one kind are put aside
    in pairs, there and back again, which cost no operation beyond their own. With one or two readings a visit nothing
    is lost by this: the visits are edges of a graph of states, two equal edges change no degree, and the walk through
    all edges is as long as they are and what the odd degrees need (the Chinese postman).

    Args:
        kinds: Orders of the readings of each kind of visit.
        counts: (kinds,) number of visits of each kind.
    """
    left, pairs = np.array(counts, dtype=np.int64), np.zeros(len(counts), dtype=np.int64)
    states = len({int(state) for kind in kinds for state in kind.entry} | {NOTHING})
    while math.prod(int(n) + 1 for n in left) * states > _STATES and (left > 2).any():
        most = int(np.argmax(left))
        left[most] -= 2
        pairs[most] += 1
    small = math.prod(int(n) + 1 for n in left) * states <= _MOST_STATES
    steps = list(_searched(kinds, left) if small else _greedy(kinds, left))
    for kind in np.flatnonzero(pairs):
        where = next(i for i, step in enumerate(steps) if step[0] == kind)
        orders = kinds[kind]
        onward = np.flatnonzero(orders.entry == orders.exit[steps[where][1]])
        there = int(onward[np.argmin(orders.lifts[onward])])
        steps[where + 1 : where + 1] = [(int(kind), there), (int(kind), int(orders.reverse[there]))] * int(pairs[kind])
    readings = max(kind.places.shape[1] for kind in kinds)
    proven = small and (readings <= 2 or (not pairs.any() and readings <= _ENUMERATED))
    return Fewest(_lifts_of_steps(kinds, steps), tuple(steps), proven)


def _lifts_of_steps(kinds: tuple[ReadingOrders, ...], steps: list[_Step]) -> int:
    """Operations of a sequence of visits."""
    entry = np.array([kinds[kind].entry[order] for kind, order in steps])
    left = np.array([NOTHING, *(kinds[kind].exit[order] for kind, order in steps)])
    within = sum(int(kinds[kind].lifts[order]) for kind, order in steps)
    return within + int(lifts_between(left[:-1], entry).sum())


def _searched(kinds: tuple[ReadingOrders, ...], counts: Ints) -> Iterator[_Step]:
    """The best sequence of a small problem, by dynamic programming over the visits made so far."""
    begin = (tuple(0 for _ in counts), NOTHING)
    layer = {begin: 0}
    came: dict[tuple[tuple[int, ...], int], tuple[tuple[tuple[int, ...], int], _Step]] = {}
    for _ in range(int(counts.sum())):
        following: dict[tuple[tuple[int, ...], int], int] = {}
        for (done, hung), cost in layer.items():
            for kind, orders in enumerate(kinds):
                if done[kind] == counts[kind]:
                    continue
                more = (*done[:kind], done[kind] + 1, *done[kind + 1 :])
                total = cost + orders.lifts + lifts_between(np.full_like(orders.entry, hung), orders.entry)
                for order, (end, value) in enumerate(zip(orders.exit.tolist(), total.tolist(), strict=True)):
                    if value < following.get((more, end), math.inf):
                        following[more, end] = value
                        came[more, end] = ((done, hung), (kind, order))
        layer = following
    node = min(layer, key=lambda reached: layer[reached])
    steps: list[_Step] = []
    while node != begin:
        node, step = came[node]
        steps.append(step)
    return reversed(steps)


def _greedy(kinds: tuple[ReadingOrders, ...], counts: Ints) -> Iterator[_Step]:
    """A sequence that takes as few operations as it can at each step."""
    left, hung = counts.copy(), np.array(NOTHING)
    while left.any():
        steps = [(kind, order) for kind in np.flatnonzero(left) for order in range(len(kinds[kind].lifts))]
        costs = [
            int((kinds[kind].lifts[order] + lifts_between(hung, kinds[kind].entry[[order]])).item())
            for kind, order in steps
        ]
        kind, order = steps[int(np.argmin(costs))]
        left[kind] -= 1
        hung = kinds[kind].exit[[order]]
        yield int(kind), order
