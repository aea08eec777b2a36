"""From poses and loads to whitened observation blocks, and from test poses to target rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from doe.executor import HERE, Executor
from doe.storage import gathered
from doe.subject import Subject
from identify.arrays import Floats, Ints
from identify.effects import Parameter, Scene, build_scene
from identify.errors import InputError, NotIdentifiable
from identify.experiment import Experiment, full_experiment
from identify.identifiability import Dropped, Identifiability, independent_columns, triangle, why_not
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import Model, model_of, without_nuisance
from identify.noise import whitening
from identify.response import effect_columns, respond, through_columns
from identify.six_d import with_turns
from identify.study import Noise, PlanSettings, Study, TestPose

__all__ = ["Observer", "error_rows", "identifiable", "keep_columns", "observer", "stacked_visits", "target_rows"]

_CHUNK = 4096  # poses at a time: the fields of one chunk stay in cache
_WEAK = 2e-5  # share of the strongest column of the same unit: six digits of an angle, and no joint of a real arm
# share of the largest error at the test poses that does not count: of what is not seen, of what is seen too weakly
_NEGLIGIBLE = (1e-6, 1e-3)


@dataclass(frozen=True, eq=False)
class Observer:
    """Everything that turns poses into blocks.

    Attributes:
        study: The study.
        model: Its model; without frame and markers under ``differences``, where free offsets take their place.
        reference: What the readings will be compared with.
        own_visits: Each reading of an experiment is a visit of its own, with a pose jitter of its own.
    """

    study: Study
    model: Model
    reference: Literal["absolute", "differences"]
    own_visits: bool = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process builds the model anew: effects hold functions of their own."""
        return _again, (self.study, self.reference, self.own_visits)

    @property
    def path(self) -> Path:
        """The study file."""
        return self.study.path

    @property
    def settings(self) -> PlanSettings:
        """What the plan is asked for."""
        return self.study.plan

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """(p,) parameters of the model."""
        return self.model.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) their names."""
        return self.model.names

    @property
    def nuisance(self) -> np.ndarray:
        """(p,) True for frame and markers."""
        return self.model.nuisance

    @property
    def weights(self) -> Floats:
        """(t,) weights of the test poses."""
        return np.array([pose.weight for pose in self.study.test_poses])

    @property
    def noise(self) -> Noise:
        """Noise of the readings of an experiment: in visits of their own the pose jitter is new in each of them."""
        stated = self.study.noise
        if not self.own_visits:
            return stated
        return replace(stated, pose_jitter=0.0, reading_jitter=math.hypot(stated.pose_jitter, stated.reading_jitter))

    def test_rows(self) -> Floats:
        """(t, 3, p) error of the point of each test pose, base frame, m per unit of each parameter."""
        return np.stack([error_rows(self.model, pose) for pose in self.study.test_poses])

    def why(self, dropped: Dropped) -> str:
        """In words, why a parameter cannot be identified."""
        return why_not(self.model, dropped)

    def blocks(
        self, q: Floats, visit_loads: Ints, executor: Executor = HERE, *, loads: tuple[LoadCase, ...] | None = None
    ) -> Floats:
        """Whitened observation blocks of visits.

        Args:
            q: (N, n) joint values, rad or m.
            visit_loads: (N, L) load of each shot of a visit.
            executor: Who builds them, in pieces.
            loads: The loads that these are indices of; None: those of the study.

        Returns:
            (N, k, p) rows per unit of each parameter of the observer's model; many of them stand in a temporary file.
        """
        if not len(q):
            raise InputError(f"{self.study.path}: no poses to observe")
        hung = self.study.loads if loads is None else loads
        parts = [slice(start, start + _CHUNK) for start in range(0, len(q), _CHUNK)]
        if len(parts) == 1:
            return self._piece(hung, (q, visit_loads))
        pieces = [(q[part], visit_loads[part]) for part in parts]
        return gathered(executor.map(partial(self._piece, hung), pieces), len(q))

    def _piece(self, loads: tuple[LoadCase, ...], visits: tuple[Floats, Ints]) -> Floats:
        """Blocks of some visits: joint values and loads."""
        return stacked_visits(self, full_experiment(*visits, loads, self.study.markers))


def observer(study: Study, *, own_visits: bool = False) -> Observer:
    """The observer of a study.

    ``reference = "auto"`` becomes ``differences`` where the mass of a moved link is unknown, else
    ``absolute``: the rule that `identify` follows when the model is right.

    Args:
        study: The study.
        own_visits: The unloaded state is read in visits of its own.

    Raises:
        InputError: Visits of their own under ``differences``, which compares the readings of one visit.
    """
    model = model_of(study)
    reference = study.reference
    if reference == "auto":
        elastic = any(effect.yields for effect in model.effects)
        compares = elastic and (study.plan.reference_rows or study.plan.loads_per_pose > 1)
        reference = "differences" if compares and not study.robot.masses_known else "absolute"
    if own_visits and reference == "differences":
        why = "is asked for" if study.reference == reference else "is needed: the mass of a moved link is unknown"
        raise InputError(
            f'{study.path}: [plan] references = "own_visits": reference "differences" {why}, which compares readings '
            'of one visit, and visits of their own hold one reading each; write references = "same_visit"'
        )
    return Observer(study, model if reference == "absolute" else without_nuisance(model), reference, own_visits)


def _again(study: Study, reference: Literal["absolute", "differences"], own_visits: bool) -> Observer:
    """The observer of a study whose readings are compared with what is known already."""
    return replace(observer(study, own_visits=own_visits), reference=reference)


def stacked_visits(observer: Observer, experiment: Experiment, more: Callable[[Scene], Floats] | None = None) -> Floats:
    """Blocks of the visits that have rows, of any layout and in their order, (V, k, p).

    Short ones are filled up with rows of zeros.

    Args:
        observer: The observer.
        experiment: The visits.
        more: ``scene -> (R, 3, c)`` further columns behind those of the model, SI; the blocks are then (V, k, p + c).
    """
    model = observer.model
    if observer.study.six_d:
        experiment = with_turns(experiment)
    response = respond(model, experiment, model.nominal)
    free_offsets = observer.reference == "differences"
    operators = whitening(response.scene, observer.noise, _station(observer.study), free_offsets=free_offsets)
    columns = response.derivative
    if more is not None:
        columns = np.concatenate([columns, more(response.scene)], axis=2)
    groups = list(operators.blocks(columns))
    first = np.concatenate([rows[:, 0] for rows, _ in operators.groups])  # rows of one visit stand together
    place = np.argsort(np.argsort(first))
    blocks = np.zeros((len(first), max(group.shape[1] for group in groups), columns.shape[2]))
    start = 0
    for group in groups:
        blocks[place[start : start + len(group)], : group.shape[1]] = group
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


def target_rows(observer: Subject, known: Identifiability) -> Floats:
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
    if not len(observer.weights):
        raise InputError(f"{observer.path}: [[test_poses]] is missing; the accuracy that counts is not defined")
    rows, nuisance = observer.test_rows(), observer.nuisance
    scale = np.abs(rows).max(initial=0.0)
    for dropped in known.dropped:
        through = rows[:, :, list(dropped.alike)] @ dropped.coefficients
        by_nuisance = any(nuisance[other] for other in dropped.alike)
        least = _NEGLIGIBLE[int(np.isfinite(dropped.std))] * scale
        if not by_nuisance and np.abs(rows[:, :, dropped.column] - through).max(initial=0.0) > least:
            name = observer.names[dropped.column]
            raise NotIdentifiable(
                f"{observer.path}: the test poses depend on {name}, which no candidate shows: {observer.why(dropped)}. "
                "Add loads in other directions, or test poses that do not need it",
                (name,),
            )
    return rows[:, :, known.kept]


def error_rows(model: Model, pose: TestPose) -> Floats:
    """Error of the point of one test pose.

    Args:
        model: The model.
        pose: Joint values, wrench and the point that counts.

    Returns:
        (3, p) m per unit of each parameter, base frame; zero for what displaces readings and not the arm.
    """
    load = LoadCase("test", attach=pose.attach, force=pose.wrench[:3], moment=pose.wrench[3:], in_flange=pose.in_flange)
    point = Markers(("point",), pose.point[None], np.array([False]))
    experiment = full_experiment(pose.q[None], np.zeros((1, 1), dtype=np.int64), (load,), point)
    scene = build_scene(experiment, forward(model.robot, experiment.q), point.positions, self_weight=model.self_weight)
    columns: Floats = effect_columns(model, scene, model.nominal)[0]
    columns[:, ~model.nuisance] += _self_weight_columns(model, experiment)
    columns[:, model.nuisance | model.of_reading] = 0.0
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


def identifiable(*blocks: Floats | None, parameters: Sequence[Parameter] = ()) -> Identifiability:
    """Kept parameters of one or several sets of blocks (N, k, p) together.

    A robot file that writes 3.14159 turns an upright joint 1e-6 rad off the vertical: its column is no noise and of no
    use, and a criterion that counts it looks at nothing else. Such columns are dropped.

    Args:
        blocks: One or several (N, k, p); None is none.
        parameters: (p,) whose columns are compared with those of the same unit; none: none is too weak.
    """
    upper = triangle([part.reshape(-1, part.shape[2]) for part in blocks if part is not None])
    norms = np.linalg.norm(upper, axis=0)
    units = np.array([parameter.unit for parameter in parameters])
    weak = [k for k, unit in enumerate(units) if 0.0 < norms[k] < _WEAK * norms[units == unit].max()]
    upper[:, weak] = 0.0
    found = independent_columns(upper)
    stds = {k: 1.0 / norms[k] for k in weak}
    return replace(found, dropped=tuple(replace(d, std=stds.get(d.column, d.std)) for d in found.dropped))


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
