"""Measurements from a stated truth: exact kinematics at jittered joints, instrument noise on top."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.alignment import inverse
from identify.arrays import Floats, rotation_of
from identify.experiment import Experiment, Measurements
from identify.model import Model
from identify.noise import reading_covariance
from identify.response import respond
from identify.six_d import as_read, with_turns
from identify.study import Noise

__all__ = ["default_placement", "simulate"]


def simulate(
    model: Model,
    values: Floats,
    experiment: Experiment,
    noise: Noise,
    base_T_measurement: Floats,
    rng: np.random.Generator,
) -> Measurements:
    """Readings of an experiment.

    Args:
        model: The true model.
        values: (p,) its true parameters in their units.
        experiment: The conditions, with the commanded joint values.
        noise: The true noise.
        base_T_measurement: (4, 4) placement of the measurement frame.
        rng: Random numbers: pose jitter, reading jitter, instrument noise, in this order.

    Returns:
        Positions, and orientations where the noise of 6-D targets is stated (markers on the base have none).
    """
    respond_to = _jittered(experiment, noise, rng)
    if noise.orientation > 0:
        respond_to = with_turns(respond_to)
    response = respond(model, respond_to, values, derivative=False)
    position, turning = response.position, respond_to.turning
    covariance = reading_covariance(noise, respond_to, position, base_T_measurement[:3, 3])
    errors = np.einsum("rij,rj->ri", np.linalg.cholesky(covariance), rng.standard_normal(position.shape))
    back, quaternions = inverse(base_T_measurement), None
    read = (position + errors) @ back[:3, :3].T + back[:3, 3]
    if noise.orientation > 0:
        turned = back[:3, :3] @ rotation_of(errors[turning]) @ response.turned
        _, read, quaternions = as_read(respond_to, read, turned)
    return Measurements(experiment, read, np.arange(2, len(read) + 2), quaternions, source="simulation")


def _jittered(experiment: Experiment, noise: Noise, rng: np.random.Generator) -> Experiment:
    """The same experiment with the joint values of every shot as they really are."""
    shots, joints = len(experiment.shot_visit), experiment.q.shape[1]
    pose = noise.pose_jitter * rng.standard_normal((len(experiment.visits), joints))
    reading = noise.reading_jitter * rng.standard_normal((shots, joints))
    q = experiment.q[experiment.shot_pose] + pose[experiment.shot_visit] + reading
    return replace(experiment, q=q, shot_pose=np.arange(shots))


def default_placement(noise: Noise, *, frame_free: bool) -> Floats:
    """Where the measurement frame stands if the truth does not say: at the tracker's station, axes as the base's."""
    placement = np.eye(4)
    if frame_free and noise.tracker is not None and noise.tracker.station is not None:
        placement[:3, 3] = noise.tracker.station
    return placement
