"""What to measure next: energies against plain least squares, the choice against all subsets, and a case to its end."""

from dataclasses import replace
from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

import doe
from doe.contest import contest, needed_energy
from doe.diagnose_command import run_diagnose
from doe.discriminate import choose, next_poses, separable
from doe.next_visits import named_visits, possible_visits, usual_loads
from doe.remedies import remedy
from identify.diagnosis import diagnose
from identify.diagnosis.library import hypotheses
from identify.diagnosis.search import fitted
from identify.effects import REGISTRY
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.kinematics import forward
from identify.model import model_of
from identify.simulate import simulate
from identify.tables import load_measurements, load_plan, measurements_csv, plan_csv, plan_experiment
from tests.doe.study_files import KR270, study

MODEL = 5  # columns of the model in the small problems
WIDTHS = (2, 1, 3)  # of the cause and its rivals


def small_contest(rng, visits=9, rows=4):
    """Random rows: the model's, and those of a cause and two rivals that resemble it where it was measured."""
    total = sum(WIDTHS)
    base = rng.normal(size=(12, MODEL)), rng.normal(size=(visits, rows, MODEL))
    own = rng.normal(size=(12, total)), rng.normal(size=(visits, rows, total))
    own[0][:, 2] = own[0][:, :2] @ [3.0, -1.0] + 0.2 * own[0][:, 2]
    parts = [SimpleNamespace(own=np.arange(width)) for width in WIDTHS]
    made = contest(
        parts[0], tuple(parts[1:]), np.array([3.0, -1.0]), (base[0], own[0].copy()), (base[1], own[1].copy())
    )
    return made, base, own


def stacked(rows, chosen):
    """The measured rows and those of chosen visits."""
    return np.concatenate([rows[0], rows[1][chosen].reshape(-1, rows[1].shape[2])])


def remaining(signal, columns):
    """Squared length of what least squares leaves."""
    rest = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
    return float(rest @ rest)


@pytest.mark.parametrize("chosen", [[], [3], [0, 4, 7]])
def test_energies_from_normal_matrices_are_those_of_stacked_rows(chosen):
    made, base, own = small_contest(np.random.default_rng(1))
    normal = made.measured + made.possible[chosen].sum(axis=0)
    ends = np.cumsum([0, *WIDTHS])
    where = [slice(a, b) for a, b in pairwise(ends)]
    model, columns, readings = stacked(base, chosen), stacked(own, chosen), stacked(own, [])
    signal = readings[:, where[0]] @ [3.0, -1.0]
    sizes = [np.array([3.0, -1.0])]
    for there in where[1:]:  # a rival has the size at which it imitates the cause best in the readings
        size = np.linalg.lstsq(np.hstack([stacked(base, []), readings[:, there]]), signal, rcond=None)[0]
        sizes.append(size[MODEL:])
    found = made.energies(normal)
    for first, second in combinations(range(3), 2):
        for a, b in ((first, second), (second, first)):
            expected = remaining(columns[:, where[a]] @ sizes[a], np.hstack([model, columns[:, where[b]]]))
            assert found[a, b] == pytest.approx(expected, rel=1e-7, abs=1e-7)
    assert np.isinf(np.diag(found)).all()


def worth(made, chosen):
    """Harmonic sum over pairs and directions, by the definition."""
    energies = made.energies(made.measured + made.possible[list(chosen)].sum(axis=0))
    pairs = ~np.eye(3, dtype=bool)
    return -(made.needed[pairs] / (1.0 + energies[pairs])).sum()


@pytest.mark.parametrize("seed", range(6))
def test_the_choice_is_the_best_of_all_subsets_of_a_few_visits(seed):
    made, _, _ = small_contest(np.random.default_rng(seed))
    able = (~np.eye(3, dtype=bool),)
    chosen = choose((made,), 3, able)
    every = [worth(made, subset) for subset in combinations(range(9), 3)]
    assert len(set(chosen.tolist())) == 3
    assert worth(made, chosen) >= max(every) * (1.0 + 1e-9 if max(every) < 0 else 1.0 - 1e-9)


def test_the_needed_energy_gives_a_test_at_one_per_mille_a_power_of_nine_tenths():
    assert [round(needed_energy(dof)) for dof in (1, 2, 6)] == [21, 24, 31]
    assert ncx2.sf(chi2.isf(1e-3, 3), 3, needed_energy(3)) == pytest.approx(0.9, abs=1e-9)


def test_a_rival_that_coincides_everywhere_is_exact_and_not_separable():
    rng = np.random.default_rng(2)
    base, own = rng.normal(size=(12, 2)), rng.normal(size=(12, 2))
    more, new = rng.normal(size=(9, 4, 2)), rng.normal(size=(9, 4, 2))
    own[:, 1], new[:, :, 1] = 2.0 * own[:, 0] + base[:, 1], 2.0 * new[:, :, 0] + more[:, :, 1]
    parts = [SimpleNamespace(own=np.arange(1), entry=entry) for entry in ("one", "other")]
    made = contest(parts[0], (parts[1],), np.array([10.0]), (base, own), (more, new))
    assert made.dofs[0, 1] == made.dofs[1, 0] == 0
    assert not separable((made,))[0].any()


# --- a diagnosis that one q1 leaves ambiguous, and what resolves it


LOADS = [
    {"id": "L0"},
    {"id": "L1", "mass_kg": 90.0, "attach_mm": [250.0, 80.0, -100.0]},
    {"id": "L2", "mass_kg": 220.0, "attach_mm": [250.0, 80.0, -100.0]},
]
GIVEN = {f"joint_compliance.j{i}": c for i, c in enumerate((0.35, 0.27, 0.38, 2.7, 3.1, 2.2), 1)}
TRUTH = {"base_compliance.base.rx": 0.06, "base_compliance.base.ry": 0.0}
FEW = frozenset(REGISTRY) - {"base_compliance", "load_com", "tool_compliance", "marker_seating"}


def tilting(folder):
    """A KR 270 of unknown masses (only changes between loads count) and its study file."""
    settings = {
        "plan": {"candidates": 200, "poses": 12},
        "loads": LOADS,
        "model": {"nominal": GIVEN},
        "noise": {"reading_mm": 0.06},
    }
    return study(folder, KR270, **settings)


def poses(whole, count, rng, **fixed):
    """Joint values within the limits; some joints at one angle."""
    q = rng.uniform(np.maximum(whole.robot.lower, -2.4), np.minimum(whole.robot.upper, 2.4), (count, 6))
    for name, value in fixed.items():
        q[:, int(name[1:]) - 1] = value
    return q


def measured(whole, experiment, rng, entry="base_compliance@base", values=TRUTH):
    """Readings of a robot with one cause more."""
    model = model_of(replace(whole, effects=(*whole.effects, entry)), nominal={**GIVEN, **values})
    return simulate(model, model.nominal, experiment, whole.noise, np.eye(4), rng)


@pytest.fixture(scope="module")
def ambiguous(tmp_path_factory):
    """A study, readings at one q1, and their diagnosis."""
    whole = tilting(tmp_path_factory.mktemp("tilting"))
    rng = np.random.default_rng(0)
    q = poses(whole, 12, rng, q1=0.3)
    data = measured(whole, full_experiment(q, np.tile([0, 1, 2], (12, 1)), whole.loads, whole.markers), rng)
    return whole, data, diagnose(whole, data, without=FEW)


def joined(whole, data, more, folder):
    """Both sets of readings in one file, read back."""
    texts = [measurements_csv(part, whole) for part in (data, more)]
    path = folder / "both.csv"
    path.write_text(texts[0] + texts[1].partition("\n")[2])
    return load_measurements(path, whole)


def test_the_next_poses_resolve_what_one_base_angle_leaves_ambiguous(ambiguous, tmp_path):
    whole, data, found = ambiguous
    assert found.verdict == "ambiguous"
    (cause,) = found.causes
    names = {cause.hypothesis.entry, *(rival.entry for rival in cause.rivals)}
    assert {"base_compliance@base", "base_compliance@column"} <= names

    following = doe.next_poses(whole, found)
    (pair,) = (p for p in following.separations if {p.cause, p.rival} == set(names))
    assert pair.now < pair.needed < pair.then
    assert pair.separable
    assert not pair.exact

    path = tmp_path / "next.csv"
    path.write_text(plan_csv(following.experiment, whole))
    plan = plan_experiment(load_plan(path, whole), whole)
    assert plan.visits == ("N001", "N002", "N003", "N004")
    assert [whole.loads[load].name for load in plan.shot_load] == ["L0", "L1", "L2"] * 4
    margin = np.deg2rad(2.0) - 1e-9
    assert ((plan.q >= whole.robot.lower + margin) & (plan.q <= whole.robot.upper - margin)).all()

    more = measured(whole, plan, np.random.default_rng(4))
    again = diagnose(whole, joined(whole, data, more, tmp_path), without=FEW)
    assert again.verdict == "cause_found"
    assert [c.hypothesis.entry for c in again.causes] == ["base_compliance@base"]


def test_proposed_poses_carry_more_than_random_ones(ambiguous):
    whole, _, found = ambiguous
    made, possible = contests_of(whole, found)
    chosen = choose(made, 4, separable(made))
    rng = np.random.default_rng(5)

    def reached(index):
        energies = made[0].energies(made[0].measured + made[0].possible[index].sum(axis=0))
        return min(energies[0, 1], energies[1, 0])

    random = [reached(rng.choice(len(possible.visits), 4, replace=False)) for _ in range(40)]
    now = reached(np.zeros(0, dtype=np.int64))
    assert reached(chosen) > max(random)
    assert reached(chosen) - now > 2.0 * (np.mean(random) - now)


def contests_of(whole, found):
    """The contests of a diagnosis on some possible visits."""
    from doe.discriminate import contests

    asked = tuple(h for cause in found.causes for h in (cause.hypothesis, *cause.rivals))
    possible = possible_visits(whole, found.data.experiment, asked, most=128, seed=1)
    return contests(found, found.clean.experiment, possible), possible


def test_the_command_writes_the_plan_and_says_what_it_will_do(ambiguous, tmp_path):
    whole, data, found = ambiguous
    (tmp_path / "measurements.csv").write_text(measurements_csv(data, whole))
    told = run_diagnose(whole.path, tmp_path / "measurements.csv", tmp_path, seed=0, without=tuple(sorted(FEW)))
    assert told.content["next_poses"] == "next_poses.csv"
    assert told.tables["next_poses.csv"] == plan_csv(next_poses(whole, found).experiment, whole)
    first = told.content["separation"][0]
    assert set(first) == {
        "cause", "rival", "energy_now", "energy_then", "energy_needed", "separable", "exact", "advice"
    }  # fmt: skip
    assert first["rival"] in told.content["causes"][0]["ambiguous_with"]
    text = "\n".join(told.lines)
    assert "measure next: the 4 poses of next_poses.csv" in text
    assert f"{first['cause']} against {first['rival']}: energy" in text


def test_names_continue_those_of_earlier_proposals(ambiguous):
    whole, data, found = ambiguous
    again = replace(data.experiment, visits=("N004", "N1000x", *data.experiment.visits[2:]))
    _, possible = contests_of(whole, found)
    assert named_visits(possible, np.array([5, 2]), again).visits == ("N005", "N006")


def test_without_joint_limits_the_reason_is_said_and_nothing_fails(ambiguous):
    whole, _, found = ambiguous
    endless = replace(whole.robot, upper=np.where(np.arange(6) == 5, np.inf, whole.robot.upper))
    search = replace(found.search, study=replace(found.search.study, robot=endless))
    following = next_poses(whole, replace(found, search=search))
    assert following.experiment is None
    assert "no limits are stated" in following.notes[0]
    assert [pair.separable for pair in following.separations] == [None] * len(following.separations)
    with pytest.raises(InputError, match="count = 0"):
        next_poses(whole, found, count=0)


def test_exact_twins_are_reported_with_what_separates_them(ambiguous):
    """The first link that bends and a column that tilts are one and the same spring."""
    whole, data, found = ambiguous
    (cause,) = found.causes
    begin = fitted(found.study, data, differences=True)
    asked = hypotheses(found.study, begin.model, begin)
    (column,) = (h for h in asked if h.entry == "base_compliance@column")
    link = next(h for h in asked if h.entry == "link_compliance@link1" and len(h.own) > 1)
    base = replace(found.study, effects=(*found.study.effects, "base_compliance@column"))
    last = fitted(base, data, differences=True)
    twin = replace(cause, hypothesis=column, rivals=(link,))
    changed = replace(found, search=replace(found.search, study=base, last=last, causes=(twin,)))
    (pair,) = next_poses(whole, changed).separations
    assert pair.exact
    assert pair.separable is False
    assert "reflector on the base" in pair.advice
    assert next_poses(whole, changed).experiment is None


# --- visits as they are measured


def test_new_visits_take_the_loads_of_most_visits_and_what_was_recorded(tmp_path):
    whole = tilting(tmp_path)
    rng = np.random.default_rng(6)
    q = poses(whole, 5, rng)
    e = full_experiment(q, np.tile([0, 2], (5, 1)), whole.loads, whole.markers)
    frames = forward(whole.robot, q)
    weight = np.einsum("vji,j->vi", frames.flange_rotation, [0.0, 0.0, -2000.0])
    wrench = np.zeros((10, 6))
    wrench[1::2, :3] = weight
    e = replace(e, wrench=wrench, approach=np.ones((5, 6)), time=60.0 * e.row_visit, temperature=22.0 + e.row_visit)
    assert usual_loads(e).tolist() == [0, 2]
    new = possible_visits(whole, e, (), most=16, seed=0)
    assert new.shot_load.tolist() == [0, 2] * len(new.visits)
    assert set(np.unique(new.approach)) == {-1.0, 1.0}
    assert new.time.min() == 240.0 + 2 * 60.0
    assert new.start == 0.0  # drift goes on where it was
    assert (new.temperature == 26.0).all()
    there = forward(whole.robot, new.q)
    force = np.einsum("vij,vj->vi", there.flange_rotation, new.wrench[1::2, :3])
    np.testing.assert_allclose(force, np.tile([0.0, 0.0, -2000.0], (len(new.visits), 1)), atol=1e-9)
    assert not new.wrench[::2].any()

    chosen = named_visits(new, np.array([3, 1]), e)
    path = tmp_path / "next.csv"
    path.write_text(plan_csv(chosen, whole))
    back = plan_experiment(load_plan(path, whole), whole)
    np.testing.assert_allclose(back.wrench, new.wrench.reshape(-1, 2, 6)[[3, 1]].reshape(-1, 6), atol=1e-6)
    np.testing.assert_array_equal(back.approach, new.approach[[3, 1]])


def test_every_pair_of_names_has_advice_and_drift_has_it_beside_poses():
    for cause, rival in combinations(REGISTRY, 2):
        assert remedy(cause, rival, False)
        assert remedy(cause, rival, False) == remedy(rival, cause, False) or cause not in remedy(cause, rival, False)
    assert remedy("base_compliance", "link_compliance", True) is None
    assert "floor" in remedy("tracker_drift", "tracker_step", True)
    assert "currents" in remedy("transmission_error", "gravity_compensator", False)
