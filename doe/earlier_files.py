"""What was measured before, from files: readings, a first fit, and the names of poses that could not be measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doe.earlier import Earlier
from identify.arrays import Floats
from identify.errors import InputError
from identify.experiment import Experiment
from identify.model import model_of
from identify.problems import nearest
from identify.study import Study
from identify.summary import load_fitted
from identify.tables import load_measurements, load_plan, plan_experiment

__all__ = ["NO_FILES", "EarlierFiles", "load_earlier"]


@dataclass(frozen=True)
class EarlierFiles:
    """What the command line names.

    Attributes:
        measured: Measured positions (CSV).
        result: identify.json or diagnose.json of a first fit.
        earlier: The plan that was being measured (CSV).
        unreachable: Names of poses that could not be measured.
    """

    measured: Path | None = None
    result: Path | None = None
    earlier: Path | None = None
    unreachable: tuple[str, ...] = ()

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files."""
        return tuple(path for path in (self.measured, self.result, self.earlier) if path is not None)


NO_FILES = EarlierFiles()


def load_earlier(study: Study, files: EarlierFiles) -> tuple[Study, Earlier, tuple[str, ...]]:
    """Read what was there before.

    Args:
        study: The study.
        files: The files.

    Returns:
        The study with the values of the first fit as starting values, what was measured, and notes.

    Raises:
        InputError: A file is wrong, or a pose that could not be measured stands in none of them.
    """
    notes: tuple[str, ...] = ()
    if files.result is not None:
        study, notes = _refitted(study, files.result)
    measured = None if files.measured is None else _measured(study, files.measured)
    planned = None if files.earlier is None else plan_experiment(load_plan(files.earlier, study), study)
    known = [experiment for experiment in (planned, measured) if experiment is not None]
    refused = [_pose(study, name, known) for name in files.unreachable]
    names = tuple(dict.fromkeys(name for experiment in known for name in experiment.visits))
    return study, Earlier(measured, np.reshape(refused, (len(refused), study.robot.n)), names), notes


def _measured(study: Study, path: Path) -> Experiment:
    """The conditions of what was read.

    Raises:
        InputError: Orientations of 6-D targets are missing, whose information the study counts on.
    """
    data = load_measurements(path, study)
    if study.six_d and data.quaternions is None:
        raise InputError(
            f"{path}: columns qw, qx, qy, qz are missing, but [noise] orientation_urad of {study.path} says that "
            "orientations are read; take the key out to plan with positions alone"
        )
    return data.experiment


def _refitted(study: Study, path: Path) -> tuple[Study, tuple[str, ...]]:
    """The study with the values, and under ``auto`` the reference, of a first fit."""
    fitted = load_fitted(path, study)
    names = set(model_of(study).names)
    values = {
        parameter.name: float(value)
        for parameter, value in zip(fitted.model.parameters, fitted.values, strict=True)
        if not parameter.nuisance
    }
    left = sorted(set(values) - names)
    reference = study.reference
    if reference == "auto" and fitted.reference is not None:
        reference = fitted.reference
    nominal = {**study.nominal, **{name: value for name, value in values.items() if name in names}}
    notes = (f"{path.name} holds what the study's model does not: {', '.join(left)}",) if left else ()
    return replace(study, nominal=nominal, reference=reference), notes


def _pose(study: Study, name: str, known: list[Experiment]) -> Floats:
    """(n,) joint values of a pose by its name.

    Raises:
        InputError: No file has this pose.
    """
    for experiment in known:
        if name in experiment.visits:
            shot = int(np.flatnonzero(experiment.shot_visit == experiment.visits.index(name))[0])
            joints: Floats = experiment.q[experiment.shot_pose[shot]]
            return joints
    listed = list(dict.fromkeys(visit for experiment in known for visit in experiment.visits))
    if not listed:
        raise InputError(
            f"--unreachable {name}: nothing says where this pose is; name the plan it stands in with --earlier PLAN.csv"
        )
    raise InputError(
        f"--unreachable {name}: no such pose in --earlier or --measured{nearest(name, listed)}; they hold "
        f"{', '.join(listed[:20])}{' ...' if len(listed) > 20 else ''}"
    )
