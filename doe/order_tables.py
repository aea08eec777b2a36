"""Visits and the possible orders of their readings as tables, by which many orders are judged at once.

An order is (visit (V,), option (V,)): what comes first, second, ..., and which order of its readings it takes.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from doe.lifts import (
    NOTHING,
    Fewest,
    ReadingOrders,
    carried_between,
    fewest_lifts,
    hung_states,
    lifts_between,
    orders_of,
)
from doe.order import Order, Visits, measured, passage
from doe.routing import short_route
from identify.arrays import Floats, Ints
from identify.units import HOUR

__all__ = ["Tables"]

_ROUTES = 100  # visits of a plan from each of which a route by nearest neighbours is tried


class Tables:
    """Visits and the possible orders of their readings."""

    def __init__(self, visits: Visits) -> None:
        """Look at every order of the readings of each kind of visit."""
        self.visits = visits
        states = hung_states(visits.loads, visits.unloaded)
        _, first, kind = np.unique(states, axis=0, return_index=True, return_inverse=True)
        self.kind: Ints = kind.ravel()
        self.kinds: tuple[ReadingOrders, ...] = tuple(orders_of(states[i]) for i in first)
        self.options = max(len(orders.lifts) for orders in self.kinds)
        self.count = np.array([len(self.kinds[k].lifts) for k in self.kind])
        self.entry, self.exit, self.within, self.reverse = (
            np.array([np.resize(getattr(self.kinds[k], key), self.options) for k in self.kind])
            for key in ("entry", "exit", "lifts", "reverse")
        )
        pace = visits.pace
        readings = visits.loads.shape[1]
        self.length = pace.reading * (readings - 1) + pace.load_change * self.within  # (V, O), first to last reading
        self.sums = visits.drift.sum(axis=1)  # (V, K)
        self.inner = np.stack([self._inner(visit) for visit in range(len(self.kind))])  # (V, O, K)

    def _inner(self, visit: int) -> Floats:
        """(O, K) drift within a visit, from its first reading on, for each order of its readings."""
        orders, pace = self.kinds[self.kind[visit]], self.visits.pace
        state = hung_states(self.visits.loads[visit], self.visits.unloaded)[orders.places]
        step = pace.reading + pace.load_change * lifts_between(state[:, :-1], state[:, 1:])
        late = np.cumsum(np.pad(step, ((0, 0), (1, 0))), axis=1) / HOUR
        drift = np.einsum("os,osk->ok", late, self.visits.drift[visit][orders.places])
        return np.asarray(drift[np.resize(np.arange(len(drift)), self.options)])

    @cached_property
    def fewest(self) -> Fewest:
        """The fewest operations."""
        return fewest_lifts(self.kinds, np.bincount(self.kind))

    def lifts(self, visit: Ints, option: Ints) -> Ints:
        """(B,) operations of orders (B, V)."""
        left = self.exit[visit, option]
        total = (self.within[visit, option] + self._passages(visit, option)[2]).sum(axis=1)
        return np.asarray(total + (self.visits.taken_off & (left[:, -1] != NOTHING)))

    def ways(self, visit: Ints, option: Ints) -> tuple[Floats, Floats]:
        """(B, V) time and length of the move to each visit of orders (B, V)."""
        travel, (before, carried, _) = self.visits.travel, self._passages(visit, option)
        move = travel.move(carried, before, visit)
        return travel.seconds[move], travel.length[move]

    def _passages(self, visit: Ints, option: Ints) -> tuple[Ints, Ints, Ints]:
        """(B, V) of orders (B, V): the pose before each visit, what hangs on the way, and operations on the way."""
        before = np.concatenate([np.full((len(visit), 1), len(self.kind)), visit[:, :-1]], axis=1)
        left = np.concatenate([np.full((len(visit), 1), NOTHING), self.exit[visit, option][:, :-1]], axis=1)
        return before, *passage(self.visits.travel, left, self.entry[visit, option], before, visit)

    def blocked(self, visit: Ints, option: Ints) -> bool:
        """True if a move of an order is not possible."""
        return not np.isfinite(self.ways(visit[None], option[None])[1]).all()

    def drifts(self, visit: Ints, option: Ints, seconds: Floats) -> Floats:
        """(B,) size of the drift of orders (B, V)."""
        pace, (batch, count) = self.visits.pace, visit.shape
        changes = self._passages(visit, option)[2][:, 1:]
        step = self.length[visit, option][:, :-1] + pace.load_change * changes + pace.pose + seconds[:, 1:]
        late = np.cumsum(np.pad(step, ((0, 0), (1, 0))), axis=1) / HOUR
        rows = np.arange(batch)[:, None]
        by_visit, chosen = np.zeros((batch, count)), np.zeros((batch, count * self.options))
        by_visit[rows, visit] = late
        chosen[rows, visit * self.options + option] = 1.0
        total = by_visit @ self.sums + chosen @ self.inner.reshape(-1, self.sums.shape[1])
        return np.asarray(np.linalg.norm(total, axis=1))

    def order(self, visit: Ints, option: Ints) -> Order:
        """An order with its reading times."""
        reading = np.stack([self.kinds[self.kind[v]].places[o] for v, o in zip(visit, option, strict=True)])
        return measured(self.visits, visit, reading)

    def by_pattern(self) -> tuple[Ints, Ints]:
        """The kinds in a sequence of the fewest operations, each time the nearest visit of the kind."""
        steps = [*self.fewest.steps]
        if self.visits.taken_off:
            steps = _unloaded_between(steps, self.kinds)
        kinds, option = (np.array(part) for part in zip(*steps, strict=True))
        travel = self.visits.travel
        entry, left_with = (np.array([getattr(self.kinds[k], key)[o] for k, o in steps]) for key in ("entry", "exit"))
        carried = carried_between(left_with[:-1], entry[1:])
        firsts = np.flatnonzero(self.kind == kinds[0])[: max(_ROUTES**2 // len(kinds) ** 2, 1)]
        routes, home = [], travel.length[-1, -1]
        for first in firsts if not home.any() else firsts[[np.argmin(home[firsts])]]:
            left, route = np.ones(len(self.kind), dtype=bool), [int(first)]
            left[first] = False
            for kind, hung in zip(kinds[1:], carried, strict=True):
                open_ones = np.flatnonzero(left & (self.kind == kind))
                way = travel.length[travel.move(hung, np.full(len(open_ones), route[-1]), open_ones)]
                route.append(int(open_ones[np.argmin(way)]))
                left[route[-1]] = False
            routes.append(route)
        visit = np.array(routes)
        return visit[np.argmin(self.ways(visit, np.broadcast_to(option, visit.shape))[1].sum(axis=1))], option

    def by_routing(self) -> tuple[Ints, Ints]:
        """The route of the solver, which puts operations before travel."""
        visit, option = np.nonzero(np.arange(self.options) < self.count[:, None])
        place = np.append(visit, len(self.kind))
        entry = np.append(self.entry[visit, option], NOTHING)
        left = np.append(self.exit[visit, option], NOTHING)
        within = np.append(self.within[visit, option], 0)
        travel = self.visits.travel
        carried, changes = passage(travel, left[:, None], entry[None], place[:, None], place[None])
        lifts = changes + within[None]
        length = travel.length[travel.move(carried, place[:, None], place[None])]
        longest = np.max(length, where=np.isfinite(length), initial=0.0) * (len(self.kind) + 1)
        route = short_route(lifts * max(longest, 1.0) + length, visit)
        return visit[route], option[route]


def _unloaded_between(steps: list[tuple[int, int]], kinds: tuple[ReadingOrders, ...]) -> list[tuple[int, int]]:
    """Single readings by weight, with the unloaded ones spread before, between and after the weights."""
    bare = [step for step in steps if kinds[step[0]].entry[step[1]] == NOTHING]
    loaded = [step for step in steps if kinds[step[0]].entry[step[1]] != NOTHING]
    groups = [[step for step in loaded if step[0] == kind] for kind in dict.fromkeys(kind for kind, _ in loaded)]
    result: list[tuple[int, int]] = []
    for place in range(len(groups) + 1):
        result += bare[place :: len(groups) + 1]
        result += groups[place] if place < len(groups) else []
    return result
