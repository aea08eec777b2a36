"""The routing solver of OR-Tools as a program of its own: costs and groups in, places of a route out.

It is started by `doe.routing`, never imported: OR-Tools brings a HiGHS library that does not load into a process in
which cvxpy has loaded another version of it.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict

__all__ = ["route"]


def route(costs: list[list[int]], group: list[int]) -> list[int]:
    """Places in the order of visiting, one of each group; the route begins at the last place and ends anywhere.

    Args:
        costs: (P + 1, P + 1) cost of each move, whole numbers, not negative; moves to the last place cost nothing.
        group: (P,) group of each place.
    """
    from ortools.constraint_solver import pywrapcp

    manager = pywrapcp.RoutingIndexManager(len(costs), 1, len(costs) - 1)
    model = pywrapcp.RoutingModel(manager)
    model.SetArcCostEvaluatorOfAllVehicles(model.RegisterTransitMatrix(costs))
    places: dict[int, list[int]] = defaultdict(list)
    for place, own in enumerate(group):
        places[own].append(manager.NodeToIndex(place))
    for own in sorted(places):
        model.AddDisjunction(places[own])
    found = model.SolveWithParameters(pywrapcp.DefaultRoutingSearchParameters())
    visited, index = [], found.Value(model.NextVar(model.Start(0)))
    while not model.IsEnd(index):
        visited.append(manager.IndexToNode(index))
        index = found.Value(model.NextVar(index))
    return visited


if __name__ == "__main__":
    json.dump(route(*json.load(sys.stdin)), sys.stdout)
