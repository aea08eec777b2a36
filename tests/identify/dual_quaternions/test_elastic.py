"""Torques, deflections and stiffness against the springs, finite differences and the loaded equilibrium."""

from dataclasses import replace

import numpy as np
import pytest
from reference_robots import ARMS, mixed, poses_of

from identify.dual_quaternions import algebra as dq
from identify.dual_quaternions.chain import Postures, dual_chain, forward, postures
from identify.dual_quaternions.elastic import (
    FRAMES,
    apply_wrench,
    cartesian_compliance,
    cartesian_stiffness,
    complementary_stiffness,
    deviation,
    deviation_columns,
    joint_torques,
    twist_jacobian,
)
from identify.dual_quaternions.placements import placed, rotation, transform
from identify.dual_quaternions.screws import DEVIATION_OF_TWIST, TWIST_OF_DEVIATION, dual_vector, exp, twist
from identify.effects import build_scene
from identify.elastic_chain import chain_index
from identify.errors import Infeasible, InputError
from identify.experiment import full_experiment
from identify.kinematics import forward as matrix_forward
from identify.loaded_scene import _loads, _state
from identify.loads import LoadCase, Markers
from identify.robot_files import load_robot
from identify.springs import carry, joint_springs, load_torque, screws

HOOK = np.array([0.32, 0.06, -0.07])
WRENCH = np.array([120.0, -80.0, -300.0, 15.0, -25.0, 40.0])
MARKERS = np.array([[0.3, 0.12, -0.08], [0.02, 0.09, 0.22]])


@pytest.fixture(params=ARMS)
def robot(request):
    return ARMS[request.param]()


def turned(robot, frames, frame):
    """(V, 3), (V, 3) force and moment in the base frame, by matrices."""
    count = len(frames.flange_origin)
    turn = {"base": np.eye(3), "world": robot.world_R_base.T, "flange": frames.flange_rotation}[frame]
    turn = np.broadcast_to(turn, (count, 3, 3))
    return turn @ WRENCH[:3], turn @ WRENCH[3:]


def compliances(robot, seed=4):
    return 1e-6 * np.random.default_rng(seed).uniform(0.2, 2.0, robot.n)


@pytest.mark.parametrize("frame", FRAMES)
def test_torques_are_those_on_the_springs(robot, frame):
    q = poses_of(robot)
    frames, found = matrix_forward(robot, q), postures(dual_chain(robot), q)
    force, moment = turned(robot, frames, frame)
    expected = load_torque(joint_springs(frames), frames.point(HOOK), force, moment)
    ours = joint_torques(found, apply_wrench(found, WRENCH, HOOK, frame=frame))
    np.testing.assert_allclose(ours, expected, atol=1e-10 * np.abs(expected).max())


def test_torques_of_equations_16_to_18_with_the_dual_jacobian(robot):
    """``T F' J`` with the Jacobian of deviations and the F that goes with them."""
    found = postures(dual_chain(robot), poses_of(robot))
    applied = apply_wrench(found, WRENCH, HOOK)
    f = 2.0 * dq.swap(applied.dual)
    np.testing.assert_allclose(
        (f[:, None] @ found.deviation)[:, 0], joint_torques(found, applied), rtol=1e-12, atol=1e-10
    )


def test_virtual_work_of_the_joints_is_that_of_the_flange(robot):
    found, rng = postures(dual_chain(robot), poses_of(robot)), np.random.default_rng(5)
    applied = apply_wrench(found, WRENCH, HOOK)
    turn = rng.normal(size=(len(found.pose), robot.n))
    motion = (turn[:, None] @ found.screws)[:, 0]
    linear, turning = np.split(twist(motion), 2, axis=1)
    work = ((linear + np.cross(turning, applied.point)) @ WRENCH[:3]) + turning @ WRENCH[3:]
    np.testing.assert_allclose((joint_torques(found, applied) * turn).sum(axis=1), work, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(dq.circle(dq.swap(applied.dual), motion), work, rtol=1e-10, atol=1e-9)


def test_a_wrench_is_carried_from_frame_to_frame_as_a_screw_is():
    """In the flange frame the moment is about the flange origin: one product carries it to the base."""
    found = postures(dual_chain(mixed()), poses_of(mixed()))
    local = dual_vector(np.concatenate([WRENCH[3:] + np.cross(HOOK, WRENCH[:3]), WRENCH[:3]]))
    carried = dq.product(dq.product(found.pose, local), dq.conjugate(found.pose))
    applied = apply_wrench(found, WRENCH, HOOK, frame="flange")
    np.testing.assert_allclose(applied.dual, carried, rtol=1e-12, atol=1e-10)


def test_work_does_not_depend_on_the_frame():
    rng = np.random.default_rng(6)
    r = rng.normal(size=4)
    change = placed(r / np.linalg.norm(r), rng.normal(size=3))
    w, s = dual_vector(rng.normal(size=(2, 6)))
    moved = [dq.product(dq.product(change, x), dq.conjugate(change)) for x in (w, s)]
    np.testing.assert_allclose(dq.circle(dq.swap(moved[0]), moved[1]), dq.circle(dq.swap(w), s), rtol=1e-12)


def test_deviations_and_their_columns_are_those_of_the_springs(robot):
    q, soft = poses_of(robot), compliances(robot)
    frames, found = matrix_forward(robot, q), postures(dual_chain(robot), q)
    applied, springs = apply_wrench(found, WRENCH, HOOK), joint_springs(frames)
    torque = load_torque(springs, frames.point(HOOK), *turned(robot, frames, "base"))
    twists = screws(springs) * torque[:, None]
    columns = deviation_columns(found, applied)
    np.testing.assert_allclose(TWIST_OF_DEVIATION @ columns, twists, rtol=1e-10, atol=1e-10 * np.abs(twists).max())
    np.testing.assert_allclose(DEVIATION_OF_TWIST @ twists, columns, rtol=1e-10, atol=1e-10 * np.abs(twists).max())
    moved = deviation(found, soft, applied)
    np.testing.assert_allclose(columns @ soft, moved, rtol=1e-12, atol=1e-18)
    points = np.stack([frames.point(local) for local in MARKERS], axis=1)
    expected = carry((twists @ soft)[..., None], points)[..., 0]
    back = twist(2.0 * moved)
    shift = back[:, None, :3] + np.cross(back[:, None, 3:], points)
    np.testing.assert_allclose(shift, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_the_deviation_is_the_finite_one_to_second_order(robot):
    chain, q, soft = dual_chain(robot), poses_of(robot), compliances(robot)
    found = postures(chain, q)
    gaps = []
    for scale in (1.0, 0.1):
        applied = apply_wrench(found, scale * WRENCH, HOOK)
        bent = forward(chain, q + joint_torques(found, applied) * soft)
        whole = dq.canonical(dq.product(bent, dq.conjugate(found.pose))) - dq.IDENTITY
        gaps.append(np.abs(whole - deviation(found, soft, applied)).max())
        assert gaps[-1] < 2e-3 * np.abs(whole).max()
    assert gaps[1] < 0.02 * gaps[0]


@pytest.mark.parametrize("frame", FRAMES)
def test_complementary_stiffness_is_the_slope_of_the_torque(robot, frame):
    chain, q, step = dual_chain(robot), poses_of(robot), 1e-6

    def torque(values):
        bent = postures(chain, values)
        return joint_torques(bent, apply_wrench(bent, WRENCH, HOOK, frame=frame))

    found = postures(chain, q)
    slope = complementary_stiffness(found, apply_wrench(found, WRENCH, HOOK, frame=frame))
    for j, nudge in enumerate(step * np.eye(robot.n)):
        expected = (torque(q + nudge) - torque(q - nudge)) / (2 * step)
        np.testing.assert_allclose(slope[:, :, j], expected, atol=1e-6 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("in_flange", [False, True])
@pytest.mark.parametrize("name", ["sda5f_r1", "mixed"])
def test_complementary_stiffness_is_that_of_the_loaded_equilibrium(name, in_flange):
    robot, q = ARMS[name](), poses_of(ARMS[name](), 6)
    load = LoadCase("L1", force=WRENCH[:3], moment=WRENCH[3:], attach=HOOK, in_flange=in_flange)
    markers = Markers(("M1", "M2"), MARKERS, np.zeros(2, dtype=bool))
    experiment = full_experiment(q, np.zeros((6, 1), dtype=int), (load,), markers)
    scene = build_scene(experiment, matrix_forward(robot, q), MARKERS, self_weight=False)
    state = _state(scene, _loads(experiment, robot), q, np.zeros((6, robot.n)), chain_index(robot.n, "joints"))
    found = postures(dual_chain(robot), q)
    ours = complementary_stiffness(found, apply_wrench(found, WRENCH, HOOK, frame="flange" if in_flange else "world"))
    np.testing.assert_allclose(ours, state.slope, rtol=1e-10, atol=1e-10 * np.abs(state.slope).max())


def test_complementary_stiffness_of_a_force_is_symmetric():
    """A constant force has a potential, a constant moment has none."""
    found = postures(dual_chain(load_robot("sda5f_r1")), poses_of(load_robot("sda5f_r1")))
    of_force = complementary_stiffness(found, apply_wrench(found, WRENCH * [1, 1, 1, 0, 0, 0], HOOK))
    np.testing.assert_allclose(of_force, of_force.swapaxes(1, 2), atol=1e-9)
    of_both = complementary_stiffness(found, apply_wrench(found, WRENCH, HOOK))
    assert np.abs(of_both - of_both.swapaxes(1, 2)).max() > 1.0


def test_cartesian_compliance_is_how_a_point_moves_under_a_little_more_load():
    """At the equilibrium under the first wrench, found by iteration; K - K_c, not K, is the stiffness there."""
    robot = load_robot("sda5f_r1")
    chain, soft = dual_chain(robot), 2e-4 * np.linspace(0.5, 1.5, robot.n)
    q0 = poses_of(robot, 5)

    def settled(wrench):
        q = q0
        for _ in range(60):
            bent = postures(chain, q)
            q = q0 + soft * joint_torques(bent, apply_wrench(bent, wrench, HOOK))
        return postures(chain, q)

    loaded = settled(WRENCH / 5)
    applied = apply_wrench(loaded, WRENCH / 5, HOOK)
    ours = cartesian_compliance(loaded, soft, applied, HOOK)
    plain = cartesian_compliance(loaded, soft, point=HOOK)
    for k, extra in enumerate(1e-3 * np.eye(6)):
        more, less = settled(WRENCH / 5 + extra), settled(WRENCH / 5 - extra)
        shift = transform(more.pose, HOOK) - transform(less.pose, HOOK)
        turn = rotation(dq.product(more.pose, dq.conjugate(less.pose)))
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        slope = np.concatenate([shift, spin], axis=1) / 2e-3
        np.testing.assert_allclose(ours[:, :, k], slope, rtol=1e-6, atol=1e-6 * np.abs(ours).max())
        assert np.abs(plain[:, :, k] - slope).max() > 1e-4 * np.abs(slope).max()


def test_cartesian_stiffness_is_its_inverse_and_refused_where_there_is_none():
    robot = load_robot("sda5f_r1")
    found, soft = postures(dual_chain(robot), poses_of(robot)), compliances(robot)
    product = cartesian_stiffness(found, soft, point=HOOK) @ cartesian_compliance(found, soft, point=HOOK)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-6)
    moves = twist_jacobian(found, HOOK)
    np.testing.assert_allclose(
        cartesian_compliance(found, soft, point=HOOK),
        moves @ np.diag(soft) @ moves.swapaxes(1, 2),
        rtol=1e-12,
        atol=1e-18,
    )
    with pytest.raises(Infeasible, match="pose 0 of 20: the arm does not yield in every direction"):
        cartesian_stiffness(found, soft * [1, 1, 1, 1, 1, 0, 0, 0])
    five = mixed()
    with pytest.raises(Infeasible, match="fewer than six"):
        cartesian_stiffness(postures(dual_chain(five), poses_of(five)), compliances(five))


def test_the_last_joint_of_the_sda5f_sees_no_moment_of_a_mass_on_its_axis():
    for name in ("sda5f_r1", "sda5f_r2"):
        robot = load_robot(name)
        found = postures(dual_chain(robot), poses_of(robot, 200))
        hung = apply_wrench(found, [0, 0, -49.0, 0, 0, 0], [0.0, 0.0, 0.1], frame="world")
        torque, columns = joint_torques(found, hung), deviation_columns(found, hung)
        assert np.abs(torque[:, 7]).max() < 1e-12 * np.abs(torque).max()
        assert np.abs(columns[:, :, 7]).max() < 1e-12 * np.abs(columns).max()
        beside = apply_wrench(found, [0, 0, -49.0, 0, 0, 0], [0.05, 0.0, 0.1], frame="world")
        assert np.abs(joint_torques(found, beside)[:, 7]).max() > 1.0


def test_nothing_changes_with_the_sign_of_the_dual_quaternions(robot):
    found = postures(dual_chain(robot), poses_of(robot))
    other = replace(found, pose=-found.pose)
    soft = compliances(robot)
    for frame in FRAMES:
        one, two = (apply_wrench(p, WRENCH, HOOK, frame=frame) for p in (found, other))
        np.testing.assert_allclose(one.dual, two.dual, rtol=1e-14, atol=1e-12)
        np.testing.assert_allclose(joint_torques(found, one), joint_torques(other, two), rtol=1e-14, atol=1e-12)
        np.testing.assert_allclose(deviation(found, soft, one), deviation(other, soft, two), rtol=1e-13, atol=1e-16)
        slopes = [complementary_stiffness(p, w) for p, w in ((found, one), (other, two))]
        np.testing.assert_allclose(*slopes, rtol=1e-13, atol=1e-10)


def test_noise_of_a_twist_is_carried_to_the_deviation_and_back():
    """The maps keep a covariance: of a twist exactly, and the exact deviation differs in second order only."""
    rng = np.random.default_rng(8)
    root = rng.normal(size=(6, 6)) * 1e-5
    covariance = root @ root.T
    there = DEVIATION_OF_TWIST @ covariance @ DEVIATION_OF_TWIST.T
    np.testing.assert_allclose(TWIST_OF_DEVIATION @ there @ TWIST_OF_DEVIATION.T, covariance, rtol=1e-14)
    assert not there[[0, 4]].any()
    sample = rng.normal(size=(20000, 6)) @ root.T
    seen = exp(0.5 * dual_vector(sample)) - dq.IDENTITY
    np.testing.assert_allclose(np.cov(seen.T), there, atol=0.05 * np.abs(there).max())
    assert np.abs(seen[:, [0, 4]]).max() < 1e-8


def test_bad_wrenches_are_named():
    robot = load_robot("ur10")
    found = postures(dual_chain(robot), poses_of(robot, 3))
    with pytest.raises(InputError, match="frame = 'sensor': a wrench can be given in base, world, flange"):
        apply_wrench(found, WRENCH, frame="sensor")
    for empty in (np.zeros((0, 6)), np.zeros(0), []):
        with pytest.raises(InputError, match="no wrench: an array of shape"):
            apply_wrench(found, empty)
    with pytest.raises(InputError, match=r"wrench of shape \(2, 6\): \(6,\) or \(3, 6\) expected"):
        apply_wrench(found, np.zeros((2, 6)))
    with pytest.raises(InputError, match=r"attach point of shape \(2,\)"):
        apply_wrench(found, WRENCH, [0.0, 1.0])
    with pytest.raises(InputError, match="wrench nan: finite"):
        apply_wrench(found, [0, 0, np.nan, 0, 0, 0])
    with pytest.raises(InputError, match="is not unit"):
        apply_wrench(Postures(robot, 2.0 * found.pose, found.screws), WRENCH)
    applied = apply_wrench(found, WRENCH)
    fewer = apply_wrench(Postures(robot, found.pose[:2], found.screws[:2]), WRENCH)
    for function in (joint_torques, deviation_columns, complementary_stiffness):
        with pytest.raises(InputError, match="2 wrenches for 3 poses"):
            function(found, fewer)
    for wrong in ([1e-6] * 5, [1e-6] * 5 + [-1e-6], [1e-6] * 5 + [np.nan]):
        with pytest.raises(InputError, match="6 finite numbers, none negative"):
            deviation(found, wrong, applied)
