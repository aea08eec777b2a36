"""Whole processes: help, plan and diagnose, with their peak memory."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.clock import line

ROOT = Path(__file__).parents[1]
COMMAND = Path(sys.executable).with_name("elastocal")


def _run(*arguments: str) -> tuple[float, float]:
    """Wall seconds and peak MB of one process."""
    begin = time.perf_counter()
    process = subprocess.Popen([COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"elastocal {' '.join(arguments)} failed")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024


def _larger(study: Path, candidates: int, folder: str) -> Path:
    """The same study with another number of candidates."""
    path = Path(folder) / f"{study.stem}_{candidates}.toml"
    text = study.read_text().replace("candidates = 10000", f"candidates = {candidates}")
    path.write_text(text.replace("../robots/", f"{ROOT}/configs/robots/"))
    return path


def main() -> None:
    resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = min(_run("--help")[0] for _ in range(5))
    line("elastocal --help", f"{seconds:.2f} s", "under 0.3 s")
    study = ROOT / "configs" / "studies" / "kr270.toml"
    with tempfile.TemporaryDirectory() as folder:
        seconds, memory = _run("plan", str(study), "--out", f"{folder}/a")
        line("elastocal plan, KR 270, 10,000 candidates, 15 poses", f"{seconds:.1f} s, {memory:.0f} MB", "under 10 s")
        seconds, memory = _run("plan", str(_larger(study, 100_000, folder)), "--out", f"{folder}/b")
        line("elastocal plan, 100,000 candidates", f"{seconds:.1f} s, {memory:.0f} MB", "under 1 GB")
        cell = study.with_name("kr270_cell.toml")
        one, two = (_run("plan", str(cell), "--out", f"{folder}/w{n}", "--workers", f"{n}")[0] for n in (1, 2))
        line("elastocal plan, KR 270 cell: one process, two", f"{one:.0f} s, {two:.0f} s", "said as it is")
        seconds, memory = _run("plan", str(_larger(cell, 1_000_000, folder)), "--out", f"{folder}/m")
        line("elastocal plan, KR 270 cell, a million candidates", f"{seconds:.0f} s, {memory:.0f} MB", "4 GB")
        wrong, poses = (study.with_name(f"kr270_diagnose{end}") for end in (".toml", "_poses.csv"))
        truth = ROOT / "configs" / "truths" / "kr270_diagnose.toml"
        _run("simulate", str(wrong), str(poses), "--truth", str(truth), "--out", f"{folder}/c")
        seconds, memory = _run("diagnose", str(wrong), f"{folder}/c/measurements.csv", "--out", f"{folder}/d")
        line("elastocal diagnose, 30 poses, folds included", f"{seconds:.1f} s, {memory:.0f} MB", "under 3 s")
        series = ROOT.parent / "shared" / "data" / "ur10-tmac" / "series_a.csv"
        if series.is_file():  # real measurements, not part of the project
            real = study.with_name("ur10_series_a.toml")
            seconds, memory = _run("diagnose", str(real), str(series), "--out", f"{folder}/e")
            line("elastocal diagnose, UR10, 12,000 poses", f"{seconds:.0f} s, {memory:.0f} MB", "under 60 s")
