"""The study of a plan with everything chosen: station, markers and the settings of loads, as a file and in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from doe.design_choices import Option
from doe.plan import Plan
from identify.loads import LoadCase
from identify.problems import name_robot_from, read_toml
from identify.units import MM

__all__ = ["UsedSetting", "planned_toml", "setting_lines", "settings_json", "used_settings"]

_DIGITS = 6  # of kg and mm


@dataclass(frozen=True)
class UsedSetting:
    """A setting of a load with ranges that a plan uses.

    Attributes:
        load: What is hung.
        of: Id of the load in the study file.
        visits: Visits in which it hangs.
    """

    load: LoadCase
    of: str
    visits: int

    @property
    def mass_kg(self) -> float:
        """Its mass as a file holds it."""
        return round(self.load.mass, _DIGITS)

    @property
    def attach_mm(self) -> list[float]:
        """Its attach point as a file holds it."""
        return [round(float(value), _DIGITS) for value in self.load.attach / MM]


def used_settings(made: Plan) -> tuple[UsedSetting, ...]:
    """Settings that a plan uses, in the order of the study; nothing without ranges."""
    study = made.pool.observer.study
    found = []
    for index, load in enumerate(study.loads):
        visits = int((made.visit_loads == index).any(axis=1).sum())
        if visits and load.name in study.load_ranges:
            found.append(UsedSetting(load, study.load_ranges[load.name].of, visits))
    return tuple(found)


def settings_json(used: tuple[UsedSetting, ...]) -> list[dict[str, Any]]:
    """Settings for plan.json."""
    return [
        {"load": one.load.name, "of": one.of, "mass_kg": one.mass_kg, "attach_mm": one.attach_mm, "visits": one.visits}
        for one in used
    ]


def setting_lines(used: tuple[UsedSetting, ...]) -> tuple[str, ...]:
    """Settings for people."""
    return tuple(
        f"hang {one.load.name}: {one.mass_kg:g} kg at [{', '.join(f'{value:g}' for value in one.attach_mm)}] mm, "
        f"in {one.visits} {'visit' if one.visits == 1 else 'visits'}"
        for one in used
    )


def planned_toml(study: Path, out: Path, best: Option | None, used: tuple[UsedSetting, ...]) -> str:
    """Text of a study file in which nothing is left to choose, for the commands that follow a plan.

    Only the chosen station stands in it, the mounted markers as markers, and for each load with ranges the settings
    that are used, as loads of their own; its nominal values where none is used.

    Args:
        study: The study file with the choices.
        out: Folder that the file will stand in; the robot file is named from there.
        best: Station and markers; None where there was no choice.
        used: The settings.
    """
    import tomli_w

    data = read_toml(study)
    name_robot_from(out, data, study)
    if best is not None:
        _mount(data, best)
    _hang(data, used)
    return tomli_w.dumps(data)


def _mount(data: dict[str, Any], best: Option) -> None:
    """Leave only the chosen station and markers."""
    plan = data.setdefault("plan", {})
    for key in ("stations", "markers"):
        plan.pop(key, None)
    if best.station is not None:
        data["tracker_stations"] = [place for place in data["tracker_stations"] if place["id"] == best.station]
    choices = data.pop("marker_choices", {})
    mounted = {name: choices[name] for name in best.markers}
    data["markers"] = {**data.get("markers", {}), **mounted}
    normals = data.get("marker_normals", {})
    data["marker_normals"] = {name: look for name, look in normals.items() if name in data["markers"]}


def _hang(data: dict[str, Any], used: tuple[UsedSetting, ...]) -> None:
    """Put the used settings in the place of loads with ranges."""
    loads, names = [], {}
    for table in data.get("loads", []):
        plain = {key: value for key, value in table.items() if key not in {"mass_range_kg", "attach_range_mm"}}
        own = [one for one in used if one.of == table["id"]]
        tables = [{**plain, "id": one.load.name, "mass_kg": one.mass_kg, "attach_mm": one.attach_mm} for one in own]
        loads += tables or [plain]
        names[table["id"]] = [one["id"] for one in tables or [plain]]
    if "loads" in data:
        data["loads"] = loads
    plan = data.get("plan", {})
    plan.pop("settings_per_load", None)
    if "loads" in plan:
        plan["loads"] = [new for name in plan["loads"] for new in names.get(name, [name])]
