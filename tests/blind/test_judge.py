"""The exam itself: answers that dodge must lose, right ones must win."""

import numpy as np
import pytest

from tests.blind.cases import holdout, make_case, random_plan
from tests.blind.exam import separation
from tests.blind.judge import judge
from tests.blind.oracle import oracle_error, rms
from tests.blind.physics import respond
from tests.blind.targets import Rate, rates, report


def found(*names, verdict="cause_found", rivals=(), where=None, remainder=False):
    """A diagnose.json with these causes."""
    causes = [{"name": name, "where": where, "ambiguous_with": list(rivals)} for name in names]
    return {"verdict": verdict, "causes": causes, "remainder": remainder}


ONE = (("geometry", "j3"),)
TWO = (("geometry", "j3"), ("load_com", None))


@pytest.mark.parametrize(
    ("kind", "causes", "kin", "answer", "outcome"),
    [
        ("geometry", ONE, (), found("geometry"), "right"),
        ("geometry", ONE, (), found("geometry", "geometry"), "right"),
        ("geometry", ONE, (), found("load_com"), "wrong"),
        ("geometry", ONE, (), found("load_com", rivals=["geometry@j3"], verdict="ambiguous"), "set"),
        ("geometry", ONE, (), found("geometry", "load_com"), "extra"),
        ("geometry", ONE, (), found(verdict="adequate"), "missed"),
        ("geometry", ONE, (), found(verdict="unexplained"), "unexplained"),
        ("pair:geometry+load_com", TWO, (), found("geometry", "load_com"), "right"),
        ("pair:geometry+load_com", TWO, (), found("geometry"), "partial"),
        ("confounded:load_level", (("load_level", "L1"),), ("load_scale",), found("load_level"), "alone"),
        ("confounded:load_level", (("load_level", "L1"),), ("load_scale",), found("load_scale"), "wrong"),
        (
            *("confounded:load_level", (("load_level", "L1"),), ("load_scale",)),
            *(found("load_scale", rivals=["load_level"], verdict="ambiguous"), "right"),
        ),
        ("outside:hose", (("outside:hose", None),), (), found(verdict="unexplained"), "right"),
        ("outside:hose", (("outside:hose", None),), (), found("geometry", remainder=True), "right"),
        ("outside:hose", (("outside:hose", None),), (), found("geometry"), "wrong"),
        ("clean", (), (), found(verdict="adequate"), "quiet"),
        ("clean", (), (), found("range_noise"), "wrong"),
        ("noise:tails", (), (), found("data_fault"), "quiet"),
        ("below:backlash", (("backlash", "j4"),), (), found(verdict="adequate"), "quiet"),
    ],
)
def test_a_verdict_is_judged(kind, causes, kin, answer, outcome):
    assert judge(kind, causes, kin, answer).outcome == outcome


def test_one_marker_of_the_faulty_pose_is_the_right_place():
    causes = (("data_fault", "P006"),)
    assert judge("fault:swap", causes, (), found("data_fault", where="P006/M2")).place
    assert not judge("fault:swap", causes, (), found("data_fault", where="P007")).place


def exam_of(answer):
    """Outcomes of a tool that gives the same answer to everything."""
    cases = [("clean", (), ()), ("geometry", ONE, ()), ("outside:hose", (("outside:hose", None),), ())]
    outcomes = []
    for kind, causes, kin in 60 * cases:
        verdict = judge(kind, causes, kin, answer)
        group = "single" if kind == "geometry" else kind.partition(":")[0]
        facts = {"kind": kind, "group": group, "causes": causes, "judged": True, "resolvable": True}
        outcomes.append(facts | vars(verdict))
    return outcomes


@pytest.mark.parametrize(
    ("answer", "lost"),
    [
        (found("geometry"), "clean data named"),
        (found("geometry", rivals=["load_com"], verdict="ambiguous"), "right and alone where resolvable"),
        (found(verdict="unexplained", remainder=True), "clean data unexplained"),
        (found(verdict="adequate"), "missed"),
    ],
)
def test_always_the_same_answer_loses(answer, lost):
    text, broken = report(exam_of(answer), alpha=1e-4)
    assert lost in [rate.name for rate in broken]
    assert "BROKEN" in text


def test_a_promise_is_refuted_only_beyond_chance():
    assert not Rate("x", 1, 20, 0.02, least=False).broken(1e-3)
    assert Rate("x", 8, 20, 0.02, least=False).broken(1e-3)
    assert not Rate("x", 0, 0, 0.9, least=True).broken(1e-3)
    np.testing.assert_allclose(Rate("x", 0, 10, 0.9, least=True).bounds(0.05), [0.0, 0.3085], atol=1e-4)
    assert rates([])[0].of == 0


def test_the_oracle_predicts_better_than_the_base_model_and_down_to_the_noise():
    case = make_case(51, "base_compliance", energy=2000.0, free=False)
    _, true, given = holdout(case)
    blind = rms(respond(case.setting.world, given) - true)
    knowing = oracle_error(case, true, given)
    assert knowing < 0.3 * blind
    assert knowing < 60e-6


def test_further_poses_tell_more():
    case = make_case(52, "joint_hardening", energy=100.0)
    few = case.rival[0]
    assert separation(case, random_plan(case, 12), {case.rival[1].partition("@")[0]}) > few
