"""Loads whose mass and attach point are open: settings, what may be hung, and what a plan makes of them."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doe import column_settings, load_settings, off_grid
from doe.candidates import load_choices, sampled_range
from doe.commands import run_evaluate, run_plan
from doe.earlier_files import EarlierFiles
from doe.feasible import check, screen
from doe.hung_frames import Hung
from doe.load_settings import as_hung, setting, shares_of, values_at, values_of, with_setting, with_settings
from doe.moved_loads import fewer_settings, most_settings, move_loads
from doe.open_loads import load_space
from doe.plan import plan
from doe.pool import build_pool
from doe.reach import Reach, region_of
from doe.statics import allowed_mass, carried, overload
from identify.commands import run_simulate
from identify.config import load_study
from identify.errors import InputError
from identify.schema import LoadSection, PlanSection
from identify.two_arm_config import load_two_arm_study
from tests.doe.study_files import KR270, study, study_file
from tests.doe.two_arm_files import write_both

ROOT = Path(__file__).parents[2]
WEIGHT = {"id": "W", "mass_kg": 180.0, "attach_mm": [200.0, 60.0, -120.0], "size_mm": [300.0, 300.0, 300.0]}
RANGES = {"mass_range_kg": [100.0, 250.0], "attach_range_mm": [[150, -100, -150], [300, 100, -50]]}
DIAGRAM = {"payload_diagram": {"distance_mm": [0.0, 250.0, 400.0], "mass_kg": [270.0, 260.0, 120.0]}}
KR = {
    "loads": [
        {"id": "L0"},
        {"id": "F", "mass_kg": 90.0, "cost": 2.0},
        {**WEIGHT, **RANGES, "cost": 3.0, "hang_mm": 300.0},
    ],
    "plan": {"loads": ["F", "W"], "candidates": 40},
    "tool": {"mass_kg": 12.0, "com_mm": [40.0, 0.0, 0.0]},
    "constraints": {**DIAGRAM, "wrist_moment_Nm": [1100.0, 900.0, 500.0]},
}

#: One weight on a planar arm: the further out it hangs, the lighter it must be.
OPEN = {"id": "W", "mass_kg": 20.0, "attach_mm": [100.0, 0.0, 0.0], "mass_range_kg": [5.0, 60.0],
        "attach_range_mm": [[0, 0, 0], [1000, 0, 0]]}  # fmt: skip
PLANAR = {
    "robot": {"model": "planar_2r"},
    "markers": {"M1": [0.0, 0.0, 0.0]},
    "loads": [{"id": "L0"}, OPEN],
    "noise": {"reading_mm": 0.03},
    "frames": {"measurement": "base", "markers": "exact"},
    "model": {"effects": ["joint_compliance"], "reference": "absolute"},
    "test_poses": [{"joints_deg": [20, -50], "wrench": [0, 0, -300, 0, 0, 0]}],
    "plan": {"poses": 1, "reference_rows": False, "candidates": 100, "settings_per_load": 5, "curve": False},
    "constraints": {"self_collision": False, "payload_diagram": {"distance_mm": [0, 1500], "mass_kg": [60, 30]}},
}


def kr270(folder, **changes):
    return study(folder, KR270, **{**KR, **changes})


# --- settings


def test_settings_can_be_hung_and_stand_in_the_place_of_their_load(tmp_path):
    stated = kr270(tmp_path, constraints=DIAGRAM)
    made = with_settings(stated, seed=3)
    names = [f"W.{number + 1}" for number in range(8)]
    assert [load.name for load in made.loads] == ["L0", "F", *names]
    assert made.plan.loads == ("F", *names)
    assert made.load_costs == (0.0, 2.0, *[3.0] * 8)
    values = np.array([values_of(load) for load in made.loads[2:]])
    np.testing.assert_array_equal(values[0], [180.0, 0.2, 0.06, -0.12])
    assert len(np.unique(values, axis=0)) == 8
    span = made.load_ranges["W.4"]
    assert span.of == "W"
    assert ((values >= span.lower) & (values <= span.upper)).all()
    assert carried(made).all()
    np.testing.assert_allclose(values[1:] / [0.1, 0.001, 0.001, 0.001], np.rint(values[1:] / [0.1, 1e-3, 1e-3, 1e-3]))
    heaviest = allowed_mass(made, values[1:, 1:], np.full(7, 100.0), np.full(7, 250.0))
    assert (heaviest - values[1:, 0] < 0.1 + 1e-9).sum() >= 4, "corners hang under the largest mass"
    assert with_settings(study(tmp_path, KR270), seed=0).load_ranges == {}
    again, index = with_setting(made, 5, values[3])
    assert again is made
    assert index == 5, "the same values are the same load"


def test_ids_of_settings_are_free(tmp_path):
    taken = {"id": "W.2", "mass_kg": 20.0}
    made = with_settings(kr270(tmp_path, loads=[taken, {**WEIGHT, **RANGES}], plan={"loads": ["W"]}), seed=0)
    assert len({load.name for load in made.loads}) == len(made.loads) == 10
    assert made.plan.loads[0] == "W..1"


def test_the_largest_mass_that_may_hang_is_found_also_with_a_tool_further_out(tmp_path):
    far = {"mass_kg": 40.0, "com_mm": [600.0, 0.0, 0.0]}
    for tool in (KR["tool"], far):
        made = kr270(tmp_path, tool=tool, constraints=DIAGRAM)
        attach = np.random.default_rng(0).uniform([-0.3] * 3, [0.3] * 3, (40, 3))
        ends = np.full(40, 1.0), np.full(40, 240.0)
        found = allowed_mass(made, attach, *ends)
        every = np.arange(1.0, 240.01, 0.5)
        fine = overload(made, np.tile(every, (40, 1)), np.repeat(attach[:, None], len(every), axis=1)) <= 0.0
        best = np.where(fine, every, 1.0).max(axis=1)
        assert ((found >= best - 1e-6) & (found < best + 0.5)).all()
        assert (found < 240.0).any()


def test_shares_lead_to_values_and_back(tmp_path):
    made = with_settings(kr270(tmp_path), seed=0)
    span = made.load_ranges["W.1"]
    share = np.random.default_rng(1).uniform(size=(30, 4))
    lower, upper = np.tile(span.lower, (30, 1)), np.tile(span.upper, (30, 1))
    values = values_at(made, lower, upper, share)
    np.testing.assert_allclose(shares_of(made, lower, upper, values), share, atol=1e-7)
    hung = as_hung(made, span, values)
    assert (overload(made, hung[:, 0], hung[:, 1:]) <= 0.0).all()
    assert np.abs(hung - values).max(axis=0) == pytest.approx([0.05, 5e-4, 5e-4, 5e-4], rel=2.0)


# --- many loads at once


def test_poses_with_loads_of_their_own_are_checked_as_if_these_were_loads_of_the_study(tmp_path):
    cell = load_study(ROOT / "configs" / "studies" / "kr270_cell.toml")
    rng = np.random.default_rng(0)
    values = rng.uniform([60.0, 0.1, -0.2, -0.2], [270.0, 0.5, 0.2, 0.1], (25, 4))
    base = cell.loads[2]
    cases = tuple(setting(base, f"S{i}", own) for i, own in enumerate(values))
    q, pick = rng.uniform(*sampled_range(cell), (500, 6)), rng.integers(0, 25, 500)
    stated = replace(cell, loads=(cell.loads[0], base))
    hung = np.tile([values_of(load) for load in stated.loads], (500, 1, 1))
    hung[:, 1] = values[pick]
    every = screen(replace(cell, loads=(cell.loads[0], *cases)))
    expected = every.codes(q)[np.arange(500), 1 + pick]
    found = screen(stated).codes(q, Hung(hung[..., 0], hung[..., 1:]))
    np.testing.assert_array_equal(found[:, 1], expected)
    assert len(np.unique(expected)) > 6, "many reasons are met"


def test_a_region_gives_the_blocks_and_the_verdict_of_its_settings(tmp_path):
    made = with_settings(kr270(tmp_path, plan={**KR["plan"], "loads_per_pose": 2}), seed=0)
    pool = build_pool(made, 0)
    kept, space = pool.known.kept, load_space(made, load_choices(made))
    region = region_of(pool.observer, kept, space)
    assert len(space.study.loads) == 3
    rng = np.random.default_rng(2)
    choices = load_choices(made)
    loads = choices[rng.integers(0, len(choices), 60)]
    q = rng.uniform(*sampled_range(made), (60, 6))
    x, choice = np.hstack([q, space.shares(made, loads)]), space.choice_of(made, loads)
    own = pool.observer.blocks(q, loads)[:, :, kept]
    np.testing.assert_allclose(region.blocks(x, choice), own, rtol=1e-6, atol=1e-9)
    ok = check(made, q, loads).ok
    np.testing.assert_array_equal(region.excess(x, choice) <= 0.0, ok)
    assert 0 < ok.sum() < 60


# --- plans


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of one visit, its plan twice, and the folder of the first."""
    folder = tmp_path_factory.mktemp("open")
    path = study_file(folder, PLANAR)
    first, second = (run_plan(path, seed=0, out=folder) for _ in range(2))
    for name, text in first.tables.items():
        (folder / name).write_text(text)
    return folder, first, second


def test_no_mass_and_no_place_on_a_fine_grid_beats_the_plan(made):
    """Two compliances, one visit: everything by hand, with m(d) = 60 - 20 d."""
    _, first, _ = made
    (hung,) = first.content["load_settings"]
    mass, place = hung["mass_kg"], hung["attach_mm"][0] / 1000.0
    assert mass == pytest.approx(60.0 - 20.0 * place, abs=0.1), "at the limit"
    assert 0.2 < place < 0.9, "heavy and near against light and far"

    def value(q, mass, reach):
        angle = np.stack([q[..., 0], q.sum(axis=-1)])
        x, z = np.cos(angle) * [[1.0], [0.8]], np.sin(angle) * [[1.0], [0.8]]
        arms = np.stack([x.sum(axis=0), x[1]]), np.stack([z.sum(axis=0), z[1]])
        torque = 9.80665e-3 * mass * np.stack([arms[0][0] + reach * np.cos(angle[1]), (0.8 + reach) * np.cos(angle[1])])
        columns = np.stack([-arms[1] * torque, arms[0] * torque]) / 0.03  # (2 coordinates, 2 springs, N)
        return np.moveaxis(columns, 2, 0)

    rows = value(np.radians([[20.0, -50.0]]), 300.0 / 9.80665, 0.0)[0] * 0.03
    rng = np.random.default_rng(0)
    place = rng.uniform(0.0, 1.0, 200_000)
    mass = rng.uniform(0.0, 1.0, 200_000) * (55.0 - 20.0 * place) + 5.0
    columns = value(rng.uniform(-np.pi, np.pi, (200_000, 2)), mass, place)
    best = (np.linalg.norm(rows @ np.linalg.inv(columns), axis=(1, 2)) ** 2).min()
    q = np.radians(list(map(float, first.tables["plan.csv"].splitlines()[1].split(",")[2:4])))
    grid = np.linspace(0.0, 1.0, 1001)
    beside = value(np.tile(q, (1001, 1)), 60.0 - 20.0 * grid, grid)
    here = np.linalg.norm(rows @ np.linalg.inv(beside), axis=(1, 2)) ** 2
    found = first.content["criterion"]["value"]
    assert found <= 1.003 * min(best, here.min())
    assert found >= 0.9 * best


def test_a_plan_with_open_loads_is_the_same_every_time_and_better_than_with_nominal_ones(made, tmp_path):
    _, first, second = made
    assert first.tables == second.tables
    np.testing.assert_equal(first.content, second.content)
    assert first.content["efficiency_continuous"] <= first.content["efficiency"] <= 1.0
    fixed = {key: value for key, value in OPEN.items() if "range" not in key}
    nominal = run_plan(study_file(tmp_path, PLANAR, loads=[{"id": "L0"}, fixed]), seed=0, out=tmp_path)
    assert nominal.content["load_settings"] is None
    assert "planned.toml" not in nominal.tables
    assert first.content["criterion"]["value"] < 0.5 * nominal.content["criterion"]["value"]


def test_the_planned_study_gives_the_same_figures_and_runs(made):
    folder, first, _ = made
    assert first.content["chosen_study"] == "planned.toml"
    chosen = tomllib.loads(first.tables["planned.toml"])
    (hung,) = first.content["load_settings"]
    assert chosen["loads"][1:] == [{"id": "W.1", "mass_kg": hung["mass_kg"], "attach_mm": hung["attach_mm"]}]
    assert hung == {"load": "W.1", "of": "W", "visits": 1, **{key: hung[key] for key in ("mass_kg", "attach_mm")}}
    assert "settings_per_load" not in chosen["plan"]
    judged = run_evaluate(folder / "planned.toml", folder / "plan.csv", seed=0).content
    assert judged["criterion"]["value"] == pytest.approx(first.content["criterion"]["value"], rel=1e-9)
    assert judged["visits_rejected"] == {}
    read = run_simulate(folder / "planned.toml", folder / "plan.csv", None, seed=0).tables["measurements.csv"]
    assert "W.1" in read
    with pytest.raises(InputError, match=r"settings that a plan chose stand in its planned\.toml"):
        run_evaluate(folder / "study.toml", folder / "plan.csv", seed=0)
    assert f"hang W.1: {hung['mass_kg']:g} kg" in first.lines[0]


def test_visits_share_moved_loads_which_keep_every_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("doe.polish.ITERATIONS", 15)
    made = with_settings(kr270(tmp_path, plan={"loads": ["W"], "candidates": 60, "settings_per_load": 4}), seed=0)
    pool = build_pool(made, 0)
    reach = Reach(region_of(pool.observer, pool.known.kept, space := load_space(made, load_choices(made))), space, None)
    pick = np.flatnonzero(pool.candidates.visit_loads[:, 1] < 4)[:6]
    q, loads = pool.candidates.visit_q[pick], pool.candidates.visit_loads[pick]
    assert len(np.unique(loads[:, 1])) == 2
    found = move_loads(pool, reach, q, loads)
    after = found.pool.observer.study
    before = pool.objective.value(pool.information(pool.blocks[pick]))
    assert pool.objective.value(pool.information(found.blocks)) < 0.9 * before
    assert after.loads[: len(made.loads)] == made.loads
    assert all(len(np.unique(found.visit_loads[loads == old])) == 1 for old in np.unique(loads))
    assert check(after, found.q, found.visit_loads).ok.all()
    moved = np.array([values_of(after.loads[index]) for index in np.unique(found.visit_loads[:, 1])])
    np.testing.assert_array_equal(as_hung(after, made.load_ranges["W.1"], moved), moved)
    own = pool.observer.blocks(found.q, found.visit_loads, loads=after.loads)[:, :, pool.known.kept]
    np.testing.assert_array_equal(found.blocks, own)


@pytest.mark.parametrize(("most", "left"), [(1.001, 2), (0.0, 3), (np.inf, 1)])
def test_settings_that_gain_hardly_anything_are_not_hung(tmp_path, most, left):
    """Of 40, 39.9 and 20 kg one is worth saving; all may be saved only if it costs nothing that counts."""
    opened = with_settings(study(tmp_path, PLANAR, constraints={"payload_diagram": None}), seed=0)
    indices = []
    for mass in (40.0, 39.9, 20.0):
        opened, index = with_setting(opened, 1, np.array([mass, 0.5 * mass / 40.0, 0.0, 0.0]))
        indices.append(index)
    opened = replace(opened, plan=replace(opened.plan, criterion="A"))
    pool = build_pool(opened, 0)
    q, loads = np.radians([[10.0, 60], [20, 50], [-30, 80], [40, -70]]), np.array(indices)[[0, 0, 1, 2]][:, None]
    before = pool.objective.value(pool.information(pool.observer.blocks(q, loads)[:, :, pool.known.kept]))

    def cost(changed, blocks):
        lighter = (changed == indices[2]).sum() != 1  # as if the light one were needed
        return pool.objective.value(pool.information(blocks)) * (2.0 if lighter else 1.0)

    found = fewer_settings(pool, q, loads, cost, most * before)
    kept = loads if found is None else found[0]
    assert len(np.unique(kept)) == left
    crowded = replace(opened, plan=replace(opened.plan, settings_per_load=1))
    pool = replace(pool, observer=replace(pool.observer, study=crowded))
    assert most_settings(crowded, loads) == 3
    assert most_settings(crowded, fewer_settings(pool, q, loads, cost, 0.0)[0]) == 1


def test_without_a_limit_the_heaviest_weight_furthest_out_is_taken(tmp_path):
    made = plan(study(tmp_path, PLANAR, constraints={"payload_diagram": None}, plan={"candidates": 20}), seed=0)
    (used,) = np.unique(made.visit_loads)
    np.testing.assert_array_equal(values_of(made.pool.observer.study.loads[used]), [60.0, 1.0, 0.0, 0.0])


def measured(folder):
    """Readings of two visits under the nominal load."""
    rows = ["pose,load,q1_deg,q2_deg", "P1,W,10,40", "P2,W,-20,70"]
    (folder / "before.csv").write_text("\n".join(rows) + "\n")
    read = run_simulate(study_file(folder, PLANAR), folder / "before.csv", None, seed=0)
    (folder / "measurements.csv").write_text(read.tables["measurements.csv"])
    return EarlierFiles(measured=folder / "measurements.csv")


@pytest.mark.parametrize(
    "asked",
    [
        {"refine": False},
        {"poses": 3, "robust_to_losses": 1},
        {"poses": None, "cost_budget": 7.0, "pose_cost": 2.0},
        {"poses": None, "tolerance_mm": 0.1, "refine": False},
    ],
    ids=lambda asked: next(reversed(asked)),
)
def test_where_loads_are_not_moved_the_plan_says_so(tmp_path, asked):
    path = study_file(tmp_path, PLANAR, plan={"candidates": 20, **asked})
    made = run_plan(path, seed=0, out=tmp_path).content
    assert any("loads with ranges hang at the settings of the candidates" in note for note in made["notes"])
    assert {one["of"] for one in made["load_settings"]} == {"W"}
    assert sum(one["visits"] for one in made["load_settings"]) == made["poses"] > 0


def test_loads_are_moved_beside_measured_visits_too(tmp_path):
    before = measured(tmp_path)
    path = study_file(tmp_path, PLANAR, plan={"candidates": 20, "poses": 4})
    alone = run_plan(path, seed=0, out=tmp_path).content
    beside = run_plan(path, seed=0, out=tmp_path, before=before).content
    assert beside["criterion"]["value"] < alone["criterion"]["value"]
    assert 0.95 < beside["efficiency_continuous"] <= 1.0
    assert not any("loads with ranges" in note for note in beside["notes"])


# --- bad input, and what the page says


@pytest.mark.parametrize(
    ("table", "asked", "key", "words"),
    [
        ({"mass_range_kg": [60.0, 5.0]}, {}, "mass_range_kg = [60.0, 5.0]", "reversed: the lower end comes first"),
        ({"mass_range_kg": [-1.0, 60.0]}, {}, "mass_range_kg, entry 1 = -1.0", "must be at least 0"),
        ({"mass_range_kg": [0.0, 60.0]}, {}, "mass_range_kg = [0.0, 60.0]", "must begin above 0"),
        ({"mass_range_kg": [30.0, 60.0]}, {}, "mass_range_kg", "must hold the nominal value mass_kg = 20"),
        ({"attach_range_mm": [[0, 0, 0], [1000, 0, -1]]}, {}, "attach_range_mm, z = [0.0, -1.0]", "reversed"),
        ({"attach_range_mm": [[200, 0, 0], [900, 0, 0]]}, {}, "attach_range_mm, x", "attach_mm = 100; widen the range"),
        ({"attach_range_mm": [[0, 0, 0]]}, {}, "attach_range_mm", "2"),
        ({"mass_kg": 0.0}, {"loads": ["V"]}, "mass_range_kg", "W is unloaded, so there is nothing to choose"),
        ({}, {"loads": ["V"]}, "attach_range_mm", "the plan does not choose W; add it to [plan] loads = ['V']"),
        ({}, {"settings_per_load": 0}, "[plan] settings_per_load = 0", "must be above 0"),
    ],
)  # fmt: skip
def test_wrong_ranges_are_named(tmp_path, table, asked, key, words):
    path = study_file(tmp_path, PLANAR, loads=[{"id": "V", "mass_kg": 1.0}, {**OPEN, **table}], plan=asked)
    with pytest.raises(InputError) as caught:
        load_study(path)
    text = str(caught.value)
    assert str(path) in text
    assert key in text
    assert words in text


def test_unknowns_of_single_loads_and_two_arms_take_no_ranges(tmp_path):
    for effect in ("load_level", "load_level@W"):
        with pytest.raises(InputError, match=f"{effect} is an unknown of each single load"):
            plan(study(tmp_path, PLANAR, model={"effects": ["joint_compliance", effect]}), seed=0)
    path = write_both(tmp_path, second={"loads": [{"id": "L0"}, {**OPEN, "id": "L1"}]})
    with pytest.raises(InputError, match="the load L1 has mass_range_kg or attach_range_mm, which only a plan"):
        load_two_arm_study(path)


def test_keys_and_numbers_of_open_loads_are_documented():
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    words = " ".join(text.split())
    for key in ("mass_range_kg", "attach_range_mm", "settings_per_load", "load_settings", "planned.toml"):
        assert f"`{key}`" in text
    assert "mass_range_kg" in LoadSection.model_fields
    usual = PlanSection.model_fields["settings_per_load"].default
    assert f"`settings_per_load` (default {usual}) settings" in words
    assert f"whole {load_settings.MM_STEP:g} mm and {load_settings.KG_STEP:g} kg" in words
    theory = " ".join((ROOT / "docs" / "theory.md").read_text(encoding="utf-8").split())
    assert f"until less than {100 * off_grid._HARDLY:g} % is gained" in theory
    assert f"at least {100 * column_settings._APART:g} % of the ranges apart" in theory
    assert f"costs less than {100 * off_grid._HARDLY:g} %" in words
    for key in ("load", "of", "mass_kg", "attach_mm", "visits"):
        assert f"`{key}`" in words[words.index("`load_settings`") :][:400]
