"""12,543 measured poses of a real UR10: every row used, the published accuracy reached, spoilt rows found."""

import os
from dataclasses import replace

import numpy as np
import pytest

from identify.config import load_study
from identify.diagnosis import diagnose
from identify.fit import fit, start
from identify.identification import heldout_misfit, identify
from identify.kinematics import forward
from identify.model import model_of
from identify.selection import take_rows
from identify.tables import load_measurements
from tests.identify.spoiling import POSITION, Table, spoil
from tests.identify.studies import ROOT

FOLDER = ROOT.parent / "shared" / "data" / "ur10-tmac"
WHERE = (
    f"needs ../shared/data/{FOLDER.name}: series_a.csv and series_d.csv of the GitHub repository "
    "christianlandgraf/ipa-robot-accuracy, converted to the columns of measurements.csv (docs/formats.md)"
)
SERIES = {"d": (632, 0.42, 0.77), "a": (11911, 0.45, 0.84)}  # rows, held-out rms to reach, rms without geometry, mm


def table_of(series):
    path = FOLDER / f"series_{series}.csv"
    if not path.is_file():
        (pytest.fail if os.environ.get("CI") else pytest.skip)(WHERE)
    return Table.read(path.read_text(encoding="utf-8"))


def study_of(series):
    return load_study(ROOT / "configs" / "studies" / f"ur10_series_{series}.toml")


@pytest.fixture(scope="module", params=SERIES)
def series(request, tmp_path_factory):
    table, study = table_of(request.param), study_of(request.param)
    path = table.write(tmp_path_factory.mktemp("series") / "measurements.csv")
    return request.param, table, study, identify(study, load_measurements(path, study))


def test_heldout_poses_are_predicted_to_the_published_accuracy_from_every_row(series):
    name, table, _, result = series
    rows, limit, _ = SERIES[name]
    assert len(table.rows) == len(result.residuals) == rows
    assert sorted(result.data.lines) == list(range(2, rows + 2))
    assert result.heldout.misfit.rms * 1e3 <= limit
    assert result.heldout.visits == round(0.4 * rows)
    assert len(result.heldout.misfit.error) >= result.heldout.visits - len(result.worst)
    assert len(result.worst) < 0.002 * rows
    assert (result.reference, result.covariance_kind) == ("absolute", "pose-clustered")


def test_no_reading_is_used_at_less_than_its_weight_unless_it_is_listed(series):
    _, _, _, result = series
    assert set(np.flatnonzero(result.fit.state.weights < 1)) <= set(result.worst.tolist())


def test_a_rigid_nominal_robot_leaves_twice_the_error(series, tmp_path):
    name, table, study, _ = series
    rigid = replace(study, effects=())
    result = identify(rigid, load_measurements(table.write(tmp_path / "measurements.csv"), rigid))
    assert result.misfit.rms * 1e3 == pytest.approx(SERIES[name][2], abs=0.03)
    assert result.parameters == {}


def test_another_split_gives_the_same_answer(series):
    _, _, study, result = series
    others = [identify(study, result.data, seed=seed).heldout.misfit.rms for seed in (1, 2)]
    np.testing.assert_allclose(others, result.heldout.misfit.rms, rtol=0.1)


def moved_by(table, clean, study):
    """(R,) how far a spoilt row stands from where the clean one was, as the nominal robot sees it, m."""
    joints = [f"q{i + 1}_deg" for i in range(6)]
    marker = study.markers.positions[0]
    predicted = [forward(study.robot, np.deg2rad(t.numbers(joints))).point(marker) for t in (table, clean)]
    read = [t.numbers(POSITION) * 1e-3 for t in (table, clean)]
    return np.linalg.norm(predicted[0] - predicted[1], axis=1) + np.linalg.norm(read[0] - read[1], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_one_per_cent_of_spoilt_rows_is_listed_and_does_no_harm(series, seed, tmp_path):
    _, table, study, clean = series
    rng = np.random.default_rng([seed, len(table.rows)])
    spoilt = Table(table.header, [list(row) for row in table.rows])
    done = spoil(spoilt, rng, round(0.01 * len(table.rows)))
    assert set(done.values()) >= {"swapped", "shifted"}
    result = identify(study, load_measurements(spoilt.write(tmp_path / "measurements.csv"), study))
    assert len(result.residuals) == len(table.rows)

    moved = moved_by(spoilt, table, study)
    must = {row + 2 for row in done if moved[row] > 5e-3}
    listed = {int(result.data.lines[row]) for row in result.worst}
    assert len(must) > 0.8 * len(done)
    assert must <= listed
    unlisted = {int(clean.data.lines[row]) for row in clean.worst}
    assert listed - unlisted <= {row + 2 for row in done}

    good = ~np.isin(result.data.lines, [row + 2 for row in done])
    judged = np.zeros(len(result.data.experiment.visits), dtype=bool)
    judged[np.random.default_rng(seed).permutation(len(judged))[: round(0.4 * len(judged))]] = True
    errors = [heldout_misfit(study, r.fit, "absolute", judged, good).rms for r in (clean, result)]
    assert errors[1] == pytest.approx(errors[0], rel=0.03)
    assert result.heldout.misfit.rms == pytest.approx(clean.heldout.misfit.rms, rel=0.1)


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    table, study = table_of("a"), study_of("a")
    return diagnose(study, load_measurements(table.write(tmp_path_factory.mktemp("diagnosed") / "a.csv"), study))


def test_errors_of_the_gears_are_found_to_dominate_what_geometry_leaves(diagnosed):
    names = [cause.hypothesis.entry for cause in diagnosed.causes]
    assert set(names[:3]) == {f"transmission_error@j{joint}" for joint in (1, 2, 3)}
    assert {f"transmission_error@j{joint}" for joint in (4, 5)} <= set(names)
    assert diagnosed.verdict == "cause_found"
    assert not diagnosed.faults


def test_the_curves_of_the_gears_predict_heldout_poses_five_times_better(diagnosed):
    gain = diagnosed.gain
    assert gain.before * 1e3 == pytest.approx(0.44, abs=0.02)
    assert gain.after * 1e3 <= 0.095
    assert gain.significant


def test_the_gears_found_on_one_series_predict_another_a_year_later(diagnosed, tmp_path):
    other = study_of("d")
    data = load_measurements(table_of("d").write(tmp_path / "d.csv"), other)
    covered = take_rows(data, np.flatnonzero(near(data, diagnosed.data)))
    found = diagnosed.extended_study
    own = diagnosed.identification.parameters
    errors = []
    for effects in (("geometry",), found.effects):
        study = replace(other, effects=effects, options=found.options)
        known = model_of(study, nominal={})
        model = model_of(study, nominal={name: value for name, value in own.items() if name in known.names})
        placed = fit(model, covered, study.noise, start(model, covered), fitted=model.nuisance)
        errors.append(1e3 * np.sqrt((placed.residual**2).sum(axis=1).mean()))
    assert len(covered.positions) > 100
    assert errors[1] <= 0.17
    assert errors[1] < 0.35 * errors[0]


def near(data, learnt):
    """(R,) True where ten or more learnt poses lie within 2 deg of every joint angle but the last, by joint."""
    inside = np.ones(len(data.positions), dtype=bool)
    for joint in range(5):
        angles = np.sort(learnt.experiment.q[:, joint])
        q = data.experiment.q[data.experiment.shot_pose[data.experiment.row_shot], joint]
        ends = np.searchsorted(angles, q + np.deg2rad([[2.0], [-2.0]]))
        inside &= ends[0] - ends[1] >= 10
    return inside
