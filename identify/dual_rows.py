"""Rows of a fit by the second road: poses, torques and columns from dual quaternions, nothing from the springs.

A shot reads the pose p of a 6-D target; the model says it is q. The deviation ``p q^-1 - 1`` is eight numbers, of which
six are free: half the twist that carries one to the other (Li, Zhang, Fu, Wang, eq. 33, 36). Its columns by the joint
compliances are eq. 32. Noise is known of the position and the turn that were read, that is of six numbers; carried to
the eight it has a covariance of rank six. Whitening eight rows by its pseudo-inverse is the same as going back to the
six by the pseudo-inverse of the map and whitening there, and so it is done. Two residuals:

* ``dual_quaternions``: position and turn between p and q, exactly. The same numbers as on the ordinary road.
* ``dual_quaternion_deviations``: the deviation itself, as the paper has it. It differs from the other one by products
  of turns and displacements, a matter of second order in what the model leaves.
"""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats, skew
from identify.dual_quaternions.algebra import conjugate, normalise, product
from identify.dual_quaternions.chain import DualChain, Postures, dual_chain, joint_frames, postures
from identify.dual_quaternions.correction import pose_error
from identify.dual_quaternions.elastic import apply_wrench, joint_torques
from identify.dual_quaternions.placements import from_rotation, placed, rotation, transform
from identify.dual_quaternions.screws import TWIST_OF_DEVIATION, exp
from identify.effects import Scene, build_scene
from identify.errors import InputError
from identify.experiment import Experiment
from identify.kinematics import forward
from identify.model import Model
from identify.response import (
    Response,
    frame_displacement,
    marker_positions,
    nuisance_columns,
    target_turns,
)
from identify.six_d import position_rows
from identify.units import SI_OF

__all__ = ["deviation_residual", "dual_respond"]


def dual_respond(model: Model, experiment: Experiment, values: Floats, *, derivative: bool = True) -> Response:
    """Where every row should be read, and how that depends on the parameters; as `identify.response.respond`.

    Args:
        model: The model; joint compliances are all that this road knows.
        experiment: The conditions.
        values: (p,) parameters in their units.
        derivative: Also compute the derivative.

    Raises:
        InputError: The model holds other effects, or asks for the loaded equilibrium.
    """
    _check(model)
    local, (turn, shift) = marker_positions(model, experiment, values), frame_displacement(model, values)
    chain = dual_chain(model.robot)
    at = postures(chain, experiment.q)
    scene = build_scene(experiment, forward(model.robot, experiment.q), local, self_weight=model.self_weight)
    point = transform(at.pose[scene.row_pose], local[experiment.row_marker])
    point[scene.on_base] = local[experiment.row_marker[scene.on_base]]
    columns = _compliance_columns(model, experiment, at, _weight_torque(model, chain, experiment.q, at))
    twists = columns @ values[model.nuisance_size :]
    moved = _as_read(scene, twists[:, :, None], point)[:, :, 0]
    position = (point + np.where(scene.turning[:, None], 0.0, moved)) @ turn.T + shift
    turned = _turned(model, scene, at, moved, values)
    if not derivative:
        nothing = np.zeros((len(point), 3, 0))
        return Response(scene, position, moved, nothing, nothing, turned)
    direct = np.concatenate(
        [nuisance_columns(model, scene, point @ turn.T + shift, values), _as_read(scene, columns, point)], axis=2
    )
    bent = _with_bending(model, scene, direct, position, twists, values)
    return Response(scene, position, moved, bent, direct, turned)


def deviation_residual(response: Response, experiment: Experiment, read: Floats, turned: Floats) -> Floats:
    """The residual of the paper in the layout of rows: eight numbers of each pose, read back as position and turn.

    Args:
        response: What the model says.
        experiment: The conditions.
        read: (R, 3) positions that were read, base frame, m.
        turned: (K, 3, 3) orientations that were read, base frame.

    Returns:
        (R, 3) m, or rad where a turn is read; positions without an orientation keep their plain difference.
    """
    turns = np.flatnonzero(experiment.turning)
    places = position_rows(experiment)
    wanted = placed(from_rotation(turned), read[places])
    model = placed(from_rotation(response.turned), response.position[places])
    twist = pose_error(wanted, model) @ TWIST_OF_DEVIATION.T
    residual = read - response.position
    residual[turns] = twist[:, 3:]
    residual[places] = twist[:, :3] + np.cross(twist[:, 3:], response.position[places])
    return residual


def _check(model: Model) -> None:
    """Refuse what this road does not know."""
    others = sorted({effect.name for effect in model.effects} - {"joint_compliance"})
    if others or model.loaded:
        what = f"effects hold {', '.join(others)}" if others else 'equilibrium = "loaded"'
        raise InputError(
            f'[model] rows = "{model.rows}": {what}; rows by dual quaternions know joint_compliance on the undeflected '
            'arm alone. Use rows = "vectors" for this model'
        )


def _compliance_columns(model: Model, experiment: Experiment, at: Postures, weight: Floats) -> Floats:
    """Twists (S, 6, m) of the flange about the base origin per unit of each compliance, m or rad.

    Args:
        model: The model.
        experiment: The conditions.
        at: The arm in all poses.
        weight: (C, n) torques of its own weight.
    """
    own = model.parameters[model.nuisance_size :]
    joints = [int(parameter.name.rpartition(".j")[2]) - 1 for parameter in own]
    scale = np.array([SI_OF[parameter.unit] for parameter in own])
    shot = experiment.shot_pose
    there = Postures(at.robot, at.pose[shot], at.screws[shot])
    torque = weight[shot] + _load_torque(experiment, there)
    columns: Floats = TWIST_OF_DEVIATION @ (there.deviation * torque[:, None])[:, :, joints] * scale
    return columns


def _load_torque(experiment: Experiment, there: Postures) -> Floats:
    """(S, n) torque of what hangs on the flange, or of the wrenches that were measured."""
    torque = np.zeros((len(there.pose), there.robot.n))
    for index, load in enumerate(experiment.loads):
        shots = np.flatnonzero((experiment.shot_load == index) & ~experiment.shot_unloaded)
        if not len(shots):
            continue
        part = Postures(there.robot, there.pose[shots], there.screws[shots])
        if experiment.wrench is not None:
            fixed = np.zeros(len(shots)) if experiment.wrench_in_world is None else experiment.wrench_in_world[shots]
            acting = {"flange": experiment.wrench[shots] * (fixed == 0)[:, None]}
            acting["world"] = experiment.wrench[shots] - acting["flange"]
        else:
            acting = {"base": np.concatenate([load.mass * there.robot.gravity_base, np.zeros(3)])}
            acting["flange" if load.in_flange else "world"] = np.concatenate([load.force, load.moment])
        for frame, wrench in acting.items():
            torque[shots] += joint_torques(part, apply_wrench(part, wrench, load.attach, frame=frame))
    return torque


def _weight_torque(model: Model, chain: DualChain, q: Floats, at: Postures) -> Floats:
    """(C, n) torque of the weight of links and tool; a link loads the joints before it."""
    robot = at.robot
    torque = np.zeros((len(at.pose), robot.n))
    if not model.self_weight:
        return torque
    behind = np.concatenate([joint_frames(chain, q)[:, 1:], at.pose[:, None]], axis=1)
    moved = normalise(product(behind, conjugate(chain.placements[1:])))
    carried = [(mass, moved[:, i], robot.centres[i], i + 1) for i, mass in enumerate(robot.masses)]
    for mass, pose, centre, joints in [*carried, (robot.tool_mass, at.pose, robot.tool_centre, robot.n)]:
        here = Postures(robot, pose, at.screws)
        force = np.concatenate([mass * robot.gravity_base, np.zeros(3)])
        torque[:, :joints] += joint_torques(here, apply_wrench(here, force, centre))[:, :joints]
    return torque


def _as_read(scene: Scene, twists: Floats, point: Floats) -> Floats:
    """What twists (S, 6, k) of the flange about the base origin do to what rows read, (R, 3, k), m or rad."""
    each = twists[scene.experiment.row_shot]
    moved: Floats = each[:, :3] - skew(point) @ each[:, 3:]
    moved[scene.turning] = each[scene.turning, 3:]
    moved[scene.on_base] = 0.0
    return moved


def _turned(model: Model, scene: Scene, at: Postures, moved: Floats, values: Floats) -> Floats:
    """(K, 3, 3) orientations of the targets in the rows that read a turn, base frame."""
    rows = np.flatnonzero(scene.turning)
    small = np.zeros((len(rows), 8))
    small[:, 1:4] = 0.5 * moved[rows]
    pose = product(exp(small), at.pose[scene.row_pose[rows]])
    if model.turn_size:
        seat = np.zeros((len(rows), 8))
        seat[:, 1:4] = 0.5 * target_turns(model, values)[scene.experiment.row_marker[rows]]
        pose = product(pose, exp(seat))
    return np.asarray(frame_displacement(model, values)[0] @ rotation(normalise(pose)))


def _with_bending(
    model: Model, scene: Scene, direct: Floats, position: Floats, twists: Floats, values: Floats
) -> Floats:
    """The columns with markers that ride on the deflected flange, and a frame that turns the deflected arm."""
    if not model.nuisance_size:
        return direct
    columns, markers = direct.copy(), slice(model.frame_size, model.frame_size + model.marker_size)
    columns[:, :, : model.frame_size] = nuisance_columns(model, scene, position, values)[:, :, : model.frame_size]
    turn = np.where((scene.on_base | scene.turning)[:, None], 0.0, twists[scene.experiment.row_shot, 3:])
    columns[:, :, markers] += skew(turn) @ direct[:, :, markers]
    return columns
