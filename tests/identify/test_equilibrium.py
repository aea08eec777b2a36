"""Loaded equilibrium against a root finder and a minimiser of the potential energy, with kinematics of their own."""

from dataclasses import replace

import numpy as np
import pytest
from reference_robots import mixed, study_of
from scipy.optimize import minimize, root
from scipy.spatial.transform import Rotation

from identify.equilibrium import equilibrium, linear_error, linear_misses
from identify.errors import NoConvergence
from identify.experiment import full_experiment
from identify.fit import fit, start
from identify.loads import LoadCase, Markers
from identify.model import model_of
from identify.response import respond
from identify.robot_files import load_robot
from identify.simulate import simulate
from identify.study import Noise

MARKERS = np.array([[0.3, 0.12, -0.08], [0.02, 0.09, 0.22], [0.5, 0.2, 0.1]])
HOOK = np.array([0.32, 0.06, -0.07])
UNIT = {"urad/Nm": 1e-6, "um/N": 1e-6, "urad/N": 1e-6}


def heavy(robot, seed=3):
    """The robot with known masses and a tool."""
    rng = np.random.default_rng(seed)
    return replace(
        robot, masses=rng.uniform(20, 300, robot.n), centres=rng.normal(0, 0.3, (robot.n, 3)), tool_mass=25.0,
        tool_centre=np.array([0.1, 0.05, -0.1]), lower=np.full(robot.n, -3.0), upper=np.full(robot.n, 3.0),
    )  # fmt: skip


ROBOTS = {
    "upright": lambda: heavy(load_robot("kr270_2")),
    "mounted": lambda: heavy(load_robot("kr270_2", mount=(0.4, -0.9, 0.5))),
    "sliding": lambda: heavy(mixed()),
}
LOADS = {
    "mass": LoadCase("L1", mass=250.0, attach=HOOK),
    "world": LoadCase("L1", mass=100.0, attach=HOOK, force=np.array([900.0, -700.0, -500.0])),
    "world_moment": LoadCase("L1", attach=HOOK, force=np.array([0.0, 500.0, 0.0]), moment=np.array([300.0, 200, -250])),
    "flange": LoadCase("L1", mass=80.0, attach=HOOK, force=np.array([800.0, 400, -900]),
                       moment=np.array([200.0, -300, 150]), in_flange=True),
}  # fmt: skip
EFFECTS = {
    "joints": ("joint_compliance",),
    "links": ("link_compliance",),
    "all": ("joint_compliance", "link_compliance", "base_compliance", "tool_compliance", "joint_cross_compliance"),
}


def case(robot, load, effects, seed=5, **options):
    """Model, experiment and ten times too soft values."""
    rng = np.random.default_rng(seed)
    study = replace(
        study_of(robot), loads=(LoadCase("L0"), load), effects=effects, frame_free=False, markers_fitted=False,
        markers=Markers(("M1", "M2", "B1"), MARKERS, np.array([False, False, True])), options={}, **options,
    )  # fmt: skip
    model = model_of(study)
    size = {"urad/Nm": 2.0, "um/N": 0.1, "urad/N": 0.05}
    values = np.array([size[p.unit] * rng.uniform(0.5, 1.5) for p in model.parameters])
    values[["joint_compliance" in n or n.endswith(("k55", "k66")) for n in model.names]] *= 2.0
    q = rng.uniform(-1.0, 1.0, (2, robot.n))
    return study, model, full_experiment(q, np.array([[0, 1]] * 2), study.loads, study.markers), values


class BruteForce:
    """The same arm, written down once more: one pose at a time, every spring a rotation vector or a shift."""

    def __init__(self, model, q, load):
        self.model, self.robot, self.q, self.load = model, model.robot, q, load
        self.count = self.robot.n + 6 * (self.robot.n + 1) + 6
        self.turns = self._turns()

    def _turns(self):
        """Link frames in the frames of their ends, from the chain at zero."""
        pose, turns = np.eye(4), []
        for i, placement in enumerate(self.robot.placements):
            pose = pose @ placement
            turns.append(pose[:3, :3].T @ self.robot.link_rotations[i])
        return turns

    def compliance(self, values):
        """Dense (s, s); joints first, then the links, then the column."""
        n, matrix = self.robot.n, np.zeros((self.count, self.count))
        for effect, where in zip(self.model.effects, self.model.effect_slices, strict=True):
            start = {"joints": 0, "links": n}
            for term, value in zip(effect.terms, values[where], strict=True):
                pair = [term.first, term.second]
                if effect.springs == "base":
                    pair = [n + k if k < 6 else n + 6 * (n + 1) + k - 6 for k in pair]
                else:
                    pair = [k + start[effect.springs] for k in pair]
                a, b = pair
                matrix[a, b] += value * UNIT[term.unit]
                if a != b and term.mutual:
                    matrix[b, a] += value * UNIT[term.unit]
        return matrix

    def place(self, theta):
        """Flange pose (4, 4) and world-carried centres of mass [(mass, point)] in the base frame."""
        robot, n = self.robot, self.robot.n
        pose, weights = np.eye(4), []
        for i in range(n + 1):
            pose = pose @ robot.placements[i] @ self._six(theta[n + 6 * i : n + 6 * i + 6], self.turns[i])
            if i == n:
                break
            step, value = np.eye(4), self.q[i] + theta[i]
            if robot.prismatic[i]:
                step[2, 3] = value
            else:
                step[:3, :3] = Rotation.from_rotvec([0, 0, value]).as_matrix()
            pose = pose @ step
            if i == 0:
                pose = pose @ self._six(theta[-6:], self.turns[0])
            weights.append((robot.masses[i], pose[:3, :3] @ robot.centres[i] + pose[:3, 3]))
        weights.append((robot.tool_mass, pose[:3, :3] @ robot.tool_centre + pose[:3, 3]))
        return pose, weights

    @staticmethod
    def _six(values, turn):
        """Shifts along x, y, z of the frame, then turns about its x, its new y and its newest z."""
        step = np.eye(4)
        if not values.any():
            return step
        step[:3, 3] = turn @ values[:3]
        step[:3, :3] = turn @ Rotation.from_euler("XYZ", values[3:]).as_matrix() @ turn.T
        return step

    def work(self, theta):
        """Potential of dead loads and weights, J: their work with the opposite sign."""
        pose, weights = self.place(theta)
        world = self.robot.world_R_base
        down = self.robot.gravity_base
        force = world.T @ self.load.force + self.load.mass * down
        hung = -force @ (pose[:3, :3] @ self.load.attach + pose[:3, 3])
        return hung - sum(mass * down @ point for mass, point in weights)

    def torque(self, theta, live, step=3e-5):
        """Virtual work of all loads per unit of each live coordinate, by central differences."""
        torque = np.zeros(self.count)
        here, _ = self.place(theta)
        world, load, down = self.robot.world_R_base, self.load, self.robot.gravity_base
        turn = here[:3, :3] if load.in_flange else world.T
        force, moment = turn @ load.force + load.mass * down, turn @ load.moment
        for k in live:
            for sign in (-1.0, 1.0):
                nudged = theta.copy()
                nudged[k] += sign * step
                pose, weights = self.place(nudged)
                work = force @ (pose[:3, :3] @ load.attach + pose[:3, 3])
                work += sum(mass * down @ point for mass, point in weights)
                work += moment @ Rotation.from_matrix(pose[:3, :3] @ here[:3, :3].T).as_rotvec()
                torque[k] += sign * work / (2 * step)
        return torque

    def solve(self, values):
        """Root of ``theta = C t(theta)`` on the coordinates that yield."""
        matrix = self.compliance(values)
        live = np.flatnonzero(matrix.any(axis=1))

        def gap(part):
            theta = np.zeros(self.count)
            theta[live] = part * 1e-3
            return part - 1e3 * (matrix @ self.torque(theta, live))[live]

        begin = -gap(np.zeros(len(live)))
        found = root(gap, begin, method="broyden1", options={"fatol": 1e-9, "jac_options": {"alpha": -1.0}})
        assert np.abs(gap(found.x)).max() < 1e-8
        theta = np.zeros(self.count)
        theta[live] = found.x * 1e-3
        return theta

    def markers(self, theta):
        pose, _ = self.place(theta)
        return np.vstack([MARKERS[:2] @ pose[:3, :3].T + pose[:3, 3], MARKERS[2]])


def brute(model, experiment, values):
    """Markers of the first pose, unloaded and loaded."""
    found = []
    for shot in range(2):
        arm = BruteForce(model, experiment.q[experiment.shot_pose[shot]], experiment.loads[experiment.shot_load[shot]])
        found.append(arm.markers(arm.solve(values)))
    return np.concatenate(found)


@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_it_is_what_a_root_finder_finds(robot, effects):
    _, model, experiment, values = case(robot(), LOADS["flange"], effects)
    found = equilibrium(model, experiment, values)
    np.testing.assert_allclose(found.positions[:6], brute(model, experiment, values), atol=1e-9, rtol=0)
    assert found.iterations <= 6
    assert linear_error(model, experiment, values).maximum > 1e-5


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_forces_of_the_world_stay_and_forces_of_the_flange_turn(load):
    _, model, experiment, values = case(ROBOTS["mounted"](), load, EFFECTS["links"])
    expected = brute(model, experiment, values)
    np.testing.assert_allclose(equilibrium(model, experiment, values).positions[:6], expected, atol=1e-9, rtol=0)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_it_is_the_least_potential_energy(robot):
    _, model, experiment, values = case(robot(), LOADS["world"], EFFECTS["joints"])
    arm = BruteForce(model, experiment.q[0], experiment.loads[1])
    n = arm.robot.n
    stiffness = 1.0 / (values * 1e-6)
    full = np.zeros(arm.count)

    def energy(part):
        theta = full.copy()
        theta[:n] = part * 1e-3
        slope = stiffness * theta[:n] - arm.torque(theta, range(n))[:n]
        return 0.5 * stiffness @ theta[:n] ** 2 + arm.work(theta) - arm.work(full), 1e-3 * slope

    best = minimize(energy, np.zeros(n), jac=True, method="BFGS", options={"gtol": 1e-8})
    theta = full.copy()
    theta[:n] = best.x * 1e-3
    np.testing.assert_allclose(best.jac, 0.0, atol=1e-4)
    here = equilibrium(model, experiment, values).positions[experiment.row_shot == 1]
    np.testing.assert_allclose(here, arm.markers(theta), atol=1e-9, rtol=0)
    exact = arm.solve(values)
    assert abs(energy(exact[:n] * 1e3)[0] - best.fun) < 1e-9
    np.testing.assert_allclose(here, arm.markers(exact), atol=1e-9, rtol=0)


def test_measured_wrenches_turn_with_the_deflected_flange():
    _, model, experiment, values = case(ROBOTS["upright"](), LOADS["flange"], EFFECTS["all"])
    load = replace(LOADS["flange"], mass=0.0)
    loads = (experiment.loads[0], load)
    wrench = np.array([np.zeros(6), [*load.force, *load.moment]] * 2)
    hooked = (replace(loads[0], attach=HOOK), LoadCase("L1", attach=HOOK))
    stated = equilibrium(model, replace(experiment, loads=loads), values).positions
    measured = equilibrium(model, replace(experiment, loads=hooked, wrench=wrench), values).positions
    np.testing.assert_allclose(measured, stated, atol=1e-12)


def test_small_loads_leave_the_linear_model():
    _, model, experiment, values = case(ROBOTS["upright"](), LOADS["mass"], EFFECTS["all"])
    whole = linear_error(model, experiment, values / 10)
    tenth = linear_error(model, experiment, values / 100)
    assert whole.percent == pytest.approx(10 * tenth.percent, rel=0.1)
    assert whole.rms == pytest.approx(100 * tenth.rms, rel=0.1)
    assert linear_error(model, experiment, 0 * values).maximum < 1e-14
    assert linear_misses(model, experiment, 0 * values) is None
    assert linear_misses(model, experiment, 1e4 * values) is None


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_the_derivative_is_exact(robot):
    study, _, experiment, values = case(robot(), LOADS["flange"], EFFECTS["all"])
    model = model_of(replace(study, equilibrium="loaded", frame_free=True, markers_fitted=True))
    values = np.concatenate([np.zeros(len(model.parameters) - len(values)), values])
    columns = respond(model, experiment, values).derivative
    for k in range(6, len(values)):
        step = 1e-3 * np.eye(len(values))[k]
        up, down = (respond(model, experiment, values + s, derivative=False).position for s in (step, -step))
        np.testing.assert_allclose(columns[:, :, k], (up - down) / 2e-3, atol=2e-8, rtol=1e-5)


def test_a_loaded_truth_is_found_with_the_option_and_missed_without():
    study, model, _, values = case(ROBOTS["mounted"](), LOADS["mass"], EFFECTS["joints"])
    rng = np.random.default_rng(1)
    experiment = full_experiment(rng.uniform(-1, 1, (12, 6)), np.array([[0, 1]] * 12), study.loads, study.markers)
    loaded = model_of(replace(study, equilibrium="loaded"))
    data = simulate(loaded, values, experiment, Noise(reading=1e-12), np.eye(4), rng)
    found = fit(loaded, data, study.noise, start(loaded, data))
    np.testing.assert_allclose(found.state.values, values, rtol=1e-7)
    missed = fit(model, data, study.noise, start(model, data))
    assert np.abs(missed.state.values / values - 1).max() > 1e-4


def test_an_arm_that_gives_way_is_refused():
    _, model, experiment, values = case(ROBOTS["upright"](), LOADS["mass"], EFFECTS["joints"])
    with pytest.raises(NoConvergence, match="finds no equilibrium"):
        equilibrium(model, experiment, 1e4 * values)


def test_many_poses_are_sampled():
    study, model, _, values = case(ROBOTS["upright"](), LOADS["mass"], EFFECTS["links"])
    rng = np.random.default_rng(1)
    experiment = full_experiment(rng.uniform(-1, 1, (900, 6)), np.array([[0, 1]] * 900), study.loads, study.markers)
    part, whole = linear_misses(model, experiment, values), linear_error(model, experiment, values)
    assert part is not None
    assert part["rms_mm"] == pytest.approx(1e3 * whole.rms, rel=0.2)
