"""The verb `drill`: forces of both arms against time while the drill goes through the board."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats
from identify.drilling.contact import Contact, Hole, contact_of, wrench_on_drill
from identify.drilling.course import Drilling, Feed
from identify.drilling.cutting import Cutting
from identify.drilling.facing import Facing
from identify.drilling.loop import Compensation, Sensors, compensation, sensor_noise
from identify.errors import InputError
from identify.units import MM

__all__ = ["drill"]


def drill(
    facing: Facing,
    cutting: Cutting | None = None,
    feed: Feed | None = None,
    *,
    sensors: Sensors | None = None,
    estimates: tuple[ArrayLike, ArrayLike] | None = None,
    rng: np.random.Generator | None = None,
) -> Drilling:
    """Drill through the board.

    Args:
        facing: Both arms and the feed direction.
        cutting: Drill and board; None: the defaults.
        feed: Commanded advance; None: the defaults.
        sensors: Wrist sensors; None: the defaults, without noise.
        estimates: Estimated joint compliances (n,) of the arm with the drill and of that with the board, as for
            `compensation`; None: no compensation.
        rng: Source of the sensor noise; needed only if there is any.

    Returns:
        The course of motion and forces. With a tool weight that is not compensated, the drill starts out of place.

    Raises:
        InputError: Wrong estimates, noisy sensors without ``rng``, or a drill that starts inside the board.
    """
    cutting, feed, sensors = cutting or Cutting(), feed or Feed(), sensors or Sensors()
    contact, loop = contact_of(facing, cutting, feed.step), compensation(facing, estimates)
    time, commanded = feed.depth(cutting)
    noise = sensor_noise(sensors, len(time), rng)
    hung = facing.jacobian @ (facing.compliance * facing.weight) + loop.weight
    nearer = float(hung[:3] @ facing.feed)
    if commanded[0] + nearer > 0.0:
        raise InputError(
            f"gap = {feed.gap / MM:g} mm: the tool weights alone bring the drill {nearer / MM:.3g} mm nearer to the "
            "board; choose a larger gap"
        )
    advance = commanded[:, None] * contact.axis
    motion, wrench, readings, used = _run(contact, loop, facing, advance + hung, noise, sensors)
    depth = motion @ contact.axis + cutting.plate_compliance * (wrench @ contact.axis)
    return Drilling(
        facing, cutting, time, depth, np.gradient(depth, feed.step), wrench,
        deviation=motion - advance,
        drill_reading=readings[:, :6], board_reading=readings[:, 6:],
        corrections=-loop.compliance * (used @ facing.torque.T + facing.weight),
        contact_time=_first(time, depth > 0.0),
        breakthrough_time=_first(time, depth >= cutting.thickness),
        through_time=_first(time, depth >= cutting.thickness + cutting.cone),
    )  # fmt: skip


def _run(
    contact: Contact, loop: Compensation, facing: Facing, free: Floats, noise: Floats, sensors: Sensors
) -> tuple[Floats, Floats, Floats, Floats]:
    """Step through time.

    Args:
        contact: What does not change.
        loop: The compensation.
        facing: Both arms.
        free: (T, 6) motion of drill against board without any contact.
        noise: (T, 12) of the sensors.
        sensors: Their low pass.

    Returns:
        Motion (T, 6), wrench (T, 6), readings (T, 12), and the readings that were corrected for (T, 12).
    """
    motion, wrench = np.empty_like(free), np.empty_like(free)
    readings, used = np.empty_like(noise), np.zeros_like(noise)
    share = contact.step / (contact.step + sensors.filter_time)
    hole, filtered = Hole(), np.zeros(noise.shape[1])
    for k, undisturbed in enumerate(free):
        used[k] = filtered
        moved = undisturbed + loop.per_reading @ filtered
        wrench[k] = wrench_on_drill(contact, hole, moved)
        motion[k] = moved + contact.arms @ wrench[k]
        readings[k] = facing.reading @ wrench[k] + noise[k]
        filtered = filtered + share * (readings[k] - filtered)
    return motion, wrench, readings, used


def _first(time: Floats, reached: np.ndarray) -> float:
    """First time at which something holds, s; nan if never."""
    return float(time[np.argmax(reached)]) if reached.any() else float("nan")
