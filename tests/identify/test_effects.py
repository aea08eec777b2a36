"""The derivative of every reading by every parameter, against finite differences of the response itself."""

import numpy as np
import pytest

from identify.effects import bind_effects
from identify.errors import InputError
from identify.kinematics import flange_poses
from identify.loads import Markers
from identify.model import model_of
from identify.response import respond
from tests.identify.studies import (
    COMPLIANCE,
    LIGHT,
    NOISE,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    poses,
    random_robot,
    study_of,
    ur10_study,
    values_of,
)

BOTH = ("joint_compliance", "geometry")
ON_BOTH = Markers(
    names=("M1", "M2", "F1"),
    positions=np.array([[0.3, 0.12, -0.08], [0.02, 0.09, 0.22], [1.1, -0.6, 0.1]]),
    on_base=np.array([False, False, True]),
)


def differences(model, experiment, values):
    """Central differences of the response by each parameter, at two steps combined (Richardson), (R, 3, p)."""
    columns = []
    for index in range(len(values)):
        slopes = []
        for step in (2e-2, 1e-2):
            nudge = np.zeros(len(values))
            nudge[index] = step
            ahead, behind = (
                respond(model, experiment, values + sign * nudge, derivative=False).position for sign in (1, -1)
            )
            slopes.append((ahead - behind) / (2 * step))
        columns.append((4 * slopes[1] - slopes[0]) / 3)
    return np.stack(columns, axis=-1)


def assert_derivative(study, rng, given, relative=1e-6):
    """The frame sits at zero, as in every fit; all other parameters are anywhere."""
    model = model_of(study)
    values = values_of(model, given)
    experiment = experiment_of(study, poses(study, 6, rng))
    analytic = respond(model, experiment, values).derivative
    numeric = differences(model, experiment, values)
    scale = np.abs(numeric).max(axis=(0, 1))
    error = np.abs(analytic - numeric).max(axis=(0, 1))
    bad = error > relative * scale + 1e-15
    assert not bad.any(), [(n, e, s) for n, e, s, b in zip(model.names, error, scale, bad, strict=True) if b]
    return scale


def everywhere(study, rng, soft=1.0):
    """Random values of every parameter but the frame's."""
    model = model_of(study)
    wide = {"mm": 0.6, "mrad": 0.8, "urad/Nm": soft, "um/N": soft}
    return {p.name: float(rng.normal(0, wide[p.unit])) for p in model.parameters if not p.name.startswith("frame")}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("slides", [(False,) * 6, (False, True, False, True, False), (True, True, True, False)])
def test_derivatives_of_random_robots_equal_finite_differences(seed, slides):
    rng = np.random.default_rng([seed, len(slides)])
    study = study_of(
        random_robot(rng, slides), loads=(UNLOADED, LIGHT, SIDE), markers=ON_BOTH, effects=BOTH, noise=NOISE
    )
    assert_derivative(study, rng, everywhere(study, rng))


@pytest.mark.parametrize("seed", range(3))
def test_flange_errors_of_exact_markers_have_exact_derivatives(seed):
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, (False, False, True, False))
    study = study_of(robot, loads=(UNLOADED, SIDE), markers=ON_BOTH, markers_fitted=False, effects=BOTH)
    assert any(name.startswith("geometry.flange") for name in model_of(study).names)
    assert_derivative(study, rng, everywhere(study, rng))


@pytest.mark.parametrize(("make", "parallel"), [(kr270_study, ["j3"]), (ur10_study, ["j3", "j4"])])
def test_parallel_axes_take_beta_and_have_exact_derivatives(make, parallel):
    rng = np.random.default_rng(5)
    study = make(effects=BOTH)
    names = model_of(study).names
    assert [name.split(".")[1] for name in names if name.endswith(".beta")] == parallel
    assert not any(f"geometry.{joint}.d" in names for joint in parallel)
    assert_derivative(study, rng, everywhere(study, rng, soft=3.0))


def test_base_frame_and_mounting_have_exact_derivatives():
    rng = np.random.default_rng(11)
    study = kr270_study(effects=BOTH, frame_free=False, mount=(0.3, -0.2, 0.4), loads=(UNLOADED, WEIGHT, LIGHT))
    assert not any(name.startswith("frame") for name in model_of(study).names)
    scale = assert_derivative(study, rng, everywhere(study, rng))
    assert scale[model_of(study).names.index("joint_compliance.j1")] > 0


def test_markers_on_the_base_answer_to_frame_and_their_own_position_only():
    rng = np.random.default_rng(3)
    study = kr270_study(effects=BOTH, markers=ON_BOTH)
    model = model_of(study)
    experiment = experiment_of(study, poses(study, 5, rng))
    derivative = respond(model, experiment, values_of(model, COMPLIANCE)).derivative
    rows = experiment.row_marker == 2
    moving = {model.names[i] for i in np.flatnonzero(np.abs(derivative[rows]).max(axis=(0, 1)))}
    assert moving == {f"frame.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")} | {f"marker.F1.{c}" for c in "xyz"}


def test_geometry_is_complete_with_frame_and_markers():
    """Any rigid displacement of any joint frame is a combination of the columns (Hayati's parameter set)."""
    rng = np.random.default_rng(8)
    study = ur10_study(effects=("geometry",), loads=(UNLOADED,))
    model = model_of(study)
    experiment = experiment_of(study, poses(study, 40, rng))
    response = respond(model, experiment, model.nominal)
    columns = response.derivative.reshape(-1, len(model.parameters))
    columns = columns / np.linalg.norm(columns, axis=0)
    frames, pose = response.scene.frames, response.scene.row_pose
    for joint in range(study.robot.n):
        rotation, origin = frames.rotation[:, joint], frames.origin[:, joint]
        for axis in rotation.swapaxes(1, 2).swapaxes(0, 1):
            for extra in (axis[pose], np.cross(axis[pose], response.scene.point - origin[pose])):
                flat = extra.ravel() / np.linalg.norm(extra)
                left = flat - columns @ np.linalg.lstsq(columns, flat, rcond=1e-12)[0]
                assert np.linalg.norm(left) < 1e-8


def test_deflection_is_the_sum_of_its_columns_and_linear_in_compliance():
    rng = np.random.default_rng(2)
    study = kr270_study(frame_free=False, loads=(UNLOADED, WEIGHT, SIDE))
    model = model_of(study)
    experiment = experiment_of(study, poses(study, 8, rng))
    values = values_of(model, COMPLIANCE)
    response = respond(model, experiment, values)
    (where,) = model.effect_slices
    np.testing.assert_allclose(response.derivative[:, :, where] @ values[where], response.deflection, atol=1e-15)
    twice = respond(model, experiment, 2 * values)
    np.testing.assert_allclose(twice.deflection, 2 * response.deflection, rtol=1e-12)


def test_displaced_geometry_is_what_the_robot_file_would_say():
    """A longer link and a zero offset by their parameters, or by the placement itself."""
    rng = np.random.default_rng(4)
    study = study_of(kr270_study().robot, effects=("geometry",))
    (effect,) = bind_effects(("geometry",), study.robot)
    values = np.zeros(len(effect.parameters))
    names = [p.name for p in effect.parameters]
    values[names.index("geometry.j3.a")], values[names.index("geometry.j5.offset")] = 0.7, 1.5
    moved = effect.adjust(study.robot, values)
    expected = study.robot.placements[2][:3, 3] * (1 + 0.7e-3 / np.linalg.norm(study.robot.placements[2][:3, 3]))
    np.testing.assert_allclose(moved.placements[2][:3, 3], expected, atol=1e-15)
    q = poses(study, 3, rng)
    turned = q.copy()
    turned[:, 4] += 1.5e-3
    only_length = effect.adjust(study.robot, np.where(np.array(names) == "geometry.j3.a", values, 0.0))
    np.testing.assert_allclose(flange_poses(moved, q), flange_poses(only_length, turned), atol=1e-14)


def test_places_limit_an_effect_and_unknown_ones_are_refused():
    study = kr270_study(effects=("joint_compliance@j3", "geometry@j2", "joint_compliance@j1"))
    names = [name for name in model_of(study).names if not name.startswith(("frame", "marker"))]
    assert names[:2] == ["joint_compliance.j1", "joint_compliance.j3"]
    assert {name.rsplit(".", 1)[0] for name in names[2:]} == {"geometry.j2"}
    for wrong in ("joint_compliance@j7", "geometry@base", "wind"):
        with pytest.raises(InputError, match=wrong.partition("@")[2] or wrong):
            bind_effects((wrong,), study.robot)
