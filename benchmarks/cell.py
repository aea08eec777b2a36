"""The cell: candidates through all checks, straight moves, and coal one pair at a time beside the batched distances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np

from benchmarks.clock import line, timed
from doe.candidates import candidates
from doe.design_choices import decide
from doe.distances import segment_box_distance
from doe.feasible import screen
from doe.moves import free_moves
from identify.config import load_study

STUDY = Path(__file__).parents[1] / "configs" / "studies" / "kr270_cell.toml"
COUNT = 100_000


def main() -> None:
    (study, decision), wall, _ = timed(lambda: decide(load_study(STUDY), seed=0), repeats=1)
    line(f"choice among {len(decision.tried)} stations", f"{wall:.1f} s", "seconds")
    large = replace(study, plan=replace(study.plan, candidates=COUNT))
    found, wall, cpu = timed(lambda: candidates(large, seed=0), repeats=1)
    share = len(found) / found.drawn
    line(f"{len(found)} candidates found, {100 * share:.1f} % of those drawn", f"{wall:.0f} s, {cpu:.0f} s CPU", "60 s")
    tests = screen(study)
    q = np.random.default_rng(0).permutation(found.q)
    _, wall, _ = timed(lambda: tests.codes(q), repeats=1)
    line(f"{len(q)} feasible poses x 4 loads through every check", f"{wall:.1f} s", "60 s")
    pairs = q[: 60 * 2].reshape(2, 60, -1)
    start, end = np.repeat(pairs[0], 60, axis=0), np.tile(pairs[1], (60, 1))
    free, wall, _ = timed(lambda: free_moves(study, start, end, np.full(3600, 3)), repeats=1)
    line(f"3600 straight moves with 250 kg, {100 * free.mean():.0f} % free", f"{wall:.1f} s", "seconds")
    _compare()


def _compare() -> None:
    """Capsules against a box: batched, and by coal one by one."""
    rng, half = np.random.default_rng(0), np.array([0.3, 0.5, 0.2])
    p, q = rng.normal(0, 1.0, (2, 20_000, 3))
    _, ours, _ = timed(lambda: segment_box_distance(p, q, half))
    box, here = coal.Box(*(2 * half)), coal.Transform3s()
    capsules = [coal.Capsule(0.1, float(length)) for length in np.linalg.norm(q - p, axis=1)]
    middles, there, turn = (p + q) / 2, coal.Transform3s(), np.eye(3)
    request, result = coal.DistanceRequest(), coal.DistanceResult()

    def one_by_one() -> None:
        for capsule, middle in zip(capsules, middles, strict=True):
            there.setTranslation(middle)
            there.setRotation(turn)
            coal.distance(capsule, there, box, here, request, result)

    _, theirs, _ = timed(one_by_one, repeats=1)
    line("20,000 capsules placed against a box: batched, coal", f"{ours:.2f} s, {theirs:.2f} s", "said as it is")
