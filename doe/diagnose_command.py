"""The command `diagnose`, from files to files: a diagnosis and the poses that would settle what is ambiguous."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from doe.discriminate import NextPoses, Separation, next_poses
from identify.commands import Outcome
from identify.config import load_study
from identify.diagnosis import diagnose
from identify.diagnosis.content import diagnosis_json, diagnosis_lines
from identify.diagnosis.extension import extended_toml
from identify.diagnosis.residual_table import residuals_csv
from identify.effects import REGISTRY
from identify.errors import InputError
from identify.tables import load_measurements, plan_csv

__all__ = ["run_diagnose"]

EXTENDED = "extended.toml"
RESIDUALS = "residuals.csv"
NEXT = "next_poses.csv"


def run_diagnose(
    study_file: Path, measurements: Path, out: Path, *, seed: int, without: tuple[str, ...] = ()
) -> Outcome:
    """Diagnose measurements.

    Args:
        study_file: Study file.
        measurements: Measured positions.
        out: Folder that the results will stand in.
        seed: Seed of all random choices.
        without: Names of causes that are not considered.

    Raises:
        InputError: A cause that does not exist.
    """
    for name in without:
        if name not in REGISTRY:
            raise InputError(f"--without {name}: no such cause; allowed are {', '.join(sorted(REGISTRY))}")
    study = load_study(study_file)
    found = diagnose(study, load_measurements(measurements, study), seed=seed, without=frozenset(without))
    following = next_poses(study, found, seed=seed)
    content = diagnosis_json(found)
    content = {
        **content,
        "extended_study": EXTENDED,
        "next_poses": None if following.experiment is None else NEXT,
        "separation": [_separation(pair) for pair in following.separations],
        "notes": [*content["notes"], *following.notes],
    }
    tables = {EXTENDED: extended_toml(found, out), RESIDUALS: residuals_csv(found)}
    if following.experiment is not None:
        tables[NEXT] = plan_csv(following.experiment, study)
    lines = (*diagnosis_lines(content), *_lines(following))
    return Outcome("diagnose", content, (*study.inputs, measurements), tables, lines)


def _separation(pair: Separation) -> dict[str, Any]:
    """A cause against a rival as plain data."""
    return {
        "cause": pair.cause,
        "rival": pair.rival,
        "energy_now": pair.now,
        "energy_then": pair.then,
        "energy_needed": pair.needed,
        "separable": pair.separable,
        "exact": pair.exact,
        "advice": pair.advice,
    }


def _lines(following: NextPoses) -> list[str]:
    """What to measure next, for people."""
    lines = []
    if following.experiment is not None:
        lines.append(
            f"measure next: the {len(following.experiment.visits)} poses of {NEXT}, then diagnose all readings"
        )
    return lines + [f"    {pair.cause} against {pair.rival}: {_outlook(pair)}" for pair in following.separations]


def _outlook(pair: Separation) -> str:
    """What the next poses will do for a pair."""
    if pair.separable is False:
        return f"no pose separates these; {pair.advice}"
    if pair.then is None:
        return f"energy {pair.now:.0f} now, {pair.needed:.0f} needed"
    enough = "" if pair.then >= pair.needed else ", not enough yet: measure more such poses"
    beside = "" if pair.advice is None else f"; {pair.advice}"
    return f"energy {pair.now:.0f} now, {pair.then:.0f} then, {pair.needed:.0f} needed{enough}{beside}"
