"""Run blind cases through the command line and judge what it says."""

import multiprocessing
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from tests.blind import oracle, shell
from tests.blind.cases import Case, holdout, make_case, measure_more, more_conditions, random_plan, write_case
from tests.blind.faults import base_handles, rivals
from tests.blind.hidden import EFFECTS
from tests.blind.judge import confident, judge, reported
from tests.blind.physics import respond
from tests.blind.spoiled import read_plan
from tests.blind.whitening import lens_for, orthonormal

CLEAR = 35.0  # energy beyond a rival at which the two can be told apart
STRANGE = 250.0  # energy beyond every rival at which a stranger cannot pass for one of the library


def run_exam(seeds, kinds=(), *, command: Path = shell.COMMAND, more=True, without=False, options=None, workers=2):
    """Outcomes (dicts) of one case for each seed.

    Args:
        seeds: Seeds of the cases.
        kinds: Kinds, taken in turn; by the mix if empty.
        command: The executable under test.
        more: Also judge extra poses and held-out errors.
        without: Also diagnose clear single cases with their own effect taken out of the library.
        options: Options of `make_case`.
        workers: Cases at a time.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    jobs = [(seed, kinds[k % len(kinds)] if kinds else None) for k, seed in enumerate(seeds)]
    work = partial(_safely, command=command, more=more, without=without, options=options or {})
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        return list(pool.map(work, jobs))


def _safely(job, *, command, more, without, options):
    """One outcome; what fails in the command is an outcome too."""
    seed, kind = job
    case = make_case(seed, kind, **options)
    head = {"seed": seed, "kind": case.kind, "group": _group(case), **_facts(case)}
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = _examined(case, Path(folder) / "case", command, more)
            if without and head["group"] == "single" and case.judged and case.rival[0] >= STRANGE:
                result["robbed"] = robbed(case, Path(folder) / "robbed", command)
            return head | result
        except shell.Failed as error:
            return head | {"error": str(error)}


def _group(case: Case) -> str:
    group = case.kind.partition(":")[0]
    return "single" if group in EFFECTS else group


def _facts(case: Case) -> dict:
    rival = case.rival if len(case.faults) == 1 else (np.inf, "")
    judged = case.judged and (_group(case) != "outside" or rival[0] >= STRANGE)
    return {
        "causes": case.causes, "energy": case.energy, "judged": judged, "resolvable": case.resolvable,
        "rival": rival, "free": case.setting.design.free,
    }  # fmt: skip


def _examined(case, folder, command, more):
    write_case(case, folder)
    found, seconds = shell.diagnose(folder, command)
    verdict = judge(case.kind, case.causes, case.kin, found)
    result = asdict(verdict) | {"verdict": found["verdict"], "seconds": seconds}
    if more and verdict.outcome == "right" and _group(case) == "single":
        result["gain"] = held_out_ratio(case, folder, command)
    if more and _group(case) == "single" and verdict.outcome == "set" and found.get("next_poses"):
        result["more"] = extra_poses(case, folder, found, command)
    return result


def robbed(case: Case, folder: Path, command: Path) -> bool:
    """Without its own effect in the library, the case is given another name and no doubt is left."""
    write_case(case, folder)
    return confident(shell.diagnose(folder, command, without=case.causes[0][0])[0])


def held_out_ratio(case: Case, folder: Path, command: Path) -> float:
    """Error of the diagnosed model on new poses over that of the true model fitted to the same readings."""
    plan, true, given = holdout(case)
    said = shell.predicted(folder, plan, true.shape, command)
    return oracle.rms(said - true) / oracle.oracle_error(case, true, given)


def extra_poses(case: Case, folder: Path, found: dict, command: Path) -> dict:
    """Diagnose again with the proposed poses, and with as many random ones, measured in addition."""
    proposed = (folder.parent / "case-measurements-found" / found["next_poses"]).read_text()
    count = len(read_plan(proposed, case.setting.design.loads)[2])
    result = {"poses": count, "resolvable": False}
    for name, plan in (("proposed", proposed), ("random", random_plan(case, count))):
        (folder / f"{name}.csv").write_text(measure_more(case, plan))
        again, _ = shell.diagnose(folder, command, f"{name}.csv")
        result[name] = judge(case.kind, case.causes, case.kin, again).outcome == "right"
        others = reported(found)[1] - {name for name, _ in case.causes}
        result["resolvable"] |= separation(case, plan, others) >= CLEAR
    return result


def separation(case: Case, plan: str, others: set) -> float:
    """Smallest energy that the cause keeps beyond base and each named rival once a plan is measured in addition."""
    both = [case.given, more_conditions(case, plan)[0]]
    lenses = [lens_for(case.setting.world, given, case.noise, base_handles()) for given in both]

    def stacked(handles):
        return np.concatenate([lens.columns(handles) for lens in lenses])

    joint = replace(lenses[0], base=orthonormal(stacked(base_handles()), tolerance=1e-9))
    change = [respond(case.world, given) - respond(case.setting.world, given) for given in both]
    signal = np.concatenate([lens.whiten(part) for lens, part in zip(lenses, change, strict=True)])
    against = [handles for name, _, handles in rivals(case.setting, case.given.time) if name in others]
    return min((joint.remains(signal, stacked(handles)) for handles in against), default=joint.remains(signal))
