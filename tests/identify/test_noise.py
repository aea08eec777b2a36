"""Whitening against the dense covariance of the noise model, and against textbook estimators on it."""

from dataclasses import replace

import numpy as np
import pytest
import statsmodels.api as sm

from identify.experiment import Experiment
from identify.fit import State, fit
from identify.kinematics import flange_poses
from identify.loads import Markers
from identify.model import model_of
from identify.noise import _inverse_root, instrument_covariance, whitening
from identify.response import respond
from identify.simulate import simulate
from identify.study import Noise, Tracker
from identify.uncertainty import stated_covariance
from tests.identify.studies import (
    COMPLIANCE,
    LIGHT,
    NOISE,
    PLATE,
    UNLOADED,
    WEIGHT,
    experiment_of,
    kr270_study,
    poses,
    readings,
)

TRACKER = Tracker(radial=8e-6, radial_per_m=2e-6, transverse=10e-6, transverse_per_m=5e-6)
NOISES = {
    "readings": Noise(reading=0.03e-3),
    "jitter": NOISE,
    "tracker": Noise(tracker=TRACKER, pose_jitter=15e-6, reading_jitter=4e-6),
}
STATION = np.array([4.0, -1.5, 0.8])
WITH_BASE = Markers(
    names=(*PLATE.names, "F1"),
    positions=np.vstack([PLATE.positions, [[1.0, 0.8, 0.1]]]),
    on_base=np.array([False, False, False, True]),
)


def study(**changes):
    return kr270_study(loads=(UNLOADED, WEIGHT, LIGHT), **changes)


def balanced(study, rng):
    return experiment_of(study, poses(study, 5, rng))


def ragged(study, rng, count=6):
    """Missing readings, unequal shots, repeats, and one visit whose rows state two different joint values."""
    loads = np.array([0, 1, 2, 0, 1])
    repeats = np.array([1, 1, 1, 2, 2])
    q = np.vstack([poses(study, count, rng), poses(study, 1, rng)])
    pose = np.repeat(np.arange(count), 5)
    pose[3] = count  # the fourth shot of the first visit was typed with other joint values
    markers = len(study.markers.names)
    full = Experiment(
        visits=tuple(f"P{i}" for i in range(count)),
        q=q,
        loads=study.loads,
        markers=study.markers,
        shot_visit=np.repeat(np.arange(count), 5),
        shot_pose=pose,
        shot_load=np.tile(loads, count),
        shot_repeat=np.tile(repeats, count),
        row_shot=np.repeat(np.arange(5 * count), markers),
        row_marker=np.tile(np.arange(markers), 5 * count),
    )
    keep = np.sort(rng.permutation(len(full.row_shot))[: int(0.7 * len(full.row_shot))])
    return replace(full, row_shot=full.row_shot[keep], row_marker=full.row_marker[keep])


def numeric_motion(study, experiment, marker, pose):
    """Jacobian (3, n) of a marker by central differences of the flange pose."""
    robot, step = study.robot, 1e-6
    if study.markers.on_base[marker]:
        return np.zeros((3, robot.n))
    local = np.append(study.markers.positions[marker], 1.0)
    nudged = np.vstack([experiment.q[pose] + sign * step * np.eye(robot.n) for sign in (1, -1)])
    points = flange_poses(robot, nudged)[:, :3] @ local
    return (points[: robot.n] - points[robot.n :]).T / (2 * step)


def dense_covariance(study, experiment, noise, station, weights):
    """V of all rows, entry by entry from its definition."""
    rows = len(experiment.row_shot)
    shot, visit = experiment.row_shot, experiment.row_visit
    motion = [
        numeric_motion(study, experiment, m, p)
        for m, p in zip(experiment.row_marker, experiment.shot_pose[shot], strict=True)
    ]
    total = np.zeros((3 * rows, 3 * rows))
    for i in range(rows):
        here = slice(3 * i, 3 * i + 3)
        for j in range(rows):
            shared = (visit[i] == visit[j]) * noise.pose_jitter**2 + (shot[i] == shot[j]) * noise.reading_jitter**2
            total[here, 3 * j : 3 * j + 3] += shared * motion[i] @ motion[j].T
        if noise.tracker is None:
            own = noise.reading**2 * np.eye(3)
        else:
            local = np.append(study.markers.positions[experiment.row_marker[i]], 1.0)
            on_base = study.markers.on_base[experiment.row_marker[i]]
            flange = np.eye(4) if on_base else flange_poses(study.robot, experiment.q[experiment.shot_pose[shot[i]]])[0]
            beam = flange[:3] @ local - station
            length = np.linalg.norm(beam)
            t = noise.tracker
            across, along = t.transverse + t.transverse_per_m * length, t.radial + t.radial_per_m * length
            turn = np.linalg.qr(np.column_stack([beam / length, np.eye(3)[:, :2]]))[0]
            own = turn @ np.diag([along**2, across**2, across**2]) @ turn.T
        total[here, here] += own / weights[i]
    return total


def offset_columns(experiment):
    """One free displacement of each (visit, marker), (3 R, 3 K)."""
    key = experiment.row_visit * 100 + experiment.row_marker
    return np.kron(key[:, None] == np.unique(key), np.eye(3))


def flat_operator(whitener, rows):
    """The whole operator as one matrix (K, 3 R)."""
    return whitener.apply(np.eye(3 * rows).reshape(rows, 3, 3 * rows))


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
@pytest.mark.parametrize("layout", [balanced, ragged])
@pytest.mark.parametrize("free_offsets", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
def test_whitened_readings_have_unit_covariance(noise, layout, free_offsets, weighted):
    rng = np.random.default_rng(17)
    own = study(markers=WITH_BASE)
    experiment = layout(own, rng)
    rows = len(experiment.row_shot)
    weights = np.where(rng.random(rows) < 0.2, rng.uniform(1e-4, 1, rows), 1.0) if weighted else np.ones(rows)
    model = model_of(own)
    scene = respond(model, experiment, model.nominal).scene
    whitener = whitening(scene, noise, STATION, free_offsets=free_offsets, weights=weights)
    operator = flat_operator(whitener, rows)
    dense = dense_covariance(own, experiment, noise, STATION, weights)
    np.testing.assert_allclose(operator @ dense @ operator.T, np.eye(len(operator)), atol=1e-7)
    if free_offsets:
        offsets = offset_columns(experiment)
        assert len(operator) == 3 * rows - offsets.shape[1]
        assert np.abs(operator @ offsets).max() < 1e-9 * np.abs(operator).max()
        assert (whitener.apply(offsets.reshape(rows, 3, -1)) == 0.0).all()
    else:
        assert len(operator) == 3 * rows
    visits = whitener.visits(experiment)
    for row, visit in zip(operator, visits, strict=True):
        assert set(experiment.row_visit[np.flatnonzero(np.abs(row).reshape(rows, 3).max(axis=1))]) == {visit}


@pytest.mark.parametrize("free_offsets", [False, True])
def test_the_fast_path_of_balanced_visits_equals_the_general_one(free_offsets):
    """A weight a hair below one sends every visit down the general path."""
    rng = np.random.default_rng(5)
    own = study()
    experiment = balanced(own, rng)
    model = model_of(own)
    scene = respond(model, experiment, model.nominal).scene
    rows = len(experiment.row_shot)
    fast = whitening(scene, NOISES["tracker"], STATION, free_offsets=free_offsets)
    slow = whitening(scene, NOISES["tracker"], STATION, free_offsets=free_offsets, weights=np.full(rows, 1 - 1e-13))
    # one stands for the sum of contrasts of equal shots, the other for a Cholesky factor of the whole visit
    assert not np.allclose(fast.groups[0][1], slow.groups[0][1])
    first, second = (flat_operator(w, rows) for w in (fast, slow))
    scale = np.abs(second.T @ second).max()
    np.testing.assert_allclose(first.T @ first / scale, second.T @ second / scale, atol=1e-9)


@pytest.mark.parametrize(("count", "size"), [(3, 9), (64, 1), (1000, 9), (300, 18), (70, 60)])
def test_roots_of_many_matrices_are_those_of_each(count, size):
    """Few, many, more than are taken at once, and too large to be taken at once."""
    draw = np.random.default_rng(6).normal(size=(count, size, 2 * size))
    covariance = draw @ draw.swapaxes(1, 2)
    root = _inverse_root(covariance)
    np.testing.assert_allclose(np.triu(root, 1), 0.0, atol=1e-12)
    unit = root @ covariance @ root.swapaxes(1, 2)
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(size), unit.shape), atol=1e-11)


def test_the_beam_is_known_better_than_its_direction():
    points = np.array([[10.0, 0, 0], [0, 3.0, 0]])
    covariance = instrument_covariance(Noise(tracker=TRACKER), points, np.zeros(3))
    for point, axis in ((0, 0), (1, 1)):
        length = np.linalg.norm(points[point])
        expected = np.full(3, (10e-6 + 5e-6 * length) ** 2)
        expected[axis] = (8e-6 + 2e-6 * length) ** 2
        np.testing.assert_allclose(covariance[point], np.diag(expected), atol=1e-18)


def test_simulated_readings_have_the_stated_covariance():
    """4,000 draws of one visit, whitened by V: unit covariance, entry by entry, within sampling error."""
    rng = np.random.default_rng(23)
    own = study(markers=WITH_BASE, frame_free=False)
    one = experiment_of(own, np.repeat(poses(own, 1, rng), 4000, axis=0))
    model = model_of(own)
    noise = NOISES["tracker"]
    data = simulate(model, model.nominal, one, noise, np.eye(4), rng)
    size = len(own.loads) * len(own.markers.names)
    expected = respond(model, one, model.nominal, derivative=False).position
    error = (data.positions - expected).reshape(4000, 3 * size)
    dense = dense_covariance(own, experiment_of(own, one.q[:1]), noise, np.zeros(3), np.ones(size))
    whitened = np.linalg.solve(np.linalg.cholesky(dense), error.T)
    found = whitened @ whitened.T / 4000
    spread = np.sqrt((1 + np.eye(3 * size)) / 4000)
    z = ((found - np.eye(3 * size)) / spread)[np.triu_indices(3 * size)]
    assert np.abs(z).max() < 4.5
    assert 0.9 < z.std() < 1.1


def linear_problem(own, layout, rng):
    """Residual at nominal (3 R,), columns (3 R, p) of what a fit may move, and its start."""
    experiment = layout(own, rng)
    data = readings(own, experiment, COMPLIANCE, rng, noise=NOISES["tracker"])
    model = model_of(own)
    columns = respond(model, experiment, model.nominal).derivative
    start = State(model.nominal, np.eye(4), np.ones(len(data.positions)))
    residual = data.positions - respond(model, experiment, model.nominal).position
    return model, data, columns.reshape(-1, columns.shape[2]), residual.ravel(), start


@pytest.mark.parametrize("layout", [balanced, ragged])
def test_absolute_estimates_are_the_dense_gls_solution(layout):
    rng = np.random.default_rng(29)
    noise = replace(NOISES["tracker"], tracker=replace(TRACKER, station=STATION))
    own = study(frame_free=False, markers_fitted=False, noise=noise)
    model, data, columns, residual, start = linear_problem(own, layout, rng)
    dense = dense_covariance(own, data.experiment, noise, STATION, np.ones(len(data.positions)))
    found = fit(model, data, noise, start)
    kept = found.identifiability.kept
    reference = sm.GLS(residual, columns[:, kept], sigma=dense).fit()
    np.testing.assert_allclose(found.state.values[kept], reference.params, rtol=1e-7)
    np.testing.assert_allclose(found.chi2, reference.ssr, rtol=1e-6)
    np.testing.assert_allclose(
        stated_covariance(found)[np.ix_(kept, kept)], reference.normalized_cov_params, rtol=1e-5, atol=1e-12
    )


@pytest.mark.parametrize("layout", [balanced, ragged])
def test_differences_equal_the_regression_with_a_free_offset_of_every_visit_and_marker(layout):
    rng = np.random.default_rng(31)
    noise = replace(NOISES["tracker"], tracker=replace(TRACKER, station=STATION))
    own = study(frame_free=False, markers_fitted=False, noise=noise)
    model, data, columns, residual, start = linear_problem(own, layout, rng)
    dense = dense_covariance(own, data.experiment, noise, STATION, np.ones(len(data.positions)))
    found = fit(model, data, noise, start, free_offsets=True)
    kept = found.identifiability.kept
    offsets = offset_columns(data.experiment)
    reference = sm.GLS(residual, np.hstack([columns[:, kept] * 1e3, offsets]), sigma=dense).fit()
    np.testing.assert_allclose(found.state.values[kept], reference.params[: len(kept)] * 1e3, rtol=1e-6)
    np.testing.assert_allclose(found.chi2, reference.ssr, rtol=1e-6)
    assert found.dof == len(residual) - offsets.shape[1] - len(kept)
