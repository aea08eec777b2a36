"""The comparison of models as plain data and as a table for people."""

from __future__ import annotations

from typing import Any

import numpy as np

from identify.compare import Comparison, CrossFit
from identify.identification import Misfit
from identify.units import MM

__all__ = ["comparison_json", "comparison_lines"]

_BINS = 20
_ROOM = 1.02  # the histogram reaches a little beyond the largest residual


def comparison_json(lines: tuple[Comparison, ...]) -> list[dict[str, Any]]:
    """The key ``comparison`` of ``identify.json``; lengths in mm, histograms of all models on their own bins."""
    return [
        {
            "name": line.choice.name,
            "effects": list(line.choice.effects),
            "parameters": line.parameters,
            **_errors(line.misfit),
            "compensated_percent": line.compensated,
            "heldout": None if line.crossfit is None else _heldout(line.crossfit),
            "histogram": _histogram(line.misfit),
            "normality": None if line.normality is None else vars(line.normality),
        }
        for line in lines
    ]


def _heldout(crossfit: CrossFit) -> dict[str, Any]:
    return {
        **_errors(crossfit.misfit),
        "compensated_percent": crossfit.compensated,
        "folds": crossfit.folds,
        "parameters_least": crossfit.parameters,
    }


def _errors(misfit: Misfit) -> dict[str, dict[str, float]]:
    """Largest and root mean square error of each coordinate and of the position, mm."""
    axes = {
        axis: {"max_mm": float(np.abs(values).max()) / MM, "rms_mm": float(np.sqrt((values**2).mean())) / MM}
        for axis, values in zip("xyz", misfit.error.T, strict=True)
    }
    return {**axes, "position": {"max_mm": misfit.maximum / MM, "rms_mm": misfit.rms / MM}}


def _histogram(misfit: Misfit) -> dict[str, Any]:
    """Counts of the errors of each coordinate, in equal bins about zero."""
    half = max(_ROOM * float(np.abs(misfit.error).max()), 1e-9)
    edges = np.linspace(-half, half, _BINS + 1)
    counts = {axis: np.histogram(values, edges)[0].tolist() for axis, values in zip("xyz", misfit.error.T, strict=True)}
    return {"edges_mm": edges / MM, "counts": counts}


def comparison_lines(content: list[dict[str, Any]]) -> list[str]:
    """The table, MAX / RMS in mm."""
    width = max(6, *(len(row["name"]) for row in content))
    heading = "".join(f"{name:>15}" for name in ("x", "y", "z", "position", "held-out"))
    lines = ["comparison of models, max / rms in mm"]
    lines.append(f"{'model':<{width}}{'n':>4}{heading}{'compensated':>13}{'held-out':>10}{'normal p':>10}")
    for row in content:
        cells = [row[key] for key in ("x", "y", "z", "position")]
        cells.append(None if row["heldout"] is None else row["heldout"]["position"])
        held = None if row["heldout"] is None else row["heldout"]["compensated_percent"]
        normal = "-" if row["normality"] is None else f"{row['normality']['p_value']:.2g}"
        text = "".join(f"{_pair(cell):>15}" for cell in cells)
        share = f"{_percent(row['compensated_percent']):>13}{_percent(held):>10}"
        lines.append(f"{row['name']:<{width}}{row['parameters']:>4}{text}{share}{normal:>10}")
    return [*lines, *_notes(content)]


def _notes(content: list[dict[str, Any]]) -> list[str]:
    """What held-out poses cannot say."""
    notes = []
    for row in content:
        least = row["parameters"] if row["heldout"] is None else row["heldout"]["parameters_least"]
        if least < row["parameters"]:
            notes.append(
                f"note: {row['name']}: without a fold of the poses only {least} of {row['parameters']} parameters can "
                "be told, the others are nominal there; held-out errors are too large for that reason"
            )
    return notes


def _pair(cell: dict[str, float] | None) -> str:
    return "-" if cell is None else f"{cell['max_mm']:.3f} / {cell['rms_mm']:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} %"
