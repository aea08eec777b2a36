"""From pose to pose: how long the moves of the joints are and how long they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.errors import Infeasible, InputError
from identify.units import DEG

__all__ = ["Blocked", "Free", "Travel", "travel_between"]

#: ``(q_from (K, n), q_to (K, n), loads (K,) or None) -> (K,)``: True where the straight move of the joints is free, in
#: both directions, with this load hung on the way; None: with nothing hung.
Free = Callable[[Floats, Floats, Ints | None], np.ndarray]


_TESTED = 2500  # moves between poses; of more, the long ones go over home untested


class Blocked(Infeasible):
    """Moves between the visits of a plan, which may do with other poses, collide in every order.

    Attributes:
        count: Experiments of that plan.
        value: The criterion that it would have reached; None where it is not known.
    """

    count: int = 0
    value: float | None = None


@dataclass(frozen=True, eq=False)
class Travel:
    """Moves between V poses, and from the home pose, which stands last; without one it costs nothing to begin anywhere.

    The first axis is what hangs on the way: each load, and in the last place nothing; a single place stands for all.

    Attributes:
        seconds: (H, V + 1, V + 1) time of each move; infinite where it is not possible.
        length: (H, V + 1, V + 1) largest move of a joint, rad, or m where it slides; infinite likewise.
        degrees: (H, V + 1, V + 1) largest move of a turning joint, deg.
        detour: (H, V + 1, V + 1) True for moves that go over the home pose.
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

    def move(self, hung: Ints, before: Ints, after: Ints) -> tuple[Ints | int, Ints, Ints]:
        """Index of moves into the arrays: ``hung`` is a load, or `doe.lifts.NOTHING`."""
        return (hung if len(self.seconds) > 1 else 0), before, after

    @cached_property
    def alone(self) -> np.ndarray | None:
        """(H, V + 1, V + 1) True where a load cannot go along, but the bare arm can go; None if this is nowhere."""
        possible = np.isfinite(self.length)
        alone = possible[-1] & ~possible
        return alone if alone.any() else None

    def along(self, visits: Ints, hung: Ints) -> tuple[float, float, int]:
        """Time (s), way (deg) and number of detours of a route.

        Args:
            visits: (V,) poses in the order of visiting.
            hung: (V,) what hangs on the way to each of them.
        """
        move = self.move(hung, np.append(self.seconds.shape[1] - 1, visits[:-1]), visits)
        return float(self.seconds[move].sum()), float(self.degrees[move].sum()), int(self.detour[move].sum())

    def blocked(self, visits: Ints, hung: Ints) -> Ints:
        """Places in a route, from 0, that there is no way to from the one before.

        Args:
            visits: (V,) poses in the order of visiting.
            hung: (V,) what hangs on the way to each of them.
        """
        move = self.move(hung, np.append(self.seconds.shape[1] - 1, visits[:-1]), visits)
        return np.flatnonzero(~np.isfinite(self.length[move]))

    def check(self, visits: Ints, hung: Ints, names: tuple[str, ...], source: str) -> None:
        """Refuse a route with a move that is not possible.

        Args:
            visits: (V,) poses in the order of visiting.
            hung: (V,) what hangs on the way to each of them.
            names: (V,) names of the visits in that order.
            source: What the message begins with.

        Raises:
            Blocked: A move is not possible; the message names all of them.
        """
        stops = ("home", *names)
        blocked = [f"{stops[place]} to {stops[place + 1]}" for place in self.blocked(visits, hung)]
        if blocked:
            raise Blocked(
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
    hung: np.ndarray | None = None,
) -> Travel:
    """Straight moves of the joints between poses: every joint at its speed, the slowest one counts.

    Args:
        q: (V, n) joint values, rad or m.
        prismatic: (n,) True for sliding joints.
        speed: Of turning joints, rad/s; infinite: they take no time.
        speed_slide: Of sliding joints, m/s.
        home: (n,) where the robot comes from, and where it goes around what blocks a move; None: from anywhere.
        free: Which moves are free; None: all are.
        hung: (loads,) True for loads that may hang on the way; None: nothing ever does.

    Raises:
        InputError: ``home`` has the wrong length.
    """
    if home is not None and np.shape(home) != (q.shape[1],):
        raise InputError(f"home has shape {np.shape(home)}, needed: ({q.shape[1]},), one value a joint")
    stops = q if home is None else np.vstack([q, home])
    speeds = np.where(prismatic, speed_slide, speed)
    parts = [_farthest(stops / speeds), _farthest(stops), _farthest(stops[:, ~prismatic] / DEG)]
    over_home = home is not None
    if free is None:
        layers = [(*parts, np.zeros(parts[0].shape, dtype=bool))]
    else:
        bare = _allowed(stops, None, free, _worth_testing(stops, over_home=over_home))
        loaded = [] if hung is None else [
            _allowed(stops, load, free, bare) if used else bare for load, used in enumerate(hung)
        ]  # fmt: skip
        layers = [_ways(parts, allowed, over_home=over_home) for allowed in (*loaded, bare)]
    stacked = [np.stack(each) for each in zip(*layers, strict=True)]
    if home is None:
        stacked = [np.pad(each, ((0, 0), (0, 1), (0, 1))) for each in stacked]
    return Travel(*stacked)


def _farthest(stops: Floats) -> Floats:
    """(S, S) largest difference of any joint between two stops (S, n)."""
    largest = np.zeros((len(stops), len(stops)))
    for joint in stops.T:
        np.maximum(largest, np.abs(joint[:, None] - joint), out=largest)
    return largest


def _ways(parts: list[Floats], allowed: np.ndarray, *, over_home: bool) -> tuple[np.ndarray, ...]:
    """Moves with one load: ``parts`` (S, S), infinite where none is ``allowed``; and which of them go over home."""
    straight = [np.where(allowed, part, np.inf) for part in parts]
    if not over_home:
        return (*straight, np.zeros_like(allowed))
    over = [part[:, -1:] + part[-1:, :] for part in straight]
    detour = ~allowed & np.isfinite(over[1])
    return (*(np.where(detour, way, part) for part, way in zip(straight, over, strict=True)), detour)


def _worth_testing(stops: Floats, *, over_home: bool) -> np.ndarray:
    """(S, S) True for moves that are tested: all of them, or, with a home to go over, those to it and the shortest."""
    tested = np.ones((len(stops), len(stops)), dtype=bool)
    distinct = np.unique(stops, axis=0)
    if not over_home or len(distinct) * (len(distinct) - 1) // 2 <= _TESTED:
        return tested
    between = _farthest(distinct)[np.triu_indices(len(distinct), 1)]
    tested = np.asarray(_farthest(stops) <= np.partition(between, _TESTED)[_TESTED])
    tested[-1], tested[:, -1] = True, True
    return tested


def _allowed(stops: Floats, load: int | None, free: Free, among: np.ndarray) -> np.ndarray:
    """(S, S) True where the straight move between two stops is free with a load; staying always is.

    Only moves ``among`` (S, S) may be: with a load those that the bare arm can make. Stops that are the same pose
    share their moves.
    """
    distinct, place = np.unique(stops, axis=0, return_inverse=True)
    place, possible = place.ravel(), np.zeros((len(distinct), len(distinct)), dtype=bool)
    np.logical_or.at(possible, (place[:, None], place), among)
    first, second = np.nonzero(np.triu(possible | possible.T, 1))
    allowed = np.eye(len(distinct), dtype=bool)
    hung = None if load is None else np.full(len(first), load)
    allowed[first, second] = np.asarray(free(distinct[first], distinct[second], hung), dtype=bool)
    both: np.ndarray = (allowed | allowed.T)[place][:, place]
    return both
