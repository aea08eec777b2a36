"""The shortest route through groups of places of which one each is visited, by the routing solver of OR-Tools."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats, Ints

__all__ = ["short_route"]

_LARGEST = 10**12  # cost of the dearest move in the solver's whole numbers


def short_route(costs: Floats, group: Ints) -> Ints:
    """A short route that visits one place of each group (the solver's local search; no clock decides when it ends).

    Args:
        costs: (P + 1, P + 1) cost of each move, not negative; the route begins at the last place and ends anywhere.
        group: (P,) group of each place, 0 to G - 1.

    Returns:
        (G,) places in the order of visiting.
    """
    from ortools.constraint_solver import pywrapcp

    start = len(group)
    largest = np.max(costs, where=np.isfinite(costs), initial=0.0)
    whole = np.where(np.isfinite(costs), costs, 2 * largest) / max(largest, 1e-300) * (_LARGEST / (start + 1))
    whole[:, start] = 0.0
    manager = pywrapcp.RoutingIndexManager(start + 1, 1, start)
    model = pywrapcp.RoutingModel(manager)
    model.SetArcCostEvaluatorOfAllVehicles(model.RegisterTransitMatrix(np.rint(whole).astype(np.int64).tolist()))
    for one in range(int(group.max()) + 1):
        model.AddDisjunction([manager.NodeToIndex(int(place)) for place in np.flatnonzero(group == one)])
    found = model.SolveWithParameters(pywrapcp.DefaultRoutingSearchParameters())
    route, index = [], found.Value(model.NextVar(model.Start(0)))
    while not model.IsEnd(index):
        route.append(manager.IndexToNode(index))
        index = found.Value(model.NextVar(index))
    return np.array(route, dtype=np.int64)
