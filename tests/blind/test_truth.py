"""The truth of the blind tests against itself, and clean cases against `elastocal identify`."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from tests.blind.arm import place_frames, point_of
from tests.blind.cases import MIX, holdout, make_case, measure_more, random_plan, write_case
from tests.blind.hidden import EFFECTS, OUTSIDE
from tests.blind.physics import World, _balance, respond
from tests.blind.setting import GRAVITY, Noise

HERE = Path(__file__).parent
ELASTOCAL = [sys.executable, "-c", "import sys; from doe.cli import main; sys.exit(main())"]


@pytest.fixture(scope="module")
def case():
    return make_case(11, "clean", free=False, poses=12)


def energy(case, q):
    """Potential energy (N,) of all bodies and of the heaviest load."""
    world, arm = case.setting.world, case.setting.world.arm
    frames = place_frames(arm, q, np.ones((len(q), 7)))
    links = np.einsum("njab,jb->nja", frames.moved[:, :, :3, :3], arm.centre) + frames.moved[:, :, :3, 3]
    height = links[:, :, 2] @ arm.mass + arm.tool_mass * point_of(frames.flange, arm.tool_centre[None])[:, 0, 2]
    hook = point_of(frames.flange, case.given.attach[:1])[:, 0, 2]
    assert world.tracker.shape == (4, 4)
    return GRAVITY * (height + case.given.mass[-1] * hook)


def test_a_joint_turns_by_its_compliance_times_the_slope_of_the_potential_energy(case):
    step, q = 1e-5, case.given.q
    rigid = replace(case.setting.world, compliance=np.zeros(6))
    bare = respond(rigid, case.given, base_frame=True)[:, -1]
    for joint in range(1, 6):
        ahead, back = (q + sign * step * np.eye(6)[joint] for sign in (1, -1))
        torque = -(energy(case, ahead) - energy(case, back)) / (2 * step)
        soft = replace(rigid, compliance=1e-7 * np.eye(6)[joint])
        moved = respond(soft, case.given, base_frame=True)[:, -1] - bare
        nudged = replace(case.given, jitter=np.eye(6)[joint] * step)
        pushed = replace(case.given, jitter=np.eye(6)[joint] * -step)
        slope = respond(rigid, nudged, base_frame=True)[:, -1] - respond(rigid, pushed, base_frame=True)[:, -1]
        expected = 1e-7 * torque[:, None, None] * slope / (2 * step)
        np.testing.assert_allclose(moved, expected, atol=1e-6 * np.abs(expected).max() + 1e-12)


def test_the_spring_beside_joint_2_pulls_by_the_slope_of_its_energy(case):
    world = replace(case.setting.world, balance=1e5)
    q2, step = np.linspace(-2.0, 0.0, 9), 1e-4

    def stored(q2):
        a, radius, angle, free = world.balance_shape
        ends = a * np.array([np.cos(angle), np.sin(angle)])[:, None] + radius * np.array([np.cos(q2), np.sin(q2)])
        return 0.5 * world.balance * (np.linalg.norm(ends, axis=0) - free) ** 2

    pull, rate = _balance(world, q2)
    np.testing.assert_allclose(pull, (stored(q2 + step) - stored(q2 - step)) / (2 * step), rtol=1e-5, atol=1e-3)
    bend = (stored(q2 + step) - 2 * stored(q2) + stored(q2 - step)) / step**2
    np.testing.assert_allclose(rate, bend, rtol=1e-3, atol=1.0)


def test_a_rigid_arm_reads_its_markers_whatever_hangs_on_it(case):
    rigid = replace(case.setting.world, compliance=np.zeros(6))
    read = respond(rigid, case.given)
    np.testing.assert_allclose(read, np.broadcast_to(read[:, :1], read.shape), atol=1e-12)
    frames = place_frames(rigid.arm, case.given.q, np.ones((len(read), 7)))
    seen = (point_of(frames.flange, rigid.marker) - rigid.tracker[:3, 3]) @ rigid.tracker[:3, :3]
    np.testing.assert_allclose(read[:, 0], seen, atol=1e-12)


def test_a_spring_about_a_joint_axis_is_the_compliance_of_that_joint(case):
    rigid = replace(case.setting.world, compliance=np.zeros(6))
    spring = rigid.spring.copy()
    spring[0, 5, 5] = 1e-7  # base, about z, against joint 1 about -z
    jointed = replace(rigid, compliance=1e-7 * np.eye(6)[0])
    given = replace(case.given, wrench=np.tile([100.0, 200, 300, 10, 20, 30], (*case.given.load.shape, 1)))
    np.testing.assert_allclose(respond(replace(rigid, spring=spring), given), respond(jointed, given), atol=1e-12)


def test_a_world_without_faults_has_zeros(case):
    neutral = World(case.setting.world.arm, case.setting.world.marker, case.setting.world.tracker)
    assert not any(np.any(getattr(neutral, name)) for name in ("spring", "cross", "backlash", "seating", "scale"))


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_every_fault_moves_the_readings_as_much_as_was_asked_for(name):
    case = make_case(21, name, poses=15, energy=200.0)
    assert case.causes[0][0] == name
    assert 150.0 < case.energy[0] < 210.0
    moved = respond(case.world, case.given) - respond(case.setting.world, case.given)
    assert np.abs(moved).max() > 1e-6


@pytest.mark.parametrize("kind", MIX)
def test_the_same_seed_gives_the_same_case_and_the_truth_stays_out_of_the_folder(kind, tmp_path):
    folder = write_case(make_case(5, kind, poses=8), tmp_path / "a")
    again = write_case(make_case(5, kind, poses=8), tmp_path / "b")
    other = write_case(make_case(6, kind, poses=8), tmp_path / "c")
    texts = [(f / "measurements.csv").read_text() for f in (folder, again, other)]
    assert texts[0] == texts[1] != texts[2]
    assert sorted(path.name for path in folder.iterdir()) == ["measurements.csv", "robot.toml", "study.toml"]
    words = (folder / "study.toml").read_text() + (folder / "robot.toml").read_text() + texts[0]
    assert not any(name in words for name in [*EFFECTS, "outside", "fault"])


@pytest.mark.parametrize("way", ["plain", "free"])
def test_identify_accepts_clean_data(way, tmp_path):
    p_values = []
    for seed in (31, 32):
        folder = write_case(make_case(seed, "clean", poses=20, free=way == "free"), tmp_path / f"{seed}")
        found = identify(folder)
        assert found["reference"] == "absolute"
        p_values.append(chi2.sf(found["chi2"], found["dof"]))
    assert chi2.sf(-2 * np.log(p_values).sum(), 4) > 1e-3
    assert min(p_values) > 1e-4


def test_identify_finds_a_hidden_tilt_of_the_foundation(tmp_path):
    case = make_case(3, "base_compliance", energy=2000.0, free=False)
    folder = write_case(case, tmp_path / "case")
    blind = identify(folder)
    study = (folder / "study.toml").read_text()
    extended = study.replace('["joint_compliance"]', f'["joint_compliance", "base_compliance@{case.causes[0][1]}"]')
    (folder / "study.toml").write_text(extended)
    seeing = identify(folder)
    assert chi2.sf(blind["chi2"], blind["dof"]) < 1e-6
    assert chi2.sf(seeing["chi2"], seeing["dof"]) > 1e-4


def identify(folder):
    out = folder.parent / f"{folder.name}-out"
    call = [*ELASTOCAL, "identify", folder / "study.toml", folder / "measurements.csv"]
    subprocess.run([*call, "--out", out, "--force", "--quiet"], check=True, capture_output=True)
    return json.loads((out / "identify.json").read_text())


def test_more_poses_are_measured_on_the_same_robot():
    case = make_case(41, "tracker_drift", poses=10)
    text = measure_more(case, random_plan(case, 4))
    rows = text.splitlines()
    assert len(rows) == 1 + (10 + 4) * 4 * 3
    assert len({row.split(",")[0] for row in rows[1:]}) == 14
    plan, true, given = holdout(case, 6)
    assert true.shape == (6, 4, 3, 3)
    assert len(plan.splitlines()) == 1 + 6 * 4
    assert given.time.max() <= case.given.time.max() + 60.0


def test_wrong_noise_scatters_as_it_says():
    quiet, loud = Noise(), Noise(law=(5e-6, 15e-6))
    assert np.all(quiet.spread(np.array([1.0, 5.0, 3.0])) == 30e-6)
    np.testing.assert_allclose(loud.spread(np.array([1.0, 5.0, 3.0])), [20e-6, 80e-6, 50e-6])


def test_the_truth_imports_nothing_of_what_it_judges():
    for path in HERE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] in {"identify", "doe"} for name in names), path.name
