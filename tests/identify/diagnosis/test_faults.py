"""Mistakes that people make, planted one at a time in otherwise clean readings."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from identify.diagnosis.edits import Reading, edits
from identify.diagnosis.faults import faults, without_rows
from identify.fit import fit, start
from identify.model import model_of
from tests.identify.diagnosis.cases import arm, conditions, read
from tests.identify.studies import LIGHT, UNLOADED, WEIGHT

VISIT, ROWS = 6, 9  # the visit that is spoilt, and its rows: three loads of three markers


@pytest.fixture(scope="module")
def clean():
    study = arm(loads=(UNLOADED, WEIGHT, LIGHT))
    return study, read(study, conditions(study, 24, 3), 4)


def judged(study, data, limit=25.0):
    """Faults under the model of the study."""
    model = model_of(study)
    return faults(fit(model, data, study.noise, start(model, data)), study.noise, limit=limit)


def told(data, found):
    return [(fault.where(data.experiment), fault.what) for fault in found]


def rows_of(data, *which):
    """Rows of the spoilt visit."""
    return np.flatnonzero(data.experiment.row_visit == VISIT)[list(which) or slice(None)]


def exchanged(one, other, data):
    p = data.positions.copy()
    p[np.concatenate([one, other])] = p[np.concatenate([other, one])]
    return replace(data, positions=p)


def swapped(pairs, data):
    for one, other in pairs:
        data = exchanged(rows_of(data, one), rows_of(data, other), data)
    return data


def multiplied(rows, factor, data):
    p = data.positions.copy()
    p[rows_of(data, *rows)] *= factor
    return replace(data, positions=p)


def reordered(order, data):
    p = data.positions.copy()
    p[rows_of(data)] = p[rows_of(data)][:, order]
    return replace(data, positions=p)


def repeated(data):
    p = data.positions.copy()
    p[rows_of(data)] = p[rows_of(data) - ROWS]
    return replace(data, positions=p)


def shifted(rows, size, data):
    p = data.positions.copy()
    p[rows_of(data, *rows)] += np.random.default_rng(0).normal(0, size, (len(rows_of(data, *rows)), 3))
    return replace(data, positions=p)


def mistyped(change, data):
    q = data.experiment.q.copy()
    change(q[VISIT])
    return replace(data, experiment=replace(data.experiment, q=q))


def relabelled(order, data):
    load, own = data.experiment.shot_load.copy(), np.flatnonzero(data.experiment.shot_visit == VISIT)
    load[own] = load[own][order]
    return replace(data, experiment=replace(data.experiment, shot_load=load))


def in_rad(q):
    q[:] = np.deg2rad(q)


def one_joint(q):
    q[2] += np.deg2rad(5.0)


def other_sign(q):
    q[4] *= -1.0


MISTAKES = {
    "swap in one shot": (partial(swapped, [(3, 4)]), "P007", "swapped markers: M1 and M2 exchanged", [3, 4]),
    "swap in the visit": (
        partial(swapped, [(0, 2), (3, 5), (6, 8)]), "P007", "swapped markers: M1 and M3 exchanged",
        [0, 2, 3, 5, 6, 8],
    ),
    "sign": (partial(multiplied, [4], [1.0, -1.0, 1.0]), "P007/M2", "wrong sign of y", [4]),
    "inch": (partial(multiplied, [], 1 / 25.4), "P007", "inch instead of mm (the whole visit)", range(9)),
    "taken for inch": (partial(multiplied, [2], 25.4), "P007/M3", "mm read as inch", [2]),
    "m": (partial(multiplied, [], 1e-3), "P007", "m instead of mm (the whole visit)", range(9)),
    "columns": (partial(reordered, [1, 0, 2]), "P007", "x and y exchanged (the whole visit)", range(9)),
    "rad": (partial(mistyped, in_rad), "P007", "joint values in rad instead of deg", range(9)),
    "joint": (partial(mistyped, one_joint), "P007", "typing error: joint 3 was at {2:.3f} deg", range(9)),
    "joint sign": (partial(mistyped, other_sign), "P007", "typing error: joint 5 was at {4:.3f} deg", range(9)),
    "loads exchanged": (partial(relabelled, [0, 2, 1]), "P007", "wrong load label: L2 and L1 exchanged", range(3, 9)),
    "load replaced": (partial(relabelled, [0, 1, 1]), "P007", "wrong load label: L1 instead of L2", range(6, 9)),
    "repeated": (repeated, "P007", "repeated row: the readings are those of P006", range(9)),
    "row": (partial(shifted, [5], 0.02), "P007/M3", "gross outlier", [5]),
    "marker": (partial(shifted, [1, 4, 7], 0.02), "P007/M2", "gross outlier", [1, 4, 7]),
    "visit": (partial(shifted, [], 0.05), "P007", "gross outlier: all readings", range(9)),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_in_words_at_its_place_and_nothing_else_is(clean, mistake):
    study, data = clean
    spoil, where, what, rows = MISTAKES[mistake]
    spoilt = spoil(data)
    (found,) = judged(study, spoilt)
    assert found.where(data.experiment) == where
    words, _, value = what.partition("{")
    assert found.what.startswith(words)
    if value:  # the value that was meant, to the accuracy of the readings
        meant = np.rad2deg(data.experiment.q[VISIT, int(value[0])])
        assert float(found.what.removeprefix(words).removesuffix(" deg")) == pytest.approx(meant, abs=0.05)
    assert found.rows.tolist() == rows_of(data, *rows).tolist()
    kept = without_rows(spoilt, (found,))
    assert len(kept.positions) == len(data.positions) - len(found.rows)
    assert judged(study, kept) == ()


def test_the_size_of_a_fault_is_how_far_its_rows_are_off(clean):
    study, data = clean
    p = data.positions.copy()
    p[rows_of(data, 5)] += [0.02, 0.0, 0.0]
    (found,) = judged(study, replace(data, positions=p))
    assert found.size == pytest.approx(0.02, rel=0.02)


def test_two_mistakes_in_two_visits_are_both_named(clean):
    study, data = clean
    both = multiplied([4], [1.0, -1.0, 1.0], data)
    q = both.experiment.q.copy()
    q[15, 2] += 0.1
    found = judged(study, replace(both, experiment=replace(both.experiment, q=q)))
    assert [(where, what[:6]) for where, what in told(data, found)] == [("P007/M2", "wrong "), ("P016", "typing")]


@pytest.mark.parametrize("seed", range(4))
def test_clean_readings_have_no_faults(seed):
    study = arm(loads=(UNLOADED, WEIGHT, LIGHT))
    data = read(study, conditions(study, 24, seed), seed)
    assert judged(study, data) == judged(study, data, 10.0) == ()


def test_a_small_outlier_is_told_once_the_causes_are_known(clean):
    """The limit is wider before: a robot that lacks a cause has such rows too."""
    study, data = clean
    p = data.positions.copy()
    p[rows_of(data, 5)] += [0.6e-3, 0.0, 0.0]
    spoilt = replace(data, positions=p)
    assert judged(study, spoilt, 25.0) == ()
    assert told(data, judged(study, spoilt, 10.0)) == [("P007/M3", "gross outlier")]


def test_where_many_visits_misfit_the_model_is_wrong_and_not_the_rows(clean):
    """A knocked instrument in a third of the visits, large against the noise, and a tilt seen by all."""
    study, data = clean
    p = data.positions.copy()
    late = data.experiment.row_visit >= 16
    p[late, 0] += 0.05
    assert judged(study, replace(data, positions=p)) == ()
    lacking = read(study, data.experiment, 4, {"geometry.j3.offset": 4.0, "geometry.j2.a": 3.0})
    assert judged(study, lacking) == ()


@pytest.mark.parametrize(("visits", "named"), [(range(0, 24, 6), True), (range(0, 24, 3), False)], ids=["4", "8"])
def test_a_slip_in_a_third_of_all_visits_is_none(clean, visits, named):
    """Two markers stand for each other: slips in a few visits, but a wrong study where many are like that."""
    study, data = clean
    p = data.positions.copy()
    for visit in visits:
        rows = np.flatnonzero(data.experiment.row_visit == visit).reshape(-1, 3)
        p[rows[:, [0, 1]]] = p[rows[:, [1, 0]]]
    found = judged(study, replace(data, positions=p))
    assert [fault.visit for fault in found] == (list(visits) if named else [])


def test_an_edit_undone_leaves_what_was_read(clean):
    """Edits of a clean visit make it worse, all of them; its own misfit is that of noise."""
    study, data = clean
    model = model_of(study)
    found = fit(model, data, study.noise, start(model, data))
    reading = Reading(found, study.noise, VISIT)
    assert 0.3 < reading.misfit() < 2.0
    tried = [reading.edited(edit) for edit in edits(reading) if not edit.what.startswith("typing")]
    assert len(tried) > 30
    assert min(tried) > 5.0 * reading.misfit()
