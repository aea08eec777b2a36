"""Cases: what is wrong with a random robot, the files that show it, and the truth that is kept apart."""

import json
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tests.blind import files, hidden, sizing, spoiled
from tests.blind.faults import base_handles, rivals
from tests.blind.physics import Conditions, World, respond
from tests.blind.setting import Design, Noise, Setting, conditions, random_poses, random_setting
from tests.blind.whitening import Lens, lens_for

MIX = {
    "clean": 0.2, "single": 0.36, "pair": 0.08, "confounded": 0.08, "outside": 0.1,
    "fault": 0.08, "noise": 0.06, "below": 0.04,
}  # fmt: skip
CONFOUNDED = {  # what is true, and what nothing in the data tells from it
    "tracker_scale": "geometry",
    "transmission_error": "gravity_compensator",
    "load_level": "load_scale",
    "approach_hysteresis": "geometry",
}
NOISES = ("jitter", "reading", "tails", "marker", "range")


@dataclass(frozen=True, eq=False)
class Case:
    """One blind case.

    Attributes:
        seed, kind, options: What makes it.
        causes: (name, where) of what is wrong; empty if nothing is.
        energy: Detectability of each cause: whitened signal energy beyond the base model and the other causes.
        kin: Names that fit exactly as well (the set is then the answer).
        judged: Every cause is big enough to be found.
        setting, given, world, faults, stated, noise: The truth.
        table: What the files hold.
    """

    seed: int
    kind: str
    options: dict
    causes: tuple
    energy: tuple
    kin: tuple
    judged: bool
    setting: Setting
    given: Conditions
    world: World
    faults: tuple
    sizes: tuple
    stated: Noise
    noise: Noise
    table: files.Table
    lens: Lens = field(repr=False)

    @cached_property
    def rival(self) -> tuple[float, str]:
        """Smallest energy that the first cause keeps beyond base and one rival of another name, and which rival."""
        signal = self.lens.whiten(respond(self.world, self.given) - respond(self.setting.world, self.given))
        best = (np.inf, "")
        for name, where, handles in rivals(self.setting, self.given.time):
            if name != self.causes[0][0]:
                left = self.lens.remains(signal, self.lens.columns(handles))
                best = min(best, (left, f"{name}@{where}"))
        return best

    @property
    def resolvable(self) -> bool:
        """No single rival of another name explains the one cause."""
        return len(self.faults) == 1 and not self.kin and self.rival[0] >= 35.0

    @property
    def truth(self) -> dict:
        """What is kept apart from the files."""
        return {
            "seed": self.seed, "kind": self.kind, "options": self.options, "causes": self.causes,
            "energy": self.energy, "sizes": self.sizes, "kin": self.kin, "judged": self.judged,
        }  # fmt: skip


def make_case(seed: int, kind: str | None = None, **options) -> Case:
    """Draw a case; the same seed, kind and options give the same case.

    Args:
        seed: Any whole number >= 0.
        kind: ``clean``, ``single``, ``pair``, ``confounded``, ``outside``, ``fault``, ``noise``, ``below``; or one of a
            group: a name of a cause, ``outside:hose``, ``confounded:tracker_scale``, ``fault:swap``, ``noise:jitter``,
            ``pair:geometry+load_com``, ``below:backlash``. By the mix if None.
        options: ``energy`` (detectability), and the fields of `Design` (poses, levels, repeats, free, time, ...).
    """
    rng = np.random.default_rng([seed, 7001, *str(kind).encode()])
    kind = str(rng.choice(list(MIX), p=list(MIX.values()))) if kind is None else kind
    group, names, detail = _names(rng, kind)
    design = _design(rng, group, names, dict(options))
    setting = random_setting(rng, design, far=detail != "range")
    given = conditions(rng, setting, random_poses(rng, setting, design.poses))
    stated, noise = _noises(rng, setting, detail if group == "noise" else None)
    lens = lens_for(setting.world, given, noise, base_handles())
    chosen = [sizing.sized(rng, name, group, setting, given, lens, options.get("energy")) for name in names]
    world = setting.world
    for fault, size in chosen:
        world = fault.apply(world, size)
    faults = tuple(fault for fault, _ in chosen)
    energy = sizing.energies(lens, setting, given, chosen)
    readings = measure(rng, world, given, noise)
    table = files.table_of(setting, given, readings)
    causes = tuple((fault.name, fault.where) for fault in faults)
    if group == "fault":
        causes = (("data_fault", spoiled.spoil(rng, table, detail)),)
        energy = (np.inf,)
    if detail == "range" and group == "noise":
        causes = (("range_noise", None),)
        energy = (np.inf,)
    kin = (CONFOUNDED[names[0]],) if group == "confounded" else ()
    judged = group not in {"below"} and all(value >= sizing.LAMBDA[0] * 0.9 for value in energy)
    label = kind if ":" in kind or kind in hidden.EFFECTS else ":".join([kind, *([detail] if detail else [])])
    sizes = tuple(size for _, size in chosen)
    return Case(
        seed,
        label,
        options,
        causes,
        energy,
        kin,
        judged,
        setting,
        given,
        world,
        faults,
        sizes,
        stated,
        noise,
        table,
        lens,
    )


def _names(rng, kind):
    """Group, causes to draw, and the word after the colon."""
    group, _, detail = kind.partition(":")
    if group in hidden.EFFECTS:
        return "single", [group], group
    if group in {"single", "below"}:
        detail = detail or str(rng.choice(hidden.EFFECTS))
        return group, [detail], detail
    if group == "pair":
        detail = detail or "+".join(rng.choice(hidden.EFFECTS, 2, replace=False))
        return group, detail.split("+"), detail
    if group == "confounded":
        detail = detail or str(rng.choice(list(CONFOUNDED)))
        return group, [detail], detail
    if group == "outside":
        detail = detail or str(rng.choice(hidden.OUTSIDE)).partition(":")[2]
        return group, [f"outside:{detail}"], detail
    if group in {"fault", "noise"}:
        detail = detail or str(rng.choice(spoiled.WAYS if group == "fault" else NOISES))
        return group, [], detail
    if group != "clean":
        raise ValueError(f"kind {kind!r}: allowed are {', '.join(MIX)} and names of causes")
    return group, [], ""


def _design(rng, group, names, options):
    """Which columns the file has; what a cause needs to be seen is there."""
    options.pop("energy", None)
    needs = set(names)
    lucky = rng.random(4)
    design = Design(
        time=bool(lucky[0] < 0.85 or needs & {"tracker_drift", "tracker_step", "thermal_growth"} or group == "outside"),
        temperature=bool(lucky[1] < 0.75 or group == "outside"),
        approach=bool(lucky[2] < 0.7 or "approach_hysteresis" in needs),
        free=bool("force_sensor_bias" in needs or (lucky[3] < 0.12 and "load_direction" not in needs)),
    )
    if group == "confounded":
        design = replace(design, free=False)
        if "load_level" in needs:
            design = replace(design, levels=(0.0, 2500.0), poses=40)
        if "approach_hysteresis" in needs:
            design = replace(design, one_way=True)
    design = replace(design, **options)
    return replace(design, temperature=design.temperature and design.time)


def _noises(rng, setting, way):
    """What the study states and what is true."""
    stated = Noise()
    true = {
        None: stated,
        "jitter": replace(stated, pose=2 * stated.pose),
        "reading": replace(stated, reading=1.5 * stated.reading),
        "tails": replace(stated, tails=True),
        "marker": replace(stated, marker=tuple(np.roll([3.0, 1.0, 1.0], rng.integers(3)))),
        "range": replace(stated, law=(5e-6, 15e-6)),
    }[way]
    return stated, true


def measure(rng, world, given, noise) -> np.ndarray:
    """(P, L, M, 3) readings with the joints' scatter and the tracker's noise."""
    pose = noise.pose * rng.normal(size=(len(given.q), 1, 6))
    shot = noise.shot * rng.normal(size=(*given.load.shape, 6))
    clean = respond(world, replace(given, jitter=pose + shot))
    spread = noise.spread(np.linalg.norm(clean, axis=-1))[..., None]
    drawn = rng.standard_t(3, clean.shape) / np.sqrt(3.0) if noise.tails else rng.normal(size=clean.shape)
    return clean + spread * drawn


def write_case(case: Case, folder: Path) -> Path:
    """Write robot.toml, study.toml and measurements.csv into a folder; the truth goes beside it, not into it.

    Args:
        case: The case.
        folder: Made if need be.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(files.robot_file(case.setting))
    (folder / "study.toml").write_text(files.study_file(case.setting, case.stated))
    (folder / "measurements.csv").write_text(files.measurements(case.table))
    folder.with_suffix(".truth.json").write_text(json.dumps(case.truth, default=float, indent=1))
    return folder


def holdout(case: Case, count: int = 25) -> tuple[str, np.ndarray, Conditions]:
    """New poses: a plan file, where the markers truly are read (P, L, M, 3) m without noise, and the conditions.

    Times lie within those of the measurement, so that instrument effects are interpolated.
    """
    rng = np.random.default_rng([case.seed, 7002])
    q = random_poses(rng, case.setting, count)
    span = case.given.time.max()
    begin = np.sort(rng.uniform(0.05 * span, 0.95 * span, count))
    times = begin[:, None] + 10.0 * np.arange(case.given.load.shape[1])
    given = conditions(rng, case.setting, q, times=times)
    true = respond(case.world, given)
    names = [f"H{k:03d}" for k in range(1, count + 1)]
    return files.plan(files.table_of(case.setting, given, true, names=names)), true, given


def more_conditions(case: Case, plan_csv: str) -> tuple[Conditions, list[str]]:
    """When the visits of a plan file are measured after the case, and under what conditions; their names."""
    q, load, names = spoiled.read_plan(plan_csv, case.setting.design.loads)
    rng = np.random.default_rng([case.seed, 7003, len(q)])
    return conditions(rng, case.setting, q, start=case.given.time.max(), load=load), names


def measure_more(case: Case, plan_csv: str) -> str:
    """The text of measurements.csv with the visits of a plan file measured in addition, by the same robot."""
    given, names = more_conditions(case, plan_csv)
    rng = np.random.default_rng([case.seed, 7005, len(names)])
    readings = measure(rng, case.world, given, case.noise)
    more = files.table_of(case.setting, given, readings, names=[f"N{name}" for name in names])
    return files.measurements(case.table) + files.measurements(more).partition("\n")[2]


def random_plan(case: Case, count: int = 4) -> str:
    """A plan of random poses with all loads, to compare proposed ones with."""
    rng = np.random.default_rng([case.seed, 7004])
    given = conditions(rng, case.setting, random_poses(rng, case.setting, count))
    return files.plan(files.table_of(case.setting, given, respond(case.world, given)))
