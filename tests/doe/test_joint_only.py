"""Plans for the complete model: levels of a joint, and what a plan for joint compliances alone is worth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe.candidates import candidates
from doe.joint_only import joint_only
from doe.plan import plan
from identify import load_study

STUDIES = Path(__file__).parents[2] / "configs" / "studies"
LEVELS = [-100.0, -75.0, -50.0, -25.0, -5.0]


def complete(**settings):
    study = load_study(STUDIES / "kr270_complete.toml")
    return replace(study, plan=replace(study.plan, candidates=400, poses=15, refine=False, **settings))


def test_a_plan_for_joints_alone_is_much_worse_for_the_complete_model():
    made = plan(complete())
    simple = joint_only(made)
    assert made.pool.objective.size == 26
    assert simple.rank <= 26
    assert simple.times > 2.0
    assert simple.value == pytest.approx(simple.times * made.grid.value)


def test_a_joint_model_is_not_compared_with_itself():
    study = load_study(STUDIES / "kr270.toml")
    made = plan(replace(study, plan=replace(study.plan, candidates=200, refine=False)))
    assert joint_only(made) is None


def test_candidates_stop_at_the_levels_of_the_compensator():
    study = complete()
    options = {**study.options, "gravity_compensator": {"levels_deg": LEVELS}}
    study = replace(study, effects=(*study.effects, "gravity_compensator@j2"), options=options)
    drawn = candidates(study, seed=0)
    at = np.round(np.degrees(drawn.q[:, 1]), 6)
    assert set(at) == set(LEVELS)
    counts = np.array([(at == level).sum() for level in LEVELS])
    assert counts.min() > 0.3 * counts.max()
    others = np.round(np.degrees(drawn.q[:, 2]), 6)
    assert len(set(others)) > 0.9 * len(others)


def test_the_plan_with_levels_shows_thirty_parameters():
    study = complete()
    options = {**study.options, "gravity_compensator": {"levels_deg": LEVELS}}
    study = replace(study, effects=(*study.effects, "gravity_compensator@j2"), options=options)
    made = plan(study)
    assert made.pool.objective.size == 30
    assert np.isfinite(made.covariance).all()
