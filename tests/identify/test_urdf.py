"""URDF files: the same robot as Pinocchio reads, and hostile or broken files against their messages."""

import math

import numpy as np
import pinocchio as pin
import pytest

from identify.errors import InputError
from identify.kinematics import flange_poses, forward, jacobian
from identify.robot_files import load_robot
from identify.springs import joint_springs, self_weight_torque
from identify.urdf import robot_from_urdf


def written(folder, text, name="robot.urdf"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


# --- the same robot as Pinocchio reads -----------------------------------------------------------------------------


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


def random_urdf(rng):
    """A random robot: a chain of 1-9 moving joints with fixed ones between, and branches.

    Returns:
        The text, the flange link, and the names of the moving joints of the chain.
    """
    lines, chain, count = ['<robot name="random">'], [], 0

    def link():
        nonlocal count
        name = f"link_{count}"
        count += 1
        lines.append(f'<link name="{name}">')
        if rng.random() < 0.7:
            spread = np.diag(rng.uniform(0.1, 1, 3)).tolist()
            lines.append(
                f'<inertial><origin xyz="{numbers(rng.normal(0, 0.3, 3))}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'
                f'<mass value="{rng.uniform(0.1, 30)!r}"/><inertia ixx="{spread[0][0]!r}" iyy="{spread[1][1]!r}" '
                f'izz="{spread[2][2]!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
            )
        lines.append('<visual><geometry><mesh filename="package://not/there.stl"/></geometry></visual></link>')
        return name

    def joint(parent, child, kind):
        name = f"joint_{child}"
        axis = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) if rng.random() < 0.4 else rng.normal(size=3)
        lower, upper = sorted(rng.uniform(-2, 2, 2).tolist())
        lines.append(
            f'<joint name="{name}" type="{kind}"><origin xyz="{numbers(rng.normal(0, 0.5, 3))}" '
            f'rpy="{numbers(rng.uniform(-math.pi, math.pi, 3))}"/><parent link="{parent}"/><child link="{child}"/>'
        )
        if kind != "fixed":
            lines.append(f'<axis xyz="{numbers(axis)}"/>')
        if kind in {"revolute", "prismatic"}:
            lines.append(f'<limit lower="{lower!r}" upper="{upper!r}" effort="{rng.uniform(1, 100)!r}" velocity="1"/>')
        lines.append("</joint>")
        return name

    end = link()
    for _ in range(rng.integers(1, 10)):
        while rng.random() < 0.3:
            parent, end = end, link()
            joint(parent, end, "fixed")
        if rng.random() < 0.3:
            side = link()
            joint(end, side, rng.choice(["fixed", "revolute", "prismatic"]))
            if rng.random() < 0.5:
                joint(side, link(), "fixed")
        parent, end = end, link()
        chain.append(joint(parent, end, rng.choice(["revolute", "continuous", "prismatic"])))
    if rng.random() < 0.5:
        parent, end = end, link()
        joint(parent, end, "fixed")
    lines.append("</robot>")
    return "\n".join(lines), end, chain


def full_q(model, chain, q):
    """Pinocchio's configuration: the chain at q, everything else at zero."""
    configuration = pin.neutral(model)
    for name, value in zip(chain, q, strict=True):
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 2:
            configuration[joint.idx_q : joint.idx_q + 2] = math.cos(value), math.sin(value)
        else:
            configuration[joint.idx_q] = value
    return configuration


@pytest.mark.parametrize("seed", range(60))
def test_a_random_urdf_is_read_as_pinocchio_reads_it(tmp_path, seed):
    rng = np.random.default_rng(seed)
    text, flange, chain = random_urdf(rng)
    robot = robot_from_urdf(written(tmp_path, text), flange=flange)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    assert robot.joints == tuple(chain)
    frame = model.getFrameId(flange, pin.BODY)
    columns = [model.joints[model.getJointId(name)].idx_v for name in chain]
    bounds = [model.joints[model.getJointId(name)] for name in chain]
    for value, joint in zip(robot.lower, bounds, strict=True):
        assert value == (-math.inf if joint.nq == 2 else model.lowerPositionLimit[joint.idx_q])
    q = rng.uniform(-3, 3, (20, robot.n))
    frames = forward(robot, q)
    poses = flange_poses(robot, q)
    ours = jacobian(frames, frames.flange_origin)
    weights = self_weight_torque(joint_springs(frames), frames)
    for i, row in enumerate(q):
        configuration = full_q(model, chain, row)
        pin.computeJointJacobians(model, data, configuration)
        pin.updateFramePlacements(model, data)
        np.testing.assert_allclose(poses[i], data.oMf[frame].homogeneous, atol=1e-10)
        theirs = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)[:, columns]
        np.testing.assert_allclose(ours[i], theirs, atol=1e-10)
        if robot.masses_known:
            gravity = pin.computeGeneralizedGravity(model, data, configuration)[columns]
            scale = max(1.0, float(np.abs(gravity).max()))
            # Pinocchio's default gravity is 9.81; its generalised gravity is what the motors must hold.
            np.testing.assert_allclose(weights[i] * 9.81 / robot.gravity, -gravity, atol=1e-10 * scale)


def test_masses_are_known_often_enough_for_the_comparison_above(tmp_path):
    known = 0
    for seed in range(60):
        text, flange, _ = random_urdf(np.random.default_rng(seed))
        known += robot_from_urdf(written(tmp_path, text), flange=flange).masses_known
    assert known >= 10


# UR10 from ur_description: default_kinematics.yaml (ros-industrial/universal_robot, e30bc2e) and
# physical_parameters.yaml (UniversalRobots/Universal_Robots_ROS2_Description, 3426d67).
UR10_LINKS = [
    ("shoulder", (0, 0, 0.1273), (0, 0, 0), 7.1, (0.021, -0.027, 0)),
    ("upper_arm", (0, 0, 0), (math.pi / 2, 0, 0), 12.7, (-0.232, 0, 0.158)),
    ("forearm", (-0.612, 0, 0), (0, 0, 0), 4.27, (-0.3323, 0, 0.068)),
    ("wrist_1", (-0.5723, 0, 0.163941), (0, 0, 0), 2.0, (0, -0.018, 0.007)),
    ("wrist_2", (0, -0.1157, 0), (math.pi / 2, 0, 0), 2.0, (0, 0.018, -0.007)),
    ("wrist_3", (0, 0.0922, 0), (math.pi / 2, math.pi, math.pi), 0.365, (0, 0, -0.026)),
]


def ur10_urdf():
    text, parent = ['<robot name="ur10">', '<link name="base_link"/>'], "base_link"
    for name, xyz, rpy, mass, com in UR10_LINKS:
        numbers = [" ".join(map(repr, v)) for v in (com, xyz, rpy)]
        text.append(
            f'<link name="{name}"><inertial><origin xyz="{numbers[0]}"/><mass value="{mass}"/></inertial></link>'
            f'<joint name="{name}_joint" type="revolute"><origin xyz="{numbers[1]}" rpy="{numbers[2]}"/>'
            f'<parent link="{parent}"/><child link="{name}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.28" upper="6.28" effort="0" velocity="1"/></joint>'
        )
        parent = name
    return "\n".join([*text, "</robot>"])


def test_the_ur10_table_agrees_with_the_ur10_description(tmp_path):
    ours, theirs = load_robot("ur10"), robot_from_urdf(written(tmp_path, ur10_urdf()))
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (50, 6))
    a, b = forward(ours, q), forward(theirs, q)
    np.testing.assert_allclose(a.flange_origin, b.flange_origin, atol=1e-10)
    np.testing.assert_allclose(a.axis, b.axis, atol=1e-10)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-10)
    torque_a, torque_b = (self_weight_torque(joint_springs(frames), frames) for frames in (a, b))
    np.testing.assert_allclose(torque_a, torque_b, atol=1e-9)
    assert np.abs(torque_a[:, 1]).max() > 100


# --- what is decided -----------------------------------------------------------------------------------------------

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base_link"/>
  <link name="base"/>
  <joint name="base_link-base" type="fixed"><parent link="base_link"/><child link="base"/></joint>
  <link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="3"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="j1" type="revolute"><origin xyz="0 0 1"/><parent link="base_link"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="50" velocity="1"/></joint>
  <link name="fore"><inertial><mass value="2"/></inertial>
    <collision><geometry><mesh filename="package://nowhere/fore.stl"/></geometry></collision></link>
  <joint name="j2" type="prismatic"><origin xyz="1 0 0"/><parent link="upper"/><child link="fore"/>
    <axis xyz="-2 0 0"/><limit lower="-0.5" upper="0.1" effort="0" velocity="1"/></joint>
  <link name="tool0"/>
  <joint name="fore-tool0" type="fixed"><origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>
    <parent link="fore"/><child link="tool0"/></joint>
</robot>
"""

FINGERS = """
  <link name="palm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/></inertial></link>
  <joint name="fore-palm" type="fixed"><origin xyz="0.5 0 0"/><parent link="fore"/><child link="palm"/></joint>
  <link name="left"><inertial><mass value="0.5"/></inertial></link>
  <joint name="slide" type="prismatic"><origin xyz="0 0.2 0"/><parent link="palm"/><child link="left"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="9" velocity="1"/></joint>
  <link name="right"/>
  <joint name="follow" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.1" effort="9" velocity="1"/><mimic joint="slide" multiplier="1"/></joint>
</robot>"""


def test_a_small_arm_end_to_end(tmp_path):
    robot = robot_from_urdf(written(tmp_path, ARM))
    assert (robot.name, robot.joints) == ("arm", ("j1", "j2"))
    assert robot.prismatic.tolist() == [False, True]
    np.testing.assert_array_equal(robot.masses, [3, 2])
    np.testing.assert_array_equal(robot.efforts, [50, math.nan])
    np.testing.assert_array_equal(robot.lower, [-1, -0.5])
    np.testing.assert_array_equal(robot.upper, [2, 0.1])
    assert str(tmp_path) not in robot.source
    assert "robot.urdf" in robot.source
    frames = forward(robot, np.array([[0.0, -0.25]]))
    np.testing.assert_allclose(frames.flange_origin[0], [1.75, 0, 1], atol=1e-15)
    np.testing.assert_allclose(frames.axis[0], [[0, 1, 0], [-1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(frames.centre[0], [[0.1, 0, 1], [1.25, 0, 1]], atol=1e-15)


def test_a_link_that_is_only_a_frame_of_the_base_is_no_branch(tmp_path):
    assert robot_from_urdf(written(tmp_path, ARM)).source.endswith("links base_link to tool0")


def test_base_and_flange_choose_a_part_of_the_tree(tmp_path):
    robot = load_robot(written(tmp_path, ARM), base="upper", flange="fore")
    assert robot.joints == ("j2",)
    np.testing.assert_array_equal(robot.masses, [2])
    np.testing.assert_allclose(forward(robot, np.array([0.1])).flange_origin[0], [0.9, 0, 0], atol=1e-15)


def test_what_hangs_behind_the_flange_is_carried_at_zero(tmp_path):
    robot = robot_from_urdf(written(tmp_path, ARM), flange="upper")
    np.testing.assert_array_equal(robot.masses, [5])
    np.testing.assert_allclose(
        robot.placements[0][:3, :3] @ robot.centres[0], [(3 * 0.1 + 2 * 1) / 5, 0, 0], atol=1e-15
    )


def test_a_gripper_off_the_chain_is_carried_with_its_mass(tmp_path):
    robot = robot_from_urdf(written(tmp_path, ARM.replace("</robot>", FINGERS)), flange="tool0")
    assert robot.joints == ("j1", "j2")
    np.testing.assert_array_equal(robot.masses, [3, 3.5])
    centre = forward(robot, np.zeros((1, 2))).centre[0, 1]
    np.testing.assert_allclose(centre, [1 + 1.5 * 0.5 / 3.5, 0.5 * 0.2 / 3.5, 1 + 0.1 / 3.5], atol=1e-15)


def test_a_branching_tree_asks_for_the_flange_and_lists_the_ends(tmp_path):
    with pytest.raises(InputError, match="name the flange link: flange = one of 'left', 'right'"):
        robot_from_urdf(written(tmp_path, ARM.replace("</robot>", FINGERS)))
    twin = '<link name="ft"/><joint name="f" type="fixed"><parent link="fore"/><child link="ft"/></joint></robot>'
    with pytest.raises(InputError, match="flange = one of 'ft', 'tool0'"):
        robot_from_urdf(written(tmp_path, ARM.replace("</robot>", twin)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<inertial><mass value=\"2\"/></inertial>", ""),
        ("<mass value=\"2\"/>", "<mass value=\"0\"/>"),
    ],
)  # fmt: skip
def test_a_body_without_a_stated_mass_is_unknown_and_not_zero(tmp_path, old, new):
    assert old in ARM
    robot = robot_from_urdf(written(tmp_path, ARM.replace(old, new)))
    np.testing.assert_array_equal(robot.masses, [3, math.nan])
    assert np.isnan(robot.centres[1]).all()
    assert not robot.masses_known


@pytest.mark.parametrize(
    ("old", "new", "lower", "upper"),
    [
        ('<limit lower="-1" upper="2" effort="50" velocity="1"/>', "", -math.inf, math.inf),
        ('lower="-1" upper="2" ', "", -math.inf, math.inf),
        ('lower="-1" upper="2" ', 'upper="2" ', 0, 2),
        ('"j1" type="revolute"', '"j1" type="continuous"', -math.inf, math.inf),
    ],
)
def test_limits_that_are_not_stated_are_unknown(tmp_path, old, new, lower, upper):
    assert old in ARM
    robot = robot_from_urdf(written(tmp_path, ARM.replace(old, new)))
    assert (robot.lower[0], robot.upper[0]) == (lower, upper)
    assert robot.continuous.tolist() == ["continuous" in new, False]


def test_nothing_is_printed(tmp_path, capfd):
    robot_from_urdf(written(tmp_path, ARM))
    with pytest.raises(InputError):
        robot_from_urdf(written(tmp_path, ARM.replace('"upper"/>', '"uper"/>')))
    assert capfd.readouterr() == ("", "")


def test_names_may_clash_or_hold_odd_characters(tmp_path):
    text = ARM.replace('"j1"', '"universe"').replace('"j2"', '"fore"').replace('"tool0"', '"tool &amp; &lt;0&gt; é"')
    robot = robot_from_urdf(written(tmp_path, text), flange="tool & <0> é")
    assert robot.joints == ("universe", "fore")
    np.testing.assert_allclose(forward(robot, np.zeros(2)).flange_origin[0], [1.5, 0, 1], atol=1e-15)


# --- hostile and broken files --------------------------------------------------------------------------------------


def error_of(folder, text, **arguments):
    path = written(folder, text) if isinstance(text, str) else folder / "robot.urdf"
    if not isinstance(text, str):
        path.write_bytes(text)
    with pytest.raises(InputError) as caught:
        robot_from_urdf(path, **arguments)
    assert str(caught.value).startswith(str(path))
    assert caught.value.exit_code == 2
    return str(caught.value)


LAUGHS = '<!DOCTYPE l [<!ENTITY a0 "ha">' + "".join(
    f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(9)
) + ']><robot name="&a9;"/>'  # fmt: skip
OUTSIDE = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="&x;"/>'


@pytest.mark.parametrize(
    "content",
    [LAUGHS, OUTSIDE, '<?xml version="1.0" encoding="UTF-16"?>'.encode("utf-16") + LAUGHS.encode("utf-16")[2:]],
)
def test_entities_are_refused_before_they_are_read(tmp_path, content):
    message = error_of(tmp_path, content)
    assert "<!DOCTYPE> is refused" in message
    assert "line 1" in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no XML"),
        (b"\x00\x01\x02", "no XML"),
        (b"solid ascii stl", "no XML"),
        (b"<robot><link name='a'></robot>", "no XML: mismatched tag"),
        (b"<robot name='\xff'/>", "no XML"),
        (b"<?xml version='1.0' encoding='klingon'?><robot/>", "no XML"),
        (b"<html/>", "the first element is <html>, a URDF file starts with <robot>"),
        (b"<robot>" + b"<a>" * 200 + b"</a>" * 200 + b"</robot>", "more than 100 nested elements"),
        (b"<robot><!--" + b"x" * 10_000_001 + b"--></robot>", "a URDF file has at most 10000000"),
        (b"<robot/>", "0 links"),
        (b"<robot>" + b"".join(b"<link name='%d'/>" % i for i in range(2001)) + b"</robot>", "2001 links"),
        (b"<robot xmlns:xacro='http://ros.org/wiki/xacro'><xacro:macro/></robot>", "is xacro; expand the file first"),
    ],
)
def test_files_that_are_no_urdf_are_refused(tmp_path, content, words):
    assert words in error_of(tmp_path, content)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('xyz="0 0 1"', 'xyz="0 0 nan"', ["joint 'j1'", "origin xyz = '0 0 nan'", "3 finite numbers"]),
        ('xyz="0 0 1"', 'xyz="0 0 1e999"', ["joint 'j1'", "origin xyz = '0 0 1e999'", "3 finite numbers"]),
        ('xyz="0 0 1"', 'xyz="0 0 1e300"', ["joint 'j1'", "origin xyz = '0 0 1e300'", "at most 1e+06"]),
        ('xyz="0 0 1"', 'xyz="0 0"', ["joint 'j1'", "origin xyz = '0 0'", "3 finite numbers"]),
        ('xyz="0 0 1"', 'xyz="0 0 1_0"', ["origin xyz = '0 0 1_0'"]),
        ('xyz="0 0 1"', 'xyz="0,0,1"', ["origin xyz = '0,0,1'"]),
        ('xyz="0 0 1"', 'rpy="0 0 inf"', ["joint 'j1'", "origin rpy = '0 0 inf'"]),
        ('xyz="0 0 1"', 'xyz="0 0 ${h}"', ["xacro"]),
        ('xyz="-2 0 0"', 'xyz="0 0 0"', ["joint 'j2'", "axis xyz", "no direction"]),
        ('xyz="-2 0 0"', 'xyz="x y z"', ["joint 'j2'", "axis xyz = 'x y z'"]),
        ('lower="-1" upper="2"', 'lower="-one" upper="2"', ["joint 'j1'", "limit lower = '-one'", "1 finite number "]),
        ('lower="-1" upper="2"', 'lower="2" upper="-1"', ["joint 'j1'", "lower = 2", "not below upper = -1"]),
        ('lower="-1" upper="2"', 'lower="0" upper="0"', ["joint 'j1'", "not below", "leave both out"]),
        ('effort="50"', 'effort="nan"', ["joint 'j1'", "limit effort = 'nan'"]),
        ('effort="50"', 'effort="-50"', ["joint 'j1'", "limit effort = -50", "0: unknown"]),
        ('effort="50" velocity="1"', 'effort="50" velocity="fast"', ["joint 'j1'", "limit velocity = 'fast'"]),
        ('<mass value="3"/>', '<mass value="heavy"/>', ["link 'upper'", "mass value = 'heavy'"]),
        ('<mass value="3"/>', '<mass value="-3"/>', ["link 'upper'", "mass value = -3", "above zero"]),
        ('<mass value="3"/>', "", ["link 'upper'", "<inertial> states no mass"]),
        ('ixx="1"', 'ixx="NaN"', ["link 'upper'", "inertia ixx = 'NaN'"]),
        ('<origin xyz="0.1 0 0"/>', '<origin xyz="0.1 0 0"/><origin/>', ["link 'upper'", "<origin> stands 2 times"]),
        ('<link name="base"/>', '<link name="upper"/>', ["link 'upper' stands twice"]),
        ('<link name="base"/>', '<link name="base"/><link name="lost"/>', ["'base_link', 'lost' hang on nothing"]),
        ('<link name="base"/>', "<link/>", ["a <link> has no name"]),
        ('joint name="j2"', 'joint name="j1"', ["joint 'j1' stands twice"]),
        ('<child link="fore"/>', '<child link="upper"/>', ["joint 'j2'", "'upper' is that of joint 'j1' already"]),
        ('<child link="fore"/>', '<child link="four"/>', ["joint 'j2'", "child link 'four' does not exist", "'fore'"]),
        ('<child link="fore"/>', "", ["joint 'j2'", "<child link=...> is missing"]),
        ('<parent link="base_link"/><child link="upper"/>', '<parent link="tool0"/><child link="upper"/>', ["circle"]),
        ('"j2" type="prismatic"', '"j2" type="planar"', ["joint 'j2'", "'planar'", "revolute, continuous, prismatic"]),
        ('"j2" type="prismatic"', '"j2" type="floating"', ["joint 'j2'", "'floating'"]),
        ('"j2" type="prismatic"', '"j2" type="screw"', ["joint 'j2'", "type = 'screw'", "allowed are revolute"]),
        ('"j2" type="prismatic"', '"j2"', ["joint 'j2'", "type = ''", "allowed are revolute"]),
        ("<axis xyz=\"-2 0 0\"/>", "<axis xyz=\"-2 0 0\"/><mimic joint=\"j1\"/>", ["joint 'j2' mimics 'j1'"]),
    ],
)  # fmt: skip
def test_broken_files_name_the_element_the_value_and_what_is_allowed(tmp_path, old, new, words):
    assert old in ARM
    message = error_of(tmp_path, ARM.replace(old, new, 1))
    for word in words:
        assert word in message


def test_a_tree_that_is_one_circle(tmp_path):
    text = """<robot name="r"><link name="a"/><link name="b"/>
    <joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>
    <joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint></robot>"""
    assert "'a', 'b' hang on one another in a circle" in error_of(tmp_path, text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"flange": "tool1"}, ["flange = 'tool1'", "no such link", "'tool0'"]),
        ({"base": "world"}, ["base = 'world'", "no such link", "'base_link'"]),
        ({"base": "fore", "flange": "upper"}, ["'upper' does not hang on base 'fore'", "'tool0'"]),
        ({"flange": "base"}, ["no moving joint between base 'base_link' and flange 'base'"]),
    ],
)
def test_wrong_links_are_named(tmp_path, arguments, words):
    message = error_of(tmp_path, ARM, **arguments)
    for word in words:
        assert word in message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.urdf.*no such file"):
        robot_from_urdf(tmp_path / "nowhere.urdf")
