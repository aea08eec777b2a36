"""Draw the picture of the README from the demo: `python docs/make_demo_picture.py` writes `docs/demo.svg`."""

from __future__ import annotations

import io
import re
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parent))

from make_readme import ROOT, demo_commands, run_demo

from doe import view
from identify import Identification, identify, load_measurements, load_study
from identify.selection import load_changes
from identify.study import Study
from identify.truth import load_truth
from identify.units import MM

__all__ = ["picture", "svg"]


def picture(folder: Path) -> Figure:
    """The three panels: the plan, the error before and after, the intervals against the truth.

    Args:
        folder: Where the demo ran.
    """
    words = " ".join(demo_commands()).split()
    readings = next(folder / word for word in words if word.endswith("/measurements.csv"))
    study = load_study(folder / next(word for word in words if "/studies/" in word))
    truth = load_truth(folder / next(word for word in words if "/truths/" in word), study)
    result = identify(study, load_measurements(readings, study))
    figure = view.canvas(3, width=4.3, height=3.7)
    plan, errors, intervals = figure.axes
    _draw_plan(study, result, plan)
    _draw_errors(result, errors)
    names = list(result.parameters)
    index = [result.model.names.index(name) for name in names]
    view.intervals(
        [f"joint {name.rpartition('.j')[2]}" for name in names],
        np.array([result.parameters[name] for name in names]),
        result.quantile * np.sqrt(np.diag(result.covariance))[index],
        np.array([truth.values[name] for name in names]),
        unit="µrad/Nm",
        axes=intervals,
    )
    titles = (
        "1  Plan: where to measure",
        "2  Identify: error before and after",
        "3  Know how sure it is: 95 % intervals",
    )
    for axes, title in zip(figure.axes, titles, strict=True):
        axes.set_title(title, loc="left", fontsize=10.5, fontweight="bold", color=view.TRUTH, pad=10)
    return figure


def _draw_plan(study: Study, result: Identification, axes: Axes) -> None:
    load = next(load for load in study.loads if not load.unloaded)
    view.stick_figures(
        study.robot,
        result.data.experiment.q,
        attach=load.attach,
        markers=study.markers.positions[~study.markers.on_base],
        aspect=1.25,
        axes=axes,
    )


def _draw_errors(result: Identification, axes: Axes) -> None:
    """Change of the reflectors under load that a rigid robot leaves, and that the fit leaves."""
    before, _ = load_changes(result.data.experiment, result.fit.response.position + result.residuals)
    errors = {"rigid robot": before, "identified springs": result.misfit.error}
    lengths = {name: np.linalg.norm(error, axis=1) / MM for name, error in errors.items()}
    view.error_histogram(lengths, what="unexplained shift of a reflector under load", axes=axes)


def svg(figure: Figure) -> str:
    """The figure as SVG; the same figure gives the same bytes."""
    text = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "elastocal", "path.simplify": True}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r" +$", "", text.getvalue(), flags=re.MULTILINE)


def main() -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        run_demo(Path(folder))
        figure = picture(Path(folder))
    path = ROOT / "docs" / "demo.svg"
    path.write_text(svg(figure), encoding="utf-8", newline="\n")
    print(f"docs/{path.name}: {path.stat().st_size / 1000:.0f} kB")
    if len(sys.argv) > 1:
        figure.savefig(sys.argv[1], dpi=130)


if __name__ == "__main__":
    main()
