"""Pictures of plans and results: every function draws one panel and returns the figure.

Nothing is shown or saved here, and no global state of matplotlib is touched. A function draws into the ``axes`` it
is given; without them it makes a figure of its own. Colours mean the same in every panel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter

from identify.arrays import Floats, Ints
from identify.kinematics import forward
from identify.robot import Robot

__all__ = [
    "accuracy_curve",
    "canvas",
    "distinct",
    "efficiencies",
    "error_by_pose",
    "error_histogram",
    "expected_and_realised",
    "intervals",
    "knee",
    "stick_figures",
]

BEFORE, AFTER, TRUTH, FORCE = "#c2603f", "#17708a", "#2b2b2b", "#d9930d"
GREY, PALE = "#8a8f94", "#d9dcdf"
_SERIES = (BEFORE, AFTER, "#8d5a97", "#7a8f3a", GREY)
ARM = "#43525e"


def canvas(columns: int = 1, *, width: float = 4.6, height: float = 3.4) -> Figure:
    """An empty figure with panels side by side.

    Args:
        columns: Number of panels.
        width: Of one panel, inch.
        height: Of the figure, inch.
    """
    figure = Figure(figsize=(columns * width, height), layout="constrained", facecolor="white")
    figure.subplots(1, columns)
    return figure


def stick_figures(
    robot: Robot,
    q: Floats,
    *,
    attach: Floats | None = None,
    force: Floats | None = None,
    markers: Floats | None = None,
    same: float = 0.05,
    label: str = "pose",
    aspect: float = 1.35,
    axes: Axes | None = None,
) -> Figure:
    """Arms in space, side by side on one scale: joints, load arrow, reflectors, and the shadow on the floor.

    The camera goes around with the arm, so that every load hangs to the right; z of the base points up. Poses that
    nearly agree are drawn once, with their number.

    Args:
        robot: The robot.
        q: (V, n) joint values, rad or m.
        attach: (3,) or (V, 3) where the load acts, flange frame, m; no arrow without it.
        force: (3,) or (V, 3) direction of the load, base frame; along gravity by default.
        markers: (M, 3) reflectors, flange frame, m.
        same: Joint values this close (rad or m, all joints) count as one pose.
        label: What one figure is called.
        aspect: Width by height of the panel, for which the rows are broken.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    kept, counts = distinct(q, same)
    arms, unit = _arms(robot, q, kept, attach, force, markers)
    boxes = np.array([
        [points.min(axis=0), points.max(axis=0)] for points in (np.concatenate(list(a.values())) for a in arms)
    ])
    places, size = _rows(boxes, aspect, unit)
    for index, (arm, place) in enumerate(zip(arms, places, strict=True)):
        _draw_arm(axes, {part: points + place for part, points in arm.items()})
        words = f"{label} {kept[index] + 1}" + (f"  ×{counts[index]}" if counts[index] > 1 else "")
        middle = place[0] + boxes[index, :, 0].mean()
        foot = place[1] + boxes[:, 0, 1].min() - 0.06 * unit
        axes.text(middle, foot, words, fontsize=7.5, color=TRUTH, ha="center", va="top")
    _key(axes, size[0], unit, load=attach is not None, reflectors=markers is not None)
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]), aspect="equal")
    axes.axis("off")
    return _figure(axes)


def distinct(q: Floats, same: float) -> tuple[Ints, Ints]:
    """Poses without repeats: indices of the first of each kind, and how many there are.

    Args:
        q: (V, n) joint values, rad or m.
        same: Poses whose joint values all differ by no more than this are one kind.
    """
    kept: list[int] = []
    counts: list[int] = []
    for index, pose in enumerate(q):
        near = [place for place, first in enumerate(kept) if np.abs(q[first] - pose).max() <= same]
        if near:
            counts[near[0]] += 1
        else:
            kept.append(index)
            counts.append(1)
    return np.array(kept, dtype=np.int64), np.array(counts, dtype=np.int64)


def error_histogram(
    errors: Mapping[str, Floats], *, what: str = "error of a reflector", axes: Axes | None = None
) -> Figure:
    """Errors of several models on one logarithmic axis.

    Args:
        errors: Name of the model -> (K,) lengths of the errors, mm; the first is the one before.
        what: What the errors are of.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    errors = _above_zero(errors)
    everything = np.concatenate(list(errors.values()))
    edges = np.geomspace(0.8 * everything.min(), 1.25 * everything.max(), 31)
    tops = []
    for (_, values), colour in zip(errors.items(), cycle(_SERIES), strict=False):
        count, _, _ = axes.hist(values, bins=edges.tolist(), color=colour, edgecolor="white", linewidth=0.6)
        tops.append(float(np.max(count)))
    for (name, values), colour, top in zip(errors.items(), cycle(_SERIES), tops, strict=False):
        middle = float(np.exp(np.log(values).mean()))
        words = f"{name}\nrms {_round(_rms(values))} mm\nmax {_round(float(np.max(values)))} mm"
        axes.text(middle, top + 0.03 * max(tops), words, color=colour, ha="center", va="bottom", fontsize=8)
    axes.set_ylim(0, 1.32 * max(tops))
    axes.set_xscale("log")
    _plain_log(axes.xaxis, everything)
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.set_xlabel(f"{what} (mm)")
    axes.set_ylabel("number of readings")
    _tidy(axes)
    return _figure(axes)


def error_by_pose(
    errors: Mapping[str, Floats],
    visit: Ints,
    names: Sequence[str] = (),
    *,
    what: str = "error of a reflector",
    axes: Axes | None = None,
) -> Figure:
    """Largest error of each pose, poses sorted by the first model, the maximum of each model marked.

    Args:
        errors: Name of the model -> (K,) lengths of the errors, mm; the first is the one before.
        visit: (K,) pose of each error.
        names: Names of the poses; their numbers by default.
        what: What the errors are of.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    errors = _above_zero(errors)
    poses = np.unique(visit)
    largest = {name: np.array([values[visit == pose].max() for pose in poses]) for name, values in errors.items()}
    order = np.argsort(-next(iter(largest.values())), kind="stable")
    place = np.arange(len(poses))
    axes.vlines(place, *_ends(largest, order), color=PALE, lw=1.2)
    for (name, values), colour in zip(largest.items(), cycle(_SERIES), strict=False):
        ranked = values[order]
        axes.plot(place, ranked, "o", color=colour, ms=4, label=name)
        top = int(np.argmax(ranked))
        axes.annotate(
            f"max {_round(float(ranked[top]))} mm", (top, ranked[top]), (0, 6), textcoords="offset points",
            ha="left" if top < len(poses) / 2 else "right", color=colour, fontsize=8,
        )  # fmt: skip
    axes.set_yscale("log")
    everything = np.concatenate(list(largest.values()))
    axes.set_ylim(_floor(largest), 2.0 * everything.max())
    _plain_log(axes.yaxis, everything)
    labels = [names[pose] if len(names) else str(pose + 1) for pose in poses[order]]
    axes.set_xticks(place, labels, rotation=90, fontsize=7)
    axes.set_xlabel("pose, sorted by the error before")
    axes.set_ylabel(f"largest {what} (mm)")
    axes.legend(frameon=True, framealpha=1.0, edgecolor="none", fontsize=8, loc="center right")
    _tidy(axes)
    return _figure(axes)


def intervals(
    names: Sequence[str],
    values: Floats,
    half: Floats,
    truth: Floats,
    *,
    unit: str,
    axes: Axes | None = None,
) -> Figure:
    """Parameters with their 95 % intervals against the truth, in per cent of it.

    Args:
        names: (p) parameters, top to bottom.
        values: (p,) identified, in ``unit``.
        half: (p,) half widths of the intervals.
        truth: (p,) true values, none of them zero.
        unit: Unit of the values.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    place = np.arange(len(names))
    centre, reach = 100.0 * (values / truth - 1.0), 100.0 * half / np.abs(truth)
    axes.axvline(0.0, color=TRUTH, lw=1.0)
    axes.errorbar(centre, place, xerr=reach, fmt="o", color=AFTER, ms=4.5, lw=2.0, capsize=3.0)
    widest = 1.12 * float((np.abs(centre) + reach).max()) or 1.0
    axes.set_xlim(-widest, widest)
    axes.set_ylim(len(names) - 0.35, -0.85)
    axes.set_yticks(place, names)
    axes.tick_params(axis="y", length=0)
    for row, (value, width, true) in enumerate(zip(values, half, truth, strict=True)):
        digits = max(0, 1 - int(np.floor(np.log10(max(width, 1e-4 * abs(true))))))
        words = f"{value:.{digits}f} ± {width:.{digits}f}   (true {true:g})"
        axes.text(0.0, row - 0.26, words, fontsize=7.5, color=AFTER, ha="center", va="bottom", bbox=_PAPER)
    axes.set_xlabel("identified − true (% of the true value)")
    axes.text(0.0, -0.78, f"values in {unit}", fontsize=7.5, color=GREY, ha="center", va="center", bbox=_PAPER)
    _tidy(axes)
    axes.spines["left"].set_visible(False)
    return _figure(axes)


def knee(
    counts: Ints,
    designed: Floats,
    bound: Floats,
    random: Floats,
    *,
    repeatability: float | None = None,
    mark: int | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Expected error against the number of poses: designed plans, what is impossible, random plans.

    Args:
        counts: (K,) numbers of poses, ascending.
        designed: (K,) expected error of the designed plans, um.
        bound: (K,) no plan of as many poses has a smaller one, um.
        random: (K, R) of random plans, um.
        repeatability: Error that the robot adds by itself, um; drawn as a line.
        mark: A number of poses to point out; one of ``counts``.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    low, middle, high = np.quantile(random, [0.05, 0.5, 0.95], axis=1)
    least = 0.8 * float(bound.min())
    axes.fill_between(counts, low, high, color=BEFORE, alpha=0.18, lw=0)
    axes.plot(counts, middle, color=BEFORE, lw=1.6)
    axes.fill_between(counts, least, bound, color=PALE, lw=0)
    axes.plot(counts, designed, "o-", color=AFTER, ms=3.6, lw=1.6)
    axes.set_yscale("log")
    axes.set_ylim(least, 1.6 * float(middle.max()))
    if repeatability is not None:
        axes.axhline(repeatability, color=TRUTH, lw=1.0, ls=(0, (4, 2)))
        words = f"the robot's own repeatability, {repeatability:.0f} µm"
        axes.text(counts[-1], 1.06 * repeatability, words, color=TRUTH, fontsize=8, ha="right", va="bottom")
    if mark is not None:
        at = int(np.flatnonzero(counts == mark)[0])
        axes.plot(counts[at], designed[at], "o", color=AFTER, ms=8, mfc="none", mew=1.4)
        as_good = np.flatnonzero(middle <= designed[at])
        words = f"{mark} designed" + (f"\n= {counts[as_good[0]]} random" if len(as_good) else "")
        axes.annotate(
            words, (counts[at], designed[at]), (-30, -26), textcoords="offset points", fontsize=8, color=AFTER,
            ha="center", arrowprops={"arrowstyle": "-", "color": AFTER, "lw": 0.7},
        )  # fmt: skip
    words = "random plans\n(median, 5 to 95 %)"
    axes.text(0.97, 0.94, words, color=BEFORE, fontsize=8, transform=axes.transAxes, ha="right", va="top")
    axes.text(0.03, 0.05, "proven impossible", color=GREY, fontsize=8, transform=axes.transAxes)
    _plain_log(axes.yaxis, np.concatenate([bound, middle]))
    _pose_axis(axes, counts)
    axes.set_ylabel("expected error at the test poses, rms (µm)")
    _tidy(axes)
    return _figure(axes)


def accuracy_curve(
    counts: Ints,
    bound: Floats,
    errors: Mapping[str, Floats],
    *,
    tolerance: float | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Expected error against the number of experiments, from the key ``curve`` of plan.json or evaluate.json.

    Args:
        counts: (K,) numbers of experiments, ascending.
        bound: (K,) no plan of as many has a smaller error, mm; nan where nothing is known.
        errors: By name, (K,) errors of plans, mm; nan where a plan sees too little.
        tolerance: A stated tolerance, mm; drawn as a line.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    known = np.concatenate([bound, *errors.values()])
    known = known[np.isfinite(known) & (known > 0)]
    low, high = 0.8 * float(known.min()), 1.6 * float(known.max())
    axes.fill_between(counts, low, np.where(np.isfinite(bound), bound, low), color=PALE, lw=0, label="impossible")
    colours, others = {"designed": AFTER, "random": BEFORE}, cycle(_SERIES[2:])
    for name, values in errors.items():
        colour = colours[name] if name in colours else next(others)
        axes.plot(counts, values, "o-", color=colour, ms=3.2, lw=1.5, label=name)
    if tolerance is not None:
        axes.axhline(tolerance, color=TRUTH, lw=1.0, ls=(0, (4, 2)), label=f"tolerance {tolerance:g} mm")
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    _plain_log(axes.yaxis, known)
    _pose_axis(axes, counts)
    axes.set_ylabel("expected error at the test poses (mm)")
    axes.legend(frameon=False, fontsize=8, loc="upper right")
    _tidy(axes)
    return _figure(axes)


def efficiencies(counts: Ints, designed: Floats, random: Floats, *, axes: Axes | None = None) -> Figure:
    """Proven efficiency against the number of poses.

    Args:
        counts: (K,) numbers of poses, ascending.
        designed: (K,) proven efficiency of the designed plans, 0 to 1.
        random: (K, R) the same of random plans.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    low, middle, high = 100.0 * np.quantile(random, [0.05, 0.5, 0.95], axis=1)
    axes.fill_between(counts, low, high, color=BEFORE, alpha=0.18, lw=0)
    axes.plot(counts, middle, color=BEFORE, lw=1.6)
    axes.plot(counts, 100.0 * designed, "o-", color=AFTER, ms=3.6, lw=1.6)
    axes.text(counts[-1], 100.0 * designed[-1] - 4.0, "designed plans", color=AFTER, fontsize=8, ha="right", va="top")
    axes.text(counts[-1], middle[-1] - 9.0, "random plans", color=BEFORE, fontsize=8, ha="right", va="top")
    axes.set_ylim(0, 103)
    _pose_axis(axes, counts)
    axes.set_ylabel("proven efficiency (%)")
    _tidy(axes)
    return _figure(axes)


def expected_and_realised(expected: Floats, realised: Floats, *, axes: Axes | None = None) -> Figure:
    """Realised errors of repeated identifications against the expected error, for each test pose.

    Args:
        expected: (t,) expected rms error at the test poses, um.
        realised: (K, t) lengths of the errors of K identifications, um.
        axes: Where to draw.
    """
    axes = canvas().axes[0] if axes is None else axes
    count = len(realised)
    spread = np.linspace(-0.26, 0.26, count) if count > 1 else np.zeros(1)
    for index, level in enumerate(expected):
        found = realised[:, index]
        axes.plot(index + spread, found, "o", color=AFTER, ms=2.6, alpha=0.55, mew=0)
        axes.hlines(_rms(found), index - 0.34, index + 0.34, color=AFTER, lw=2.0)
        axes.hlines(level, index - 0.34, index + 0.34, color=TRUTH, lw=1.4, ls=(0, (3, 2)))
    axes.plot([], [], color=TRUTH, lw=1.4, ls=(0, (3, 2)), label="expected rms (before measuring)")
    axes.plot([], [], color=AFTER, lw=2.0, label=f"realised rms of {count} repetitions")
    axes.plot([], [], "o", color=AFTER, ms=2.6, alpha=0.55, mew=0, label="one repetition")
    axes.set_xticks(np.arange(len(expected)), [f"test pose {index + 1}" for index in range(len(expected))])
    axes.set_ylim(0, 1.45 * float(max(realised.max(), expected.max())))
    axes.set_ylabel("error from the identified springs (µm)")
    axes.legend(frameon=False, fontsize=8, loc="upper right")
    _tidy(axes)
    return _figure(axes)


_PAPER = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none"}


def _figure(axes: Axes) -> Figure:
    """The whole figure that axes belong to."""
    figure = axes.get_figure(root=True)
    assert figure is not None, "axes of a figure that was cleared"
    return figure


def _arms(
    robot: Robot, q: Floats, kept: Ints, attach: Floats | None, force: Floats | None, markers: Floats | None
) -> tuple[list[dict[str, Floats]], float]:
    """Parts of each kept arm as the camera sees them, name -> (P, 2), m from the base; and a third of the reach, m."""
    frames = forward(robot, q[kept])
    base = np.zeros((len(kept), 1, 3))
    parts = {"line": np.concatenate([base, frames.origin, frames.flange_origin[:, None]], axis=1)}
    end = frames.flange_origin
    unit = float(np.linalg.norm(parts["line"], axis=2).max()) / 2.8
    if markers is not None:
        parts["markers"] = end[:, None] + np.einsum("vij,mj->vmi", frames.flange_rotation, markers)
    if attach is not None:
        point = frames.point(np.broadcast_to(attach, (len(q), 3))[kept])
        pull = np.broadcast_to(robot.gravity_base if force is None else force, (len(q), 3))[kept]
        tip = point + 0.45 * unit * pull / np.linalg.norm(pull, axis=1, keepdims=True)
        parts["load"] = np.stack([end, point, tip], axis=1)
        end = point
    parts["shadow"] = parts["line"] * [1.0, 1.0, 0.0]
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    ring = 0.3 * unit * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    parts["foot"] = np.broadcast_to(ring, (len(kept), *ring.shape))
    across = np.arctan2(end[:, 1], end[:, 0]) + np.deg2rad(25.0)
    right = np.stack([np.cos(across), np.sin(across), 0 * across], axis=1)
    rise = np.deg2rad(14.0)
    up = np.stack([-np.sin(rise) * np.sin(across), np.sin(rise) * np.cos(across), 0 * across + np.cos(rise)], axis=1)
    screen = np.stack([right, up], axis=2)
    return [{part: points[arm] @ screen[arm] for part, points in parts.items()} for arm in range(len(kept))], unit


def _key(axes: Axes, width: float, unit: float, *, load: bool, reflectors: bool) -> None:
    """A bar of a round length and what the signs mean, at the foot of a panel ``width`` m wide."""
    power = 10.0 ** np.floor(np.log10(1.2 * unit))
    bar = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= 1.2 * unit)
    height = 0.1 * unit
    axes.plot([width - bar, width], [height, height], color=GREY, lw=2.0, solid_capstyle="butt")
    axes.text(width - bar - height, height, f"{bar:g} m", fontsize=7.5, color=GREY, ha="right", va="center")
    words = [("load", FORCE, "$\\downarrow$", 7.0)] * load + [("reflectors", AFTER, "o", 2.8)] * reflectors
    for index, (word, colour, sign, size) in enumerate(words):
        x = 0.2 * unit + 0.22 * width * index
        axes.plot(x, height, color=colour, marker=sign, ms=size, mew=0, ls="none")
        axes.text(x + 0.18 * unit, height, word, fontsize=7.5, color=GREY, ha="left", va="center")


def _rows(boxes: Floats, aspect: float, unit: float) -> tuple[Floats, Floats]:
    """Where arms stand in rows that fill a panel best.

    Args:
        boxes: (V, 2, 2) lower left and upper right corner of each arm, seen from its base, m.
        aspect: Width by height of the panel.
        unit: About a third of the reach, m.

    Returns:
        (V, 2) places of the bases, lower left corner of the panel at zero, and its (2,) size, m.
    """
    gap = 0.12 * (boxes[:, 1] - boxes[:, 0]).max()
    width = boxes[:, 1, 0] - boxes[:, 0, 0] + 2 * gap
    bottom, top = boxes[:, 0, 1].min(), boxes[:, 1, 1].max()
    height = top - bottom + 0.62 * unit  # room for the name below
    best, places, size = np.inf, np.zeros((len(boxes), 2)), np.ones(2)
    for count in range(1, len(boxes) + 1):
        ends = np.cumsum(width)
        row = np.minimum((ends - width / 2) / ends[-1] * count, count - 1e-9).astype(np.int64)
        totals = np.array([width[row == index].sum() for index in range(count)])
        extent = np.array([totals.max(), count * height + 0.45 * unit])  # the scale stands at the foot
        if max(extent[0], aspect * extent[1]) < best:
            best, size = max(extent[0], aspect * extent[1]), extent
            before = ends - width - np.array([width[row < index].sum() for index in row])
            slack = (extent[0] - totals[row]) / 2
            places = np.stack(
                [before + slack + gap - boxes[:, 0, 0], 0.35 * unit + (count - row) * height - top], axis=1
            )
    return places, size


def _draw_arm(axes: Axes, arm: Mapping[str, Floats]) -> None:
    """One arm from its parts (P, 2), m."""
    axes.fill(*arm["foot"].T, color=PALE, lw=0)
    axes.plot(*arm["shadow"].T, color=PALE, lw=2.2, solid_capstyle="round", solid_joinstyle="round")
    if "load" in arm:
        flange, point, tip = arm["load"]
        axes.plot(*np.stack([flange, point]).T, color=FORCE, lw=1.3)
        style = {"arrowstyle": "-|>", "color": FORCE, "lw": 1.6, "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, point, arrowprops=style)
    axes.plot(*arm["line"].T, color=ARM, lw=3.0, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(*arm["line"][1:-1].T, "o", color="white", mec=ARM, mew=1.0, ms=3.6)
    if "markers" in arm:
        axes.plot(*arm["markers"].T, "o", color=AFTER, ms=2.8, mew=0)


def _tidy(axes: Axes) -> None:
    """No frame on top and right, small quiet ticks."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(which="both", color=GREY, labelsize=8)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)


def _plain_log(axis: Axis, values: Floats) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, written as plain numbers."""
    low, high = np.floor(np.log10(values.min())) - 1, np.ceil(np.log10(values.max())) + 1
    steps = (1.0,) if high - low > 5 else (1.0, 2.0, 5.0)
    ticks = [step * 10.0**power for power in np.arange(low, high + 1) for step in steps]
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(_number))
    axis.set_minor_formatter(NullFormatter())


def _pose_axis(axes: Axes, counts: Ints) -> None:
    """Numbers of poses (K,) on a logarithmic axis."""
    axes.set_xscale("log")
    axes.set_xlim(counts[0], counts[-1])
    axes.xaxis.set_major_locator(FixedLocator(_readable(counts)))
    axes.xaxis.set_major_formatter(FuncFormatter(_number))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("number of poses")


def _readable(counts: Ints) -> list[int]:
    """Those counts that have room for a label on a logarithmic axis."""
    shown: list[int] = []
    for count in counts.tolist():
        if not shown or count >= 1.3 * shown[-1]:
            shown.append(count)
    return shown


def _number(value: float, _: int | None = None) -> str:
    return f"{value:g}"


def _round(value: float) -> str:
    """Two significant digits, three from one on."""
    return f"{value:.2f}" if value >= 1.0 else f"{value:.2g}"


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _above_zero(errors: Mapping[str, Floats]) -> dict[str, Floats]:
    """Errors that a logarithmic axis can show: at least a millionth of the largest."""
    least = 1e-6 * max(float(values.max()) for values in errors.values()) or 1e-6
    return {name: np.maximum(values, least) for name, values in errors.items()}


def _ends(values: Mapping[str, Floats], order: Ints) -> tuple[Floats, Floats]:
    """Smallest and largest of several models, (K,) each, in an order."""
    table = np.stack(list(values.values()))[:, order]
    return table.min(axis=0), table.max(axis=0)


def _floor(largest: Mapping[str, Floats]) -> float:
    return 0.5 * min(float(values.min()) for values in largest.values())
