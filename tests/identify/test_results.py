"""Results on disk: the same bytes for the same run, and nothing between the old and the new."""

import hashlib
import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identify import results
from identify.errors import InputError
from identify.results import check_out, json_text, provenance, recover, write_results

OLD = {"plan.csv": "old table\n", "plan.json": '{"old": 1}\n'}
NEW = {"plan.csv": "new table\n", "plan.json": '{"new": 1}\n'}


def content(folder):
    """Every file of a folder, hidden ones too."""
    return {path.name: path.read_text() for path in sorted(folder.iterdir()) if path.is_file()}


def leftovers(folder):
    """Hidden folders of ours."""
    return [path.name for path in folder.rglob(".elastocal-*")]


# ---- JSON


def test_json_begins_with_the_schema_and_keeps_the_order():
    text = json_text({"b": 1, "a": [1, 2.5, True, None], "c": {"x": np.float64(0.1)}, "d": []})
    lines = ["{", '  "schema": 1,', '  "b": 1,', '  "a": [1, 2.5, true, null],', '  "c": {', '    "x": 0.1', "  },"]
    assert text.splitlines() == [*lines, '  "d": []', "}"]


def test_json_takes_arrays_tuples_paths_and_turns_nan_into_null():
    data = {
        "array": np.array([[1.0, np.nan], [np.inf, -0.0]]),
        "ints": np.arange(3),
        "tuple": ("a", "ü"),
        "path": Path("a/b/c.csv"),
        "flag": np.bool_(True),
        "number": float("-inf"),
        "records": [{"x": 1}, {"x": (1, 2)}],
    }
    text = json_text(data)
    assert "-0.0" not in text
    assert json.loads(text) == {
        "schema": 1,
        "array": [[1.0, None], [None, 0.0]],
        "ints": [0, 1, 2],
        "tuple": ["a", "ü"],
        "path": "c.csv",
        "flag": True,
        "number": None,
        "records": [{"x": 1}, {"x": [1, 2]}],
    }


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.text().filter(lambda key: key != "schema"), plain))
def test_json_comes_back_as_it_was_written(data):
    text = json_text(data)
    assert json.loads(text) == {"schema": 1, **data}
    assert json_text(data) == text


# ---- provenance


def test_provenance_names_versions_seed_and_hashes_but_no_folder(tmp_path):
    study = tmp_path / "study.toml"
    study.write_bytes(b"x")
    found = provenance([study], 7)
    assert found["seed"] == 7
    assert found["inputs"] == {"study.toml": hashlib.sha256(b"x").hexdigest()}
    assert list(found["versions"]) == ["python", "elastocal", "numpy", "scipy", "pin", "casadi"]
    assert found["versions"]["numpy"] == np.__version__
    assert str(tmp_path) not in json_text(found)
    assert json_text(found) == json_text(provenance([study], 7))


def test_files_of_one_name_are_told_apart(tmp_path):
    paths = [tmp_path / folder / "a.csv" for folder in "xyz"]
    for path, text in zip(paths, ["1", "2", "1"], strict=True):
        path.parent.mkdir()
        path.write_text(text)
    assert list(provenance(paths, 0)["inputs"]) == ["a.csv", "a.csv (2)"]


def test_an_input_that_is_gone_is_named(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        provenance([tmp_path / "none"], 0)


# ---- folders


def test_results_make_their_folder(tmp_path):
    out = tmp_path / "a" / "b"
    write_results(out, {**NEW, "picture.png": b"\x89\x00"})
    assert (out / "picture.png").read_bytes() == b"\x89\x00"
    assert (out / "plan.csv").read_bytes() == b"new table\n"
    assert leftovers(tmp_path) == []
    mask = os.umask(0)
    os.umask(mask)
    assert out.stat().st_mode & 0o777 == 0o777 & ~mask


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "out").mkdir()
    write_results(tmp_path / "out", NEW)
    assert content(tmp_path / "out") == NEW
    assert leftovers(tmp_path) == []


def test_a_folder_with_content_is_refused_without_force(tmp_path):
    write_results(tmp_path / "out", OLD)
    for call in (lambda: check_out(tmp_path / "out", False), lambda: write_results(tmp_path / "out", NEW)):
        with pytest.raises(InputError, match=r"the folder is not empty \(plan.csv, plan.json\).*--force"):
            call()
    assert content(tmp_path / "out") == OLD


def test_force_replaces_old_results(tmp_path):
    write_results(tmp_path / "out", OLD)
    write_results(tmp_path / "out", NEW, force=True)
    assert content(tmp_path / "out") == NEW
    assert leftovers(tmp_path) == []


def test_obsolete_files_of_the_same_command_go(tmp_path):
    for other in ({}, {"notes.txt": "mine"}):
        out = tmp_path / f"out{len(other)}"
        write_results(out, {**OLD, "next_poses.csv": "old", **other})
        write_results(out, NEW, force=True, obsolete=["next_poses.csv", "plan.csv"])
        assert content(out) == {**NEW, **other}


def test_files_and_folders_of_others_are_left_alone(tmp_path):
    out = tmp_path / "out"
    write_results(out, OLD)
    (out / "notes.txt").write_text("mine")
    (out / "sub").mkdir()
    (out / "sub" / "plan.csv").write_text("mine too")
    write_results(out, NEW, force=True)
    assert content(out) == {**NEW, "notes.txt": "mine"}
    assert content(out / "sub") == {"plan.csv": "mine too"}
    assert leftovers(tmp_path) == []


def test_the_working_folder_is_not_exchanged_under_our_feet(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    number = tmp_path.stat().st_ino
    write_results(Path(), OLD)
    write_results(Path(), NEW, force=True)
    assert content(tmp_path) == NEW
    assert tmp_path.stat().st_ino == number


def test_links_are_replaced_and_their_targets_left_alone(tmp_path):
    treasure = tmp_path / "treasure"
    treasure.write_text("mine")
    for other in (False, True):
        out = tmp_path / f"out{other}"
        out.mkdir()
        (out / "plan.csv").symlink_to(treasure)
        if other:
            (out / "link").symlink_to(treasure)
        write_results(out, NEW, force=True)
        assert not (out / "plan.csv").is_symlink()
        assert (out / "plan.csv").read_text() == "new table\n"
    assert treasure.read_text() == "mine"


def test_a_file_a_link_and_a_place_below_a_file_are_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    (tmp_path / "nowhere").symlink_to(tmp_path / "none")
    cases = {"file": "is a file", "link": "symbolic link", "nowhere": "symbolic link", "file/out": "is no folder"}
    for name, part in cases.items():
        with pytest.raises(InputError, match=part):
            check_out(tmp_path / name, True)
        with pytest.raises(InputError, match=part):
            write_results(tmp_path / name, NEW, force=True)
    assert (tmp_path / "file").read_text() == "mine"
    assert list((tmp_path / "folder").iterdir()) == []


def test_a_folder_in_the_place_of_a_result_is_refused(tmp_path):
    (tmp_path / "plan.csv").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        write_results(tmp_path, NEW, force=True)
    assert content(tmp_path) == {}


@pytest.mark.parametrize("name", ["../x", "a/b", ".hidden", "..", ""])
def test_names_that_leave_the_folder_are_refused(name, tmp_path):
    with pytest.raises(InputError, match="plain file name"):
        write_results(tmp_path / "out", {name: "x"})
    assert list(tmp_path.iterdir()) == []


def test_checking_writes_nothing(tmp_path):
    check_out(tmp_path / "a" / "b", False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("others", [{}, {"notes.txt": "mine"}])
def test_a_full_disk_leaves_the_old_result(others, tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_results(out, {**OLD, **others})

    def full(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results.os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        write_results(out, NEW, force=True)
    assert content(out) == {**OLD, **others}
    assert leftovers(tmp_path) == []


def test_systems_that_cannot_exchange_folders_move_the_files(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "_exchange", lambda staged, out: False)
    write_results(tmp_path / "out", OLD)
    write_results(tmp_path / "out", NEW, force=True)
    assert content(tmp_path / "out") == NEW
    assert leftovers(tmp_path) == []


def test_a_file_that_comes_at_the_last_moment_is_kept(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_results(out, OLD)
    exchange = results._exchange

    def late(staged, folder):
        (folder / "notes.txt").write_text("mine")
        return exchange(staged, folder)

    monkeypatch.setattr(results, "_exchange", late)
    write_results(out, NEW, force=True)
    assert content(out) == {**NEW, "notes.txt": "mine"}


KILLER = textwrap.dedent(
    """
    import os, sys, shutil, ctypes
    from pathlib import Path
    from identify import results

    OLD, NEW, others, root = {old}, {new}, {others}, Path(sys.argv[1])

    def run(k):
        "Write the new result and die at the k-th step; True if it got to the end."
        left = [k]
        def step(event, args):
            if event.startswith(("open", "os.", "shutil.", "tempfile.", "ctypes.")):
                left[0] -= 1
                if left[0] < 0:
                    os._exit(9)
        pid = os.fork()
        if pid == 0:
            sys.addaudithook(step)
            results.write_results(root / "out", NEW, force=True)
            os._exit(0)
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0

    def content():
        "The visible files."
        return {{p.name: p.read_text() for p in sorted((root / "out").iterdir()) if not p.name.startswith(".")}}

    for k in range(1000):
        shutil.rmtree(root / "out", ignore_errors=True)
        if OLD:
            results.write_results(root / "out", {{**OLD, **others}})
        done = run(k)
        before = content() if (root / "out").exists() else {{}}
        if (root / "out").exists():
            results.recover(root / "out")
        after = content() if (root / "out").exists() else {{}}
        print(repr((done, before, after)))
        if done:
            break
    """
)


@pytest.mark.parametrize(("old", "others"), [(OLD, {}), (OLD, {"notes.txt": "mine"}), ({}, {})])
def test_a_run_killed_at_any_step_leaves_the_old_or_the_new(old, others, tmp_path):
    script = KILLER.format(old=old, new=NEW, others=others)
    ran = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=True)
    states = [eval(line) for line in ran.stdout.splitlines()]
    assert len(states) > 6
    assert states[-1][0]
    allowed = [{**old, **others}, {**NEW, **others}]
    for _, before, after in states:
        assert after in allowed
        if not others:  # a folder of our own is exchanged at once
            assert before in allowed
    assert allowed[0] in [after for _, _, after in states[:-1]]
    assert states[-1][2] == allowed[1]


def test_an_interrupted_move_is_finished_by_the_next_check(tmp_path, caplog):
    out = tmp_path / "out"
    write_results(out, {**OLD, "notes.txt": "mine", "gone.csv": "old"})
    sealed = out / ".elastocal-sealed"
    sealed.mkdir()
    for name, text in {**NEW, ".remove": "gone.csv\n../out/notes.txt"}.items():
        (sealed / name).write_text(text)
    (out / ".elastocal-new-x").mkdir()
    check_out(out, True)
    assert content(out) == {**NEW, "notes.txt": "mine"}
    assert leftovers(tmp_path) == []
    assert "interrupted" in caplog.text
    recover(out)  # nothing left to do
    assert content(out) == {**NEW, "notes.txt": "mine"}
