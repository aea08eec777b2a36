"""Candidate visits: feasible poses from a scrambled Sobol sequence, each with every choice of loads.

A joint that can turn more than once is sampled over one turn around the middle of its range: other turns give the
same poses. Joint values are rounded to what a plan file holds before they are checked, so plan and evaluation agree.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from types import MappingProxyType

import numpy as np

from doe.blame import REMEDIES, blame
from doe.executor import HERE, Executor
from doe.feasible import FEASIBLE, Screen, count_reasons, joint_range, screen
from identify.arrays import Floats, Ints, frozen
from identify.errors import Infeasible, InputError
from identify.model import effects_of
from identify.study import Study

__all__ = ["Candidates", "candidates", "load_choices", "rounded", "sampled_range", "stops_of"]

_log = logging.getLogger("elastocal")

_STEPS = 1e6  # steps a deg or mm: the six decimals of plan.csv
_BATCH = 4096  # most poses of one batch, a power of two
_GROUPED, _GROUPS = 16, 8  # batches of one piece of work, and pieces that are given away at a time
_CELLS = 2**22  # most pose-load pairs of one batch
_DRAWS = 64  # poses drawn for each one wanted before the search gives up
_FEWEST = 1024  # wanted poses that the search is made for at least
_MOST_CHOICES = 100_000  # choices of loads at one pose
_BLAMED = 512  # poses that tell which constraint is to blame


@dataclass(frozen=True, eq=False)
class Candidates:
    """N candidate visits at P poses.

    Attributes:
        q: (P, n) joint values of the poses, rad or m; every pose has at least one candidate.
        pose: (N,) pose of each candidate; candidates of one pose stand together.
        visit_loads: (N, L) loads of each candidate in the order of reading, the unloaded state first where it is read.
        drawn: Candidates looked at: N and the rejected ones.
        rejected: Number of rejected candidates by the first reason against them.
        unchecked: Pairs of links, or of load and link, that touch in every pose and were not checked, by name.
    """

    q: Floats
    pose: Ints
    visit_loads: Ints
    drawn: int
    rejected: Mapping[str, int]
    unchecked: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays and the counts read-only."""
        object.__setattr__(self, "q", frozen(self.q))
        object.__setattr__(self, "pose", frozen(self.pose, np.int64))
        object.__setattr__(self, "visit_loads", frozen(self.visit_loads, np.int64))
        object.__setattr__(self, "rejected", MappingProxyType(dict(self.rejected)))

    def __len__(self) -> int:
        """Number of candidates N."""
        return len(self.pose)

    @property
    def visit_q(self) -> Floats:
        """(N, n) joint values of each candidate."""
        q: Floats = self.q[self.pose]
        return q


def candidates(study: Study, *, seed: int, warn: bool = True, executor: Executor = HERE) -> Candidates:
    """Draw the candidates of a study: at most ``plan.candidates``, but all choices of loads of at least one pose.

    Poses come from one scrambled Sobol sequence, so the same seed gives the same candidates, and more candidates
    continue fewer ones. The search stops after 64 poses for each one wanted (65,536 at least).

    Args:
        study: The study.
        seed: Seed of the scrambling.
        warn: Say where fewer than wanted were found, and what is not checked.
        executor: Who checks the drawn poses, in pieces.

    Raises:
        InputError: A joint has no limits or no range, or the loads do not allow what the plan asks for.
        Infeasible: No pose was found; the message counts the reasons.
    """
    choices = load_choices(study)
    lower, upper = sampled_range(study)
    tests = screen(study)
    if warn and tests.gaps.always:
        _log.warning(
            "%s: these touch in every pose and are not checked against each other: %s",
            study.path, "; ".join(tests.gaps.always),
        )  # fmt: skip
    poses = max(study.plan.candidates // len(choices), 1)
    found = _search(tests, choices, (lower, upper), poses, seed, executor)
    if not len(found):
        culprit = blame(tests, _draws(study, (lower, upper), seed)(_BLAMED), choices)
        raise Infeasible(
            f"{study.path}: none of {found.drawn} drawn candidates may be measured: {_why(found)}. Each constraint on "
            f"its own: {culprit}"
        )
    if warn and len(found) < poses * len(choices) and found.drawn >= _most(poses) * len(choices):
        _log.warning(
            "%s: only %d of %d candidates found among %d drawn: %s",
            study.path, len(found), poses * len(choices), found.drawn, _why(found),
        )  # fmt: skip
    return found


def rounded(study: Study, q: Floats) -> Floats:
    """Joint values as a plan file holds them: to 1e-6 deg or mm, moved inside the limits less the margin.

    Args:
        study: The study.
        q: (..., n) joint values, rad or m.

    Returns:
        (..., n) rad or m, exactly what is read back from ``plan.csv``.
    """
    unit = study.joint_units
    lower, upper = (limit / unit * _STEPS for limit in joint_range(study))
    first, last = np.ceil(lower - 1e-3), np.floor(upper + 1e-3)  # 1e-3 steps: rounding noise of the conversion
    steps = np.minimum(np.maximum(np.rint(q / unit * _STEPS), first), last)
    return np.asarray((steps / _STEPS + 0.0) * unit)


def sampled_range(study: Study) -> tuple[Floats, Floats]:
    """(n,) lower and (n,) upper ends of sampling, rad or m: limits less margin, at most one turn around their middle.

    A continuous joint is sampled over one turn around zero.

    Raises:
        InputError: A joint has no limits, or the margin leaves it no range.
    """
    robot, (lower, upper) = study.robot, joint_range(study)
    lower, upper = (np.where(robot.continuous, turn, end) for turn, end in ((-np.pi, lower), (np.pi, upper)))
    file = study.inputs[-1] if study.inputs else study.path
    unlimited = ~(np.isfinite(lower) & np.isfinite(upper))
    if unlimited.any():
        names = ", ".join(name for name, none in zip(robot.joints, unlimited, strict=True) if none)
        raise InputError(
            f"{file}: no limits are stated of joint {names} of {robot.name}, so no poses can be drawn. State a lower "
            "and an upper limit of each in the robot file (lower_deg and upper_deg, or lower_mm and upper_mm where it "
            "slides; <limit lower upper> in a URDF), or give it the type continuous if it turns without end"
        )
    if not (lower < upper).all():
        names = ", ".join(name for name, none in zip(robot.joints, ~(lower < upper), strict=True) if none)
        raise InputError(f"{study.path}: [constraints] joint margin leaves no range to joint {names}; make it smaller")
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    half = np.where(robot.prismatic, half, np.minimum(half, np.pi))
    return middle - half, middle + half


def load_choices(study: Study) -> Ints:
    """Every choice of loads of one visit, in the order of reading.

    The choices are all sets of ``loads_per_pose`` loads out of ``plan.loads`` (default: the loads that load the
    robot), in this order, with the unloaded state in front if the visit reads it. Without any loaded
    load the unloaded state alone is read.

    Returns:
        (C, L) indices of loads.

    Raises:
        InputError: The unloaded state is needed and missing, or there are too few loads or too many choices.
    """
    plan, loads = study.plan, study.loads
    unloaded = [i for i, load in enumerate(loads) if load.unloaded]
    named = [study.load_index(name) for name in plan.loads]
    if plan.reference_rows or not named:
        named = [i for i in named or range(len(loads)) if i not in unloaded]
    if not unloaded and (plan.reference_rows or not named):
        raise InputError(
            f"{study.path}: [plan] reference_rows = true reads the unloaded state at each pose, but every load loads "
            "the robot; add a load of 0 kg under [[loads]] or set reference_rows = false"
        )
    if not named:
        return np.array([unloaded[:1]], dtype=np.int64)
    if not 1 <= plan.loads_per_pose <= len(named):
        raise InputError(
            f"{study.path}: [plan] loads_per_pose = {plan.loads_per_pose}, allowed are 1 to {len(named)}: "
            f"the loads to choose from are {', '.join(loads[i].name for i in named)}"
        )
    if (count := math.comb(len(named), plan.loads_per_pose)) > _MOST_CHOICES:
        raise InputError(
            f"{study.path}: [plan] loads_per_pose = {plan.loads_per_pose} of {len(named)} loads makes {count} choices "
            f"at each pose, at most {_MOST_CHOICES} are possible; name fewer loads in [plan] loads"
        )
    front = unloaded[:1] if plan.reference_rows else []
    return np.array([[*front, *chosen] for chosen in combinations(named, plan.loads_per_pose)], dtype=np.int64)


def _search(
    tests: Screen, choices: Ints, ends: tuple[Floats, Floats], poses: int, seed: int, executor: Executor
) -> Candidates:
    """Draw poses until there are enough candidates or the search has to stop."""
    study, draw = tests.study, _draws(tests.study, ends, seed)
    parts: list[tuple[Floats, Ints, Ints]] = []
    rejected: Counter[str] = Counter()
    drawn, stood, room, enough = 0, 0, max(study.plan.candidates, 1), False
    batches = _checked(tests, draw, _batches(poses, choices), executor)
    while not enough and drawn < _most(poses):
        q, by_load = next(batches)
        codes = by_load[:, choices].min(axis=2)
        taken, enough = _taken((codes == FEASIBLE).sum(axis=1), room, stood == 0)
        pose, choice = np.nonzero(codes[:taken] == FEASIBLE)
        used, place = np.unique(pose, return_inverse=True)
        parts.append((q[used], stood + place, choice))
        rejected.update(count_reasons(codes[:taken]))
        drawn, stood, room = drawn + taken, stood + len(used), room - len(choice)
    kept_q, pose, choice = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Candidates(kept_q, pose, choices[choice], drawn * len(choices), rejected, tests.gaps.always)


def _batches(poses: int, choices: Ints) -> Iterator[int]:
    """Numbers of poses that are drawn at a time, without end."""
    largest = min(_BATCH, _power_of_two(max(_CELLS // choices.size, 1)))
    batch = min(_power_of_two(poses), largest)
    while True:
        yield batch
        batch = min(2 * batch, largest)


def _checked(
    tests: Screen, draw: Callable[[int], Floats], sizes: Iterator[int], executor: Executor
) -> Iterator[tuple[Floats, np.ndarray]]:
    """Batches of poses and their codes (B, loads); the first few by themselves, later ones many at a time."""
    for _ in range(_GROUPED):
        q = draw(next(sizes))
        yield q, tests.codes(q)
    while True:
        groups = [[draw(next(sizes)) for _ in range(_GROUPED)] for _ in range(_GROUPS)]
        for group, codes in zip(groups, executor.map(partial(_codes, tests), groups), strict=True):
            yield from zip(group, codes, strict=True)


def _codes(tests: Screen, batches: list[Floats]) -> list[np.ndarray]:
    """Codes (B, loads) of several batches."""
    return [tests.codes(q) for q in batches]


def _draws(study: Study, ends: tuple[Floats, Floats], seed: int) -> Callable[[int], Floats]:
    """The next (B, n) poses of the sequence, as a plan file holds them, for a number B."""
    from scipy.stats import qmc

    (lower, upper), stops = ends, stops_of(study)
    sequence = qmc.Sobol(study.robot.n, scramble=True, seed=np.random.default_rng(seed))

    def draw(count: int) -> Floats:
        share = sequence.random(count)
        q = lower + (upper - lower) * share
        for joint, values in stops.items():
            q[:, joint] = values[(share[:, joint] * len(values)).astype(np.int64)]
        return rounded(study, q)

    return draw


def stops_of(study: Study) -> dict[int, Floats]:
    """Joints that stop at certain values (rad or m) only, because an effect of the study is defined there alone."""
    return {joint: values for effect in effects_of(study, study.effects) for joint, values in effect.stops.items()}


def _taken(feasible: Ints, room: int, first: bool) -> tuple[int, bool]:
    """How many poses of a batch are taken, and whether that is the end.

    Args:
        feasible: (B,) feasible candidates of each pose.
        room: Candidates still wanted.
        first: No candidate has been found yet; then the first pose is taken even if it alone exceeds the room.
    """
    total = np.cumsum(feasible)
    last = int(np.searchsorted(total, room))
    if last == len(total):
        return last, False
    alone = first and total[last] == feasible[last]
    return (last + 1 if total[last] == room or alone else last), True


def _most(poses: int) -> int:
    """Poses that are drawn at most."""
    return _DRAWS * max(poses, _FEWEST)


def _power_of_two(count: int) -> int:
    """The smallest power of two that is not below ``count``."""
    return 1 << (count - 1).bit_length()


def _why(found: Candidates) -> str:
    """The reasons of the rejected, most frequent first, and what would help."""
    reasons = sorted((r for r, n in found.rejected.items() if n), key=lambda r: -found.rejected[r])
    counts = ", ".join(f"{reason} rejected {found.rejected[reason]}" for reason in reasons)
    return f"{counts}. What helps, in [constraints] or [[loads]]: {'; '.join(REMEDIES[r] for r in reasons)}"
