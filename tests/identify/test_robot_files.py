"""Robot files: the shipped tables against published figures, and bad files against their messages."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from identify.errors import InputError
from identify.kinematics import flange_poses, forward, jacobian
from identify.robot import STANDARD_GRAVITY
from identify.robot_files import find_robot_file, load_robot, robot_from_toml, shipped_robots

NAMES = [
    "arm_3dof", "kr270_2", "kr270_r2700", "planar_2r", "planar_3r", "sda5f_r1", "sda5f_r2", "single_joint", "ur10",
]  # fmt: skip
RNG = np.random.default_rng(2)


def turn(axis, angle):
    """Homogeneous turn; deliberately another way than in the code under test (Rodrigues)."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], dtype=float)
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * k + (1 - math.cos(angle)) * k @ k
    return matrix


def shift(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def product(*matrices):
    return np.linalg.multi_dot(matrices)


X, Y, Z = np.eye(3)


def within_limits(robot, count):
    lower = np.where(np.isfinite(robot.lower), robot.lower, -math.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, math.pi)
    return RNG.uniform(lower, upper, (count, robot.n))


# --- shipped robots ------------------------------------------------------------------------------------------------


def test_the_shipped_robots_are_these():
    assert sorted(shipped_robots()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_robot_states_its_source_and_ordered_limits(name):
    robot = load_robot(name)
    assert len(robot.source) > 20
    assert np.isfinite(robot.lower).all()
    assert (robot.lower < robot.upper).all()
    assert robot.gravity == STANDARD_GRAVITY
    assert not np.any(robot.masses == 0)
    assert not np.any(robot.efforts == 0)
    assert robot.payload != 0


@pytest.mark.parametrize("name", NAMES)
def test_reach_bounds_the_distance_from_base_to_flange(name):
    robot = load_robot(name)
    distance = np.linalg.norm(flange_poses(robot, within_limits(robot, 500))[:, :3, 3], axis=1)
    assert distance.max() <= robot.reach
    assert robot.reach < 3 * distance.max()


@pytest.mark.parametrize("name", [name for name in NAMES if name != "ur10"])
def test_masses_and_efforts_that_nobody_publishes_are_unknown(name):
    robot = load_robot(name)
    assert np.isnan(robot.masses).all()
    assert np.isnan(robot.centres).all()
    assert np.isnan(robot.efforts).all()
    assert not robot.masses_known


# a1, d1, L2, z3, L3, d6 in m; limits in deg
KUKA = {
    "kr270_r2700": (
        (0.350, 0.675, 1.150, -0.041, 1.200, 0.240),
        [(-185, 185), (-140, -5), (-120, 155), (-350, 350), (-122.5, 122.5), (-350, 350)],
        2.7007,
    ),
    "kr270_2": (
        (0.350, 0.750, 1.250, -0.055, 1.100, 0.230),
        [(-185, 185), (-146, 0), (-119, 155), (-350, 350), (-125, 125), (-350, 350)],
        2.7014,
    ),
}


def kuka_fk(lengths, q):
    """Tz(d1) Rz(-A1) Tx(a1) Ry(A2) Tx(L2) Ry(A3) Tx(L3) Tz(z3) Rx(-A4) Ry(A5) Rx(-A6) Tx(d6)."""
    a1, d1, l2, z3, l3, d6 = lengths
    return product(
        shift(0, 0, d1), turn(Z, -q[0]), shift(a1, 0, 0), turn(Y, q[1]), shift(l2, 0, 0), turn(Y, q[2]),
        shift(l3, 0, 0), shift(0, 0, z3), turn(X, -q[3]), turn(Y, q[4]), turn(X, -q[5]), shift(d6, 0, 0),
    )  # fmt: skip


@pytest.mark.parametrize("name", KUKA)
def test_kuka_arms_follow_the_formula_with_kuka_signs(name):
    lengths, limits, _ = KUKA[name]
    robot = load_robot(name)
    q = RNG.uniform(-math.pi, math.pi, (50, 6))
    expected = np.array([kuka_fk(lengths, row) for row in q])
    np.testing.assert_allclose(flange_poses(robot, q), expected, atol=1e-12)
    np.testing.assert_allclose(np.degrees(np.column_stack([robot.lower, robot.upper])), limits)
    assert robot.payload == 270
    assert robot.joints == ("A1", "A2", "A3", "A4", "A5", "A6")


@pytest.mark.parametrize("name", KUKA)
def test_kuka_arms_reach_what_the_maker_states(name):
    robot = load_robot(name)
    (_, _, _, z3, l3, _), _, reach = KUKA[name]
    stretched = forward(robot, np.array([0.0, 0.0, math.atan2(z3, l3), 0.0, 0.0, 0.0]))
    wrist = stretched.origin[0, 4]
    assert wrist[0] == pytest.approx(reach, abs=1e-4)


@pytest.mark.parametrize(("joint", "axis"), [(0, -Z), (1, Y), (2, Y), (3, -X), (4, Y), (5, -X)])
def test_a_swapped_sign_of_a_kuka_axis_shows(joint, axis):
    robot = load_robot("kr270_r2700")
    np.testing.assert_array_equal(forward(robot, np.zeros(6)).axis[0, joint], axis)


def test_a1_counts_clockwise_seen_from_above():
    tip = flange_poses(load_robot("kr270_r2700"), np.radians([[90.0, -90, 90, 0, 0, 0]]))[0, :3, 3]
    np.testing.assert_allclose(tip, [0, -(0.35 + 1.2 + 0.24), 0.675 + 1.15 - 0.041 + 0.0], atol=1e-12)


# Universal Robots' table: a, d (m), alpha (deg), mass (kg), centre of mass in the row's DH frame (m)
UR10 = [
    (0.0, 0.1273, 90, 7.1, (0.021, 0.0, 0.027)),
    (-0.612, 0.0, 0, 12.7, (0.38, 0.0, 0.158)),
    (-0.5723, 0.0, 0, 4.27, (0.24, 0.0, 0.068)),
    (0.0, 0.163941, 90, 2.0, (0.0, 0.007, 0.018)),
    (0.0, 0.1157, -90, 2.0, (0.0, 0.007, 0.018)),
    (0.0, 0.0922, 0, 0.365, (0.0, 0.0, -0.026)),
]


def test_ur10_is_the_makers_table():
    robot = load_robot("ur10")
    q = RNG.uniform(-math.pi, math.pi, (50, 6))
    frames = forward(robot, q)
    for row, (rotation, origin) in enumerate(zip(frames.flange_rotation, frames.flange_origin, strict=True)):
        frame = np.eye(4)
        for i, (a, d, alpha, _, centre) in enumerate(UR10):
            frame = frame @ turn(Z, q[row, i]) @ shift(0, 0, d) @ shift(a, 0, 0) @ turn(X, math.radians(alpha))
            np.testing.assert_allclose(frames.centre[row, i], (frame @ [*centre, 1.0])[:3], atol=1e-12)
        np.testing.assert_allclose(rotation, frame[:3, :3], atol=1e-12)
        np.testing.assert_allclose(origin, frame[:3, 3], atol=1e-12)
    np.testing.assert_array_equal(robot.masses, [row[3] for row in UR10])
    np.testing.assert_array_equal(robot.efforts, [330, 330, 150, 56, 56, 56])
    np.testing.assert_allclose(np.degrees(robot.upper), [360, 360, 180, 360, 360, 360])
    np.testing.assert_allclose(robot.lower, -robot.upper)
    assert robot.payload == 10
    assert robot.masses_known


# Craig's table of the SDA5F: alpha_{i-1} (deg), theta (deg), d (mm); a_{i-1} (mm) for both arms
SDA5F_A = (0, 150, 0, 0, 85, 60, 0, 0)
SDA5F = {
    "sda5f_r1": [
        (0, 0, 0), (-90, 90, 243), (90, 0, 0), (-90, 180, 270),
        (90, 90, 0), (-90, 0, -270), (90, 0, 0), (-90, 0, -148),
    ],
    "sda5f_r2": [
        (0, 0, 0), (-90, 90, -243), (-90, 0, 0), (90, -180, -270),
        (-90, 90, 0), (90, 0, 270), (-90, 0, 0), (90, 0, 148),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", SDA5F)
def test_sda5f_is_the_printed_modified_dh_table(name):
    robot = load_robot(name)
    q = RNG.uniform(-math.pi, math.pi, (20, 8))
    expected = []
    for row in q:
        frame = np.eye(4)
        for a, (alpha, theta, d), value in zip(SDA5F_A, SDA5F[name], row, strict=True):
            frame = product(
                frame, turn(X, math.radians(alpha)), shift(a / 1000, 0, 0), turn(Z, math.radians(theta) + value),
                shift(0, 0, d / 1000),
            )  # fmt: skip
        expected.append(frame)
    np.testing.assert_allclose(flange_poses(robot, q), expected, atol=1e-12)
    limits = [170, 180, 110, 170, 115, 90, 110, 90]
    np.testing.assert_allclose(np.degrees(robot.upper), limits)
    np.testing.assert_allclose(np.degrees(robot.lower), [-170, -180, -110, -170, -90, -90, -110, -90])
    assert math.isnan(robot.payload)


def test_sda5f_end_points_at_the_offsets_mirror_each_other(tmp_path):
    for name, end in (("sda5f_r1", (0.150, 0.573, 0.503)), ("sda5f_r2", (0.150, -0.573, 0.503))):
        np.testing.assert_allclose(flange_poses(load_robot(name), np.zeros((1, 8)))[0, :3, 3], end, atol=1e-12)
    printed = tmp_path / "r2_as_printed.toml"
    text = shipped_robots()["sda5f_r2"].read_text()
    assert text.count("d_mm = 148") == 1
    printed.write_text(text.replace("d_mm = 148", "d_mm = -148"))
    end = flange_poses(load_robot(printed), np.zeros((1, 8)))[0, :3, 3]
    np.testing.assert_allclose(end, (0.150, -0.573, 0.207), atol=1e-12)


def test_sda5f_elbow_counts_towards_the_stretched_arm_as_its_limits_do():
    for name in SDA5F:
        frames = forward(load_robot(name), np.zeros(8))
        upper_arm, forearm = frames.origin[0, 4] - frames.origin[0, 2], frames.origin[0, 6] - frames.origin[0, 5]
        assert np.cross(frames.axis[0, 4], forearm) @ upper_arm > 0


def test_three_joint_arm_has_the_published_jacobian():
    robot = load_robot("arm_3dof")
    for q1, q2, q3 in RNG.uniform(-math.pi, math.pi, (20, 3)):
        r3, z3 = 0.8 * math.cos(q2 + q3), 0.8 * math.sin(q2 + q3)
        r, z = math.cos(q2) + r3, math.sin(q2) + z3
        s, c = math.sin(q1), math.cos(q1)
        frames = forward(robot, np.array([q1, q2, q3]))
        expected = [[-r * s, -z * c, -z3 * c], [r * c, -z * s, -z3 * s], [0, r, r3]]
        np.testing.assert_allclose(frames.flange_origin[0], [r * c, r * s, z], atol=1e-14)
        np.testing.assert_allclose(jacobian(frames, frames.flange_origin)[0, :3], expected, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "lengths"), [("single_joint", [1]), ("planar_2r", [1, 0.8]), ("planar_3r", [1, 0.8, 0.6])]
)
def test_planar_arms_lie_in_the_vertical_plane_and_positive_angles_lift(name, lengths):
    q = RNG.uniform(-math.pi, math.pi, (20, len(lengths)))
    angle = np.cumsum(q, axis=1)
    expected = np.column_stack([np.cos(angle) @ lengths, np.zeros(20), np.sin(angle) @ lengths])
    np.testing.assert_allclose(flange_poses(load_robot(name), q)[:, :3, 3], expected, atol=1e-14)


# --- the door ------------------------------------------------------------------------------------------------------

SMALL = """
name = "small"
convention = "chain"
source = "made up for this test"
[[joints]]
name = "a"
[[joints]]
name = "b"
type = "prismatic"
xyz_mm = [500, 0, 0]
axis = [0, 1, 0]
lower_mm = -100
upper_mm = 300
mass_kg = 2
com_mm = [10, 20, 30]
effort_N = 40
"""


def written(folder, text, name="robot.toml"):
    path = folder / name
    path.write_text(text)
    return path


def test_mount_turns_gravity_into_the_base_as_urdf_angles_do(tmp_path):
    roll, pitch, yaw = angles = (0.3, -0.5, 1.2)
    robot = load_robot(written(tmp_path, SMALL), mount=angles, gravity=9.81)
    expected = (turn(Z, yaw) @ turn(Y, pitch) @ turn(X, roll))[:3, :3]
    np.testing.assert_allclose(robot.world_R_base, expected, atol=1e-15)
    np.testing.assert_allclose(robot.world_R_base @ robot.gravity_base, [0, 0, -9.81], atol=1e-14)


def test_a_hanging_robot_feels_gravity_along_its_own_z(tmp_path):
    robot = load_robot(written(tmp_path, SMALL), mount=(math.pi, 0, 0))
    np.testing.assert_allclose(robot.gravity_base, [0, 0, STANDARD_GRAVITY], atol=1e-14)


def test_sliding_joints_and_unknown_limits(tmp_path):
    robot = load_robot(written(tmp_path, SMALL))
    assert robot.prismatic.tolist() == [False, True]
    np.testing.assert_allclose(robot.upper, [math.inf, 0.3])
    np.testing.assert_allclose(robot.lower, [-math.inf, -0.1])
    np.testing.assert_array_equal(robot.efforts, [math.nan, 40])
    frames = forward(robot, np.array([math.pi / 2, 0.2]))
    np.testing.assert_allclose(frames.flange_origin[0], [-0.2, 0.5, 0], atol=1e-15)
    np.testing.assert_allclose(frames.centre[0, 1], [-0.22, 0.51, 0.03], atol=1e-15)
    assert robot.reach == pytest.approx(0.8)


def test_a_sliding_joint_without_limits_has_no_reach(tmp_path):
    text = SMALL.replace("lower_mm = -100\nupper_mm = 300\n", "upper_mm = 300\n")
    assert load_robot(written(tmp_path, text)).reach == math.inf


@pytest.mark.parametrize("convention", ["dh_standard", "dh_modified"])
def test_dh_rows_with_sign_slide_base_and_flange(tmp_path, convention):
    text = f"""
name = "general"
convention = "{convention}"
source = "made up for this test"
[base]
xyz_mm = [10, 20, 30]
rpy_deg = [10, 20, 30]
[flange]
xyz_mm = [1, 2, 3]
rpy_deg = [0, 90, 180]
[[joints]]
name = "one"
sign = -1
a_mm = 100
alpha_deg = 37
d_mm = 50
theta_deg = 11
mass_kg = 1
com_mm = [1, 2, 3]
[[joints]]
name = "two"
type = "prismatic"
sign = -1
a_mm = 200
alpha_deg = -64
d_mm = 70
theta_deg = -25
mass_kg = 1
com_mm = [4, 5, 6]
"""
    robot = load_robot(written(tmp_path, text))
    q = np.array([0.7, 0.05])

    def placed(xyz, rpy):
        roll, pitch, yaw = np.radians(rpy)
        return product(shift(*np.array(xyz) / 1000), turn(Z, yaw), turn(Y, pitch), turn(X, roll))

    frame, centres = placed([10, 20, 30], [10, 20, 30]), []
    rows = [(0.1, 37, 0.05, math.radians(11) - q[0], (1, 2, 3)), (0.2, -64, 0.07 - q[1], math.radians(-25), (4, 5, 6))]
    for a, alpha, d, theta, com in rows:
        side = shift(a, 0, 0) @ turn(X, math.radians(alpha))
        joint = turn(Z, theta) @ shift(0, 0, d)
        frame = frame @ (joint @ side if convention == "dh_standard" else side @ joint)
        centres.append((frame @ [*np.array(com) / 1000, 1])[:3])
    frames = forward(robot, q)
    np.testing.assert_allclose(flange_poses(robot, q)[0], frame @ placed([1, 2, 3], [0, 90, 180]), atol=1e-15)
    np.testing.assert_allclose(frames.centre[0], centres, atol=1e-15)


def test_a_bare_name_means_the_file_beside_the_study_first(tmp_path):
    assert find_robot_file("ur10", tmp_path) == shipped_robots()["ur10"]
    assert find_robot_file("ur10.toml", tmp_path) == shipped_robots()["ur10"]
    own = written(tmp_path, SMALL, "ur10.toml")
    assert find_robot_file("ur10.toml", tmp_path) == own
    assert load_robot("ur10.toml", folder=tmp_path).name == "small"


def test_a_path_is_never_replaced_by_a_shipped_robot(tmp_path):
    with pytest.raises(InputError, match="does not exist") as caught:
        load_robot(tmp_path / "ur10.toml")
    assert str(tmp_path / "ur10.toml") in str(caught.value)
    assert "kr270_r2700" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mount": (0, 0)}, ["mount", "roll, pitch, yaw"]),
        ({"mount": (0, math.nan, 0)}, ["mount", "nan", "finite"]),
        ({"gravity": -9.81}, ["gravity", "-9.81", "not negative"]),
        ({"gravity": math.inf}, ["gravity", "inf", "finite"]),
        ({"flange": "tool0"}, ["flange", "tool0", "URDF"]),
        ({"base": "base_link"}, ["base", "base_link", "URDF"]),
    ],
)
def test_wrong_arguments_are_named(arguments, words):
    with pytest.raises(InputError) as caught:
        load_robot("ur10", **arguments)
    for word in words:
        assert word in str(caught.value)


def test_other_kinds_of_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"'\.xml' is not known; allowed are \.toml, \.urdf"):
        load_robot(written(tmp_path, "<robot/>", "robot.xml"))
    with pytest.raises(InputError, match="is no file"):
        load_robot(tmp_path)


# --- bad tables ----------------------------------------------------------------------------------------------------


def error_of(folder, text):
    path = written(folder, text) if isinstance(text, str) else folder / "robot.toml"
    if not isinstance(text, str):
        path.write_bytes(text)
    with pytest.raises(InputError) as caught:
        robot_from_toml(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert caught.value.exit_code == 2
    return message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "small"', 'nome = "small"', ["nome = 'small'", "unknown key", "convention", "name", "is missing"]),
        ("upper_mm = 300", "uper_mm = 300", ["joints[2].uper_mm = 300", "unknown key", "upper_mm"]),
        ("xyz_mm = [500, 0, 0]", "xyz_m = [0.5, 0, 0]", ["joints[2].xyz_m", "unknown key", "xyz_mm"]),
        ("xyz_mm = [500, 0, 0]", "xyz_mm = [500, 0]", ["joints[2].xyz_mm[3]", "missing"]),
        ("xyz_mm = [500, 0, 0]", "xyz_mm = [500, 0, nan]", ["joints[2].xyz_mm[3] = nan", "finite"]),
        ("xyz_mm = [500, 0, 0]", "xyz_mm = [5e9, 0, 0]", ["joints[2].xyz_mm[1] = 5000000000.0", "less than"]),
        ("xyz_mm = [500, 0, 0]", 'xyz_mm = ["500", 0, 0]', ["joints[2].xyz_mm[1] = '500'", "number"]),
        ("mass_kg = 2", "mass_kg = 0", ["joints[2].mass_kg = 0", "greater than 0"]),
        ("mass_kg = 2", "mass_kg = true", ["joints[2].mass_kg = True", "number"]),
        ("mass_kg = 2\n", "", ["joints[2]", "joint b", "mass_kg and com_mm stand together"]),
        ("effort_N = 40", "effort_Nm = 40", ["joint b is prismatic and has no effort_Nm"]),
        ("lower_mm = -100", "lower_deg = -100", ["joint b is prismatic and has no lower_deg"]),
        ("lower_mm = -100", "lower_mm = 300", ["joint b", "lower limit 300.0 is not below upper limit 300.0"]),
        ('type = "prismatic"', 'type = "floating"', ["joints[2].type = 'floating'", "'revolute'", "'prismatic'"]),
        ('type = "prismatic"', 'type = "continuous"', ["b is continuous and has no lower_mm, upper_mm, effort_N"]),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", ["joint b", "axis = [0.0, 0.0, 0.0]", "no direction"]),
        ('name = "b"', 'name = "a"', ["joints", "name a", "more than once"]),
        ('name = "b"', 'name = "b b"', ["joints[2].name = 'b b'", "pattern"]),
        ('"chain"', '"dh"', ["convention = 'dh'", "'dh_standard', 'dh_modified' or 'chain'"]),
        ('source = "made up for this test"', "", ["source", "is missing"]),
        ('source = "made up for this test"', 'source = ""', ["source = ''", "at least 1"]),
        ("[[joints]]", "[[joint]]", ["joint", "unknown key", "joints", "is missing"]),
        ("name =", "name", ["no TOML", "line 2"]),
    ],
)  # fmt: skip
def test_bad_tables_name_file_key_value_and_what_is_allowed(tmp_path, old, new, words):
    assert old in SMALL
    message = error_of(tmp_path, SMALL.replace(old, new))
    for word in words:
        assert word in message


def test_all_problems_stand_in_one_message(tmp_path):
    message = error_of(
        tmp_path, SMALL.replace("mass_kg = 2", "mass_kg = -2").replace("effort_N = 40", "effort_N = nan")
    )
    assert "2 problems" in message
    assert "joints[2].mass_kg = -2" in message
    assert "joints[2].effort_N = nan" in message


def test_a_dh_sign_is_plus_or_minus_one(tmp_path):
    text = 'name="r"\nconvention="dh_standard"\nsource="test"\n[[joints]]\nname="a"\nsign = 0\n'
    assert "sign = 0, allowed are 1 and -1" in error_of(tmp_path, text)
    assert "joints[1].sign = 2" in error_of(tmp_path, text.replace("sign = 0", "sign = 2"))


def test_a_table_without_joints_or_with_an_empty_list(tmp_path):
    head = 'name = "r"\nconvention = "dh_standard"\nsource = "test"\n'
    assert "joints" in error_of(tmp_path, head)
    assert "at least 1" in error_of(tmp_path, head + "joints = []\n")
    assert "valid tuple" in error_of(tmp_path, head + "joints = 3\n")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe\x00", "no UTF-8"),
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"#" * 10_000_001, "10000001 bytes; a TOML file has at most 10000000"),
        (b"a = " + b"9" * 5000, "value cannot be read"),
        (b"", "is missing"),
    ],
)
def test_hostile_tables_are_refused(tmp_path, content, words):
    assert words in error_of(tmp_path, content)


# --- controller map ------------------------------------------------------------------------------------------------

CONTROLLER = """
[controller]
sign = [1, -1]
offset_deg = [90, 5]
coupling = [[1, 0], [-1, 1]]
pulses_per_deg = [1000.5, 20]
"""


def test_the_controller_map_is_carried_and_frozen(tmp_path):
    controller = load_robot(written(tmp_path, SMALL + CONTROLLER)).controller
    assert controller is not None
    np.testing.assert_array_equal(controller.sign, [1, -1])
    np.testing.assert_array_equal(controller.offset_deg, [90, 5])
    np.testing.assert_array_equal(controller.coupling, [[1, 0], [-1, 1]])
    np.testing.assert_array_equal(controller.pulses_per_deg, [1000.5, 20])
    assert not controller.coupling.flags.writeable
    assert load_robot(written(tmp_path, SMALL)).controller is None


def test_an_empty_controller_map_is_the_identity(tmp_path):
    controller = load_robot(written(tmp_path, SMALL + "[controller]\n")).controller
    np.testing.assert_array_equal(controller.coupling, np.eye(2))
    np.testing.assert_array_equal(controller.sign, [1, 1])
    assert controller.pulses_per_deg is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[1, -1]\n", "[1, -1, 1]\n", ["controller.offset_deg", "(3,)"]),
        ("[1, -1]\n", "[1, 0]\n", ["controller.sign", "[1.0, 0.0]", "1 and -1"]),
        ("[90, 5]", "[90]", ["controller.offset_deg", "(1,)", "(2,)"]),
        ("[-1, 1]]", "[-1]]", ["controller.coupling", "2 rows of 2 numbers"]),
        ("[[1, 0], [-1, 1]]", "[[1, 1], [1, 1]]", ["controller.coupling", "inverted"]),
        ("[1000.5, 20]", "[0, 20]", ["controller.pulses_per_deg", "0 is not allowed"]),
        ("pulses_per_deg", "pulses", ["controller.pulses", "unknown key", "pulses_per_deg"]),
    ],
)
def test_a_wrong_controller_map_is_named(tmp_path, old, new, words):
    assert old in CONTROLLER
    message = error_of(tmp_path, SMALL + CONTROLLER.replace(old, new))
    for word in words:
        assert word in message


# --- documentation -------------------------------------------------------------------------------------------------


def test_the_manual_lists_every_shipped_robot_and_every_key():
    from identify import robot_files

    text = (Path(__file__).parents[2] / "docs" / "robots.md").read_text()
    for name in NAMES:
        assert f"`{name}`" in text
    for table in ("_DhJoint", "_ChainJoint", "_Placement", "_Controller", "_DhFile"):
        for key in getattr(robot_files, table).model_fields:
            assert re.search(rf"`(\w+\.)?{key}`", text), key
