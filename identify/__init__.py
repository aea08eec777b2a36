"""elastocal, the physics and the estimator: robots, effects, readings, and what they tell."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identify.config import load_study
    from identify.diagnosis import Diagnosis, diagnose
    from identify.errors import ElastocalError, Infeasible, InputError, NoConvergence, NotIdentifiable
    from identify.identification import Identification, identify
    from identify.reduction import Reduction, reduce
    from identify.tables import load_measurements

__all__ = [
    "Diagnosis",
    "ElastocalError",
    "Identification",
    "Infeasible",
    "InputError",
    "NoConvergence",
    "NotIdentifiable",
    "Reduction",
    "diagnose",
    "identify",
    "load_measurements",
    "load_study",
    "reduce",
]

_HOME = {
    "Diagnosis": "identify.diagnosis.verdict",
    "Identification": "identify.identification",
    "Reduction": "identify.reduction",
    "diagnose": "identify.diagnosis.verdict",
    "identify": "identify.identification",
    "load_measurements": "identify.tables",
    "load_study": "identify.config",
    "reduce": "identify.reduction",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that importing the package costs nothing."""
    if name in __all__:
        return getattr(import_module(_HOME.get(name, "identify.errors")), name)
    raise AttributeError(f"module 'identify' has no attribute {name!r}")
