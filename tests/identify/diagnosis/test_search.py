"""What a search names: planted effects, pairs of them, rivals; what it leaves out again and what it steps over."""

from dataclasses import replace

import numpy as np
import pytest

from identify.diagnosis import search as module
from identify.diagnosis.search import carried, fitted, search, with_causes, with_rivals
from identify.effects import REGISTRY
from identify.errors import NoConvergence
from identify.model import model_of
from tests.identify.diagnosis.cases import (
    COMPLIANCE,
    STEP_S,
    arm,
    conditions,
    entries,
    fit_of,
    library,
    read,
    recorded,
)  # fmt: skip

#: Cause -> hidden parameters and the options that they need.
PLANTED = {
    "joint_hardening@j2": ({"joint_hardening.j2": -4.0}, {}),
    "load_com": ({"load_com.x": 25.0, "load_com.y": -20.0}, {}),
    "base_compliance@base": ({"base_compliance.base.rx": 0.06, "base_compliance.base.ry": 0.04}, {}),
    "tracker_step": (
        {"tracker_step.x": 0.2, "tracker_step.rz": 0.08}, {"tracker_step": {"time_s": 8.5 * STEP_S}},
    ),
    "transmission_error@j4": (
        {"transmission_error.j4.s2": 200.0, "transmission_error.j4.c2": 150.0},
        {"transmission_error": {"orders": [2.0]}},
    ),
    "stiction@j3": ({"stiction.j3": 300.0}, {}),
    "joint_windup@j2": ({"joint_windup.j2.amplitude": 150.0}, {"joint_windup": {"knee_Nm": 600.0}}),
    "approach_hysteresis@j3": ({"approach_hysteresis.j3": 100.0}, {}),
    "thermal_growth": ({"thermal_growth.all": 20.0, "thermal_growth.j2": 10.0}, {}),
    "marker_seating@M2": ({"marker_seating.M2.x": 0.08, "marker_seating.M2.z": -0.06}, {}),
}  # fmt: skip


def searched(study, data, *, gate="holm", **options):
    differences = study.reference == "differences"
    return search(study, data, gate=gate, differences=differences, rng=np.random.default_rng(0), **options)


@pytest.fixture(scope="module")
def study():
    return arm()


@pytest.mark.parametrize("cause", PLANTED)
def test_a_planted_effect_is_named_alone_and_explains_everything(study, cause):
    hidden, options = PLANTED[cause]
    done = searched(study, read(study, recorded(conditions(study, 18, 3)), 4, hidden, options=options))
    assert entries(done.causes) == [cause]
    assert entries(done.causes[0].rivals) == []
    assert done.causes[0].p_value < 1e-3
    assert done.first.chi2 > 1.1 * done.first.dof
    assert done.last.chi2 < done.last.dof + 4 * np.sqrt(2 * done.last.dof)
    known = dict(zip(done.last.model.names, done.last.state.values, strict=True))
    for name, size in hidden.items():
        assert known[name] == pytest.approx(size, rel=0.35, abs=0.02 * abs(size))


def test_the_time_of_a_step_is_found_between_the_right_visits(study):
    hidden, options = PLANTED["tracker_step"]
    done = searched(study, read(study, recorded(conditions(study, 18, 3)), 4, hidden, options=options), rivals=False)
    assert 8 * STEP_S < done.causes[0].hypothesis.options["time_s"] < 9 * STEP_S


def test_the_knee_of_a_windup_is_refined_beyond_the_coarse_values(study):
    hidden, options = PLANTED["joint_windup@j2"]
    done = searched(study, read(study, recorded(conditions(study, 18, 3)), 4, hidden, options=options), rivals=False)
    assert done.causes[0].hypothesis.options["knee_Nm"] == pytest.approx(600.0, rel=0.25)


@pytest.mark.parametrize("gate", ["holm", "flip"])
def test_two_effects_are_both_named(study, gate):
    hidden = {**PLANTED["thermal_growth"][0], **PLANTED["joint_hardening@j2"][0]}
    done = searched(study, read(study, recorded(conditions(study, 30, 5)), 6, hidden), gate=gate, rivals=False)
    assert set(entries(done.causes)) == {"thermal_growth", "joint_hardening@j2"}
    assert done.study.effects == ("joint_compliance", *entries(done.causes))
    assert done.base.effects == ("joint_compliance",)


def test_nothing_is_named_where_nothing_is_missing(study):
    for seed in range(5):
        done = searched(study, read(study, recorded(conditions(study, 18, seed)), seed), rivals=False)
        assert done.causes == ()
        assert done.last is done.first


def test_an_effect_that_is_not_considered_is_not_named(study):
    data = read(study, recorded(conditions(study, 18, 3)), 4, PLANTED["load_com"][0])
    done = searched(study, data, without=frozenset({"load_com"}))
    named = {entry for cause in done.causes for entry in (cause.hypothesis.entry, *entries(cause.rivals))}
    assert "load_com" not in named


@pytest.mark.parametrize(("fixed", "twins"), [({"q1": 0.0}, True), ({}, False)], ids=["one q1", "free q1"])
def test_base_and_column_are_rivals_only_while_the_first_joint_stands_still(fixed, twins):
    """The same hidden tilt under two designs; a base tilt turns with the first joint as seen from the column."""
    study = arm(reference="differences")
    data = read(study, conditions(study, 14, 7, **fixed), 8, {"base_compliance.base.rx": 0.06})
    (cause,) = searched(study, data).causes
    told = {cause.hypothesis.entry, *entries(cause.rivals)}
    assert "base_compliance@base" in told
    assert ("base_compliance@column" in told) == twins


def test_a_rival_explains_what_the_cause_explains(study):
    """The defining property, by refitting: beside the rival the cause adds nothing."""
    data = read(study, conditions(study, 14, 7, q1=0.0), 8, {"base_compliance.base.rx": 0.06})
    done = searched(study, data)
    (cause,) = done.causes
    assert cause.rivals
    for rival in cause.rivals:
        beside = fit_of(with_causes(study, (rival,)), data)
        both = fit_of(with_causes(study, (rival, cause.hypothesis)), data)
        assert beside.chi2 - both.chi2 < 30.0
        assert beside.chi2 < done.first.chi2 - 0.7 * (done.first.chi2 - done.last.chi2)


def test_a_cause_that_a_later_one_makes_superfluous_is_left_out(study):
    data = read(study, recorded(conditions(study, 18, 3)), 4, PLANTED["thermal_growth"][0])
    asked = library(study, fit_of(study, data))
    right = next(h for h in asked if h.entry == "thermal_growth")
    wrong = next(h for h in asked if h.entry == "load_com")
    both = fitted(with_causes(study, (wrong, right)), data, differences=False)
    causes = tuple(module.Cause(h, 1e-4) for h in (wrong, right))
    assert entries(module._needed(both, causes)) == ["thermal_growth"]
    hidden = {**PLANTED["thermal_growth"][0], **PLANTED["load_com"][0]}
    data = read(study, recorded(conditions(study, 18, 3)), 4, hidden)
    both = fitted(with_causes(study, (wrong, right)), data, differences=False)
    assert module._needed(both, causes) == causes


def test_a_candidate_that_cannot_be_fitted_is_stepped_over(study, monkeypatch):
    data = read(study, recorded(conditions(study, 18, 3)), 4, PLANTED["base_compliance@base"][0])
    plain = module.fitted

    def failing(wider, *args, **options):
        if "base_compliance@base" in wider.effects:
            raise NoConvergence("it wanders")
        return plain(wider, *args, **options)

    monkeypatch.setattr(module, "fitted", failing)
    few = frozenset(REGISTRY) - {"base_compliance", "link_compliance", "geometry", "load_com"}
    done = searched(study, data, rivals=False, without=few)
    assert "base_compliance@base" not in entries(done.causes)
    assert done.causes
    assert done.last.chi2 < done.first.chi2


def test_values_carry_over_into_a_larger_model(study):
    data = read(study, conditions(study, 12, 1), 2)
    found = fit_of(study, data)
    larger = model_of(replace(study, effects=(*study.effects, "geometry@j3", "load_com")))
    state = carried(found, larger, len(data.positions), {"load_com.x": 7.0})
    known = dict(zip(larger.names, state.values, strict=True))
    for name, value in zip(found.model.names, found.state.values, strict=True):
        assert known[name] == value
    assert (known["load_com.x"], known["geometry.j3.offset"]) == (7.0, 0.0)
    assert known["joint_compliance.j2"] == pytest.approx(COMPLIANCE["joint_compliance.j2"], rel=0.1)


def test_rivals_do_not_depend_on_when_they_are_looked_for(study):
    data = read(study, conditions(study, 14, 7, q1=0.0), 8, {"base_compliance.base.rx": 0.06})
    at_once, later = searched(study, data), with_rivals(searched(study, data, rivals=False))
    assert [entries(c.rivals) for c in at_once.causes] == [entries(c.rivals) for c in later.causes]


def test_an_implausible_size_is_no_explanation(study):
    """A gear error far beyond what gears have is refused, although nothing fits as well."""
    hidden = {"transmission_error.j4.s2": 2500.0, "transmission_error.j4.c2": 1500.0}
    options = {"transmission_error": {"orders": [2.0]}}
    few = frozenset(REGISTRY) - {"transmission_error", "geometry", "stiction", "load_com"}
    data = read(study, conditions(study, 18, 3), 4, hidden, options=options)
    done = searched(study, data, rivals=False, without=few)
    assert "transmission_error@j4" not in entries(done.causes)


def test_a_cause_that_the_others_replace_leaves_the_answer_and_has_no_rivals(study):
    """Beside the right cause a wrong one explains nothing, so that everything would be its rival."""
    data = read(study, recorded(conditions(study, 18, 3)), 4, PLANTED["thermal_growth"][0])
    first = fit_of(study, data)
    asked = library(study, first)
    right, wrong = (next(h for h in asked if h.entry == name) for name in ("thermal_growth", "load_com"))
    causes = tuple(module.Cause(h, 1e-4) for h in (wrong, right))
    both = with_causes(study, (wrong, right))
    last = fitted(both, data, differences=False)
    done = module.with_rivals(module.Search(both, study, first, last, causes, "holm"))
    assert entries(done.causes) == ["thermal_growth"]
    assert "load_com.x" not in done.last.model.names
    assert done.study.effects == (*study.effects, "thermal_growth")
