"""From pose to pose: how long the moves of the joints are and how long they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.errors import Infeasible, InputError
from identify.units import DEG

__all__ = ["Free", "Travel", "travel_between"]

#: ``(q_from (K, n), q_to (K, n)) -> (K,)``: True where the straight move of the joints is free.
Free = Callable[[Floats, Floats], np.ndarray]


@dataclass(frozen=True, eq=False)
class Travel:
    """Moves between V poses, and from the home pose, which stands last; without one it costs nothing to begin anywhere.

    Attributes:
        seconds: (V + 1, V + 1) time of each move; infinite where it is not possible.
        length: (V + 1, V + 1) largest move of a joint, rad, or m where it slides; infinite likewise.
        degrees: (V + 1, V + 1) largest move of a turning joint, deg.
        detour: (V + 1, V + 1) True for moves that go over the home pose.
    """

    seconds: Floats
    length: Floats
    degrees: Floats
    detour: np.ndarray

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("seconds", "length", "degrees"):
            object.__setattr__(self, key, frozen(getattr(self, key)))
        object.__setattr__(self, "detour", frozen(self.detour, bool))

    def along(self, visits: Ints) -> tuple[float, float, int]:
        """Time (s), way (deg) and number of detours of a route through poses, (V,) in the order of visiting."""
        before, after = np.append(len(self.seconds) - 1, visits[:-1]), visits
        move = (before, after)
        return float(self.seconds[move].sum()), float(self.degrees[move].sum()), int(self.detour[move].sum())

    def check(self, visits: Ints, names: tuple[str, ...], source: str) -> None:
        """Refuse a route with a move that is not possible.

        Args:
            visits: (V,) poses in the order of visiting.
            names: (V,) names of the visits in that order.
            source: What the message begins with.

        Raises:
            Infeasible: A move is blocked; the message names all of them.
        """
        steps = [("home", len(self.seconds) - 1), *zip(names, visits.tolist(), strict=True)]
        blocked = [
            f"{a} to {b}" for (a, first), (b, second) in pairwise(steps) if not np.isfinite(self.seconds[first, second])
        ]
        if blocked:
            raise Infeasible(
                f"{source}: no order of the visits avoids moves that collide: {', '.join(blocked)}; state a home pose "
                "from which all of them can be reached ([constraints] home_deg), or allow other poses"
            )


def travel_between(
    q: Floats,
    prismatic: np.ndarray,
    *,
    speed: float = np.inf,
    speed_slide: float = np.inf,
    home: Floats | None = None,
    free: Free | None = None,
) -> Travel:
    """Straight moves of the joints between poses: every joint at its speed, the slowest one counts.

    Args:
        q: (V, n) joint values, rad or m.
        prismatic: (n,) True for sliding joints.
        speed: Of turning joints, rad/s; infinite: they take no time.
        speed_slide: Of sliding joints, m/s.
        home: (n,) where the robot comes from, and where it goes around what blocks a move; None: from anywhere.
        free: Which moves are free; None: all are.

    Raises:
        InputError: ``home`` has the wrong length.
    """
    if home is not None and np.shape(home) != (q.shape[1],):
        raise InputError(f"home has shape {np.shape(home)}, needed: ({q.shape[1]},), one value a joint")
    stops = q if home is None else np.vstack([q, home])
    speeds = np.where(prismatic, speed_slide, speed)
    parts = [_farthest(stops / speeds), _farthest(stops), _farthest(stops[:, ~prismatic] / DEG)]
    detour = np.zeros(parts[0].shape, dtype=bool)
    if free is not None:
        allowed = _allowed(stops, free)
        for part in parts:
            part[~allowed] = np.inf
        if home is not None:
            over = [part[:, -1:] + part[-1:, :] for part in parts]
            detour = ~allowed & np.isfinite(over[1])
            for part, way in zip(parts, over, strict=True):
                part[detour] = way[detour]
    if home is None:
        parts = [np.pad(part, (0, 1)) for part in parts]
        detour = np.pad(detour, (0, 1))
    return Travel(parts[0], parts[1], parts[2], detour)


def _farthest(stops: Floats) -> Floats:
    """(S, S) largest difference of any joint between two stops (S, n)."""
    largest = np.zeros((len(stops), len(stops)))
    for joint in stops.T:
        np.maximum(largest, np.abs(joint[:, None] - joint), out=largest)
    return largest


def _allowed(stops: Floats, free: Free) -> np.ndarray:
    """(S, S) True where the move between two stops is free; staying always is."""
    count = len(stops)
    first, second = (index.ravel() for index in np.indices((count, count)))
    allowed = np.asarray(free(stops[first], stops[second]), dtype=bool).reshape(count, count)
    return np.asarray(allowed | (stops[:, None] == stops[None]).all(axis=2))
