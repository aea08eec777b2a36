"""URDF files read and checked, before any other parser sees them: a tree of links with masses.

Refused are entities, files that are too large or too deep, numbers that are none, and trees that are no tree.
Of geometry, only the collision shapes are looked at, and of meshes only that they are there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree as ET
from xml.parsers import expat

from identify.arrays import frozen
from identify.collision_shapes import Collision
from identify.errors import InputError
from identify.transforms import roll_pitch_yaw, translation

__all__ = ["SLIDING", "TURNING", "Inertial", "UrdfJoint", "UrdfTree", "listed", "read_urdf"]

MAX_BYTES = 10_000_000
MAX_DEPTH = 100
MAX_LINKS = 2_000
MAX_SIZE = 1e6
MAX_MASS = 1e9
TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)
OTHERS = ("fixed", "floating", "planar")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A checked ``<joint>``; rad, m, Nm, N."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]
    lower: float
    upper: float
    effort: float
    mimics: str | None

    @property
    def moves(self) -> bool:
        """True unless it is fixed."""
        return self.kind != "fixed"


@dataclass(frozen=True, eq=False)
class Inertial:
    """A checked ``<inertial>``: mass in kg and its centre in the link's frame, m."""

    mass: float
    centre: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """A checked URDF: a tree of links.

    Attributes:
        path: The file.
        name: Name of the robot.
        root: The link without a parent.
        links: Mass of each link, None if not stated.
        above: The joint that carries each link (not for the root).
        below: The joints that hang on each link.
        collisions: Collision geometry of the links that state any.
    """

    path: Path
    name: str
    root: str
    links: Mapping[str, Inertial | None]
    above: Mapping[str, UrdfJoint]
    below: Mapping[str, Sequence[UrdfJoint]]
    collisions: Mapping[str, tuple[Collision, ...]]

    def fail(self, message: str) -> NoReturn:
        """Raise an `InputError` that names the file."""
        raise InputError(f"{self.path}: {message}")

    def under(self, link: str) -> list[str]:
        """All links that hang on ``link``, sorted by name."""
        names, waiting = [], [link]
        while waiting:
            for joint in self.below[waiting.pop()]:
                names.append(joint.child)
                waiting.append(joint.child)
        return sorted(names)


def read_urdf(path: Path) -> UrdfTree:
    """Read and check a URDF file."""
    root = _document(path)
    if root.tag != "robot":
        raise InputError(f"{path}: the first element is <{root.tag}>, a URDF file starts with <robot>")
    for element in root.iter():
        if "xacro}" in str(element.tag) or any("${" in value for value in element.attrib.values()):
            raise InputError(f"{path}: <{element.tag}> is xacro; expand the file first (xacro file.xacro > file.urdf)")
    links = _links(root, path)
    above, below = _joints(root, links, path)
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise InputError(f"{path}: links {listed(roots)} hang on nothing; one root is allowed, join the others to it")
    shapes = {str(element.get("name")): _collisions(element, path) for element in root.findall("link")}
    shapes = {link: found for link, found in shapes.items() if found}
    tree = UrdfTree(path, root.get("name") or path.stem, roots[0] if roots else "", links, above, below, shapes)
    loop = sorted(set(links) - {tree.root, *(tree.under(tree.root) if roots else ())})
    if loop:
        tree.fail(f"links {listed(loop)} hang on one another in a circle; the links of a robot form a tree")
    return tree


def _links(root: ET.Element, path: Path) -> dict[str, Inertial | None]:
    """The links of a ``<robot>`` and their masses."""
    links: dict[str, Inertial | None] = {}
    elements = root.findall("link")
    if not 2 <= len(elements) <= MAX_LINKS:
        raise InputError(f"{path}: {len(elements)} links; a robot has 2 to {MAX_LINKS}")
    for element in elements:
        name = _name(element, path)
        if name in links:
            raise InputError(f"{path}: link {name!r} stands twice; every link needs its own name")
        links[name] = _inertial(element, f"{path}: link {name!r}")
    return links


def _joints(
    root: ET.Element, links: Mapping[str, Inertial | None], path: Path
) -> tuple[dict[str, UrdfJoint], dict[str, list[UrdfJoint]]]:
    """The joint above each link and the joints below it."""
    above: dict[str, UrdfJoint] = {}
    below: dict[str, list[UrdfJoint]] = {name: [] for name in links}
    names: set[str] = set()
    for element in root.findall("joint"):
        joint = _joint(element, path)
        where = f"{path}: joint {joint.name!r}"
        if joint.name in names:
            raise InputError(f"{where} stands twice; every joint needs its own name")
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise InputError(f"{where}: {end} link {link!r} does not exist; allowed are {listed(links)}")
        if joint.child in above:
            other = above[joint.child].name
            raise InputError(f"{where}: child link {joint.child!r} is that of joint {other!r} already; one is allowed")
        names.add(joint.name)
        above[joint.child] = joint
        below[joint.parent].append(joint)
    return above, below


def _document(path: Path) -> ET.Element:
    """The XML of a file that declares no document type, hence no entities."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size} bytes; a URDF file has at most {MAX_BYTES}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    depth = 0

    def doctype(*_: object) -> NoReturn:
        raise InputError(
            f"{path}: line {parser.CurrentLineNumber}: <!DOCTYPE> is refused, for entities can blow up a file or read "
            "another; a URDF file needs none"
        )

    def deeper(*_: object) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise InputError(f"{path}: line {parser.CurrentLineNumber}: more than {MAX_DEPTH} nested elements")

    def higher(*_: object) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = doctype
    parser.EntityDeclHandler = doctype
    parser.StartElementHandler = deeper
    parser.EndElementHandler = higher
    try:
        parser.Parse(content, True)
        return ET.fromstring(content)
    except (expat.ExpatError, ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: no XML: {error}; a URDF file starts with <robot>") from None


def _joint(element: ET.Element, path: Path) -> UrdfJoint:
    """Check one ``<joint>``."""
    name = _name(element, path)
    where = f"{path}: joint {name!r}"
    kind = element.get("type", "")
    if kind not in TURNING + SLIDING + OTHERS:
        raise InputError(f"{where}: type = {kind!r}; allowed are {', '.join(TURNING + SLIDING + OTHERS)}")
    parent, child = (_attribute(_only(element, key, where), key, "link", where) for key in ("parent", "child"))
    xyz, rpy = _origin(element, where)
    stated = _only(element, "axis", where)
    axis = _numbers(stated, "xyz", where, tag="axis", default=(1.0, 0.0, 0.0))
    length = math.hypot(*axis)
    if kind in TURNING + SLIDING and not 1e-6 < length < 1e6:
        raise InputError(f"{where}: axis xyz = {list(axis)} has no direction; a vector other than zero is expected")
    lower, upper, effort = _limits(element, kind, where)
    mimic = _only(element, "mimic", where)
    return UrdfJoint(
        name, kind, parent, child, xyz, rpy,
        tuple(value / length for value in axis) if length else axis, lower, upper, effort,
        None if mimic is None else mimic.get("joint", ""),
    )  # fmt: skip


def _limits(element: ET.Element, kind: str, where: str) -> tuple[float, float, float]:
    """Lower and upper limit (infinite if unknown) and rated effort (nan if unknown)."""
    limit = _only(element, "limit", where)
    if limit is None:
        return -math.inf, math.inf, math.nan
    lower, upper, effort, _ = (_number(limit, key, where) for key in ("lower", "upper", "effort", "velocity"))
    if effort is not None and effort < 0:
        raise InputError(f"{where}: limit effort = {effort:g}; a number above zero is expected (0: unknown)")
    if kind == "continuous" or (lower is None and upper is None):
        return -math.inf, math.inf, effort or math.nan
    # The URDF format: a limit that is not stated beside the other one is zero.
    lower, upper = lower or 0.0, upper or 0.0
    if kind in TURNING + SLIDING and not lower < upper:
        raise InputError(
            f"{where}: limit lower = {lower:g} is not below upper = {upper:g}; leave both out if they are unknown, or "
            "make the joint fixed"
        )
    return lower, upper, effort or math.nan


def _inertial(element: ET.Element, where: str) -> Inertial | None:
    """Check the ``<inertial>`` of a link; None if there is none."""
    block = _only(element, "inertial", where)
    if block is None:
        return None
    stated = _only(block, "mass", where)
    mass = None if stated is None else _number(stated, "value", where)
    if mass is None:
        raise InputError(f"{where}: <inertial> states no mass value; leave the whole element out if it is unknown")
    if not 0 <= mass <= MAX_MASS:
        raise InputError(f"{where}: mass value = {mass:g}; a number above zero is expected (kg; 0: unknown)")
    inertia = _only(block, "inertia", where)
    if inertia is not None:
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            _number(inertia, key, where)
    centre, _ = _origin(block, where)
    return Inertial(mass, centre)


_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",)}


def _collisions(link: ET.Element, path: Path) -> tuple[Collision, ...]:
    """Check every ``<collision>`` of a link."""
    found = []
    for element in link.findall("collision"):
        where = f"{path}: link {link.get('name')!r}: collision"
        geometry = _only(element, "geometry", where)
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None or shape.tag not in {*_SIZES, "mesh"}:
            raise InputError(f"{where}: one of {', '.join(_SIZES)} or mesh expected inside <geometry>")
        keys = _SIZES.get(shape.tag, ())
        count = 3 if shape.tag == "box" else 1
        sizes = [_numbers(shape, key, where, tag=shape.tag, count=count, default=(0.0,) * count) for key in keys]
        flat = tuple(value for own in sizes for value in own)
        if any(value <= 0.0 for value in flat):
            raise InputError(f"{where}: {shape.tag} {', '.join(keys)} = {list(flat)}; numbers above zero expected (m)")
        xyz, rpy = _origin(element, where)
        placement = translation(xyz)
        placement[:3, :3] = roll_pitch_yaw(rpy)
        found.append(Collision(shape.tag, flat, frozen(placement)))
    return tuple(found)


def _origin(element: ET.Element, where: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """``xyz`` and ``rpy`` of an ``<origin>``; zero where not stated, as in the URDF format."""
    origin = _only(element, "origin", where)
    return _numbers(origin, "xyz", where, tag="origin"), _numbers(origin, "rpy", where, tag="origin")


def _only(element: ET.Element, tag: str, where: str) -> ET.Element | None:
    """The child element of this name, None if there is none."""
    found = element.findall(tag)
    if len(found) > 1:
        raise InputError(f"{where}: <{tag}> stands {len(found)} times; one is allowed")
    return found[0] if found else None


def _numbers(
    element: ET.Element | None,
    key: str,
    where: str,
    *,
    tag: str,
    count: int = 3,
    default: tuple[float, ...] = (0.0,) * 3,
) -> tuple[float, ...]:
    """``count`` finite numbers of an attribute, ``default`` where it is not stated."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    words = text.split()
    values = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if len(words) != count or len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"{where}: {tag} {key} = {text!r}; {count} finite number{'s' * (count > 1)} expected")
    if count > 1 and max(map(abs, values)) > MAX_SIZE:
        raise InputError(f"{where}: {tag} {key} = {text!r}; at most {MAX_SIZE:g} is allowed (m, rad)")
    return tuple(values)


def _number(element: ET.Element, key: str, where: str) -> float | None:
    """A finite number of an attribute, None if it is not stated."""
    stated = _numbers(element, key, where, tag=element.tag, count=1, default=())
    return stated[0] if stated else None


def _name(element: ET.Element, path: Path) -> str:
    """Name of a link or joint."""
    name = element.get("name")
    if not name:
        raise InputError(f"{path}: a <{element.tag}> has no name; every link and joint needs one")
    return name


def _attribute(element: ET.Element | None, tag: str, key: str, where: str) -> str:
    """An attribute that must stand."""
    value = None if element is None else element.get(key)
    if not value:
        raise InputError(f"{where}: <{tag} {key}=...> is missing")
    return value


def listed(names: Mapping[str, object] | Sequence[str], most: int = 20) -> str:
    """A readable list of names."""
    listed = list(names)
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(repr(name) for name in listed[:most]) + more
