"""The study file of two arms: what arrives in SI, what is shared, and every mistake by its key."""

import numpy as np
import pytest
import tomli_w

from identify import two_arm_checks
from identify.config import load_study
from identify.errors import InputError
from identify.model import model_of
from identify.robot_files import load_robot
from identify.schema import ArmPoseSection, ArmSection, TwoArmPlanSection, WaistSection
from identify.two_arm_config import holds_two_arms, load_two_arm_study
from identify.two_arm_study import shared_parameters, task_points, unsupported
from tests.doe.two_arm_files import BOTH, SDA5F, UP, both, write_both
from tests.identify.studies import study_of

TASK = BOTH["test_poses"][0]


def message(folder, **changes):
    """What is said about a wrong study."""
    with pytest.raises(InputError) as caught:
        both(folder, **changes)
    return str(caught.value)


def test_every_value_arrives_in_si(tmp_path):
    plan = {"poses": None, "tolerance_mm": 0.2, "confidence": 0.9, "criterion": "G", "repeats": False, "refine": True}
    study = both(tmp_path, plan={**plan, "max_std_percent": 500.0})
    assert [arm.name for arm in study.arms] == ["A", "B"]
    assert study.shared == 1
    assert [task.weight for task in study.tasks] == [1.0, 2.0]
    first, second = study.tasks[1].poses
    np.testing.assert_allclose(first.q, np.deg2rad([-50.0, 30.0, 40.0]))
    np.testing.assert_allclose(first.point, [0.05, 0.03, -0.02])
    assert second.wrench.tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    assert (first.weight, second.weight) == (2.0, 2.0)
    settings = study.plan
    assert (settings.poses, settings.tolerance, settings.confidence) == (None, pytest.approx(0.2e-3), 0.9)
    assert (settings.criterion, settings.repeats, settings.refine, settings.max_std_percent) == (
        "G",
        False,
        True,
        500.0,
    )
    assert [path.name for path in study.inputs] == ["both.toml", "a.toml", "arm_3dof.toml", "b.toml"]


def test_defaults_are_those_of_ordinary_studies(tmp_path):
    study = both(tmp_path, plan=None, test_poses=None)
    assert study.tasks == ()
    assert (study.plan.poses, study.plan.criterion, study.plan.candidates, study.plan.refine) == (
        15, "test_pose", 10_000, True,
    )  # fmt: skip


def test_only_a_file_with_arms_is_a_study_of_two(tmp_path):
    assert holds_two_arms(write_both(tmp_path))
    assert not holds_two_arms(tmp_path / "a.toml")


def test_shipped_tasks_meet_with_axes_that_oppose_each_other():
    study = load_two_arm_study(SDA5F)
    points = task_points(study)
    assert points.shape == (3, 2, 3)
    assert np.abs(np.diff(points, axis=1)).max() < 2e-8
    for task in study.tasks:
        (first, second), (a, b) = task.poses, (arm.study.robot for arm in study.arms)
        axes = [flange_axis(robot, pose.q) for robot, pose in zip((a, b), (first, second), strict=True)]
        np.testing.assert_allclose(axes[0], axes[1], atol=1e-7)  # R1 looks along its -z, R2 along its +z
        np.testing.assert_array_equal(first.wrench, -second.wrench)
        assert np.linalg.norm(first.wrench) == pytest.approx(8.0, rel=1e-6)
        np.testing.assert_allclose(np.cross(first.wrench[:3], axes[0]), 0.0, atol=1e-6)


def flange_axis(robot, q):
    """(3,) z axis of the flange."""
    from identify.kinematics import forward

    return forward(robot, q[None]).flange_rotation[0, :, 2]


# --- what is shared


def names(robot, effects, joints, options=None):
    """Shared parameters and what is unsupported, of a model."""
    model = model_of(study_of(robot, effects=tuple(effects), options=options or {}))
    return shared_parameters(model, joints), unsupported(model, joints)


def test_springs_below_the_first_own_joint_are_shared():
    robot = load_robot("sda5f_r1")
    shared, wrong = names(robot, ["joint_compliance", "base_compliance", "tool_compliance"], 2)
    assert shared == {
        "joint_compliance.j1",
        "joint_compliance.j2",
        *(f"base_compliance.{place}.{axis}" for place in ("base", "column") for axis in ("rx", "ry")),
    }
    assert wrong == []
    shared, _ = names(robot, ["link_compliance"], 2, {"link_compliance": {"template": ["k44"]}})
    assert shared == {"link_compliance.link0.k44", "link_compliance.link1.k44"}
    assert names(robot, ["joint_compliance", "base_compliance"], 0) == (frozenset(), [])


def test_errors_of_a_shared_joint_that_no_load_causes_are_shared_too():
    shared, wrong = names(
        load_robot("sda5f_r1"), ["transmission_error@j1", "transmission_error@j2", "tracker_drift"], 1
    )
    assert shared
    assert all(name.startswith("transmission_error.j1.") for name in shared)
    assert wrong == []


@pytest.mark.parametrize(
    ("effects", "joints", "part"),
    [
        (
            ["joint_compliance", "joint_cross_compliance@j1-j2"],
            1,
            "joint_cross_compliance.j1-j2: couples a shared joint",
        ),
        (["joint_compliance", "joint_hardening@j1"], 1, "joint_hardening.j1: no linear spring on a shared joint"),
        (["joint_compliance", "backlash@j2"], 2, "backlash.j2: no linear spring on a shared joint"),
        (["joint_compliance", "load_direction"], 1, "load_direction: also loads the joints that carry the other arm"),
    ],
)
def test_what_two_arms_cannot_share_is_named(effects, joints, part):
    shared, wrong = names(load_robot("sda5f_r1"), effects, joints)
    assert [line for line in wrong if line.startswith(part)]
    assert not {line.partition(":")[0] for line in wrong} & shared
    assert names(load_robot("sda5f_r1"), effects, 0) == (frozenset(), [])


@pytest.mark.parametrize("effect", ["joint_hardening@j3", "joint_cross_compliance@j2-j3", "load_com"])
def test_what_an_arm_has_for_itself_is_no_matter(effect):
    assert names(load_robot("sda5f_r1"), ["joint_compliance", effect], 1) == ({"joint_compliance.j1"}, [])


# --- bad input

FIRST, SECOND = BOTH["arms"]
WRONG = {
    "a third arm": ({"arms": [FIRST, SECOND, {"name": "C", "study": "a.toml"}]}, ["[[arms]]: two tables", "3 given"]),
    "one arm": ({"arms": [FIRST]}, ["[[arms]]: two tables expected, each with name and study; 1 given"]),
    "no list": ({"arms": {"name": "A"}}, ["[[arms]]: two tables expected", "none given"]),
    "no file": (
        {"arms": [FIRST, {"name": "B", "study": "none.toml"}]},
        ["[[arms]] 2 study = 'none.toml'", "No such file"],
    ),
    "no study": ({"arms": [FIRST, {"name": "B"}]}, ["[[arms]] 2 study: is missing"]),
    "its own file": ({"arms": [FIRST, {"name": "B", "study": "both.toml"}]}, ["this is a study of two arms"]),
    "same name": (
        {"arms": [FIRST, {"name": "A", "study": "b.toml"}]},
        ["[[arms]] 2 name = 'A'", "every arm needs its"],
    ),
    "name is a key": (
        {"arms": [FIRST, {"name": "weight", "study": "b.toml"}]},
        ["[[arms]] 2 name = 'weight': is a key"],
    ),
    "unknown table": (
        {"plann": {}},
        ["[plann]: unknown table (did you mean 'plan'?)", "arms, waist, test_poses, plan"],
    ),
    "loads of one arm": (
        {"plan": {"loads": ["L1"]}},
        ["[plan] loads = ['L1']: is not for two arms", "poses, tolerance_mm"],
    ),
    "poses and tolerance": (
        {"plan": {"tolerance_mm": 1.0}},
        ["[plan] poses = 7: give poses or tolerance_mm, not both"],
    ),
    "negative waist": ({"waist": {"shared_joints": -1}}, ["[waist] shared_joints = -1: must be at least 0"]),
    "all joints shared": ({"waist": {"shared_joints": 3}}, ["[waist] shared_joints = 3: at most 2: each arm needs"]),
    "no waist": ({"waist": None}, ["[[arms]] 2 base_mm = [0.0, 0.0, 0.0]: stands where the other arm stands"]),
    "two bases": (
        {"arms": [FIRST, {**SECOND, "base_mm": [1, 0, 0]}]},
        ["[waist] shared_joints = 1", "leave base_mm out"],
    ),
    "two mounts": (
        {"second": {"robot": {"mount_deg": [0, 0, 5]}}},
        ["[waist] shared_joints = 1", "one [robot] mount_deg"],
    ),
    "two robots": (
        {"second": {"robot": {"model": "sda5f_r1"}}, "test_poses": None},
        ["joint 1 is not the same in both robots: its limits are -360 to 360 deg and -170 to 170 deg"],
    ),
    "two gravities": (
        {"second": {"robot": {"gravity_ms2": 1.6}}},
        ["[[arms]] 2 study = 'b.toml'", "gravity_ms2 is not"],
    ),
    "no loads": ({"first": {"loads": [{"id": "L0"}]}}, ["[[arms]] 1 study = 'a.toml': loads nothing"]),
    "effects differ": (
        {"second": {"model": {"effects": ["joint_compliance@j2", "joint_compliance@j3"]}}},
        ["[[arms]] 2 study = 'b.toml': its model lacks joint_compliance.j1, which belongs to both arms"],
    ),
    "nominals differ": (
        {"second": {"model": {"nominal": {"joint_compliance.j1": 2.5}}}},
        ["[[arms]] 2 study = 'b.toml': [model.nominal] joint_compliance.j1 = 2.5, the study of A says 0;"],
    ),
    "a pair across": (
        {"first": {"model": {"effects": ["joint_compliance", "joint_cross_compliance@j1-j2"]}}},
        ["[[arms]] 1 study = 'a.toml': [model] effects, joint_cross_compliance.j1-j2: couples", "name@j2"],
    ),
    "unknown place": ({"first": {"model": {"effects": ["joint_compliance@j9"]}}}, ["[[arms]] study", "no such place"]),
    "unknown arm": ({"test_poses": [{**TASK, "R2": TASK["B"]}]}, ["[[test_poses]] 1 R2: unknown arm", "A, B, weight"]),
    "an arm left out": ({"test_poses": [{"A": TASK["A"]}]}, ["[[test_poses]] 1 B: is missing; a task says what both"]),
    "bad weight": ({"test_poses": [{**TASK, "weight": 0}]}, ["[[test_poses]] 1 weight = 0: must be above 0"]),
    "weight of one arm": (
        {"test_poses": [{"A": {"joints_deg": UP, "weight": 1.0}, "B": TASK["B"]}]},
        ["[[test_poses]] 1 A weight = 1.0: unknown key"],
    ),
    "no table": ({"test_poses": [{"A": 1, "B": TASK["B"]}]}, ["[[test_poses]] 1 A = 1: a table expected"]),
    "no list of tasks": ({"test_poses": {"A": TASK["A"]}}, ["[test_poses]: a list of tables expected"]),
    "too few joints": (
        {"test_poses": [{"A": {"joints_deg": [20.0, 1.0]}, "B": TASK["B"]}]},
        ["[[test_poses]] 1 A joints_deg = [20.0, 1.0]: 3 values expected"],
    ),
    "outside limits": (
        {"test_poses": [{"A": {"joints_deg": [20.0, 400.0, 0.0]}, "B": TASK["B"]}]},
        ["[[test_poses]] 1 A joints_deg, entry 2 = 400.0: outside the limits"],
    ),
    "unequal waist": (
        {"test_poses": [{"A": TASK["A"], "B": {"joints_deg": [21.0, 10.0, 40.0]}}]},
        ["[[test_poses]] 1 B joints_deg, entry 1 = 21.0: the joint is shared and A has 20 there"],
    ),
    "far apart": (
        {"test_poses": [{"A": TASK["A"], "B": {"joints_deg": [20.0, -150.0, 0.0]}}]},
        ["[[test_poses]] 1: the tool points are", "mm apart, at most 1000 mm"],
    ),
}


@pytest.mark.parametrize("case", list(WRONG))
def test_each_mistake_is_named_with_file_key_and_what_is_allowed(tmp_path, case):
    changes, parts = WRONG[case]
    said = message(tmp_path, **changes)
    assert str(tmp_path / "both.toml") in said
    for part in parts:
        assert part in said


def test_all_problems_come_together(tmp_path):
    said = message(
        tmp_path,
        first={"markers": None},
        plan={"poses": -1},
        waist={"joints": 1},
        test_poses=[{"A": {"joints_deg": UP, "wrench": [1]}, "B": {"joints_deg": [0, 0]}}],
    )
    assert "[markers]: is missing" in said
    assert "a.toml" in said
    assert "[plan] poses = -1" in said
    assert "[waist] joints = 1: unknown key (did you mean 'shared_joints'?)" in said
    said = message(tmp_path, plan={"poses": -1}, test_poses=[{"A": {"joints_deg": UP, "wrench": [1]}, "C": {}}])
    for part in ("4 problems", "A wrench", "1 C: unknown arm", "1 B: is missing", "poses = -1"):
        assert part in said


def test_absolute_readings_would_show_the_weight_of_the_other_arm(tmp_path):
    """Both arms have known masses: the other one hangs on the waist too, and its posture is in no model."""
    from identify.robot_files import shipped_robots

    text = (
        shipped_robots()["arm_3dof"]
        .read_text()
        .replace("\n[[joints]]\n", "\n[[joints]]\nmass_kg = 5\ncom_mm = [1, 2, 3]\n")
    )
    (tmp_path / "heavy.toml").write_text(text)
    robot = {"robot": {"model": "heavy.toml"}}
    said = message(tmp_path, first=robot, second=robot)
    assert "[[arms]] 1 study = 'a.toml': the other arm hangs on the shared joints too" in said
    assert 'set [model] reference = "differences" there' in said
    changes = {**robot, "model": {"reference": "differences"}}
    assert load_study(tmp_path / "a.toml").robot.masses_known
    assert both(tmp_path, first=changes, second=changes).shared == 1


def test_the_loader_of_one_arm_says_what_to_give_it(tmp_path):
    path = write_both(tmp_path)
    with pytest.raises(
        InputError, match=r"\[\[arms\]\]: this is a study of two arms, which only plan and evaluate take"
    ):
        load_study(path)


def test_a_wrong_file_is_refused(tmp_path):
    path = tmp_path / "both.toml"
    for content, part in ((b"arms = [", "no TOML"), (b"\xff", "no UTF-8 text")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=part):
            load_two_arm_study(path)
    path.write_text(tomli_w.dumps(BOTH))
    with pytest.raises(InputError, match=r"a\.toml cannot be read"):
        load_two_arm_study(path)


def test_every_key_is_documented_with_the_limit_of_the_code():
    text = (SDA5F.parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    section = text[text.index("### Two arms that face one task") : text.index("## The truth of a simulation")]
    schemas = (ArmSection, WaistSection, TwoArmPlanSection, ArmPoseSection)
    keys = {key for schema in schemas for key in schema.model_fields} | {"weight"}
    assert len(keys) > 15
    assert not [key for key in sorted(keys) if f"`{key}`" not in section]
    assert f"at most {two_arm_checks._FAR * 1e3:g} mm apart" in " ".join(section.split())


def test_the_example_of_the_page_is_a_study(tmp_path):
    text = (SDA5F.parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    section = text[text.index("### Two arms that face one task") :]
    example = section[section.index("```toml\n") + 8 :].partition("```")[0]
    for name in ("sda5f_r1.toml", "sda5f_r2.toml"):
        content = (SDA5F.parent / name).read_text().replace('"../robots/', f'"{SDA5F.parents[1]}/robots/')
        (tmp_path / name).write_text(content)
    (tmp_path / "both.toml").write_text(example)
    study = load_two_arm_study(tmp_path / "both.toml")
    assert study.shared == 1
    assert np.linalg.norm(np.diff(task_points(study)[0], axis=0)) < 0.01
