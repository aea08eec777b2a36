"""Pictures: right data in the right place, deterministic bytes, no global state."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from doe import view
from identify.arrays import Floats
from identify.kinematics import forward
from identify.robot_files import load_robot

ROBOTS = Path(__file__).parents[2] / "configs" / "robots"
ATTACH = np.array([0.2, 0.05, -0.25])
MARKERS = np.array([[0.05, 0.0, 0.12], [0.05, 0.1, -0.06]])


def some_poses(count: int = 5) -> Floats:
    rng = np.random.default_rng(3)
    return rng.uniform([-2, -2, 0, -3, -2, -3], [2, -0.5, 2, 3, 2, 3], (count, 6))


def svg(figure: Figure) -> bytes:
    text = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "test"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def words(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def pictures() -> dict[str, Figure]:
    robot = load_robot(ROBOTS / "kr270_r2700.toml")
    rng = np.random.default_rng(1)
    before, after = rng.uniform(2, 8, 12), rng.uniform(0.02, 0.2, 12)
    counts = np.array([1, 2, 4, 8, 16])
    bound = 20.0 / np.sqrt(counts)
    random = bound[:, None] * rng.uniform(1.5, 3.0, (5, 30))
    errors = {"rigid": before, "fitted": after}
    return {
        "arms": view.stick_figures(robot, some_poses(), attach=ATTACH, markers=MARKERS),
        "histogram": view.error_histogram(errors),
        "poses": view.error_by_pose(errors, np.repeat(np.arange(4), 3)),
        "intervals": view.intervals(
            ["a", "b"], np.array([1.1, 3.0]), np.array([0.2, 0.4]), np.array([1.0, 3.1]), unit="N"
        ),
        "knee": view.knee(counts, 1.02 * bound, bound, random, repeatability=9.0, mark=4),
        "efficiency": view.efficiencies(counts, np.full(5, 0.97), (bound[:, None] / random) ** 2),
        "kept": view.expected_and_realised(np.array([5.0, 7.0]), rng.uniform(1, 12, (20, 2))),
    }


def test_every_picture_draws_without_a_warning_and_twice_the_same() -> None:
    first, second = pictures(), pictures()
    for name, figure in first.items():
        assert isinstance(figure, Figure)
        assert svg(figure) == svg(second[name]), name


def test_axes_that_carry_numbers_name_their_unit() -> None:
    for name, figure in pictures().items():
        for axes in figure.axes:
            if axes.axison:
                label = axes.get_ylabel() + axes.get_xlabel()
                assert any(unit in label for unit in ("(mm)", "(µm)", "(%", "(µrad")), name


def test_pictures_leave_pyplot_alone() -> None:
    shown = sys.modules.get("matplotlib.pyplot")
    open_before = shown.get_fignums() if shown else []
    pictures()
    shown = sys.modules.get("matplotlib.pyplot")
    assert (shown.get_fignums() if shown else []) == open_before


def test_repeated_poses_are_drawn_once_with_their_number() -> None:
    q = some_poses(3)
    q = np.concatenate([q, q[1:2] + 0.01, q[1:2] - 0.01])
    kept, counts = view.distinct(q, 0.05)
    assert kept.tolist() == [0, 1, 2]
    assert counts.tolist() == [1, 3, 1]
    figure = view.stick_figures(load_robot(ROBOTS / "kr270_r2700.toml"), q)
    assert [word for word in words(figure) if word.startswith("pose")] == ["pose 1", "pose 2  ×3", "pose 3"]


def test_arms_are_drawn_to_scale_and_upright() -> None:
    robot = load_robot(ROBOTS / "kr270_r2700.toml")
    q = some_poses(1)
    axes = view.stick_figures(robot, q, attach=ATTACH).axes[0]
    lines = [np.column_stack(line.get_data()) for line in axes.lines if line.get_color() == view.ARM]
    line = next(points for points in lines if len(points) == robot.n + 2)  # base, joints, flange
    frames = forward(robot, q)
    true = np.concatenate([np.zeros((1, 3)), frames.origin[0], frames.flange_origin])
    seen, length = np.linalg.norm(np.diff(line, axis=0), axis=1), np.linalg.norm(np.diff(true, axis=0), axis=1)
    assert (seen <= length + 1e-12).all()
    assert line[1] - line[0] == pytest.approx([0.0, length[0] * np.cos(np.deg2rad(14.0))])
    assert axes.get_aspect() == 1.0


def test_a_load_hangs_along_gravity_also_on_a_robot_at_the_ceiling() -> None:
    for mount, sign in (((0.0, 0.0, 0.0), -1.0), ((np.pi, 0.0, 0.0), 1.0)):
        robot = load_robot(ROBOTS / "kr270_r2700.toml", mount=mount)
        axes = view.stick_figures(robot, some_poses(1), attach=ATTACH).axes[0]
        arrow = next(text for text in axes.texts if not text.get_text())
        assert np.sign(arrow.xy[1] - arrow.xyann[1]) == sign


def test_histogram_and_poses_tell_rms_and_maximum() -> None:
    errors = {"before": np.array([3.0, 4.0]), "after": np.array([0.3, 0.4])}
    assert "before\nrms 3.54 mm\nmax 4.00 mm" in words(view.error_histogram(errors))
    assert "max 0.4 mm" in words(view.error_by_pose(errors, np.array([0, 1])))


def test_knee_says_how_many_random_poses_are_as_good() -> None:
    counts = np.array([1, 2, 4, 8, 16])
    bound = 10.0 / np.sqrt(counts)
    figure = view.knee(counts, bound, bound, 2.0 * bound[:, None] * np.ones((1, 5)), mark=4)
    assert "4 designed\n= 16 random" in words(figure)


def test_no_error_at_all_and_more_models_than_two_can_be_drawn() -> None:
    errors = {"rigid": np.array([2.0, 3.0]), "half": np.array([0.5, 0.7]), "exact": np.zeros(2)}
    for figure in (view.error_histogram(errors), view.error_by_pose(errors, np.array([0, 1]))):
        svg(figure)
        shown = [
            *words(figure),
            *(text.get_text() for axes in figure.axes if axes.legend_ for text in axes.legend_.texts),
        ]
        assert all(any(name in word for word in shown) for name in errors)
    svg(view.intervals(["a"], np.array([1.0]), np.array([0.0]), np.array([1.0]), unit="N"))
