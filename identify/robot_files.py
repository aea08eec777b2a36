"""Robot files: TOML tables of a serial chain in one of three conventions, and the one door to all robots.

``dh_standard``   ``Rz(theta + q) Tz(d) Tx(a) Rx(alpha)`` (row i holds a_i, alpha_i)
``dh_modified``   ``Rx(alpha) Tx(a) Rz(theta + q) Tz(d)`` (Craig; row i holds a_{i-1}, alpha_{i-1})
``chain``         ``T(xyz) R(rpy)``, then a turn about, or a slide along, ``axis`` (as a URDF joint)

A sliding joint adds its value to ``d``. The format is described in ``docs/robots.md``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from identify.arrays import Floats
from identify.errors import InputError
from identify.problems import read_toml
from identify.robot import STANDARD_GRAVITY, ControllerMap, Robot
from identify.transforms import axis_frame, roll_pitch_yaw, rotation, translation
from identify.units import DEG, MM

__all__ = ["find_robot_file", "load_robot", "robot_from_toml", "shipped_robots"]

SUFFIXES = (".toml", ".urdf")

Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e9, le=1e9)]
Length = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
Angle = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-36_000, le=36_000)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e9)]
Sign = Annotated[int, Field(strict=True, ge=-1, le=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-]+$")]
Vector = tuple[Length, Length, Length]


class _Table(BaseModel):
    """A table of a robot file: frozen, unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class _Placement(_Table):
    """A fixed frame; roll, pitch, yaw about fixed x, y, z as in URDF."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    source: str = ""

    def matrix(self) -> Floats:
        """Homogeneous (4, 4), m."""
        return _placed(self.xyz_mm, self.rpy_deg)


#: Keys that a joint of this type cannot have.
_FOREIGN = {
    "revolute": ("lower_mm", "upper_mm", "effort_N"),
    "continuous": ("lower_mm", "upper_mm", "lower_deg", "upper_deg", "effort_N"),
    "prismatic": ("lower_deg", "upper_deg", "effort_Nm"),
}


class _Joint(_Table):
    """What the rows of all conventions share."""

    name: Name
    type: Literal["revolute", "continuous", "prismatic"] = "revolute"
    lower_deg: Angle | None = None
    upper_deg: Angle | None = None
    lower_mm: Length | None = None
    upper_mm: Length | None = None
    mass_kg: Positive | None = None
    com_mm: Vector | None = None
    effort_Nm: Positive | None = None
    effort_N: Positive | None = None
    source: str = ""

    @model_validator(mode="after")
    def _consistent(self) -> _Joint:
        """Units follow the type; limits are ordered; a mass comes with its centre."""
        stated = [key for key in _FOREIGN[self.type] if getattr(self, key) is not None]
        if stated:
            raise ValueError(f"joint {self.name} is {self.type} and has no {', '.join(stated)}")
        lower, upper = self.limits()
        if not lower < upper:
            raise ValueError(f"joint {self.name}: lower limit {lower} is not below upper limit {upper}")
        if (self.mass_kg is None) != (self.com_mm is None):
            raise ValueError(f"joint {self.name}: mass_kg and com_mm stand together (leave both out if unknown)")
        return self

    def limits(self) -> tuple[float, float]:
        """Lower and upper limit, deg or mm; infinite if unknown."""
        lower, upper = (self.lower_mm, self.upper_mm) if self.slides else (self.lower_deg, self.upper_deg)
        return -math.inf if lower is None else lower, math.inf if upper is None else upper

    @property
    def slides(self) -> bool:
        """True for a prismatic joint."""
        return self.type == "prismatic"

    @abstractmethod
    def frames(self, convention: str) -> tuple[Floats, Floats, Floats]:
        """The fixed placement before the motion, the axis of the motion, the fixed placement after it."""


class _DhJoint(_Joint):
    """A row of a Denavit-Hartenberg table."""

    a_mm: Length = 0.0
    alpha_deg: Angle = 0.0
    d_mm: Length = 0.0
    theta_deg: Angle = 0.0
    sign: Sign = 1

    @model_validator(mode="after")
    def _direction(self) -> _DhJoint:
        """A sign is +1 or -1."""
        if self.sign == 0:
            raise ValueError(f"joint {self.name}: sign = 0, allowed are 1 and -1")
        return self

    def frames(self, convention: str) -> tuple[Floats, Floats, Floats]:
        """See `_Joint.frames`; the joint's own z axis is the axis of the motion."""
        side = translation([self.a_mm * MM, 0.0, 0.0]) @ rotation("x", self.alpha_deg)
        zero, along = rotation("z", self.theta_deg), translation([0.0, 0.0, self.d_mm * MM])
        axis = np.array([0.0, 0.0, float(self.sign)])
        if convention == "dh_standard":
            return zero, axis, along @ side
        return side @ zero, axis, along


class _ChainJoint(_Joint):
    """A joint placed in the moved frame of the one before it."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    axis: tuple[Number, Number, Number] = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _points_somewhere(self) -> _ChainJoint:
        """The axis has a direction."""
        if not 1e-6 < math.hypot(*self.axis) < 1e6:
            raise ValueError(f"joint {self.name}: axis = {list(self.axis)} has no direction")
        return self

    def frames(self, convention: str) -> tuple[Floats, Floats, Floats]:
        """See `_Joint.frames`; nothing fixed stands after the motion."""
        return _placed(self.xyz_mm, self.rpy_deg), np.array(self.axis), np.eye(4)


class _Controller(_Table):
    """``q_ctrl = coupling (sign * q + offset)`` in deg, or mm where a joint slides."""

    sign: tuple[Sign, ...] | None = None
    offset_deg: tuple[Number, ...] | None = None
    coupling: tuple[tuple[Number, ...], ...] | None = None
    pulses_per_deg: tuple[Number, ...] | None = None
    source: str = ""

    def record(self, n: int) -> ControllerMap:
        """The map of a robot with ``n`` joints.

        Raises:
            InputError: A list has the wrong length or a value that cannot be.
        """
        return ControllerMap(
            sign=np.ones(n) if self.sign is None else np.array(self.sign, dtype=float),
            offset_deg=np.zeros(n) if self.offset_deg is None else np.array(self.offset_deg),
            coupling=np.eye(n) if self.coupling is None else _matrix(self.coupling, n),
            pulses_per_deg=None if self.pulses_per_deg is None else np.array(self.pulses_per_deg),
        )


class _RobotFile(_Table):
    """What the files of all conventions share."""

    name: str
    convention: Literal["dh_standard", "dh_modified", "chain"]
    source: Annotated[str, Field(min_length=1)]
    remarks: str = ""
    payload_kg: Positive | None = None
    link_radius_mm: Positive | None = None
    base: _Placement = _Placement()
    flange: _Placement = _Placement()
    controller: _Controller | None = None


class _DhFile(_RobotFile):
    """A robot file with Denavit-Hartenberg rows."""

    joints: Annotated[tuple[_DhJoint, ...], Field(min_length=1)]


class _ChainFile(_RobotFile):
    """A robot file with placed joints."""

    joints: Annotated[tuple[_ChainJoint, ...], Field(min_length=1)]


def load_robot(
    path: str | Path,
    *,
    base: str | None = None,
    flange: str | None = None,
    mount: ArrayLike = (0.0, 0.0, 0.0),
    gravity: float = STANDARD_GRAVITY,
    folder: str | Path | None = None,
) -> Robot:
    """Read a robot from a URDF or a TOML robot file.

    Args:
        path: The file, or the bare name of a shipped robot (`find_robot_file`).
        base: Link the chain starts from (URDF; default: the root).
        flange: Link that carries markers and loads (URDF; default: the end of the chain).
        mount: (3,) roll, pitch, yaw of the base in the world, rad: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
        gravity: Magnitude of gravity, m/s^2; it acts along world -z.
        folder: Where a relative path starts (the folder of the study; default: the working directory).

    Raises:
        InputError: The file is missing, unreadable or wrong.
    """
    file = find_robot_file(path, folder)
    if file.suffix.lower() == ".urdf":
        from identify.urdf import robot_from_urdf

        robot = robot_from_urdf(file, base=base, flange=flange)
    else:
        for key, value, only in (("base", base, "base"), ("flange", flange, "flange")):
            if value not in {None, only}:
                raise InputError(
                    f"{file}: {key} = {value!r}: links are chosen by name in URDF files only; a TOML robot file has one"
                    f" {key}, allowed is {only!r} or nothing"
                )
        robot = robot_from_toml(file)
    angles = np.asarray(mount, dtype=np.float64)
    if angles.shape != (3,) or not np.isfinite(angles).all():
        raise InputError(f"mount = {angles.tolist()}: roll, pitch, yaw expected, three finite angles")
    if not (math.isfinite(gravity) and gravity >= 0):
        raise InputError(f"gravity = {gravity}: a finite magnitude in m/s^2 expected, not negative")
    return replace(robot, world_R_base=roll_pitch_yaw(angles), gravity=gravity)


def find_robot_file(path: str | Path, folder: str | Path | None = None) -> Path:
    """The file that ``path`` means: the file itself, seen from ``folder``, or else a shipped robot of that bare name.

    Args:
        path: File, or name of a shipped robot with or without ``.toml``.
        folder: Where a relative path starts; default: the working directory.

    Raises:
        InputError: There is no such file, or it is of another kind.
    """
    file = Path(folder or "") / path
    if not file.exists() and Path(path).name == str(path):
        shipped = shipped_robots()
        file = shipped.get(str(path).removesuffix(".toml"), file)
    if not file.is_file():
        what = "is no file" if file.exists() else "does not exist"
        raise InputError(
            f"robot file {file} {what}; give a {' or '.join(SUFFIXES)} file, or one of the shipped robots "
            f"({', '.join(shipped_robots())})"
        )
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"robot file {file}: suffix {file.suffix!r} is not known; allowed are {', '.join(SUFFIXES)}")
    return file


def shipped_robots() -> dict[str, Path]:
    """The robot files that come with elastocal, by name (in the repository: ``configs/robots``)."""
    here = Path(__file__).resolve().parent
    for place in (here.parent / "configs" / "robots", here / "_robots"):
        files = sorted(place.glob("*.toml"))
        if files:
            return {file.stem: file for file in files}
    return {}


def robot_from_toml(path: str | Path) -> Robot:
    """Read a TOML robot file; mounted upright, standard gravity.

    Raises:
        InputError: The file is no TOML, or a key or value is wrong; all problems in one message.
    """
    path = Path(path)
    table = read_toml(path)
    model = _ChainFile if table.get("convention") == "chain" else _DhFile
    try:
        return _robot(model.model_validate(table))
    except ValidationError as error:
        raise InputError(_message(path, error, model)) from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _robot(file: _DhFile | _ChainFile) -> Robot:
    """Fold the rows so that every joint acts on its own frame's z axis."""
    rows: Sequence[_Joint] = file.joints
    names = tuple(row.name for row in rows)
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"joints: name {', '.join(twice)} stands more than once; every joint needs its own name")
    carry, placements, centres = file.base.matrix(), [], []
    for row in rows:
        before, axis, after = row.frames(file.convention)
        turn = axis_frame(axis)
        placements.append(carry @ before @ turn)
        carry = turn.T @ after
        centres.append(_point(carry, row.com_mm))
    placements.append(carry @ file.flange.matrix())
    slides = np.array([row.slides for row in rows])
    limits = np.array([row.limits() for row in rows]) * np.where(slides, MM, DEG)[:, None]
    return Robot(
        name=file.name,
        joints=names,
        prismatic=slides,
        placements=np.array(placements),
        lower=limits[:, 0],
        upper=limits[:, 1],
        masses=np.array([_known(row.mass_kg) for row in rows]),
        centres=np.array(centres),
        efforts=np.array([_known(row.effort_N if row.slides else row.effort_Nm) for row in rows]),
        payload=_known(file.payload_kg),
        link_radius=_known(file.link_radius_mm) * MM,
        source=file.source,
        continuous=np.array([row.type == "continuous" for row in rows]),
        controller=None if file.controller is None else file.controller.record(len(rows)),
    )


def _placed(xyz_mm: Sequence[float], rpy_deg: Sequence[float]) -> Floats:
    """Homogeneous (4, 4) of a placement in mm and deg."""
    roll, pitch, yaw = rpy_deg
    turn = rotation("z", yaw) @ rotation("y", pitch) @ rotation("x", roll)
    return translation(np.array(xyz_mm) * MM) @ turn


def _point(frame: Floats, com_mm: Sequence[float] | None) -> Floats:
    """(3,) a point of ``frame`` (4, 4), m; nan if unknown."""
    if com_mm is None:
        return np.full(3, np.nan)
    return np.asarray(frame[:3, :3] @ (np.array(com_mm) * MM) + frame[:3, 3])


def _known(value: float | None) -> float:
    """The value, or nan if it is not stated."""
    return math.nan if value is None else value


def _matrix(rows: Sequence[Sequence[float]], n: int) -> Floats:
    """(n, n) from rows of a file."""
    if [len(row) for row in rows] != [n] * n:
        raise InputError(f"controller.coupling: {n} rows of {n} numbers expected, one row a joint")
    return np.array(rows, dtype=np.float64)


_M = TypeVar("_M", bound=_RobotFile)


def _message(path: Path, error: ValidationError, model: type[_M]) -> str:
    """One message with every problem: key, value, what is allowed."""
    lines = []
    for problem in error.errors():
        place = problem["loc"]
        key = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
        text = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            text = f"unknown key; allowed are {', '.join(_allowed(model, place))}"
        elif problem["type"] == "missing":
            text = "is missing"
        value = problem["input"]
        shown = "" if isinstance(value, dict) else f" = {value!r}"
        lines.append(f"{key}{shown}: {text}" if key else text)
    if len(lines) == 1:
        return f"{path}: {lines[0]}"
    return f"{path}: {len(lines)} problems\n" + "\n".join(f"  {line}" for line in lines)


def _allowed(model: type[_M], place: Sequence[int | str]) -> list[str]:
    """Keys of the table in which the last part of ``place`` stands."""
    tables: dict[str, Any] = {"base": _Placement, "flange": _Placement, "controller": _Controller}
    tables["joints"] = _ChainJoint if model is _ChainFile else _DhJoint
    table = tables.get(str(place[0]), model) if len(place) > 1 else model
    return sorted(table.model_fields)
