"""Instruments that move, step or scale, and reflectors that shift: rigid motions of readings, found again."""

import json
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from doe.cli import run
from doe.observations import identifiable, observer, target_rows
from identify.arrays import rotation_of
from identify.effects import bind_effects
from identify.errors import InputError
from identify.identification import identify
from identify.model import model_of
from identify.response import respond
from identify.robot_files import load_robot
from identify.study import TestPose
from tests.identify.studies import (
    COMPLIANCE,
    experiment_of,
    kr270_study,
    poses,
    readings,
    ur10_study,
    values_of,
)
from tests.identify.test_effects import ON_BOTH, differences

ALL = ("tracker_drift", "tracker_step", "tracker_scale", "marker_seating")
OPTIONS = {"tracker_step": {"time_s": 1.7e9 + 2000.0}}
MOVING = {"x": 0.2, "y": -0.1, "z": 0.15, "rx": 0.05, "ry": -0.08, "rz": 0.1}


def timed(experiment, *, step=40.0):
    """Rows read one after the other, from some day on."""
    return replace(experiment, time=1.7e9 + step * np.arange(len(experiment.row_shot)))


def one(name, values, *, markers=ON_BOTH, time=True, **options):
    """Displacement of all rows by one effect of a heavy arm that is rigid, and the scene."""
    study = kr270_study(effects=(name,), markers=markers, frame_free=False, options={name: options})
    experiment = experiment_of(study, poses(study, 6, np.random.default_rng(3)))
    model = model_of(study)
    found = respond(model, timed(experiment) if time else experiment, values_of(model, values), derivative=False)
    return found.deflection, found.scene


@pytest.mark.parametrize("equilibrium", ["linear", "loaded"])
def test_derivatives_are_those_of_the_response(equilibrium):
    rng = np.random.default_rng(4)
    study = kr270_study(
        effects=("joint_compliance", *ALL), markers=ON_BOTH, options=OPTIONS, equilibrium=equilibrium, frame_free=False
    )
    model = model_of(study)
    given = {p.name: p.typical * rng.normal() for p in model.parameters[model.effect_slices[1].start :]}
    values = values_of(model, {**COMPLIANCE, **given, "marker.M1.x": 0.4})
    experiment = timed(experiment_of(study, poses(study, 12, rng)))
    analytic, numeric = respond(model, experiment, values).derivative, differences(model, experiment, values)
    scale = np.abs(numeric).max(axis=(0, 1))
    where = slice(model.effect_slices[1].start, None)
    assert (scale[where] > 0).all()
    assert (np.abs(analytic - numeric).max(axis=(0, 1)) <= 1e-6 * scale + 1e-15).all()


def moved_rigidly(point, size):
    """Points after a small rigid motion of ``MOVING`` times size (R,)."""
    shift, turn = (1e-3 * np.array([MOVING[f"{kind}{axis}"] for axis in "xyz"]) for kind in ("", "r"))
    return np.array([rotation_of(s * turn) @ p + s * shift for p, s in zip(point, size, strict=True)])


def test_a_drift_is_a_rigid_motion_of_the_readings_that_grows_with_time():
    moved, scene = one("tracker_drift", {f"tracker_drift.{k}": v for k, v in MOVING.items()})
    hours = (scene.experiment.time - 1.7e9) / 3600
    np.testing.assert_allclose(moved, moved_rigidly(scene.point, hours) - scene.point, atol=2e-8)
    fixed = ON_BOTH.on_base[scene.experiment.row_marker]
    assert np.linalg.norm(moved[fixed], axis=1).max() > 5e-5


def test_a_step_is_a_rigid_motion_of_the_later_readings():
    values = {f"tracker_step.{k}": v for k, v in MOVING.items()}
    moved, scene = one("tracker_step", values, time_s=1.7e9 + 600.0)
    late = scene.experiment.time > 1.7e9 + 600.0
    assert 5 < late.sum() < len(late) - 5
    np.testing.assert_allclose(moved, moved_rigidly(scene.point, late) - scene.point, atol=1e-7)
    assert not moved[~late].any()


def test_a_scale_stretches_distances_between_all_readings():
    moved, scene = one("tracker_scale", {"tracker_scale.all": 30.0}, time=False)
    read = scene.point + moved
    lengths = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (scene.point, read)]
    np.testing.assert_allclose(lengths[1], (1 + 30e-6) * lengths[0], atol=1e-12)


def test_a_reflector_shifts_along_the_flange_in_loaded_readings_only():
    values = {"marker_seating.M2.x": 0.04, "marker_seating.M2.z": -0.03}
    moved, scene = one("marker_seating", values, time=False)
    e = scene.experiment
    concerned = (e.row_marker == 1) & ~e.shot_unloaded[e.row_shot]
    shift = scene.frames.flange_rotation[scene.row_pose] @ np.array([0.04e-3, 0.0, -0.03e-3])
    np.testing.assert_allclose(moved, shift * concerned[:, None], atol=1e-18)
    assert 0 < concerned.sum() < len(concerned) / 2


@pytest.mark.parametrize(
    ("effect", "sizes"),
    [
        ("tracker_drift", {"x": 0.1, "z": -0.2, "rz": 0.05}),
        ("tracker_step", {"y": 0.15, "rx": 0.08}),
        ("tracker_scale", {"all": 40.0}),
        ("marker_seating", {"M1.x": 0.05, "M2.z": -0.08}),
    ],
)
def test_simulated_faults_are_found_within_their_intervals(effect, sizes):
    rng = np.random.default_rng(8)
    study = kr270_study(effects=("joint_compliance", effect), options=OPTIONS, reference="absolute", markers=ON_BOTH)
    given = {**COMPLIANCE, **{f"{effect}.{place}": size for place, size in sizes.items()}}
    data = readings(study, timed(experiment_of(study, poses(study, 40, rng)), step=25.0), given, rng)
    found = identify(study, data)
    asked = [i for i in found.kept if not found.model.parameters[i].nuisance]
    z = (found.values - values_of(found.model, given))[asked] / np.sqrt(np.diag(found.covariance)[asked])
    assert np.abs(z).max() < 4.0
    assert found.lack_of_fit.p_value > 1e-3
    for place, size in sizes.items():
        index = found.model.names.index(f"{effect}.{place}")
        assert abs(size) > 4 * np.sqrt(found.covariance[index, index])
    assert found.heldout.misfit.rms < 0.1e-3  # parts of the data count time from the same moment


def test_changes_between_loads_show_the_seating_and_nothing_else():
    rng = np.random.default_rng(2)
    study = kr270_study(effects=("joint_compliance", *ALL), options=OPTIONS, reference="differences", markers=ON_BOTH)
    experiment = timed(experiment_of(study, poses(study, 30, rng)))
    visit = experiment.row_visit
    experiment = replace(experiment, time=1.7e9 + 300.0 * visit)  # all readings of a visit at once
    data = readings(study, experiment, {**COMPLIANCE, "marker_seating.M1.y": 0.1}, rng)
    found = identify(study, data)
    shown = {name.partition(".")[0] for name in found.parameters}
    assert shown == {"joint_compliance", "marker_seating"}
    effects = {effect.name: effect for effect in found.model.effects}
    assert [effects[name].yields for name in ALL] == [False, False, False, True]
    assert all(effects[name].of_reading for name in ALL)
    index = found.model.names.index("marker_seating.M1.y")
    assert abs(found.values[index] - 0.1) < 4 * np.sqrt(found.covariance[index, index])


def test_without_times_drift_and_step_are_not_there_and_this_is_said():
    rng = np.random.default_rng(9)
    study = ur10_study(effects=("joint_compliance", "tracker_drift", "tracker_step"), options=OPTIONS)
    data = readings(study, experiment_of(study, poses(study, 12, rng)), {}, rng)
    found = identify(study, data)
    held = {found.model.names[d.column] for d in found.fit.identifiability.dropped}
    axes = ("x", "y", "z", "rx", "ry", "rz")
    assert {f"{name}.{axis}" for name in ("tracker_drift", "tracker_step") for axis in axes} <= held
    drift, step = found.model.effects[1:]
    assert "the data have no column time_s" in drift.why_zero(0)
    assert "no reading is later than 1.7e+09 s" in step.why_zero(3)


def test_a_part_of_the_readings_keeps_the_clock_of_the_whole():
    study = kr270_study(effects=("tracker_drift",), frame_free=False)
    experiment = timed(experiment_of(study, poses(study, 6, np.random.default_rng(3))))
    assert experiment.elapsed.min() == 0.0
    late = np.flatnonzero(experiment.time > 1.7e9 + 500)
    part = replace(
        experiment,
        row_shot=experiment.row_shot[late],
        row_marker=experiment.row_marker[late],
        time=experiment.time[late],
    )
    np.testing.assert_array_equal(part.elapsed, experiment.elapsed[late])


def test_what_is_wrong_with_readings_does_not_spoil_the_accuracy_of_the_arm():
    """Test poses ask for the arm; a plan may hold effects of the instrument all the same."""
    nowhere = np.zeros(3)
    pose = TestPose(np.deg2rad([0, -60, 90, 0, 45, 0]), np.array([0, 0, -1500.0, 0, 0, 0]), False, nowhere, nowhere)
    study = kr270_study(effects=("joint_compliance", *ALL), options=OPTIONS, test_poses=(pose,), frame_free=False)
    watching = observer(study)
    blocks = watching.blocks(poses(study, 20, np.random.default_rng(1)), np.tile([0, 1], (20, 1)))
    known = identifiable(blocks)
    kept = [watching.model.names[i] for i in known.kept]
    rows = dict(zip(kept, np.abs(target_rows(watching, known)).max(axis=(0, 1)), strict=True))
    assert "tracker_scale.all" in rows
    assert "tracker_drift.x" not in rows
    assert all((size > 0) == name.startswith("joint") for name, size in rows.items() if name != "joint_compliance.j1")


@pytest.mark.parametrize(
    ("effect", "options", "words"),
    [
        ("tracker_step", {}, r"\[model.tracker_step\] time_s is missing; .* time_s = 5400.0"),
        ("tracker_step", {"time_s": "noon"}, "time_s = 'noon': a finite number expected"),
        ("tracker_step", {"time_s": 1.0, "x": 2}, "x: unknown key; allowed: time_s"),
        ("tracker_drift", {"time_s": 1.0}, "time_s: unknown key; this effect has no options"),
        ("tracker_drift@M1", {}, "M1: no such place; allowed: x, y, z, rx, ry, rz"),
        ("tracker_scale@x", {}, "x: no such place; allowed: all"),
        ("tracker_scale", {"ppm": 1}, "unknown key"),
        ("marker_seating@M9", {}, "M9: no such place; allowed: M1, M2"),
        ("marker_seating@F1", {}, "F1: no such place; allowed: M1, M2"),
        ("marker_seating", {"axis": "x"}, "unknown key"),
    ],
)
def test_wrong_places_and_options_are_refused_in_words(effect, options, words):
    name = effect.partition("@")[0]
    with pytest.raises(InputError, match=words) as caught:
        bind_effects((effect,), load_robot("kr270_r2700"), options={name: options}, markers=ON_BOTH)
    assert caught.value.exit_code == 2


def test_seating_needs_markers():
    with pytest.raises(InputError, match="no markers are known"):
        bind_effects(("marker_seating",), load_robot("kr270_r2700"))
    assert len(model_of(kr270_study(effects=("marker_seating",))).parameters) == 6 + 9 + 9


# --- files


STUDY = {
    "robot": {"model": "kr270_r2700.toml"},
    "markers": {"M1": [300.0, 120.0, -80.0], "M2": [20.0, 90.0, 220.0]},
    "fixed_markers": {"F1": [1100.0, -600.0, 100.0]},
    "loads": [{"id": "L0", "mass_kg": 0.0}, {"id": "L1", "mass_kg": 200.0, "attach_mm": [200.0, 50.0, -150.0]}],
    "noise": {"reading_mm": 0.02},
    "model": {"effects": ["joint_compliance", "tracker_drift"], "reference": "absolute"},
}
TRUTH = {
    "truth": {
        "effects": ["joint_compliance", "tracker_drift", "tracker_step", "approach_hysteresis"],
        "tracker_step": {"time_s": 1e9},
        "values": {"joint_compliance.j2": 0.3, "tracker_drift.z": 0.4, "tracker_drift.rx": 0.1},
    }
}


def plan_text(first, poses, seed):
    """A plan with times (s, two minutes a row) and approaches."""
    rng = np.random.default_rng(seed)
    lines = ["pose,load," + ",".join(f"q{i}_deg" for i in range(1, 7)) + ",time_s," +
             ",".join(f"approach{i}" for i in range(1, 7))]  # fmt: skip
    for i in range(poses):
        q = rng.uniform([-100, -110, 20, -150, -100, -150], [100, -40, 120, 150, 100, 150])
        signs = rng.integers(-1, 2, 6)
        for k, load in enumerate(("L0", "L1")):
            cells = [f"P{i:03d}", load, *(f"{v:.4f}" for v in q), f"{first + 120 * (2 * i + k)}", *map(str, signs)]
            lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def test_predictions_count_drift_from_the_first_reading_of_the_fit(tmp_path):
    (tmp_path / "study.toml").write_text(tomli_w.dumps(STUDY))
    (tmp_path / "truth.toml").write_text(tomli_w.dumps(TRUTH))
    (tmp_path / "plan.csv").write_text(plan_text(5000.0, 40, 1))
    later = plan_text(20000.0, 5, 2)
    (tmp_path / "later.csv").write_text(later)
    path = {name: str(tmp_path / name) for name in ("study.toml", "truth.toml", "plan.csv", "later.csv")}
    simulate = ["simulate", path["study.toml"], path["plan.csv"], "--truth", path["truth.toml"]]
    assert run([*simulate, "--out", str(tmp_path / "sim"), "--quiet"]) == 0
    measured = (tmp_path / "sim" / "measurements.csv").read_text().splitlines()
    assert {"time_s", "approach1", "approach6"} <= set(measured[0].split(","))
    command = ["identify", path["study.toml"], str(tmp_path / "sim" / "measurements.csv")]
    assert run([*command, "--out", str(tmp_path / "id"), "--quiet"]) == 0
    content = json.loads((tmp_path / "id" / "identify.json").read_text())
    assert content["time_start_s"] == 5000.0
    found = {p["name"]: p["value"] for p in content["parameters"]}
    assert found["tracker_drift.z"] == pytest.approx(0.4, abs=0.02)

    result = str(tmp_path / "id" / "identify.json")
    timeless = "\n".join(",".join(line.split(",")[:8]) for line in later.splitlines()) + "\n"
    (tmp_path / "timeless.csv").write_text(timeless)
    told = {}
    for name in ("later", "timeless"):
        command = ["predict", path["study.toml"], result, str(tmp_path / f"{name}.csv")]
        assert run([*command, "--out", str(tmp_path / name), "--quiet"]) == 0
        told[name] = np.loadtxt(tmp_path / name / "predicted.csv", delimiter=",", skiprows=1, usecols=(3, 4, 5))
    turn = np.array(content["frames"]["base_T_measurement"])
    drift = (told["later"] - told["timeless"]) @ turn[:3, :3].T
    hours = (15000.0 + 120 * np.arange(10)) / 3600
    fixed = drift[2::3]  # F1, at 1100, -600, 100 mm
    rate = {k: found.get(f"tracker_drift.{k}", 0.0) for k in ("x", "y", "z", "rx", "ry", "rz")}
    turned = np.cross([rate["rx"], rate["ry"], rate["rz"]], [1.1, -0.6, 0.1])
    expected = hours[:, None] * (np.array([rate["x"], rate["y"], rate["z"]]) + turned)
    np.testing.assert_allclose(fixed, expected, atol=0.01)
    assert np.abs(expected).max() > 1.0
