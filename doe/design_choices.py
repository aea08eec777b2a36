"""Where the tracker stands and which markers are mounted, as part of the design.

Every possible station with every set of markers is judged by the relaxed design on a small set of candidates of its
own (those that can be measured with it); the plan goes on with the best. With too many sets the markers are exchanged
one at a time for as long as that helps, at each station.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from doe.approximate import ApproximateDesign, approximate_design
from doe.candidates import candidates
from doe.executor import HERE, Executor
from doe.objective import objective
from doe.observations import identifiable, keep_columns, observer
from identify.errors import Infeasible, NoConvergence, NotIdentifiable
from identify.study import Study

__all__ = ["Decision", "Option", "choice_lines", "decide", "open_choices"]

_CANDIDATES = 400  # at most, for each option
_TRIED = 300  # options that are all tried; with more, markers are exchanged
_ROUNDS = 10  # of exchanges at one station

log = logging.getLogger("elastocal")


@dataclass(frozen=True)
class Option:
    """One station with one set of markers.

    Attributes:
        station: Its name; None where there is nothing to choose.
        markers: Names of the mounted markers out of those to choose from.
        rank: Parameters that can be identified.
        value: The criterion of the relaxed design for one experiment; infinite where nothing can be planned.
        why: Why nothing can be planned, or None.
    """

    station: str | None
    markers: tuple[str, ...]
    rank: int
    value: float
    why: str | None = None

    @property
    def order(self) -> tuple[int, float]:
        """The smaller the better: more parameters first where the criterion does not see the missing ones."""
        return -self.rank, self.value


@dataclass(frozen=True)
class Decision:
    """What was chosen, and out of what.

    Attributes:
        best: The chosen option.
        tried: All options that were judged, the best first.
        complete: True if these are all there are.
    """

    best: Option
    tried: tuple[Option, ...]
    complete: bool

    @property
    def as_json(self) -> dict[str, Any]:
        """Plain data; values that are infinite are null. ``gain_percent`` is against the median of what was tried."""
        values = [option.value for option in self.tried if option.rank == self.best.rank and np.isfinite(option.value)]
        median, worst = float(np.median(values)), max(values)
        return {
            "station": self.best.station,
            "markers": list(self.best.markers),
            "value": self.best.value,
            "median": median,
            "worst": worst,
            "gain_percent": 100.0 * (1.0 - self.best.value / median),
            "gain_against_worst_percent": 100.0 * (1.0 - self.best.value / worst),
            "complete": self.complete,
            "tried": [
                {
                    "station": option.station,
                    "markers": list(option.markers),
                    "rank": option.rank,
                    "value": option.value if np.isfinite(option.value) else None,
                    "why": option.why,
                }
                for option in self.tried
            ],
        }


def open_choices(study: Study) -> bool:
    """True if the study leaves the station of the tracker or the markers open."""
    return len(study.plan.stations) > 1 or bool(study.marker_choices)


def decide(study: Study, *, seed: int, executor: Executor = HERE) -> tuple[Study, Decision | None]:
    """Choose station and markers.

    Args:
        study: The study.
        seed: Seed of the candidates.
        executor: Who judges the options.

    Returns:
        The study with the chosen station and the mounted markers alone, and how it was chosen; the study itself and
        None where nothing is open.

    Raises:
        Infeasible: No option has a candidate.
        NotIdentifiable: No option shows what the criterion needs.
    """
    if not open_choices(study):
        return study, None
    judge = _Judge(study, seed, executor)
    stations = study.plan.stations or (None,)
    count = study.plan.markers or 0
    sets = math.comb(len(study.marker_choices), count)
    complete = sets * len(stations) <= _TRIED
    if complete:
        judge.all([(place, mounted) for place in stations for mounted in combinations(study.marker_choices, count)])
    else:
        for station in stations:
            judge.exchange(station, study.marker_choices, count)
    tried = tuple(sorted(judge.judged.values(), key=lambda option: option.order))
    best = tried[0]
    if not np.isfinite(best.value):
        raise judge.errors[best.station, best.markers]
    where = "" if best.station is None else f"tracker at {best.station}"
    mounted = ", ".join(best.markers)
    blind = sum(not np.isfinite(option.value) for option in tried)
    told = f"{len(tried)}, {blind} of them without a plan" if blind else str(len(tried))
    if best.rank:  # nothing is chosen where no option shows anything; the plan says why
        log.info("chosen out of %s: %s", told, "; ".join(filter(None, [where, mounted and f"markers {mounted}"])))
    return _with(study, best.station, best.markers), Decision(best, tried, complete)


def choice_lines(decision: Decision) -> tuple[str, ...]:
    """What was chosen and what that is worth, for people."""
    best, content = decision.best, decision.as_json
    chosen = [] if best.station is None else [f"tracker at {best.station}"]
    chosen += [f"markers {', '.join(best.markers)}"] if best.markers else []
    kind = "all" if decision.complete else "exchanges among all"
    blind = sum(not np.isfinite(option.value) for option in decision.tried)
    nothing = f"; without a plan: {blind} of them" if blind else ""
    first = f"chosen: {' and '.join(chosen)}, out of {len(decision.tried)} options ({kind}){nothing}"
    if blind + 1 == len(decision.tried):
        return (first,)
    return (
        first,
        f"the choice takes {content['gain_percent']:.0f} % off the criterion against the median option, "
        f"{content['gain_against_worst_percent']:.0f} % against the worst",
    )


_Key = tuple[str | None, tuple[str, ...]]  # a station and the mounted markers


class _Judge:
    """Judges options, each once."""

    def __init__(self, study: Study, seed: int, executor: Executor) -> None:
        """Start with none."""
        small = min(_CANDIDATES, study.plan.candidates)
        self.study, self.seed = replace(study, plan=replace(study.plan, candidates=small)), seed
        self.executor = executor
        self.judged: dict[_Key, Option] = {}
        self.errors: dict[_Key, Infeasible | NotIdentifiable] = {}

    def exchange(self, station: str | None, names: tuple[str, ...], count: int) -> None:
        """From the first markers, exchange one at a time for the best other one, while this helps."""
        best = self.all([(station, names[:count])])[0]
        for _ in range(_ROUNDS):
            start = best
            for place in range(count):
                others = [name for name in names if name not in best.markers]
                swapped = [{*best.markers[:place], *best.markers[place + 1 :], name} for name in others]
                options = self.all([(station, tuple(name for name in names if name in own)) for own in swapped])
                best = min([best, *options], key=lambda option: option.order)
            if best is start:
                break

    def all(self, keys: list[_Key]) -> list[Option]:
        """The relaxed designs of some options."""
        new = [key for key in dict.fromkeys(keys) if key not in self.judged]
        found = self.executor.map(partial(_tried, self.seed), [_with(self.study, *key) for key in new])
        for key, (rank, value, error) in zip(new, found, strict=True):
            self.judged[key] = Option(*key, rank, value, None if error is None else str(error))
            if error is not None:
                self.errors[key] = error
        return [self.judged[key] for key in keys]


def _tried(seed: int, study: Study) -> tuple[int, float, Infeasible | NotIdentifiable | None]:
    """Rank and value of the relaxed design for one experiment, or why there is none."""
    try:
        return *_relaxed(study, seed), None
    except (Infeasible, NotIdentifiable) as error:
        return 0, float("inf"), error


def _relaxed(study: Study, seed: int) -> tuple[int, float]:
    """Rank and value of the relaxed design for one experiment."""
    chosen, own_visits = candidates(study, seed=seed, warn=False), study.plan.references == "own_visits"
    watching = observer(study, own_visits=own_visits)
    blocks = watching.blocks(chosen.visit_q, chosen.visit_loads)
    known = identifiable(blocks, parameters=watching.parameters)
    aim = objective(watching, known, study.plan.criterion)
    try:
        design = approximate_design(keep_columns(blocks, known.kept), aim.target(), criterion=aim.criterion, tol=1e-3)
    except NoConvergence as error:
        if not isinstance(error.best, ApproximateDesign):
            raise
        design = error.best
    return known.rank, design.value


def _with(study: Study, station: str | None, markers: tuple[str, ...]) -> Study:
    """The study with one station and the mounted markers alone."""
    dropped = set(study.marker_choices) - set(markers)
    plan = replace(study.plan, stations=() if station is None else (station,), markers=None)
    study = replace(study, plan=plan, markers=study.markers.without(dropped), marker_choices=())
    if station is None:
        return study
    kept = tuple(place for place in study.stations if place.name == station)
    noise = study.noise
    if noise.tracker is not None:
        noise = replace(noise, tracker=replace(noise.tracker, station=kept[0].position))
    return replace(study, stations=kept, noise=noise)
