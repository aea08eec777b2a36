"""What compensation changed at the targets of a program."""

from __future__ import annotations

import numpy as np

from doe.report.folder import Folder, Targets
from doe.report.page import Markup, element, joined, table
from doe.report.words import length, millimetres

__all__ = ["compensation_section"]

_SHOWN = 60  # targets
_FORMS = {"joint": "joint targets", "mirror": "mirrored poses"}
_NOTHING = 1e-6  # mm: a residual below this is rounding


def compensation_section(folder: Folder) -> Markup:
    """Predicted errors before and after, target by target."""
    result = folder.results["compensate"]
    before, after, radius = (result.table(key) for key in ("deflection", "residual", "residual_ci95"))
    outside, form = result.texts("extrapolated"), str(result["form"])
    rows = [
        (words, millimetres(found["rms_mm"]), millimetres(found["max_mm"]))
        for words, found in (
            ("predicted error before", before),
            ("predicted error after, by the model", after),
            ("what the parameters leave open, 95 % radius", radius),
        )
    ]
    told = f"{result['targets']} targets became {_FORMS.get(form, form)}, in {result['passes']} passes at most."
    skipped = (
        f"Outside the calibrated poses and loads, extrapolated: {', '.join(outside[:_SHOWN])}" if outside else None
    )
    return joined(
        element("p", told),
        table(("", "rms", "largest"), rows),
        element("p", f"{skipped}{' ...' if len(outside) > _SHOWN else '.'}", class_="warn") if skipped else None,
        None if folder.compensated is None else _targets(folder.compensated),
        element("ul", *(element("li", note) for note in result.texts("notes")), class_="quiet"),
    )


def _targets(found: Targets) -> Markup:
    """The targets in their order; of many, those of which most remains."""
    count = len(found.name)
    worst = np.argsort(-(found.residual + found.radius95), kind="stable")[:_SHOWN]
    rows = [
        (
            found.name[row],
            length(float(found.deflection[row])),
            "0" if found.residual[row] < _NOTHING else length(float(found.residual[row])),
            length(float(found.radius95[row])),
            element("span", "extrapolated", class_="warn") if found.extrapolated[row] else "",
        )
        for row in np.sort(worst)
    ]
    more = f"The {_SHOWN} of {count} targets of which most remains:" if count > _SHOWN else None
    header = ("target", "before, mm", "after, mm", "95 % radius, mm", "")
    return joined(element("p", more, class_="quiet") if more else None, table(header, rows, words=(0, 4)))
