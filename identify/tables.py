"""Plans and measurements: from CSV files to records in SI, and back.

The formats are described in ``docs/formats.md``.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.csv_file import CsvTable, csv_text, read_csv
from identify.experiment import Experiment, Measurements
from identify.plausibility import joint_mistakes, unit_mistakes
from identify.problems import Problems
from identify.row_groups import class_firsts, classes, occurrence, run_firsts, runs, take
from identify.study import Study
from identify.units import MM

__all__ = [
    "POSITION",
    "QUATERNION",
    "WRENCH",
    "PlanTable",
    "joint_columns",
    "load_measurements",
    "load_plan",
    "measurements_csv",
    "plan_csv",
    "plan_experiment",
    "predicted_csv",
]

_log = logging.getLogger("elastocal")

POSITION = ("x_mm", "y_mm", "z_mm")
WRENCH = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
QUATERNION = ("qw", "qx", "qy", "qz")


@dataclass(frozen=True, eq=False)
class PlanTable:
    """Rows of a plan in the order to be measured; rows of one visit stand together.

    Attributes:
        visits: (V,) names of the poses, in the order of their first rows.
        row_visit: (P,) index into ``visits``.
        row_load: (P,) index into the loads of the study.
        row_repeat: (P,) number of the reading of this pose and load.
        q: (P, n) joint values, rad or m.
        lines: (P,) line of each row in the file (the header is line 1).
        wrench: (P, 6) N and Nm, see `Experiment`, or None.
        approach: (P, n) sign of the last motion of each joint, or None.
        time: (P,) s, or None.
        temperature: (P,) degC, or None.
        source: Path of the file.
        ignored_columns: Columns of the file that were not used.
    """

    visits: tuple[str, ...]
    row_visit: Ints
    row_load: Ints
    row_repeat: Ints
    q: Floats
    lines: Ints
    wrench: Floats | None = None
    approach: Floats | None = None
    time: Floats | None = None
    temperature: Floats | None = None
    source: str = ""
    ignored_columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("row_visit", "row_load", "row_repeat", "lines"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))
        for key in ("q", "wrench", "approach", "time", "temperature"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class _Rows:
    """What plans and measurements share, by row of the file; units of the file."""

    visit: Ints
    names: tuple[str, ...]
    load: Ints
    q: Floats
    wrench: Floats | None
    approach: Floats | None
    time: Floats | None
    temperature: Floats | None

    def values(self, *more: Floats | None) -> Floats:
        """(R, k) every number of a row beside its ids."""
        parts = [self.q, self.wrench, self.approach, self.time, self.temperature, *more]
        return np.column_stack([part for part in parts if part is not None])


def joint_columns(study: Study) -> list[str]:
    """Names of the joint columns: ``q1_deg``, or ``q1_mm`` where a joint slides."""
    return [f"q{i + 1}_{'mm' if slides else 'deg'}" for i, slides in enumerate(study.robot.prismatic)]


def _approach_columns(study: Study) -> list[str]:
    """Names of the columns that tell where each joint came from."""
    return [f"approach{i + 1}" for i in range(study.robot.n)]


def _known_columns(study: Study) -> list[str]:
    """Columns that plans and measurements share."""
    return [
        "pose",
        "load",
        "repeat",
        *joint_columns(study),
        "time_s",
        "temperature_C",
        *_approach_columns(study),
        *WRENCH,
    ]


# ---- measurements


def load_measurements(path: str | Path, study: Study) -> Measurements:
    """Read and check a measurement file.

    The order of its rows does not matter: visits come sorted by name, shots by load and repeat, rows by
    marker. Rows that stand there twice with the same numbers are used once, with a warning.

    Args:
        path: The file.
        study: The study that was measured.

    Raises:
        InputError: The file as a whole is wrong; the message holds the problems with their lines.
    """
    table = read_csv(path)
    problems = Problems(table.path)
    table.require(["pose", "load", "marker", "repeat", *joint_columns(study), *POSITION])
    ignored = table.warn_unknown([*_known_columns(study), "marker", *POSITION, *QUATERNION])
    rows = _rows(table, study, problems)
    marker = table.choices("marker", study.markers.names, problems)
    repeat = table.integers("repeat", problems)
    position = table.numbers(POSITION, problems)
    quaternion = _quaternions(table, problems)
    problems.settle()

    keep = _without_copies(table, (rows.visit, rows.load, repeat, marker), rows.values(position, quaternion), problems)
    _check_unloaded(table, rows, study, problems)
    for message in unit_mistakes(study, rows.q * study.joint_units, marker, position * MM):
        problems.add("whole file", message)
    problems.settle()

    pose = classes(rows.visit, *rows.q.T)
    force = np.zeros_like(pose) if rows.wrench is None else classes(*rows.wrench.T)
    keep = keep[np.lexsort([key[keep] for key in (marker, force, pose, repeat, rows.load, rows.visit)])]
    shot = runs(rows.visit[keep], rows.load[keep], repeat[keep], pose[keep], force[keep])
    first = keep[run_firsts(shot)]
    experiment = Experiment(
        visits=rows.names,
        q=rows.q[class_firsts(pose)] * study.joint_units,
        loads=study.loads,
        markers=study.markers,
        shot_visit=rows.visit[first],
        shot_pose=pose[first],
        shot_load=rows.load[first],
        shot_repeat=repeat[first],
        row_shot=shot,
        row_marker=marker[keep],
        wrench=take(rows.wrench, first),
        approach=_visit_approach(rows.approach, rows.visit, rows.names, table.path),
        time=take(rows.time, keep),
        temperature=take(rows.temperature, keep),
    )
    return Measurements(
        experiment=experiment,
        positions=position[keep] * MM,
        lines=table.lines[keep],
        quaternions=take(quaternion, keep),
        source=str(path),
        ignored_columns=ignored,
    )


def _rows(table: CsvTable, study: Study, problems: Problems) -> _Rows:
    """The columns that plans and measurements share; visits are numbered by sorted name."""
    pose = table.ids("pose", problems)
    known = (
        "settings that a plan chose stand in its planned.toml; this study has" if study.load_ranges else "the study has"
    )
    names = sorted(set(pose))
    number = {name: i for i, name in enumerate(names)}
    return _Rows(
        visit=np.fromiter((number[name] for name in pose), np.int64, len(pose)),
        names=tuple(names),
        load=table.choices("load", [load.name for load in study.loads], problems, known=known),
        q=table.numbers(joint_columns(study), problems),
        wrench=table.numbers(WRENCH, problems) if table.group(WRENCH) else None,
        approach=_approach(table, study, problems),
        time=table.numbers(["time_s"], problems)[:, 0] if "time_s" in table.cells else None,
        temperature=table.numbers(["temperature_C"], problems)[:, 0] if "temperature_C" in table.cells else None,
    )


def _approach(table: CsvTable, study: Study, problems: Problems) -> Floats | None:
    """(R, n) signs of the last motion, or None where the columns are missing."""
    names = _approach_columns(study)
    if not table.group(names):
        return None
    signs = [table.integers(name, problems, allowed=(-1, 0, 1)) for name in names]
    return np.column_stack(signs).astype(np.float64)


def _quaternions(table: CsvTable, problems: Problems) -> Floats | None:
    """(R, 4) unit quaternions with w >= 0, or None where the columns are missing."""
    if not table.group(QUATERNION):
        return None
    raw = table.numbers(QUATERNION, problems)
    norm = np.linalg.norm(raw, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > 1e-3)
    if len(wrong):
        row, count = wrong[0], len(wrong)
        what = f"length {norm[row]:.6g}, must be 1 within 0.001 (in {count} row{'s'[: count > 1]})"
        problems.add(f"line {table.lines[row]}, qw, qx, qy, qz", what)
    norm[wrong] = 1.0
    sign = np.where(raw[:, :1] < 0, -1.0, 1.0)
    unit: Floats = sign * raw / norm[:, None]
    return unit


def _without_copies(table: CsvTable, key: Sequence[Ints], values: Floats, problems: Problems) -> Ints:
    """Rows to keep: the first of every key; rows of one key with different numbers are noted."""
    order = np.lexsort([table.lines, *reversed(key)])
    group = runs(*(part[order] for part in key))
    copy = np.append(False, group[1:] == group[:-1])
    if not copy.any():
        return np.arange(len(order))
    first = order[run_firsts(group)][group]
    differs = copy & (values[order] != values[first]).any(axis=1)
    columns = "pose, load, marker, repeat" if len(key) == 4 else "pose, load, repeat"
    for i in np.flatnonzero(differs)[:5]:
        lines = f"lines {table.lines[first[i]]} and {table.lines[order[i]]}"
        problems.add(lines, f"the same {columns} ({_cells(table, first[i], columns)}) with different numbers")
    if differs.sum() > 5:
        problems.add("whole file", f"{differs.sum() - 5} more rows contradict another one")
    if not differs.any():
        shown = ", ".join(str(line) for line in table.lines[order[copy]][:10])
        _log.warning("%s: %d rows stand there twice and are used once: lines %s", table.path, copy.sum(), shown)
    return np.sort(order[~copy])


def _cells(table: CsvTable, row: int, columns: str) -> str:
    """The ids of a row."""
    return ", ".join(table.cells[name][row] for name in columns.split(", "))


def _check_unloaded(table: CsvTable, rows: _Rows, study: Study, problems: Problems) -> None:
    """Where wrenches were measured, rows of the unloaded state hold zeros."""
    unloaded = [load.name for load in study.loads if load.unloaded]
    if rows.wrench is None or not unloaded or len(study.loads) == 1:
        return
    name = "L0" if "L0" in unloaded else unloaded[0]
    wrong = np.flatnonzero((rows.load == study.load_index(name)) & rows.wrench.any(axis=1))
    if len(wrong):
        count = len(wrong)
        what = f"rows of the unloaded state {name} must hold zeros (in {count} row{'s'[: count > 1]})"
        problems.add(f"line {table.lines[wrong[0]]}, {', '.join(WRENCH)}", what)


def _visit_approach(approach: Floats | None, visit: Ints, names: Sequence[str], path: Path) -> Floats | None:
    """(V, n) the sign that most rows of a visit state; with a warning where they differ."""
    if approach is None:
        return None
    counts = np.zeros((len(names), approach.shape[1], 3), dtype=np.int64)
    np.add.at(counts, (visit[:, None], np.arange(approach.shape[1]), approach.astype(np.int64) + 1), 1)
    mixed = np.flatnonzero(((counts > 0).sum(axis=2) > 1).any(axis=1))
    if len(mixed):
        shown = ", ".join(names[i] for i in mixed[:10])
        _log.warning("%s: rows of one pose state different approaches, the most frequent one is used: %s", path, shown)
    most: Floats = counts.argmax(axis=2) - 1.0
    return most


# ---- plans


def load_plan(path: str | Path, study: Study) -> PlanTable:
    """Read and check a plan, or any set of poses.

    Rows of one pose are put together at the place of its first row. A measurement file is a plan too:
    rows that differ in their marker only are one row.

    Args:
        path: The file.
        study: The study that is planned.

    Raises:
        InputError: The file as a whole is wrong; the message holds the problems with their lines.
    """
    table = read_csv(path)
    problems = Problems(table.path)
    table.require(["pose", "load", *joint_columns(study)])
    ignored = table.warn_unknown([*_known_columns(study), "marker"])
    rows = _rows(table, study, problems)
    marker = table.choices("marker", study.markers.names, problems) if "marker" in table.cells else None
    repeat = table.integers("repeat", problems) if "repeat" in table.cells else None
    problems.settle()

    rows = _in_order(rows)
    if repeat is None:
        repeat = occurrence(rows.visit, rows.load, *([] if marker is None else [marker]))
    keys = (rows.visit, rows.load, repeat)
    if marker is None:
        keep = _without_copies(table, keys, rows.values(), problems)
    else:
        keep = np.sort(class_firsts(classes(*keys, *rows.q.T)))
    _check_unloaded(table, rows, study, problems)
    for message in joint_mistakes(study, rows.q * study.joint_units):
        problems.add("whole file", message)
    problems.settle()

    keep = keep[np.argsort(rows.visit[keep], kind="stable")]
    return PlanTable(
        visits=rows.names,
        row_visit=rows.visit[keep],
        row_load=rows.load[keep],
        row_repeat=repeat[keep],
        q=rows.q[keep] * study.joint_units,
        lines=table.lines[keep],
        wrench=take(rows.wrench, keep),
        approach=take(rows.approach, keep),
        time=take(rows.time, keep),
        temperature=take(rows.temperature, keep),
        source=str(path),
        ignored_columns=ignored,
    )


def plan_experiment(plan: PlanTable, study: Study) -> Experiment:
    """The conditions of a plan in which every row reads all markers of the study, in the order of the plan."""
    shots, markers = len(plan.lines), len(study.markers.names)
    label = classes(plan.row_visit, *plan.q.T)
    first = class_firsts(label)
    place = np.argsort(np.argsort(first))  # number the poses in the order of the plan
    return Experiment(
        visits=plan.visits,
        q=plan.q[np.sort(first)],
        loads=study.loads,
        markers=study.markers,
        shot_visit=plan.row_visit,
        shot_pose=place[label],
        shot_load=plan.row_load,
        shot_repeat=plan.row_repeat,
        row_shot=np.repeat(np.arange(shots), markers),
        row_marker=np.tile(np.arange(markers), shots),
        wrench=plan.wrench,
        approach=_visit_approach(plan.approach, plan.row_visit, plan.visits, Path(plan.source)),
        time=None if plan.time is None else np.repeat(plan.time, markers),
        temperature=None if plan.temperature is None else np.repeat(plan.temperature, markers),
    )


def _in_order(rows: _Rows) -> _Rows:
    """The same rows with visits numbered by their first appearance."""
    first = class_firsts(rows.visit)
    order = np.argsort(first)
    place = np.argsort(order)
    return replace(rows, visit=place[rows.visit], names=tuple(rows.names[i] for i in order))


# ---- back to files


def plan_csv(experiment: Experiment, study: Study) -> str:
    """Text of ``plan.csv``: one row a visit and load, in the order of the shots.

    Where the experiment states when a shot is taken (at its first row), from where a pose is approached, or a wrench,
    their columns follow.
    """
    shot = np.arange(len(experiment.shot_visit))
    header, columns = _shot_columns(experiment, study, shot)
    if experiment.time is not None:
        first = np.searchsorted(experiment.row_shot, shot)
        _append(header, columns, [(["time_s"], experiment.time[first][:, None])])
    _append(header, columns, _conditions(experiment, study, shot))
    return csv_text(header, columns)


def measurements_csv(data: Measurements, study: Study) -> str:
    """Text of ``measurements.csv``, with the optional columns that the data have."""
    e = data.experiment
    header, columns = _shot_columns(e, study, e.row_shot)
    header[2:2] = ["marker", "repeat"]
    columns[2:2] = [[e.markers.names[i] for i in e.row_marker], e.shot_repeat[e.row_shot]]
    _append(
        header,
        columns,
        [
            (POSITION, data.positions / MM),
            (["time_s"], e.time if e.time is None else e.time[:, None]),
            (["temperature_C"], e.temperature if e.temperature is None else e.temperature[:, None]),
            *_conditions(e, study, e.row_shot),
            (QUATERNION, data.quaternions),
        ],
    )
    return csv_text(header, columns)


_Block = tuple[Sequence[str], np.ndarray | None]  # names of columns and their values, if there are any


def _conditions(e: Experiment, study: Study, shot: Ints) -> list[_Block]:
    """How poses are approached and what was measured to act, for the given shots."""
    approach = None if e.approach is None else e.approach[e.shot_visit[shot]].astype(np.int64)
    return [(_approach_columns(study), approach), (WRENCH, None if e.wrench is None else e.wrench[shot])]


def _append(header: list[str], columns: list[Sequence[str] | np.ndarray], blocks: list[_Block]) -> None:
    """Put the blocks that exist behind the columns of a table."""
    for names, block in blocks:
        if block is not None:
            header += names
            columns += list(block.T)


def predicted_csv(experiment: Experiment, positions: Floats, std: Floats) -> str:
    """Text of ``predicted.csv``; ``positions`` (R, 3) and their ``std`` (R, 3), m, frame of the measurements."""
    e = experiment
    ids = [
        [e.visits[i] for i in e.row_visit],
        [e.loads[i].name for i in e.shot_load[e.row_shot]],
        [e.markers.names[i] for i in e.row_marker],
    ]
    header = ["pose", "load", "marker", *POSITION, "sx_mm", "sy_mm", "sz_mm"]
    return csv_text(header, [*ids, *(positions / MM).T, *(std / MM).T])


def _shot_columns(e: Experiment, study: Study, shot: Ints) -> tuple[list[str], list[Sequence[str] | np.ndarray]]:
    """Names and columns of pose, load and joint values for the given shots."""
    pose = [e.visits[i] for i in e.shot_visit[shot]]
    load = [e.loads[i].name for i in e.shot_load[shot]]
    q = (e.q / study.joint_units)[e.shot_pose[shot]]
    return ["pose", "load", *joint_columns(study)], [pose, load, *q.T]
