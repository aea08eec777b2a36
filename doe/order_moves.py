"""Single moves on an order of visits: two swap, a stretch turns round, or rotates, or its readings alone turn round."""

from __future__ import annotations

import numpy as np

from identify.arrays import Ints

__all__ = ["moved", "moves_of", "turned_round"]

_WINDOW = 20_000  # moves of each kind of a long plan
_SWAP, _REVERSE, _TURN, _ROTATE = 0, 1, 2, 3
_SHIFTS = (1, 2, 3, -1, -2, -3)


def moves_of(count: int) -> Ints:
    """(M, 4) moves on an order of ``count`` visits: what, from place, to place, by how many."""
    window = max(min(count, _WINDOW // max(count, 1)), 1)
    first, last = (index.ravel() for index in np.indices((count, count)))
    near = (last >= first) & (last - first <= window)
    first, last = first[near], last[near]
    apart = last > first
    parts = [_table(_TURN, first, last, 0)]
    for what, shift in ((_SWAP, 0), (_REVERSE, 0), *((_ROTATE, shift) for shift in _SHIFTS)):
        long_enough = apart & (last - first >= max(abs(shift), 1)) & ((what != _REVERSE) | (last - first > 1))
        parts.append(_table(what, first[long_enough], last[long_enough], shift))
    return np.concatenate(parts)


def _table(what: int, first: Ints, last: Ints, shift: int) -> Ints:
    """Moves of one kind."""
    return np.column_stack([np.full_like(first, what), first, last, np.full_like(first, shift)])


def turned_round(moves: Ints, count: int) -> np.ndarray:
    """(M, V) True for places where the readings of a visit turn round if its stretch does."""
    return np.asarray(_within(moves, count) & (moves[:, :1] != _SWAP))


def _within(moves: Ints, count: int) -> np.ndarray:
    """(M, V) True for places in the range of a move."""
    place = np.arange(count)
    return np.asarray((place >= moves[:, 1:2]) & (place <= moves[:, 2:3]))


def moved(moves: Ints, count: int) -> Ints:
    """(M, V) which place of the old order stands at each place of the new one."""
    place = np.broadcast_to(np.arange(count), (len(moves), count))
    what, first, last, shift = (moves[:, i : i + 1] for i in range(4))
    inside = _within(moves, count)
    swapped = np.where(place == first, last, np.where(place == last, first, place))
    reversed_ = np.where(inside, first + last - place, place)
    rotated = np.where(inside, first + (place - first + shift) % (last - first + 1), place)
    return np.select([what == _SWAP, what == _REVERSE, what == _ROTATE], [swapped, reversed_, rotated], place)
