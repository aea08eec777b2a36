"""6-D targets: their orientations as rows beside those of their positions.

A reading of a 6-D target is a position and an orientation. In a fit it is two rows: one of the position, and one of
the turn, a rotation vector in the base frame, whose columns are how fast the flange turns. Both share the jitter of
their visit and shot, so nothing else about them is special.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats, Ints
from identify.experiment import Experiment, Measurements
from identify.kinematics import forward
from identify.model import Model
from identify.rotations import quaternions
from identify.study import Study

__all__ = ["as_read", "facing", "position_rows", "positions_only", "with_turns", "with_turns_read"]


def positions_only(study: Study) -> Study:
    """The study of an instrument that reads positions alone."""
    return replace(study, noise=replace(study.noise, orientation=0.0)) if study.six_d else study


def with_turns(experiment: Experiment) -> Experiment:
    """The experiment in which every shot also reads how its markers on the flange are turned."""
    order, turning = _order(experiment)
    return replace(experiment.with_rows(order), row_turns=turning)


def with_turns_read(data: Measurements) -> Measurements:
    """The readings with a row for each orientation; a fit of a model with 6-D targets takes these."""
    assert data.quaternions is not None
    order, turning = _order(data.experiment)
    return replace(
        data,
        experiment=replace(data.experiment.with_rows(order), row_turns=turning),
        positions=data.positions[order],
        lines=data.lines[order],
        quaternions=data.quaternions[order],
    )


def _order(experiment: Experiment) -> tuple[Ints, np.ndarray]:
    """Which row each row comes from, and True for those that read a turn; within a shot they follow the positions."""
    count = len(experiment.row_shot)
    turned = np.flatnonzero(~experiment.markers.on_base[experiment.row_marker])
    source = np.concatenate([np.arange(count), turned])
    turning = np.arange(len(source)) >= count
    order = np.lexsort([source, turning, experiment.row_shot[source]])
    return source[order], turning[order]


def as_read(experiment: Experiment, positions: Floats, turned: Floats) -> tuple[Experiment, Floats, Floats]:
    """The other way round: one row a reading.

    Args:
        experiment: Of `with_turns`.
        positions: (R, 3) of its rows, m.
        turned: (K, 3, 3) orientations in its K rows that read a turn.

    Returns:
        The experiment without them, (R - K, 3) positions, and (R - K, 4) quaternions w, x, y, z, w >= 0; markers on
        the base have none and get that of no turn.
    """
    kept = np.flatnonzero(~experiment.turning)
    plain = replace(experiment.with_rows(kept), row_turns=None)
    units = np.tile([1.0, 0.0, 0.0, 0.0], (len(experiment.row_shot), 1))
    units[position_rows(experiment)] = quaternions(turned)
    return plain, positions[kept], units[kept]


def position_rows(experiment: Experiment) -> Ints:
    """(K,) rows of the positions that were read together with the K turns."""
    key = experiment.row_shot * len(experiment.markers.names) + experiment.row_marker
    places = np.flatnonzero(~experiment.turning)
    order = np.argsort(key[places])
    found: Ints = places[order[np.searchsorted(key[places][order], key[experiment.turning])]]
    return found


def facing(model: Model, data: Measurements, placement: Floats) -> tuple[Measurements, Floats]:
    """The readings as if every 6-D target had the axes of the flange.

    How a target sits on the flange is any rotation. Its mean over all readings, against the nominal arm, is taken out
    once; what is wrong with that mean is small and is a parameter of the model.

    Args:
        model: The model; without turns of markers among its parameters nothing is taken out.
        data: Of `with_turns_read`.
        placement: (4, 4) base_T_measurement as far as it is known.

    Returns:
        The readings, and (M, 3, 3) flange_R_target of the markers (identity where nothing was read).
    """
    from scipy.spatial.transform import Rotation

    experiment = data.experiment
    mounts = np.tile(np.eye(3), (len(experiment.markers.names), 1, 1))
    if not model.turn_size:
        return data, mounts
    rows = np.flatnonzero(experiment.turning)
    flange = forward(model.robot, experiment.q).flange_rotation[experiment.shot_pose[experiment.row_shot[rows]]]
    read = data.orientations(rows)
    for marker in np.unique(experiment.row_marker[rows]):
        own = experiment.row_marker[rows] == marker
        seen = flange[own].swapaxes(1, 2) @ placement[:3, :3] @ read[own]
        mounts[marker] = Rotation.from_matrix(seen).mean().as_matrix()
    faced = read @ mounts[experiment.row_marker[rows]].swapaxes(1, 2)
    units = np.array(data.quaternions)
    units[rows] = quaternions(faced)
    return replace(data, quaternions=units), mounts
