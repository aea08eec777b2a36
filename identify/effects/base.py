"""What every effect is made of: named parameters, a displacement and its derivative.

An effect is one physical cause. It is bound to a robot once (`bind`), which fixes its parameters, and
then maps a *scene* (an experiment with all its fields computed) to marker displacements. Simulation,
design, identification and compensation all use the same two functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from identify.arrays import Floats, Ints
from identify.experiment import Experiment
from identify.kinematics import Frames
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.springs import (
    Springs,
    base_springs,
    carry,
    joint_springs,
    link_springs,
    load_torque,
    screws,
    self_weight_torque,
)

__all__ = ["Binding", "Effect", "Fields", "Parameter", "Scene", "SpringSet", "Term", "build_scene"]

#: Springs that a scene knows: one a joint, six a link (`link_springs`), twelve at the foot (`base_springs`).
SpringSet = Literal["joints", "links", "base"]
_SPRINGS: dict[SpringSet, Callable[[Frames], Springs]] = {
    "joints": joint_springs,
    "links": link_springs,
    "base": base_springs,
}


@dataclass(frozen=True)
class Parameter:
    """One unknown.

    Attributes:
        name: ``<effect>.<where>[.<component>]``.
        unit: Unit of its value in files and results.
        scale: SI value of one unit.
        nominal: Starting value, in ``unit``.
        nuisance: True for frame and markers, which are fitted but not asked for.
        limit: A fit that knows it no better than this (1 sigma, in ``unit``) holds it at its nominal value.
        plausible: Largest absolute size, in ``unit``, that is still physically plausible.
        typical: Typical absolute size, in ``unit``; ``nan`` where nothing is known about it.
    """

    name: str
    unit: str
    scale: float
    nominal: float = 0.0
    nuisance: bool = False
    limit: float = float("inf")
    plausible: float = float("inf")
    typical: float = float("nan")


@dataclass(frozen=True)
class Term:
    """One compliance: the deflection of spring ``first`` per load on spring ``second``, and back if ``mutual``."""

    name: str
    first: int
    second: int
    unit: str
    mutual: bool = True


@dataclass(frozen=True, eq=False)
class Binding:
    """What an effect is bound to.

    Attributes:
        robot: The robot.
        where: Places of the effect; empty for all.
        options: The table ``[model.<effect>]`` of the study.
        flange: The flange has geometric errors of its own (marker positions are exact).
        others: The other effects of the model, for effects that lean on their parameters.
        loads: The load cases of the study.
        markers: The markers of the study.
    """

    robot: Robot
    where: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    flange: bool = False
    others: tuple[Effect, ...] = ()
    loads: tuple[LoadCase, ...] = ()
    markers: Markers | None = None


@dataclass(frozen=True, eq=False)
class Fields:
    """The two fields of a set of springs, base frame.

    Attributes:
        motion: (R, s, 3) motion of each row's marker per unit of each spring (its turn, where the row reads that); zero
            for targets on the base.
        torque: (S, s) torque or force that load and self-weight put on each spring in each shot.
    """

    motion: Floats
    torque: Floats


class _Arm(NamedTuple):
    """What a scene knows of the arm itself, kept when it was asked for.

    Attributes:
        springs: Screws (C, 6, s) of all poses (`identify.springs.screws`) and torques (S, s).
        twists: The last compliance (s, s) and the twists (S, 6) of the flange that it lets happen.
    """

    springs: dict[SpringSet, tuple[Floats, Floats]]
    twists: dict[SpringSet, tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class Scene:
    """An experiment on a robot; the fields of its springs are computed when they are first asked for.

    Attributes:
        experiment: The conditions.
        frames: Joint frames of the C poses of the experiment.
        marker: (C, M, 3) undeflected markers in all poses, base frame, m.
        self_weight: The weight of links and tool counts.
    """

    experiment: Experiment
    frames: Frames
    marker: Floats
    self_weight: bool

    @property
    def row_pose(self) -> np.ndarray:
        """(R,) pose of each row."""
        return np.asarray(self.experiment.shot_pose[self.experiment.row_shot])

    @cached_property
    def point(self) -> Floats:
        """(R, 3) undeflected marker of each row, m."""
        point: Floats = self.marker[self.row_pose, self.experiment.row_marker]
        return point

    @cached_property
    def joints(self) -> Fields:
        """Fields of the n joint springs."""
        return self._fields("joints")

    @cached_property
    def load_on_joints(self) -> Floats:
        """(S, n) torque (force) that the load alone, without self-weight, puts on each joint."""
        return _load_torque(self.experiment, self.frames, joint_springs, joint_springs(self.frames))

    @cached_property
    def links(self) -> Fields:
        """Fields of the 6 (n + 1) link springs, see `identify.springs.link_springs`."""
        return self._fields("links")

    @cached_property
    def base(self) -> Fields:
        """Fields of the twelve springs at the foot, see `identify.springs.base_springs`."""
        return self._fields("base")

    def fields(self, springs: SpringSet) -> Fields:
        """Fields of a named set of springs."""
        found: Fields = getattr(self, springs)
        return found

    def torque(self, springs: SpringSet) -> Floats:
        """(S, s) the torques of a named set of springs, without the motion of any marker."""
        return self._loaded(springs)[1]

    @property
    def joint_torque(self) -> Floats:
        """(S, n) torques of the joints of the undeflected arm."""
        return self._loaded("joints")[1]

    def turned(self, joint: int, angle: Floats) -> Floats:
        """Twists (S, 6) of the flange where a joint of the undeflected arm yields by ``angle`` (S,), rad or m."""
        twists: Floats = self._loaded("joints")[0][self.experiment.shot_pose, :, joint] * angle[:, None]
        return twists

    def yielded(self, springs: SpringSet, compliance: Floats) -> Floats:
        """Twists (S, 6) of the flange where springs of ``compliance`` (s, s), SI, yield to their torques."""
        known = self._arm.twists.get(springs)
        if known is None or not np.array_equal(known[0], compliance):
            known = compliance, self._twists(springs, self._loaded(springs)[1] @ compliance.T)
            self._arm.twists[springs] = known
        return known[1]

    def moved_by(self, springs: SpringSet, compliance: Floats) -> Floats:
        """(R, 3) motion of the markers, m, where springs of ``compliance`` (s, s), SI, yield to their torques."""
        return self.carried(self.yielded(springs, compliance))

    def _twists(self, springs: SpringSet, yielded: Floats) -> Floats:
        """(S, 6) twists of the flange where springs yield by (S, s)."""
        twists = np.zeros((len(yielded), 6))
        loaded = np.flatnonzero(yielded.any(axis=1))
        every = self._loaded(springs)[0][self.experiment.shot_pose[loaded]]
        twists[loaded] = (every @ yielded[loaded, :, None])[:, :, 0]
        return twists

    def carried(self, twists: Floats) -> Floats:
        """(R, 3) what twists (S, 6) of the flange (`identify.springs.screws`) do to what rows read, m or rad."""
        experiment = self.experiment
        moved = carry(twists[experiment.row_shot, :, None], self.point[:, None])[:, 0, :, 0]
        if experiment.row_turns is not None:
            moved[self.turning] = twists[experiment.row_shot[self.turning], 3:]
        moved[self.on_base] = 0.0
        return moved

    @property
    def turning(self) -> np.ndarray:
        """(R,) True for rows that read how the flange is turned; all that displaces them is a rotation vector, rad."""
        return self.experiment.turning

    @property
    def on_base(self) -> np.ndarray:
        """(R,) True for rows of markers on the base, which no deflection moves."""
        markers = self.experiment.markers
        return np.asarray(markers.on_base[self.experiment.row_marker])

    def with_markers(self, positions: Floats) -> Scene:
        """The same arm under the same loads, undeflected, with markers elsewhere: (M, 3) in their own frames, m."""
        other = Scene(self.experiment, self.frames, _points(self.experiment, self.frames, positions), self.self_weight)
        vars(other)["_arm"] = self._arm  # what is known of the arm depends on no marker
        return other

    @cached_property
    def _arm(self) -> _Arm:
        """What was computed of the arm so far."""
        return _Arm({}, {})

    def _loaded(self, name: SpringSet) -> tuple[Floats, Floats]:
        """Screws (C, 6, s) of a set of springs in all poses, and its torques (S, s)."""
        if name not in self._arm.springs:
            springs = _SPRINGS[name](self.frames)
            torque = _load_torque(self.experiment, self.frames, _SPRINGS[name], springs)
            if self.self_weight:
                torque += self_weight_torque(springs, self.frames)[self.experiment.shot_pose]
            self._arm.springs[name] = screws(springs), torque
        return self._arm.springs[name]

    def _fields(self, name: SpringSet) -> Fields:
        every, torque = self._loaded(name)
        moves = carry(every, self.marker)
        moves[:, self.experiment.markers.on_base] = 0.0
        rows = moves[self.row_pose, self.experiment.row_marker]
        if self.experiment.row_turns is not None:
            rows[self.turning] = every[self.row_pose[self.turning], 3:]
        return Fields(rows.swapaxes(1, 2), torque)


Displacement = Callable[[Scene, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Effect:
    """One cause, bound to a robot.

    Attributes:
        name: Its name in study files.
        parameters: Its p unknowns.
        displacement: ``(scene, values) -> (R, 3)`` m (rad for rows that read a turn), base frame; values in the
            parameters' units, followed by the values of the b borrowed ones.
        derivative: ``(scene, values) -> (R, 3, p + b)`` m per unit; the last b add to the columns of their owners.
        yields: True if it answers to loads (only then do differences between loads show it).
        of_reading: True if it displaces what is read and not the arm (instrument, reflectors): of no concern to the
            accuracy of a robot that is compensated.
        adjust: ``(robot, values) -> robot`` for effects that change the robot itself.
        reload: ``(experiment, values) -> experiment`` for effects that change what acts on the arm.
        linear: True if its displacement is linear in its values, so that its derivative does not depend on them.
        through: True if it moves markers only through springs that other effects bring (a wrong mass, a wrong load):
            its ``derivative`` is zero and its columns are differences of the whole model's response.
        why_zero: Index of a parameter -> why no row may depend on it.
        borrowed: Names of b parameters of other effects that it depends on as well.
        springs: The set of springs that its terms count in, if it is a sum over pairs of springs.
        terms: These pairs, one a parameter.
        held: Pairs that yield too and are not fitted, with their values in their units.
        stops: Joint values (rad or m), by joint index, at which alone it is defined: candidates stop there.
        twist: ``(scene, values) -> (S, 6)`` where the displacement is that of a flange which moves as a rigid body on
            the undeflected arm (`Scene.carried`): one twist a shot then serves all its markers.
    """

    name: str
    parameters: tuple[Parameter, ...]
    displacement: Displacement
    derivative: Displacement
    why_zero: Callable[[int], str]
    yields: bool = True
    of_reading: bool = False
    adjust: Callable[[Robot, Floats], Robot] | None = None
    reload: Callable[[Experiment, Floats], Experiment] | None = None
    linear: bool = False
    through: bool = False
    borrowed: tuple[str, ...] = ()
    springs: SpringSet | None = None
    terms: tuple[Term, ...] = ()
    held: tuple[tuple[Term, float], ...] = ()
    stops: Mapping[int, Floats] = field(default_factory=lambda: MappingProxyType({}))
    twist: Displacement | None = None


def build_scene(experiment: Experiment, frames: Frames, positions: Floats, *, self_weight: bool) -> Scene:
    """The scene of an experiment.

    Args:
        experiment: The conditions.
        frames: Joint frames of ``experiment.q``.
        positions: (M, 3) markers in their own frames, m.
        self_weight: Count the weight of links and tool.
    """
    return Scene(experiment, frames, _points(experiment, frames, positions), self_weight)


def _points(experiment: Experiment, frames: Frames, positions: Floats) -> Floats:
    """(C, M, 3) undeflected markers in all poses."""
    points = np.stack([frames.point(local) for local in positions], axis=1)
    points[:, experiment.markers.on_base] = positions[experiment.markers.on_base]
    return points


def _load_torque(
    experiment: Experiment, frames: Frames, springs_of: Callable[[Frames], Springs], springs: Springs
) -> Floats:
    """Torque of what hangs on the flange or of the measured wrench, (S, s); ``springs`` are those of all poses."""
    torque: Floats | None = None
    for shots in _alike(experiment):
        if len(shots):
            there = _at(frames, experiment.shot_pose[shots])
            part = load_torque(springs if there is frames else springs_of(there), *_wrench(experiment, shots, there))
            torque = np.zeros((len(experiment.shot_load), part.shape[1])) if torque is None else torque
            torque[shots] = part
    if torque is None:
        return np.zeros((len(experiment.shot_load), len(springs.slides)))
    return torque


def _alike(experiment: Experiment) -> Iterator[Ints]:
    """Loaded shots that are computed together: all that were measured, else those whose force turns with the flange."""
    loaded = ~experiment.shot_unloaded
    if experiment.wrench is not None:
        yield np.flatnonzero(loaded)
        return
    turning = np.array([load.in_flange for load in experiment.loads])[experiment.shot_load]
    for sort in (False, True):
        yield np.flatnonzero(loaded & (turning == sort))


def _wrench(experiment: Experiment, shots: Ints, frames: Frames) -> tuple[Floats, Floats, Floats]:
    """Point, force and moment (S, 3) that act in shots which are alike, base frame; ``frames`` are theirs."""
    loads, index = experiment.loads, experiment.shot_load[shots]
    attach = frames.point(np.array([load.attach for load in loads])[index])
    if experiment.wrench is not None:
        return attach, *_measured(experiment, shots, frames)
    robot = frames.robot
    turn = frames.flange_rotation if loads[index[0]].in_flange else robot.world_R_base.T[None]
    force, moment = (np.array([getattr(load, key) for load in loads])[index, :, None] for key in ("force", "moment"))
    weight = np.array([load.mass for load in loads])[index, None] * robot.gravity_base
    return attach, (turn @ force)[:, :, 0] + weight, (turn @ moment)[:, :, 0]


def _measured(experiment: Experiment, shots: Ints, frames: Frames) -> tuple[Floats, Floats]:
    """Force and moment (S, 3) of measured wrenches, base frame."""
    assert experiment.wrench is not None
    turn = frames.flange_rotation
    if experiment.wrench_in_world is not None:
        turn = np.where(experiment.wrench_in_world[shots, None, None], frames.robot.world_R_base.T, turn)
    given = experiment.wrench[shots]
    force, moment = (np.einsum("sij,sj->si", turn, v) for v in (given[:, :3], given[:, 3:]))
    return force, moment


def _at(frames: Frames, index: np.ndarray) -> Frames:
    """The frames of some poses."""
    if np.array_equal(index, np.arange(len(frames.origin))):
        return frames
    return Frames(
        frames.robot,
        frames.rotation[index],
        frames.origin[index],
        frames.centre[index],
        frames.flange_rotation[index],
        frames.flange_origin[index],
    )
