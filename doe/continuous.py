"""Column generation over all poses: what is best where any pose may be measured, estimated.

The relaxed design on few columns gives sensitivities; the poses where they are largest, found by multistart ascent
(`doe.ascent`), become columns, and again. By the certificate of `doe.criteria` the relaxed optimum over all poses is
at least ``numerator / max_x d(x)``. The largest d of all poses is only searched for, so this is an estimate and no
proof; it stands when starts that had no part in it find nothing any more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from doe.ascent import Region, ascend
from doe.blocks import Blocks
from doe.column_generation import Found, best_weights
from doe.executor import HERE, Executor
from doe.problem import Problem, make_problem
from identify.arrays import Floats, Ints, frozen
from identify.threads import one_thread

__all__ = ["Columns", "Sample", "continuous_columns"]

KEPT = 300  # candidates beside those of the relaxed design
STARTS = 60  # of one round, beside the poses of the design itself
FRESH = 150  # of the last word
ROUNDS = 25
PASSES = 20  # for the design on the columns; where its optimum is singular it would need many more
STALLED = 5  # rounds that have to lower the value
QUICK, THOROUGH = 12, 30  # steps of an ascent
HOPEFUL = 0.8  # of the largest sensitivity: starts that reach this in a few steps go on
CLOSED = 1e-4  # relative gap at which the last word is asked for
TOGETHER = 50  # starts that climb together, at most
SAME, NEAR = 1e-3, 0.1  # of the scale: new columns in one such cell are one; columns that are one start


@dataclass(frozen=True, eq=False)
class Sample:
    """Experiments with their blocks.

    Attributes:
        x: (m, d) what varies continuously.
        choice: (m,) what does not.
        blocks: (m, k, p) whitened rows.
    """

    x: Floats
    choice: Ints
    blocks: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only; blocks may be large and stay as they are."""
        object.__setattr__(self, "x", frozen(self.x))
        object.__setattr__(self, "choice", frozen(self.choice, np.int64))

    def take(self, index: Ints) -> Sample:
        """Some of them."""
        return Sample(self.x[index], self.choice[index], self.blocks[index])

    def plus(self, other: Sample) -> Sample:
        """Both."""
        return Sample(
            np.concatenate([self.x, other.x]),
            np.concatenate([self.choice, other.choice]),
            np.concatenate([self.blocks, other.blocks]),
        )


@dataclass(frozen=True, eq=False)
class Columns:
    """What column generation over all poses found.

    Attributes:
        found: The columns of the last round, those of the relaxed design among them.
        value: The criterion of the relaxed design on them, for one experiment.
        bound: Estimate of the best that any weights on any poses reach; not proven.
        factor: (p, q) R of the sensitivities ``|A R|^2`` of the last round.
        rounds: Rounds of ascent.
    """

    found: Sample
    value: float
    bound: float
    factor: Floats
    rounds: int

    @property
    def gap(self) -> float:
        """Share of the value by which the largest sensitivity found says that it could still fall."""
        return 1.0 - self.bound / self.value

    def sensitivities(self, blocks: Floats) -> Floats:
        """(N,) sensitivities of blocks (N, k, p)."""
        return Blocks(blocks).sensitivities(self.factor)


def continuous_columns(
    region: Region,
    grid: Sample,
    target: Floats | None,
    criterion: str,
    rng: np.random.Generator,
    *,
    prior: Floats | None = None,
    tol: float = CLOSED,
    executor: Executor = HERE,
) -> Columns:
    """Find the best relaxed design over all poses, starting from that of a grid.

    Args:
        region: What may be measured.
        grid: Candidates; all may be measured.
        target: As for `doe.approximate.approximate_design`.
        criterion: test_pose, A, D, E or G.
        rng: Chooses starts.
        prior: (p, p) information that is there already, on the scale of one experiment, or None.
        tol: Relative gap at which the search may end.
        executor: Who climbs, some starts at a time.

    Raises:
        NotIdentifiable: The candidates cannot show what the criterion needs.
    """
    with one_thread():
        search = _Search(region, grid, target, criterion, rng, prior, executor)
        return search.run(tol)


class _Search:
    """State of the column generation.

    Attributes:
        columns: The present columns.
        value: Of the relaxed design on them.
        bound: Estimate by the last round.
    """

    def __init__(
        self,
        region: Region,
        grid: Sample,
        target: Floats | None,
        criterion: str,
        rng: np.random.Generator,
        prior: Floats | None,
        executor: Executor,
    ) -> None:
        self.region, self.grid, self.target, self.criterion, self.rng = region, grid, target, criterion, rng
        self.prior, self.executor = prior, executor
        problem = make_problem(grid.blocks, target, criterion, None, prior, None)
        found = best_weights(problem, 1e-4)
        self.order = np.argsort(-found.d, kind="stable")
        used = np.flatnonzero(found.u > 0.0)
        self.columns = grid.take(np.union1d(used, self.order[:KEPT]))
        self.value, self.bound = found.certificate.value, 0.9 * found.certificate.value

    def run(self, tol: float) -> Columns:
        """Rounds until fresh starts find nothing any more."""
        asked, values = False, []  # asked: for the last word
        for rounds in range(1, ROUNDS + 1):
            gap = 1.0 - self.bound / self.value
            problem, found = self._relaxed(min(1e-4, max(0.02 * gap, 0.02 * tol)))
            values.append(found.certificate.value)
            stalled = len(values) > STALLED and values[-1] > values[-1 - STALLED] * (1.0 - 0.2 * tol)
            stalled = stalled or found.gap > tol
            asked = asked or stalled or rounds == ROUNDS
            starts = self._starts(found, FRESH if asked else STARTS)
            factor = problem.space.basis @ found.certificate.factor
            x, d = self._climbed(factor, starts, found, thorough=asked)
            largest = max(
                float(d.max()), float(found.d.max()), float(Blocks(self.grid.blocks).sensitivities(factor).max())
            )
            self.value = found.certificate.value
            self.bound = found.certificate.numerator / (largest + problem.fixed(found.certificate))
            closed = 1.0 - self.bound / self.value <= tol
            if asked and (closed or stalled):
                break
            asked = closed
            self._enlarge(problem, found, x, starts.choice, d)
        return Columns(self.columns, self.value, min(self.bound, self.value), factor, rounds)

    def _relaxed(self, tol: float) -> tuple[Problem, Found]:
        """The relaxed design on the present columns."""
        problem = make_problem(self.columns.blocks, self.target, self.criterion, None, self.prior, None)
        return problem, best_weights(problem, tol, PASSES)

    def _starts(self, found: Found, count: int) -> Sample:
        """The poses of the design, the best and some other candidates."""
        used = np.flatnonzero(found.u > 1e-6)
        used = used[np.argsort(-found.u[used], kind="stable")]
        used = used[self._distinct(self.columns.x[used], self.columns.choice[used], NEAR)][:count]
        own = self.columns.take(used)
        near = self.order[: max(count, len(self.order) // 20)]
        good = self.rng.choice(near, min(count // 2, len(near)), replace=False)
        others = self.rng.choice(len(self.order), min(count - count // 2, len(self.order)), replace=False)
        return own.plus(self.grid.take(np.union1d(good, others)))

    def _climbed(self, factor: Floats, starts: Sample, found: Found, *, thorough: bool) -> tuple[Floats, Floats]:
        """Where some steps of ascent lead, (m, d) and (m,); ``thorough``: those that may get far go on."""
        x, d = self._ascended(factor, starts.x, starts.choice, QUICK)
        if thorough:
            on = np.flatnonzero(d > HOPEFUL * found.d.max())
            x[on], d[on] = self._ascended(factor, x[on], starts.choice[on], THOROUGH)
        return x, d

    def _ascended(self, factor: Floats, x: Floats, choice: Ints, steps: int) -> tuple[Floats, Floats]:
        """`ascend`, some starts at a time."""
        pieces = 2 * -(-len(x) // (2 * TOGETHER))  # an even number, all of about one size
        parts = np.array_split(np.arange(len(x)), max(pieces, 1))
        work = partial(_climb, self.region, factor, steps)
        ended = list(self.executor.map(work, [(x[part], choice[part]) for part in parts]))
        return np.concatenate([x[:0], *(each[0] for each in ended)]), np.concatenate([[], *(each[1] for each in ended)])

    def _enlarge(self, problem: Problem, found: Found, x: Floats, choice: Ints, d: Floats) -> None:
        """Add what would improve the design, and drop what has no part in it."""
        level = found.certificate.numerator / found.certificate.value - problem.fixed(found.certificate)
        hopeful = np.flatnonzero(d > level * (1.0 + 1e-7))
        hopeful = hopeful[np.argsort(-d[hopeful], kind="stable")]
        hopeful = hopeful[self._distinct(x[hopeful], choice[hopeful], SAME)]
        used = np.flatnonzero(found.u > 1e-9)
        rest = np.setdiff1d(np.argsort(-found.d, kind="stable")[: len(used) + KEPT], used)[:KEPT]
        kept = self.columns.take(np.concatenate([used, rest]))
        if len(hopeful):
            new = Sample(x[hopeful], choice[hopeful], self.region.blocks(x[hopeful], choice[hopeful]))
            kept = kept.plus(new)
        self.columns = kept

    def _distinct(self, x: Floats, choice: Ints, apart: float) -> Ints:
        """The first of each group of points in one cell of ``apart`` times the scale."""
        scale = np.where(self.region.scale > 0.0, self.region.scale, 1.0)
        keys = np.column_stack([np.rint(x / (apart * scale)), choice])
        return np.sort(np.unique(keys, axis=0, return_index=True)[1])


def _climb(region: Region, factor: Floats, steps: int, starts: tuple[Floats, Ints]) -> tuple[Floats, Floats]:
    """`ascend` from some starts (points and choices)."""
    return ascend(region, factor, *starts, steps=steps)
