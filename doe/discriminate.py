"""The public verb `next_poses`: the visits that tell a named cause from its rivals."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from doe.contest import Contest, contest
from doe.next_visits import named_visits, possible_visits
from doe.remedies import remedy
from identify.arrays import Floats, Ints
from identify.diagnosis.library import Hypothesis, columns_of, hypotheses
from identify.diagnosis.search import Cause, carried, with_causes
from identify.diagnosis.verdict import Diagnosis
from identify.errors import Infeasible, InputError
from identify.experiment import Experiment
from identify.model import Model, model_of
from identify.noise import whitening
from identify.response import respond
from identify.study import Study
from identify.threads import one_thread

__all__ = ["NextPoses", "Separation", "choose", "contests", "next_poses"]

_MOST = 768  # visits to choose from
_CELLS = 2**21  # numbers in their normal matrices
_BEST = 200  # visits that are tried together before a pair is called inseparable
_SHORTLIST = 100  # visits that exchanges look at
_SWEEPS = 4
_VARIANTS = 3  # causes that are tried with more options than this are taken with those found


@dataclass(frozen=True)
class Separation:
    """How well a cause can be told from a rival; energies are chi-squares, the smaller of either being true.

    Attributes:
        cause: The cause, ``name`` or ``name@where``.
        rival: Its rival.
        now: Energy of the readings.
        then: Energy expected with the next poses; None if there are none.
        needed: Energy with which a test at 0.1 % tells them apart in nine of ten cases.
        separable: Some visits reach what is needed; None if no visits could be drawn.
        exact: Their columns coincide in all of them.
        advice: What to do where poses do not help, or beside them.
    """

    cause: str
    rival: str
    now: float
    then: float | None
    needed: float
    separable: bool | None
    exact: bool
    advice: str | None


@dataclass(frozen=True, eq=False)
class NextPoses:
    """What to measure next.

    Attributes:
        experiment: The visits to add; None if nothing is ambiguous or no visits help.
        separations: Every cause against every rival.
        notes: What the user should know.
    """

    experiment: Experiment | None
    separations: tuple[Separation, ...]
    notes: tuple[str, ...] = ()


def next_poses(study: Study, found: Diagnosis, *, count: int = 4, seed: int = 0) -> NextPoses:
    """Visits that, added to the readings, tell the causes of a diagnosis from their rivals (T-optimal).

    Args:
        study: The study, with the constraints that poses keep to.
        found: Its diagnosis.
        count: Number of visits.
        seed: Seed of the candidates.

    Raises:
        InputError: ``count`` is not positive.
    """
    if count < 1:
        raise InputError(f"count = {count}: at least one pose can be measured next")
    unclear = [cause for cause in found.causes if cause.rivals]
    if not unclear:
        return NextPoses(None, ())
    measured = found.clean.experiment
    asked = tuple(h for cause in unclear for h in (cause.hypothesis, *cause.rivals))
    extended = replace(found.extended_study, constraints=study.constraints)
    with one_thread():
        try:
            possible = possible_visits(extended, found.data.experiment, asked, most=_most(found, asked), seed=seed)
        except (InputError, Infeasible) as error:
            unknown = contests(found, measured)
            return NextPoses(None, _judged(unknown, None, None), (f"no next poses: {error}",))
        held = contests(found, measured, possible)
        return _planned(held, possible, found.data.experiment, count)


def _most(found: Diagnosis, asked: tuple[Hypothesis, ...]) -> int:
    """Visits to choose from: fewer where there are many columns."""
    columns = len(found.search.last.model.parameters) + sum(len(hypothesis.own) for hypothesis in asked)
    return max(min(_MOST, _CELLS // columns**2), 64)


def _planned(held: tuple[Contest, ...], possible: Experiment, measured: Experiment, count: int) -> NextPoses:
    """Choose visits for the pairs that can be told apart."""
    able = separable(held)
    if not any(pairs[0].any() for pairs in able):
        return NextPoses(None, _judged(held, able, None))
    chosen = choose(held, count, able)
    experiment = named_visits(possible, chosen, measured)
    return NextPoses(experiment, _judged(held, able, chosen), _notes(experiment))


def _notes(experiment: Experiment) -> tuple[str, ...]:
    """What the columns of the plan ask for."""
    notes: tuple[str, ...] = ()
    if experiment.approach is not None:
        notes += ("come to each of the next poses from the side that its approach columns say",)
    if experiment.wrench is not None:
        notes += ("pull at the next poses about as the wrench columns say, and measure what acts",)
    return notes


# ---- from a diagnosis to normal matrices


def contests(found: Diagnosis, measured: Experiment, possible: Experiment | None = None) -> tuple[Contest, ...]:
    """Every cause that has rivals, with the normal matrices of readings and possible visits.

    Args:
        found: The diagnosis.
        measured: The rows that were measured.
        possible: Visits of equal layout that could be.
    """
    return tuple(_contest(found, cause, measured, possible) for cause in found.causes if cause.rivals)


def _contest(found: Diagnosis, cause: Cause, measured: Experiment, possible: Experiment | None) -> Contest:
    others = tuple(other.hypothesis for other in found.causes if other is not cause)
    noise = found.search.study.noise
    rest = with_causes(replace(found.study, noise=noise), others)
    rivals = (*cause.rivals, *_variants(rest, found, cause))
    asked = (cause.hypothesis, *rivals)
    rows = _whitened(rest, found, measured, asked)
    known = dict(zip(found.search.last.model.names, found.search.last.state.values, strict=True))
    own = cause.hypothesis
    sizes = np.array([known[own.effect.parameters[index].name] for index in own.own])
    empty = (np.zeros((0, 1, rows[0].shape[-1])), np.zeros((0, 1, rows[1].shape[-1])))
    blocks = empty if possible is None else _stacked(_whitened(rest, found, possible, asked), len(possible.visits))
    return contest(own, rivals, sizes, rows, blocks)


def _variants(study: Study, found: Diagnosis, cause: Cause) -> tuple[Hypothesis, ...]:
    """The same causes at the same places with other options, which a diagnosis will try as well."""
    stated = (cause.hypothesis, *cause.rivals)
    there = {(h.entry, str(dict(h.options))) for h in stated}
    entries = {h.entry for h in stated}
    every = hypotheses(study, model_of(study), found.search.last)
    others = [h for h in every if h.entry in entries and (h.entry, str(dict(h.options))) not in there]
    count = Counter(h.entry for h in others)
    return tuple(h for h in others if count[h.entry] <= _VARIANTS)


def _stacked(rows: tuple[Floats, Floats], visits: int) -> tuple[Floats, Floats]:
    """Rows of visits of equal layout, (N k, p) -> (N, k, p)."""
    return rows[0].reshape(visits, -1, rows[0].shape[1]), rows[1].reshape(visits, -1, rows[1].shape[1])


def _whitened(
    study: Study, found: Diagnosis, experiment: Experiment, asked: tuple[Hypothesis, ...]
) -> tuple[Floats, Floats]:
    """Whitened columns (K, p) of a study's model and (K, m) of hypotheses, at the values of the extended fit."""
    model, differences = model_of(study), found.study.reference == "differences"
    state = carried(found.search.last, model, len(experiment.row_shot))
    response = respond(model, experiment, state.values)
    station = _station(study, state.base_T_measurement)
    operators = whitening(response.scene, study.noise, station, free_offsets=differences)
    own = np.concatenate(columns_of(asked, model, response, experiment, state.values), axis=2)
    return operators.apply(response.derivative[:, :, _wanted(model, differences)]), operators.apply(own)


def _station(study: Study, placement: Floats) -> Floats:
    """The instrument in the base frame: where the measurement frame begins if that is free, else as stated."""
    tracker = study.noise.tracker
    if not study.frame_free and tracker is not None and tracker.station is not None:
        return tracker.station
    return np.asarray(placement[:3, 3])


def _wanted(model: Model, differences: bool) -> np.ndarray:
    """(p,) True for the parameters that the readings of a visit inform about."""
    return ~model.nuisance if differences else np.ones(len(model.parameters), dtype=bool)


# ---- choosing


def separable(held: tuple[Contest, ...]) -> tuple[np.ndarray, ...]:
    """For each contest (k + 1, k + 1) True where the visits that help a pair most reach what it needs."""
    return tuple(_separable(one) for one in held)


def _separable(one: Contest) -> np.ndarray:
    alone = _of_pairs(one.energies(one.measured + one.possible))
    able = np.zeros(one.needed.shape, dtype=bool)
    for first, second in zip(*np.triu_indices(len(able), 1), strict=True):
        best = np.argsort(-alone[:, first, second], kind="stable")[:_BEST]
        reached = _of_pairs(one.energies(one.measured + one.possible[best].sum(axis=0)))
        able[[first, second], [second, first]] = reached[first, second] >= one.needed[first, second]
    inside = one.dofs == 0
    inside[one.nested, 0] = False
    entries = np.array([h.entry for h in (one.cause, *one.rivals)])
    return np.asarray(able & ~inside & ~inside.T & (entries[:, None] != entries))


def _of_pairs(energies: Floats) -> Floats:
    """(..., k + 1, k + 1) the smaller energy of the two hypotheses of each pair."""
    smaller: Floats = np.minimum(energies, energies.swapaxes(-1, -2))
    return smaller


def choose(held: tuple[Contest, ...], count: int, able: tuple[np.ndarray, ...]) -> Ints:
    """Visits with the largest harmonic mean of energies over those needed: one after another, then exchanges.

    With one pair this is its energy; with several the smallest counts most, and any gain counts.

    Args:
        held: The contests on the same N possible visits.
        count: Number of visits; all if there are no more.
        able: For each contest, the pairs that count.

    Returns:
        (count,) their numbers, in the order of the search.
    """
    number = len(held[0].possible)
    chosen: list[int] = []
    worth = np.zeros(number)
    while len(chosen) < min(count, number):
        worth = _worth(held, able, chosen, np.arange(number))
        worth[chosen] = -np.inf
        chosen.append(int(np.argmax(worth)))
    shortlist = np.argsort(-worth, kind="stable")[:_SHORTLIST]
    return np.array(_exchanged(held, able, chosen, shortlist), dtype=np.int64)


def _exchanged(
    held: tuple[Contest, ...], able: tuple[np.ndarray, ...], chosen: list[int], shortlist: Ints
) -> list[int]:
    """Replace one chosen visit after another by a better one, until nothing is gained."""
    for _ in range(_SWEEPS):
        before = list(chosen)
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            tried = np.concatenate([chosen[place : place + 1], np.setdiff1d(shortlist, chosen)])
            best = int(np.argmax(_worth(held, able, others, tried)))
            chosen = [*others[:place], int(tried[best]), *others[place:]]
        if chosen == before:
            break
    return chosen


def _worth(held: tuple[Contest, ...], able: tuple[np.ndarray, ...], chosen: list[int], tried: Ints) -> Floats:
    """(T,) what the readings, the chosen visits and one more are worth; the more, the less negative."""
    total = np.zeros(len(tried))
    for one, pairs in zip(held, able, strict=True):
        if pairs.any():
            normal = one.measured + one.possible[chosen].sum(axis=0) + one.possible[tried]
            total -= (one.needed[pairs] / (1.0 + one.energies(normal)[:, pairs])).sum(axis=1)
    return total


# ---- reporting


def _judged(
    held: tuple[Contest, ...], able: tuple[np.ndarray, ...] | None, chosen: Ints | None
) -> tuple[Separation, ...]:
    """What every pair has and will have."""
    judged: list[Separation] = []
    for number, one in enumerate(held):
        now = _of_pairs(one.energies(one.measured))[0, 1:]
        then = (
            None if chosen is None else _of_pairs(one.energies(one.measured + one.possible[chosen].sum(axis=0)))[0, 1:]
        )
        for name in dict.fromkeys(rival.entry for rival in one.rivals if rival.entry != one.cause.entry):
            own = np.array([i for i, rival in enumerate(one.rivals) if rival.entry == name])
            can = None if able is None else bool(able[number][0, 1 + own].all())
            judged.append(
                Separation(
                    cause=one.cause.entry,
                    rival=name,
                    now=float(now[own].min()),
                    then=None if then is None else float(then[own].min()),
                    needed=float(one.needed[0, 1 + own].max()),
                    separable=can,
                    exact=bool((one.dofs[0, 1 + own] == 0).any()),
                    advice=remedy(one.cause.name, name.partition("@")[0], bool(can)),
                )
            )
    return tuple(judged)
