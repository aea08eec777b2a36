"""Line of sight: which reflectors a laser tracker sees at a pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from doe.distances import crosses_box, segment_distance
from doe.gaps import Gaps
from identify.arrays import Floats
from identify.cell import Visibility
from identify.errors import InputError
from identify.kinematics import Frames
from identify.loads import Markers
from identify.study import Study

__all__ = ["Sight", "sight"]


@dataclass(frozen=True, eq=False)
class Sight:
    """A tracker, what it looks at, and what may stand between.

    Attributes:
        station: (3,) base frame, m.
        limits: What must hold.
        required: Number of markers that must be seen.
        markers: Markers on the flange.
        gaps: Arm, boxes and hung weights.
    """

    station: Floats
    limits: Visibility
    required: int
    markers: Markers
    gaps: Gaps

    @property
    def by_reason(self) -> Mapping[str, Callable[[Frames], np.ndarray]]:
        """Reason -> function of N poses to (N, 1) or (N, L), True where too few markers are left."""
        return {
            "tracker_range": lambda frames: self._too_few(self.in_range(frames)),
            "reflector_angle": lambda frames: self._too_few(self.in_range(frames) & self.turned_here(frames)),
            "line_of_sight": lambda frames: self._too_few(self.seen(frames)),
        }

    def _too_few(self, seen: np.ndarray) -> np.ndarray:
        """(N, M) or (N, M, L) -> (N, 1) or (N, L)."""
        few = np.asarray(seen.sum(axis=1) < self.required, dtype=bool)
        return np.asarray(few.reshape(len(seen), -1))

    def points(self, frames: Frames) -> Floats:
        """(N, M, 3) markers, base frame, m."""
        turned = np.einsum("vij,mj->vmi", frames.flange_rotation, self.markers.positions)
        return np.asarray(frames.flange_origin[:, None] + turned)

    def in_range(self, frames: Frames) -> np.ndarray:
        """(N, M) True within the range of the tracker."""
        distance = np.linalg.norm(self.points(frames) - self.station, axis=2)
        return np.asarray((distance >= self.limits.nearest) & (distance <= self.limits.farthest))

    def turned_here(self, frames: Frames) -> np.ndarray:
        """(N, M) True where the tracker stands in the reflector's cone, or the reflector looks everywhere."""
        if self.limits.acceptance is None:
            return np.ones((len(frames.origin), len(self.markers.names)), dtype=bool)
        beam = self.station - self.points(frames)
        looks = np.einsum("vij,mj->vmi", frames.flange_rotation, self.markers.normals)
        cosine = np.einsum("vmi,vmi->vm", beam, looks) / np.maximum(np.linalg.norm(beam, axis=2), 1e-9)
        away = cosine < np.cos(self.limits.acceptance) - 1e-12  # never for nan, where no direction is stated
        return np.asarray(~away)

    def seen(self, frames: Frames) -> np.ndarray:
        """(N, M) or, where hung weights count, (N, M, L): True for markers that are read."""
        seen = self.in_range(frames) & self.turned_here(frames)
        if not self.limits.occlusion:
            return np.asarray(seen)
        points = self.points(frames)
        seen = seen & ~self._behind_arm(frames, points) & ~self._behind_boxes(points)
        hung = self.gaps.weights
        if not hung.extended.any():
            return np.asarray(seen)
        return np.asarray(seen[:, :, None] & ~self._behind_weights(frames, points))

    def _behind_arm(self, frames: Frames, points: Floats) -> np.ndarray:
        """(N, M) True where a capsule cuts the line; one at the flange that holds the marker itself does not count."""
        arm = self.gaps.capsules
        start, end = (ends[:, None] for ends in arm.segments(frames))
        marker = points[:, :, None]
        hidden = segment_distance(marker, self.station, start, end) < arm.radii
        inside = segment_distance(marker, marker, start, end) < arm.radii
        return np.asarray((hidden & ~(inside & arm.at_flange)).any(axis=2))

    def _behind_boxes(self, points: Floats) -> np.ndarray:
        """(N, M) True where a box cuts the line."""
        hidden = np.zeros(points.shape[:2], dtype=bool)
        for box in self.gaps.boxes:
            hidden |= crosses_box(box.local(points), box.local(self.station), box.half)
        return hidden

    def _behind_weights(self, frames: Frames, points: Floats) -> np.ndarray:
        """(N, M, L) True where a hung body cuts the line; ropes are too thin to count."""
        hung = self.gaps.weights
        centres = hung.centres(hung.tops(frames))
        hidden = np.zeros((*points.shape[:2], len(hung.hang)), dtype=bool)
        for i in np.flatnonzero(hung.half.any(axis=1)):
            centre = centres[:, i, None]
            marker, tracker = ((end - centre) @ hung.axes for end in (points, self.station[None, None]))
            hidden[:, :, i] = crosses_box(marker, tracker, hung.half[i])
        return hidden


def sight(study: Study, gaps: Gaps) -> Sight | None:
    """The line of sight of a study; None where it is not checked.

    Raises:
        InputError: The tracker stands nowhere, or inside a part of the arm that does not move.
    """
    limits, station = study.constraints.visibility, study.station
    if limits is None:
        return None
    if station is None:
        raise InputError(
            f"{study.path}: [constraints.visibility]: the tracker stands nowhere; give [[tracker_stations]] or "
            "[noise.tracker] station_mm"
        )
    markers = study.markers.without(np.array(study.markers.names)[study.markers.on_base])
    mounted = len(markers.names)
    if study.plan.markers is not None:
        mounted += study.plan.markers - len(study.marker_choices)
    return Sight(station, limits, limits.required or mounted, markers, gaps)
