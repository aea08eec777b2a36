"""Structure without a name: does the residual depend smoothly on anything that was recorded?

For every joint j and every recorded quantity x the residual is compared with an error of the joint's angle that is a
smooth function of x alone, ``D_j f(x)``, and with an error that grows with the torque of the load,
``D_j t_j f(x)``. With f = sin, cos of the first multiples of a joint angle, or the first powers of time and
temperature, such blocks stand for causes that no library holds; so do waves in time of the place of the instrument.
What they show is not named: it tells that, and on what, something still depends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.experiment import Experiment
from identify.fit import Fit

__all__ = ["Pattern", "patterns"]

_TURNS = 3  # multiples of a joint angle
_POWERS = 2  # of time and temperature
_VISITS_A_WAVE, _WAVES = 3, 20


@dataclass(frozen=True, eq=False)
class Pattern:
    """An unnamed block.

    Attributes:
        depends_on: Column of the table that it is a function of.
        columns: (R, 3, b) m per unit (mrad, or mrad per torque of usual size).
        plausible: (b,) infinite.
    """

    depends_on: str
    columns: Floats
    plausible: Floats


def patterns(found: Fit) -> tuple[Pattern, ...]:
    """Unnamed blocks on the rows of a fit."""
    scene, experiment = found.response.scene, found.data.experiment
    motion = scene.joints.motion
    unloaded = scene.joints.torque[experiment.row_shot]
    torque = unloaded / np.maximum(np.abs(unloaded).max(axis=0), 1e-12)
    made = []
    for name, shape in _functions(experiment, found.model.robot.prismatic):
        for joint in range(motion.shape[1]):
            turned = motion[:, joint, :, None] * shape[:, None, :]
            for columns in (turned, turned * torque[:, joint, None, None]):
                made.append(Pattern(name, 1e-3 * columns, np.full(shape.shape[1], np.inf)))
    return (*made, *_wandering(experiment))


def _wandering(experiment: Experiment) -> Iterator[Pattern]:
    """Waves in time of the place of the instrument, from one over all visits to one over three."""
    if experiment.time is None or np.ptp(experiment.time) == 0:
        return
    phase = 2 * np.pi * (experiment.time - experiment.time.min()) / np.ptp(experiment.time)
    waves = min(len(np.unique(experiment.row_visit)) // _VISITS_A_WAVE, _WAVES)
    for wave in range(1, waves + 1):
        shape = np.stack([np.sin(wave * phase), np.cos(wave * phase)], axis=1)
        columns = (np.eye(3)[None, :, :, None] * shape[:, None, None, :]).reshape(len(phase), 3, 6)
        yield Pattern("time_s", 1e-3 * columns, np.full(6, np.inf))


def _functions(experiment: Experiment, slides: np.ndarray) -> Iterator[tuple[str, Floats]]:
    """Recorded quantities with their smooth functions (R, f); a sliding joint's stroke counts as half a turn."""
    q = experiment.q[experiment.shot_pose[experiment.row_shot]]
    for joint, sliding in enumerate(slides):
        turn = q[:, joint] if not sliding else np.pi * q[:, joint] / max(float(np.ptp(q[:, joint])), 1e-9)
        angle = turn[:, None] * np.arange(1, _TURNS + 1)
        yield f"q{joint + 1}_{'mm' if sliding else 'deg'}", np.hstack([np.sin(angle), np.cos(angle)])
    for name, values in (("time_s", experiment.time), ("temperature_C", experiment.temperature)):
        if values is not None and np.ptp(values) > 0:
            unit = 2 * (values - values.min()) / np.ptp(values) - 1
            yield name, unit[:, None] ** np.arange(1, _POWERS + 1)
