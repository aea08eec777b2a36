"""A fit gives the same however its rows are cut into parts, and its triangle stands for its columns."""

from dataclasses import replace

import numpy as np
import pytest

from identify import whitened_rows
from identify.experiment import full_experiment
from identify.identification import fit_differences, identify
from identify.loads import Markers
from identify.model import model_of
from identify.response import respond, undeflected
from identify.row_distances import _square
from identify.uncertainty import _scores, load_changes_by_sigma, off_columns
from tests.identify.studies import COMPLIANCE, PLATE, UNLOADED, WEIGHT, geometry_errors, kr270_study, measured, poses

UNSURE = replace(WEIGHT, mass_std=2.0, attach_std=0.002)
WITH_BASE = Markers(
    names=(*PLATE.names, "F1"),
    positions=np.vstack([PLATE.positions, [[1.0, 0.8, 0.1]]]),
    on_base=np.array([False, False, False, True]),
)


def spoiled(data):
    """One wild row, and one visit that is short of a row."""
    positions = data.positions.copy()
    positions[17] += [0.3, -0.2, 0.5]
    return whitened_rows.take_rows(replace(data, positions=positions), np.delete(np.arange(len(positions)), 30))


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("effects", [("joint_compliance",), ("joint_compliance", "geometry")])
def test_parts_change_nothing(monkeypatch, reference, effects):
    """Small parts, so many that they go over two threads, against all rows at once."""
    rng = np.random.default_rng(20)
    study = kr270_study(reference=reference, effects=effects, loads=(UNLOADED, UNSURE))
    truth = {**COMPLIANCE, **(geometry_errors(study.robot, rng) if "geometry" in effects else {})}
    data = spoiled(measured(study, rng, count=40, values=truth))
    whole = identify(study, data)
    monkeypatch.setattr(whitened_rows, "_ROWS", 12)
    cut = identify(study, data)
    assert len(whole.fit.rows.problem.parts) == 1
    assert len(cut.fit.rows.problem.parts) >= 2 * whitened_rows._SERIAL
    assert cut.fit.identifiability.kept.tolist() == whole.fit.identifiability.kept.tolist()
    std = np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose(cut.values / np.maximum(std, 1e-9), whole.values / np.maximum(std, 1e-9), atol=1e-6)
    np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=1e-6, atol=1e-9 * std.max() ** 2)
    np.testing.assert_allclose(cut.fit.z, whole.fit.z, rtol=1e-6, atol=1e-6)
    assert cut.worst.tolist() == whole.worst.tolist() == [17]
    assert cut.lack_of_fit.chi2 == pytest.approx(whole.lack_of_fit.chi2, rel=1e-8)
    assert cut.lack_of_fit.dof == whole.lack_of_fit.dof
    assert cut.heldout.misfit.rms == pytest.approx(whole.heldout.misfit.rms, rel=1e-8)


@pytest.mark.parametrize("rows", [12, 10_000])
def test_the_triangle_stands_for_the_columns(monkeypatch, rows):
    rng = np.random.default_rng(21)
    study = kr270_study(reference="differences", loads=(UNLOADED, UNSURE))
    monkeypatch.setattr(whitened_rows, "_ROWS", rows)
    data = spoiled(measured(study, rng, count=40))
    found = fit_differences(study, model_of(study), data)
    columns, scale = found.columns, np.linalg.norm(found.columns, axis=0).max()
    assert len(found.upper) <= columns.shape[1] + 1 < len(columns)
    np.testing.assert_allclose(found.upper.T @ found.upper, columns.T @ columns, atol=1e-8 * scale**2)
    np.testing.assert_allclose(found.whitened, found.whitening.apply(found.residual), atol=1e-9)
    expected = found.whitening.apply(respond(found.model, data.experiment, found.state.values).derivative)
    np.testing.assert_allclose(columns[:, found.fitted], expected[:, found.fitted], atol=1e-9 * scale)
    assert np.abs(columns[:, found.identifiability.kept].T @ found.whitened).max() < 1e-6 * scale
    loads = load_changes_by_sigma(found)
    kept = columns[:, found.identifiability.kept]
    off = loads - kept @ np.linalg.lstsq(kept, loads, rcond=None)[0]
    assert np.abs(off).max() > 1e-6
    np.testing.assert_allclose(off_columns(found, loads), off, atol=1e-8 * np.abs(loads).max())


def test_markers_elsewhere_ride_on_the_same_arm():
    """A scene that shares its arm says what a scene of its own would say; one whose arm changes is never shared."""
    rng = np.random.default_rng(22)
    study = kr270_study(effects=("joint_compliance", "link_compliance"))
    model = model_of(study)
    experiment = measured(study, rng, count=5).experiment
    values = model.nominal + rng.normal(0, 1.0, len(model.nominal)) * ~model.nuisance
    values[model.frame_size : model.frame_size + model.marker_size] = rng.normal(0, 2.0, model.marker_size)
    shared = undeflected(model, experiment)
    for scaled in (values, values * (1 + model.nuisance), values * (2 - model.nuisance)):
        own, other = respond(model, experiment, scaled), respond(model, experiment, scaled, known=shared)
        np.testing.assert_allclose(other.position, own.position, rtol=0, atol=1e-14)
        np.testing.assert_allclose(other.derivative, own.derivative, rtol=1e-9, atol=1e-12)
    assert undeflected(model_of(replace(study, effects=("geometry",))), experiment) is None


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
@pytest.mark.parametrize(
    "effects", [("joint_compliance", "joint_hardening"), ("joint_compliance", "link_compliance", "geometry")]
)
def test_a_marker_moves_its_readings_as_its_columns_say(effects, equilibrium):
    """Central differences of the whole response, with deflections of centimetres and a marker on the base."""
    rng = np.random.default_rng(23)
    study = kr270_study(effects=effects, equilibrium=equilibrium, markers=WITH_BASE)
    model = model_of(study)
    experiment = full_experiment(poses(study, 4, rng), np.tile([0, 1], (4, 1)), study.loads, study.markers)
    stiff = np.array([name.startswith("joint_compliance") for name in model.names])
    values = model.nominal + stiff * rng.uniform(1.0, 3.0, len(stiff))
    response = respond(model, experiment, values)
    assert np.abs(response.deflection).max() > 5e-3
    for column in range(model.frame_size, model.frame_size + model.marker_size):
        step = 0.1 * (np.arange(len(values)) == column)
        ahead, behind = (
            respond(model, experiment, v, derivative=False).position for v in (values + step, values - step)
        )
        np.testing.assert_allclose(response.derivative[:, :, column], (ahead - behind) / 0.2, rtol=0, atol=2e-9)
    assert np.abs(response.derivative - response.direct).max() > 1e-6


def test_squared_shifts_and_scores_are_those_of_the_plain_formulas():
    rng = np.random.default_rng(24)
    root = rng.normal(size=(50, 4, 3, 5)) * [[1.0], [10.0], [100.0]]
    precision, score = root @ root.swapaxes(2, 3), rng.normal(size=(50, 4, 3))
    expected = np.einsum("gmi,gmij,gmj->gm", score, np.linalg.inv(precision), score)
    np.testing.assert_allclose(_square(precision, score), expected, rtol=1e-9)
    for share in (0.0, 0.01, 0.3, 0.9):
        basis, whitened = rng.normal(size=(20, 6, 4)), rng.normal(size=(20, 6))
        basis *= np.sqrt(share) / np.linalg.norm(basis, axis=(1, 2), keepdims=True)
        left = np.linalg.solve(np.eye(6) - basis @ basis.swapaxes(1, 2), whitened[..., None])
        np.testing.assert_allclose(_scores(basis, whitened), (basis.swapaxes(1, 2) @ left)[..., 0], atol=1e-13)
