"""What is allowed in a study but can hardly be meant: sizes in wrong units, a sunk tracker, work without load."""

from __future__ import annotations

import numpy as np

from doe.accuracy import Accuracy
from identify.study import Study
from identify.units import MM

__all__ = ["study_notes", "work_notes"]

_REACH = (0.02, 20.0)  # m: no arm that a tracker measures is smaller or larger
_TOGETHER = 1e-3  # m: reflectors that are all this close are one
_NOTHING = 5e-5  # mm: what a plan prints as an error of 0.0000 mm


def study_notes(study: Study) -> tuple[str, ...]:
    """What the user should look at again in the robot, the markers and the tracker stations.

    Args:
        study: The study, checked.

    Returns:
        Notes; none if all is usual.
    """
    return (*_reach_notes(study), *_marker_notes(study), *_station_notes(study))


def work_notes(reached: Accuracy | None) -> tuple[str, ...]:
    """A note if the test poses hardly load the arm, so that nothing they tell about a plan is worth knowing.

    Args:
        reached: Accuracy at the test poses, or None without any.
    """
    if reached is None or reached.rms >= _NOTHING:
        return ()
    return (
        f"the expected error at the test poses is {reached.rms:.1e} mm rms, next to nothing: their loads hardly turn "
        "the joints, so that any plan looks good there; state [[test_poses]] with the wrenches of the work",
    )


def _reach_notes(study: Study) -> tuple[str, ...]:
    """A robot file in mm, or a model of one."""
    reach, (least, most) = study.robot.reach, _REACH
    if not np.isfinite(reach) or least <= reach <= most:
        return ()
    return (
        f"robot {study.robot.name} reaches {reach / MM:.4g} mm, usual are {least / MM:g} to {most / MM:g}: lengths in "
        "URDF files are in m, in robot files of this project in mm",
    )


def _marker_notes(study: Study) -> tuple[str, ...]:
    """Reflectors on the flange that are all in one place."""
    points = study.markers.positions[~study.markers.on_base]
    if len(points) < 2 or np.linalg.norm(points - points[0], axis=1).max() >= _TOGETHER:
        return ()
    return (
        f"all {len(points)} markers on the flange lie within {_TOGETHER / MM:g} mm of {study.markers.names[0]}: "
        "turns of the flange are not seen; [markers] are in mm",
    )


def _station_notes(study: Study) -> tuple[str, ...]:
    """Tracker stations below the floor."""
    floor = study.constraints.floor
    if floor is None:
        return ()
    heights = [(place.name, float((study.robot.world_R_base @ place.position)[2])) for place in study.stations]
    return tuple(
        f"tracker station {name} stands {(floor - height) / MM:.4g} mm below the floor ([constraints] floor_mm)"
        for name, height in heights
        if height < floor
    )
