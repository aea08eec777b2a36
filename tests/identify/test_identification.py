"""Is the identifier honest: coverage, chi-square, reference by rule, invariances, bad rows, what cannot be told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from identify.arrays import rotation_of
from identify.errors import InputError, NotIdentifiable
from identify.identifiability import why_not
from identify.identification import identify
from identify.loads import Markers
from identify.model import model_of
from identify.robot_files import load_robot
from identify.tables import load_measurements, measurements_csv
from tests.identify.spoiling import POSITION, Table, spoil
from tests.identify.studies import (
    COMPLIANCE,
    EXACT,
    LIGHT,
    NOISE,
    PLATE,
    SOFT,
    UNLOADED,
    WEIGHT,
    experiment_of,
    geometry_errors,
    kr270,
    kr270_study,
    measured,
    moved_markers,
    placement_of,
    poses,
    readings,
    study_of,
    ur10_study,
    values_of,
)

GEOMETRY = ("joint_compliance", "geometry")
SINGLE = Markers(("M1",), PLATE.positions[:1], np.zeros(1, dtype=bool))


# ---- intervals


class Draws:
    """Repeated experiments: estimates, standard deviations and p values of the parameters asked for."""

    def __init__(self, study, rng, *, count, visits, noise=None, vary=None):
        experiment = experiment_of(study, poses(study, visits, rng))
        placement = placement_of(rng) if study.frame_free else np.eye(4)
        self.values, self.std, self.inside, self.p_value, self.kinds, self.references = [], [], [], [], set(), set()
        for _ in range(count):
            truth = study if vary is None else vary(study, rng)
            result = identify(study, readings(truth, experiment, COMPLIANCE, rng, noise=noise, placement=placement))
            index = [result.model.names.index(name) for name in result.parameters]
            self.truth = np.array([COMPLIANCE[name] for name in result.parameters])
            std = np.sqrt(np.diag(result.covariance)[index])
            self.values.append(result.values[index])
            self.std.append(std)
            self.inside.append(np.abs(result.values[index] - self.truth) < result.quantile * std)
            self.p_value.append(result.lack_of_fit.p_value)
            self.kinds.add(result.covariance_kind)
            self.references.add(result.reference)
        self.values, self.std = np.array(self.values), np.array(self.std)

    @property
    def coverage(self):
        return float(np.mean(self.inside))

    @property
    def spread(self):
        """Empirical over predicted standard deviation of each parameter."""
        return self.values.std(axis=0, ddof=1) / np.sqrt((self.std**2).mean(axis=0))

    @property
    def bias(self):
        """Mean error in standard errors of the mean."""
        error = self.values.std(axis=0, ddof=1) / np.sqrt(len(self.values))
        return (self.values.mean(axis=0) - self.truth) / error


@pytest.mark.parametrize("masses", [True, False], ids=["absolute", "differences"])
def test_intervals_cover_and_chi_square_is_uniform_when_the_noise_is_as_stated(masses):
    known = {} if masses else {"frame_free": False, "markers_fitted": False}  # what differences do not look at
    draws = Draws(kr270_study(masses=masses, **known), np.random.default_rng(1), count=400, visits=6)
    assert draws.references == {"absolute" if masses else "differences"}
    assert 0.93 < draws.coverage < 0.97
    assert stats.kstest(draws.p_value, "uniform").pvalue > 0.01
    sampling = 1 / np.sqrt(2 * 400)
    assert (np.abs(draws.spread - 1) < 4 * sampling).all()
    assert (np.abs(draws.bias) < 4).all()


def test_load_uncertainty_widens_the_intervals_as_much_as_it_moves_the_estimates():
    sure, unsure = WEIGHT, replace(WEIGHT, mass_std=8.0, attach_std=15e-3)

    def vary(study, rng):
        load = study.loads[1]
        moved = replace(load, mass=load.mass + 8 * rng.normal(), attach=load.attach + 15e-3 * rng.normal(size=3))
        return replace(study, loads=(UNLOADED, moved))

    rng = np.random.default_rng(2)
    draws = Draws(kr270_study(loads=(UNLOADED, unsure)), rng, count=150, visits=6, vary=vary)
    assert 0.92 < draws.coverage < 0.985
    assert (np.abs(draws.spread - 1) < 4 / np.sqrt(2 * 150)).all()
    assert stats.kstest(draws.p_value, "uniform").pvalue > 0.01
    assert draws.references == {"absolute"}
    blind = Draws(kr270_study(loads=(UNLOADED, sure), reference="absolute"), rng, count=40, visits=6, vary=vary)
    assert blind.coverage < 0.8


@pytest.mark.parametrize("factor", [1 / 3, 3.0])
def test_pose_clustered_intervals_cover_when_the_stated_noise_is_three_times_wrong(factor):
    stated = replace(
        NOISE,
        reading=NOISE.reading * factor,
        pose_jitter=NOISE.pose_jitter * factor,
        reading_jitter=NOISE.reading_jitter * factor,
    )
    draws = Draws(kr270_study(noise=stated), np.random.default_rng(3), count=60, visits=9, noise=NOISE)
    assert draws.kinds == {"pose-clustered" if factor < 1 else "stated noise"}
    assert draws.coverage >= 0.9


def test_simulated_jitter_that_is_not_stated_spoils_the_coverage():
    """The control: with readings taken as independent, chi-square is far from uniform and the intervals too short."""
    blind = replace(NOISE, pose_jitter=0.0)
    study = kr270_study(noise=blind, reference="absolute")
    draws = Draws(study, np.random.default_rng(4), count=60, visits=8, noise=NOISE)
    assert stats.kstest(draws.p_value, "uniform").pvalue < 1e-3
    assert draws.coverage < 0.93


# ---- reference


def real_arm(study, rng, visits=12):
    """Readings of an arm with masses, 0.5 mrad and 0.3 mm of geometry errors and displaced markers."""
    truth = replace(study, robot=kr270(), effects=GEOMETRY)
    values = {**COMPLIANCE, **geometry_errors(truth.robot, rng), **moved_markers(truth, rng, 0.5e-3)}
    return readings(truth, experiment_of(study, poses(study, visits, rng)), values, rng)


def deviations(result):
    index = [result.model.names.index(name) for name in result.parameters]
    truth = np.array([COMPLIANCE[name] for name in result.parameters])
    return (result.values[index] - truth) / np.sqrt(np.diag(result.covariance)[index])


@pytest.mark.parametrize("masses", [True, False])
def test_auto_takes_differences_where_geometry_or_masses_are_missing(masses):
    worst = 0.0
    for seed in range(6):
        study = kr270_study(masses=masses)
        result = identify(study, real_arm(study, np.random.default_rng(seed)))
        assert result.reference == "differences"
        assert any("only changes between loads" in note for note in result.notes)
        worst = max(worst, np.abs(deviations(result)).max())
    assert worst < 4


def test_auto_stays_absolute_on_a_clean_arm():
    for seed in range(6):
        study = kr270_study()
        result = identify(study, measured(study, np.random.default_rng(seed)))
        assert (result.reference, result.notes) == ("absolute", ())


def test_forced_absolute_readings_of_a_real_arm_are_wrong_beyond_what_differences_allow():
    """The control of `auto`: several per cent of compliance error, where differences stay ten times closer."""
    errors = {"absolute": [], "differences": []}
    for seed in range(6):
        for reference, found in errors.items():
            study = kr270_study(reference=reference)
            result = identify(study, real_arm(study, np.random.default_rng(seed)))
            assert result.reference == reference
            assert (result.covariance_kind == "pose-clustered") == (reference == "absolute")
            found.append([result.parameters[name] / COMPLIANCE[name] - 1 for name in result.parameters])
    absolute, differences = (np.sqrt(np.mean(np.square(errors[key]))) for key in errors)
    assert absolute > 0.05
    assert absolute > 5 * differences


def test_forgotten_link_masses_ruin_forced_absolute_readings():
    study = kr270_study(masses=False, reference="absolute")
    rng = np.random.default_rng(1)
    truth = replace(study, robot=kr270())
    result = identify(study, readings(truth, experiment_of(study, poses(study, 12, rng)), COMPLIANCE, rng))
    assert any("self-weight is left out" in note for note in result.notes)
    assert max(abs(result.parameters[name] / COMPLIANCE[name] - 1) for name in result.parameters) > 0.03


def test_unloaded_readings_with_unknown_masses_leave_self_weight_out_and_say_so():
    rng = np.random.default_rng(5)
    study = kr270_study(masses=False, loads=(UNLOADED,), effects=GEOMETRY)
    errors = {"geometry.j3.a": 0.6, "geometry.j4.alpha": -0.7}
    result = identify(study, measured(study, rng, count=40, values=errors))
    assert result.reference == "absolute"
    assert result.notes[0] == "link masses are unknown: self-weight is left out"
    assert not any(name.startswith("joint_compliance") for name in result.parameters)
    for name, value in errors.items():
        index = result.model.names.index(name)
        assert abs(result.values[index] - value) < 4 * np.sqrt(result.covariance[index, index])


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_unloaded_readings_with_known_masses_show_compliances_through_self_weight(tilt):
    rng = np.random.default_rng(6)
    robot = load_robot("ur10", mount=(tilt, 0.0, 0.0))
    study = study_of(robot, loads=(UNLOADED,), noise=replace(NOISE, reading=1e-6, pose_jitter=0.0, reading_jitter=0.0))
    result = identify(study, measured(study, rng, count=30, values=SOFT))
    assert ("joint_compliance.j1" in result.parameters) == (tilt > 0)
    for name, value in result.parameters.items():
        index = result.model.names.index(name)
        assert abs(value - SOFT[name]) < 4 * np.sqrt(result.covariance[index, index])


def test_geometry_in_the_model_keeps_the_reference_absolute_even_if_the_fit_is_rejected():
    rng = np.random.default_rng(7)
    study = ur10_study(effects=GEOMETRY)
    values = {**SOFT, **geometry_errors(study.robot, rng)}
    result = identify(study, measured(study, rng, count=30, values=values, noise=replace(study.noise, reading=0.2e-3)))
    assert result.reference == "absolute"
    assert result.covariance_kind == "pose-clustered"


# ---- what cannot be identified


def reasons(result):
    return {result.model.names[d.column]: why_not(result.model, d) for d in result.fit.identifiability.dropped}


def test_vertical_loads_leave_joint_one_out_and_say_why():
    study = kr270_study()
    result = identify(study, measured(study, np.random.default_rng(8)))
    assert reasons(result) == {
        "joint_compliance.j1": "vertical loads put no torque on joint 1, whose axis is vertical in every pose"
    }
    assert "joint_compliance.j1" not in result.parameters


def test_errors_of_the_first_joint_frame_are_told_to_be_those_of_the_measurement_frame():
    rng = np.random.default_rng(9)
    study = ur10_study(effects=("geometry",), loads=(UNLOADED,))
    result = identify(study, measured(study, rng, count=30, values={"geometry.j3.a": 0.4}))
    said = reasons(result)
    for ours, frame in (("x", "x"), ("y", "y"), ("d", "z"), ("rx", "rx"), ("ry", "ry"), ("offset", "rz")):
        assert f"frame.{frame}" in said[f"geometry.j1.{ours}"]
    assert "marker." in said["geometry.j6.d"]
    assert "geometry.j3.a" in result.parameters


def test_joints_that_never_turned_are_held_and_named():
    """With joint 6 always at the same angle, its zero offset and what lies before it cannot be told apart."""
    rng = np.random.default_rng(10)
    study = ur10_study(effects=("geometry",), loads=(UNLOADED,))
    q = poses(study, 40, rng)
    q[:, 4:] = [0.7, 0.3]
    result = identify(study, readings(study, experiment_of(study, q), {}, rng))
    named = reasons(result)
    assert len(named) > len(reasons(identify(study, measured(study, rng, count=40, values={}))))
    assert all(named.values())
    assert result.fit.identifiability.rank + len(named) == len(result.model.parameters)


def test_no_load_at_all_is_not_identifiable_and_too_few_rows_are_refused():
    rng = np.random.default_rng(11)
    unloaded = kr270_study(masses=False, loads=(UNLOADED,))
    with pytest.raises(NotIdentifiable, match="joint_compliance"):
        identify(unloaded, measured(unloaded, rng, values={}))
    study = kr270_study(reference="absolute", markers=SINGLE)
    with pytest.raises(NotIdentifiable, match="measure more") as caught:
        identify(study, measured(study, rng, count=1))
    assert caught.value.exit_code == 3
    data = measured(study, rng)
    none = replace(data.experiment, row_shot=data.experiment.row_shot[:0], row_marker=data.experiment.row_marker[:0])
    with pytest.raises(InputError, match="no rows"):
        identify(study, replace(data, experiment=none, positions=data.positions[:0], lines=data.lines[:0]))


# ---- invariances


def assert_same(one, other, *, rows=True):
    assert one.reference == other.reference
    assert one.parameters.keys() == other.parameters.keys()
    for name, value in one.parameters.items():
        assert other.parameters[name] == pytest.approx(value, rel=1e-9, abs=1e-9)
    index = [[r.model.names.index(name) for name in one.parameters] for r in (one, other)]
    np.testing.assert_allclose(
        other.covariance[np.ix_(index[1], index[1])], one.covariance[np.ix_(index[0], index[0])], rtol=1e-6, atol=1e-12
    )
    assert other.lack_of_fit.chi2 == pytest.approx(one.lack_of_fit.chi2, rel=1e-7)
    assert other.heldout.misfit.rms == pytest.approx(one.heldout.misfit.rms, rel=1e-7)
    assert other.compensated_percent == pytest.approx(one.compensated_percent, abs=1e-7)


@pytest.fixture(params=[True, False], ids=["absolute", "differences"])
def case(request, tmp_path):
    rng = np.random.default_rng(12)
    study = kr270_study(masses=request.param, loads=(UNLOADED, WEIGHT, LIGHT))
    data = measured(study, rng, count=14)
    path = tmp_path / "measurements.csv"
    table = Table.read(measurements_csv(data, study))
    return study, table, path, identify(study, load_measurements(table.write(path), study)), rng


def test_a_turned_and_shifted_measurement_frame_changes_nothing(case):
    study, table, path, expected, rng = case
    data = load_measurements(table.write(path), study)
    turned = data.positions @ rotation_of(rng.normal(size=3)).T + rng.normal(0, 3, 3)
    assert_same(expected, identify(study, replace(data, positions=turned)))


def test_the_order_of_rows_in_the_file_changes_nothing(case):
    study, table, path, expected, rng = case
    order = rng.permutation(len(table.rows))
    mixed = Table(table.header, [table.rows[i] for i in order])
    other = identify(study, load_measurements(mixed.write(path), study))
    assert_same(expected, other)
    np.testing.assert_allclose(other.values, expected.values, atol=1e-9)


def test_names_of_poses_and_markers_change_nothing(case):
    study, table, path, expected, rng = case
    pose, marker = table.header.index("pose"), table.header.index("marker")
    names = sorted({row[pose] for row in table.rows})
    new = dict(zip(names, [f"Z{i}" for i in rng.permutation(len(names))], strict=True))
    markers = {"M1": "c", "M2": "a", "M3": "b"}
    for row in table.rows:
        row[pose], row[marker] = new[row[pose]], markers[row[marker]]
    renamed = replace(study, markers=replace(study.markers, names=tuple(markers.values())))
    assert_same(expected, identify(renamed, load_measurements(table.write(path), renamed)))


def test_the_order_of_markers_and_loads_in_the_study_changes_nothing(case):
    study, table, path, expected, _ = case
    order = [2, 0, 1]
    markers = Markers(tuple(np.array(PLATE.names)[order]), PLATE.positions[order], np.zeros(3, dtype=bool))
    other = replace(study, markers=markers, loads=tuple(reversed(study.loads)))
    assert_same(expected, identify(other, load_measurements(table.write(path), other)))


def test_where_the_nuisance_starts_changes_nothing(case):
    study, table, path, expected, rng = case
    moved = replace(study.markers, positions=study.markers.positions + rng.normal(0, 0.5e-3, (3, 3)))
    other = identify(replace(study, markers=moved), load_measurements(table.write(path), study))
    start = dict(zip(expected.model.names, (expected.model.nominal + 0.3).tolist(), strict=True))
    nominal = {name: value for name, value in start.items() if name.startswith("marker")}
    assert_same(expected, identify(replace(study, nominal=nominal), load_measurements(table.write(path), study)))
    for name, value in expected.parameters.items():  # markers of another study linearise the noise elsewhere
        assert other.parameters[name] == pytest.approx(value, rel=1e-9)


def test_the_same_seed_splits_alike_and_another_seed_otherwise(case):
    study, table, path, expected, _ = case
    data = load_measurements(table.write(path), study)
    assert identify(study, data).heldout.misfit.rms == expected.heldout.misfit.rms
    assert identify(study, data, seed=1).heldout.misfit.rms != expected.heldout.misfit.rms
    assert expected.heldout.visits == 6


# ---- bad rows

SCENES = {
    "absolute": ({}, False, 30),
    "three loads": ({"masses": False, "loads": (UNLOADED, WEIGHT, LIGHT)}, False, 25),
    "two loads": ({"masses": False}, False, 30),
    "unmodelled geometry": ({}, True, 30),
    "one marker": ({"masses": False, "markers": SINGLE}, False, 80),
    "geometry modelled": ({"effects": GEOMETRY}, True, 40),
}


def spoilt_pair(scene, seed, path, share=0.015):
    """Results of clean and of spoilt readings, and the lines that were spoilt."""
    changes, real, visits = SCENES[scene]
    rng = np.random.default_rng(seed)
    study = kr270_study(**changes)
    truth = replace(study, robot=kr270(), effects=GEOMETRY if real else ("joint_compliance",))
    values = {**COMPLIANCE, **moved_markers(study, rng, 0.5e-3), **(geometry_errors(truth.robot, rng) if real else {})}
    data = readings(truth, experiment_of(study, poses(study, visits, rng)), values, rng)
    table = Table.read(measurements_csv(data, study))
    clean = identify(study, load_measurements(table.write(path), study))
    done = spoil(table, rng, max(4, round(share * len(table.rows))))
    bad = load_measurements(table.write(path), study)
    return clean, identify(study, bad), {row + 2 for row in done}


@pytest.mark.parametrize("scene", SCENES)
def test_spoilt_rows_are_listed_by_line_and_hardly_move_the_parameters(scene, tmp_path):
    for seed in range(3):
        clean, spoilt, lines = spoilt_pair(scene, seed, tmp_path / "measurements.csv")
        assert spoilt.reference == clean.reference
        assert spoilt.covariance_kind == clean.covariance_kind == "stated noise"
        assert {int(spoilt.data.lines[row]) for row in spoilt.worst} == lines
        assert not len(clean.worst)
        assert len(spoilt.residuals) == len(clean.residuals)  # every row is still there
        for name, value in clean.parameters.items():
            index = clean.model.names.index(name)
            assert abs(spoilt.parameters[name] - value) < np.sqrt(clean.covariance[index, index])
        assert spoilt.compensated_percent == pytest.approx(clean.compensated_percent, abs=0.3)
        assert f"{len(lines)} rows do not fit" in spoilt.notes[-1]


def test_gross_typing_errors_are_listed_and_do_no_harm(tmp_path):
    """Metres away: a lost digit, a wrong sign, a reading in m."""
    rng = np.random.default_rng(20)
    study = kr270_study()
    path = tmp_path / "measurements.csv"
    table = Table.read(measurements_csv(measured(study, rng, count=20), study))
    clean = identify(study, load_measurements(table.write(path), study))
    columns = [table.header.index(name) for name in POSITION]
    for row, factor in ((10, 0.1), (47, -1.0), (83, 0.001)):
        for column in columns:
            table.rows[row][column] = repr(float(table.rows[row][column]) * factor)
    result = identify(study, load_measurements(table.write(path), study))
    assert {int(result.data.lines[row]) for row in result.worst} == {12, 49, 85}
    assert result.reference == clean.reference
    assert np.abs(deviations(result) - deviations(clean)).max() < 1


def test_bad_rows_in_differences_are_told_apart_from_the_good_row_they_are_compared_with(tmp_path):
    """Two rows, one of them wrong: changes alone cannot say which."""
    rng = np.random.default_rng(21)
    study = kr270_study(masses=False, markers=SINGLE)
    data = measured(study, rng, count=40)
    for row in (8, 9):
        positions = data.positions.copy()
        positions[row] += [0.004, -0.003, 0.003]
        result = identify(study, replace(data, positions=positions))
        assert result.worst.tolist() == [row]


def test_nominal_starting_values_are_no_prior():
    rng = np.random.default_rng(22)
    study = kr270_study()
    data = measured(study, rng)
    far = replace(study, nominal={name: 10.0 for name in COMPLIANCE})
    one, other = identify(study, data), identify(far, data)
    for name, value in one.parameters.items():
        assert other.parameters[name] == pytest.approx(value, rel=1e-9)
    model = model_of(far)
    assert values_of(model, {})[model.names.index("joint_compliance.j1")] == 10.0
    assert other.values[model.names.index("joint_compliance.j1")] == 10.0  # held at its nominal value


def test_exact_readings_need_no_special_case():
    study = kr270_study()
    result = identify(study, measured(study, np.random.default_rng(23), noise=EXACT))
    assert result.compensated_percent == pytest.approx(100.0, abs=1e-6)
    assert result.lack_of_fit.p_value == pytest.approx(1.0)
    assert not len(result.worst)
