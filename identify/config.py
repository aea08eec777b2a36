"""From a study file to a `Study`: read, check everything, convert to SI.

All problems of a file are reported together (`identify.problems`). The shapes of the tables stand in
`identify.schema`, what is checked beyond them in `identify.study_checks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from identify.arrays import frozen
from identify.cell_sections import ConstraintsSection
from identify.errors import InputError
from identify.problems import Problems, read_toml, unknown
from identify.robot import STANDARD_GRAVITY, Robot
from identify.robot_files import find_robot_file, load_robot
from identify.schema import (
    EFFECT_NAMES,
    FramesSection,
    ModelChoiceSection,
    ModelSection,
    NoiseSection,
    PlanSection,
    ReduceSection,
    Section,
    ToolSection,
)
from identify.study import ModelChoice, Noise, Study
from identify.study_checks import check_study
from identify.study_file import STUDY_SECTIONS, StudyFile
from identify.study_records import (
    constraints,
    load_cases,
    load_ranges,
    markers,
    noise_from,
    plan_settings,
    reduce_settings,
    standing,
    stations,
    test_pose,
    test_region,
    times_from,
)
from identify.units import DEG, MM

__all__ = ["load_study", "split_options"]

_POINTS = ("markers", "fixed_markers", "marker_choices", "marker_normals")  # tables of id -> three numbers

_T = TypeVar("_T", bound=Section)
_NUMBERS = {"nominal", "nominal_std_percent", "values"}  # tables of numbers by parameter name


def load_study(path: str | Path) -> Study:
    """Read and check a study file.

    Loads that are not given are the unloaded state ``L0`` alone; it is also put in front where all
    loads of the file are loaded and none is called ``L0``.

    Args:
        path: The study file (TOML).

    Raises:
        InputError: The file or the robot file is wrong; the message holds every problem.
    """
    path = Path(path)
    problems = Problems(path)
    data = read_toml(path)
    if "arms" in data:
        raise InputError(
            f"{path}: [[arms]]: this is a study of two arms, which only plan and evaluate take; give the study of one "
            "of its arms, which stands under [[arms]] study"
        )
    file = _tables(data, problems)
    robot, robot_file = _robot(file, path, problems)
    check_study(file, robot, problems)
    problems.settle()
    if robot is None:  # a robot that cannot be had is a problem, so this is only for the type checker
        raise InputError(f"{path}: [robot] cannot be read")
    return _study(file, path, robot, robot_file, timed="times" in data)


# ---- tables


def _tables(data: Mapping[str, Any], problems: Problems) -> StudyFile:
    """Every table on its own, so that a mistake in one does not hide those in others."""
    for name in data:
        if name in STUDY_SECTIONS or name == "models":
            continue
        problems.add(f"[{name}]", unknown("table", name, [*STUDY_SECTIONS, "models"]))
    needed = ("robot", "noise") if data.get("marker_choices") else ("robot", "markers", "noise")
    for name in needed:
        if name not in data:
            problems.add(f"[{name}]", "is missing")
    model, options = split_options(data.get("model", {}), ModelSection, "[model]", problems)
    points = {name: {"points": data.get(name, {})} for name in _POINTS}
    tables: dict[str, Any] = {**data, **points, "model": model}
    found: dict[str, Any] = {}
    for name, (schema, several) in STUDY_SECTIONS.items():
        if several:
            found[name] = _list(schema, tables.get(name, []), name, problems)
        elif name in tables or name not in {"robot", "noise"}:
            found[name] = problems.check(schema, tables.get(name, {}), f"[{name}]")
    models = _models(data.get("models", []), problems)
    return StudyFile(**{"robot": None, "noise": None, **found}, options=options, models=models)


def _models(tables: object, problems: Problems) -> list[tuple[ModelChoiceSection, Mapping[str, Mapping[str, Any]]]]:
    """The models to compare, each with its own options."""
    if not isinstance(tables, list):
        problems.add("[models]", "a list of tables expected, each begins with [[models]]")
        return []
    found = []
    for i, table in enumerate(tables):
        own, options = split_options(table, ModelChoiceSection, f"[[models]] {i + 1}", problems)
        choice = problems.check(ModelChoiceSection, own, f"[[models]] {i + 1}")
        if choice is not None:
            found.append((choice, options))
    return found


def _list(schema: type[_T], tables: object, name: str, problems: Problems) -> list[_T] | None:
    """A list of tables, or None if one of them is wrong."""
    if not isinstance(tables, list):
        problems.add(f"[{name}]", f"a list of tables expected, each begins with [[{name}]]")
        return None
    checked = [problems.check(schema, table, f"[[{name}]] {i + 1}") for i, table in enumerate(tables)]
    good = [table for table in checked if table is not None]
    return good if len(good) == len(checked) else None


def split_options(
    table: object, schema: type[Section], heading: str, problems: Problems
) -> tuple[object, Mapping[str, Mapping[str, Any]]]:
    """Separate the keys of ``schema`` from tables of options, which carry names of effects.

    Dotted keys without quotes (``joint_compliance.j2 = 1``) in tables of numbers become one name.

    Returns:
        The table without options, and the options by effect name.
    """
    if not isinstance(table, Mapping):
        return table, MappingProxyType({})
    keys = list(schema.model_fields)
    own = {key: _flat(value) if key in _NUMBERS else value for key, value in table.items() if key in keys}
    options: dict[str, Mapping[str, Any]] = {}
    for key, value in table.items():
        if key in keys:
            continue
        if key not in EFFECT_NAMES:
            problems.add(f"{heading} {key}", unknown("key", key, [*keys, *EFFECT_NAMES]))
        elif not isinstance(value, Mapping):
            problems.add(f"{heading} {key}", "a table of options expected", value)
        else:
            problems.finite(f"{heading[:-1]}.{key}]", value)
            options[key] = MappingProxyType(dict(value))
    return own, MappingProxyType(options)


def _flat(value: object) -> object:
    """Nested tables as one table with dotted names."""
    if not isinstance(value, Mapping):
        return value
    flat: dict[str, object] = {}
    for key, item in value.items():
        inner = _flat(item)
        if isinstance(inner, Mapping) and inner:
            flat.update({f"{key}.{name}": number for name, number in inner.items()})
        else:
            flat[key] = inner
    return flat


def _robot(file: StudyFile, path: Path, problems: Problems) -> tuple[Robot | None, Path]:
    """The robot with mounting, gravity and tool, and its file."""
    table, tool = file.robot, file.tool or ToolSection()
    if table is None:
        return None, path
    try:
        found = find_robot_file(table.model, path.parent)
        robot = load_robot(
            found,
            base=table.base,
            flange=table.flange,
            mount=np.array(table.mount_deg) * DEG,
            gravity=STANDARD_GRAVITY if table.gravity_ms2 is None else table.gravity_ms2,
        )
    except InputError as error:
        problems.add("[robot] model", str(error), table.model)
        return None, path
    return replace(robot, tool_mass=tool.mass_kg, tool_centre=frozen(tool.com_mm) * MM), found


# ---- to records in SI


def _study(file: StudyFile, path: Path, robot: Robot, robot_file: Path, *, timed: bool) -> Study:
    """The study of a file without problems; ``timed`` if it says how long measuring takes."""
    frames, model = file.frames or FramesSection(), file.model or ModelSection()
    loads, possible = load_cases(file.loads or []), stations(file.tracker_stations or [])
    costs = {table.id: table.cost for table in file.loads or []}
    plan = plan_settings(file.plan or PlanSection(), loads, possible)
    noise = noise_from(file.noise or NoiseSection(), Noise())
    return Study(
        path=path,
        robot=robot,
        loads=loads,
        markers=markers(file.markers, file.fixed_markers, file.marker_choices, file.marker_normals),
        noise=standing(noise, possible, plan.stations),
        frame_free=frames.measurement == "free",
        markers_fitted=frames.markers == "nominal",
        effects=tuple(model.effects),
        reference=model.reference,
        equilibrium=model.equilibrium,
        rows=model.rows,
        nominal=MappingProxyType(dict(model.nominal)),
        nominal_std_percent=MappingProxyType(dict(model.nominal_std_percent)),
        options=file.options,
        test_poses=tuple(test_pose(pose, robot, pose.weight) for pose in file.test_poses or []),
        test_regions=tuple(test_region(region, robot) for region in file.test_regions or []),
        plan=plan,
        constraints=constraints(file.constraints or ConstraintsSection(), robot.prismatic),
        reduce=reduce_settings(file.reduce or ReduceSection()),
        models=tuple(
            ModelChoice(choice.name, tuple(choice.effects), MappingProxyType({**file.options, **own}))
            for choice, own in file.models
        ),
        inputs=(path, robot_file),
        stations=possible,
        marker_choices=tuple(file.marker_choices.points if file.marker_choices else ()),
        times=times_from(file.times) if timed and file.times is not None else None,
        load_costs=tuple(costs.get(load.name, 0.0) for load in loads),
        load_ranges=MappingProxyType(load_ranges(file.loads or [])),
    )
