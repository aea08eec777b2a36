"""The accuracy contract: the stated confidence holds in simulated measurements; what cannot be kept is said."""

import re

import numpy as np
import pytest

from doe.accuracy import accuracy
from doe.plan import plan
from identify.errors import Infeasible
from identify.experiment import full_experiment
from identify.identification import identify
from identify.kinematics import forward, jacobian
from identify.model import model_of
from identify.simulate import simulate
from tests.doe.study_files import KR270, study

TRUTH = {"j2": 0.30, "j3": 0.40, "j4": 3.0, "j5": 3.3, "j6": 2.4}
QUIET = {"pose_jitter_urad": 1.0, "reading_jitter_urad": 1.0}


def errors_at_test_poses(whole, found, rng, count):
    """(count, t) distance of the compensated, jittering point from where it is meant, mm; by plain statics."""
    names = found.model.names
    wrong = np.zeros(whole.robot.n)
    for joint, value in TRUTH.items():
        wrong[int(joint[1]) - 1] = 1e-6 * (found.values[names.index(f"joint_compliance.{joint}")] - value)
    errors = []
    for pose in whole.test_poses:
        frames = forward(whole.robot, pose.q[None])
        at_load = jacobian(frames, frames.point(pose.attach[None]))[0]
        at_point = jacobian(frames, frames.point(pose.point[None]))[0, :3]
        jitter = whole.noise.pose_jitter * rng.standard_normal((count, whole.robot.n))
        errors.append(np.linalg.norm((wrong * (at_load.T @ pose.wrench) + jitter) @ at_point.T, axis=1))
    return 1e3 * np.stack(errors, axis=1)


def test_the_stated_confidence_holds_in_simulated_measurements(tmp_path):
    """150 data sets are simulated and identified, and every result is used 40 times at each test pose."""
    settings = {"poses": None, "tolerance_mm": 0.0125, "confidence": 0.9, "candidates": 200}
    whole = study(tmp_path, KR270, plan=settings, noise=QUIET, model={"reference": "differences"})
    made = plan(whole)
    reached = accuracy(whole, made.pool.objective.rows, made.covariance)
    assert reached.radius(0.9) <= 0.0125
    assert reached.rms > 1.5 * np.sqrt(np.trace(reached.jitter, axis1=1, axis2=2).max()), "the fit decides"
    model = model_of(whole)
    values = model.nominal.copy()
    for joint, value in TRUTH.items():
        values[model.names.index(f"joint_compliance.{joint}")] = value
    experiment = full_experiment(made.q, made.visit_loads, whole.loads, whole.markers)
    rng, errors = np.random.default_rng(0), []
    for _ in range(150):
        data = simulate(model, values, experiment, whole.noise, np.eye(4), rng)
        errors.append(errors_at_test_poses(whole, identify(whole, data), rng, 40))
    errors = np.concatenate(errors)
    kept = (errors <= 0.0125).mean(axis=0)
    assert kept.min() > 0.9 - 0.06, "one sigma of 150 data sets is at most 0.025"
    assert (errors <= reached.radius(0.9)).mean(axis=0).min() == pytest.approx(0.9, abs=0.06)
    rms = np.sqrt((errors**2).mean(axis=0) @ reached.weights)
    assert rms == pytest.approx(reached.rms_total, rel=0.12)


def smallest(error):
    """The tolerance that a message names as the smallest."""
    return float(re.search(r"experiments keep is about ([\d.]+) mm", str(error.value))[1])


def test_an_infeasible_tolerance_comes_with_the_smallest_that_can_be_met(tmp_path):
    settings = {"poses": None, "candidates": 60, "refine": False}
    with pytest.raises(Infeasible, match=r"own pose jitter alone gives 0\.075") as jitter:
        plan(study(tmp_path, KR270, plan={**settings, "tolerance_mm": 0.05}))
    assert 0.075 <= smallest(jitter) < 0.0765
    few = {**settings, "candidates": 12, "repeats": False}
    with pytest.raises(Infeasible, match="needs more than 12 experiments") as caught:
        plan(study(tmp_path, KR270, plan={**few, "tolerance_mm": 0.0752}))
    made = plan(study(tmp_path, KR270, plan={**few, "tolerance_mm": 1.001 * smallest(caught)}))
    assert len(made.q) <= 12
