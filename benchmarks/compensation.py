"""Compensation: one sample in a control loop, whole programs, and maps of the workspace."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.clock import line, timed
from identify import load_study
from identify.arrays import Floats
from identify.compensation import compensate
from identify.error_map import error_map, hung_weight, spread_poses
from identify.kinematics import forward, jacobian
from identify.loop_compensator import loop_compensator
from identify.model import model_of
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.study import Study
from identify.tool_response import Arm, Targets, arm_of
from identify.truth import load_truth

STUDIES = Path(__file__).parents[1] / "configs" / "studies"
TRUTH = STUDIES.parent / "truths" / "kr270_complete.toml"


def main() -> None:
    demo = load_study(STUDIES / "kr270.toml")
    eight = replace(demo, robot=load_robot("sda5f_r1"), nominal={})
    loop(soft_arm(eight))
    map_of_workspace(soft_arm(eight))
    for equilibrium in ("linear", "loaded"):
        program(arm_with_spread(replace(demo, equilibrium=equilibrium)), f"joints, {equilibrium}")
    complete = load_study(STUDIES / "kr270_complete.toml")
    truth = load_truth(TRUTH, complete)
    complete = replace(complete, effects=truth.effects, options=truth.options, nominal=truth.values)
    program(arm_with_spread(replace(complete, equilibrium="loaded")), "complete, loaded")


def soft_arm(study: Study) -> Arm:
    """20 urad/Nm in every joint."""
    model = model_of(study, ("joint_compliance",))
    return arm_of(model, np.where(model.nuisance, 0.0, 20.0))


def arm_with_spread(study: Study) -> Arm:
    """The nominal values of a study, known to 2 %."""
    model = model_of(study)
    return arm_of(model, model.nominal, np.diag((0.02 * model.nominal) ** 2))


def loop(arm: Arm) -> None:
    """2000 samples, one after the other."""
    samples, rng = 2000, np.random.default_rng(0)
    compensator = loop_compensator(arm)
    q = spread_poses(arm.model.robot, samples, rng)
    wrench = rng.normal(0, 30.0, (samples, 6))
    times = np.empty(samples)
    for i in range(samples):
        begin = time.perf_counter()
        compensator.correction(q[i], wrench[i])
        times[i] = time.perf_counter() - begin
    median, late = np.quantile(times, [0.5, 0.99]) * 1e3
    line("one sample in the loop, 8 joints", f"{median:.2f} ms, 99 %: {late:.2f} ms", "under 1 ms")


def map_of_workspace(arm: Arm) -> None:
    """Position and orientation error under 5 kg."""
    q = spread_poses(arm.model.robot, 100_000, np.random.default_rng(0))
    _, wall, cpu = timed(lambda: error_map(arm, q, hung_weight(arm.model.robot, 5.0)))
    line("workspace map, 100,000 poses, 8 joints", f"{wall:.2f} s wall {cpu:.2f} s CPU", "under 3 s")


def roomy_poses(robot: Robot, count: int, rng: np.random.Generator) -> Floats:
    """Poses with room to the limits for corrections, the less singular half of twice as many."""
    middle = (robot.lower + robot.upper) / 2
    q = middle + 0.9 * (spread_poses(robot, 2 * count, rng) - middle)
    frames = forward(robot, q)
    weakest = np.linalg.svd(jacobian(frames, frames.flange_origin), compute_uv=False)[:, -1]
    return np.asarray(q[np.argsort(-weakest)[:count]])


def program(arm: Arm, what: str) -> None:
    """A program of 1000 targets under 1.2 kN in any direction."""
    count, rng = 1000, np.random.default_rng(0)
    force = rng.normal(size=(count, 3))
    force *= 1200.0 / np.linalg.norm(force, axis=1, keepdims=True)
    q = roomy_poses(arm.model.robot, count, rng)
    targets = Targets(
        names=tuple(f"T{i}" for i in range(count)),
        q=q,
        wrench=np.hstack([force, np.zeros((count, 3))]),
        in_flange=np.zeros(count, dtype=bool),
        attach=np.tile([0.3, 0.0, 0.0], (count, 1)),
    )
    for form, passes in (("joint", 1), ("joint", 10), ("mirror", 1), ("mirror", 2)):
        found, wall, _ = timed(lambda form=form, passes=passes: compensate(arm, targets, form, passes), repeats=1)
        before, after = (np.linalg.norm(error, axis=1) for error in (found.before, found.residual))
        sizes = f"{1e6 * before.mean():.0f} -> {1e6 * after.mean():.2g} um (max {1e6 * after.max():.2g})"
        line(f"{what}: {form}, {found.passes} passes, {wall:.2f} s", sizes, "")
    _, wall, _ = timed(lambda: found.radius95, repeats=1)
    line(f"{what}: 95 % radii of 1000 targets", f"{wall:.2f} s", "")


if __name__ == "__main__":
    main()
