"""The symbolic block against the exact one, for every shipped robot and for random chains."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from doe.chain import block_function, missing_columns
from doe.floor import floor_points
from doe.observations import identifiable, observer
from doe.refine import refine
from doe.symbolic_arm import heights_function, load_table
from identify.arrays import rotation_of
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.robot_files import load_robot, shipped_robots
from identify.study import Noise, Study, Tracker

MARKERS = Markers(
    names=("m1", "m2", "m3", "floor"),
    positions=np.array([[0.1, 0.0, 0.05], [-0.06, 0.1, 0.05], [-0.06, -0.1, 0.05], [1.0, 0.2, 0.1]]),
    on_base=np.array([False, False, False, True]),
)
LOADS = (
    LoadCase("none"),
    LoadCase("hung", mass=20.0, attach=np.array([0.1, 0.2, 0.1])),
    LoadCase("pulled", 5.0, np.array([0.0, 0.1, 0.2]), np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0])),
    LoadCase("pushed", 0.0, np.array([0.2, 0.0, 0.2]), np.array([9.0, -8.0, 7.0]), np.array([1.0, -2.0, 0.5]), True),
)
PLAIN = Noise(reading=3e-5)
JITTER = Noise(reading=3e-5, pose_jitter=1e-5, reading_jitter=2e-5)
TRACKER = Noise(
    tracker=Tracker(1e-5, 1e-6, 2e-5, 3e-6, np.array([3.0, -1.0, 0.5])), pose_jitter=1e-5, reading_jitter=2e-5
)
BOTH = ("joint_compliance", "geometry")
TILTED = rotation_of(np.array([0.4, -1.1, 0.3]))


def study_of(robot, **changes):
    settings = {"noise": JITTER, "effects": BOTH, "reference": "absolute"} | changes
    return Study(Path("study.toml"), robot, LOADS, MARKERS, **settings)


def poses(robot, count, seed=0):
    span = np.where(robot.prismatic, 0.4, 3.0)
    return np.random.default_rng(seed).uniform(
        np.maximum(robot.lower, -span), np.minimum(robot.upper, span), (count, robot.n)
    )


def visits(count, shots=2):
    loads = np.random.default_rng(1).integers(1, len(LOADS), (count, shots))
    if shots > 1:
        loads[:, 0] = 0
    return loads


def random_chain(seed, joints=5):
    """A robot with turning and sliding joints in no special position, with masses and a tool."""
    rng = np.random.default_rng(seed)
    placements = np.tile(np.eye(4), (joints + 1, 1, 1))
    for placement in placements:
        placement[:3, :3], placement[:3, 3] = rotation_of(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3)
    return Robot(
        name=f"random {seed}",
        joints=tuple(f"j{i + 1}" for i in range(joints)),
        prismatic=rng.random(joints) < 0.5,
        placements=placements,
        lower=np.full(joints, -np.inf),
        upper=np.full(joints, np.inf),
        masses=rng.uniform(1.0, 20.0, joints),
        centres=rng.uniform(-0.2, 0.2, (joints, 3)),
        efforts=np.full(joints, np.nan),
        world_R_base=rotation_of(rng.normal(size=3)),
        tool_mass=3.0,
        tool_centre=np.array([0.0, 0.05, 0.1]),
    )


def both_blocks(study, count=12, shots=2, kept=None):
    """Symbolic and exact blocks (count, k, p) of random visits."""
    watching, q, loads = observer(study), poses(study.robot, count), visits(count, shots)
    exact = watching.blocks(q, loads)
    kept = np.arange(exact.shape[2]) if kept is None else kept
    function = block_function(watching, shots, kept).map(count)
    flat = np.asarray(function(q.T, load_table(study.robot, study.loads)[loads.ravel()].T))
    return flat.reshape(len(kept), count, -1).transpose(1, 2, 0), exact[:, :, kept]


def assert_same_information(symbolic, exact, tolerance=1e-9):
    ours, theirs = (np.einsum("nki,nkj->nij", block, block) for block in (symbolic, exact))
    size = np.sqrt(np.einsum("nii->ni", theirs).max(axis=0))
    size = np.where(size > 0, size, 1.0)
    np.testing.assert_allclose(ours / np.outer(size, size), theirs / np.outer(size, size), rtol=0, atol=tolerance)


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("name", sorted(shipped_robots()))
def test_information_of_every_shipped_robot(name, reference):
    for noise in (PLAIN, JITTER, TRACKER):
        assert_same_information(*both_blocks(study_of(load_robot(name), noise=noise, reference=reference)))


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("free", [True, False])
def test_turns_of_6d_targets(reference, free):
    noise, nominal = replace(TRACKER, orientation=4e-5), {"joint_compliance.j2": 2.0, "geometry.j3.offset": 0.5}
    for robot in (load_robot("sda5f_r1"), random_chain(7)):
        known = {name: value for name, value in nominal.items() if robot.name.startswith("Yaskawa")}
        study = study_of(robot, noise=noise, reference=reference, frame_free=free, markers_fitted=free, nominal=known)
        symbolic, exact = both_blocks(study)
        rows = 3 * (len(MARKERS.names) + 3)
        assert exact.shape[1] == rows * (2 if reference == "absolute" else 1)
        assert_same_information(symbolic, exact, 1e-5)  # forward differences of bending in the exact one


@pytest.mark.parametrize("seed", range(4))
def test_random_chains_with_sliding_joints_masses_and_a_tilted_base(seed):
    robot = random_chain(seed)
    assert_same_information(*both_blocks(study_of(robot, noise=TRACKER)))
    assert_same_information(*both_blocks(study_of(robot, noise=TRACKER, reference="differences"), shots=3))


@pytest.mark.parametrize(
    "effects", [("joint_compliance",), ("joint_compliance@j2", "joint_compliance@j3"), ("geometry",), BOTH]
)
@pytest.mark.parametrize("nuisance", [True, False])
def test_effects_places_frame_and_markers(effects, nuisance):
    robot = replace(load_robot("kr270_r2700"), world_R_base=TILTED)
    study = study_of(robot, effects=effects, frame_free=nuisance, markers_fitted=nuisance)
    for shots in (1, 2, 3):
        assert_same_information(*both_blocks(study, shots=shots))


PAIRS = ("joint_compliance@j2", "link_compliance", "base_compliance", "tool_compliance", "joint_cross_compliance")
EVERY = {
    "link_compliance": {"template": "full"},
    "base_compliance": {"components": ["x", "y", "z", "rx", "ry", "rz"]},
    "tool_compliance": {"components": ["x", "rz"]},
}


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("options", [{}, EVERY], ids=["default", "every"])
@pytest.mark.parametrize("robot", [load_robot("kr270_2"), random_chain(1), random_chain(3, 3)], ids=["kr", "r1", "r3"])
def test_pairs_of_springs_anywhere(robot, options, reference):
    study = study_of(robot, effects=PAIRS, options=options, reference=reference, noise=TRACKER)
    assert missing_columns(observer(study)) == ()
    assert_same_information(*both_blocks(study, count=6))


def test_link_elements_that_are_held_bend_with_geometry_and_markers():
    constants = {"template": ["k11"], "constants": {"link2": {"k55": 30.0, "k26": 20.0}}}
    study = study_of(
        load_robot("ur10"), effects=("link_compliance", "geometry"), options={"link_compliance": constants}
    )
    symbolic, exact = both_blocks(study)
    stiff, _ = both_blocks(replace(study, options={"link_compliance": {"template": ["k11"]}}))
    assert np.abs(symbolic - stiff).max() > 1e-4 * np.abs(exact).max()
    assert_same_information(symbolic, exact, tolerance=1e-5)


def test_the_complete_model_can_be_refined_on_what_one_vertical_load_shows():
    robot = load_robot("kr270_2")
    loads = (LoadCase("L0"), LoadCase("L1", mass=250.0, attach=np.array([0.3, 0.05, -0.1])))
    markers = Markers(
        ("M1", "M2", "M3"), np.array([[0.18, 0, -0.17], [0.25, 0, 0.05], [0.02, 0.09, 0.22]]), np.zeros(3, dtype=bool)
    )
    noise = Noise(reading=3e-5, pose_jitter=1.2e-5, reading_jitter=1.5e-6)
    study = Study(Path("s.toml"), robot, loads, markers, noise, effects=("link_compliance",), reference="differences")
    watching = observer(study)
    q = poses(robot, 80, seed=2)
    kept = identifiable(watching.blocks(q, np.tile([0, 1], (80, 1)))).kept
    assert len(kept) == 26
    lower, upper = robot.lower, robot.upper
    found = refine(watching, q[:15], np.tile([0, 1], (15, 1)), kept, None, criterion="D", lower=lower, upper=upper,
                   max_iterations=15)  # fmt: skip
    assert found.gain > 0.1


def test_the_block_itself_is_the_exact_one_on_kept_columns():
    study = study_of(load_robot("kr270_r2700"), noise=TRACKER)
    exact = observer(study).blocks(poses(study.robot, 40), visits(40))
    symbolic, exact = both_blocks(study, kept=identifiable(exact).kept)
    size = np.abs(exact).max(axis=(0, 1))
    np.testing.assert_allclose(symbolic / size, exact / size, rtol=0, atol=1e-12)


def test_nominal_geometry_and_nominal_compliance():
    robot = load_robot("ur10")
    geometry = {"geometry.j2.a": 2.0, "geometry.j3.offset": 5.0, "geometry.j4.alpha": -3.0, "geometry.j3.beta": 4.0}
    frame = {"frame.x": 3.0, "frame.rz": 8.0, "marker.m2.y": 1.5}
    study = study_of(robot, nominal=geometry | frame)
    assert_same_information(*both_blocks(study))
    soft = {f"joint_compliance.j{j + 1}": 30.0 for j in range(6)}
    markers_known = study_of(robot, effects=("joint_compliance",), markers_fitted=False, nominal=soft)
    assert_same_information(*both_blocks(markers_known))


@pytest.mark.parametrize("name", ["ur10", "kr270_r2700"])
def test_bending_of_soft_robots_agrees_with_differences(name):
    soft = {f"joint_compliance.j{j + 1}": 30.0 for j in range(6)} | {"geometry.j2.a": 2.0}
    study = study_of(load_robot(name), nominal=soft)
    symbolic, exact = both_blocks(study)
    stiff, _ = both_blocks(replace(study, nominal={"geometry.j2.a": 2.0}))
    assert np.abs(symbolic - stiff).max() > 1e-4 * np.abs(exact).max()
    assert_same_information(symbolic, exact, tolerance=1e-5)


@pytest.mark.parametrize("reference", ["absolute", "differences"])
@pytest.mark.parametrize("robot", [load_robot("kr270_2"), random_chain(1)], ids=["kr270_2", "random"])
def test_derivatives_against_finite_differences(robot, reference):
    watching = observer(
        study_of(robot, noise=TRACKER, effects=("joint_compliance",), reference=reference, frame_free=False)
    )
    loads = np.array([[0, 2]])
    kept = np.arange(len(watching.model.parameters))
    q, numbers = ca.SX.sym("q", robot.n), load_table(robot, LOADS)[loads[0]].T
    derivative = ca.Function("derivative", [q], [ca.jacobian(block_function(watching, 2, kept)(q, numbers), q)])
    for pose in poses(robot, 3):
        steps = pose + 1e-5 * np.eye(robot.n)[:, None] * np.array([[1.0], [-1.0]])
        high, low = (
            watching
            .blocks(steps.reshape(-1, robot.n), np.tile(loads, (2 * robot.n, 1)))
            .reshape(robot.n, 2, -1, len(kept))
            .swapaxes(0, 1)
        )
        expected = ((high - low) / 2e-5).reshape(robot.n, -1).T
        found = np.asarray(derivative(pose))  # of the transposed block, column by column: rows of the block in turn
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("robot", [load_robot("kr270_r2700"), random_chain(2)], ids=["kr270", "random"])
def test_heights_are_those_of_the_feasibility_check(robot):
    study = study_of(replace(robot, world_R_base=TILTED))
    points = floor_points(study, (1, 2))
    q = poses(robot, 7)
    function = heights_function(study.robot, points.joints, len(points.local))
    heights = [np.asarray(function(pose, points.local.T)).ravel() for pose in q]
    np.testing.assert_allclose(heights, points.heights(forward(study.robot, q)), rtol=0, atol=1e-12)


def test_an_effect_without_symbolic_columns_is_named():
    watching = observer(study_of(load_robot("planar_2r")))
    assert missing_columns(watching) == ()
    strange = replace(watching.model.effects[0], name="magic")
    other = replace(watching, model=replace(watching.model, effects=(strange,)))
    assert missing_columns(other) == ("magic",)
