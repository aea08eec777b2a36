"""Whole diagnoses: the four verdicts, what is refused and noted, and what must not change a verdict."""

import csv
import io
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from doe.cli import run
from doe.diagnose_command import run_diagnose
from identify.config import load_study
from identify.diagnosis import diagnose
from identify.diagnosis import verdict as module
from identify.diagnosis.content import diagnosis_json, diagnosis_lines
from identify.effects import REGISTRY
from identify.errors import NotIdentifiable
from identify.lack_of_fit import LackOfFit
from identify.tables import load_measurements, measurements_csv
from tests.doe.study_files import KR270, study_file
from tests.identify.diagnosis.cases import (
    NOISE,
    arm,
    conditions,
    entries,
    fit_of,
    read,
    recorded,
    with_wrench,
)  # fmt: skip
from tests.identify.studies import kr270

OFFSET = {"load_com.x": 25.0, "load_com.y": -20.0}
#: Enough rivals to choose from, few enough to be quick.
FEW = frozenset(REGISTRY) - {
    "geometry",
    "load_com",
    "base_compliance",
    "joint_hardening",
    "tracker_drift",
    "load_level",
}


@pytest.fixture(scope="module")
def study():
    return arm()


def shape(found):
    """What must not change: the verdict, causes and what explains the same."""
    return found.verdict, [(c.hypothesis.entry, sorted(entries(c.rivals))) for c in found.causes]


def by_sine(study, data, size=4e-8):
    """The readings with a compliance of joint 3 that goes with sin 3 q3, which no effect describes."""
    experiment, joints = data.experiment, fit_of(study, data).response.scene.joints
    q3 = experiment.q[experiment.shot_pose[experiment.row_shot], 2]
    turn = size * np.sin(3 * q3) * joints.torque[experiment.row_shot, 2]
    return replace(data, positions=data.positions + joints.motion[:, 2] * turn[:, None])


def test_nothing_missing_is_adequate(study):
    found = diagnose(study, read(study, recorded(conditions(study, 20, 1)), 2))
    assert shape(found) == ("adequate", [])
    assert found.gain is None
    assert not found.remainder.present
    assert found.extended_study.effects == study.effects


def test_a_lonely_cause_is_found_with_its_size_and_gain(study):
    found = diagnose(study, read(study, recorded(conditions(study, 25, 1)), 2, OFFSET))
    assert shape(found) == ("cause_found", [("load_com", [])])
    assert not found.remainder.present
    assert found.gain.significant
    position = found.identification.model.names.index("load_com.x")
    spread = np.sqrt(found.identification.covariance[position, position])
    assert abs(found.identification.values[position] - 25.0) < 4 * spread
    assert found.first_lack.p_value < 1e-2 < found.remainder.lack_of_fit.p_value


def test_a_cause_with_a_twin_is_ambiguous(study):
    """A level that is wrong and a scale that is wrong are the same under a single load."""
    found = diagnose(
        study, read(study, conditions(study, 25, 1), 2, {"load_level.L1": 5.0}), without=FEW - {"load_scale"}
    )
    assert found.verdict == "ambiguous"
    told = {e for c in found.causes for e in (c.hypothesis.entry, *entries(c.rivals))}
    assert {"load_level@L1", "load_scale"} <= told


def test_what_no_effect_describes_is_unexplained_and_located(study):
    data = by_sine(study, read(study, conditions(study, 25, 1), 2))
    found = diagnose(study, data, without=FEW)
    assert found.verdict == "unexplained"
    assert found.remainder.present
    assert found.remainder.depends_on == "q3_deg"


@pytest.mark.parametrize(
    ("causes", "rivals", "remains", "removed", "expected"),
    [
        (0, 0, False, 0.0, "adequate"),
        (0, 0, True, 0.0, "unexplained"),
        (1, 0, False, 1.0, "cause_found"),
        (1, 2, False, 1.0, "ambiguous"),
        (1, 0, True, 0.4, "unexplained"),
        (1, 0, True, 0.6, "cause_found"),
        (1, 2, True, 0.6, "ambiguous"),
    ],
)
def test_the_verdict_follows_from_causes_rivals_and_what_remains(study, causes, rivals, remains, removed, expected):
    """``removed`` is the share of the excess chi-square of the first fit that the causes take off."""
    first = LackOfFit(1500.0, 500, 0.0)
    last = LackOfFit(1500.0 - removed * 1000.0, 500, 0.0)
    named = tuple(SimpleNamespace(rivals=(0,) * rivals) for _ in range(causes))
    concluded = SimpleNamespace(
        search=SimpleNamespace(causes=named),
        range_noise=None,
        remainder=SimpleNamespace(present=remains, lack_of_fit=last),
    )
    assert module._verdict(concluded, first, ()) == expected


def test_understated_noise_alone_is_no_cause(study):
    """It contradicts the stated noise, so that flips decide; the size found is about the true one."""
    twice = replace(NOISE, reading=2 * NOISE.reading, pose_jitter=2 * NOISE.pose_jitter)
    found = diagnose(study, read(study, conditions(study, 25, 1), 2, noise=twice))
    assert shape(found) == ("adequate", [])
    assert found.search.gate == "flip"
    assert found.noise.reading == pytest.approx(2.0, rel=0.15)
    assert "flipping" in found.notes[-1]


def test_a_cause_is_found_below_understated_noise(study):
    twice = replace(NOISE, reading=2 * NOISE.reading, pose_jitter=2 * NOISE.pose_jitter)
    hidden = {"geometry.j3.offset": 0.5, "geometry.j3.a": 0.4}
    found = diagnose(study, read(study, conditions(study, 40, 1), 2, hidden, noise=twice), without=FEW)
    assert found.search.gate == "flip"
    assert entries(found.causes) == ["geometry@j3"]


def test_faulty_rows_are_named_beside_a_cause_and_kept_out_of_fit_and_gain(study):
    data = read(study, recorded(conditions(study, 25, 1)), 2, OFFSET)
    positions = data.positions.copy()
    positions[[36, 37]] = positions[[37, 36]]
    found = diagnose(study, replace(data, positions=positions), without=FEW)
    assert shape(found) == ("cause_found", [("load_com", [])])
    assert [(f.where(data.experiment), f.what) for f in found.faults] == [
        ("P007", "swapped markers: M1 and M2 exchanged")
    ]
    assert len(found.clean.positions) == len(data.positions) - 2
    assert found.gain.after < 1.3 * found.gain.noise
    listed = diagnosis_json(found)["causes"]
    assert [cause["name"] for cause in listed] == ["load_com", "data_fault"]
    assert listed[1]["lines"].tolist() == [38, 39]


def test_a_fault_that_shows_once_the_causes_are_known_is_kept_out_as_well(study):
    """0.6 mm is within what a robot without its causes may be off, and far beyond what one with them is."""
    data = read(study, conditions(study, 20, 1), 2)
    positions = data.positions.copy()
    positions[41] += [0.6e-3, 0.0, 0.0]
    found = diagnose(study, replace(data, positions=positions))
    assert [(fault.where(data.experiment), fault.rows.tolist()) for fault in found.faults] == [("P007/M3", [41])]
    assert len(found.clean.positions) == len(positions) - 1
    assert found.verdict == "cause_found"
    assert found.causes == ()


def test_too_few_poses_are_refused_with_how_many_would_do(study):
    data = read(study, conditions(study, 7, 1), 2)
    with pytest.raises(NotIdentifiable, match=r"7 poses allow no diagnosis.*at least 8 poses"):
        diagnose(study, data)
    assert diagnose(study, read(study, conditions(study, 8, 1), 2)).verdict == "adequate"


def test_unknown_masses_leave_changes_between_loads_with_a_note():
    study = arm(masses=False, reference="auto")
    found = diagnose(study, read(study, conditions(study, 20, 1), 2, OFFSET), without=FEW)
    assert found.study.reference == "differences"
    assert entries(found.causes) == ["load_com"]
    assert "link masses are unknown" in found.notes[0]
    assert diagnosis_json(found)["reference"] == "differences"
    known = diagnose(arm(reference="auto"), read(arm(), conditions(arm(), 20, 1), 2), without=FEW)
    assert known.study.reference == "absolute"
    assert not any("masses" in note for note in known.notes)


def test_measured_wrenches_are_used_and_their_bias_is_found(study):
    hidden = {"force_sensor_bias.fx": 60.0, "force_sensor_bias.fz": -40.0}
    data = read(study, with_wrench(conditions(study, 20, 1)), 3, hidden)
    found = diagnose(study, data, without=FEW - {"force_sensor_bias"})
    assert entries(found.causes) == ["force_sensor_bias"]
    for name, size in hidden.items():
        index = found.identification.model.names.index(name)
        spread = np.sqrt(found.identification.covariance[index, index])
        assert abs(found.identification.values[index] - size) < 3.0 * spread
        assert spread < 15.0


# --- what must not change a verdict


@pytest.fixture(scope="module", params=["clean", "load_com", "base_compliance"])
def filed(request, tmp_path_factory):
    """A study file, its measurements with everything recorded, and what is said about them."""
    hidden = {
        "clean": {}, "load_com": OFFSET,
        "base_compliance": {"base_compliance.base.rx": 0.06, "base_compliance.base.ry": 0.05},
    }[request.param]  # fmt: skip
    folder = tmp_path_factory.mktemp("filed")
    path = study_file(folder, KR270, model={"reference": "absolute"})
    study = load_study(path)
    data = read(study, recorded(conditions(study, 20, 1)), 2, hidden)
    text = measurements_csv(data, study)
    (folder / "measurements.csv").write_text(text)
    before = shape(diagnose(study, load_measurements(folder / "measurements.csv", study), without=FEW))
    expected = {"clean": [], "load_com": ["load_com"], "base_compliance": ["base_compliance@base"]}
    assert [entry for entry, _ in before[1]] == expected[request.param]
    return path, text, before


def again(filed, tmp_path, change):
    """The diagnosis after a change of the rows of the table."""
    path, text, _ = filed
    rows = change(list(csv.DictReader(io.StringIO(text))))
    out = io.StringIO()
    writer = csv.DictWriter(out, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (tmp_path / "measurements.csv").write_text(out.getvalue())
    study = load_study(path)
    return diagnose(study, load_measurements(tmp_path / "measurements.csv", study), without=FEW)


def test_the_order_of_rows_changes_nothing(filed, tmp_path):
    rng = np.random.default_rng(4)
    assert shape(again(filed, tmp_path, lambda rows: [rows[k] for k in rng.permutation(len(rows))])) == filed[2]


def test_names_of_poses_change_nothing(filed, tmp_path):
    found = again(filed, tmp_path, lambda rows: [row | {"pose": f"{999 - int(row['pose'][1:])}-x"} for row in rows])
    assert shape(found) == filed[2]


def test_columns_that_mean_nothing_change_nothing(filed, tmp_path, caplog):
    rng = np.random.default_rng(5)
    found = again(filed, tmp_path, lambda rows: [row | {"decoy": f"{rng.normal():.3f}"} for row in rows])
    assert shape(found) == filed[2]
    assert "decoy" in caplog.text


def test_another_frame_of_the_instrument_changes_nothing(filed, tmp_path):
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])

    def turned(rows):
        for row in rows:
            point = turn @ [float(row[f"{axis}_mm"]) for axis in "xyz"] + [500.0, -300.0, 900.0]
            row.update({f"{axis}_mm": repr(value) for axis, value in zip("xyz", point.tolist(), strict=True)})
        return rows

    assert shape(again(filed, tmp_path, turned)) == filed[2]


def test_each_reading_twice_as_a_second_repeat_changes_no_cause(filed, tmp_path):
    """Copies hold no noise of their own: who counts them as readings finds causes on clean data."""
    found = again(filed, tmp_path, lambda rows: rows + [row | {"repeat": "2"} for row in rows])
    assert shape(found) == filed[2]
    assert "180 readings are copies" in found.notes[0]


def test_all_poses_twice_under_other_names_change_nothing(filed, tmp_path):
    found = again(filed, tmp_path, lambda rows: rows + [row | {"pose": f"again-{row['pose']}"} for row in rows])
    assert shape(found) == filed[2]


def test_names_of_markers_change_nothing(filed, tmp_path):
    _, text, before = filed
    names = {"M1": "left.1", "M2": "top", "M3": "zz"}
    renamed = {names[name]: place for name, place in KR270["markers"].items()}
    other = load_study(
        study_file(tmp_path, {**KR270, "markers": renamed}, name="other.toml", model={"reference": "absolute"})
    )
    for old, new in names.items():
        text = text.replace(f",{old},", f",{new},")
    (tmp_path / "measurements.csv").write_text(text)
    assert shape(diagnose(other, load_measurements(tmp_path / "measurements.csv", other), without=FEW)) == before


def test_a_base_that_is_mounted_turned_changes_nothing():
    """About the vertical: what the robot reads in its own frame is the same."""
    study = arm()
    data = read(study, conditions(study, 20, 1), 2, {**OFFSET, "base_compliance.base.rx": 0.06})
    turned = replace(study, robot=kr270(mount=(0.0, 0.0, 0.9)))
    assert not np.allclose(turned.robot.world_R_base, study.robot.world_R_base)
    first, second = (diagnose(each, data, without=FEW) for each in (study, turned))
    assert shape(first) == shape(second)
    assert set(entries(first.causes)) == {"load_com", "base_compliance@base"}
    assert first.remainder.lack_of_fit.chi2 == pytest.approx(second.remainder.lack_of_fit.chi2, rel=1e-6)


def test_the_same_readings_and_seed_give_the_same_bytes_and_lines(filed, tmp_path):
    path, text, _ = filed
    (tmp_path / "measurements.csv").write_text(text)
    made = []
    for name in ("one", "two"):
        command = ["diagnose", str(path), str(tmp_path / "measurements.csv"), "--out", str(tmp_path / name)]
        assert run([*command, *(word for effect in sorted(FEW) for word in ("--without", effect))]) == 0
        made.append({file.name: file.read_bytes() for file in (tmp_path / name).iterdir() if file.suffix != ".toml"})
    assert made[0] == made[1]
    assert "diagnose.json" in made[0]
    content = json.loads(made[0]["diagnose.json"])
    assert diagnosis_lines(content)[0].startswith(f"verdict: {content['verdict']}")


def test_too_few_poses_end_the_command_with_exit_code_3(tmp_path, capsys):
    path = study_file(tmp_path, KR270, model={"reference": "absolute"})
    study = load_study(path)
    data = read(study, conditions(study, 6, 1), 2)
    (tmp_path / "measurements.csv").write_text(measurements_csv(data, study))
    command = ["diagnose", str(path), str(tmp_path / "measurements.csv"), "--out", str(tmp_path / "out")]
    assert run(command) == 3
    shown = capsys.readouterr()
    assert "6 poses allow no diagnosis" in shown.out + shown.err
    assert not (tmp_path / "out").exists()


def test_the_command_says_the_same_as_the_function(filed, tmp_path):
    path, text, before = filed
    (tmp_path / "measurements.csv").write_text(text)
    told = run_diagnose(path, tmp_path / "measurements.csv", tmp_path, seed=0, without=tuple(sorted(FEW)))
    assert told.content["verdict"] == before[0]
    assert [cause["name"] for cause in told.content["causes"]] == [entry.split("@")[0] for entry, _ in before[1]]
