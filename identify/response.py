"""Where a model says that every reading should be, and how that depends on its parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress

import numpy as np

from identify.arrays import Floats, Ints, rotation_of, skew
from identify.effects import Effect, Scene, build_scene
from identify.experiment import Experiment
from identify.kinematics import forward
from identify.loaded_scene import TOLERANCE, load_scene, spring_matrix
from identify.model import Model, with_effect
from identify.units import MM, MRAD

__all__ = [
    "Response",
    "added_columns",
    "deflected",
    "displaced_points",
    "effect_columns",
    "frame_displacement",
    "marker_positions",
    "nuisance_columns",
    "respond",
    "target_turns",
    "through_columns",
    "undeflected",
]

_NUDGE = 1e-3  # mm or mrad
_STEP = 0.1  # kg, mm, mrad, %, N or Nm, of effects that act through the springs of others


@dataclass(frozen=True, eq=False)
class Response:
    """What a model says about an experiment.

    Attributes:
        scene: The fields it was computed from.
        position: (R, 3) readings in the base frame (displaced by the frame parameters), m; the place of the undeflected
            target in rows that read a turn.
        deflection: (R, 3) the elastic and other displacement contained in it, m (rotation vectors, rad, in such rows).
        derivative: (R, 3, p) m or rad per unit of each parameter; (R, 3, 0) if not asked for. Columns behind the last
            one that is wanted may be left out. Those of turns are of first order: off by the share that the deflection
            is of a radian.
        direct: The same without the part that works through the deflection (geometry and markers bend it); rank is
            decided on these columns, so that nothing counts as known through its second-order trace alone.
        turned: (K, 3, 3) orientations of the 6-D targets in the K rows that read a turn, base frame.
    """

    scene: Scene
    position: Floats
    deflection: Floats
    derivative: Floats
    direct: Floats
    turned: Floats


def respond(
    model: Model,
    experiment: Experiment,
    values: Floats,
    *,
    derivative: bool = True,
    wanted: np.ndarray | None = None,
    known: Scene | None = None,
    bending: bool = True,
) -> Response:
    """Where every row should be read, and how that depends on the parameters.

    Args:
        model: The model.
        experiment: The conditions.
        values: (p,) parameters in their units.
        derivative: Also compute the derivative.
        wanted: (p,) True for columns that are needed (all by default); others may be zero, or missing at the end.
        known: `undeflected` of this model and experiment, where it is at hand.
        bending: Columns count how geometry and markers bend the deflection, a matter of second order.
    """
    wanted = np.ones(len(model.parameters), dtype=bool) if wanted is None else wanted
    scene, deflection = deflected(model, experiment, values, known=known)
    turn, shift = frame_displacement(model, values)
    position = displaced_points(scene, deflection) @ turn.T + shift
    turned = _turned(model, scene, deflection, values)
    if not derivative:
        nothing = np.zeros((*position.shape, 0))
        return Response(scene, position, deflection, nothing, nothing, turned)
    direct = _derivative(model, scene, scene.point @ turn.T + shift, values, wanted)
    for column, part in through_columns(model, experiment, values, wanted):
        direct[:, :, column] = part
    columns = direct
    if bending and deflection.any():
        columns = _with_bending(direct, model, experiment, values, scene, deflection, wanted)
    if model.frame_size and columns is not direct:
        columns[:, :, 3:6] = _frame_turn(scene, position)
    return Response(scene, position, deflection, columns, direct, turned)


def displaced_points(scene: Scene, deflection: Floats) -> Floats:
    """(R, 3) deflected markers, base frame, m; those of rows that read a turn stay where they are."""
    turning = scene.experiment.row_turns
    moved: Floats = scene.point + (deflection if turning is None else np.where(turning[:, None], 0.0, deflection))
    return moved


def deflected(
    model: Model, experiment: Experiment, values: Floats, tolerance: float = TOLERANCE, known: Scene | None = None
) -> tuple[Scene, Floats]:
    """The scene on the adjusted robot and the (R, 3) displacement that all effects add, m.

    Args:
        model: The model.
        experiment: The conditions.
        values: (p,) parameters in their units.
        tolerance: Of the loaded equilibrium, rad or m.
        known: `undeflected` of this model and experiment, where it is at hand.
    """
    if known is None:
        scene = _scene(model, experiment, values)
    else:
        scene = known.with_markers(marker_positions(model, experiment, values))
    return _yielding(model, scene, values, tolerance)


def undeflected(model: Model, experiment: Experiment) -> Scene | None:
    """The scene that all values of the parameters have in common but for their markers; None if they change the arm."""
    if any(effect.adjust is not None or effect.reload is not None for effect in model.effects):
        return None
    return _scene(model, experiment, model.nominal)


def _scene(model: Model, experiment: Experiment, values: Floats) -> Scene:
    """The undeflected scene on the adjusted robot."""
    robot = model.robot
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if effect.adjust is not None:
            robot = effect.adjust(robot, values[where])
        if effect.reload is not None:
            experiment = effect.reload(experiment, values[where])
    markers = marker_positions(model, experiment, values)
    return build_scene(experiment, forward(robot, experiment.q), markers, self_weight=model.self_weight)


def _yielding(model: Model, scene: Scene, values: Floats, tolerance: float = TOLERANCE) -> tuple[Scene, Floats]:
    """The scene, in equilibrium if the model asks for that, and the (R, 3) displacement, m."""
    given = [(effect, values[inputs]) for effect, inputs in zip(model.effects, model.effect_inputs, strict=True)]
    deflection = np.zeros_like(scene.point)
    if model.loaded:
        scene = load_scene(scene, *spring_matrix(given, model.robot.n), tolerance=tolerance)
        deflection = scene.moved
    twists = _twists(model, scene, values)
    if twists is not None:
        deflection = deflection + scene.carried(twists)
    for effect, inputs in given:
        if not _is_rigid(model, effect) and not (model.loaded and effect.springs):
            deflection = deflection + effect.displacement(scene, inputs)
    return scene, deflection


def _is_rigid(model: Model, effect: Effect) -> bool:
    """True if the model counts what an effect does as a twist of the flange; a loaded arm is no such thing."""
    return effect.twist is not None and not (model.loaded and effect.springs)


def _twists(model: Model, scene: Scene, values: Floats) -> Floats | None:
    """Twists (S, 6) of the flange by all effects that move it as a rigid body; None if there is none."""
    total = None
    for effect, inputs in zip(model.effects, model.effect_inputs, strict=True):
        if effect.twist is not None and _is_rigid(model, effect):
            twist = effect.twist(scene, values[inputs])
            total = twist if total is None else total + twist
    return total


def _with_bending(
    direct: Floats,
    model: Model,
    experiment: Experiment,
    values: Floats,
    scene: Scene,
    deflection: Floats,
    wanted: np.ndarray,
) -> Floats:
    """Add how the deflection itself changes when geometry or markers move: the second-order part of their columns.

    Markers ride on a flange that is twisted; the rest by forward differences of a small term (a step of 1 um or
    1 urad in a field of some mm).
    """
    markers = slice(model.frame_size, model.frame_size + model.marker_size)
    own = [
        column
        for effect, where in zip(model.effects, model.effect_slices, strict=True)
        if effect.adjust is not None and not effect.through
        for column in range(where.start, where.stop)
        if wanted[column]
    ]
    if not own and not wanted[: markers.stop].any():
        return direct
    columns = direct.copy()
    if wanted[markers].any():
        columns[:, :, markers] += _by_marker(scene, _marker_bending(model, experiment, values, scene, deflection))
    for column in own:
        nudged = values.copy()
        nudged[column] += _NUDGE
        columns[:, :, column] += (deflected(model, experiment, nudged)[1] - deflection) / _NUDGE
    return columns


def _marker_bending(model: Model, experiment: Experiment, values: Floats, scene: Scene, deflection: Floats) -> Floats:
    """(R, 3, 3) change of the deflection of each row by the three coordinates of its marker, m per mm."""
    twists, change = _twists(model, scene, values), np.zeros((*deflection.shape, 3))
    if twists is not None:
        change += skew(twists[:, 3:])[experiment.row_shot] @ _marker_turn(scene)  # nothing where a turn is read
        change[scene.on_base] = 0.0
    if all(_is_rigid(model, effect) for effect in model.effects):
        return change
    for axis in range(3):  # every row has its own marker
        nudged = values.copy()
        nudged[model.frame_size : model.frame_size + model.marker_size][axis::3] += _NUDGE
        elsewhere = scene.with_markers(marker_positions(model, experiment, nudged))
        moved = _yielding(model, elsewhere, nudged)[1] - deflection
        if twists is not None:
            moved -= elsewhere.carried(twists) - scene.carried(twists)
        change[:, :, axis] += moved / _NUDGE
    return change


def through_columns(
    model: Model, experiment: Experiment, values: Floats, wanted: np.ndarray | None = None
) -> Iterator[tuple[int, Floats]]:
    """Columns of effects that act through the springs of others: index and (R, 3), m per unit.

    By central differences. Torques are linear in masses, lever arms and forces, so any step is exact there, and one
    that is not small keeps rounding far below what rank is decided at.

    Args:
        model: The model.
        experiment: The conditions.
        values: (p,) parameters in their units.
        wanted: (p,) True for columns that are needed; all by default.
    """
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        for column in range(where.start, where.stop) if effect.through else ():
            if wanted is None or wanted[column]:
                nudge = _STEP * (np.arange(len(values)) == column)
                ahead, behind = (deflected(model, experiment, v)[1] for v in (values + nudge, values - nudge))
                yield column, (ahead - behind) / (2 * _STEP)


def added_columns(
    model: Model, effect: Effect, own: Ints, response: Response, experiment: Experiment, values: Floats
) -> Floats:
    """Columns that an effect would add to a model, at the effect's nominal values.

    Args:
        model: The model without the effect.
        effect: The effect, bound beside the model's effects.
        own: (b,) parameters of the effect that are asked for.
        response: The model at ``values``.
        experiment: The conditions.
        values: (p,) parameters of the model in their units.

    Returns:
        (R, 3, b) m per unit; what works through the deflection of the geometry is left out.
    """
    larger = with_effect(model, effect)
    given = np.append(values, [parameter.nominal for parameter in effect.parameters])
    if not effect.through:
        inputs = larger.effect_inputs[-1]
        return effect.derivative(response.scene, given[inputs])[:, :, own]
    columns = np.zeros((len(response.scene.point), 3, len(own)))
    if not any(other.yields for other in model.effects):
        return columns  # no spring to act through
    for column, index in enumerate(len(values) + own):  # one-sided: exact but for the turn of gravity
        nudged = given + _STEP * (np.arange(len(given)) == index)
        columns[:, :, column] = (deflected(larger, experiment, nudged)[1] - response.deflection) / _STEP
    return columns


def marker_positions(model: Model, experiment: Experiment, values: Floats) -> Floats:
    """(M, 3) markers in their own frames with the corrections of the marker parameters, m."""
    if not model.marker_size:
        return experiment.markers.positions
    corrections = values[model.frame_size : model.frame_size + model.marker_size]
    moved: Floats = experiment.markers.positions + MM * corrections.reshape(-1, 3)
    return moved


def frame_displacement(model: Model, values: Floats) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) of the frame parameters."""
    if not model.frame_size:
        return np.eye(3), np.zeros(3)
    return rotation_of(values[3:6] * MRAD), values[:3] * MM


def _derivative(model: Model, scene: Scene, position: Floats, values: Floats, wanted: np.ndarray) -> Floats:
    """(R, 3, p); the turn of the frame parameters, which are small, is left out of the other columns."""
    columns = effect_columns(model, scene, values, wanted)
    nuisance = nuisance_columns(model, scene, position, values)
    columns[:, :, : nuisance.shape[2]] = nuisance
    return columns


def nuisance_columns(model: Model, scene: Scene, position: Floats, values: Floats) -> Floats:
    """Columns of frame, markers and turns of markers on the undeflected arm, (R, 3, nuisance), m or rad per unit.

    Args:
        model: The model.
        scene: The rows.
        position: (R, 3) where the markers are, displaced by the frame parameters, m.
        values: (p,) parameters in their units.
    """
    columns = np.zeros((len(scene.point), 3, model.nuisance_size))
    if model.frame_size:
        columns[:, :, :3] = MM * np.eye(3)
        columns[:, :, 3:6] = _frame_turn(scene, position)
        columns[scene.turning, :, :3] = 0.0
    if model.marker_size:
        markers = slice(model.frame_size, model.frame_size + model.marker_size)
        columns[:, :, markers] = _by_marker(scene, _marker_turn(scene))
    if model.turn_size:
        turns = slice(model.nuisance_size - model.turn_size, model.nuisance_size)
        columns[:, :, turns] = _by_marker(scene, _target_turn(scene, target_turns(model, values)))[
            :, :, : model.turn_size
        ]
    return columns


def _frame_turn(scene: Scene, position: Floats) -> Floats:
    """(R, 3, 3) motion of what rows read by a turn of the base, m or rad per mrad."""
    columns = -MRAD * skew(position)
    columns[scene.turning] = MRAD * np.eye(3)
    return columns


def effect_columns(model: Model, scene: Scene, values: Floats, wanted: np.ndarray | None = None) -> Floats:
    """(R, 3, p) derivative of the displacement by the effects' parameters, m per unit; zero for frame and markers.

    What an effect says about parameters that it borrows adds to their own columns. Effects of which nothing is
    ``wanted`` (p,) stay zero; columns behind the last one wanted are left out.
    """
    asked = [wanted is None or bool(wanted[inputs].any()) for inputs in model.effect_inputs]
    columns, lent = np.zeros((len(scene.point), 3, _leading(model, wanted, asked))), []
    every = zip(model.effects, model.effect_slices, model.effect_inputs, strict=True)
    for effect, where, inputs in compress(every, asked):
        part = effect.derivative(scene, values[inputs])
        own = len(effect.parameters)
        columns[:, :, where] = part[:, :, :own]
        lent.append((inputs[own:], part[:, :, own:]))
    for index, part in lent:
        columns[:, :, index] += part
    return columns


def _leading(model: Model, wanted: np.ndarray | None, asked: list[bool]) -> int:
    """Number of columns up to the last one that is wanted or comes with one that is."""
    if wanted is None:
        return len(model.parameters)
    ends = [int(inputs.max(initial=-1)) + 1 for inputs in compress(model.effect_inputs, asked)]
    return max(model.nuisance_size, *ends, int(np.flatnonzero(wanted).max(initial=-1)) + 1)


def _marker_turn(scene: Scene) -> Floats:
    """(R, 3, 3) motion of each row by its own marker's coordinates, m per mm; what is on the base is not turned."""
    turn: Floats = MM * scene.frames.flange_rotation[scene.row_pose]
    turn[scene.on_base] = MM * np.eye(3)
    turn[scene.turning] = 0.0
    return turn


def target_turns(model: Model, values: Floats) -> Floats:
    """(M, 3) how the 6-D targets are turned about the axes of the flange, rotation vectors, rad."""
    sizes: Floats = MRAD * values[model.nuisance_size - model.turn_size : model.nuisance_size].reshape(-1, 3)
    return sizes


def _target_turn(scene: Scene, sizes: Floats) -> Floats:
    """(R, 3, 3) turn of each row by how its own target sits on the flange, rad per mrad; zero for positions."""
    turn = np.zeros((len(scene.point), 3, 3))
    rows = np.flatnonzero(scene.turning)
    marker = scene.experiment.row_marker[rows]
    turn[rows] = MRAD * scene.frames.flange_rotation[scene.row_pose[rows]] @ rotation_of(sizes)[marker]
    return turn


def _turned(model: Model, scene: Scene, deflection: Floats, values: Floats) -> Floats:
    """(K, 3, 3) orientations of the targets in the rows that read a turn, base frame."""
    rows = np.flatnonzero(scene.turning)
    flange = scene.frames.flange_rotation[scene.row_pose[rows]]
    if model.turn_size:
        flange = flange @ rotation_of(target_turns(model, values))[scene.experiment.row_marker[rows]]
    return np.asarray(frame_displacement(model, values)[0] @ rotation_of(deflection[rows]) @ flange)


def _by_marker(scene: Scene, change: Floats) -> Floats:
    """Columns (R, 3, 3 M) of what each row does (R, 3, 3) by three numbers of its own marker."""
    columns = np.zeros((len(change), 3, len(scene.experiment.markers.names), 3))
    columns[np.arange(len(change)), :, scene.experiment.row_marker] = change
    return columns.reshape(len(change), 3, -1)
