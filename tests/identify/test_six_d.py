"""6-D targets: their orientations as rows of the same fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from identify.effects import REGISTRY
from identify.experiment import full_experiment
from identify.identification import identify
from identify.loads import Markers
from identify.model import model_of
from identify.response import respond
from identify.simulate import simulate
from identify.six_d import as_read, with_turns
from identify.study import Noise
from tests.identify.studies import (
    COMPLIANCE,
    SIDE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    measured,
    placement_of,
    poses,
    random_robot,
    study_of,
    values_of,
)
from tests.identify.test_effects import differences, everywhere

SIX_D = Noise(reading=0.03e-3, pose_jitter=12e-6, reading_jitter=1.5e-6, orientation=40e-6)
ONE = Markers(("T",), np.array([[0.1, 0.05, 0.12]]), np.array([False]))
OPTIONS = {"tracker_step": {"time_s": 50.0}, "gravity_compensator": {"mode": "harmonics"}}
POSITION_ALONE = {"tracker_scale", "marker_seating"}


def lever_arms(experiment, rotation):
    """The same shots reading four points: the flange origin and 1 m along its axes."""
    corners = Markers(("O", "X", "Y", "Z"), np.vstack([np.zeros(3), np.eye(3)]), np.zeros(4, dtype=bool))
    count = len(experiment.shot_visit)
    return replace(
        experiment,
        markers=corners,
        row_shot=np.repeat(np.arange(count), 4),
        row_marker=np.tile(np.arange(4), count),
        time=None if experiment.time is None else np.repeat(experiment.time, 4),
        temperature=None if experiment.temperature is None else np.repeat(experiment.temperature, 4),
    ), rotation[experiment.shot_pose]


def turn_of_points(moved, rotation):
    """Half the sum of e x (difference): the turn of a rigid motion of four points, (S, 3, p) from (4 S, 3, p)."""
    four = moved.reshape(len(rotation), 4, 3, -1)
    arms = rotation.swapaxes(1, 2)
    return 0.5 * np.cross(arms[..., None], four[:, 1:] - four[:, :1], axis=2).sum(axis=1)


@pytest.mark.parametrize("name", sorted(set(REGISTRY) - POSITION_ALONE))
def test_what_every_effect_does_to_a_turn_is_what_it_does_to_points_on_lever_arms(name):
    rng = np.random.default_rng(3)
    options = {name: OPTIONS[name]} if name in OPTIONS else {}
    study = kr270_study(
        effects=tuple(dict.fromkeys(("joint_compliance", name))), loads=(UNLOADED, WEIGHT, SIDE), options=options,
        markers=ONE, noise=SIX_D, frame_free=False, markers_fitted=False,
    )  # fmt: skip
    model = model_of(study)
    values = values_of(model, COMPLIANCE)
    plain = experiment_of(study, poses(study, 5, rng))
    shots = len(plain.shot_visit)
    plain = replace(
        plain,
        time=np.linspace(0, 100, shots),
        temperature=np.linspace(20, 30, shots),
        approach=rng.choice([-1.0, 1.0], (len(plain.visits), study.robot.n)),
    )
    read = with_turns(plain)
    there = respond(model, read, values, bending=False)
    points, rotation = lever_arms(plain, there.scene.frames.flange_rotation)
    expected = turn_of_points(respond(model, points, values, bending=False).direct, rotation)
    np.testing.assert_allclose(there.direct[read.turning], expected, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(
        there.derivative[~read.turning], respond(model, plain, values, bending=False).derivative
    )


def test_what_concerns_positions_alone_does_not_turn_anything():
    study = kr270_study(effects=tuple(POSITION_ALONE), markers=ONE, noise=SIX_D)
    model, read = model_of(study), with_turns(experiment_of(study, poses(study, 4, np.random.default_rng(0))))
    columns = respond(model, read, model.nominal).derivative[:, :, model.nuisance_size :]
    assert not columns[read.turning].any()
    assert columns[~read.turning].any()


@pytest.mark.parametrize("loaded", [False, True])
def test_turns_have_the_derivatives_of_the_orientations_themselves(loaded):
    """By finite differences of the rotation matrices, frame and seats of the targets included."""
    rng = np.random.default_rng(5)
    robot = random_robot(rng, (False, False, True, False))
    study = study_of(
        robot, loads=(UNLOADED, SIDE), markers=ONE, effects=("joint_compliance", "geometry"), noise=SIX_D,
        equilibrium="loaded" if loaded else "linear",
    )  # fmt: skip
    model = model_of(study)
    values = values_of(model, everywhere(study, rng, soft=0.5))
    read = with_turns(experiment_of(study, poses(study, 4, rng)))
    there = respond(model, read, values)

    def turned(at):
        other = respond(model, read, at, derivative=False).turned
        return Rotation.from_matrix(other @ there.turned.swapaxes(1, 2)).as_rotvec()

    for index, name in enumerate(model.names):
        nudge = 1e-2 * (np.arange(len(values)) == index)
        numeric = (turned(values + nudge) - turned(values - nudge)) / 2e-2
        analytic = there.derivative[read.turning, :, index]
        size = np.abs(numeric).max() + 1e-12
        assert np.abs(numeric - analytic).max() < 5e-3 * size, name  # a deflection of some mrad
    positions = ~read.turning
    np.testing.assert_allclose(
        there.derivative[positions], differences(model, read, values)[positions], rtol=1e-5, atol=1e-10
    )


def test_a_target_that_sits_anyhow_on_the_flange_gives_the_same_estimates():
    rng = np.random.default_rng(7)
    study = kr270_study(markers=ONE, noise=SIX_D, effects=("joint_compliance", "geometry"))
    data = measured(study, rng, count=20)
    crooked = Rotation.from_quat(data.quaternions, scalar_first=True) * Rotation.from_rotvec([1.0, -2.0, 0.7])
    straight, turned = identify(study, data), identify(study, replace(data, quaternions=quaternions_of(crooked)))
    for name, value in straight.parameters.items():
        std = np.sqrt(np.diag(straight.covariance))[straight.model.names.index(name)]
        assert abs(turned.parameters[name] - value) < 1e-3 * std
    np.testing.assert_allclose(Rotation.from_matrix(turned.mounts[0]).as_rotvec(), [1.0, -2.0, 0.7], atol=2e-3)


def quaternions_of(rotation):
    return rotation.as_quat(canonical=True, scalar_first=True)


@pytest.mark.parametrize("reference", ["absolute", "differences"])
def test_estimates_scatter_as_stated_and_orientations_tell_more(reference):
    rng = np.random.default_rng(11)
    study = kr270_study(markers=ONE, noise=SIX_D, reference=reference)
    experiment = experiment_of(study, poses(study, 12, rng))
    model = model_of(study)
    truth = values_of(model, COMPLIANCE)
    z, chi2, narrower = [], [], []
    for _ in range(40):
        data = simulate(model, truth, experiment, study.noise, placement_of(rng), rng)
        found = identify(study, data)
        alone = identify(study, replace(data, quaternions=None))
        std = np.sqrt(np.diag(found.covariance))
        index = [found.model.names.index(name) for name in found.parameters]
        z.append((found.values - truth)[index] / std[index])
        chi2.append(found.lack_of_fit.chi2 / found.lack_of_fit.dof)
        there = [alone.model.names.index(name) for name in found.parameters]
        narrower.append(std[index] / np.sqrt(np.diag(alone.covariance))[there])
    assert 0.8 < np.std(z) < 1.2
    assert abs(np.mean(chi2) - 1) < 0.05
    assert np.max(narrower) < 1.0
    assert len(found.residuals) == len(data.positions) == len(found.turn_residuals)


def test_what_was_read_comes_back_from_its_rows():
    rng = np.random.default_rng(1)
    fixed = Markers(("A", "F", "B"), rng.normal(size=(3, 3)), np.array([False, True, False]))
    q = rng.uniform(-1, 1, (4, 6))
    plain = full_experiment(q, np.zeros((4, 1), dtype=np.int64), (UNLOADED,), fixed)
    read = with_turns(plain)
    assert read.turning.sum() == 8
    turned = Rotation.random(8, rng=rng)
    again, positions, quaternions = as_read(read, rng.normal(size=(20, 3)), turned.as_matrix())
    np.testing.assert_array_equal(again.row_marker, plain.row_marker)
    assert again.row_turns is None
    assert len(positions) == len(quaternions) == 12
    flange = np.flatnonzero(plain.row_marker != 1)
    np.testing.assert_allclose(quaternions[flange], quaternions_of(turned), atol=1e-14)
    np.testing.assert_array_equal(quaternions[plain.row_marker == 1], np.tile([1.0, 0, 0, 0], (4, 1)))


def test_a_wrong_orientation_is_found_and_has_little_influence():
    rng = np.random.default_rng(21)
    study = kr270_study(markers=ONE, noise=SIX_D)
    data = measured(study, rng, count=15)
    wrong = np.array(data.quaternions)
    wrong[6] = quaternions_of(Rotation.from_rotvec([0.01, 0, 0]) * Rotation.from_quat(wrong[6], scalar_first=True))
    found, clean = identify(study, replace(data, quaternions=wrong)), identify(study, data)
    worst = int(found.worst[0])
    assert found.data.experiment.turning[worst]
    assert found.data.lines[worst] == data.lines[6]
    for name, value in clean.parameters.items():
        std = np.sqrt(np.diag(clean.covariance))[clean.model.names.index(name)]
        assert abs(found.parameters[name] - value) < 2 * std
