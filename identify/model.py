"""A model is a robot plus effects; with frame and markers it says where every reading should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.effects import Effect, Parameter, bind_effects
from identify.errors import InputError
from identify.robot import Robot
from identify.study import RowAlgebra, Study
from identify.units import MM, MRAD

__all__ = ["Model", "effects_of", "known_nominal", "model_of", "with_effect", "without_nuisance"]

_MARKER_LIMIT = 5.0  # mm or mrad; markers are better known than this without any fit
_FRAME = (*((axis, "mm", MM) for axis in "xyz"), *((f"r{axis}", "mrad", MRAD) for axis in "xyz"))


@dataclass(frozen=True, eq=False)
class Model:
    """Robot, effects and the nuisance parameters of frame and markers.

    Attributes:
        robot: The nominal robot.
        effects: Effects bound to it.
        parameters: All p parameters: frame, markers, turns of markers, then the effects' in their order.
        frame_size: Number of frame parameters (6 or 0).
        marker_size: Number of marker parameters (3 a marker or 0).
        rows: How the rows of a fit are built (`Study.rows`).
        turn_size: Number of parameters of how 6-D targets sit on the flange (3 a marker of the flange or 0).
        self_weight: The weight of links and tool is counted.
        loaded: Torques are taken on the deflected arm (`identify.loaded_scene`), else on the undeflected one. Effects
            that are no pairs of springs are of first order in both.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    parameters: tuple[Parameter, ...]
    frame_size: int
    marker_size: int
    self_weight: bool
    loaded: bool = False
    turn_size: int = 0
    rows: RowAlgebra = "vectors"

    @property
    def nuisance_size(self) -> int:
        """Number of parameters before those of the effects."""
        return self.frame_size + self.marker_size + self.turn_size

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nominal(self) -> Floats:
        """(p,) starting values in the parameters' units."""
        return frozen([parameter.nominal for parameter in self.parameters])

    @property
    def nuisance(self) -> np.ndarray:
        """(p,) True for frame and markers."""
        return np.array([parameter.nuisance for parameter in self.parameters], dtype=bool)

    @property
    def of_reading(self) -> np.ndarray:
        """(p,) True for parameters of effects that displace what is read and not the arm."""
        marked = np.zeros(len(self.parameters), dtype=bool)
        for effect, where in zip(self.effects, self.effect_slices, strict=True):
            marked[where] = effect.of_reading
        return marked

    @cached_property
    def effect_slices(self) -> tuple[slice, ...]:
        """Where each effect's parameters stand."""
        sizes = [len(effect.parameters) for effect in self.effects]
        ends = self.nuisance_size + np.cumsum(sizes)
        return tuple(slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True))

    @cached_property
    def effect_inputs(self) -> tuple[Ints, ...]:
        """Where the values stand that each effect takes: its own parameters, then those it borrows."""
        names = self.names
        return tuple(
            np.array([*range(where.start, where.stop), *map(names.index, effect.borrowed)], dtype=np.int64)
            for effect, where in zip(self.effects, self.effect_slices, strict=True)
        )


def model_of(study: Study, effects: tuple[str, ...] | None = None, nominal: Mapping[str, float] | None = None) -> Model:
    """The model of a study.

    Args:
        study: The study.
        effects: Another list of effects than the study's.
        nominal: Other starting values than the study's, by parameter name, in result units.

    Raises:
        InputError: Unknown effect, place or parameter name.
    """
    names = study.effects if effects is None else effects
    bound = effects_of(study, names)
    frame = _frame_parameters() if study.frame_free else ()
    markers = _marker_parameters(study) if study.markers_fitted else ()
    turns = _turn_parameters(study) if study.markers_fitted and study.six_d else ()
    parameters = (*frame, *markers, *turns, *(parameter for effect in bound for parameter in effect.parameters))
    given = study.nominal if nominal is None else nominal
    _check_names(given, parameters, str(study.path))
    parameters = tuple(replace(p, nominal=float(given.get(p.name, p.nominal))) for p in parameters)
    loaded = study.equilibrium == "loaded"
    known = study.robot.masses_known
    return Model(study.robot, bound, parameters, len(frame), len(markers), known, loaded, len(turns), study.rows)


def known_nominal(study: Study, effects: tuple[str, ...] | None) -> dict[str, float]:
    """Starting values of the study that a model with these effects (None: the study's) has too."""
    names = model_of(study, effects, {}).names
    return {name: value for name, value in study.nominal.items() if name in names}


def effects_of(study: Study, names: tuple[str, ...], others: tuple[Effect, ...] = ()) -> tuple[Effect, ...]:
    """A list of effects, bound to what the study says.

    Args:
        study: The study.
        names: The list.
        others: Effects that are bound already and that these may lean on.

    Raises:
        InputError: Unknown effect, place or option.
    """
    return bind_effects(
        names,
        study.robot,
        options=study.options,
        flange=not study.markers_fitted,
        loads=study.loads,
        markers=study.markers,
        others=others,
    )


def without_nuisance(model: Model) -> Model:
    """The same effects with frame and markers taken as known."""
    parameters = tuple(parameter for parameter in model.parameters if not parameter.nuisance)
    return replace(model, parameters=parameters, frame_size=0, marker_size=0, turn_size=0)


def with_effect(model: Model, effect: Effect) -> Model:
    """The model with one more effect, which was bound beside the effects of the model."""
    parameters = (*model.parameters, *effect.parameters)
    return replace(model, effects=(*model.effects, effect), parameters=parameters)


def _check_names(given: Mapping[str, float], parameters: tuple[Parameter, ...], path: str) -> None:
    known = [parameter.name for parameter in parameters]
    for name in given:
        if name not in known:
            raise InputError(
                f"{path}: [model.nominal] {name!r}: the model has no such parameter; it has "
                f"{', '.join(known) or 'none'}"
            )


def _frame_parameters() -> tuple[Parameter, ...]:
    """Displacement of the base in its own axes: translation, then rotation."""
    return tuple(Parameter(f"frame.{name}", unit, scale, nuisance=True) for name, unit, scale in _FRAME)


def _marker_parameters(study: Study) -> tuple[Parameter, ...]:
    """Correction of every marker position, in its own frame."""
    return tuple(
        Parameter(f"marker.{name}.{axis}", "mm", MM, nuisance=True, limit=_MARKER_LIMIT)
        for name in study.markers.names
        for axis in "xyz"
    )


def _turn_parameters(study: Study) -> tuple[Parameter, ...]:
    """Correction of how every 6-D target is turned, about the axes of the flange."""
    on_flange = [name for name, fixed in zip(study.markers.names, study.markers.on_base, strict=True) if not fixed]
    return tuple(
        Parameter(f"marker.{name}.r{axis}", "mrad", MRAD, nuisance=True, limit=_MARKER_LIMIT)
        for name in on_flange
        for axis in "xyz"
    )
