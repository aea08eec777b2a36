"""Building whitened observation blocks: KR 270, three markers, one load with its unloaded reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.clock import line, peak_mb, timed
from doe.observations import observer
from identify import load_study

STUDY = Path(__file__).parents[1] / "configs" / "studies" / "kr270.toml"


def main() -> None:
    study = load_study(STUDY)
    watching = observer(study)
    rng = np.random.default_rng(0)
    for count, wanted in ((10_000, "under 0.3 s"), (100_000, "under 3 s")):
        q = rng.uniform(study.robot.lower, study.robot.upper, (count, study.robot.n))
        loads = np.tile([0, 1], (count, 1))
        blocks, wall, cpu = timed(lambda q=q, loads=loads: watching.blocks(q, loads))
        line(f"blocks {blocks.shape}, joint compliance", f"{wall:.2f} s wall {cpu:.2f} s CPU", wanted)
    before = peak_mb()
    size = blocks.nbytes / 2**20
    line("memory: peak so far against one copy of the blocks", f"{before:.0f} MB, {size:.0f} MB", "never two copies")
    count = 1_000_000
    q = rng.uniform(study.robot.lower, study.robot.upper, (count, study.robot.n))
    loads = np.broadcast_to(np.array([0, 1]), (count, 2))
    held = peak_mb()
    blocks = watching.blocks(q, loads)
    copies = (peak_mb() - held) / (blocks.nbytes / 2**20)
    line(f"a million candidates: {blocks.nbytes / 2**20:.0f} MB of blocks", f"{copies:.2f} copies held", "below 2")
