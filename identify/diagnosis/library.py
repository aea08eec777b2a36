"""Which causes a diagnosis tries, where they may sit and with which options.

Every registered effect is tried at every place that it has and that the model does not hold already. A few effects
have a number that no linear test can find (the time of a step, the knee of a wind-up); they are tried at some values
of it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.effects import REGISTRY, Effect
from identify.effects.joint_errors import usual_pairs
from identify.effects.joint_turns import axis_compliance
from identify.experiment import Experiment
from identify.fit import Fit
from identify.model import Model, effects_of, with_effect
from identify.response import Response, added_columns
from identify.study import Study
from identify.units import DEG

__all__ = [
    "TOGETHER",
    "Hypothesis",
    "Tried",
    "columns_of",
    "detailed",
    "finer",
    "hypotheses",
    "merged_options",
    "placed_options",
    "tried",
]

_EVERYWHERE = "all"
_PLACE = re.compile(r"j\d+|j\d+-j\d+|link\d+|base|column|flange|all")
_COMPONENTS = re.compile(r"\.[xyz]$")
_BY_NAME = ("marker_seating", "load_level")  # their places are ids of the study
_COMMON = ("thermal_growth",)  # one set of options for all places
#: Also tried at all their places at once.
TOGETHER = ("geometry", "joint_compliance", "thermal_growth", "wrist_coupling")
_KNEES = (0.08, 0.25)  # shares of the largest torque on the joint
_FRICTION = (0.0, 0.05, 0.15, 0.4)  # shares of the largest torque of the load on the joint
_SATURATIONS = (0.25, 0.5)  # shares of the largest torque on the joint
_STEPS = 40  # times at which the instrument may have been knocked
_WARM_UP_H = (0.5, 1.0, 2.0)
_SCALED = {"knee_Nm", "knee_N", "saturation_Nm", "saturation_N", "tau_h"}
_RICH = 1000  # visits from which on free curves are tried
_APART = 1.5 * DEG  # knots of a free curve, at least
_VISITS = 10  # between two knots, at least
_COARSE = 12  # knots: no more of them show less than some harmonics do
_FINER = (0.5, 0.7, 0.85, 1.2, 1.4, 2.0)  # times the value found so far


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One cause at one place.

    Attributes:
        name: Name of the effect.
        where: Its place, None for effects of the whole arm, load or instrument.
        options: Options of the effect that belong to this place.
        effect: The effect, bound beside the effects of the model.
        own: (b,) its parameters at this place.
        chord: Size of its one parameter, in its unit, up to which a nonlinear effect is tried as a whole; 0: its slope.
    """

    name: str
    where: str | None
    options: Mapping[str, Any]
    effect: Effect
    own: Ints
    chord: float = 0.0

    @property
    def entry(self) -> str:
        """The entry in a list of effects: ``name`` or ``name@where``."""
        return self.name if self.where is None else f"{self.name}@{self.where}"

    @property
    def plausible(self) -> Floats:
        """(b,) largest plausible sizes, in units."""
        return np.array([self.effect.parameters[index].plausible for index in self.own])


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis with its columns on some rows.

    Attributes:
        hypothesis: The hypothesis.
        columns: (R, 3, b) m per unit.
    """

    hypothesis: Hypothesis
    columns: Floats
    plausible: Floats = field(default_factory=lambda: np.zeros(0))


def tried(found: Fit, asked: tuple[Hypothesis, ...]) -> tuple[Tried, ...]:
    """Columns of hypotheses at the values of a fit."""
    columns = columns_of(asked, found.model, found.response, found.data.experiment, found.state.values)
    return tuple(Tried(h, part, h.plausible) for h, part in zip(asked, columns, strict=True))


def columns_of(
    asked: tuple[Hypothesis, ...], model: Model, response: Response, experiment: Experiment, values: Floats
) -> tuple[Floats, ...]:
    """Columns (R, 3, b) of hypotheses beside a model on any rows, m per unit.

    Args:
        asked: The hypotheses, bound beside the effects of the model.
        model: The model.
        response: The model at ``values``.
        experiment: The rows.
        values: (p,) parameters of the model in their units.
    """
    slopes: dict[int, Floats] = {}
    for effect in (hypothesis.effect for hypothesis in asked if not hypothesis.chord):
        if id(effect) not in slopes:
            every = np.arange(len(effect.parameters))
            slopes[id(effect)] = added_columns(model, effect, every, response, experiment, values)
    return tuple(_chord(h, model, response, values) if h.chord else slopes[id(h.effect)][:, :, h.own] for h in asked)


def _chord(asked: Hypothesis, model: Model, response: Response, values: Floats) -> Floats:
    """Column (R, 3, 1) of a nonlinear effect from zero to its chord, m per unit."""
    size = np.zeros(len(asked.effect.parameters))
    size[asked.own] = asked.chord
    inputs = with_effect(model, asked.effect).effect_inputs[-1]
    moved = asked.effect.displacement(response.scene, np.append(values, size)[inputs])
    return np.asarray(moved[:, :, None] / asked.chord)


def hypotheses(
    study: Study, model: Model, found: Fit, *, without: frozenset[str] = frozenset()
) -> tuple[Hypothesis, ...]:
    """Every cause at every place that the model of a study does not hold.

    Args:
        study: The study.
        model: Its model.
        found: A fit of the model, for torques and times.
        without: Names of effects that are not tried.
    """
    held = set(model.names)
    asked: list[Hypothesis] = []
    for name in REGISTRY:
        if name in without:
            continue
        for places, options, chord in _variants(name, study, model, found):
            effect = _bound(study, model, name, places, options)
            groups: dict[str | None, list[int]] = {}
            for index, parameter in enumerate(effect.parameters):
                if parameter.name not in held:
                    groups.setdefault(_place(name, parameter.name), []).append(index)
            if name in TOGETHER and len(groups) > 1:
                groups[None] = [index for own in groups.values() for index in own]
            asked += [
                Hypothesis(name, where, _own(options, where), effect, frozen(own, np.int64), chord.get(where, 0.0))
                for where, own in groups.items()
            ]
    return tuple(asked)


def placed_options(added: Hypothesis) -> dict[str, Any]:
    """The options of a hypothesis as they stand in ``[model.<effect>]``: at its place, if the effect allows that."""
    own = dict(added.options)
    return own if added.where is None or added.name in _COMMON or not own else {added.where: own}


def merged_options(options: Mapping[str, Mapping[str, Any]], added: Hypothesis) -> Mapping[str, Mapping[str, Any]]:
    """Options of a study with those of one more cause, kept at its place where it has one."""
    if not added.options:
        return options
    own = {**options.get(added.name, {}), **placed_options(added)}
    return MappingProxyType({**options, added.name: MappingProxyType(own)})


def _own(options: Mapping[str, Any], where: str | None) -> Mapping[str, Any]:
    """Options of one place: its own table, where the options hold one."""
    own = options.get(where, options) if where is not None else options
    return MappingProxyType(dict(own))


def _bound(study: Study, model: Model, name: str, places: tuple[str, ...], options: Mapping[str, Any]) -> Effect:
    """The effect bound beside the effects of the model of the study."""
    entries = tuple(f"{name}@{place}" for place in places) or (name,)
    merged = {**study.options, name: {**study.options.get(name, {}), **options}}
    others = tuple(effect for effect in model.effects if effect.name != name)
    return effects_of(replace(study, options=merged), entries, others)[0]


def _place(name: str, parameter: str) -> str | None:
    """Where a parameter sits; None where its effect has no places."""
    rest = parameter[len(name) + 1 :]
    if name in _BY_NAME:
        return _COMPONENTS.sub("", rest) if name == "marker_seating" else rest
    first = rest.split(".")[0]
    return first if _PLACE.fullmatch(first) and first != _EVERYWHERE else None


def _variants(name: str, study: Study, model: Model, found: Fit) -> Variants:
    """Places (empty: all) and options with which an effect is tried."""
    special = _SPECIAL.get(name)
    if special is not None:
        yield from special(study, model, found)
    elif name != "joint_cross_compliance" or study.robot.n > 1:
        yield Variant()


class Variant(NamedTuple):
    """Places (empty: all), options (or tables of them by place), and chords of a nonlinear effect by place."""

    places: tuple[str, ...] = ()
    options: Mapping[str, Any] = MappingProxyType({})
    chord: Mapping[str | None, float] = MappingProxyType({})


Variants = Iterator[Variant]


def _links(study: Study, model: Model, found: Fit) -> Variants:
    """Links between base and flange, which turn alone or bend as a beam."""
    places = tuple(f"link{link}" for link in range(1, study.robot.n))
    for template in (["k44", "k55", "k66"], "beam"):
        if places:
            yield Variant(places, {"template": template})


def _masses(study: Study, model: Model, found: Fit) -> Variants:
    """A mass at its stated centre, and one whose centre is wrong too."""
    for components in (["mass"], ["mass", "mx", "my", "mz"]):
        yield Variant(options={"components": components})


def _compensators(study: Study, model: Model, found: Fit) -> Variants:
    """A spring beside joint 2: as the study describes it, else of unknown geometry."""
    joints = [joint for joint in _yielding(study, model) if joint == 1]
    if joints and not study.robot.prismatic[1]:
        yield Variant(("j2",), {} if "gravity_compensator" in study.options else {"mode": "harmonics"})


def _sticking(study: Study, model: Model, found: Fit) -> Variants:
    """Joints of which the model knows a compliance, with friction from nothing to a good share of the load."""
    largest = np.abs(found.response.scene.load_on_joints).max(axis=0)
    loaded = [joint for joint in _yielding(study, model) if largest[joint] > 0]
    for share in _FRICTION if loaded else ():
        chord: dict[str | None, float] = {f"j{joint + 1}": float(share * largest[joint]) for joint in loaded}
        yield Variant(tuple(f"j{joint + 1}" for joint in loaded), chord=chord)


def _knees(study: Study, model: Model, found: Fit) -> Variants:
    """Knees at shares of the largest torque on each joint."""
    for share in _KNEES:
        yield from _at_torques("knee", share, study, found)


def _hardening(study: Study, model: Model, found: Fit) -> Variants:
    """By the cube of the torque, or to a final stiffness."""
    yield Variant()
    for share in _SATURATIONS:
        yield from _at_torques("saturation", share, study, found)


def _at_torques(word: str, share: float, study: Study, found: Fit) -> Variants:
    """An option that is a torque (force of sliding joints), at a share of the largest one on each joint."""
    largest = np.abs(found.response.scene.joints.torque).max(axis=0)
    tables = {
        f"j{joint + 1}": {f"{word}_{'N' if study.robot.prismatic[joint] else 'Nm'}": float(share * largest[joint])}
        for joint in np.flatnonzero(largest > 0)
    }
    if tables:
        yield Variant(tuple(tables), tables)


def _gears(study: Study, model: Model, found: Fit) -> Variants:
    """Errors once or twice a turn, or both; where many poses tell even short waves, also a free curve."""
    turning = np.flatnonzero(~study.robot.prismatic)
    for orders in ([1.0], [2.0], [1.0, 2.0]) if len(turning) else ():
        yield Variant(tuple(f"j{joint + 1}" for joint in turning), {"orders": orders})
    experiment = found.data.experiment
    for joint in turning if len(np.unique(experiment.row_visit)) >= _RICH else ():
        knots = _knots(experiment, int(joint))
        if len(knots) > _COARSE:
            yield Variant((f"j{joint + 1}",), {"knots_deg": np.round(knots / DEG, 3).tolist()})


def _knots(experiment: Experiment, joint: int) -> Floats:
    """Knots of a free curve, rad: no closer than `_APART`, with enough visits between any two."""
    _, first = np.unique(experiment.row_visit, return_index=True)
    ascending = np.sort(experiment.q[experiment.shot_pose[experiment.row_shot[first]], joint])
    knots, at, last = [ascending[0]], 0, len(ascending) - 1
    while True:
        at = max(at + _VISITS, int(np.searchsorted(ascending, knots[-1] + _APART)))
        if at > last - _VISITS or ascending[last] - ascending[at] < _APART:
            return np.append(knots, ascending[last]) if ascending[last] - knots[-1] >= _APART else np.array(knots)
        knots.append(ascending[at])


def _geared(study: Study, model: Model, found: Fit) -> Variants:
    """Turning joints that may be geared together, if there are any."""
    if usual_pairs(study.robot):
        yield Variant()


def _steps(study: Study, model: Model, found: Fit) -> Variants:
    """Times between visits."""
    experiment = found.data.experiment
    if experiment.time is None:
        return
    first = _first_times(experiment.row_visit, experiment.time)
    middles = (first[1:] + first[:-1]) / 2
    inner = middles[2:-2]
    for number in np.unique(np.linspace(0, len(inner) - 1, _STEPS).round().astype(int)) if len(inner) else ():
        yield Variant(options={"time_s": float(inner[number])})


def _first_times(visit: Ints, time: Floats) -> Floats:
    """Time (s) of the first reading of each visit, ascending, from the visit and the time of every row."""
    first = np.full(int(visit.max(initial=-1)) + 1, np.inf)
    np.minimum.at(first, visit, time)
    return np.sort(first[np.isfinite(first)])


def _warming(study: Study, model: Model, found: Fit) -> Variants:
    """By temperature where it was read, else warm-up by several time constants."""
    experiment = found.data.experiment
    if experiment.temperature is not None:
        yield Variant()
    elif experiment.time is not None:
        for hours in _WARM_UP_H:
            yield Variant(options={"driver": "time", "tau_h": hours})


def _yielding(study: Study, model: Model) -> list[int]:
    """Joints that some effect of the model lets yield."""
    return [j for j in range(study.robot.n) if any(axis_compliance(model.effects, study.robot, j))]


_SPECIAL: dict[str, Callable[[Study, Model, Fit], Variants]] = {
    "gravity_compensator": _compensators,
    "joint_hardening": _hardening,
    "joint_windup": _knees,
    "link_compliance": _links,
    "link_mass": _masses,
    "stiction": _sticking,
    "thermal_growth": _warming,
    "tracker_step": _steps,
    "transmission_error": _gears,
    "wrist_coupling": _geared,
}


def detailed(hypothesis: Hypothesis, study: Study, model: Model, experiment: Experiment) -> Hypothesis:
    """The same cause with as many knots as the visits of an experiment allow; itself where it has none.

    Args:
        hypothesis: The cause.
        study: The study with the cause in its model.
        model: Its model.
        experiment: The conditions.
    """
    if "knots_deg" not in hypothesis.options or hypothesis.where is None:
        return hypothesis
    knots = _knots(experiment, int(hypothesis.where[1:]) - 1)
    options = {"knots_deg": np.round(knots / DEG, 3).tolist()}
    others = {place: table for place, table in study.options[hypothesis.name].items() if place != hypothesis.where}
    study = replace(study, options={**study.options, hypothesis.name: others})
    effect = _bound(study, model, hypothesis.name, (hypothesis.where,), options)
    every = np.arange(len(effect.parameters))
    return replace(hypothesis, options=MappingProxyType(options), effect=effect, own=frozen(every, np.int64))


def finer(hypothesis: Hypothesis, study: Study, found: Fit) -> tuple[Hypothesis, ...]:
    """The same cause at the same place with values near the one found so far of a number that no linear test finds."""
    experiment, options = found.data.experiment, hypothesis.options
    scaled = options.keys() & _SCALED
    if scaled:
        changed = [{**options, **{key: options[key] * factor for key in scaled}} for factor in _FINER]
    elif "time_s" in options and experiment.time is not None:
        times = np.unique(experiment.time)
        middles = (times[1:] + times[:-1]) / 2
        near = np.argsort(np.abs(middles - options["time_s"]), kind="stable")[: 3 * _STEPS]
        changed = [{"time_s": float(middles[index])} for index in near]
    else:
        return ()
    places = () if hypothesis.where is None else (hypothesis.where,)
    found_there = []
    for change in changed:
        effect = _bound(study, found.model, hypothesis.name, places, change)
        names = [parameter.name for parameter in effect.parameters]
        own = [names.index(hypothesis.effect.parameters[index].name) for index in hypothesis.own]
        found_there.append(
            replace(hypothesis, options=MappingProxyType(change), effect=effect, own=frozen(own, np.int64))
        )
    return tuple(found_there)
