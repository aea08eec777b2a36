"""Collision shapes of URDF links: capsules that hold them, where Pinocchio puts them."""

import coal
import numpy as np
import pinocchio
import pytest

from identify.collision_shapes import Collision
from identify.errors import InputError
from identify.kinematics import forward
from identify.robot_files import load_robot

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.4 0.3 0.6"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0.4 0.1 0" rpy="0.2 1.4 0.1"/><geometry>
    <cylinder radius="0.1" length="0.8"/></geometry></collision></link>
  <joint name="j1" type="revolute"><origin xyz="0 0 0.7" rpy="0.3 0 0.5"/><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="fore"><collision><geometry><sphere radius="0.2"/></geometry></collision></link>
  <joint name="j2" type="revolute"><origin xyz="0.9 0 0"/><parent link="upper"/><child link="fore"/>
    <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="plate"><collision><origin xyz="0.1 0 0" rpy="0 0 0.4"/><geometry><box size="0.1 0.5 0.2"/></geometry>
    </collision></link>
  <joint name="fixed" type="fixed"><origin xyz="0.5 0 0.1" rpy="0 0.6 0"/>
    <parent link="fore"/><child link="plate"/></joint>
</robot>
"""


def written(folder, text=URDF):
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def ends_in_base(robot, q):
    """Both ends of every shape (S, 2, 3) at one pose, by the moved frames of the joints."""
    placements, moved = robot.placements, [np.eye(4)]
    for i, value in enumerate(q):
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(value), -np.sin(value)], [np.sin(value), np.cos(value)]]
        moved.append(moved[-1] @ placements[i] @ turn)
    return np.array([s.ends @ moved[s.body][:3, :3].T + moved[s.body][:3, 3] for s in robot.shapes])


@pytest.mark.parametrize("q", [(0.0, 0.0), (0.7, -1.2), (-1.5, 1.9)])
def test_every_shape_lies_inside_its_capsule_where_pinocchio_puts_it(tmp_path, q):
    path = written(tmp_path)
    robot = load_robot(path)
    bodies = dict.fromkeys((shape.name, shape.body) for shape in robot.shapes)
    assert list(bodies) == [("base", 0), ("upper", 1), ("fore", 2), ("plate", 2)]
    model = pinocchio.buildModelFromUrdf(str(path))
    geometry = pinocchio.buildGeomFromUrdf(model, str(path), pinocchio.COLLISION)
    data = model.createData()
    placed = pinocchio.GeometryData(geometry)
    pinocchio.updateGeometryPlacements(model, data, geometry, placed, np.array(q))
    ends = ends_in_base(robot, q)
    rng = np.random.default_rng(0)
    for i, item in enumerate(geometry.geometryObjects):
        points = rng.uniform(-1, 1, (20_000, 3)) * 0.6
        if isinstance(item.geometry, coal.Box):
            points = points[(np.abs(points) <= item.geometry.halfSide).all(axis=1)]
        elif isinstance(item.geometry, coal.Sphere):
            points = points[np.linalg.norm(points, axis=1) <= item.geometry.radius]
        else:
            inside = np.linalg.norm(points[:, :2], axis=1) <= item.geometry.radius
            points = points[inside & (np.abs(points[:, 2]) <= item.geometry.halfLength)]
        points = points @ placed.oMg[i].rotation.T + placed.oMg[i].translation
        own = [k for k, shape in enumerate(robot.shapes) if shape.name == item.name.rsplit("_", 1)[0]]
        start, axis = ends[own, 0], ends[own, 1] - ends[own, 0]
        share = np.einsum("pki,ki->pk", points[:, None] - start, axis)
        share = (share / np.maximum((axis**2).sum(axis=1), 1e-12)).clip(0, 1)
        gap = np.linalg.norm(points[:, None] - start - share[..., None] * axis, axis=2)
        radii = np.array([robot.shapes[k].radius for k in own])
        deepest = (gap - radii).min(axis=1)
        assert len(points) > 20
        assert deepest.max() <= 1e-9
        assert deepest.max() > -0.4 * radii.max(), "the capsules are not much too large"


def test_the_flange_end_of_the_chain_is_that_of_the_kinematics(tmp_path):
    robot = load_robot(written(tmp_path))
    q = (0.4, 0.9)
    sphere = ends_in_base(robot, q)[[shape.name for shape in robot.shapes].index("fore")]
    np.testing.assert_allclose(sphere[0], sphere[1])
    np.testing.assert_allclose(sphere[0], forward(robot, np.array([q])).origin[0, 1], atol=1e-12)


def test_a_body_with_a_mesh_has_no_shapes_and_the_others_keep_theirs(tmp_path):
    mesh = '<mesh filename="package://nowhere/fore.stl"/>'
    robot = load_robot(written(tmp_path, URDF.replace('<sphere radius="0.2"/>', mesh)))
    assert list(dict.fromkeys(shape.name for shape in robot.shapes)) == ["base", "upper"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '<sphere radius="0.2"/>',
            '<sphere radius="-1"/>',
            r"link 'fore': collision: sphere radius = \[-1.0\]; numbers above",
        ),
        ('<sphere radius="0.2"/>', "<blob/>", "link 'fore': collision: one of box, cylinder, capsule, sphere or mesh"),
        ('<sphere radius="0.2"/>', '<sphere radius="wide"/>', "sphere radius = 'wide'; 1 finite number"),
        ('<box size="0.4 0.3 0.6"/>', "<box/>", "link 'base': collision: box size"),
    ],
)
def test_wrong_shapes_are_named(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words):
        load_robot(written(tmp_path, URDF.replace(old, new)))


def test_a_capsule_keeps_its_radius_and_length():
    ((ends, radius),) = Collision("capsule", (0.1, 0.5), np.eye(4)).capsules()
    np.testing.assert_allclose(ends, [[0, 0, -0.25], [0, 0, 0.25]])
    assert radius == 0.1


def test_a_flat_box_becomes_thin_strips():
    strips = Collision("box", (0.6, 0.1, 0.5), np.eye(4)).capsules()
    assert len(strips) == 5
    assert strips[0][1] == pytest.approx(np.hypot(0.1, 0.1) / 2)
    np.testing.assert_allclose([ends[0, 2] for ends, _ in strips], [-0.2, -0.1, 0, 0.1, 0.2], atol=1e-12)
    assert len(Collision("box", (1.0, 0.01, 1.0), np.eye(4)).capsules()) == 8
