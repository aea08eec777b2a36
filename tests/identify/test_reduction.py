"""The chain of reduction: published counts, invariances, completeness, other robots, the command and what it writes."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_robots import HOOK, REFLECTORS, gantry, kr270, mixed, seven_joints, study_of

from doe.cli import run
from identify.beams import Tube, tube_compliance
from identify.config import load_study
from identify.effects import bind_effects
from identify.errors import InputError, NotIdentifiable
from identify.experiment import full_experiment
from identify.identification import identify
from identify.loads import LoadCase
from identify.model import model_of, without_nuisance
from identify.observation import observation_matrix, probing_loads, random_configurations
from identify.partition import coupled_groups, coupling, partition, select
from identify.reduce_command import reduced_model
from identify.reduction import complete_model, reduce
from identify.reduction_steps import aggregation, sparsing, symmetrisation
from identify.response import respond
from identify.robot_files import load_robot
from identify.simulate import simulate
from identify.summary import identification_json
from identify.transforms import roll_pitch_yaw, translation

STUDY = Path(__file__).parents[2] / "configs" / "studies" / "kr270_complete.toml"

#: Klimchik et al., Table 1.
CHAIN = {"full": 258, "M1": 153, "M2": 62, "M3": 56, "M4": 46, "M5": 26}
G1 = {"link0.k35"}
G2 = {f"link{i}.{k}" for i in (0, 1) for k in ("k11", "k22", "k66", "k26")} | {"link2.k22", "link3.k22"}

#: Beam axis of the base link, force, load point (m): rank and G1, G2, G3 with 3 markers, 2, 1 other, 1 at the load
#: (a lone number is a rank with the groups of the first column).
CONDITIONS = [
    ("x", "loads", (0.3, 0.05, -0.1), (26, 1, 10, 45), 26, 26, 24),
    ("x", "loads", (0.3, 0, -0.1), (25, 1, 10, 45), 24, 25, 22),
    ("x", "loads", (0.2, 0.1, 0), (25, 1, 10, 45), 25, 25, 22),
    ("x", "loads", (0, 0, -0.1), (25, 1, 11, 44), 24, 25, (22, 1, 12, 43)),
    ("x", "loads", (0, 0.1, 0), (25, 1, 11, 44), 25, 25, (22, 1, 12, 43)),
    ("x", "loads", (0, 0, 0), (22, 1, 14, 41), None, 22, (19, 1, 16, 39)),
    ("z", "loads", (0.3, 0.05, -0.1), (27, 2, 9, 45), 27, 27, 25),
    ("z", "loads", (0.3, 0, -0.1), (26, 2, 9, 45), 25, 26, 23),
    ("z", "loads", (0.2, 0.1, 0), (26, 2, 9, 45), 26, 26, 23),
    ("z", "loads", (0, 0, -0.1), (26, 2, 10, 44), 25, 26, (23, 2, 11, 43)),
    ("z", "loads", (0, 0.1, 0), (26, 2, 10, 44), 26, 26, (23, 2, 11, 43)),
    ("z", "loads", (0.3, 0, 0), (23, 2, 11, 43), None, None, 20),
    ("z", "loads", (0, 0, 0), (23, 2, 13, 41), None, 23, (20, 2, 15, 39)),
    ("x", "forces", (0.3, 0.05, -0.1), (32, 2, 0, 54), None, 32, 30),
    ("z", "forces", (0.3, 0.05, -0.1), (32, 2, 0, 54), None, 32, 30),
    ("x", "forces", (0, 0, 0), (28, 2, 4, 50), None, 28, (25, 2, 6, 48)),
    ("z", "forces", (0, 0, 0), (28, 2, 4, 50), None, 28, (25, 2, 6, 48)),
]


@pytest.fixture(scope="module")
def study():
    return study_of(kr270())


@pytest.fixture(scope="module")
def reduction(study):
    return reduce(study)


def short(names):
    return {name.removeprefix("link_compliance.") for name in names}


# ---- published figures


def test_the_published_chain_and_groups(reduction):
    assert reduction.chain == CHAIN
    assert reduction.rank == 26
    assert reduction.partition.counts == (26, 1, 10, 45)
    assert short(reduction.groups["G1"]) == G1
    assert short(reduction.groups["G2"]) == G2
    assert {stage: reduction.ranks[stage] for stage in ("M2", "M3", "M4", "M5")} == dict.fromkeys(
        ("M2", "M3", "M4", "M5"), 26
    )


def test_the_rank_is_told_by_a_wide_gap(reduction):
    last, first = reduction.partition.gap
    assert last > 1e-3
    assert first < 1e-13
    assert first < reduction.partition.tolerance < last


@pytest.mark.parametrize(("beam", "directions", "hook", "three", "two", "other", "there"), CONDITIONS)
def test_every_published_condition(beam, directions, hook, three, two, other, there):
    sets = ((REFLECTORS, three), (REFLECTORS[:2], two), (REFLECTORS[2:], other), ((hook,), there))
    for reflectors, expected in sets:
        if expected is None:
            continue
        wanted = expected if isinstance(expected, tuple) else (expected, *three[1:])
        found = reduce(study_of(kr270(beam), hook=hook, reflectors=reflectors, directions=directions))
        assert found.partition.counts == wanted, (len(reflectors), reflectors)
        assert found.chain["M5"] == wanted[0]


def test_a_wrist_in_pieces_changes_no_count():
    """Forearm 0.9 m and wrist links of 0.2, 0.1 and 0.13 m instead of 1.1, 0, 0 and 0.23 m."""
    robot = kr270("z")
    placements = robot.placements.copy()
    for index, length in ((3, 0.9), (4, 0.2), (5, 0.1), (6, 0.13)):
        placements[index] = _along_world_x(robot, index, length)
    split = replace(robot, placements=placements)
    assert reduce(study_of(split)).partition.counts == (27, 2, 9, 45)


def _along_world_x(robot, index, length):
    """The placement with a translation of this length along world x at zero (and z3 kept)."""
    before = np.eye(3)
    for placement in robot.placements[:index]:
        before = before @ placement[:3, :3]
    placement = robot.placements[index].copy()
    offset = before @ placement[:3, 3]
    offset[0] = length
    placement[:3, 3] = before.T @ offset
    return placement


@pytest.fixture(scope="module")
def levels():
    """15 configurations: five levels of q2, three each, other joints random."""
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (15, 6))
    q[:, 1] = np.repeat(np.radians([-100, -75, -50, -25, -5]), 3)
    return q


def test_model_c1_of_table_2(study, levels):
    found = reduce(study, poses=levels)
    assert found.partition.counts == (26, 1, 10, 45)
    assert found.configurations == 15
    last, first = found.partition.gap
    assert 1e-3 < last < 2e-2
    assert first < 1e-13


def test_model_j1_of_table_2(levels):
    """Rigid links: six joint compliances, of which the first cannot be seen."""
    found = reduce(study_of(kr270(), template=[]), poses=levels)
    assert found.chain == {"full": 258, "M1": 153, "M2": 6, "M3": 6, "M4": 5, "M5": 5}
    assert found.partition.counts == (5, 5, 1, 0)
    assert found.groups["G2"] == ("joint_compliance.j1",)
    assert found.coupled == ()
    assert 0.1 < found.partition.gap[0] < 0.6
    assert found.fate("joint_compliance.j1").startswith("eliminated: not identifiable because vertical loads")


# ---- invariance


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_groups_do_not_depend_on_units_row_order_or_row_scale(seed):
    study, rng = study_of(kr270()), np.random.default_rng(seed)
    model = without_nuisance(model_of(study))
    matrix = observation_matrix(study, model, random_configurations(study, 60, np.random.default_rng(0)))
    changed = matrix[rng.permutation(len(matrix))] * 10.0 ** rng.uniform(-1, 1, matrix.shape[1])
    first, second = partition(matrix), partition(changed * 10.0 ** rng.uniform(-6, 6))
    assert first.counts == second.counts == (26, 1, 10, 45)
    for key in ("identifiable", "invisible", "coupled"):
        np.testing.assert_array_equal(getattr(first, key), getattr(second, key))
    index = first.coupled
    groups = [[list(index[group]) for group in coupled_groups(m[:, index])] for m in (matrix, changed)]
    assert groups[0] == groups[1]


@pytest.mark.parametrize("mount", [(0.3, -0.4, 2.0), (np.pi, 0, 0), (0, np.pi / 2, 0)])
def test_groups_do_not_depend_on_the_base_frame(reduction, mount):
    """The same robot in the same world, with another base frame."""
    robot = kr270()
    turn = roll_pitch_yaw(mount)
    moved = translation(np.array([0.4, -0.2, 0.1]))
    moved[:3, :3] = turn
    placements = robot.placements.copy()
    placements[0] = np.linalg.inv(moved) @ placements[0]
    other = replace(robot, placements=placements, world_R_base=turn, link_rotations=turn.T @ robot.link_rotations)
    found = reduce(study_of(other))
    assert found.chain == reduction.chain
    assert found.groups == reduction.groups
    assert found.kept == reduction.kept
    assert found.coupled == reduction.coupled


def test_other_seeds_and_more_loads_of_the_same_kind_find_the_same(study, reduction):
    heavier = LoadCase("L2", mass=100.0, attach=np.array(HOOK))
    for other, seed in ((study, 5), (replace(study, loads=(*study.loads, heavier)), 2)):
        found = reduce(other, configurations=80, seed=seed)
        assert (found.groups, found.kept, found.coupled) == (reduction.groups, reduction.kept, reduction.coupled)


def test_the_same_seed_gives_the_same_numbers(study):
    one, two = (reduce(study, configurations=40, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.partition.singular_values, two.partition.singular_values)


# ---- completeness


def physical_values(reduction, rng):
    """Random parameters of the full model: symmetric matrices that follow the templates."""
    first, second = reduction.steps[:2]
    return first.expanded(second.expanded(rng.uniform(0.5, 2.0, len(second.after))))


CASES = {
    "kr270": lambda: study_of(kr270()),
    "kr270 beams": lambda: study_of(kr270(), tubes={2: Tube(1.25, 0.3, 0.02), 5: Tube(0.1, 0.2, 0.01)}),
    "upright base": lambda: study_of(kr270("z")),
    "symmetric": lambda: study_of(kr270(), template="symmetric"),
    "eight joints": lambda: study_of(load_robot("sda5f_r1")),
    "seven joints": lambda: study_of(seven_joints()),
    "gantry": lambda: study_of(gantry()),
    "crooked": lambda: study_of(mixed()),
    "forces": lambda: study_of(kr270(), directions="forces"),
    "wrenches on one 6-D target": lambda: study_of(
        kr270(), directions="wrenches", targets="pose", reflectors=REFLECTORS[:1]
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_reduced_and_full_models_predict_the_same_deflections(case):
    study, rng = CASES[case](), np.random.default_rng(8)
    found = reduce(study)
    full = physical_values(found, rng)
    q = random_configurations(study, 30, rng)
    matrix = observation_matrix(study, complete_model(study), q)
    expected = matrix @ full
    kept = found.reduced(full)
    limit = 1e-10 * np.abs(expected).max()
    np.testing.assert_allclose(matrix @ found.expanded(kept), expected, rtol=0, atol=limit)
    values, before = full, matrix
    for step in found.steps:  # every step of the chain by itself
        values = step.reduced(values)
        before = before @ step.expand
        if step.name != "M5":
            np.testing.assert_allclose(before @ values, expected, rtol=0, atol=limit)
    np.testing.assert_allclose(found.reduced(found.expanded(kept)), kept, rtol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_rank_is_kept_and_the_kept_are_independent(case):
    study = CASES[case]()
    found = reduce(study)
    assert len({found.ranks[stage] for stage in ("M2", "M3", "M4", "M5")}) == 1
    assert len(found.kept) == found.rank == len(found.groups["G1"]) + sum(group.rank for group in found.coupled)
    chain = np.eye(len(found.names["full"]))
    for step in found.steps:
        chain = chain @ step.expand
    q = random_configurations(study, 150, np.random.default_rng(0))
    matrix = observation_matrix(study, complete_model(study), q)
    assert partition(matrix @ chain).counts == (found.rank, found.rank, 0, 0)


@pytest.mark.parametrize("tubes", [{}, {2: Tube(1.25, 0.3, 0.02), 5: Tube(0.1, 0.2, 0.01)}])
def test_the_written_model_has_exactly_the_kept_parameters_and_predicts_alike(tubes):
    study = study_of(kr270(), tubes=tubes)
    found = reduce(study)
    tables = reduced_model(study, found)
    lean = replace(study, effects=tuple(tables["effects"]), options={"link_compliance": tables["link_compliance"]})
    model = without_nuisance(model_of(lean))
    assert set(model.names) == set(found.kept)
    full = physical_values(found, np.random.default_rng(4))
    kept = dict(zip(found.kept, found.reduced(full), strict=True))
    q = random_configurations(study, 20, np.random.default_rng(9))
    experiment = full_experiment(q, np.ones((20, 1), dtype=int), study.loads, study.markers)
    values = np.array([kept[name] for name in model.names])
    whole = complete_model(study)
    expected = respond(whole, experiment, full, derivative=False).deflection
    got = respond(model, experiment, values, derivative=False).deflection
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_a_step_that_would_lose_rank_is_refused(study, monkeypatch):
    monkeypatch.setattr("identify.algebraic_steps.select", lambda matrix, order: np.arange(2))
    with pytest.raises(NotIdentifiable, match="step M5 of the reduction would be incomplete") as caught:
        reduce(study)
    assert caught.value.exit_code == 3


# ---- steps


def test_steps_count_and_map_as_published(study):
    names = complete_model(study).names
    first = symmetrisation(names)
    assert (len(names), len(first.after)) == (258, 153)
    assert set(np.unique(first.expand)) == {0.0, 1.0}
    np.testing.assert_array_equal(first.expand.sum(axis=1), 1)
    np.testing.assert_allclose(first.contract @ first.expand, np.eye(153))
    second = sparsing(first.after, {i: ((2, 6), (1, 1)) if i == 2 else ((5, 5),) for i in range(7)})
    assert len(second.after) == 6 + 2 + 6
    assert "link_compliance.link2.k26" in second.after
    joints = [name for name in names if name.startswith("joint")]
    stays = aggregation(second.after, kr270())
    assert set(joints) & set(stays.after) == {f"joint_compliance.j{j}" for j in (1, 3, 4, 6)}


def test_joints_join_the_element_about_their_axis(reduction):
    step = reduction.steps[2]
    holders = {}
    for name in step.removed:
        (row,) = np.flatnonzero(step.contract[:, step.before.index(name)])
        assert step.contract[row, step.before.index(name)] == pytest.approx(1)
        holders[name.partition(".")[2]] = step.after[row].removeprefix("link_compliance.")
    places = ("link0.k66", "link1.k55", "link2.k55", "link3.k44", "link4.k55", "link5.k44")
    assert holders == {f"j{i + 1}": place for i, place in enumerate(places)}


def test_sliding_joints_join_translations_of_the_link_before():
    found = reduce(study_of(gantry()))
    assert found.chain["M2"] == 5 + 6 * 8
    assert found.chain["M3"] == 6 * 8
    assert "merged with link_compliance.link0.k11" in found.fate("joint_compliance.j1")
    assert "merged with link_compliance.link3.k66" in found.fate("joint_compliance.j4")


def test_a_crooked_joint_stays_with_the_beam_and_joins_the_symmetric_matrix():
    beam, whole = reduce(study_of(mixed())), reduce(study_of(mixed(), template="symmetric"))
    assert beam.chain["M3"] == beam.chain["M2"] == 5 + 6 * 8
    assert whole.chain["M3"] == 6 * 21
    assert len(np.flatnonzero(whole.steps[2].contract[:, whole.steps[2].before.index("joint_compliance.j1")])) == 6


@pytest.mark.parametrize(
    ("robot", "full"), [(load_robot("sda5f_r1"), 8 + 9 * 36), (seven_joints(), 7 + 8 * 36)], ids=["eight", "seven"]
)
def test_redundant_arms_are_reduced_too(robot, full):
    found = reduce(study_of(robot))
    links = robot.n + 1
    expected = [full, robot.n + 21 * links, robot.n + 8 * links, 8 * links]
    assert [found.chain[stage] for stage in ("full", "M1", "M2", "M3")] == expected
    assert 0 < found.rank < found.chain["M4"] < found.chain["M3"]
    last, first = found.partition.gap
    assert last / first > 1e6
    assert found.rank <= reduce(study_of(robot, directions="wrenches")).rank


def test_a_6d_target_shows_what_three_markers_show():
    """Rotation rows make one marker as good as three that span a body, also where it sits at the load point."""
    for hook in (HOOK, (0.0, 0.0, 0.0)):
        three = reduce(study_of(kr270(), hook=hook))
        one = reduce(study_of(kr270(), hook=hook, reflectors=(hook,), targets="pose"))
        assert one.partition.counts == three.partition.counts
        assert one.groups == three.groups


def test_measured_wrenches_show_more_than_forces_and_forces_more_than_weight(reduction):
    centred = [reduce(study_of(kr270(), hook=(0, 0, 0), directions=d)) for d in ("loads", "forces", "wrenches")]
    assert [found.rank for found in centred] == sorted({found.rank for found in centred})
    assert [found.rank for found in centred[:2]] == [22, 28]
    forces, wrenches = (reduce(study_of(kr270(), directions=d)) for d in ("forces", "wrenches"))
    assert forces.groups == wrenches.groups  # beside the flange centre a force turns the wrist too
    assert reduction.rank < forces.rank == wrenches.rank
    stated = [LoadCase(f"F{i}", force=f, attach=np.array(HOOK)) for i, f in enumerate(100 * np.eye(3))]
    assert reduce(replace(study_of(kr270()), loads=tuple(stated))).groups == forces.groups
    flange = [replace(load, in_flange=True) for load in stated]
    assert reduce(replace(study_of(kr270()), loads=tuple(flange))).groups == forces.groups


# ---- algebra


@given(
    sizes=st.lists(st.tuples(st.integers(1, 4), st.integers(1, 3)), min_size=1, max_size=4),
    free=st.integers(0, 3),
    zero=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=60)
def test_planted_groups_are_found(sizes, free, zero, seed):
    """Blocks of r directions with r + extra generic columns each, hidden by a shuffle, scales and a rotation."""
    rng = np.random.default_rng(seed)
    rank = sum(r for r, _ in sizes) + free
    rotation = np.linalg.qr(rng.normal(size=(rank + 9, rank + 9)))[0]
    columns, labels, row = [], [], 0
    for label, (r, extra) in enumerate(sizes):
        block = np.linalg.qr(rng.normal(size=(r, r)))[0]
        mix = np.hstack([block, block @ (rng.choice([-1, 1], (r, extra)) * rng.uniform(0.5, 2, (r, extra)))])
        columns += list(np.pad(mix, ((row, rank + 9 - row - r), (0, 0))).T)
        labels += [label] * (r + extra)
        row += r
    columns += [np.eye(rank + 9)[row + i] for i in range(free)] + [np.zeros(rank + 9)] * zero
    labels += [-1] * free + [-2] * zero
    order = rng.permutation(len(labels))
    matrix = rotation @ np.array(columns)[order].T * 10.0 ** rng.uniform(-2, 2, len(labels))
    labels = np.array(labels)[order]
    found = partition(matrix)
    assert found.rank == rank
    np.testing.assert_array_equal(found.identifiable, np.flatnonzero(labels == -1))
    np.testing.assert_array_equal(found.invisible, np.flatnonzero(labels == -2))
    groups = {tuple(found.coupled[g].tolist()) for g in coupled_groups(matrix[:, found.coupled])}
    assert groups == {tuple(np.flatnonzero(labels == label).tolist()) for label in range(len(sizes))}
    visible = np.flatnonzero(labels > -2)
    kept = select(matrix[:, visible], range(len(visible)))
    assert len(kept) == rank
    combined = matrix[:, visible][:, kept] @ coupling(matrix[:, visible], kept)
    np.testing.assert_allclose(combined, matrix[:, visible], atol=1e-9 * np.abs(matrix).max(initial=1e-300))


def test_a_matrix_of_zeros_or_without_rows_shows_nothing():
    assert partition(np.zeros((4, 3))).counts == (0, 0, 3, 0)
    assert partition(np.zeros((0, 3))).counts == (0, 0, 3, 0)
    assert partition(np.zeros((4, 0))).counts == (0, 0, 0, 0)


def test_the_first_of_equals_is_kept_in_the_stated_order():
    matrix = np.array([[1.0, 2.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])
    np.testing.assert_array_equal(select(matrix, [0, 1, 2, 3]), [0, 2])
    np.testing.assert_array_equal(select(matrix, [3, 1, 0, 2]), [1, 3])


# ---- preference and constants


def test_bending_and_joint_like_terms_are_kept_by_default(reduction):
    kept = short(reduction.kept)
    for name in ("link1.k55", "link2.k55", "link3.k44", "link4.k55", "link5.k44"):  # what holds joints 2 to 6
        assert name in kept
    assert not any(name.endswith("k11") for name in kept)


def test_a_stated_preference_is_followed(study):
    prefer = ("link_compliance.link5.k55", "*.k11", "*.link6.k3?")
    found = reduce(replace(study, reduce=replace(study.reduce, prefer=prefer)))
    assert "link_compliance.link5.k55" in found.kept
    assert {"link2.k11", "link6.k33"} <= short(found.kept)
    assert found.rank == 26


def test_a_preference_for_nothing_is_bad_input(study):
    with pytest.raises(InputError, match=r"prefer 'link2.k55'"):
        reduce(replace(study, reduce=replace(study.reduce, prefer=("link2.k55",))))


def test_constants_come_from_the_stated_beam_and_are_zero_elsewhere(study):
    tube = Tube(1.25, 0.3, 0.02)
    found = reduce(replace(study, reduce=replace(study.reduce, tubes={2: tube})))
    assert found.kept == reduce(study).kept
    compliance = tube_compliance(tube)
    assert found.constants["link_compliance.link2.k33"] == pytest.approx(compliance[2, 2] * 1e6)
    assert {name for name, value in found.constants.items() if value} == {
        f"link_compliance.link2.{k}" for k in ("k11", "k26", "k33")
    }
    assert set(found.constants) == {name for group in found.coupled for name in group.fixed}


def test_a_tube_bends_like_a_beam():
    """A steel tube of 1 m, 100 mm outside, wall 10 mm: I = 2.898e-6 m^4, A = 2.827e-3 m^2."""
    compliance = tube_compliance(Tube(1.0, 0.1, 0.01))
    inertia, area, young = 2.8981e-6, 2.8274e-3, 210e9
    assert compliance[0, 0] == pytest.approx(1 / (young * area), rel=1e-4)
    assert compliance[2, 2] == pytest.approx(1 / (3 * young * inertia), rel=1e-4)
    assert compliance[3, 3] == pytest.approx(2.6 / (2 * young * inertia), rel=1e-4)
    np.testing.assert_array_equal(compliance, compliance.T)
    assert (np.linalg.eigvalsh(compliance) > 0).all()
    # Two tubes of half the length in a row deflect like one: k = A k_half A^T + k_half.
    half, arm = tube_compliance(Tube(0.5, 0.1, 0.01)), np.eye(6)
    arm[1, 5], arm[2, 4] = 0.5, -0.5
    np.testing.assert_allclose(arm @ half @ arm.T + half, compliance, rtol=1e-12, atol=1e-20)
    with pytest.raises(InputError, match="thicker"):
        Tube(1.0, 0.1, 0.06)


# ---- fates


@pytest.mark.parametrize("case", ["kr270", "kr270 beams", "crooked", "eight joints"])
def test_every_parameter_of_the_full_model_has_a_fate(case):
    found = reduce(CASES[case]())
    names = found.names["full"]
    assert set(found.fates) == set(names)
    heads = ("kept", "merged with ", "eliminated: ", "fixed to constant ")
    counts = {head: [n for n in names if found.fate(n).startswith(head)] for head in heads}
    assert sum(map(len, counts.values())) == len(names)
    assert counts["kept"] == [n for n in names if n in found.kept]
    assert set(counts["fixed to constant "]) == set(found.constants)
    assert set(counts["merged with "]) == set(found.steps[0].removed) | set(found.steps[2].removed)
    assert set(counts["eliminated: "]) == set(found.steps[1].removed) | set(found.steps[3].removed)


def test_fates_are_told_in_words(reduction):
    assert reduction.fate("link_compliance.link0.k35") == (
        "kept; merged with link_compliance.link0.k53; identifiable by itself"
    )
    assert reduction.fate("link_compliance.link0.k66").startswith("eliminated: not identifiable because no load")
    assert reduction.fate("link_compliance.link2.k12").startswith("eliminated: zero in the template")
    joint = reduction.fate("joint_compliance.j2")
    assert joint.startswith("merged with link_compliance.link1.k55")
    assert "link_compliance.link1.k55: kept; merged with joint_compliance.j2" in joint
    fixed = reduction.fate("link_compliance.link4.k35")
    assert fixed.startswith("fixed to constant 0 urad/N because coupled with link_compliance.link3.k26, link")
    with pytest.raises(InputError, match="no such parameter"):
        reduction.fate("link_compliance.link7.k11")


# ---- study files and the command


def study_file(folder, **changes):
    tables = tomllib.loads(STUDY.read_text(encoding="utf-8"))
    tables["robot"]["model"] = "kr270_2"
    for key, value in changes.items():
        tables[key] = {**tables.get(key, {}), **value} if isinstance(value, dict) else value
    path = folder / "study.toml"
    path.write_text(tomli_w.dumps({k: v for k, v in tables.items() if v is not None}), encoding="utf-8")
    return path


def test_the_shipped_study_gives_the_published_chain(tmp_path, capsys):
    assert run(["reduce", str(STUDY), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    for words in ("full         258", "M5            26", "G1 identifiable (1): link0.k35", "G2 not identifiable (10)"):
        assert words in printed
    content = json.loads((tmp_path / "out" / "reduce.json").read_text())
    assert content["schema"] == 1
    assert content["chain"] == CHAIN
    assert content["groups"] == {"G1": 1, "G2": 10, "G3": 45}
    assert content["rank"] == 26
    assert len(content["parameters"]) == 26
    assert [len(names) for names in content["names"].values()] == list(CHAIN.values())
    assert len(content["fates"]) == 258
    assert content["gap"]["first_dropped"] < content["gap"]["tolerance"] < content["gap"]["last_counted"]
    assert sum(group["rank"] for group in content["coupled_groups"]) == 25
    assert sum(len(group["fixed"]) for group in content["coupled_groups"]) == 20 == len(content["constants"])
    assert run(["reduce", str(STUDY), "--out", str(tmp_path / "again"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == content
    assert (tmp_path / "again" / "reduce.json").read_bytes() == (tmp_path / "out" / "reduce.json").read_bytes()


@pytest.mark.parametrize("beams", [{}, {"link2": {"length_mm": 1250.0, "diameter_mm": 300.0, "wall_mm": 20.0}}])
def test_identification_with_the_reduced_list_is_complete(tmp_path, beams):
    """The tables of reduced.toml put into the study: 26 parameters, all identified, close to the truth."""
    full = study_file(tmp_path, reduce={"beams": beams})
    assert run(["reduce", str(full), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    lean = tomllib.loads((tmp_path / "out" / "reduced.toml").read_text())
    study = load_study(with_model(full, lean["model"]))
    model, rng = model_of(study), np.random.default_rng(2)
    names = [name for name, nuisance in zip(model.names, model.nuisance, strict=True) if not nuisance]
    kept = json.loads((tmp_path / "out" / "reduce.json").read_text())["parameters"]
    assert sorted(names) == sorted(p["name"] for p in kept)
    values = np.where(model.nuisance, 0.0, rng.uniform(0.05, 0.3, len(model.names)))
    q = random_configurations(study, 40, rng)
    experiment = full_experiment(q, np.tile([0, 1], (40, 1)), study.loads, study.markers)
    result = identify(study, simulate(model, values, experiment, study.noise, np.eye(4), rng))
    content = identification_json(result)
    assert content["nonidentifiable"] == []
    found = {p["name"]: p for p in content["parameters"] if not p["nuisance"]}
    assert len(found) == 26
    truth = dict(zip(model.names, values, strict=True))
    assert max(abs(p["value"] - truth[name]) / p["std"] for name, p in found.items()) < 5


def with_model(path, model):
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables["model"] = model
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("changes", "said", "code"),
    [
        ({"model": {"link_compliance": {"template": ["k22", "k26", "k62", "k35"]}}}, "not symmetric", 2),
        ({"model": {"link_compliance": {"link3": {"template": ["k77"]}}}}, "k11 ... k66", 2),
        ({"model": {"link_compliance": {"link9": {"template": "beam"}}}}, "link0 ... link6", 2),
        ({"reduce": {"prefer": ["*.k99"]}}, "no parameter of the full model", 2),
        ({"reduce": {"configurations": 0}}, "configurations", 2),
        ({"reduce": {"targets": "6d"}}, "allowed: position, pose", 2),
        ({"reduce": {"target": "pose"}}, "did you mean 'targets'", 2),
        ({"reduce": {"beams": {"link9": {"length_mm": 1.0, "diameter_mm": 2.0, "wall_mm": 1.0}}}}, "link0, link1", 2),
        ({"reduce": {"beams": {"link2": {"length_mm": 1.0, "diameter_mm": 2.0, "wall_mm": 2.0}}}}, "half of", 2),
        ({"reduce": {"beams": {"link2": {"lenght_mm": 1.0, "diameter_mm": 2.0, "wall_mm": 1.0}}}}, "length_mm", 2),
        ({"loads": [{"id": "L0"}], "plan": None}, "no load loads the robot", 3),
    ],
)
def test_bad_studies_are_refused_with_the_reason(tmp_path, capsys, changes, said, code):
    path = study_file(tmp_path, **changes)
    assert run(["reduce", str(path), "--out", str(tmp_path / "out")]) == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_unit_loads_act_where_the_loads_act(study):
    loads = probing_loads(replace(study, reduce=replace(study.reduce, directions="wrenches")))
    assert len(loads) == 6
    np.testing.assert_allclose([load.attach for load in loads], np.tile(HOOK, (6, 1)))
    np.testing.assert_array_equal([[*load.force, *load.moment] for load in loads], np.eye(6))


def test_configurations_keep_to_the_limits_that_are_known():
    lower, upper = [-1.0, 0.2, -np.inf, -np.inf, -5.0], [1, 0.4, 4, np.inf, np.inf]
    robot = replace(mixed(), lower=np.array(lower), upper=np.array(upper))
    q = random_configurations(study_of(robot), 500, np.random.default_rng(0))
    low, high = np.array([-1, 0.2, -np.pi, -1, -5]), np.array([1, 0.4, 4, 1, np.pi])
    assert ((q >= low) & (q <= high)).all()
    np.testing.assert_allclose(q.min(axis=0), low, atol=0.05 * (high - low).max())
    np.testing.assert_allclose(q.max(axis=0), high, atol=0.05 * (high - low).max())


def test_effects_beside_the_links_stay_in_the_written_list(study):
    other = replace(study, effects=("geometry", "joint_compliance@j2"), nominal={"joint_compliance.j2": 0.3})
    tables = reduced_model(other, reduce(other))
    assert tables["effects"] == ["link_compliance", "geometry"]
    assert bind_effects(("link_compliance",), kr270(), options={"link_compliance": tables["link_compliance"]})
