"""The order of visits, and of the readings in each: fewest crane operations, then little drift and short travel.

The operations are never more than the fewest there can be (`doe.lifts`), unless no such order avoids moves that collide
with what hangs. Among such orders a local search looks for one
with a small

    travel / travel_0  +  30 drift / own  +  10 drift / naive

where drift is what a typical drift of the instrument does to the result, own the error that the plan has anyway, naive
the drift of the visits as they stand, and travel_0 the way of the order that the search starts from. A drift of a
thirtieth of the plan's own error is thus worth as much as the whole way.
"""

from __future__ import annotations

import numpy as np

from doe.lifts import Fewest
from doe.order import Order, Visits, as_found
from doe.order_moves import moved, moves_of, turned_round
from doe.order_tables import Tables
from identify.arrays import Floats, Ints

__all__ = ["best_order"]

_OWN, _NAIVE = 30.0, 10.0  # weights of the drift, see above
_WORK = 10_000_000  # places of orders looked at
_BATCH = 200_000  # places of orders looked at together
_KICKS = 20  # new starts from a disturbed order
_MORE = (1, 2, 4, 8, 16, 32, 64)  # operations beyond the fewest that are tried where moves are blocked
_ROUTED = 100  # visits that the routing solver is asked for; it needs seconds for more


def best_order(visits: Visits, rng: np.random.Generator) -> tuple[Order, Fewest]:
    """Put visits in order.

    Args:
        visits: What is to be visited.
        rng: Random numbers of the local search.

    Returns:
        The order, and the fewest operations that there can be.
    """
    tables = Tables(visits)
    starts = [tables.by_pattern()]
    if 1 < len(visits.loads) <= _ROUTED:
        starts.append(tables.by_routing())
    taken = [int(tables.lifts(visit[None], option[None])[0]) for visit, option in starts]
    most = _limit(visits, max(tables.fewest.lifts, min(taken)))
    search = _Search(tables, most, rng)
    found = search.best([start for start in starts if search.allows(*start)])
    for more in _MORE:  # other changes of weights may go where these cannot
        if not tables.blocked(*found):
            break
        found = _Search(tables, most + more, rng).best([found])
    return tables.order(*found), tables.fewest


def _limit(visits: Visits, fewest: int) -> int:
    """Operations that an order may take; where the last weight is taken off anyway, they come in pairs."""
    return fewest + fewest % 2 if visits.taken_off else fewest


class _Search:
    """Local search over orders that keep to a number of operations."""

    def __init__(self, tables: Tables, most: int, rng: np.random.Generator) -> None:
        """Weigh drift against travel, and list the moves."""
        self.tables, self.most, self.rng = tables, most, rng
        self.moves = moves_of(len(tables.kind))
        self.work = _WORK
        drift = as_found(tables.visits).drift
        own = max(tables.visits.own, 1e-300)
        self.weight = _OWN / own + _NAIVE / max(float(np.linalg.norm(drift)), 1e-2 * own)
        self.way = 1.0

    def allows(self, visit: Ints, option: Ints) -> bool:
        """True if an order keeps to the number of operations."""
        return bool(self.tables.lifts(visit[None], option[None])[0] <= self.most)

    def best(self, starts: list[tuple[Ints, Ints]]) -> tuple[Ints, Ints]:
        """The best order found from some starts, and from disturbed ones."""
        lengths = [float(self.tables.ways(visit[None], option[None])[1].sum()) for visit, option in starts]
        finite = [length for length in lengths if 0.0 < length < np.inf]
        self.way = min(finite, default=1.0)
        ends = [self._improved(*start) for start in starts]
        best = ends[int(np.argmin([end[2] for end in ends]))]
        for _ in range(_KICKS):
            if self.work <= 0:
                break
            found = self._improved(*self._disturbed(*best[:2]))
            best = found if found[2] < best[2] * (1.0 - 1e-9) else best
        return best[0], best[1]

    def _cost(self, visit: Ints, option: Ints) -> Floats:
        """(B,) what is minimised, of orders (B, V)."""
        seconds, length = self.tables.ways(visit, option)
        blocked = ~np.isfinite(length)
        far = np.where(blocked, 0.0, length).sum(axis=1) / self.way + 1e3 * blocked.sum(axis=1)
        return np.asarray(far + self.weight * self.tables.drifts(visit, option, np.where(blocked, 0.0, seconds)))

    def _improved(self, visit: Ints, option: Ints) -> tuple[Ints, Ints, float]:
        """An order that no single move improves, with its cost."""
        cost = float(self._cost(visit[None], option[None])[0])
        count, idle = len(visit), 0
        size = max(_BATCH // (3 * count), 1)
        queue = self.rng.permutation(len(self.moves))
        at = 0
        while idle < len(queue) and self.work > 0:
            chosen = queue[at : at + size]
            at = at + size if at + size < len(queue) else 0
            visits, options = self._neighbours(visit, option, self.moves[chosen])
            self.work -= 3 * len(chosen) * count
            idle += len(chosen)
            if not len(visits):
                continue
            costs = self._cost(visits, options)
            least = int(np.argmin(costs))
            if costs[least] < cost * (1.0 - 1e-9):
                visit, option, cost, idle = visits[least], options[least], float(costs[least]), 0
        return visit, option, cost

    def _neighbours(self, visit: Ints, option: Ints, moves: Ints) -> tuple[Ints, Ints]:
        """Orders one move away that keep to the operations: orders of readings travel along, turn round, or stay."""
        tables, count = self.tables, len(visit)
        places = moved(moves, count)
        new, carried = visit[places], option[places]
        turned = np.where(turned_round(moves, count), tables.reverse[new, carried], carried)
        stays = (tables.kind[new] == tables.kind[visit]).all(axis=1)
        visits = np.concatenate([new, new, new[stays]])
        options = np.concatenate([carried, turned, np.broadcast_to(option, new.shape)[stays]])
        kept = tables.lifts(visits, options) <= self.most
        return visits[kept], options[kept]

    def _disturbed(self, visit: Ints, option: Ints) -> tuple[Ints, Ints]:
        """Some random moves away, within the operations."""
        for _ in range(3):
            move = self.moves[self.rng.integers(len(self.moves), size=8)] if len(self.moves) else self.moves
            visits, options = self._neighbours(visit, option, move)
            if len(visits):
                pick = int(self.rng.integers(len(visits)))
                visit, option = visits[pick], options[pick]
        return visit, option
