"""What stands in a folder of results: JSON of the commands, and the tables beside it that the report shows."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np

from identify.arrays import Floats, Ints
from identify.csv_file import CsvTable, read_csv
from identify.errors import InputError
from identify.problems import Problems
from identify.results import SCHEMA, recover

__all__ = ["COMMANDS", "Entry", "Folder", "Residuals", "Targets", "read_folder"]

#: Results that a report shows, in the order in which they are made.
COMMANDS = ("plan", "evaluate", "identify", "diagnose", "compensate", "predict", "reduce")
_RESIDUALS = "residuals.csv"
_TARGETS = "compensated.csv"
_AXES = ("x", "y", "z")


class Entry:
    """A table of a result file; a key that is missing is an error that names file and key."""

    def __init__(self, file: str, data: Mapping[str, Any], path: str = "") -> None:
        """Take the data of a file (``path``: where in it, for messages)."""
        self._file, self._data, self._path = file, data, path

    def __getitem__(self, key: str) -> Any:
        """The value of a key; tables and lists of tables become entries.

        Raises:
            InputError: There is no such key.
        """
        if key not in self._data:
            raise InputError(f"{self._file}: no key {self._path}{key}; made by another version? run its command again")
        return self._wrapped(self._data[key], f"{self._path}{key}")

    def get(self, key: str, default: Any = None) -> Any:
        """The value of a key that may be missing."""
        return self[key] if key in self._data else default

    def items(self) -> Iterator[tuple[str, Any]]:
        """Keys and values."""
        return ((key, self[key]) for key in self._data)

    def table(self, key: str) -> Entry:
        """A table that must be there.

        Raises:
            InputError: It is missing or no table.
        """
        found: Entry = self._as(self[key], key, Entry, "a table")
        return found

    def tables(self, key: str) -> list[Entry]:
        """A list of tables that must be there.

        Raises:
            InputError: It is missing or no such list.
        """
        listed = self._as(self[key], key, list, "a list")
        return [self._as(item, f"{key}[{i}]", Entry, "a table") for i, item in enumerate(listed)]

    def texts(self, key: str) -> list[str]:
        """A list as texts.

        Raises:
            InputError: It is missing or no list.
        """
        return [str(item) for item in self._as(self[key], key, list, "a list")]

    def number(self, key: str) -> float:
        """A number; null becomes nan.

        Raises:
            InputError: It is missing or no number.
        """
        value = self[key]
        return float("nan") if value is None else float(self._as(value, key, int | float, "a number"))

    def numbers(self, key: str) -> Floats:
        """A list of numbers; null becomes nan.

        Raises:
            InputError: It is missing or no such list.
        """
        listed = self._as(self[key], key, list, "a list of numbers")
        if not all(item is None or isinstance(item, int | float) for item in listed):
            raise InputError(f"{self._file}: {self._path}{key}: a list of numbers expected")
        return np.array([np.nan if item is None else item for item in listed], dtype=np.float64)

    def _as(self, value: Any, key: str, kind: type | UnionType, words: str) -> Any:
        if not isinstance(value, kind):
            raise InputError(f"{self._file}: {self._path}{key}: {words} expected, found {str(value)[:60]!r}")
        return value

    def _wrapped(self, value: Any, path: str) -> Any:
        if isinstance(value, dict):
            return Entry(self._file, value, f"{path}.")
        if isinstance(value, list):
            return [self._wrapped(item, f"{path}[{number}]") for number, item in enumerate(value)]
        return value


@dataclass(frozen=True, eq=False)
class Residuals:
    """The table of residuals, without faulty rows.

    Attributes:
        pose, load, marker: (R,) ids.
        shot: (R,) number of pose, load and repeat, from 0.
        position: (R, 3) marker, base frame, mm.
        before, after: (R, 3) residual, mm.
        quantities: (R,) values by column name: joint values, torques, time, ...
    """

    pose: np.ndarray
    load: np.ndarray
    marker: np.ndarray
    shot: Ints
    position: Floats
    before: Floats
    after: Floats
    quantities: Mapping[str, Floats]

    def by_shot(self, values: Floats) -> Floats:
        """Mean (S, ...) over the markers of each shot."""
        total = np.zeros((int(self.shot.max(initial=-1)) + 1, *values.shape[1:]))
        np.add.at(total, self.shot, values)
        count = np.bincount(self.shot).reshape(-1, *[1] * (values.ndim - 1))
        mean: Floats = total / count
        return mean


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of a program before and after compensation.

    Attributes:
        name: (T,) ids.
        deflection: (T,) predicted error before, mm.
        residual: (T,) predicted error after, mm.
        radius95: (T,) radius of what the parameters leave open, mm.
        extrapolated: (T,) True outside the calibrated poses and loads.
    """

    name: np.ndarray
    deflection: Floats
    residual: Floats
    radius95: Floats
    extrapolated: np.ndarray


@dataclass(frozen=True, eq=False)
class Folder:
    """The results of a folder.

    Attributes:
        results: Content by command.
        residuals: None if the table is not there or has no rows without faults.
        next_poses: The poses to measure next, None if there are none.
        plans: The files of the plan by name, those that are there.
        compensated: The compensated targets, None if the table is not there.
        inputs: Every file that was read.
    """

    results: Mapping[str, Entry]
    residuals: Residuals | None
    next_poses: CsvTable | None
    plans: Mapping[str, CsvTable]
    compensated: Targets | None
    inputs: tuple[Path, ...]


def read_folder(path: Path) -> Folder:
    """Read all results of a folder.

    Raises:
        InputError: No folder, no result in it, a result of another schema, or a file that is malformed.
    """
    if not path.is_dir():
        what = "is a file" if path.exists() else "does not exist"
        raise InputError(f"{path}: {what}; a folder with results expected")
    recover(path)
    files = {command: path / f"{command}.json" for command in COMMANDS if (path / f"{command}.json").is_file()}
    if not files:
        raise InputError(
            f"{path}: holds no results; expected is at least one of {', '.join(f'{c}.json' for c in COMMANDS)}, as the "
            "commands write them with --out"
        )
    results = {command: _result(file) for command, file in files.items()}
    inputs = list(files.values())
    residuals, further = None, None
    if "diagnose" in results:
        if (path / _RESIDUALS).is_file():
            inputs.append(path / _RESIDUALS)
            residuals = _residuals(path / _RESIDUALS)
        further = _next_poses(path, results["diagnose"])
        inputs += [] if further is None else [further.path]
    plans = _plans(path, results["plan"]) if "plan" in results else {}
    inputs += [plan.path for plan in plans.values()]
    compensated = None
    if "compensate" in results and (path / _TARGETS).is_file():
        inputs.append(path / _TARGETS)
        compensated = _targets(path / _TARGETS)
    return Folder(results, residuals, further, plans, compensated, tuple(inputs))


def _result(file: Path) -> Entry:
    """One result file.

    Raises:
        InputError: It cannot be read, is no JSON, or has another schema.
    """
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{file} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: no JSON: {error}") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        found = data.get("schema") if isinstance(data, dict) else None
        raise InputError(
            f"{file}: schema {found!r} found, this version reads {SCHEMA}; make the result again with this version"
        )
    return Entry(str(file), data)


def _residuals(file: Path) -> Residuals | None:
    """The table of residuals.

    Raises:
        InputError: Columns are missing or cells are no numbers.
    """
    table = read_csv(file)
    errors = [f"{when}_{axis}_mm" for when in ("before", "after") for axis in _AXES]
    places = [f"{axis}_mm" for axis in _AXES]
    table.require(["pose", "load", "marker", "repeat", "line", *places, *errors, "faulty"])
    known = {"pose", "load", "marker", "repeat", "line", "faulty", *places, *errors}
    problems = Problems(file)
    others = [name for name in table.cells if name not in known]
    good = np.flatnonzero(table.numbers(["faulty"], problems)[:, 0] == 0)
    numbers = table.numbers([*places, *errors, *others], problems)[good]
    problems.settle()
    if not len(good):
        return None
    pose, load, marker, repeat = (np.array(table.cells[n])[good] for n in ("pose", "load", "marker", "repeat"))
    shots: dict[tuple[str, ...], int] = {}
    shot = [shots.setdefault(key, len(shots)) for key in zip(pose, load, repeat, strict=True)]
    quantities = {name: numbers[:, 9 + number] for number, name in enumerate(others)}
    return Residuals(pose, load, marker, np.array(shot), numbers[:, :3], numbers[:, 3:6], numbers[:, 6:9], quantities)


def _next_poses(path: Path, diagnosis: Entry) -> CsvTable | None:
    """The plan that a diagnosis names, if it stands in the folder."""
    name = diagnosis.get("next_poses")
    return read_csv(path / name) if isinstance(name, str) and _beside(path, name) else None


def _beside(path: Path, name: str) -> bool:
    """True for the name of a file in the folder itself."""
    return Path(name).name == name and (path / name).is_file()


def _plans(path: Path, plan: Entry) -> dict[str, CsvTable]:
    """The files of a plan that have visits: of one robot, or of each of two arms.

    Raises:
        InputError: A file has no poses or loads.
    """
    arms = {"plan.csv": plan.get("poses")}
    if plan.get("arms") is not None:
        arms = {f"plan_{arm}.csv": visits for arm, visits in plan.table("arms").items()}
    plans = {name: read_csv(path / name) for name, visits in arms.items() if visits and _beside(path, name)}
    for table in plans.values():
        table.require(["pose", "load"])
    return plans


def _targets(file: Path) -> Targets:
    """The table of compensated targets.

    Raises:
        InputError: Columns are missing or cells are no numbers.
    """
    table = read_csv(file)
    columns = ["deflection_mm", "residual_mm", "residual_ci95_mm", "extrapolated"]
    table.require(["target", *columns])
    problems = Problems(file)
    before, after, radius, outside = table.numbers(columns, problems).T
    problems.settle()
    return Targets(np.array(table.cells["target"]), before, after, radius, outside != 0)
