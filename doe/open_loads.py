"""Visits over all values of their loads: what varies continuously beside the joint values.

Settings of one load are the same load here; what tells them apart is a point of shares of its ranges
(`doe.load_settings`), one set for each shot of a visit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.hung_frames import Hung
from doe.load_settings import setting, shares_of, values_at, values_of
from identify.arrays import Floats, Ints, frozen
from identify.loads import LoadCase
from identify.study import Study

__all__ = ["LoadSpace", "load_space"]


@dataclass(frozen=True, eq=False)
class LoadSpace:
    """The loads of visits, whatever their values.

    Attributes:
        study: The study with one load in the place of all its settings; itself where no load has ranges.
        choices: (C, S) loads of one visit, indices of the loads of ``study``.
        lower: (B, 4) least values of its loads.
        upper: (B, 4) largest values.
        shots: (v,) shot of each variable.
        entries: (v,) which of the four values of its load it is.
    """

    study: Study
    choices: Ints
    lower: Floats
    upper: Floats
    shots: Ints
    entries: Ints

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("lower", "upper"):
            object.__setattr__(self, key, frozen(getattr(self, key)))
        for key in ("choices", "shots", "entries"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))

    @property
    def open(self) -> bool:
        """True where something may be chosen."""
        return len(self.shots) > 0

    def bases(self, study: Study) -> Ints:
        """(L,) load of this space that each load of a study is a setting of."""
        names = [load.name for load in self.study.loads]
        return np.array([names.index(_of(study, load)) for load in study.loads], dtype=np.int64)

    def choice_of(self, study: Study, visit_loads: Ints) -> Ints:
        """(n,) choice of visits with loads (n, S) of a study."""
        base = self.bases(study)[visit_loads]
        return np.asarray((base[:, None] == self.choices).all(axis=2).argmax(axis=1))

    def shares(self, study: Study, visit_loads: Ints) -> Floats:
        """(n, v) shares of visits with loads (n, S) of a study."""
        base = self.bases(study)
        values = np.array([values_of(load) for load in study.loads])
        share = shares_of(self.study, self.lower[base], self.upper[base], values)
        found: Floats = share[visit_loads[:, self.shots], self.entries]
        return found

    def values(self, share: Floats, choice: Ints) -> Floats:
        """(m, S, 4) values of the loads of each shot at shares (m, v)."""
        base = self.choices[choice]
        every = np.zeros((*base.shape, 4))
        every[:, self.shots, self.entries] = share
        lower, upper = (end[base].reshape(-1, 4) for end in (self.lower, self.upper))
        return values_at(self.study, lower, upper, every.reshape(-1, 4)).reshape(every.shape)

    def loads(self, share: Floats, choice: Ints) -> tuple[Ints, tuple[LoadCase, ...]]:
        """Loads (m, S) of visits at shares (m, v), as indices of load cases that are all different."""
        base = self.choices[choice]
        rows = np.column_stack([base.reshape(-1, 1), self.values(share, choice).reshape(-1, 4)])
        kinds, kind = np.unique(rows, axis=0, return_inverse=True)
        stated = self.study.loads
        cases = tuple(setting(stated[int(row[0])], stated[int(row[0])].name, row[1:]) for row in kinds)
        return kind.reshape(base.shape), cases

    def hung(self, share: Floats, choice: Ints) -> list[tuple[Ints, Hung]]:
        """What hangs at visits, for a screen of the study of this space, which knows one set of values a pose.

        Returns:
            Shots (s,) that may be looked at together, and what hangs there; every shot once.
        """
        values, base = self.values(share, choice), self.choices[choice]
        loose = np.unique(self.shots)
        fixed = np.setdiff1d(np.arange(base.shape[1]), loose)
        groups = [loose[i : i + 1] for i in range(len(loose))] or [fixed[:0]]
        groups[0] = np.concatenate([fixed, groups[0]])
        stated = np.array([values_of(load) for load in self.study.loads])
        found = []
        for shots in groups:
            every = np.tile(stated, (len(base), 1, 1))
            every[np.arange(len(base)), base[:, shots[-1]]] = values[:, shots[-1]]
            found.append((shots, Hung(every[..., 0], every[..., 1:])))
        return found


def load_space(study: Study, choices: Ints) -> LoadSpace:
    """The loads of visits of a study, settings of one load taken together.

    Args:
        study: The study, with settings in the place of loads with ranges.
        choices: (C, S) its choices of loads.
    """
    names = list(dict.fromkeys(_of(study, load) for load in study.loads))
    first = [next(load for load in study.loads if _of(study, load) == name) for name in names]
    spans = [study.load_ranges.get(load.name) for load in first]
    pairs = zip(first, spans, strict=True)
    ends = [[values_of(load)] * 2 if span is None else [span.lower, span.upper] for load, span in pairs]
    lower, upper = np.array(ends).swapaxes(0, 1)
    place = np.array([names.index(_of(study, load)) for load in study.loads], dtype=np.int64)
    merged = np.unique(place[choices], axis=0)
    loose = (upper > lower)[merged].any(axis=0)
    shots, entries = np.nonzero(loose)
    if not len(shots):
        return LoadSpace(study, choices, lower, upper, shots, entries)
    loads = tuple(replace(load, name=name) for load, name in zip(first, names, strict=True))
    return LoadSpace(replace(study, loads=loads, load_costs=()), merged, lower, upper, shots, entries)


def _of(study: Study, load: LoadCase) -> str:
    """Name of the load that a load is a setting of; its own without ranges."""
    span = study.load_ranges.get(load.name)
    return load.name if span is None else span.of
