"""The command `diagnose`, from files to files: a diagnosis and the poses that would settle what is ambiguous."""

from __future__ import annotations

from pathlib import Path

from identify.commands import Outcome
from identify.config import load_study
from identify.diagnose import diagnose
from identify.diagnose.content import diagnosis_json, diagnosis_lines
from identify.diagnose.extension import extended_toml
from identify.diagnose.residual_table import residuals_csv
from identify.effects import REGISTRY
from identify.errors import InputError
from identify.tables import load_measurements

__all__ = ["run_diagnose"]

EXTENDED = "extended.toml"
RESIDUALS = "residuals.csv"


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
    content = {**diagnosis_json(found), "extended_study": EXTENDED, "next_poses": None}
    tables = {EXTENDED: extended_toml(found, out), RESIDUALS: residuals_csv(found)}
    return Outcome("diagnose", content, (*study.inputs, measurements), tables, diagnosis_lines(content))
