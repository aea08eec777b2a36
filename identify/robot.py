"""A serial robot as a chain of fixed placements and joints about their own z axis.

Everything here is SI (m, rad, kg, N, Nm). What a robot file does not state is *unknown*:
``nan`` for masses, efforts and payload, ``inf`` for limits. It is never zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from identify.arrays import Floats, frozen
from identify.errors import InputError

__all__ = ["STANDARD_GRAVITY", "ControllerMap", "Robot", "Shape"]

STANDARD_GRAVITY = 9.80665  # m/s^2, standard acceleration (CGPM 1901)


@dataclass(frozen=True, eq=False)
class ControllerMap:
    """How the controller counts its joints: ``q_ctrl = coupling (sign * q + offset)``.

    Used by export and import only; every other number is in the robot file's convention. The numbers
    are in file units: deg, or mm for a sliding joint.

    Attributes:
        sign: (n,) +1 or -1.
        offset_deg: (n,) deg or mm.
        coupling: (n, n) invertible; a FANUC arm has -1 in row 3, column 2.
        pulses_per_deg: (n,) pulses per deg or mm, or None where the controller does not count pulses.
    """

    sign: Floats
    offset_deg: Floats
    coupling: Floats
    pulses_per_deg: Floats | None = None

    def __post_init__(self) -> None:
        """Check shapes and values, and make the arrays read-only."""
        n = len(self.sign)
        for key, shape in (("sign", (n,)), ("offset_deg", (n,)), ("coupling", (n, n)), ("pulses_per_deg", (n,))):
            if getattr(self, key) is None:
                continue
            array = frozen(getattr(self, key))
            if array.shape != shape:
                raise InputError(f"controller.{key} has shape {array.shape}, expected {shape}: one entry a joint")
            if not np.isfinite(array).all():
                raise InputError(f"controller.{key} = {array.tolist()}: finite numbers expected")
            object.__setattr__(self, key, array)
        if not np.isin(self.sign, (-1.0, 1.0)).all():
            raise InputError(f"controller.sign = {self.sign.tolist()}: allowed are 1 and -1")
        if np.linalg.matrix_rank(self.coupling) < n:
            raise InputError("controller.coupling cannot be inverted; every joint must be readable from the controller")
        if self.pulses_per_deg is not None and not self.pulses_per_deg.all():
            raise InputError(f"controller.pulses_per_deg = {self.pulses_per_deg.tolist()}: 0 is not allowed")


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision shape of one body: a capsule.

    Attributes:
        name: The link it belongs to.
        body: 0 for the base, i for what joint i (counted from 1) moves.
        ends: (2, 3) ends of its axis: in the base frame for the base, else in the moved frame of joint i, m.
        radius: m.
    """

    name: str
    body: int
    ends: Floats
    radius: float

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "ends", frozen(self.ends))


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial chain with ``n`` actuated joints.

    Attributes:
        name: Name of the robot.
        joints: Names of the joints, base first.
        prismatic: (n,) True where a joint slides along its z axis instead of turning about it.
        placements: (n + 1, 4, 4) homogeneous. ``placements[i]`` is joint i's frame at zero in the
            moved frame of joint i - 1 (``placements[0]`` in the base frame); ``placements[n]`` is the
            flange in the moved frame of the last joint. The joint acts on its frame's z axis.
        lower: (n,) lower joint limits, rad or m; ``-inf`` if unknown.
        upper: (n,) upper joint limits, rad or m; ``inf`` if unknown.
        masses: (n,) mass of the link that joint i moves, kg; ``nan`` if unknown.
        centres: (n, 3) its centre of mass in the moved frame of joint i, m.
        efforts: (n,) rated joint torque or force, Nm or N; ``nan`` if unknown.
        payload: Rated payload at the flange, kg; ``nan`` if unknown.
        link_radius: Radius of the capsules drawn around the links for the self-collision check, m;
            ``nan`` if unknown.
        link_rotations: (n + 1, 3, 3) axes of the link frames (0 is the base) in the base frame at zero joint values;
            local x is the beam axis. Default: all parallel to the base.
        world_R_base: (3, 3) base frame in the world (world z is up).
        gravity: Magnitude of gravity, m/s^2.
        down: (3,) unit vector along which it acts, world frame.
        tool_mass: Mass that hangs on the flange in every reading, kg.
        tool_centre: (3,) its centre of mass in the flange frame, m.
        source: Where the numbers come from.
        controller: How the controller counts its joints, or None if the file does not say.
        shapes: Collision shapes, where the file states them.
        continuous: (n,) True where the file says that a joint turns without end; its limits are infinite.
    """

    name: str
    joints: tuple[str, ...]
    prismatic: np.ndarray
    placements: Floats
    lower: Floats
    upper: Floats
    masses: Floats
    centres: Floats
    efforts: Floats
    payload: float = float("nan")
    link_radius: float = float("nan")
    link_rotations: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))
    world_R_base: Floats = field(default_factory=lambda: frozen(np.eye(3)))
    gravity: float = STANDARD_GRAVITY
    down: Floats = field(default_factory=lambda: frozen([0.0, 0.0, -1.0]))
    tool_mass: float = 0.0
    tool_centre: Floats = field(default_factory=lambda: frozen(np.zeros(3)))
    source: str = ""
    controller: ControllerMap | None = None
    shapes: tuple[Shape, ...] = ()
    continuous: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __post_init__(self) -> None:
        """Check shapes and make the arrays read-only."""
        n = len(self.joints)
        if not len(self.link_rotations):
            object.__setattr__(self, "link_rotations", np.broadcast_to(np.eye(3), (n + 1, 3, 3)))
        if not len(self.continuous):
            object.__setattr__(self, "continuous", np.zeros(n, dtype=bool))
        shapes = {
            "prismatic": (n,), "placements": (n + 1, 4, 4), "lower": (n,), "upper": (n,),
            "masses": (n,), "centres": (n, 3), "efforts": (n,), "link_rotations": (n + 1, 3, 3), "world_R_base": (3, 3),
            "down": (3,), "tool_centre": (3,), "continuous": (n,),
        }  # fmt: skip
        for key, shape in shapes.items():
            array = frozen(getattr(self, key), bool if key in ("prismatic", "continuous") else np.float64)
            if array.shape != shape:
                raise InputError(f"robot {self.name}: {key} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, key, array)
        if n == 0:
            raise InputError(f"robot {self.name}: no actuated joint between base and flange")
        if self.controller is not None and len(self.controller.sign) != n:
            raise InputError(
                f"robot {self.name}: the controller map has {len(self.controller.sign)} joints, the robot has {n}"
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def masses_known(self) -> bool:
        """True if the mass of every moved link is known."""
        return bool(np.isfinite(self.masses).all())

    @property
    def gravity_base(self) -> Floats:
        """(3,) gravity in the base frame, m/s^2."""
        g: Floats = self.gravity * (self.world_R_base.T @ self.down)
        return g

    @property
    def reach(self) -> float:
        """Upper bound of the distance from the base origin to the flange origin at any pose within limits, m.

        The sum of the lengths of the placements and of the largest strokes. It is ``inf`` if a sliding joint has an
        unknown limit.
        """
        lengths = np.linalg.norm(self.placements[:, :3, 3], axis=1).sum()
        strokes = np.maximum(np.abs(self.lower), np.abs(self.upper))[self.prismatic]
        return float(lengths + strokes.sum())
