"""Whole processes: help and plan, with their peak memory."""

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


def main() -> None:
    resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = min(_run("--help")[0] for _ in range(5))
    line("elastocal --help", f"{seconds:.2f} s", "under 0.3 s")
    study = ROOT / "configs" / "studies" / "kr270.toml"
    with tempfile.TemporaryDirectory() as folder:
        seconds, memory = _run("plan", str(study), "--out", f"{folder}/a")
        line("elastocal plan, KR 270, 10,000 candidates, 15 poses", f"{seconds:.1f} s, {memory:.0f} MB", "under 10 s")
        large = Path(folder) / "large.toml"
        text = study.read_text().replace("candidates = 10000", "candidates = 100000")
        large.write_text(text.replace("../robots/", f"{ROOT}/configs/robots/"))
        seconds, memory = _run("plan", str(large), "--out", f"{folder}/b")
        line("elastocal plan, 100,000 candidates", f"{seconds:.1f} s, {memory:.0f} MB", "under 1 GB")
