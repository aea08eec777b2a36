"""Settings of a load whose mass and attach point are open: which of them candidates try, and what can be hung.

Values are rows (mass in kg, attach point x, y, z in m). A *share* says where a value lies in its range, 0 to 1; that of
a mass is counted up to the largest that payload and payload diagram allow at the attach point, so that a search may
follow their limit. A setting is a load of its own: everything that looks at loads looks at settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from types import MappingProxyType

import numpy as np

from doe.statics import allowed_mass
from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.loads import LoadCase, LoadRange
from identify.study import Study
from identify.units import MM

__all__ = [
    "KG_STEP",
    "MM_STEP",
    "as_hung",
    "setting",
    "shares_of",
    "values_at",
    "values_of",
    "with_setting",
    "with_settings",
    "with_used_first",
]

KG_STEP, MM_STEP = 0.1, 1.0  # what values are rounded to
_DRAWN = 256  # points of the sequence that settings are taken from


def values_of(load: LoadCase) -> Floats:
    """(4,) values of a load."""
    return np.append(load.mass, load.attach)


def setting(load: LoadCase, name: str, values: Floats) -> LoadCase:
    """The load at other values (4,), under another name."""
    return replace(load, name=name, mass=float(values[0]), attach=values[1:])


def values_at(study: Study, lower: Floats, upper: Floats, share: Floats) -> Floats:
    """Values (m, 4) at shares (m, 4) of ranges (m, 4)."""
    values: Floats = lower + share * (upper - lower)
    most = allowed_mass(study, values[:, 1:], lower[:, 0], upper[:, 0])
    values[:, 0] = lower[:, 0] + share[:, 0] * (most - lower[:, 0])
    return values


def shares_of(study: Study, lower: Floats, upper: Floats, values: Floats) -> Floats:
    """Shares (m, 4) of values (m, 4) in ranges (m, 4); 0 where there is no choice."""
    largest = np.array(upper)
    largest[:, 0] = allowed_mass(study, values[:, 1:], lower[:, 0], upper[:, 0])
    room = largest - lower
    share = np.where(room > 0.0, (values - lower) / np.where(room > 0.0, room, 1.0), 0.0)
    return np.asarray(np.clip(share, 0.0, 1.0))


def as_hung(study: Study, span: LoadRange, values: Floats) -> Floats:
    """Values (m, 4) as a study file holds them: whole mm, tenths of a kg, inside the range and what may be carried.

    The ends of a range are taken as they stand in the file.
    """
    lower, upper = span.lower, span.upper
    place = np.clip(np.rint(values[:, 1:] / (MM_STEP * MM)) * MM_STEP * MM, lower[1:], upper[1:])
    ends = (np.broadcast_to(end[0], len(values)) for end in (lower, upper))
    most = allowed_mass(study, place, *ends)
    mass = np.rint(values[:, 0] / KG_STEP) * KG_STEP
    mass = np.where(mass > most, np.floor(most / KG_STEP + 1e-6) * KG_STEP, mass)
    return np.column_stack([np.clip(np.round(mass, 6), lower[0], upper[0]), place])


def with_settings(study: Study, seed: int) -> Study:
    """The study in which settings take the place of loads with ranges, the nominal values first.

    Up to half of the settings are corners: of the attach point under the largest mass that may be carried there. The
    others are spread over the range by a scrambled Sobol sequence, every second one under the largest mass.

    Args:
        study: The study as stated.
        seed: Of the sequence.

    Raises:
        InputError: The model holds a ``load_level`` of a load with ranges, which would be another one for each setting.
    """
    if not study.load_ranges:
        return study
    _check_effects(study)
    places: dict[str, list[LoadCase]] = {load.name: [load] for load in study.loads}
    spans: dict[str, LoadRange] = {}
    for name, span in study.load_ranges.items():
        load = places[name][0]
        found = _settings(study, span, values_of(load), study.plan.settings_per_load, np.random.default_rng(seed))
        names = _names(name, len(found), set(places) | set(spans))
        places[name] = [setting(load, new, values) for new, values in zip(names, found, strict=True)]
        spans |= dict.fromkeys(names, span)
    costs = [cost for name, cost in zip(places, study.load_costs, strict=False) for _ in places[name]]
    chosen = tuple(load.name for name in study.plan.loads for load in places[name])
    return replace(
        study,
        loads=tuple(load for loads in places.values() for load in loads),
        load_ranges=MappingProxyType(spans),
        load_costs=tuple(costs),
        plan=replace(study.plan, loads=chosen),
    )


def with_setting(study: Study, base: int, values: Floats) -> tuple[Study, int]:
    """The study with one more setting, (4,) values, of the load ``base``; and its index, which may be an old one."""
    span = study.load_ranges[study.loads[base].name]
    same = [name for name, other in study.load_ranges.items() if other.of == span.of]
    for name in same:
        if np.array_equal(values_of(study.loads[study.load_index(name)]), values):
            return study, study.load_index(name)
    name = _names(span.of, len(same) + 1, {load.name for load in study.loads} - set(same))[-1]
    ranges: Mapping[str, LoadRange] = {**study.load_ranges, name: span}
    costs = (*study.load_costs, *study.load_costs[base : base + 1])
    loads = (*study.loads, setting(study.loads[base], name, values))
    return replace(study, loads=loads, load_ranges=MappingProxyType(dict(ranges)), load_costs=costs), len(loads) - 1


def with_used_first(study: Study, used: Ints) -> Study:
    """The study whose settings are numbered anew: those of the loads ``used`` (indices) first, then the others."""
    order = [*used.tolist(), *np.setdiff1d(np.arange(len(study.loads)), used).tolist()]
    numbered: dict[str, list[int]] = {}
    for index in order:
        span = study.load_ranges.get(study.loads[index].name)
        if span is not None:
            numbered.setdefault(span.of, []).append(index)
    loads, ranges = list(study.loads), dict[str, LoadRange]()
    fixed = {load.name for load in loads} - set(study.load_ranges)
    for of, indices in numbered.items():
        for index, name in zip(indices, _names(of, len(indices), fixed | set(ranges)), strict=True):
            ranges[name] = study.load_ranges[loads[index].name]
            loads[index] = replace(loads[index], name=name)
    new = {old.name: load.name for old, load in zip(study.loads, loads, strict=True)}
    plan = replace(study.plan, loads=tuple(new[name] for name in study.plan.loads))
    return replace(study, loads=tuple(loads), load_ranges=MappingProxyType(ranges), plan=plan)


def _settings(study: Study, span: LoadRange, nominal: Floats, count: int, rng: np.random.Generator) -> Floats:
    """(V, 4) different settings of one load as they are hung, at most ``count``, the nominal values first."""
    corners = _corners(span.open)[: count // 2]
    share = np.concatenate([corners, _spread(span.open, rng)])
    lower, upper = (np.broadcast_to(end, share.shape) for end in (span.lower, span.upper))
    found = as_hung(study, span, values_at(study, lower, upper, share))
    every = np.vstack([nominal, found])
    first = np.sort(np.unique(every, axis=0, return_index=True)[1])
    return np.asarray(every[first][:count])


def _corners(free: np.ndarray) -> Floats:
    """(c, 4) shares at the corners of the attach point under the largest mass, those that lie far apart first.

    Without a choice of the point: the largest and the least mass.
    """
    if not free[1:].any():
        return np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    ends = [(0.0, 1.0) if axis else (0.0,) for axis in free[1:]]
    corners = np.array([[1.0, *corner] for corner in product(*ends)])
    even = corners[:, 1:].sum(axis=1) % 2 == 0  # no two of these share an edge
    return np.concatenate([corners[even], corners[~even]])


def _spread(free: np.ndarray, rng: np.random.Generator) -> Floats:
    """(256, 4) shares spread over what is open; every second one under the largest mass where the point is open."""
    from scipy.stats import qmc

    share = np.zeros((_DRAWN, 4))
    share[:, free] = qmc.Sobol(int(free.sum()), scramble=True, seed=rng).random(_DRAWN)
    if free[0] and free[1:].any():
        share[::2, 0] = 1.0
    return share


def _names(of: str, count: int, taken: set[str]) -> list[str]:
    """Ids of the settings of a load: its own with a number, by more dots where other loads are called so."""
    joint = "."
    while any(f"{of}{joint}{number + 1}" in taken for number in range(count)):
        joint += "."
    return [f"{of}{joint}{number + 1}" for number in range(count)]


def _check_effects(study: Study) -> None:
    """Refuse unknowns that every setting would have of its own."""
    for name in study.load_ranges:
        for effect in {"load_level", f"load_level@{name}"} & set(study.effects):
            raise InputError(
                f"{study.path}: [model] effects: {effect} is an unknown of each single load, and every setting of "
                f"{name} (mass_range_kg, attach_range_mm) would have its own; name loads without ranges "
                "(load_level@ID), take load_scale, or leave the ranges out"
            )
