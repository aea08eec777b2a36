"""The public verb `diagnose`: what the simulation gets wrong, why, and what naming it gains."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from identify.diagnosis.evidence import evidence
from identify.diagnosis.faults import Fault, faults, without_rows
from identify.diagnosis.gain import Gain, gain
from identify.diagnosis.gates import Gate, family_probabilities, holm_probabilities
from identify.diagnosis.replicate_noise import ReplicateNoise, replicate_noise
from identify.diagnosis.scatter import uneven
from identify.diagnosis.search import MANY, Cause, Search, fitted, search, with_noise_found, with_rivals
from identify.diagnosis.spread import NoiseFound, RangeNoise, louder_than_stated, noise_found, range_noise, scaled
from identify.diagnosis.structure import patterns
from identify.errors import NotIdentifiable
from identify.experiment import Experiment, Measurements
from identify.fit import Fit, fit, start
from identify.identification import Identification, fit_differences, identify
from identify.lack_of_fit import LackOfFit, lack_of_fit
from identify.model import model_of
from identify.selection import distinct_rows, load_changes, take_rows
from identify.six_d import positions_only
from identify.study import Study
from identify.threads import one_thread

__all__ = ["Diagnosis", "Remainder", "Verdict", "diagnose", "known_reference"]

Verdict = Literal["adequate", "cause_found", "ambiguous", "unexplained"]

_REJECTED = 1e-2  # stated noise is not trusted if chi2 is this improbable
_PATTERN = 0.005  # of unnamed patterns
_RANGE = 1e-3
_HALF = 0.5  # of the excess chi-square that named causes must remove
_TOO_WIDE = 4.0  # times the stated noise: more than this is no mere misstatement
_LEAST_VISITS = 8
_ROUNDS = 3  # of faults and causes in turn
_FIRST, _LATER = 25.0, 10.0  # robust sigmas of an outlier, before and after the causes are known


@dataclass(frozen=True, eq=False)
class Remainder:
    """What the extended model still leaves.

    Attributes:
        lack_of_fit: Chi-square against the stated noise.
        present: A significant misfit remains that noise alone does not explain.
        depends_on: Column of the table that it depends on most, None if none can be told.
        p_value: Family-wise probability of the strongest unnamed pattern.
    """

    lack_of_fit: LackOfFit
    present: bool
    depends_on: str | None
    p_value: float


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The result of `diagnose`.

    Attributes:
        study: The study, with the reference that was used.
        data: All readings.
        clean: The readings without faulty rows.
        verdict: adequate, cause_found, ambiguous or unexplained.
        search: The causes that are effects, the fit before and the fit after.
        faults: Faulty rows.
        range_noise: Noise that grows with the distance, None where it does not.
        remainder: What is left.
        first_lack: Chi-square of the model as it was.
        noise: How large the noise is, against what is stated.
        gain: Errors on held-out visits before and after; None if no cause is named.
        identification: The extended model identified from all rows.
        notes: What the user should know.
    """

    study: Study
    data: Measurements
    clean: Measurements
    verdict: Verdict
    search: Search
    faults: tuple[Fault, ...]
    range_noise: RangeNoise | None
    remainder: Remainder
    first_lack: LackOfFit
    noise: NoiseFound
    gain: Gain | None
    identification: Identification
    notes: tuple[str, ...]

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes that are effects, in the order in which they were found."""
        return self.search.causes

    @property
    def extended_study(self) -> Study:
        """The study with the causes in its model."""
        return self.search.study


@dataclass(frozen=True, eq=False)
class _Rules:
    """What stays the same during a diagnosis."""

    differences: bool
    seed: int
    without: frozenset[str]

    def rng(self) -> np.random.Generator:
        """Random numbers, the same at each call."""
        return np.random.default_rng(self.seed)


@dataclass(frozen=True, eq=False)
class _Conclusion:
    """A search and what it leaves."""

    search: Search
    remainder: Remainder
    range_noise: RangeNoise | None = None
    replicates: ReplicateNoise | None = None


def diagnose(study: Study, data: Measurements, *, seed: int = 0, without: frozenset[str] = frozenset()) -> Diagnosis:
    """Find out what a simulation gets wrong, from measurements.

    Args:
        study: The study; its effects are what the simulation contains.
        data: The readings.
        seed: Seed of sign flips, folds and bootstrap.
        without: Names of effects that are not considered.

    Raises:
        NotIdentifiable: Too few visits for any conclusion; the message says how many would do.
        NoConvergence: A fit did not converge.
    """
    with one_thread():
        data, copies = _without_copies(data)
        unread = () if data.quaternions is None else ("orientations of 6-D targets are not looked at",)
        study, data = positions_only(study), replace(data, quaternions=None)
        study, notes = _with_reference(study, data)
        notes = (*copies, *unread, *notes)
        rules = _Rules(study.reference == "differences", seed, without)
        _check_enough(study, data)
        wrong = faults(_robust(study, data, rules), study.noise, limit=_FIRST)
        concluded = _concluded(study, without_rows(data, wrong), rules)
        for _ in range(_ROUNDS):
            again = _faults_beside(concluded.search, study, data, rules)
            if _rows(again) == _rows(wrong):
                break
            wrong = again
            concluded = _concluded(study, without_rows(data, wrong), rules)
        return _result(study, data, wrong, concluded, rules, notes)


def _without_copies(data: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """Readings that stand there twice, under whatever repeat or pose, are used once."""
    rows = distinct_rows(data)
    copies = len(data.positions) - len(rows)
    if not copies:
        return data, ()
    return take_rows(data, rows), (f"{copies} readings are copies of others to the last digit and are used once",)


def _with_reference(study: Study, data: Measurements) -> tuple[Study, tuple[str, ...]]:
    """The study with absolute or differences in place of auto.

    Absolute readings that contradict the model are what a diagnosis is about, so that only unknown masses count.
    """
    if known_reference(study, data.experiment) == study.reference:
        return study, ()
    if known_reference(study, data.experiment) == "differences":
        note = (
            "link masses are unknown: only changes between loads are used, which hide causes that act in every "
            "reading alike; state the masses in the robot file"
        )
        return replace(study, reference="differences"), (note,)
    return replace(study, reference="absolute"), ()


def known_reference(study: Study, experiment: Experiment) -> Literal["absolute", "differences"]:
    """What a diagnosis compares: absolute readings, unless link masses are unknown and readings can be compared.

    Args:
        study: The study.
        experiment: The rows.
    """
    if study.reference != "auto":
        return study.reference
    compares = len(load_changes(experiment, np.zeros((len(experiment.row_shot), 3)))[1]) > 0
    yields = any(effect.yields for effect in model_of(study).effects)
    return "differences" if compares and yields and not study.robot.masses_known else "absolute"


def _check_enough(study: Study, data: Measurements) -> None:
    """Refuse data that allow no conclusion.

    Raises:
        NotIdentifiable: Too few visits.
    """
    count, asked = len(np.unique(data.experiment.row_visit)), len(model_of(study).parameters)
    per_visit = 3.0 * len(data.positions) / max(count, 1)
    needed = max(_LEAST_VISITS, int(np.ceil(1.5 * asked / per_visit)))
    if count < needed:
        raise NotIdentifiable(
            f"{data.source}: {count} poses allow no diagnosis of a model with {asked} unknowns; measure at least "
            f"{needed} poses (30 are usual) with their unloaded readings"
        )


def _robust(study: Study, data: Measurements, rules: _Rules) -> Fit:
    """A fit in which rows that do not fit have little influence."""
    model = model_of(study)
    if rules.differences:
        return fit_differences(study, model, data)
    return fit(model, data, study.noise, start(model, data))


def _faults_beside(done: Search, study: Study, data: Measurements, rules: _Rules) -> tuple[Fault, ...]:
    """Faults among all rows, seen with the causes in the model.

    One of many visits bends no fit, so that none has to be robust. What such a fit leaves beyond the stated noise is
    mostly the model's, with tails of its own; so only what is far beyond them is looked at.
    """
    if not _many(data):
        return faults(_robust(done.study, data, rules), study.noise, limit=_LATER)
    every = fitted(done.study, data, differences=rules.differences, begin=done.last)
    return faults(every, study.noise, limit=_FIRST, least=_FIRST)


def _many(data: Measurements) -> bool:
    """True if some of the visits choose as well as all of them."""
    return len(np.unique(data.experiment.row_visit)) > MANY


def _rows(wrong: tuple[Fault, ...]) -> list[int]:
    """Rows of faults, ascending."""
    return sorted({int(row) for fault in wrong for row in fault.rows})


def _concluded(study: Study, clean: Measurements, rules: _Rules) -> _Conclusion:
    """Causes by the stated noise or that of replicates; by sign flips if the extended model still contradicts it."""
    study, repeated = _with_replicates(study, clean, rules)
    found = replace(_searched(study, clean, rules), replicates=repeated)
    if found.remainder.present:
        return found
    wider = range_noise(found.search.last, study.noise)
    if wider is None or wider.p_value > _RANGE:
        return found
    return replace(_searched(replace(study, noise=wider.noise), clean, rules), range_noise=wider, replicates=repeated)


def _with_replicates(study: Study, clean: Measurements, rules: _Rules) -> tuple[Study, ReplicateNoise | None]:
    """The study with the noise of its replicates, where these contradict the stated one."""
    scatter = replicate_noise(fitted(study, clean, differences=rules.differences), study.noise)
    if scatter is None or scatter.p_value >= _REJECTED:
        return study, None
    return replace(study, noise=scaled(study.noise, scatter.sizes)), scatter


def _searched(study: Study, clean: Measurements, rules: _Rules) -> _Conclusion:
    """A search with the gate that the data allow, and what it leaves."""
    search_by = partial(search, study, clean, differences=rules.differences, rng=rules.rng(), without=rules.without)
    gates: tuple[Gate, Gate] = ("flip", "holm") if _many(clean) else ("holm", "flip")
    done = search_by(gate=gates[0], rivals=False)
    lack = lack_of_fit(done.last, np.zeros(0, dtype=np.int64))
    trusted = lack.p_value >= _REJECTED and louder_than_stated(done.last, study.noise) >= _REJECTED
    if trusted != (gates[0] == "holm"):
        done = search_by(gate=gates[1], rivals=False, begin=done.first)
        lack = lack_of_fit(done.last, np.zeros(0, dtype=np.int64))
    return _Conclusion(done, _remainder(done, lack, rules))


def _remainder(done: Search, lack: LackOfFit, rules: _Rules) -> Remainder:
    """Is there structure that no named cause holds?"""
    few = done.chosen or done
    _, found = with_noise_found(few.study, few.last, few.gate)
    unnamed = patterns(found)
    seen = evidence(found, unnamed)
    smooth = family_probabilities(seen, done.gate, rules.rng(), np.ones(len(unnamed), dtype=bool))
    scattered = uneven(seen, rules.rng())
    rough = holm_probabilities(np.array([part.p_value for part in scattered]))
    where = [*(pattern.depends_on for pattern in unnamed), *(part.depends_on for part in scattered)]
    probability = np.append(smooth, rough)
    strength = np.append([seen.score(b).p_value for b in range(len(unnamed))], [part.p_value for part in scattered])
    strongest = int(np.lexsort((strength, probability))[0])
    smallest = float(probability[strongest])
    if smallest < _PATTERN:
        return Remainder(lack, True, where[strongest], smallest)
    too_wide = done.gate == "flip" and noise_found(done.last, done.study.noise).reading > _TOO_WIDE
    return Remainder(lack, too_wide, None, smallest)


def _result(
    study: Study,
    data: Measurements,
    wrong: tuple[Fault, ...],
    concluded: _Conclusion,
    rules: _Rules,
    notes: tuple[str, ...],
) -> Diagnosis:
    """Everything about a conclusion."""
    done = concluded.search
    first = lack_of_fit(done.first, np.zeros(0, dtype=np.int64))
    base = replace(study, noise=done.study.noise)
    judged = partial(gain, base, done, differences=rules.differences, rng=rules.rng(), without=rules.without)
    named = bool(done.causes or wrong or concluded.range_noise)
    with ThreadPoolExecutor(1) as beside:  # the two halves of the rest do not need each other
        gained = beside.submit(judged) if named else None
        done = with_rivals(done, rules.without)
        known = done.last if _many(data) and not wrong else None
        identification = identify(done.study, data, seed=rules.seed, found=known)
    return Diagnosis(
        study=study,
        data=data,
        clean=done.last.data,
        verdict=_verdict(replace(concluded, search=done), first, wrong),
        search=done,
        faults=wrong,
        range_noise=concluded.range_noise,
        remainder=concluded.remainder,
        first_lack=first,
        noise=_against_stated(noise_found(done.last, done.study.noise), concluded.replicates),
        gain=gained.result() if gained else None,
        identification=identification,
        notes=(*notes, *_notes(done, concluded.replicates)),
    )


def _against_stated(found: NoiseFound, repeated: ReplicateNoise | None) -> NoiseFound:
    """Sizes of the noise against what is stated, where the search took that of the replicates."""
    if repeated is None:
        return found
    ours, theirs = (np.array([s.reading, s.reading_jitter, s.pose_jitter]) for s in (found, repeated.sizes))
    return NoiseFound(*(ours * theirs).tolist())


def _verdict(concluded: _Conclusion, first: LackOfFit, wrong: tuple[Fault, ...]) -> Verdict:
    """The verdict by the rules of the contract."""
    causes, remainder = concluded.search.causes, concluded.remainder
    if not (causes or wrong or concluded.range_noise):
        return "unexplained" if remainder.present else "adequate"
    removed = first.chi2 - remainder.lack_of_fit.chi2
    if remainder.present and removed < _HALF * (first.chi2 - first.dof):
        return "unexplained"
    return "ambiguous" if any(cause.rivals for cause in causes) else "cause_found"


def _notes(done: Search, repeated: ReplicateNoise | None) -> tuple[str, ...]:
    """How significance was decided."""
    source = "stated noise" if repeated is None else f"noise of the replicates ({repeated.dof} degrees of freedom)"
    if done.gate == "holm":
        return (f"the {source} is consistent with the extended model: significance by Holm's rule",)
    return (
        f"the {source} contradicts the readings even with the extended model: significance with the noise as found, "
        "and by flipping the signs of whole poses, which needs no stated noise",
    )
