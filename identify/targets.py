"""Targets of a program and their compensated commands: CSV files to records in SI, and back.

The formats are described in ``docs/formats.md``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identify.arrays import Floats
from identify.compensation import Compensation
from identify.csv_file import CsvTable, csv_text, read_csv
from identify.plausibility import joint_mistakes
from identify.problems import Problems
from identify.rotations import quaternions
from identify.study import Study
from identify.tables import POSITION, QUATERNION, WRENCH, joint_columns
from identify.tool_response import Targets
from identify.units import MM

__all__ = ["compensated_csv", "load_targets"]

_ATTACH = ("attach_x_mm", "attach_y_mm", "attach_z_mm")
_FRAMES = ("world", "flange")
_LARGEST = {"wrench": 1e6, "attach": 1e5}  # N or Nm, mm: no robot bears or reaches that, the units must be wrong
_SLACK = 1e-6  # deg or mm beyond the limits: what files round away
_SHOWN = 5  # problems shown of one kind


def load_targets(path: str | Path, study: Study) -> Targets:
    """Read and check a target file.

    Args:
        path: The file.
        study: The study of the robot.

    Raises:
        InputError: The file is wrong; the message holds the problems with their lines.
    """
    table = read_csv(path)
    problems = Problems(table.path)
    table.require(["target", *joint_columns(study), *WRENCH])
    table.warn_unknown(["target", *joint_columns(study), *WRENCH, "frame", *_ATTACH])
    names = table.ids("target", problems)
    q = table.numbers(joint_columns(study), problems)
    wrench = table.numbers(WRENCH, problems)
    attach = table.numbers(_ATTACH, problems) if table.group(_ATTACH) else np.zeros((len(names), 3))
    frame = _frames(table, problems)
    problems.settle()

    _check_names(table, names, problems)
    for message in joint_mistakes(study, q * study.joint_units):
        problems.add("whole file", message)
    problems.settle()
    _check_limits(table, names, q, study, problems)
    _check_sizes(table, WRENCH, wrench, _LARGEST["wrench"], "N or Nm", problems)
    _check_sizes(table, _ATTACH, attach, _LARGEST["attach"], "mm", problems)
    problems.settle()
    return Targets(tuple(names), q * study.joint_units, wrench, frame == "flange", attach * MM)


def _frames(table: CsvTable, problems: Problems) -> np.ndarray:
    """(T,) frame of each wrench."""
    if "frame" not in table.cells:
        return np.full(len(table.lines), _FRAMES[0])
    index = table.choices("frame", _FRAMES, problems, known="allowed are")
    return np.array(_FRAMES)[index]


def _check_names(table: CsvTable, names: list[str], problems: Problems) -> None:
    """Note targets that stand there twice."""
    seen: dict[str, int] = {}
    for name, line in zip(names, table.lines.tolist(), strict=True):
        if name in seen:
            problems.add(
                f"line {line}, target", f"stands in line {seen[name]} too; every target needs its own id", name
            )
        seen.setdefault(name, line)


def _check_limits(table: CsvTable, names: list[str], q: Floats, study: Study, problems: Problems) -> None:
    """Note targets outside the joint limits."""
    lower, upper = study.robot.lower / study.joint_units, study.robot.upper / study.joint_units
    columns = joint_columns(study)
    outside = np.argwhere((q < lower - _SLACK) | (q > upper + _SLACK))
    for row, joint in outside[:_SHOWN]:
        allowed = f"target {names[row]} is outside the joint limits: allowed are {lower[joint]:g} to {upper[joint]:g}"
        problems.add(f"line {table.lines[row]}, {columns[joint]}", allowed, float(q[row, joint]))
    if len(outside) > _SHOWN:
        problems.add("whole file", f"{len(outside) - _SHOWN} more joint values outside the limits")


def _check_sizes(
    table: CsvTable, columns: tuple[str, ...], values: Floats, largest: float, unit: str, problems: Problems
) -> None:
    """Note numbers that cannot be meant."""
    for row, column in np.argwhere(np.abs(values) > largest)[:_SHOWN]:
        what = f"at most {largest:g} {unit} expected; are the units wrong?"
        problems.add(f"line {table.lines[row]}, {columns[column]}", what, float(values[row, column]))


def compensated_csv(found: Compensation, outside: np.ndarray, study: Study) -> str:
    """Text of ``compensated.csv``.

    Args:
        found: The commands.
        outside: (T,) True for targets outside the calibrated region.
        study: The study of the robot.
    """
    size = np.linalg.norm(found.before, axis=1), np.linalg.norm(found.residual, axis=1)
    header = ["target", *joint_columns(study), *POSITION, *QUATERNION]
    header += ["residual_mm", "residual_ci95_mm", "deflection_mm", "extrapolated"]
    columns = [
        found.targets.names,
        *(found.q / study.joint_units).T,
        *(found.command[:, :3, 3] / MM).T,
        *quaternions(found.command[:, :3, :3]).T,
        size[1] / MM,
        found.radius95 / MM,
        size[0] / MM,
        outside.astype(np.int64),
    ]
    return csv_text(header, columns)
