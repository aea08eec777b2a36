"""The 6x6 compliance of links against a dense computation, and its templates."""

from dataclasses import replace

import numpy as np
import pytest
from reference_robots import HOOK, REFLECTORS, gantry, kr270, mixed, study_of

from identify.effects import bind_effects, build_scene
from identify.effects.templates import BEAM, FULL, SYMMETRIC, link_template
from identify.errors import InputError
from identify.experiment import full_experiment
from identify.kinematics import forward
from identify.loads import LoadCase, Markers
from identify.model import model_of, without_nuisance
from identify.observation import observation_matrix, random_configurations
from identify.springs import link_turns

RNG = np.random.default_rng(5)
FORCE, MOMENT = np.array([120.0, -80.0, 500.0]), np.array([30.0, 20.0, -60.0])


def moved(robot, joint, q):
    """Placement of what joint ``joint`` moves, in the frame of the joint."""
    place = np.eye(4)
    if robot.prismatic[joint]:
        place[2, 3] = q
        return place
    c, s = np.cos(q), np.sin(q)
    place[:2, :2] = [[c, -s], [s, c]]
    return place


def link_ends(robot, q):
    """(n + 1, 4, 4) frames at the ends of the links and (4, 4) the flange, by plain products."""
    zero, now, ends = np.eye(4), np.eye(4), []
    for i in range(robot.n + 1):
        zero, now = zero @ robot.placements[i], now @ robot.placements[i]
        end = now.copy()
        end[:3, :3] = now[:3, :3] @ zero[:3, :3].T @ robot.link_rotations[i]
        ends.append(end)
        if i < robot.n:
            now = now @ moved(robot, i, q[i])
    return np.array(ends), now


def jacobian6(end, point):
    """(6, 6): motion of a point (m, rad, base frame) per unit of the six springs of a link end."""
    axes, arm = end[:3, :3], point - end[:3, 3]
    turning = np.cross(axes.T, arm).T
    return np.block([[axes, turning], [np.zeros((3, 3)), axes]])


def dense(robot, q, marker, hook, wrench, matrices):
    """``sum J k J^T W`` of one pose: displacement of a marker (6,)."""
    ends, flange = link_ends(robot, q)
    point, load = (flange[:3, :3] @ np.array(p) + flange[:3, 3] for p in (marker, hook))
    return sum(
        jacobian6(end, point) @ k @ jacobian6(end, load).T @ wrench for end, k in zip(ends, matrices, strict=True)
    )


def scene_of(robot, q):
    load = LoadCase("L1", force=FORCE, moment=MOMENT, attach=np.array(HOOK))
    markers = Markers(("a", "b", "c"), np.array(REFLECTORS), np.zeros(3, dtype=bool))
    experiment = full_experiment(q, np.zeros((len(q), 1), dtype=int), (load,), markers)
    return build_scene(experiment, forward(robot, q), markers.positions, self_weight=False)


@pytest.mark.parametrize("robot", [mixed(), gantry(), kr270("z")], ids=["mixed", "gantry", "kr270"])
@pytest.mark.parametrize("template", ["full", "symmetric", "beam"])
def test_links_deflect_like_dense_matrices_between_two_jacobians(robot, template):
    effect = bind_effects(("link_compliance",), robot, options={"link_compliance": {"template": template}})[0]
    values = RNG.normal(size=len(effect.parameters))
    matrices = np.zeros((robot.n + 1, 6, 6))
    elements = link_template({"template": template}, 0)
    for index, value in enumerate(values):
        link, (a, b) = divmod(index, len(elements))[0], elements[index % len(elements)]
        matrices[link, a - 1, b - 1] = value * 1e-6
        if template != "full":
            matrices[link, b - 1, a - 1] = value * 1e-6
    q = random_configurations(study_of(robot), 4, RNG)
    turn = robot.world_R_base.T
    wrench = np.concatenate([turn @ FORCE, turn @ MOMENT])
    expected = [dense(robot, pose, marker, HOOK, wrench, matrices)[:3] for pose in q for marker in REFLECTORS]
    scene = scene_of(robot, q)
    derivative = effect.derivative(scene, values)
    np.testing.assert_allclose(derivative @ values, expected, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(effect.displacement(scene, values), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("robot", [mixed(), gantry()], ids=["mixed", "gantry"])
def test_rotation_rows_of_a_6d_target_are_those_of_the_dense_matrices(robot):
    study = study_of(robot, reflectors=REFLECTORS[:1], template="symmetric", targets="pose")
    model = without_nuisance(model_of(study))
    q = random_configurations(study, 3, RNG)
    matrix = observation_matrix(study, model, q)
    assert matrix.shape[0] == 3 * 6
    wrench = np.concatenate([robot.world_R_base.T @ [0.0, 0.0, -1.0], np.zeros(3)])
    values = RNG.normal(size=len(model.parameters))
    matrices = np.zeros((robot.n + 1, 6, 6))
    for value, (link, (a, b)) in zip(values, ((i, e) for i in range(robot.n + 1) for e in SYMMETRIC), strict=True):
        matrices[link, a - 1, b - 1] = matrices[link, b - 1, a - 1] = value * 1e-6
    expected = np.concatenate([dense(robot, pose, REFLECTORS[0], HOOK, wrench, matrices) for pose in q])
    np.testing.assert_allclose(matrix @ values, expected, rtol=1e-10, atol=1e-16)


@pytest.mark.parametrize("robot", [mixed(), gantry(), kr270()], ids=["mixed", "gantry", "kr270"])
def test_a_joint_is_a_link_element_about_its_axis(robot):
    """Its column is ``sum a_i a_j`` of those of the link before it."""
    joints, links = bind_effects(
        ("joint_compliance", "link_compliance"), robot, options={"link_compliance": {"template": "full"}}
    )
    scene = scene_of(robot, random_configurations(study_of(robot), 5, RNG))
    own, every = joints.derivative(scene, np.zeros(robot.n)), links.derivative(scene, np.zeros(36 * (robot.n + 1)))
    by_link = every.reshape(*every.shape[:2], robot.n + 1, 6, 6)
    for joint in range(robot.n):
        axis = link_turns(robot)[joint].T @ [0.0, 0.0, 1.0]
        block = slice(0, 3) if robot.prismatic[joint] else slice(3, 6)
        expected = np.einsum("rcij,i,j->rc", by_link[:, :, joint, block, block], axis, axis)
        np.testing.assert_allclose(own[:, :, joint], expected, rtol=1e-10, atol=1e-16)


def test_names_and_units_follow_the_elements():
    robot = kr270()
    effect = bind_effects(("link_compliance@link2",), robot, options={"link_compliance": {"template": ["k26", "k55"]}})[
        0
    ]
    assert [(p.name, p.unit) for p in effect.parameters] == [
        ("link_compliance.link2.k26", "urad/N"),
        ("link_compliance.link2.k55", "urad/Nm"),
    ]


def test_templates_are_what_they_say():
    assert (len(BEAM), len(SYMMETRIC), len(FULL)) == (8, 21, 36)
    pattern = np.eye(6, dtype=int)
    pattern[1, 5] = pattern[5, 1] = pattern[2, 4] = pattern[4, 2] = 1
    assert set(link_template({"template": pattern.tolist()}, 3)) == set(BEAM)
    assert link_template({"template": "full", "link3": {"template": ["k11"]}}, 3) == ((1, 1),)
    assert link_template({"template": "beam", "link3": {"template": []}}, 3) == ()
    assert link_template({"template": ["k26", "k62"]}, 0) == ((2, 6), (6, 2))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"template": ["k22", "k26", "k62", "k35"]}, "not symmetric: it holds k35 and not k53"),
        ({"template": np.triu(np.ones((6, 6), dtype=int)).tolist()}, "not symmetric: it holds k12 and not k21"),
        ({"template": ["k17"]}, "k11 ... k66"),
        ({"template": "beams"}, "beam, symmetric, full"),
        ({"link2": {"template": 3}}, "link2 template = 3"),
        ({"link7": {"template": "beam"}}, "link0 ... link6"),
        ({"link2": {"templates": "beam"}}, "key template expected"),
        ({"constants": {"link2.k22": 0.1}}, "link2.k22 stands in its link's template"),
        ({"constants": {"link2": {"k99": 0.1}}}, "link2.k99"),
        ({"constants": {"link2.k12": 0.1, "link2.k21": 0.1}}, "each once"),
        ({"constants": 3}, "a table"),
    ],
)
def test_wrong_options_are_bad_input(options, said):
    with pytest.raises(InputError) as caught:
        bind_effects(("link_compliance",), kr270(), options={"link_compliance": options})
    assert said in str(caught.value)
    assert caught.value.exit_code == 2


def test_constants_displace_and_have_no_column():
    robot = kr270()
    whole = bind_effects(("link_compliance",), robot)[0]
    rest = [f"k{a}{b}" for a, b in BEAM if (a, b) not in {(2, 2), (2, 6)}]
    options = {"link2": {"template": rest}, "constants": {"link2": {"k22": 0.004, "k62": -0.003}}}
    held = bind_effects(("link_compliance",), robot, options={"link_compliance": options})[0]
    assert len(held.parameters) == len(whole.parameters) - 2
    names = [p.name for p in whole.parameters]
    values = RNG.uniform(0.01, 0.1, len(names))
    values[names.index("link_compliance.link2.k22")] = 0.004
    values[names.index("link_compliance.link2.k26")] = -0.003
    fitted = values[[names.index(p.name) for p in held.parameters]]
    scene = scene_of(robot, random_configurations(study_of(robot), 5, RNG))
    np.testing.assert_allclose(held.displacement(scene, fitted), whole.displacement(scene, values), rtol=1e-12)
    assert held.derivative(scene, fitted).shape[2] == len(fitted)


def test_a_rotated_link_frame_rotates_its_matrix():
    """The same link described in other axes: k' = R^T k R deflects the arm alike."""
    robot = kr270()
    turn, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turns = robot.link_rotations.copy()
    turns[2] = turn
    other = replace(robot, link_rotations=turns)
    both = np.kron(np.eye(2), turn)
    matrix = RNG.normal(size=(6, 6))
    q = random_configurations(study_of(robot), 3, RNG)
    options = {"link_compliance": {"template": "full"}}
    effects = [bind_effects(("link_compliance@link2",), r, options=options)[0] for r in (robot, other)]
    first = effects[0].displacement(scene_of(robot, q), matrix.ravel())
    second = effects[1].displacement(scene_of(other, q), (both.T @ matrix @ both).ravel())
    np.testing.assert_allclose(first, second, rtol=1e-10)
