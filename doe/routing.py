"""The shortest route through groups of places of which one each is visited, by the routing solver of OR-Tools.

The solver runs in a process of its own, see `doe.routing_solver`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from identify.arrays import Floats, Ints

__all__ = ["short_route"]

_SOLVER = Path(__file__).with_name("routing_solver.py")
_LARGEST = 10**12  # cost of the dearest move in the solver's whole numbers


def short_route(costs: Floats, group: Ints) -> Ints:
    """A short route that visits one place of each group (the solver's local search; no clock decides when it ends).

    Args:
        costs: (P + 1, P + 1) cost of each move, not negative; the route begins at the last place and ends anywhere.
        group: (P,) group of each place, 0 to G - 1.

    Returns:
        (G,) places in the order of visiting.
    """
    start = len(group)
    largest = np.max(costs, where=np.isfinite(costs), initial=0.0)
    whole = np.where(np.isfinite(costs), costs, 2 * largest) / max(largest, 1e-300) * (_LARGEST / (start + 1))
    whole[:, start] = 0.0
    task = json.dumps([np.rint(whole).astype(np.int64).tolist(), group.tolist()])
    program = [sys.executable, "-P", str(_SOLVER)]
    done = subprocess.run(program, input=task, capture_output=True, check=True, text=True)
    return np.array(json.loads(done.stdout), dtype=np.int64)
