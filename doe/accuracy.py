"""Expected error at the test poses: its covariance and its mean square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.error_radius import radii
from identify.kinematics import forward, jacobian
from identify.study import Study
from identify.units import MM

__all__ = ["Accuracy", "accuracy", "jitter_covariance"]


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Accuracy at t test poses, mm.

    Attributes:
        covariance: (t, 3, 3) of the error from parameter uncertainty, mm^2, base frame.
        jitter: (t, 3, 3) of the robot's own pose jitter, mm^2.
        weights: (t,) weights, sum 1.
    """

    covariance: Floats
    jitter: Floats
    weights: Floats

    @property
    def rms(self) -> float:
        """``sqrt(sum weight E|e|^2)``, parameters only, mm."""
        return float(np.sqrt(self.weights @ np.trace(self.covariance, axis1=1, axis2=2)))

    @property
    def rms_total(self) -> float:
        """The same with the robot's pose jitter, mm."""
        return float(np.sqrt(self.weights @ np.trace(self.covariance + self.jitter, axis1=1, axis2=2)))

    def radius(self, confidence: float) -> float:
        """Radius that holds the total error with this confidence at the worst test pose, mm."""
        return float(radii(self.covariance + self.jitter, confidence).max())


def accuracy(study: Study, rows: Floats, covariance: Floats) -> Accuracy:
    """Accuracy at the test poses of a study.

    Args:
        study: The study.
        rows: (t, 3, p) error per unit of each parameter, mm.
        covariance: (p, p) of the parameters.
    """
    weights = np.array([pose.weight for pose in study.test_poses])
    return Accuracy(rows @ covariance @ rows.swapaxes(1, 2), jitter_covariance(study), weights / weights.sum())


def jitter_covariance(study: Study) -> Floats:
    """(t, 3, 3) covariance of the points of the test poses from the robot's pose jitter, mm^2."""
    frames = forward(study.robot, np.stack([pose.q for pose in study.test_poses]))
    points = frames.point(np.stack([pose.point for pose in study.test_poses]))
    linear = jacobian(frames, points)[:, :3] * (study.noise.pose_jitter / MM)
    product: Floats = linear @ linear.swapaxes(1, 2)
    return product
