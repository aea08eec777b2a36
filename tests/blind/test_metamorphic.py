"""What must not change a verdict: frames, order, names, columns that mean nothing, more of the same."""

import csv
import io
import re

import numpy as np
import pytest

from tests.blind import shell
from tests.blind.arm import rotation
from tests.blind.cases import make_case, write_case

CASES = {"clean": 64, "joint_hardening": 62, "geometry": 63}


@pytest.fixture(scope="module", params=CASES)
def original(request, tmp_path_factory):
    """A folder with a clear case, and what is said about it."""
    case = make_case(CASES[request.param], request.param, energy=1500.0, poses=24, free=False, temperature=False)
    folder = write_case(case, tmp_path_factory.mktemp("meta") / "case")
    return folder, verdict(shell.diagnose(folder)[0])


def verdict(found, names=None):
    """Verdict, causes and what fits as well; places by other names if given."""
    names = names or {}
    causes = {(c["name"], names.get(c["where"], c["where"])) for c in found["causes"]}
    also = {other for c in found["causes"] for other in c["ambiguous_with"]}
    return found["verdict"], causes, also


def again(folder, tmp_path, change_rows=None, change_text=None):
    """The diagnosis after a change of the rows of the measurements, or of the texts of all files."""
    copy = tmp_path / "case"
    copy.mkdir()
    for path in folder.iterdir():
        text = path.read_text()
        if path.suffix == ".csv" and change_rows:
            rows = list(csv.DictReader(io.StringIO(text)))
            rows = change_rows(rows)
            out = io.StringIO()
            writer = csv.DictWriter(out, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
            text = out.getvalue()
        (copy / path.name).write_text(change_text(path.name, text) if change_text else text)
    return shell.diagnose(copy)[0]


def test_another_frame_of_the_tracker(original, tmp_path):
    folder, before = original
    turn = rotation([0.3, -0.2, 2.0])

    def turned(rows):
        for row in rows:
            point = turn @ [float(row[f"{a}_mm"]) for a in "xyz"]
            row.update({f"{a}_mm": f"{v:.6f}" for a, v in zip("xyz", point, strict=True)})
        return rows

    assert verdict(again(folder, tmp_path, turned)) == before


def test_another_base_frame(original, tmp_path):
    folder, before = original

    def turned(name, text):
        return text + "\n[base]\nrpy_deg = [0, 0, 40]\nxyz_mm = [100, -50, 0]\n" if name == "robot.toml" else text

    assert verdict(again(folder, tmp_path, change_text=turned)) == before


def test_another_order_of_rows(original, tmp_path):
    folder, before = original
    rng = np.random.default_rng(4)
    assert verdict(again(folder, tmp_path, lambda rows: [rows[k] for k in rng.permutation(len(rows))])) == before


def test_other_names_of_poses_and_markers(original, tmp_path):
    folder, before = original

    def renamed(name, text):
        text = re.sub(r"\bP(\d\d\d)\b", r"pose-\1", text)
        return re.sub(r"\bM(\d)\b", r"target.\1" if name.endswith("csv") else r'"target.\1"', text)

    assert verdict(again(folder, tmp_path, change_text=renamed)) == before


def test_columns_that_mean_nothing(original, tmp_path):
    folder, before = original
    rng = np.random.default_rng(5)

    def decorated(rows):
        return [
            row | {"decoy": f"{rng.normal():.3f}", "height_inch": f"{float(row['z_mm']) / 25.4:.4f}"} for row in rows
        ]

    assert verdict(again(folder, tmp_path, decorated)) == before


def test_all_data_twice(original, tmp_path):
    folder, before = original

    def doubled(rows):
        return rows + [row | {"pose": f"again-{row['pose']}"} for row in rows]

    found = again(folder, tmp_path, doubled)
    assert (found["verdict"] == "adequate") == (before[0] == "adequate")
    assert {cause["name"] for cause in found["causes"]} == {name for name, _ in before[1]}
