"""The pictures of a report: residual against everything recorded, maps, held-out errors, curves."""

from __future__ import annotations

import numpy as np

from doe.report.drawing import AFTER, BEFORE, GREY, INK, Panel, picture, ticks, words
from doe.report.folder import Entry, Residuals
from doe.report.page import Markup, joined
from doe.report.words import heading, length, number, rival_words
from identify.arrays import Floats, Ints

__all__ = ["accuracy_curve", "against", "curve", "heldout", "maps", "scale_of"]

_KINDS = {
    "bound_mm": ("proven impossible", GREY),
    "plan_mm": ("designed", AFTER),
    "random_mm": ("random", BEFORE),
    "own_mm": ("these poses, first ones first", INK),
}
_DOTS = 500  # of one panel
_STROKES = 260
_BINS = 12
_AXES = "xyz"


def scale_of(residuals: Residuals) -> float:
    """Half the height of the panels of `against`, mm: nearly all residuals are smaller."""
    mean = residuals.by_shot(residuals.before)
    return float(max(np.quantile(np.abs(mean), 0.995, method="lower"), 1e-6)) * 1.1


def accuracy_curve(points: list[Entry]) -> Markup:
    """Expected rms at the test poses against the number of experiments; below the grey area's edge nothing is possible.

    Args:
        points: The key ``curve`` of plan.json or evaluate.json, two points or more.
    """
    counts = np.array([point.number("poses") for point in points])
    series = {key: np.array([point.number(key) for point in points if key in dict(point.items())]) for key in _KINDS}
    series = {key: values for key, values in series.items() if len(values) == len(points) and np.isfinite(values).any()}
    every = np.concatenate(list(series.values()))
    top = min(float(np.nanmax(every)), 3.0 * float(np.nanmedian(every)))  # few experiments can be off by any factor
    panel = Panel(52, 8, 400, 180, (0.0, 1.04 * counts[-1]), (0.0, 1.08 * top))
    parts = [panel.frame(across="rms at the test poses, mm, against the number of experiments")]
    for index, (key, values) in enumerate(series.items()):
        word, colour = _KINDS[key]
        told = values <= top  # false for nan too
        if key == "bound_mm" and told.any():
            parts.append(panel.band(counts[told], 0 * values[told], values[told], colour))
        elif told.any():
            parts.append(panel.line(counts[told], values[told], colour))
            parts.append(panel.dots(counts[told], values[told], colour, size=4.0, opacity=1.0))
        parts.append(words(446, 24 + 14 * index, word, anchor="end", colour=colour))
    return picture(460, 222, *parts, title="accuracy against the number of experiments")


def against(residuals: Residuals, column: str, scale: float) -> Markup:
    """Residual (x, y, z, mean over the markers of a reading) against one quantity, before and after.

    Args:
        residuals: The table.
        column: Name of the quantity.
        scale: Half the height of each strip, mm.
    """
    values = residuals.by_shot(residuals.quantities[column])
    before, after = residuals.by_shot(residuals.before), residuals.by_shot(residuals.after)
    low, high = float(values.min()), float(values.max())
    margin = 0.04 * (high - low)
    shown = _thinned(values, _DOTS)
    bins = _bins(values)
    parts = []
    for axis in range(3):
        panel = Panel(42, 6 + 70 * axis, 250, 65, (low - margin, high + margin), (-scale, scale))
        across = heading(column) if axis == 2 else None
        parts.append(panel.frame(across=across, along=_AXES[axis], zero=True, at=_few(values)))
        parts.append(panel.dots(values[shown], before[shown, axis], BEFORE, size=2.4))
        for error, colour in ((before, BEFORE), (after, AFTER)):
            middle, mean = _binned(values, error[:, axis], bins)
            parts.append(panel.line(middle, mean, colour, width=1.8))
    return picture(300, 248, *parts, title=f"residual against {heading(column)}")


def _few(values: Floats) -> list[float] | None:
    """The values themselves as ticks where there are three or fewer."""
    distinct = np.unique(values)
    return distinct.tolist() if len(distinct) <= 3 else None


def _thinned(values: Floats, count: int) -> Ints:
    """At most ``count`` indices, evenly spread over the values."""
    order = np.argsort(values, kind="stable")
    kept: Ints = order[np.unique(np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(np.int64))]
    return kept


def _bins(values: Floats) -> Ints:
    """(S,) bin of each value: one for each of few values, else of about equal numbers."""
    distinct, index = np.unique(values, return_inverse=True)
    if len(distinct) <= _BINS:
        return np.asarray(index)
    edges = np.quantile(values, np.linspace(0, 1, _BINS + 1))[1:-1]
    return np.searchsorted(np.unique(edges), values, side="right")


def _binned(values: Floats, error: Floats, bins: Ints) -> tuple[Floats, Floats]:
    """Mean value and mean error of each bin that is not empty."""
    count = np.bincount(bins)
    filled = np.flatnonzero(count)
    middle, mean = (np.bincount(bins, part)[filled] / count[filled] for part in (values, error))
    return middle, mean


def maps(residuals: Residuals) -> Markup:
    """Residual vectors over the workspace: seen from the side and from above, before and after, on one scale."""
    position, load = residuals.by_shot(residuals.position) / 1e3, residuals.by_shot(residuals.before)
    after = residuals.by_shot(residuals.after)
    kept = np.unique(np.linspace(0, len(position) - 1, min(_STROKES, len(position))).round().astype(np.int64))
    longest = float(max(np.quantile(np.linalg.norm(load[kept], axis=1), 0.9), 1e-9))
    parts = []
    for row, (first, second) in enumerate(((0, 2), (0, 1))):
        for number_, (errors, colour, when) in enumerate(((load, BEFORE, "before"), (after, AFTER, "after"))):
            panel = _map_panel(position[:, [first, second]], 42 + 490 * number_, 16 + 372 * row)
            step = 34.0 / longest * errors[kept]
            parts.append(panel.frame(across=f"{_AXES[first]} (m)"))
            title = f"{when}, {'from the side' if second == 2 else 'from above'}: {_AXES[second]} (m)"
            parts.append(words(panel.left, panel.top - 5, title, anchor="start", colour=INK))
            parts.append(_base(panel))
            x, y = position[kept][:, [first, second]].T
            parts.append(panel.strokes(x, y, step[:, first], -step[:, second], colour))
    bar = max(ticks(0.0, 1.6 * longest, 3)[1:] or [longest])
    parts += [
        Markup(f'<path d="M860 744h{34.0 * bar / longest:.1f}" stroke="{INK}" stroke-width="2"/>'),
        words(852, 747, f"{number(bar)} mm", anchor="end", colour=INK),
    ]
    return picture(980, 756, *parts, title="residual vectors over the workspace")


def _map_panel(points: Floats, left: float, top: float) -> Panel:
    """A panel with equal scales that holds points (S, 2) and the base, m."""
    both = np.vstack([points, np.zeros((1, 2))])
    low, high = both.min(axis=0), both.max(axis=0)
    width, height = 440.0, 318.0
    unit = 1.1 * max((high[0] - low[0]) / width, (high[1] - low[1]) / height, 1e-6)  # m a px
    middle, half = (low + high) / 2, np.array([width, height]) * unit / 2
    x, y = (tuple((middle[axis] - half[axis], middle[axis] + half[axis])) for axis in range(2))
    return Panel(left, top, width, height, (float(x[0]), float(x[1])), (float(y[0]), float(y[1])))


def _base(panel: Panel) -> Markup:
    """A cross at the base of the robot."""
    x, y = float(panel.px(0.0)), float(panel.py(0.0))
    cross = Markup(f'<path d="M{x - 5:g} {y:g}h10M{x:g} {y - 5:g}v10" stroke="{INK}" stroke-width="1.4"/>')
    return joined(cross, words(x + 7, y - 4, "base", anchor="start"))


def heldout(gain: Entry) -> Markup:
    """Errors on held-out poses before and after as bars, with the interval, and what the noise alone would leave."""
    before, after = gain.number("heldout_rms_before_mm"), gain.number("heldout_rms_after_mm")
    noise, low_high = gain.number("noise_rms_mm"), before * gain.numbers("ci95")
    panel = Panel(170, 8, 560, 96, (0.0, 1.12 * max(before, after, noise, low_high.max())), (0.0, 1.0))
    floor = float(panel.px(noise))
    parts = []
    for row, (label, value, colour) in enumerate((("before", before, BEFORE), ("after", after, AFTER))):
        top, end = 18 + 42 * row, float(panel.px(value))
        parts.append(Markup(f'<rect x="170" y="{top}" width="{end - 170:.1f}" height="26" fill="{colour}"/>'))
        parts.append(words(162, top + 17, label, anchor="end", colour=INK, size=12))
        last = max(end, float(panel.px(low_high[1])) if row else end)
        parts.append(words(last + 6, top + 17, f"{length(value)} mm", anchor="start", colour=INK, size=12))
    a, b = panel.px(low_high)
    parts.append(Markup(f'<path d="M{a:g} 73H{b:g}M{a:g} 68v10M{b:g} 68v10" stroke="{INK}" stroke-width="1.4"/>'))
    parts.append(Markup(f'<path d="M{floor:g} 8V104" stroke="{INK}" stroke-width="1.2" stroke-dasharray="4 3"/>'))
    parts.append(words(floor, 118, f"noise alone: {length(noise)} mm", colour=GREY, size=11))
    return picture(860, 124, *parts, title="error on held-out poses")


def curve(found: Entry) -> Markup:
    """A cause that depends on one joint's value alone, with its 95 % band."""
    slides = found.get("q_mm") is not None
    unit = "mm" if slides else "mrad"
    q, turn = found.numbers("q_mm" if slides else "q_deg"), found.numbers(f"turn_{unit}")
    half = found.numbers(f"half_{unit}")
    low, high = min(float((turn - half).min()), 0.0), max(float((turn + half).max()), 0.0)
    room = 0.08 * (high - low or 1.0)
    panel = Panel(52, 10, 560, 210, (float(q.min()), float(q.max())), (low - room, high + room))
    joint = str(found["joint"]).removeprefix("j")
    label = f"joint {joint} ({'mm' if slides else 'deg'})"
    return picture(
        630,
        252,
        panel.band(q, turn - half, turn + half, AFTER),
        panel.frame(across=label, along=f"{'shift' if slides else 'turn'} of joint {joint} ({unit})", zero=True),
        panel.line(q, turn, AFTER, width=2.0),
        title=rival_words(str(found["cause"])),
    )
