"""From poses and loads to whitened observation blocks, and from test poses to target rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from identify.arrays import Floats, Ints
from identify.effects import build_scene
from identify.errors import InputError, NotIdentifiable
from identify.experiment import Experiment, full_experiment
from identify.identifiability import Identifiability, independent_columns, triangle, why_not
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import Model, model_of, without_nuisance
from identify.noise import whitening
from identify.response import effect_columns, respond, through_columns
from identify.six_d import with_turns
from identify.study import Study

__all__ = ["Observer", "identifiable", "keep_columns", "observer", "stacked_visits", "target_rows"]

_CHUNK = 4096  # poses at a time: the fields of one chunk stay in cache


@dataclass(frozen=True, eq=False)
class Observer:
    """Everything that turns poses into blocks.

    Attributes:
        study: The study.
        model: Its model; without frame and markers under ``differences``, where free offsets take their place.
        reference: What the readings will be compared with.
    """

    study: Study
    model: Model
    reference: Literal["absolute", "differences"]

    def blocks(self, q: Floats, visit_loads: Ints) -> Floats:
        """Whitened observation blocks of visits.

        Args:
            q: (N, n) joint values, rad or m.
            visit_loads: (N, L) load of each shot of a visit.

        Returns:
            (N, k, p) rows per unit of each parameter of the observer's model.
        """
        total: Floats | None = None
        for start in range(0, len(q), _CHUNK):
            part = self._chunk(q[start : start + _CHUNK], visit_loads[start : start + _CHUNK])
            if total is None:
                total = np.empty((len(q), *part.shape[1:]))
            total[start : start + len(part)] = part
        if total is None:
            raise InputError(f"{self.study.path}: no poses to observe")
        return total

    def _chunk(self, q: Floats, visit_loads: Ints) -> Floats:
        return stacked_visits(self, full_experiment(q, visit_loads, self.study.loads, self.study.markers))


def observer(study: Study) -> Observer:
    """The observer of a study.

    ``reference = "auto"`` becomes ``differences`` where the mass of a moved link is unknown, else
    ``absolute``: the rule that `identify` follows when the model is right.
    """
    model = model_of(study)
    reference = study.reference
    if reference == "auto":
        elastic = any(effect.yields for effect in model.effects)
        compares = elastic and (study.plan.reference_rows or study.plan.loads_per_pose > 1)
        reference = "differences" if compares and not study.robot.masses_known else "absolute"
    return Observer(study, model if reference == "absolute" else without_nuisance(model), reference)


def stacked_visits(observer: Observer, experiment: Experiment) -> Floats:
    """Blocks of visits of any layout, (V, k, p); short ones are filled up with rows of zeros."""
    model = observer.model
    if observer.study.six_d:
        experiment = with_turns(experiment)
    response = respond(model, experiment, model.nominal)
    free_offsets = observer.reference == "differences"
    operators = whitening(response.scene, observer.study.noise, _station(observer.study), free_offsets=free_offsets)
    groups = list(operators.blocks(response.derivative))
    blocks = np.zeros((sum(map(len, groups)), max(group.shape[1] for group in groups), len(model.parameters)))
    start = 0
    for group in groups:
        blocks[start : start + len(group), : group.shape[1]] = group
        start += len(group)
    return blocks


def _station(study: Study) -> Floats:
    """Where the tracker stands, base frame, m."""
    tracker = study.noise.tracker
    if tracker is None:
        return np.zeros(3)
    if tracker.station is None:
        raise InputError(
            f"{study.path}: [noise.tracker] station_mm is missing; range-dependent noise can only be planned with the "
            "position of the instrument in the base frame"
        )
    return tracker.station


def target_rows(observer: Observer, known: Identifiability) -> Floats:
    """Rows of the test poses on the kept parameters: error of the point per unit, weighted.

    Args:
        observer: The observer.
        known: Kept parameters of the candidates.

    Returns:
        (t, 3, rank) m per unit; times sqrt(weight / sum of weights) is the caller's.

    Raises:
        InputError: The study has no test poses.
        NotIdentifiable: A test pose depends on a direction that the candidates cannot show.
    """
    study, model = observer.study, observer.model
    if not study.test_poses:
        raise InputError(f"{study.path}: [[test_poses]] is missing; the accuracy that counts is not defined")
    rows = np.stack([_test_rows(observer, index) for index in range(len(study.test_poses))])
    rows[:, :, model.nuisance | model.of_reading] = 0.0
    scale = np.abs(rows).max(initial=0.0)
    for dropped in known.dropped:
        through = rows[:, :, list(dropped.alike)] @ dropped.coefficients
        by_nuisance = any(model.nuisance[other] for other in dropped.alike)
        if not by_nuisance and np.abs(rows[:, :, dropped.column] - through).max(initial=0.0) > 1e-6 * scale:
            name = model.names[dropped.column]
            raise NotIdentifiable(
                f"{study.path}: the test poses depend on {name}, which no candidate shows: {why_not(model, dropped)}. "
                "Add loads in other directions, or test poses that do not need it",
                (name,),
            )
    return rows[:, :, known.kept]


def _test_rows(observer: Observer, index: int) -> Floats:
    """(3, p) derivative of the deflected point of one test pose."""
    pose = observer.study.test_poses[index]
    load = LoadCase("test", attach=pose.attach, force=pose.wrench[:3], moment=pose.wrench[3:], in_flange=pose.in_flange)
    point = Markers(("point",), pose.point[None], np.array([False]))
    experiment = full_experiment(pose.q[None], np.zeros((1, 1), dtype=np.int64), (load,), point)
    model = observer.model
    scene = build_scene(experiment, forward(model.robot, experiment.q), point.positions, self_weight=model.self_weight)
    columns: Floats = effect_columns(model, scene, model.nominal)[0]
    columns[:, ~model.nuisance] += _self_weight_columns(model, experiment)
    return columns


def _self_weight_columns(model: Model, experiment: Experiment) -> Floats:
    """(3, p) of all but nuisance: what effects on the robot itself (wrong masses) do at a test pose.

    Wrong test loads do nothing here: the wrench at a test pose is what it is, no matter what was hung for measuring.
    """
    effects = tuple(replace(effect, reload=None) for effect in model.effects)
    bare = replace(without_nuisance(model), effects=effects, loaded=False)
    columns = np.zeros((3, len(bare.parameters)))
    for column, part in through_columns(bare, experiment, bare.nominal):
        columns[:, column] = part[0]
    return columns


def identifiable(blocks: Floats) -> Identifiability:
    """Kept parameters of a set of blocks (N, k, p)."""
    return independent_columns(triangle([blocks.reshape(-1, blocks.shape[2])]))


def keep_columns(blocks: Floats, kept: Ints) -> Floats:
    """The kept columns (N, k, rank), moved together in the memory of ``blocks`` (N, k, p), which is used up."""
    count, rows, columns = blocks.shape
    if len(kept) == columns:
        return blocks
    memory = blocks.reshape(-1)
    for start in range(0, count, _CHUNK):
        part = blocks[start : start + _CHUNK][:, :, kept].reshape(-1)
        begin = start * rows * len(kept)
        memory[begin : begin + len(part)] = part  # never reaches what has not been read yet
    return memory[: count * rows * len(kept)].reshape(count, rows, len(kept))
