"""The search for causes: one after another, each the one that predicts left-out visits best.

A block must pass a gate (`identify.diagnosis.gates`) before it is considered; of those that pass, the one with the
smallest leave-one-visit-out error enters the model, the model is fitted anew, and causes that a later one has made
superfluous leave it. Rivals of a cause are found by encompassing (Cox 1962; Mizon and Richard 1986): a rival stays a
rival unless the cause is still significant after the rival was added to the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from identify.arrays import Floats, Ints
from identify.diagnosis.evidence import Evidence, evidence
from identify.diagnosis.gates import LEVELS, Gate, family_probabilities
from identify.diagnosis.library import Hypothesis, detailed, finer, hypotheses, merged_options, tried
from identify.diagnosis.spread import noise_found, scaled, wider
from identify.errors import NoConvergence
from identify.experiment import Measurements
from identify.fit import Fit, State, fit, start
from identify.identification import fit_differences
from identify.model import Model, model_of
from identify.selection import take_rows
from identify.study import Study
from identify.tails import chi2_sf
from identify.uncertainty import stated_covariance

__all__ = ["MANY", "Cause", "Search", "carried", "fitted", "search", "with_causes", "with_noise_found", "with_rivals"]

MANY = 3000  # visits: so many choose as well as more would
_MOST = 8  # causes
_SHORTLIST = 16  # blocks whose leave-out error is computed
_STILL = 1e-3  # a cause that is significant at this level beside a rival drives it out
_WORTH = 0.01  # share of the squared error that a cause must take off where the covariance is not trusted
_WORTH_BESIDE = 0.02  # the same beside free curves
_SURE = 2.0  # standard deviations by which a size must exceed what is possible before it is refused
_BEYOND = 10.0  # times what is plausible: a larger size is no explanation
_CURVE = 2.0  # times what is plausible: a larger free curve is no explanation
_NEAR = 0.7  # of a cause's score, from which on a rival's options are searched more finely
#: Curves that can imitate nearly anything once they may be large: beyond what is plausible they are no explanation.
_STRICT = ("transmission_error", "approach_hysteresis", "joint_windup")


@dataclass(frozen=True, eq=False)
class Cause:
    """A cause that was found.

    Attributes:
        hypothesis: Its effect, place and options.
        p_value: Family-wise probability of its score at the step where it entered.
        left: Squared leave-one-visit-out error with it, as a share of the one without it, at the same step.
        rivals: Other hypotheses that explain the same.
    """

    hypothesis: Hypothesis
    p_value: float
    left: float = 1.0
    rivals: tuple[Hypothesis, ...] = ()


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found.

    Attributes:
        study: The study with the causes in its model.
        base: The study as it was.
        first: The fit of the model as it was.
        last: The fit of the extended model.
        causes: In the order in which they entered.
        gate: What decided about significance.
        chosen: The same on the visits that chose the causes, where those were not all.
    """

    study: Study
    base: Study
    first: Fit
    last: Fit
    causes: tuple[Cause, ...]
    gate: Gate
    chosen: Search | None = None


@dataclass(frozen=True, eq=False)
class _Rules:
    """What stays the same during a search; ``few`` of many visits make anything significant, so that worth decides."""

    data: Measurements
    gate: Gate
    differences: bool
    without: frozenset[str]
    rng: np.random.Generator
    few: bool = False


def with_causes(study: Study, causes: tuple[Hypothesis, ...]) -> Study:
    """A study with causes added to its model."""
    for cause in causes:
        options = merged_options(study.options, cause)
        study = replace(study, effects=(*study.effects, cause.entry), options=options)
    return study


def fitted(
    study: Study,
    data: Measurements,
    *,
    differences: bool,
    begin: Fit | None = None,
    sizes: Mapping[str, float] = MappingProxyType({}),
) -> Fit:
    """The model of a study fitted to rows that all count alike.

    Args:
        study: The study.
        data: The rows.
        differences: Only changes within a visit inform.
        begin: A fit of a similar model, whose values are where the new one starts.
        sizes: Where parameters start that the similar model does not have, by name.
    """
    model = model_of(study)
    state = start(model, data) if begin is None else carried(begin, model, len(data.positions), sizes)
    if differences:
        return fit_differences(study, model, data, state, reweigh=False, coarse=True)
    return fit(model, data, study.noise, state, reweigh=False, coarse=True)


def carried(begin: Fit, model: Model, rows: int, sizes: Mapping[str, float] = MappingProxyType({})) -> State:
    """The values of a fit in another model; nominal, or as in ``sizes``, what the fit does not have."""
    known = {**sizes, **dict(zip(begin.model.names, begin.state.values.tolist(), strict=True))}
    values = np.array([known.get(p.name, p.nominal) for p in model.parameters])
    return State(values, begin.state.base_T_measurement, np.ones(rows))


def search(
    study: Study,
    data: Measurements,
    *,
    gate: Gate,
    differences: bool,
    rng: np.random.Generator,
    without: frozenset[str] = frozenset(),
    begin: Fit | None = None,
    rivals: bool = True,
) -> Search:
    """Find the causes that a model lacks.

    Args:
        study: The study.
        data: Rows without faults.
        gate: What decides about significance.
        differences: Only changes within a visit inform.
        rng: Random numbers of the flips.
        without: Effects that are not tried.
        begin: A fit of the study's model, if there is one.
        rivals: Also look for hypotheses that explain the same as a cause.
    """
    first = begin or fitted(study, data, differences=differences)
    visits = np.unique(data.experiment.row_visit)
    if len(visits) <= MANY:
        done = _chosen(_Rules(data, gate, differences, without, rng), study, first)
    else:
        some = take_rows(data, np.flatnonzero(np.isin(data.experiment.row_visit, rng.permutation(visits)[:MANY])))
        begin = fitted(study, some, differences=differences, begin=first)
        done = _on_all(_chosen(_Rules(some, gate, differences, without, rng, few=True), study, begin), first)
    return with_rivals(done, without) if rivals else done


def _chosen(rules: _Rules, study: Study, first: Fit) -> Search:
    """The causes that some rows show, one after another."""
    found, wider = first, with_noise_found(study, first, rules.gate)
    causes: tuple[Cause, ...] = ()
    refused: set[str] = set()
    while len(causes) < _MOST:
        share = float(np.prod([cause.left for cause in causes])) if rules.few else 1.0
        entered, sizes = _next(rules, *wider, refused, share)
        if entered is None:
            break
        try:
            causes, found, wider = _entered(rules, study, (*causes, entered), found, sizes, refused)
        except NoConvergence:
            refused.add(entered.hypothesis.entry)  # what cannot be fitted explains nothing
    return Search(with_causes(study, _named(causes)), study, first, found, causes, rules.gate)


def _entered(
    rules: _Rules, study: Study, causes: tuple[Cause, ...], begin: Fit, sizes: Mapping[str, float], refused: set[str]
) -> tuple[tuple[Cause, ...], Fit, tuple[Study, Fit]]:
    """The causes after one more entered: without one that it made superfluous, which is not tried again."""
    found, wider = _both(rules, study, causes, begin, sizes)
    needed = _needed(wider[1], causes)
    if len(needed) < len(causes):
        found, wider = _both(rules, study, needed, found)
        refused.update({cause.hypothesis.entry for cause in causes} - {cause.hypothesis.entry for cause in needed})
    return needed, found, wider


def _on_all(chosen: Search, first: Fit) -> Search:
    """The causes that some visits chose, fitted to all of them, as detailed as they allow where that converges."""
    if not chosen.causes:
        return Search(chosen.base, chosen.base, first, first, (), chosen.gate, chosen)
    data, model, known = first.data, chosen.last.model, _named(chosen.causes)
    full = tuple(detailed(own, chosen.study, model, data.experiment) for own in known)
    try:
        return _refitted(chosen, first, full, chosen.last if full == known else first)
    except NoConvergence:
        return _refitted(chosen, first, known, chosen.last)


def _refitted(chosen: Search, first: Fit, full: tuple[Hypothesis, ...], begin: Fit) -> Search:
    """The causes of a search with these options, fitted to all visits."""
    causes = tuple(replace(cause, hypothesis=own) for cause, own in zip(chosen.causes, full, strict=True))
    study = with_causes(chosen.base, full)
    last = fitted(study, first.data, differences=first.whitening.cancels, begin=begin)
    return Search(study, chosen.base, first, last, causes, chosen.gate, chosen)


def with_rivals(done: Search, without: frozenset[str] = frozenset()) -> Search:
    """The same search with the hypotheses that explain the same as each cause; causes that the others replace go."""
    if done.chosen is not None:
        found = [_with_rivals(done.chosen, number, without) for number in range(len(done.causes))]
        rivals = [() if few is None else few.rivals for few in found]
        return replace(done, causes=tuple(replace(c, rivals=r) for c, r in zip(done.causes, rivals, strict=True)))
    causes: list[Cause] = []
    for number in range(len(done.causes)):
        judged = _with_rivals(done, number, without)
        if judged is None:
            return with_rivals(_lessened(done, number), without)
        causes.append(judged)
    return replace(done, causes=tuple(causes))


def _lessened(done: Search, number: int) -> Search:
    """A search without one of its causes."""
    causes = done.causes[:number] + done.causes[number + 1 :]
    study = with_causes(done.base, _named(causes))
    last = (
        fitted(study, done.last.data, differences=done.last.whitening.cancels, begin=done.last)
        if causes
        else done.first
    )
    return replace(done, study=study, last=last, causes=causes)


def _named(causes: tuple[Cause, ...]) -> tuple[Hypothesis, ...]:
    return tuple(cause.hypothesis for cause in causes)


def _both(
    rules: _Rules,
    study: Study,
    causes: tuple[Cause, ...],
    begin: Fit,
    sizes: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Fit, tuple[Study, Fit]]:
    """The fit with some causes, and the same with the noise as found."""
    larger = with_causes(study, _named(causes))
    found = fitted(larger, rules.data, differences=rules.differences, begin=begin, sizes=sizes)
    return found, with_noise_found(larger, found, rules.gate)


def _next(
    rules: _Rules, study: Study, found: Fit, refused: Set[str], share: float
) -> tuple[Cause | None, Mapping[str, float]]:
    """The cause that enters next, None if no block passes or the best is worth too little; and where one starts.

    Args:
        rules: What stays the same.
        study: The study with the causes found so far, with the noise as found.
        found: Its fit.
        refused: Entries that are not tried again.
        share: What the error is worth: 1, or its square as a share of that of the model as it was.
    """
    every = hypotheses(study, found.model, found, without=rules.without)
    asked = tuple(hypothesis for hypothesis in every if hypothesis.entry not in refused)
    seen = evidence(found, tried(found, asked))
    possible = np.array([_is_plausible(seen, block, hypothesis) for block, hypothesis in enumerate(asked)], dtype=bool)
    probability = family_probabilities(seen, rules.gate, rules.rng, possible)
    passed = np.flatnonzero(probability < LEVELS[rules.gate])
    if not len(passed):
        return None, {}
    scores = [seen.score(int(block)) for block in passed]
    order = np.lexsort(([-score.value for score in scores], [score.p_value for score in scores]))
    shortlist = passed[order][:_SHORTLIST]
    errors = [seen.left_out(int(block)) for block in shortlist]
    best = int(shortlist[int(np.argmin(errors))])
    shares = np.array(errors) / seen.left_out()
    left, least = float(shares.min()), _WORTH
    if rules.few:
        best, left, least = _worthiest(asked, shortlist, shares, share)
    if rules.gate == "flip" and (1 - left) * share < least:
        return None, {}
    chosen = _polished(rules, study, found, asked[best], seen.score(best).value)
    names = [chosen.effect.parameters[index].name for index in chosen.own]
    sizes = dict(zip(names, seen.sizes(best)[0].tolist(), strict=True)) if chosen.chord else {}
    return Cause(chosen, float(probability[best]), left), sizes


def _worthiest(
    asked: tuple[Hypothesis, ...], shortlist: Ints, shares: Floats, share: float
) -> tuple[int, float, float]:
    """The block to name where visits are many, the share of the squared error that it leaves, and what it must take.

    A spring under self-weight imitates the smooth part of curves that the model does not hold yet. So free curves come
    first as long as they are worth a name, and what enters beside them must be worth more.
    """
    is_curve = np.array(["knots_deg" in asked[int(block)].options for block in shortlist])
    curve = int(np.argmin(np.where(is_curve, shares, np.inf)))
    if is_curve[curve] and (1 - shares[curve]) * share >= _WORTH:
        return int(shortlist[curve]), float(shares[curve]), _WORTH
    best = int(np.argmin(shares))
    return int(shortlist[best]), float(shares[best]), _WORTH_BESIDE


def with_noise_found(study: Study, found: Fit, gate: Gate) -> tuple[Study, Fit]:
    """Study and fit with the noise as large as the residual says, where the gate does not trust the stated one."""
    if gate == "holm":
        return study, found
    louder = replace(study, noise=scaled(study.noise, wider(noise_found(found, study.noise))))
    return louder, fitted(louder, found.data, differences=found.whitening.cancels, begin=found)


def _is_plausible(seen: Evidence, block: int, hypothesis: Hypothesis) -> bool:
    """False if a size is surely beyond what its effect can be."""
    size, spread = seen.sizes(block)
    if "knots_deg" in hypothesis.options:
        return _is_plausible_curve(size, spread, hypothesis)
    beyond = 1.0 if hypothesis.name in _STRICT else _BEYOND
    room = beyond * hypothesis.plausible + _SURE * np.where(np.isfinite(spread), spread, 0.0)
    return bool((np.abs(size) <= room).all())


def _is_plausible_curve(size: Floats, spread: Floats, hypothesis: Hypothesis) -> bool:
    """False if the rms of a free curve, less what chance adds to it, is surely beyond what its effect can be.

    As long as its neighbours are not in the model, a curve also takes up what they will take back. Its level is an
    offset of the joint and does not count; a knot alone, with few visits near it, says little.
    """
    about = size - np.append(size, 0.0).mean()
    chance = np.where(np.isfinite(spread), spread, 0.0)
    return bool((about**2).mean() - (chance**2).mean() <= ((_CURVE * hypothesis.plausible) ** 2).mean())


def _polished(rules: _Rules, study: Study, found: Fit, chosen: Hypothesis, score: float) -> Hypothesis:
    """The same cause with the best value of a number that no linear test finds."""
    others = finer(chosen, study, found)
    if not others:
        return chosen
    seen = evidence(found, tried(found, others))
    scores = [seen.score(block).value for block in range(len(others))]
    best = int(np.argmax(scores))
    return others[best] if scores[best] > score else chosen


def _needed(wider: Fit, causes: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """The causes without the weakest, if the others have made it superfluous; the fit has the noise as found."""
    weakest = max(range(len(causes)), key=lambda number: _worth(wider, causes[number].hypothesis))
    if weakest == len(causes) - 1 or _worth(wider, causes[weakest].hypothesis) <= _STILL:
        return causes
    return causes[:weakest] + causes[weakest + 1 :]


def _worth(found: Fit, cause: Hypothesis) -> float:
    """Probability that the parameters of a cause in a fitted model are all zero (Wald's test)."""
    names, kept = found.model.names, found.identifiability.kept
    own = [names.index(cause.effect.parameters[index].name) for index in cause.own]
    where = np.flatnonzero(np.isin(kept, own))
    covariance = stated_covariance(found)[np.ix_(kept[where], kept[where])]
    value = found.state.values[kept[where]] - found.model.nominal[kept[where]]
    size = float(value @ np.linalg.lstsq(covariance, value, rcond=1e-12)[0]) if len(where) else 0.0
    return float(chi2_sf(size, max(len(where), 1)))


def _with_rivals(done: Search, number: int, without: frozenset[str]) -> Cause | None:
    """A cause with the hypotheses that explain the same beside the other causes; None if these need it no more."""
    cause, own = done.causes[number], done.causes[number].hypothesis
    rest = with_causes(done.base, _named(done.causes[:number] + done.causes[number + 1 :]))
    begin = fitted(rest, done.last.data, differences=done.last.whitening.cancels, begin=done.last)
    rest, begin = with_noise_found(rest, begin, done.gate)
    asked = hypotheses(rest, begin.model, begin, without=without)
    others = [h for h in asked if h.entry != own.entry]
    seen = evidence(begin, tried(begin, (own, *others)))
    if len(done.causes) > 1 and seen.score(0).p_value > _STILL:
        return None
    rivals: dict[str, Hypothesis] = {}
    for block, other in enumerate(others, start=1):
        if other.entry not in rivals and _is_rival(seen, block, other):
            rivals[other.entry] = other
    near = {other.entry: other for block, other in enumerate(others, start=1) if _is_near(seen, block)}
    for entry in near.keys() - rivals.keys():
        polished = finer(near[entry], rest, begin)
        seen = evidence(begin, tried(begin, (own, *polished)))
        fitting = [other for block, other in enumerate(polished, start=1) if _is_rival(seen, block, other)]
        if fitting:
            rivals[entry] = fitting[0]
    return replace(
        cause, rivals=tuple(rivals[entry] for entry in dict.fromkeys(h.entry for h in others) if entry in rivals)
    )


def _is_near(seen: Evidence, block: int) -> bool:
    """True if a block explains so much of what the cause (block 0) does that a finer option of it may explain all."""
    return seen.score(block).value > _NEAR * seen.score(0).value


def _is_rival(seen: Evidence, block: int, other: Hypothesis) -> bool:
    """True if the cause (block 0) adds nothing to this one, which is plausible."""
    return seen.beyond(0, block).p_value > _STILL and _is_plausible(seen, block, other)
