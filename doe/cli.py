"""The command line: reads arguments, writes results, prints, and turns errors into exit codes.

Everything heavy is imported inside the command that needs it, so that help answers at once.
"""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

if TYPE_CHECKING:
    from identify.commands import Outcome

__all__ = ["app", "main"]


def _version() -> str:
    """Version of the installed distribution."""
    from importlib.metadata import version

    return version("elastocal")


app = App(
    name="elastocal",
    help="Plan the measurement of a loaded robot, identify its stiffness, predict where it will be.",
    version=_version,
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,
)


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options that every command has.

    Attributes:
        seed: Seed of all random choices; the same seed gives the same bytes.
        json: Print the result as one JSON object on stdout, and nothing else there.
        quiet: No progress on stderr.
        force: Replace results in a folder that is not empty.
    """

    seed: int = 0
    json: Annotated[bool, Parameter(negative="")] = False
    quiet: Annotated[bool, Parameter(negative="")] = False
    force: Annotated[bool, Parameter(negative="")] = False


@Parameter(name="*")
@dataclass(frozen=True)
class Work:
    """Where a plan is worked out; it does not depend on it.

    Attributes:
        workers: Processes of this machine; by default one a core. They are started where the work is worth it.
        scheduler: Address of a Dask scheduler whose workers are used instead, such as tcp://127.0.0.1:8786.
    """

    workers: int | None = None
    scheduler: str | None = None


_DEFAULT = Common()
_HERE = Work()


@app.command
def plan(
    study: Path,
    *,
    out: Path,
    measured: Path | None = None,
    result: Path | None = None,
    earlier: Path | None = None,
    unreachable: tuple[str, ...] = (),
    work: Work = _HERE,
    common: Common = _DEFAULT,
) -> int:
    """Pick the poses and loads to measure, of one arm or of two that face one task.

    Args:
        study: Study file (TOML).
        out: Folder for plan.json and plan.csv; with two arms a plan_<arm>.csv for each.
        measured: What was measured already (CSV); the plan picks what is best beside it.
        result: identify.json or diagnose.json of a first fit, whose values are planned with.
        earlier: The plan that was being measured (CSV).
        unreachable: Poses of it that could not be measured, such as P003,P007; the plan keeps clear of them.
        work: Where it is worked out.
        common: Options that every command has.
    """
    from doe.commands import run_plan
    from doe.earlier_files import EarlierFiles
    from doe.executor import executor_of
    from doe.two_arm_commands import run_plan_for_both
    from identify.two_arm_config import holds_two_arms

    names = tuple(name.strip() for text in unreachable for name in text.split(",") if name.strip())
    before = EarlierFiles(measured, result, earlier, tuple(dict.fromkeys(names)))

    def run() -> Outcome:
        with executor_of(work.workers, work.scheduler) as executor:
            if holds_two_arms(study):
                return run_plan_for_both(study, seed=common.seed, before=before)
            return run_plan(study, seed=common.seed, out=out, before=before, executor=executor)

    return _finish(run, out, common)


@app.command
def evaluate(
    study: Path,
    plan: Path,
    *,
    out: Path,
    measured: Path | None = None,
    result: Path | None = None,
    work: Work = _HERE,
    common: Common = _DEFAULT,
) -> int:
    """Judge any set of poses and loads.

    Args:
        study: Study file (TOML).
        plan: Pose file (CSV): pose, load, q1_deg ... With two arms the folder that holds plan_<arm>.csv of each.
        out: Folder for evaluate.json.
        measured: What was measured already (CSV); the poses are judged beside it.
        result: identify.json or diagnose.json of a first fit, whose values they are judged with.
        work: Where it is worked out.
        common: Options that every command has.
    """
    from doe.commands import run_evaluate
    from doe.earlier_files import EarlierFiles
    from doe.executor import executor_of
    from doe.two_arm_commands import run_evaluate_both
    from identify.two_arm_config import holds_two_arms

    before = EarlierFiles(measured, result)

    def run() -> Outcome:
        with executor_of(work.workers, work.scheduler) as executor:
            if holds_two_arms(study):
                return run_evaluate_both(study, plan, seed=common.seed, before=before)
            return run_evaluate(study, plan, seed=common.seed, before=before, executor=executor)

    return _finish(run, out, common)


@app.command
def simulate(study: Path, plan: Path, *, truth: Path | None = None, out: Path, common: Common = _DEFAULT) -> int:
    """Make measurements from a stated truth.

    Args:
        study: Study file (TOML).
        plan: Pose file (CSV).
        truth: What differs from the study (TOML); by default nothing does.
        out: Folder for simulate.json and measurements.csv.
        common: Options that every command has.
    """
    from identify.commands import run_simulate

    return _finish(lambda: run_simulate(study, plan, truth, seed=common.seed), out, common)


@app.command
def identify(
    study: Path,
    measurements: Path,
    *,
    out: Path,
    compare: Annotated[bool, Parameter(negative="")] = False,
    common: Common = _DEFAULT,
) -> int:
    """Fit the parameters of the study to measurements.

    Args:
        study: Study file (TOML).
        measurements: Measured positions (CSV).
        out: Folder for identify.json.
        compare: Also fit and judge other models: those of [[models]], else joints alone and complete links.
        common: Options that every command has.
    """
    from identify.commands import run_identify

    return _finish(lambda: run_identify(study, measurements, seed=common.seed, compare_models=compare), out, common)


@app.command
def diagnose(
    study: Path,
    measurements: Path,
    *,
    out: Path,
    without: tuple[str, ...] = (),
    common: Common = _DEFAULT,
) -> int:
    """Show what the simulation gets wrong, name the cause, extend the model and measure the gain.

    Args:
        study: Study file (TOML).
        measurements: Measured positions (CSV).
        out: Folder for diagnose.json, the extended study and the poses to measure next.
        without: A cause that is not considered; may be given several times.
        common: Options that every command has.
    """
    from doe.diagnose_command import run_diagnose

    return _finish(lambda: run_diagnose(study, measurements, out, seed=common.seed, without=without), out, common)


@app.command
def predict(study: Path, result: Path, plan: Path, *, out: Path, common: Common = _DEFAULT) -> int:
    """Predict where the markers will be read.

    Args:
        study: Study file (TOML).
        result: identify.json or diagnose.json.
        plan: Pose file (CSV).
        out: Folder for predict.json and predicted.csv.
        common: Options that every command has.
    """
    from identify.commands import run_predict

    return _finish(lambda: run_predict(study, result, plan, seed=common.seed), out, common)


@app.command
def compensate(
    study: Path,
    result: Path,
    targets: Path,
    *,
    out: Path,
    form: Literal["joint", "mirror"] = "joint",
    passes: int = 10,
    extrapolate: Annotated[bool, Parameter(negative="")] = False,
    common: Common = _DEFAULT,
) -> int:
    """Correct the targets of a program for what the arm yields under process wrenches.

    Args:
        study: Study file (TOML).
        result: identify.json or diagnose.json.
        targets: Target file (CSV): target, q1_deg ..., fx_N ... mz_Nm.
        out: Folder for compensate.json and compensated.csv.
        form: joint: joint targets; mirror: mirrored poses, for programs with linear motions.
        passes: Most corrections of each target; 1 is the one-shot form.
        extrapolate: Also compensate targets outside the calibrated poses and loads, and mark them.
        common: Options that every command has.
    """
    from identify.compensate_command import run_compensate

    def run() -> Outcome:
        return run_compensate(
            study, result, targets, seed=common.seed, form=form, passes=passes, extrapolate=extrapolate
        )

    return _finish(run, out, common)


@app.command
def reduce(study: Path, *, out: Path, common: Common = _DEFAULT) -> int:
    """Reduce the complete stiffness model to what the loads and markers of a study can show.

    Args:
        study: Study file (TOML).
        out: Folder for reduce.json and reduced.toml.
        common: Options that every command has.
    """
    from identify.reduce_command import run_reduce

    return _finish(lambda: run_reduce(study, seed=common.seed), out, common)


@app.command
def report(folder: Path, *, common: Common = _DEFAULT) -> int:
    """Write one HTML file, report.html, from the results in a folder.

    Args:
        folder: Folder with diagnose.json or other results.
        common: Options that every command has.
    """
    from doe.report.command import check_report, run_report

    folder = folder.resolve() if folder.is_symlink() else folder
    check_report(folder, common.force)
    return _finish(lambda: run_report(folder), folder, replace(common, force=True))


def _finish(run: Callable[[], Outcome], out: Path, common: Common) -> int:
    """Run a command, write its files and print its summary."""
    from identify.results import check_out, json_text, provenance, write_results

    _log_to_stderr(quiet=common.quiet)
    check_out(out, common.force)
    outcome = run()
    content = {**outcome.content, "provenance": provenance(outcome.inputs, common.seed)}
    text = json_text(content)
    write_results(out, {f"{outcome.command}.json": text, **outcome.tables}, force=common.force)
    if common.json:
        sys.stdout.write(text)
    else:
        sys.stdout.write("\n".join([*outcome.lines, f"written to {out}/{outcome.command}.json"]) + "\n")
    return 0


def _log_to_stderr(*, quiet: bool) -> None:
    log = logging.getLogger("elastocal")
    log.handlers = [logging.StreamHandler(sys.stderr)]
    log.setLevel(logging.ERROR if quiet else logging.INFO)


def main(arguments: list[str] | None = None) -> None:
    """Entry point; exits with 0 done, 1 a fault of ours, 2 bad input, 3 cannot be done as stated."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    from identify.errors import ElastocalError

    try:
        code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        return int(code or 0)
    except CycloptsError as error:
        sys.stderr.write(f"error: {error}\nTry elastocal --help.\n")
        return 2
    except ElastocalError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; nothing was written\n")
        return 130
    except Exception:
        traceback.print_exc()
        sys.stderr.write("error: this is a fault of elastocal, not of your input; please report it\n")
        return 1
