"""The stated truth of a simulation: what differs from the study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from identify.config import split_options
from identify.problems import Problems, read_toml, unknown
from identify.schema import NoiseSection, TruthSection
from identify.study import Noise, Study
from identify.study_checks import check_effects
from identify.study_records import noise_from

__all__ = ["Truth", "load_truth"]


@dataclass(frozen=True, eq=False)
class Truth:
    """What measurements are simulated from.

    Attributes:
        effects: Effects of the truth (``name`` or ``name@where``); None: those of the study.
        values: Parameter values by name, in the units of the results; what is missing is nominal.
        noise: Noise of the truth; None: the study's.
        options: Options by effect name: the study's, overlaid key by key with those of the truth.
        path: The file, or None.
    """

    effects: tuple[str, ...] | None = None
    values: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    noise: Noise | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: MappingProxyType({}))
    path: Path | None = None


def load_truth(path: str | Path, study: Study) -> Truth:
    """Read and check a truth file (``[truth]`` with values and options, ``[noise]``).

    Keys of ``[noise]`` replace those of the study one by one; here zero noise is allowed.

    Args:
        path: The truth file (TOML).
        study: The study that is simulated.

    Raises:
        InputError: The file is wrong; the message holds every problem.
    """
    path = Path(path)
    problems = Problems(path)
    data = read_toml(path)
    for name in data:
        if name in {"truth", "noise"}:
            continue
        problems.add(f"[{name}]", unknown("table", name, ["truth", "noise"]))
    own, options = split_options(data.get("truth", {}), TruthSection, "[truth]", problems)
    truth = problems.check(TruthSection, own, "[truth]") or TruthSection()
    check_effects(truth.effects or [], "[truth] effects", problems)
    noise = problems.check(NoiseSection, data.get("noise", {}), "[noise]") or NoiseSection()
    if noise.reading_mm is not None and noise.tracker is not None:
        problems.add("[noise] reading_mm", "give reading_mm or the table [noise.tracker], not both", noise.reading_mm)
    problems.settle()
    names = [*study.options, *(name for name in options if name not in study.options)]
    merged = {name: MappingProxyType({**study.options.get(name, {}), **options.get(name, {})}) for name in names}
    return Truth(
        effects=None if truth.effects is None else tuple(truth.effects),
        values=MappingProxyType(dict(truth.values)),
        noise=noise_from(noise, study.noise) if "noise" in data else None,
        options=MappingProxyType(merged),
        path=path,
    )
