"""The command line under test, called as a customer calls it: files in, files out."""

import csv
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.blind.setting import MARKERS

ROOT = Path(__file__).parents[2]
COMMAND = Path(sys.executable).with_name("elastocal")
SLOW = 120.0  # s; a diagnosis that takes longer has failed


class Failed(Exception):
    """The command did not end with 0; holds what it said."""


def call(verb: str, *files: Path, out: Path, command: Path = COMMAND, more: tuple = ()) -> tuple[Path, float]:
    """Run one command of elastocal (with more options) and say where its results are and how long it took, s."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path}
    line = [str(command), verb, *map(str, files), "--out", str(out), "--force", "--quiet", *more]
    start = time.perf_counter()
    try:
        done = subprocess.run(line, capture_output=True, text=True, env=env, timeout=SLOW, check=False)
    except subprocess.TimeoutExpired as error:
        raise Failed(f"{verb} took more than {SLOW:.0f} s") from error
    if done.returncode:
        raise Failed(f"{verb} exit {done.returncode}: {done.stderr.strip()[-600:]}")
    return out, time.perf_counter() - start


def diagnose(
    folder: Path, command: Path = COMMAND, name: str = "measurements.csv", without: str | None = None
) -> tuple[dict, float]:
    """diagnose.json of a case's folder, and the time it took; a cause may be taken out of the library."""
    more = () if without is None else ("--without", without)
    out = folder.parent / f"{folder.name}-{Path(name).stem}-found"
    out, seconds = call("diagnose", folder / "study.toml", folder / name, out=out, command=command, more=more)
    found = json.loads((out / "diagnose.json").read_text())
    missing = {"verdict", "causes", "remainder", "next_poses"} - set(found)
    if missing or any({"name", "where", "ambiguous_with"} - set(cause) for cause in found.get("causes", [])):
        raise Failed(f"diagnose.json lacks keys: {sorted(missing) or 'of causes'}")
    return found, seconds


def predicted(folder: Path, plan: str, shape: tuple, command: Path = COMMAND) -> np.ndarray:
    """(P, L, M, 3) m where `predict` with the diagnosed model says the markers of a plan are."""
    (folder / "holdout.csv").write_text(plan)
    found = folder.parent / f"{folder.name}-measurements-found" / "diagnose.json"
    files = (folder / "study.toml", found, folder / "holdout.csv")
    out, _ = call("predict", *files, out=folder.parent / f"{folder.name}-predicted", command=command)
    rows = list(csv.DictReader(io.StringIO((out / "predicted.csv").read_text())))
    place = {(r["pose"], r["load"], r["marker"]): [float(r[f"{a}_mm"]) for a in "xyz"] for r in rows}
    plan_rows = list(csv.DictReader(io.StringIO(plan)))
    points = [place[r["pose"], r["load"], marker] for r in plan_rows for marker in MARKERS]
    return np.array(points).reshape(shape) * 1e-3
