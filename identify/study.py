"""A study: one robot, its loads, markers, noise, model and what the plan is asked for. SI inside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from identify.arrays import Floats, frozen
from identify.beams import Tube
from identify.cell import Box, Neighbour, PayloadDiagram, Station, Visibility, Wall
from identify.loads import LoadCase, LoadRange, Markers
from identify.robot import Robot
from identify.units import DEG, MM

__all__ = [
    "Constraints",
    "ModelChoice",
    "Noise",
    "PlanSettings",
    "ReduceSettings",
    "Study",
    "TestPose",
    "TestRegion",
    "Times",
    "Tracker",
]

Criterion = Literal["test_pose", "A", "D", "E", "G"]
Reference = Literal["absolute", "differences", "auto"]
Equilibrium = Literal["linear", "loaded"]
References = Literal["same_visit", "own_visits", "auto"]
Approach = Literal["any", "same"]
RowAlgebra = Literal["vectors", "dual_quaternions", "dual_quaternion_deviations"]


@dataclass(frozen=True, eq=False)
class Tracker:
    """Range-dependent noise of a laser tracker, 1 sigma: ``a + b * range``.

    Attributes:
        radial: Along the beam, m.
        radial_per_m: Along the beam, m per m of range.
        transverse: Across the beam, m.
        transverse_per_m: Across the beam, m per m of range.
        station: (3,) the instrument in the base frame, m; None if it follows from a free frame.
    """

    radial: float
    radial_per_m: float
    transverse: float
    transverse_per_m: float
    station: Floats | None = None


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the readings, all 1 sigma.

    Attributes:
        reading: One coordinate of one reading, m (unused with a tracker).
        tracker: Range-dependent noise instead of ``reading``.
        pose_jitter: Per joint, new for each visit, rad (m for a sliding joint).
        reading_jitter: Per joint, new for each shot, rad (m for a sliding joint).
        orientation: Of a 6-D target, rad per axis; 0: only positions are read.
    """

    reading: float = 0.0
    tracker: Tracker | None = None
    pose_jitter: float = 0.0
    reading_jitter: float = 0.0
    orientation: float = 0.0


@dataclass(frozen=True, eq=False)
class TestPose:
    """A pose where accuracy after compensation counts.

    Attributes:
        q: (n,) joint values, rad or m.
        wrench: (6,) process wrench at ``attach``, N and Nm.
        in_flange: True if the wrench is given in the flange frame, else world.
        attach: (3,) flange frame, m.
        point: (3,) the point whose error counts, flange frame, m.
        weight: Weight in the mean square.
    """

    q: Floats
    wrench: Floats
    in_flange: bool
    attach: Floats
    point: Floats
    weight: float = 1.0

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("q", "wrench", "attach", "point"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class TestRegion:
    """A box of poses and wrenches where accuracy after compensation counts.

    Attributes:
        lower: (n,) smallest joint values, rad or m.
        upper: (n,) largest joint values, rad or m.
        wrench_lower: (6,) smallest process wrench at ``attach``, N and Nm.
        wrench_upper: (6,) largest process wrench, N and Nm.
        in_flange: True if the wrench is given in the flange frame, else world.
        attach: (3,) flange frame, m.
        point: (3,) the point whose error counts, flange frame, m.
        weight: Weight of the whole region in the mean square.
        points: Number of test poses that stand for it.
    """

    lower: Floats
    upper: Floats
    wrench_lower: Floats
    wrench_upper: Floats
    in_flange: bool
    attach: Floats
    point: Floats
    weight: float = 1.0
    points: int = 64

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("lower", "upper", "wrench_lower", "wrench_upper", "attach", "point"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class PlanSettings:
    """What the plan is asked for (section ``[plan]``).

    Attributes:
        poses: Number of experiments; None where a tolerance or a budget is stated instead.
        tolerance: Radius at the test poses, m; None where ``poses`` or a budget is stated.
        confidence: Confidence of the tolerance.
        loads: Names of the loads to choose from.
        criterion: test_pose, A, D, E or G.
        candidates: Number of candidate experiments.
        refine: Refine the joint angles continuously.
        loads_per_pose: Loaded shots of one visit.
        settings_per_load: Settings of a load with ranges among the candidates.
        reference_rows: Each visit also reads the unloaded state.
        repeats: One candidate may be measured several times.
        max_std_percent: No parameter's std may exceed this percentage of its std under the best A plan.
        stations: Names of the tracker stations to choose from; empty where there is no choice.
        markers: How many of the markers to choose from are mounted; None where there is no choice.
        curve: Also tell the accuracy against the number of experiments.
        restarts: Local searches of a plan on the candidates, of which the best counts.
        losses: Visits that may be lost: the plan is the best after losing any so many.
        draws: Draws of uncertain nominal values on which the plan is good on average; 0: at the nominal ones.
        references: The unloaded state is read in the visit of the loaded ones, or in visits of its own.
        approach: Poses are approached from anywhere, or every joint always from below (``same``).
        approach_turn: Least distance from which turning joints come under ``same``, rad.
        approach_slide: The same of sliding joints, m.
        time_budget: Time that the whole plan may take, s, or None.
        cost_budget: What the readings and poses may cost together, or None.
        pose_cost: Cost of one visit.
    """

    poses: int | None = 15
    tolerance: float | None = None
    confidence: float = 0.95
    loads: tuple[str, ...] = ()
    criterion: Criterion = "test_pose"
    candidates: int = 10_000
    refine: bool = True
    loads_per_pose: int = 1
    settings_per_load: int = 8
    reference_rows: bool = True
    repeats: bool = True
    max_std_percent: float = 300.0
    stations: tuple[str, ...] = ()
    markers: int | None = None
    curve: bool = True
    restarts: int = 1
    losses: int = 0
    draws: int = 0
    references: References = "same_visit"
    approach: Approach = "any"
    approach_turn: float = 2.0 * DEG
    approach_slide: float = 2.0 * MM
    time_budget: float | None = None
    cost_budget: float | None = None
    pose_cost: float = 0.0

    @property
    def budgeted(self) -> bool:
        """True where a budget takes the place of a number of experiments."""
        return self.time_budget is not None or self.cost_budget is not None


@dataclass(frozen=True, eq=False)
class Times:
    """How long measuring takes (section ``[times]``).

    Attributes:
        pose: To settle at a pose and take the first reading, s.
        reading: Each further reading of a visit, s.
        load_change: One crane operation, to hang a weight or to take one off, s.
        speed: Of turning joints between poses, rad/s; infinite: travel takes no time.
        speed_slide: Of sliding joints, m/s.
        start: Before the first pose, s.
    """

    pose: float = 0.0
    reading: float = 0.0
    load_change: float = 0.0
    speed: float = float("inf")
    speed_slide: float = float("inf")
    start: float = 0.0


@dataclass(frozen=True, eq=False)
class Constraints:
    """What a pose must keep to (section ``[constraints]``).

    Attributes:
        joint_margin: Distance to the limits of turning joints, rad.
        joint_margin_slide: Distance to the limits of sliding joints, m.
        floor: Lowest world height (from the base origin) of joints, flange, markers and loads, m; None: no floor.
        payload_share: Share of the rated payload that may hang on the flange.
        self_collision: Check the links' capsules against each other.
        link_radius: Radius of these capsules, m; None: the robot file's, else 3 % of the reach.
        clearance: Distance that arm and hung weight keep to walls and boxes, and the weight to the arm, m.
        boxes: Obstacles, world axes.
        walls: Planes that nothing may cross, world axes.
        home: (n,) where the arm comes from and returns to, rad or m; None: not stated.
        payload_diagram: Allowed mass against the distance of its centre; None: the rated payload alone.
        wrist_moment: (3,) rated static moments about the last three joints, Nm; None: unknown.
        torque_share: Share of the rated joint torques that static load may take; None: not checked.
        visibility: What the tracker must see; None: not checked.
    """

    joint_margin: float = 0.0
    joint_margin_slide: float = 0.0
    floor: float | None = None
    payload_share: float = 1.0
    self_collision: bool = True
    link_radius: float | None = None
    clearance: float = 0.0
    boxes: tuple[Box, ...] = ()
    walls: tuple[Wall, ...] = ()
    home: Floats | None = None
    payload_diagram: PayloadDiagram | None = None
    wrist_moment: Floats | None = None
    torque_share: float | None = None
    visibility: Visibility | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("home", "wrist_moment"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class ReduceSettings:
    """How the model is reduced (section ``[reduce]``).

    Attributes:
        configurations: Number of random configurations that the observation matrix is built from.
        targets: Markers are read in ``position`` alone, or as a ``pose`` (6-D target).
        directions: ``loads``: the loads of the study; ``forces`` or ``wrenches``: unit forces, or forces and moments,
            in all directions at the points where the loads act (for measured wrenches).
        prefer: Patterns of parameter names, the most preferred first.
        tubes: Link -> the tube that its assigned constants are taken from; zero for other links.
    """

    configurations: int = 150
    targets: Literal["position", "pose"] = "position"
    directions: Literal["loads", "forces", "wrenches"] = "loads"
    prefer: tuple[str, ...] = ()
    tubes: Mapping[int, Tube] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """A model to compare with others (``[[models]]``).

    Attributes:
        name: Its name in the table.
        effects: Its effects.
        options: Options of effects: the study's, with whole tables replaced by those of the model.
    """

    name: str
    effects: tuple[str, ...]
    options: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class Study:
    """A validated study.

    Attributes:
        path: The study file.
        robot: Robot with mounting, gravity and tool.
        loads: Load cases; the first unloaded one is the reference of differences.
        markers: Markers on the flange, then fixed ones.
        noise: Noise.
        frame_free: Readings are in an unknown frame that is fitted; else in the base frame.
        markers_fitted: Marker positions are fitted; else taken as they stand.
        effects: What the simulation contains: ``name`` or ``name@where``.
        reference: absolute, differences or auto.
        equilibrium: Torques on the undeflected arm (linear) or on the deflected one (loaded).
        rows: How the rows of a fit are built: vectors, or by dual quaternions (`identify.dual_rows`).
        nominal: Starting values by parameter name, in the units of the results.
        nominal_std_percent: How uncertain these are, by name of a parameter or of an effect.
        options: Options of effects, by effect name.
        test_poses: Where accuracy counts.
        test_regions: Boxes of poses and wrenches where it counts too.
        plan: What the plan is asked for.
        constraints: What poses must keep to.
        reduce: How the model is reduced.
        models: Models to compare.
        inputs: Every file the study was read from.
        stations: Where the tracker can stand.
        marker_choices: Names of the markers that the plan chooses from; they stand among ``markers``.
        times: How long measuring takes, or None if the study does not say.
        load_costs: Cost of a reading under each load; empty: none costs anything.
        load_ranges: What a plan may choose, by name of a load; ``loads`` holds the nominal values, which all else uses.
        neighbour: Another arm that is parked while this one is measured; None where there is none, or it is not known.
    """

    path: Path
    robot: Robot
    loads: tuple[LoadCase, ...]
    markers: Markers
    noise: Noise
    frame_free: bool = True
    markers_fitted: bool = True
    effects: tuple[str, ...] = ("joint_compliance",)
    reference: Reference = "auto"
    equilibrium: Equilibrium = "linear"
    rows: RowAlgebra = "vectors"
    nominal: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    nominal_std_percent: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: MappingProxyType({}))
    test_poses: tuple[TestPose, ...] = ()
    test_regions: tuple[TestRegion, ...] = ()
    plan: PlanSettings = field(default_factory=PlanSettings)
    constraints: Constraints = field(default_factory=Constraints)
    reduce: ReduceSettings = field(default_factory=ReduceSettings)
    models: tuple[ModelChoice, ...] = ()
    inputs: tuple[Path, ...] = ()
    stations: tuple[Station, ...] = ()
    marker_choices: tuple[str, ...] = ()

    @property
    def station(self) -> Floats | None:
        """(3,) where the tracker stands, base frame, m; the first station to choose from where several are left."""
        if self.noise.tracker is not None and self.noise.tracker.station is not None:
            return self.noise.tracker.station
        named = {station.name: station.position for station in self.stations}
        return next((named[name] for name in (*self.plan.stations, *named)), None)

    times: Times | None = None
    load_costs: tuple[float, ...] = ()
    load_ranges: Mapping[str, LoadRange] = field(default_factory=lambda: MappingProxyType({}))
    neighbour: Neighbour | None = None

    @property
    def joint_units(self) -> np.ndarray:
        """(n,) SI value of one file unit of each joint: deg, or mm where it slides."""
        return np.where(self.robot.prismatic, MM, DEG)

    @property
    def six_d(self) -> bool:
        """True if markers on the flange are 6-D targets, whose orientation is read too."""
        return self.noise.orientation > 0

    def load_index(self, name: str) -> int:
        """Index of a load by its id (the caller has checked that it exists)."""
        return [load.name for load in self.loads].index(name)
