"""The command line from outside: files in, files out, exit codes, and what stands on stdout and stderr."""

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import doe
import identify
from doe.cli import run
from identify.effects import REGISTRY, bind_effects
from identify.loads import LoadCase
from identify.robot_files import load_robot
from tests.doe.study_files import ARM, KR270, merged
from tests.identify.studies import PLATE

ROOT = Path(__file__).parents[1]
COMMANDS = ("plan", "evaluate", "simulate", "identify", "predict")
SMALL = merged(KR270, {"plan": {"candidates": 100, "poses": 12, "refine": False}})
TRUTH = {"truth": {"values": {"joint_compliance.j2": 0.27, "joint_compliance.j3": 0.38, "joint_compliance.j5": 3.1}}}

HEADER = "pose,load,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
PLAN = "".join(
    f"P{i},{load},{10 * i},{-50 - 3 * i},{80 + 2 * i},{15 * i - 40},{50 - 7 * i},{20 * i}\n"
    for i in range(12)
    for load in ("L0", "L1")
)


@pytest.fixture
def files(tmp_path):
    """A folder with a study, a truth and a plan."""
    (tmp_path / "study.toml").write_text(tomli_w.dumps(SMALL))
    (tmp_path / "truth.toml").write_text(tomli_w.dumps(TRUTH))
    (tmp_path / "plan.csv").write_text(f"{HEADER}\n{PLAN}")
    return tmp_path


def process(*arguments, **options):
    """The real command in a process of its own."""
    command = [Path(sys.executable).with_name("elastocal"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, **options)


def call(folder, command, *arguments):
    """Exit code of a command whose inputs and ``--out`` are names in a folder."""
    return run([command, *(str(folder / a) if a.endswith((".toml", ".csv", ".json")) else a for a in arguments)])


def measured(folder):
    """Simulated measurements of the plan."""
    assert (
        call(folder, "simulate", "study.toml", "plan.csv", "--truth", "truth.toml", "--out", str(folder / "sim")) == 0
    )
    return folder / "sim" / "measurements.csv"


def tree(folder):
    """Every file below a folder with the hash of its content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def changed(**changes):
    """A study with some keys changed."""
    return tomli_w.dumps(merged(SMALL, changes))


# --- end to end


def test_all_commands_from_study_to_prediction(files, capsys):
    out = {name: str(files / name) for name in COMMANDS}
    assert call(files, "plan", "study.toml", "--out", out["plan"]) == 0
    assert sorted(path.name for path in (files / "plan").iterdir()) == ["plan.csv", "plan.json"]
    assert call(files, "evaluate", "study.toml", "plan/plan.csv", "--out", out["evaluate"]) == 0
    assert (
        call(files, "simulate", "study.toml", "plan/plan.csv", "--truth", "truth.toml", "--out", out["simulate"]) == 0
    )
    assert call(files, "identify", "study.toml", "simulate/measurements.csv", "--out", out["identify"]) == 0
    last = ["study.toml", "identify/identify.json", "plan/plan.csv", "--out", out["predict"]]
    assert call(files, "predict", *last) == 0
    printed = capsys.readouterr()
    assert printed.out.count("written to") == 5
    assert "Traceback" not in printed.err

    results = {name: json.loads((files / name / f"{name}.json").read_text()) for name in COMMANDS}
    for result in results.values():
        assert result["schema"] == 1
        assert result["provenance"]["seed"] == 0
    study_hash = hashlib.sha256((files / "study.toml").read_bytes()).hexdigest()
    assert results["plan"]["provenance"]["inputs"]["study.toml"] == study_hash
    assert set(results["predict"]["provenance"]["inputs"]) == {
        "study.toml", "kr270_r2700.toml", "identify.json", "plan.csv"
    }  # fmt: skip

    planned, judged = results["plan"], results["evaluate"]
    assert judged["criterion"]["value"] == pytest.approx(planned["criterion"]["value"], rel=1e-9)
    found = {p["name"]: p for p in results["identify"]["parameters"]}
    for name, value in TRUTH["truth"]["values"].items():
        assert abs(found[name]["value"] - value) < 5 * found[name]["std"]
        predicted = planned["std"][planned["parameters"].index(name)]
        assert found[name]["std"] == pytest.approx(predicted, rel=0.05)
    assert [item["name"] for item in results["identify"]["nonidentifiable"]] == ["joint_compliance.j1"]

    rows = (files / "predict" / "predicted.csv").read_text().splitlines()
    assert rows[0] == "pose,load,marker,x_mm,y_mm,z_mm,sx_mm,sy_mm,sz_mm"
    assert len(rows) == 1 + 12 * 2 * 3
    read = np.loadtxt(files / "simulate" / "measurements.csv", delimiter=",", skiprows=1, usecols=(-3, -2, -1))
    told = np.loadtxt(files / "predict" / "predicted.csv", delimiter=",", skiprows=1, usecols=(3, 4, 5))
    assert np.sqrt(np.mean((read - told) ** 2)) < 0.1


def test_a_wrong_hook_is_planned_simulated_and_found(files):
    """A cause that is no spring goes the same way: it is planned by differences, intervals are the planned ones."""
    given = {f"joint_compliance.j{i}": c for i, c in enumerate((0.3, 0.27, 0.38, 2.7, 3.1, 2.2), 1)}
    model = {"effects": ["joint_compliance", "load_com"], "nominal": given}
    planned = {"plan": {"candidates": 100, "poses": 12, "loads": ["L1", "L2"]}, "model": model}
    (files / "study.toml").write_text(tomli_w.dumps(merged(KR270, planned)))
    moved = {"load_com.x": 15.0, "load_com.y": -10.0, "load_com.z": 20.0}
    values = {**given, **moved, "load_scale.all": 2.0}
    truth = {"truth": {"effects": ["joint_compliance", "load_com", "load_scale"], "values": values}}
    (files / "truth.toml").write_text(tomli_w.dumps(truth))
    assert call(files, "plan", "study.toml", "--out", str(files / "plan")) == 0
    told = json.loads((files / "plan" / "plan.json").read_text())
    assert set(moved) <= set(told["parameters"])
    assert told["refinement"]["status"] == "L-BFGS-B on differences"
    assert told["refinement"]["gained_percent"] > 1.0
    out = ("--truth", "truth.toml", "--out", str(files / "simulate"))
    assert call(files, "simulate", "study.toml", "plan/plan.csv", *out) == 0
    measurements = ("study.toml", "simulate/measurements.csv", "--out", str(files / "identify"))
    assert call(files, "identify", *measurements) == 0
    found = {p["name"]: p for p in json.loads((files / "identify" / "identify.json").read_text())["parameters"]}
    for name, value in {**moved, "joint_compliance.j2": 1.02 * given["joint_compliance.j2"]}.items():
        assert abs(found[name]["value"] - value) < 5 * found[name]["std"]
        expected = told["std"][told["parameters"].index(name)]
        assert found[name]["std"] == pytest.approx(expected, rel=0.1)


def test_plan_json_holds_what_the_interface_promises(files):
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 0
    content = json.loads((files / "out" / "plan.json").read_text())
    assert {"name", "value", "rms_mm", "rms_total_mm"} <= set(content["criterion"])
    assert set(content["grid"]) == {"value", "bound", "efficiency"}
    for key in ("bound", "efficiency", "efficiency_continuous", "rank", "parameters", "nonidentifiable", "candidates",
                "rejected", "time_s", "order"):  # fmt: skip
        assert key in content
    assert content["criterion"]["rms_mm"] == pytest.approx(content["criterion"]["value"] ** 0.5, rel=1e-9)
    assert content["efficiency"] == pytest.approx(content["bound"] / content["criterion"]["value"], rel=1e-9)
    rows = (files / "out" / "plan.csv").read_text().splitlines()
    assert rows[0] == HEADER
    assert [row.split(",")[1] for row in rows[1:]] == ["L0", "L1", "L1", "L0"] * 6, "one crane operation a visit"
    assert call(files, "evaluate", "study.toml", "out/plan.csv", "--out", str(files / "ev")) == 0
    judged = json.loads((files / "ev" / "evaluate.json").read_text())
    assert set(judged["criteria"]) == {"test_pose", "A", "D", "E", "G"}
    assert {"rms_mm", "ci95"} <= set(judged["test_poses"][0])
    assert judged["weakest"]["parameter"] in judged["parameters"]


# --- streams and options


def test_json_is_one_object_on_stdout_and_the_file_at_the_same_time(files, capsys):
    assert call(files, "evaluate", "study.toml", "plan.csv", "--out", str(files / "a"), "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["schema"] == 1
    assert printed.out == (files / "a" / "evaluate.json").read_text()


def test_results_go_to_stdout_and_progress_to_stderr_unless_quiet(files, capsys):
    assert call(files, "plan", "study.toml", "--out", str(files / "a")) == 0
    loud = capsys.readouterr()
    assert "proven: no 12" in loud.out
    assert "searching 12 experiments" in loud.err
    assert "searching" not in loud.out
    assert call(files, "plan", "study.toml", "--out", str(files / "b"), "--quiet") == 0
    quiet = capsys.readouterr()
    assert quiet.err == ""
    assert quiet.out.replace(f"{files / 'b'}", "") == loud.out.replace(f"{files / 'a'}", "")


def test_the_real_process_keeps_stdout_clean(files):
    done = process("plan", files / "study.toml", "--out", files / "out", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["poses"] == 12
    assert "searching 12 experiments" in done.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_the_same_seed_gives_the_same_bytes(files, command, capsys):
    sheet = measured(files)
    assert call(files, "identify", "study.toml", str(sheet), "--out", str(files / "id")) == 0
    arguments = {
        "plan": [],
        "evaluate": ["plan.csv"],
        "simulate": ["plan.csv", "--truth", "truth.toml"],
        "identify": [str(sheet)],
        "predict": ["id/identify.json", "plan.csv"],
    }[command]
    for name in ("first", "second"):
        assert call(files, command, "study.toml", *arguments, "--out", str(files / name), "--seed", "7") == 0
    assert tree(files / "first") == tree(files / "second")
    content = json.loads((files / "first" / f"{command}.json").read_text())
    assert content["provenance"]["seed"] == 7
    assert str(files) not in json.dumps(content)
    capsys.readouterr()


def test_another_seed_gives_other_measurements(files):
    first = measured(files).read_text()
    assert call(files, "simulate", "study.toml", "plan.csv", "--seed", "1", "--out", str(files / "other")) == 0
    assert (files / "other" / "measurements.csv").read_text() != first


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_of_every_command(command, capsys):
    assert run([*([command] if command else []), "--help"]) == 0
    shown = capsys.readouterr()
    assert "Usage" in shown.out
    assert shown.err == ""
    if command:
        assert all(option in shown.out for option in ("--out", "--seed", "--json", "--quiet", "--force"))
    else:
        assert all(name in shown.out for name in COMMANDS)


@pytest.mark.parametrize(
    "arguments",
    [
        ["plot"],
        ["plan"],
        ["plan", "study.toml"],
        ["plan", "study.toml", "--out"],
        ["plan", "study.toml", "--out", "x", "--poses", "3"],
        ["plan", "study.toml", "--out", "x", "--seed", "one"],
        ["evaluate", "study.toml", "--out", "x"],
        ["plan", "study.toml", "more.toml", "--out", "x"],
    ],
)
def test_wrong_command_lines_give_exit_2(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert tree(tmp_path) == {}


def test_the_real_process_hands_on_exit_codes(tmp_path):
    assert process("--version").stdout.strip() == version("elastocal")
    assert process("plot").returncode == 2
    missing = process("plan", tmp_path / "none.toml", "--out", tmp_path / "out")
    assert (missing.returncode, missing.stdout) == (2, "")
    assert "none.toml cannot be read: No such file or directory" in missing.stderr
    assert tree(tmp_path) == {}


# --- the folder of the results


def test_a_folder_in_use_is_refused_before_anything_is_read(files, capsys):
    (files / "out").mkdir()
    (files / "out" / "mine.txt").write_text("keep me")
    assert run(["plan", str(files / "there is no study.toml"), "--out", str(files / "out")]) == 2
    assert "the folder is not empty (mine.txt); choose another one or give --force" in capsys.readouterr().err
    assert tree(files / "out") == {"mine.txt": hashlib.sha256(b"keep me").hexdigest()}


def test_force_replaces_results_and_leaves_other_files(files):
    out = files / "out"
    assert call(files, "evaluate", "study.toml", "plan.csv", "--out", str(out)) == 0
    before = (out / "evaluate.json").read_text()
    (out / "mine.txt").write_text("keep me")
    assert call(files, "evaluate", "study.toml", "plan.csv", "--out", str(out)) == 2
    assert call(files, "evaluate", "study.toml", "plan.csv", "--out", str(out), "--force", "--seed", "1") == 0
    assert (out / "evaluate.json").read_text() != before
    assert (out / "mine.txt").read_text() == "keep me"
    assert sorted(path.name for path in out.iterdir()) == ["evaluate.json", "mine.txt"]


@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_between_the_files_of_a_result_leaves_all_or_nothing(files, monkeypatch, existing, capsys):
    out = files / "out"
    if existing:
        assert call(files, "plan", "study.toml", "--out", str(out)) == 0
    before = tree(files)
    written = []

    def failing(number):
        written.append(number)
        if len(written) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("identify.results.os.fsync", failing)
    assert call(files, "plan", "study.toml", "--out", str(out), "--seed", "1", "--force") in (0, 1, 2)
    assert "No space left" in capsys.readouterr().err or tree(files) != before
    names = {str(path.name) for path in out.iterdir()} if out.exists() else set()
    assert names in (set(), {"plan.csv", "plan.json"})
    if existing:
        seeds = json.loads((out / "plan.json").read_text())["provenance"]["seed"]
        assert seeds in (0, 1)
        assert (tree(files) == before) == (seeds == 0)
    assert not list(files.glob(".elastocal-*"))


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_computation_leaves_nothing(files, monkeypatch, error, capsys):
    def stop(*_, **__):
        raise error("stopped")

    monkeypatch.setattr("doe.commands.plan", stop)
    before = tree(files)
    code = call(files, "plan", "study.toml", "--out", str(files / "out"))
    assert code == (130 if error is KeyboardInterrupt else 1)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert ("interrupted; nothing was written" in shown.err) == (error is KeyboardInterrupt)
    assert ("this is a fault of elastocal" in shown.err) == (error is RuntimeError)
    assert tree(files) == before


def test_ctrl_c_in_the_real_process_leaves_nothing(files):
    (files / "study.toml").write_text(changed(plan={"poses": 1500, "refine": True}))
    before = tree(files)
    hearing = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a background job may be deaf
    start = f"{hearing}; from doe.cli import main; main()"
    command = [sys.executable, "-c", start, "plan", files / "study.toml", "--out", files / "out"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert "searching 1500 experiments" in running.stderr.readline()
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert out == ""
    assert err.endswith("interrupted; nothing was written\n")
    assert tree(files) == before


# --- bad input


UNLIMITED = """<robot name="free"><link name="a"/><link name="b"/><link name="c"/>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="revolute"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint>
</robot>"""
HOSTILE = """<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;">]><robot name="&c;"><link name="a"/></robot>"""
SIDEWAYS = [{"joints_deg": [0.0, -60.0, 90.0, 0.0, 45.0, 0.0], "wrench": [0.0, 900.0, 0.0, 0.0, 0.0, 0.0]}]
TRACKER = {"reading_mm": None, "tracker": {"radial_um": 10.0, "transverse_um": 15.0}}

BAD_STUDIES = {
    "unknown key": (changed(plan={"candidtaes": 5}), ["[plan] candidtaes = 5", "unknown key", "'candidates'"]),
    "unknown table": (changed(planning={"poses": 5}), ["[planning]: unknown table"]),
    "no toml": ("[robot\n", ["line 1"]),
    "zero poses": (changed(plan={"poses": 0}), ["[plan] poses = 0: must be above 0"]),
    "more candidates than fit": (
        changed(plan={"candidates": 10**10}),
        ["[plan] candidates = 10000000000", "at most 10000000"],
    ),
    "poses and tolerance": (changed(plan={"tolerance_mm": 0.1}), ["[plan] poses = 12", "tolerance_mm, not both"]),
    "unknown load": (changed(plan={"loads": ["L9"]}), ["[plan] loads, entry 1 = 'L9'", "unknown load", "L1, L2"]),
    "unknown criterion": (changed(plan={"criterion": "B"}), ["[plan] criterion = 'B'", "test_pose"]),
    "nan": (changed(noise={"reading_mm": float("nan")}), ["[noise] reading_mm = nan", "finite"]),
    "load above payload": (
        changed(loads=[{"id": "L0"}, {"id": "L1", "mass_kg": 400.0}]),
        ["[[loads]] 2 mass_kg = 400", "load above payload", "270 kg"],
    ),
    "no test poses": (changed(test_poses=None), ["[[test_poses]] is missing"]),
    "test poses without load": (
        changed(test_poses=[{"joints_deg": [0.0, -60.0, 90.0, 0.0, 45.0, 0.0]}]),
        ["study.toml: [[test_poses]]: nothing that can be identified moves their points", "give them a wrench"],
    ),
    "no station": (changed(noise=TRACKER), ["[noise.tracker] station_mm is missing"]),
    "no unloaded state": (
        changed(loads=[{"id": "L0", "mass_kg": 5.0}, {"id": "L1", "mass_kg": 9.0}]),
        ["reference_rows = true", "reference_rows = false"],
    ),
    "unknown nominal": (
        changed(model={"nominal": {"joint_compliance.j9": 1.0}}),
        ["study.toml: [model.nominal] 'joint_compliance.j9'", "no such parameter"],
    ),
    "unknown robot": (changed(robot={"model": "kr271"}), ["[robot] model = 'kr271'"]),
    "hostile URDF": (changed(robot={"model": "hostile.urdf"}), ["hostile.urdf", "entit"]),
    "no limits": (
        changed(robot={"model": "free.urdf"}, test_poses=[{"joints_deg": [0.0, 0.0]}], constraints={"floor_mm": None}),
        ["free.urdf", "no limits", "joint j1, j2", "limit lower upper", "continuous"],
    ),
}


@pytest.mark.parametrize("name", BAD_STUDIES)
def test_a_bad_study_is_refused_in_one_message_and_nothing_is_written(files, name, capsys):
    text, expected = BAD_STUDIES[name]
    (files / "study.toml").write_text(text)
    (files / "free.urdf").write_text(UNLIMITED)
    (files / "hostile.urdf").write_text(HOSTILE)
    before = tree(files)
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("error: ") == 1
    assert str(files / "study.toml") in shown.err or "free.urdf" in shown.err
    for part in expected:
        assert part in shown.err
    assert tree(files) == before


def test_several_mistakes_are_told_at_once(files, capsys):
    text = changed(plan={"candidtaes": 5}, noise={"reading_mm": -1.0}, markers={"M 1": [0.0, 0.0, 0.0]})
    (files / "study.toml").write_text(text)
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 2
    shown = capsys.readouterr().err
    assert all(part in shown for part in ("candidtaes", "reading_mm = -1", "M 1"))


def test_a_urdf_whose_meshes_are_missing_is_planned_all_the_same(files):
    meshes = '<collision><geometry><mesh filename="package://nowhere/a.stl"/></geometry></collision>'
    limits = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
    text = UNLIMITED.replace("</joint>", f"{limits}</joint>")
    (files / "arm.urdf").write_text(text.replace('<link name="b"/>', f'<link name="b">{meshes}</link>'))
    tests = [{"joints_deg": [0.0, 20.0], "wrench": [0.0, 0.0, -10.0, 0.0, 0.0, 0.0], "attach_mm": [200.0, 0.0, 0.0]}]
    loads = [{"id": "L0"}, {"id": "L1", "mass_kg": 5.0, "attach_mm": [500.0, 0.0, 0.0]}]
    (files / "study.toml").write_text(
        changed(robot={"model": "arm.urdf"}, test_poses=tests, loads=loads, constraints={"floor_mm": None})
    )
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 0


def first_rows(sheet, change):
    """The measurement file with one function applied to the cells of each row."""
    header, *rows = sheet.read_text().splitlines()
    names = header.split(",")
    cells = [dict(zip(names, row.split(","), strict=True)) for row in rows]
    for number, row in enumerate(cells):
        change(number, row)
    return "\n".join([",".join(cells[0]), *(",".join(row.values()) for row in cells)]) + "\n"


def in_metres(_, row):
    row.update({key: str(float(row[key]) / 1000) for key in ("x_mm", "y_mm", "z_mm")})


def in_radians(_, row):
    row.update({key: f"{np.deg2rad(float(value)):.8f}" for key, value in row.items() if key.endswith("_deg")})


def with_nan(number, row):
    row["y_mm"] = "nan" if number == 4 else row["y_mm"]


def with_text(number, row):
    row["q3_deg"] = "12,5".replace(",", ";") if number == 2 else row["q3_deg"]


def with_unknown_load(number, row):
    row["load"] = "L7" if number > 60 else row["load"]


def with_unknown_marker(number, row):
    row["marker"] = "M8" if number == 0 else row["marker"]


def without_z(_, row):
    del row["z_mm"]


def renamed_unit(_, row):
    row["x_m"] = row.pop("x_mm")


BAD_SHEETS = {
    "metres": (in_metres, ["whole file", "must be in mm"]),
    "radians": (in_radians, ["whole file", "rad"]),
    "nan": (with_nan, ["line 6, y_mm", "nan", "finite number"]),
    "text": (with_text, ["line 4, q3_deg", "12;5"]),
    "unknown load": (with_unknown_load, ["line 63, load", "unknown load", "L0, L1, L2"]),
    "unknown marker": (with_unknown_marker, ["line 2, marker", "unknown marker", "M1, M2, M3"]),
    "missing column": (without_z, ["line 1", "missing column z_mm"]),
    "unit in the name": (renamed_unit, ["missing column x_mm", "x_m"]),
}


@pytest.mark.parametrize("name", BAD_SHEETS)
def test_bad_measurements_are_refused_with_their_line(files, name, capsys):
    change, expected = BAD_SHEETS[name]
    (files / "bad.csv").write_text(first_rows(measured(files), change))
    capsys.readouterr()
    before = tree(files)
    assert call(files, "identify", "study.toml", "bad.csv", "--out", str(files / "out")) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("error: ") == 1
    for part in ["bad.csv", *expected]:
        assert part in shown.err
    assert tree(files) == before


def test_rows_that_contradict_each_other_are_refused_and_equal_ones_used_once(files, capsys):
    sheet = measured(files)
    rows = sheet.read_text().splitlines()
    (files / "twice.csv").write_text("\n".join([*rows, rows[1]]) + "\n")
    cells = rows[1].split(",")
    (files / "contradiction.csv").write_text("\n".join([*rows, ",".join([*cells[:-1], "1.0"])]) + "\n")
    capsys.readouterr()
    assert call(files, "identify", "study.toml", "twice.csv", "--out", str(files / "a")) == 0
    assert "1 rows stand there twice and are used once: lines 74" in capsys.readouterr().err
    assert call(files, "identify", "study.toml", "contradiction.csv", "--out", str(files / "b")) == 2
    assert "lines 2 and 74: the same pose, load, marker, repeat" in capsys.readouterr().err


def turned_to_radians(row):
    return [*row[:2], *(f"{np.deg2rad(float(value)):.8f}" for value in row[2:])]


BAD_PLANS = {
    "radians": (turned_to_radians, ["whole file", "rad"]),
    "unknown load": (lambda row: [row[0], "L5", *row[2:]], ["line 2, load", "'L5'", "L0, L1, L2"]),
    "nan": (lambda row: [*row[:-1], "nan"], ["line 2, q6_deg", "'nan'", "finite number"]),
    "pose id": (lambda row: ["P 1", *row[1:]], ["line 2, pose", "'P 1'", "an id expected"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_PLANS)
@pytest.mark.parametrize("command", ["evaluate", "simulate"])
def test_bad_plans_are_refused(files, name, command, capsys):
    change, expected = BAD_PLANS[name]
    rows = [",".join(change(row.split(","))) for row in PLAN.strip().split("\n")]
    (files / "bad.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    before = tree(files)
    assert call(files, command, "study.toml", "bad.csv", "--out", str(files / "out")) == 2
    shown = capsys.readouterr().err
    for part in ["bad.csv", *expected]:
        assert part in shown
    assert tree(files) == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", "the file is empty"), (HEADER, "no rows below the header"), ("pose;load;q1_deg\nP;L0;1\n", "comma")],
)
def test_plans_without_rows_or_commas_are_refused(files, text, expected, capsys):
    (files / "bad.csv").write_text(text)
    assert call(files, "evaluate", "study.toml", "bad.csv", "--out", str(files / "out")) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ({"truth": {"values": {"joint_compliance.j9": 1.0}}}, "joint_compliance.j9"),
        ({"truth": {"effect": ["geometry"]}}, "[truth] effect"),
        ({"truth": {"effects": ["geometri"]}}, "geometri"),
        ({"noise": {"reading_mm": -0.1}}, "reading_mm"),
    ],
)
def test_bad_truths_are_refused(files, truth, expected, capsys):
    (files / "truth.toml").write_text(tomli_w.dumps(truth))
    arguments = ["study.toml", "plan.csv", "--truth", "truth.toml", "--out", str(files / "out")]
    assert call(files, "simulate", *arguments) == 2
    assert expected in capsys.readouterr().err
    assert not (files / "out").exists()


@pytest.mark.parametrize("text", ["", "{}", "[1, 2]", '{"parameters": 3}', "no json"])
def test_bad_results_are_refused_by_predict(files, text, capsys):
    (files / "result.json").write_text(text)
    arguments = ["study.toml", "result.json", "plan.csv", "--out", str(files / "out")]
    assert call(files, "predict", *arguments) == 2
    assert "result.json" in capsys.readouterr().err
    assert not (files / "out").exists()


# --- what cannot be done


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"test_poses": SIDEWAYS}, "joint_compliance.j1"),
        ({"plan": {"poses": None, "tolerance_mm": 0.05}}, "the robot's own pose jitter"),
        ({"constraints": {"floor_mm": 9000.0}}, "floor rejected"),
        ({"model": {"reference": "differences"}, "plan": {"reference_rows": False}}, "no parameter can be identified"),
        ({"markers": {"M2": None, "M3": None}, "plan": {"poses": 1}}, "too few"),
    ],
)
def test_what_cannot_be_planned_gives_exit_3_and_nothing_is_written(files, changes, expected, capsys):
    (files / "study.toml").write_text(changed(**changes))
    before = tree(files)
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 3
    shown = capsys.readouterr()
    assert shown.out == ""
    assert expected in shown.err
    assert "study.toml" in shown.err
    assert tree(files) == before


def test_what_cannot_be_judged_or_identified_gives_exit_3(files, capsys):
    (files / "unloaded.csv").write_text("\n".join([HEADER, *(r for r in PLAN.splitlines() if ",L0," in r)]) + "\n")
    assert call(files, "evaluate", "study.toml", "unloaded.csv", "--out", str(files / "a")) == 3
    assert "joint_compliance" in capsys.readouterr().err
    arguments = ["study.toml", "unloaded.csv", "--truth", "truth.toml", "--out", str(files / "sim")]
    assert call(files, "simulate", *arguments) == 0
    capsys.readouterr()
    assert call(files, "identify", "study.toml", "sim/measurements.csv", "--out", str(files / "b")) == 3
    assert "no parameter can be identified" in capsys.readouterr().err
    assert not (files / "a").exists()
    assert not (files / "b").exists()


def test_what_cannot_be_identified_is_named_and_the_rest_is_done(files, capsys):
    sheet = measured(files)
    assert call(files, "identify", "study.toml", str(sheet), "--out", str(files / "id")) == 0
    assert call(files, "evaluate", "study.toml", "plan.csv", "--out", str(files / "ev")) == 0
    assert call(files, "plan", "study.toml", "--out", str(files / "out")) == 0
    assert capsys.readouterr().out.count("vertical loads put no torque on joint 1") == 3


# --- packages


def test_packages_are_ours_and_their_public_names_resolve():
    for package, folder in ((identify, "identify"), (doe, "doe")):
        assert Path(package.__file__) == ROOT / folder / "__init__.py"
        assert list(package.__all__) == sorted(package.__all__)
        for name in package.__all__:
            assert getattr(package, name) is not None
        with pytest.raises(AttributeError, match="nothing_like_this"):
            _ = package.nothing_like_this


@pytest.mark.parametrize("statement", ["import doe", "import identify", "import doe.cli"])
def test_imports_load_nothing_heavy(statement):
    heavy = "{'numpy', 'scipy', 'cvxpy', 'casadi', 'pinocchio', 'pydantic', 'matplotlib'}"
    code = f"import sys; {statement}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def name_patterns(cell):
    """Regular expressions of the names in one cell: `a.j<i>.b`, `.c` stands for a.j1.b and a.j1.c."""
    first, *more = re.findall(r"`([^`]+)`", cell)
    ends = [end.strip().lstrip(".") for text in [first, *more] for end in text.split(",")]
    stem, names = first.split(",")[0].rpartition(".")[0], [ends[0].rpartition(".")[2], *ends[1:]]
    for name in names:
        text = re.escape(f"{stem}.{name}").replace(r"\ \.\.\.\ rz", "")
        text = re.sub(r"<(i|a|b|k)>", r"\\d+", text.replace("<ab>", "<i>"))
        text = re.sub(r"<\w+>", r"\\w+", text)
        yield re.sub(r"\.x$", r".\\w+", text) if "..." in cell else text


def test_the_table_of_parameters_names_every_pattern_with_its_unit():
    """Every parameter of every effect on turning joints, frame and markers included."""
    rows = [line for line in (ROOT / "docs" / "theory.md").read_text().splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    table = [(pattern, unit) for names, unit, *rest in cells if rest for pattern in name_patterns(names)]
    springs = {"a_x_mm": 600.0, "a_y_mm": 100.0, "radius_mm": 180.0, "fit_geometry": True}
    modes = ({"levels_deg": [-100.0, -50.0, 0.0]}, springs, {"mode": "harmonics"})
    common = {"joint_windup": {"fit_knee": True}, "link_mass": {"components": ["mass", "mx", "my", "mz"]}}
    common |= {"transmission_error": {"orders": [1, 101], "knots_deg": 90.0}, "tracker_step": {"time_s": 5400.0}}
    chosen = [(name, common) for name in REGISTRY if name != "gravity_compensator"]
    chosen += [("gravity_compensator", {"gravity_compensator": mode}) for mode in modes]
    robot, loads = load_robot("ur10"), (LoadCase("L1", mass=5.0),)
    for name, options in chosen:
        *_, effect = bind_effects(
            ("joint_compliance", name), robot, options=options, flange=True, loads=loads, markers=PLATE
        )
        assert effect.parameters
        for parameter in effect.parameters:
            units = [unit for pattern, unit in table if re.fullmatch(pattern, parameter.name)]
            assert any(parameter.unit in unit for unit in units), parameter.name
    assert any(re.fullmatch(pattern, "frame.ry") for pattern, _ in table)
    assert any(re.fullmatch(pattern, "marker.M1.z") for pattern, _ in table)


def test_the_environment_that_the_tests_run_in_has_no_other_identify():
    assert os.path.commonpath([identify.__file__, ROOT]) == str(ROOT)
    done = subprocess.run(
        [sys.executable, "-c", "import identify, doe; print(identify.__file__); print(doe.__file__)"],
        capture_output=True, text=True, check=True, cwd=ROOT / "tests",
    )  # fmt: skip
    assert done.stdout.split() == [str(ROOT / "identify" / "__init__.py"), str(ROOT / "doe" / "__init__.py")]


def test_the_published_arm_from_the_command_line(tmp_path):
    """Facts, table 4.1: the plan of two poses has rho_0 = 0.74949 at sigma = 1 m."""
    (tmp_path / "study.toml").write_text(tomli_w.dumps(merged(ARM, {"plan": {"candidates": 50}})))
    (tmp_path / "plan.csv").write_text("pose,load,q1_deg,q2_deg,q3_deg\nA,L1,0,0,0\nB,L1,0,143.1,216.9\n")
    assert call(tmp_path, "evaluate", "study.toml", "plan.csv", "--out", str(tmp_path / "out")) == 0
    content = json.loads((tmp_path / "out" / "evaluate.json").read_text())
    assert content["criterion"]["rms_mm"] / 1000 == pytest.approx(0.74949, abs=0.6e-5)
