"""Models that other people made: what MJCF, URDF and SDF say is read, or refused by name."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from other_models import (
    ARM,
    GANTRY,
    GRAVITY,
    INERTIAL,
    MESH,
    MOTOR,
    TRANSMISSION,
    carry_double_pendulum,
    make,
    write,
)
from space_models import SPHERE, ball_and_finger, collision, make_scenario

from drake_aigto import Scenario, World, plan
from drake_aigto.errors import ModelError


def test_a_gear_multiplies_the_range_of_control_of_a_class_of_defaults(arm: Any) -> None:
    np.testing.assert_array_equal(arm().limits.control, [[-10.0], [15.0]])


def test_defaults_hold_in_classes_below_theirs_that_do_not_say_them(arm: Any) -> None:
    plant = arm(JOINT='class="strong"').plant
    joints = [plant.GetJointByName(name) for name in ("shoulder", "elbow")]
    assert [joint.default_damping() for joint in joints] == [0.5, 0.5]


@pytest.mark.parametrize(
    ("actuator", "limits"),
    [
        ('<motor joint="elbow" gear="-2" ctrlrange="-1 3"/>', (-6.0, 2.0)),
        ('<motor joint="elbow" gear="2" ctrlrange="-9 9" forcerange="-1 3"/>', (-2.0, 6.0)),
        ('<motor joint="elbow" gear="2" ctrlrange="-1 1" ctrllimited="false"/>', (-np.inf, np.inf)),
        ('<general joint="elbow" gainprm="4" gear="2" ctrlrange="-1 1"/>', (-8.0, 8.0)),
    ],
)
def test_effective_limits_are_those_of_control_and_of_force(
    arm: Any, actuator: str, limits: tuple[float, float]
) -> None:
    np.testing.assert_array_equal(arm(ACTUATORS=actuator).limits.control.ravel(), limits)


def test_a_tendon_along_one_joint_is_an_actuator_of_that_joint(arm: Any) -> None:
    tendon = (
        '<tendon><fixed name="t"><joint joint="elbow" coef="3"/><joint joint="shoulder" coef="0"/>'
        "</fixed></tendon>"
    )
    world = arm(FLAGS=tendon, ACTUATORS='<motor name="pull" tendon="t" gear="2" ctrlrange="-1 1"/>')
    assert world.limits.control[1] == 6.0
    np.testing.assert_array_equal(world.actuation.ravel(), [0.0, 1.0])


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_forces_of_two_actuators_at_one_joint_add_up(arm: Any, gantry: Any, kind: str) -> None:
    if kind == "urdf":
        second = TRANSMISSION.replace('name="t"', 'name="t2"').replace("drive", "drive2")
        world = gantry({"effort_limits": {"drive2": 3.0}}, MORE=TRANSMISSION + second)
        with pytest.raises(ModelError, match=r"got joint 'x', which 'drive', 'drive2' drive, exp"):
            gantry({"effort_limits": {"x": 3.0}}, MORE=TRANSMISSION + second)
        with pytest.raises(ModelError, match=r"already contains a joint actuator named 'drive'"):
            gantry(MORE=TRANSMISSION + TRANSMISSION)
    else:
        motors = '<motor joint="shoulder" gear="5" ctrlrange="-1 1"/><motor joint="shoulder" '
        world = arm(ACTUATORS=motors + 'ctrlrange="-3 3"/>', JOINT='armature="2"')
    np.testing.assert_array_equal(world.limits.control[1], [5.0, 3.0])
    np.testing.assert_array_equal(world.actuation, [[1.0, 1.0], [0.0, 0.0]])


def test_springs_and_friction_of_joints_act(arm: Any) -> None:
    plain = arm(OPTION='gravity="0 0 0"')
    sprung = arm(OPTION='gravity="0 0 0"', JOINT='stiffness="4" springref="30" frictionloss="0.25"')
    q, v = np.array([0.2, 0.3]), np.array([0.0, 0.0])
    force = sprung.calc_bias(q, v) - plain.calc_bias(q, v)
    np.testing.assert_allclose(force, [4 * (0.2 - np.pi / 6), 0.0], atol=1e-12)
    assert plain.dry_friction is None
    np.testing.assert_array_equal(sprung.dry_friction, [0.25, 0.0])


@pytest.mark.parametrize(
    ("flag", "springs", "has_gravity", "has_limit"),
    [
        ("gravity", True, False, True),
        ("spring", False, True, True),
        ("passive", False, True, True),
        ("limit", True, True, False),
        ("constraint", True, True, False),
    ],
)
def test_flags_turn_off_what_they_name(
    arm: Any, flag: str, springs: bool, has_gravity: bool, has_limit: bool
) -> None:
    world = arm(FLAGS=f'<option><flag {flag}="disable"/></option>', JOINT='stiffness="4"')
    q, still = np.array([0.5, -0.5]), np.zeros(2)
    force = world.calc_bias(q, still)[0]
    weight = (2 * 0.5 * np.sin(0.5) + 1.0 * (np.sin(0.5) + 0.25 * 0.0)) * GRAVITY
    assert force == pytest.approx(springs * 4 * 0.5 + has_gravity * weight, rel=1e-9)
    assert np.isfinite(world.limits.position[1, 1]) == has_limit


def test_a_total_mass_scales_all_of_the_model(arm: Any) -> None:
    q, v = np.array([0.3, 0.4]), np.array([0.5, 0.6])
    masses = [
        arm(FLAGS=f'<compiler settotalmass="{mass}"/>').calc_mass_matrix(q) for mass in (3.0, 6.0)
    ]
    np.testing.assert_allclose(masses[1], 2 * masses[0], rtol=1e-12)
    np.testing.assert_allclose(masses[0], arm().calc_mass_matrix(q), rtol=1e-12)
    assert v.size == 2


REFUSED = {
    "fluid": ({"OPTION": 'density="1000"'}, "the density 1000 of a fluid .its forces"),
    "gravcomp": (
        {"JOINT": '/><body gravcomp="1"><geom size=".1"/></body><site'},
        "gravcomp of body",
    ),
    "armature": ({"JOINT": 'armature="1"', "ACTUATORS": ""}, "the armature 1 of joint 'shoulder'"),
    "springdamper": ({"JOINT": 'springdamper="1 1"'}, "springdamper of joint 'shoulder'"),
    "polynomials": ({"JOINT": 'damping="1 2"'}, "damping 1 2 of joint 'shoulder'"),
    "inertias": ({"FLAGS": '<compiler boundmass="3" boundinertia="0"/>'}, "boundmass of <compiler"),
    "equality": (
        {"FLAGS": '<equality><joint joint1="shoulder" joint2="elbow"/></equality>'},
        "<equality><joint>",
    ),
    "tendons": (
        {"FLAGS": '<tendon><fixed name="t" stiffness="2"><joint joint="elbow"/></fixed></tendon>'},
        "tendon 't' with stiffness",
    ),
    "servos": (
        {"ACTUATORS": '<position name="p" joint="elbow" kp="3" forcerange="-2 2"/>'},
        "actuator 'p', a servo",
    ),
    "actuators": (
        {"ACTUATORS": f'{MOTOR}<motor name="s" site="tip"/>'},
        "actuator 's', which acts through a site",
    ),
}


LEFT_OUT = {
    "free": (
        {"JOINT": '/><body name="c"><freejoint name="f"/><geom size=".1"/></body><site'},
        "actuator 'm' at joint 'f', which turns in space",
    ),
    "replicate": (
        {"JOINT": '/><replicate count="2"><body><joint name="f"/></body></replicate><site'},
        "actuator 'm' at joint 'f', which is left out",
    ),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_actuators_of_what_can_not_be_driven_are_refused_with_it(arm: Any, name: str) -> None:
    parts, message = LEFT_OUT[name]
    with pytest.raises(ModelError, match=f"{message}.*allow_ignored: .*actuators"):
        arm(**parts, ACTUATORS=f'{MOTOR}<motor name="m" joint="f"/>')


@pytest.mark.parametrize("word", REFUSED)
def test_what_changes_the_physics_is_refused_by_name_or_left_out_as_allowed(
    arm: Any, word: str
) -> None:
    parts, message = REFUSED[word]
    with pytest.raises(ModelError, match=f"{message}.*allow_ignored: .{word}"):
        arm(**parts)
    if word == "armature":
        parts = {"JOINT": 'armature="1"', "ACTUATORS": '<motor joint="elbow"/>'}
    world = arm({"allow_ignored": [word]}, **parts)
    assert len(world.ignored) == 1


def test_drawing_and_numerics_are_read_without_a_word(
    arm: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        world = arm()
    assert not caplog.records
    assert world.notes == world.ignored == ()


def test_includes_are_read_and_missing_ones_refused(tmp_path: Path) -> None:
    part = tmp_path / "motors.xml"
    part.write_text(f"<mujocoinclude>{MOTOR}</mujocoinclude>", encoding="utf-8")
    model = write(tmp_path / "arm.xml", ARM, ACTUATORS='<include file="motors.xml"/>')
    assert make(model).limits.control[1] == 15.0
    part.unlink()
    with pytest.raises(ModelError, match=r"an <include> of .*motors\.xml, which is missing"):
        make(model)
    part.write_text('<mujocoinclude><include file="motors.xml"/></mujocoinclude>')
    with pytest.raises(ModelError, match="which includes itself"):
        make(model)


BAD_MJCF = {
    "all at once": (
        {"OPTION": 'density="1"', "JOINT": 'springdamper="1 1"'},
        r"allow_ignored: \[fluid, springdamper\]",
    ),
    "what Drake asserts": (
        {"JOINT": '/><body pos="0 0 1"><geom size="-1"/></body><site'},
        r"Drake can't parse the model .*arm.xml: got .*radius",
    ),
    "a gear of 0": ({"ACTUATORS": '<motor joint="elbow" gear="0"/>'}, "with a gear of 0"),
    "an unknown joint": ({"ACTUATORS": '<motor joint="knee"/>'}, "the unknown joint 'knee'"),
    "an unknown class": ({"ACTUATORS": '<motor joint="elbow" class="x"/>'}, "unknown class 'x'"),
    "two within one range": (
        {"JOINT": 'actuatorfrcrange="-1 1"', "ACTUATORS": f'{MOTOR}<motor joint="shoulder"/>'},
        "'motor' and 'shoulder_motor' at joint 'shoulder' with an actuatorfrcrange, expected one",
    ),
    "no range": ({"JOINT": 'range="1 -1"'}, "range of joint 'shoulder' .* from 1 to -1, expected"),
    "no range of control": (
        {"ACTUATORS": '<motor name="m" joint="elbow" ctrlrange="1 0"/>'},
        "ctrlrange of actuator 'm' in .*: got from 1 to 0, expected least first",
    ),
    "no number": ({"JOINT": 'stiffness="much"'}, "got 'much', expected finite numbers"),
    "NaN": ({"JOINT": 'stiffness="nan"'}, "got 'nan', expected finite numbers"),
}


@pytest.mark.parametrize("name", BAD_MJCF)
def test_a_bad_mjcf_is_refused_by_name(arm: Any, name: str) -> None:
    parts, message = BAD_MJCF[name]
    with pytest.raises(ModelError, match=message):
        arm(**parts)


SAME_TWICE = {
    "several joints of a turned body": (
        """<body name="a" pos=".3 .1 .2" euler="0 30 0">
          <joint name="x" type="slide" axis="1 0 1"/>
          <joint name="y" axis="0 1 0" pos=".1 .2 .3" range="-9 9"/>
          <joint name="z" axis="0 0 1" pos="0 -.1 .3" damping=".3"/>
          <geom type="box" size=".1 .2 .3" pos=".2 .1 0"/></body>""",
        """<body name="c" pos=".3 .1 .2" euler="0 30 0"><joint name="x" type="slide" axis="1 0 1"/>
          <body name="b"><joint name="y" axis="0 1 0" pos=".1 .2 .3" range="-9 9"/>
          <body name="a"><joint name="z" axis="0 0 1" pos="0 -.1 .3" damping=".3"/>
          <geom type="box" size=".1 .2 .3" pos=".2 .1 0"/></body></body></body>""",
    ),
    "frames": (
        """<frame pos="0 0 1" euler="0 90 0"><body name="a"><joint name="x" axis="0 1 0"/>
          <frame pos="0.1 0 0"><geom size=".1" pos="0 0 .4"/></frame></body></frame>""",
        """<body pos="0 0 1" euler="0 90 0"><body name="a"><joint name="x" axis="0 1 0"/>
          <geom size=".1" pos=".1 0 .4"/></body></body>""",
    ),
    "a box from a point to another": (
        """<body name="a"><joint name="x" axis="0 1 0"/>
          <geom type="box" fromto=".1 0 0 .1 0 .6" size=".05 .2"/></body>""",
        """<body name="a"><joint name="x" axis="0 1 0"/>
          <geom type="box" size=".05 .05 .3" pos=".1 0 .3"/></body>""",
    ),
    "actuators of groups that are off": (
        """<body name="a"><joint name="x" axis="0 1 0"/><geom size=".1" pos="0 0 .4"/></body>
          </worldbody><option actuatorgroupdisable="1 2"/>
          <actuator><motor joint="x" group="2" gear="7"/></actuator><worldbody>""",
        """<body name="a"><joint name="x" axis="0 1 0"/><geom size=".1" pos="0 0 .4"/></body>""",
    ),
    "groups that weigh nothing": (
        """<body name="a"><joint name="x" axis="0 1 0"/><geom size=".1" pos="0 0 .4"/>
          <geom group="3" size=".3"/></body>""",
        """<body name="a"><joint name="x" axis="0 1 0"/><geom size=".1" pos="0 0 .4"/></body>""",
    ),
    "ranges that do not count": (
        """<body name="a"><joint name="x" axis="0 1 0" range="-1 1" limited="false"/>
          <geom size=".1" pos="0 0 .4"/></body>""",
        """<body name="a"><joint name="x" axis="0 1 0"/><geom size=".1" pos="0 0 .4"/></body>""",
    ),
}


@pytest.mark.parametrize("name", SAME_TWICE)
def test_an_mjcf_and_a_plainer_one_of_the_same_mean_the_same(tmp_path: Path, name: str) -> None:
    worlds, size = [], 3 if "joints" in name else 1
    for i, bodies in enumerate(SAME_TWICE[name]):
        model = tmp_path / f"m{i}.xml"
        model.write_text(
            '<mujoco><compiler inertiagrouprange="0 2" autolimits="AUTO"/><worldbody>'.replace(
                "AUTO", "false" if "count" in name else "true"
            )
            + f'{bodies}</worldbody><actuator><motor joint="x" gear="3"/></actuator></mujoco>',
            encoding="utf-8",
        )
        worlds.append(make(str(model), size, goal_weight=np.ones(size)))
    q, v = np.array([0.3, -0.02, 0.7])[:size], np.array([0.4, 0.5, -0.6])[:size]
    one, other = worlds
    np.testing.assert_allclose(one.calc_mass_matrix(q), other.calc_mass_matrix(q), atol=1e-9)
    np.testing.assert_allclose(one.calc_bias(q, v), other.calc_bias(q, v), atol=1e-9)
    np.testing.assert_array_equal(one.limits.position, other.limits.position)
    np.testing.assert_array_equal(one.actuation, other.actuation)
    assert one.notes == other.notes or "groups" in name


@pytest.mark.slow
def test_two_poles_on_a_cart_are_carried_along_upright(tmp_path: Path) -> None:
    found = plan(carry_double_pendulum(tmp_path))
    assert found.holds
    np.testing.assert_allclose(found.trajectory.positions[-1], [0.5, 0.0, 0.0], atol=0.02)


def test_masks_and_flags_keep_shapes_apart(tmp_path: Path) -> None:
    text = """<mujoco model="balls"><option gravity="0 0 0">FLAG</option>
      <default><geom size="0.1" MASKS/></default>
      <worldbody><geom name="floor" type="plane" size="1 1 1" pos="0 0 -1"/>
      <body name="a"><joint name="x" type="slide" axis="0 0 1"/><geom name="a"/></body>
      <body name="b" pos="0 0 1"><joint name="y" type="slide" axis="0 0 1"/><geom name="b"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""

    def list_pairs(flag: str, masks: str) -> list[str]:
        path = tmp_path / "balls.xml"
        path.write_text(text.replace("FLAG", flag).replace("MASKS", masks), encoding="utf-8")
        world = make(str(path), limits="ignore", ignored_shapes=())
        return sorted(contact.name for contact in world.contacts)

    assert list_pairs("", "") == ["a against b", "a against floor", "b against floor"]
    assert list_pairs('<flag contact="disable"/>', "") == []
    assert list_pairs("", 'contype="1" conaffinity="0"') == []


def test_masks_keep_capsules_apart_and_their_ends_from_floors(tmp_path: Path) -> None:
    text = """<mujoco model="pills"><option gravity="0 0 0"/>
      <default><geom type="capsule" size="0.1 0.2"/></default>
      <worldbody><geom name="floor" type="plane" size="1 1 1"/>
      <body pos="0 0 1"><joint name="x" type="slide" axis="0 0 1"/><geom/></body>
      <body pos="0 0 2"><joint type="slide" axis="0 0 1"/><geom contype="2" conaffinity="2"/></body>
      <body pos="0 0 3"><joint type="slide" axis="0 0 1"/><geom contype="4" conaffinity="4"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "pills.xml"
    model.write_text(text, encoding="utf-8")
    world = make(str(model), 3, ignored_shapes=())
    names = [contact.name for contact in world.contacts]
    assert names == ["body0_geom0 end 1 against floor", "body0_geom0 end 2 against floor"]


def test_a_name_that_fits_two_shapes_is_refused_and_globs_take_both(tmp_path: Path) -> None:
    ball = '<collision name="ball"><geometry><sphere radius="0.1"/></geometry></collision>'
    text = GANTRY.replace('<link name="bridge">INERTIAL', f'<link name="bridge">INERTIAL{ball}')
    model = write(tmp_path / "gantry.urdf", text, COLLISION=ball)
    stiff = {"stiffness": 1e5}
    with pytest.raises(ModelError, match=r"'ball', which fits .*bridge::ball, .*trolley::ball"):
        make(model, material={"ball": stiff})
    make(model, material={"ball*": stiff})
    make(model, material={"trolley::ball": stiff})


def test_a_capsule_touches_a_floor_with_its_two_ends(tmp_path: Path) -> None:
    text = ARM.replace(' contype="0" conaffinity="0"', "").replace('pos="0 0 2"', 'pos="0 0 0.9"')
    model = write(tmp_path / "arm.xml", text)
    ends: dict[str, Any] = {"initial_position": [1.5, 0.0], "goal_position": [1.5, 0.1]}
    world = make(model, ignored_shapes=["rod"], **ends)
    names = [contact.name for contact in world.contacts]
    assert names == ["stick end 1 against floor", "stick end 2 against floor"]
    q = np.array([0.7, -0.4])
    elbow = np.array([-np.sin(0.7), 0.9 - np.cos(0.7)])
    tip = elbow + 0.5 * np.array([-np.sin(0.3), -np.cos(0.3)])
    distances = sorted(world.calc_signed_distance(q))
    np.testing.assert_allclose(distances, sorted([elbow[1] - 0.04, tip[1] - 0.04]), atol=1e-9)
    everywhere = make(model)
    assert everywhere.notes == ("nothing can touch: shapes that would are ignored",)


def test_pairs_that_are_not_planned_for_are_listed_at_once_and_left_out_if_allowed(
    tmp_path: Path,
) -> None:
    text = """<mujoco model="m"><option gravity="0 0 0"/><worldbody>
      <geom name="wall" type="box" size="0.1 1 1" pos="-9 0 0"/>
      <body name="a"><joint name="x" type="slide" axis="1 0 0"/>
        <geom name="pill" type="capsule" size="0.1 0.2"/></body>
      <body name="b" pos="3 0 0"><joint name="y" type="slide" axis="1 0 0"/>
        <geom name="can" type="cylinder" size="0.1 0.2"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "m.xml"
    model.write_text(text, encoding="utf-8")
    names: dict[str, Any] = {"ignored_shapes": ()}
    message = (
        "contacts: got .*Box against Capsule: pill with wall.*: .*ignored_shapes: .m::pill, "
        "m::can.*: .pairs"
    )
    with pytest.raises(ModelError, match=message):
        make(str(model), **names)
    world = make(str(model), allow_ignored=["pairs"], **names)
    assert len(world.ignored) == 3 and not world.contacts


def test_all_that_is_wrong_comes_with_one_answer_that_works(tmp_path: Path) -> None:
    text = GANTRY.replace('link="world"', 'link="cart"').replace('name="world"', 'name="cart"')
    mesh = MESH.replace("NAME", "hook").replace("FILE", "hook.stl")
    mimic = text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="x"/>')
    model = write(tmp_path / "gantry.urdf", mimic, MORE="", COLLISION=mesh)
    with pytest.raises(ModelError) as caught:
        make(model)
    remedy = caught.value.remedy or ""
    text = remedy.partition("answer that: ")[2].partition(", or change")[0]
    answers = yaml.safe_load(text)
    assert set(answers) == {"collisions", "allow_ignored", "actuators", "weld"}
    assert make(model, **answers).num_actuators == 2


@pytest.mark.parametrize("limits", ["model", "ignore"])
@pytest.mark.parametrize("damping", ["0.0", "0.3"])
def test_a_gantry_that_touches_nothing_is_planned_for(
    tmp_path: Path, limits: str, damping: str
) -> None:
    text = GANTRY.replace('damping="0.3" friction="0.7"', f'damping="{damping}"')
    fields: dict[str, Any] = {"initial_position": [0.0, 0.0], "initial_velocity": [0.0, 0.0]}
    fields |= {"goal_position": [0.5, 0.2], "time_step": 0.05, "actuators": ["y"], "limits": limits}
    assert plan(Scenario(model=write(tmp_path / "gantry.urdf", text), **fields)).holds


def test_too_many_joints_are_refused_at_once_with_joints_to_fix(tmp_path: Path) -> None:
    bodies, ends = "", ""
    for i in range(9):
        axis = ("1 0 0", "0 1 0", "0 0 1")[i % 3]
        bodies += f'<body pos="0.1 0.2 0.3"><joint name="j{i}" axis="{axis}"/>'
        bodies += '<geom type="sphere" size="0.1" pos="0.3 0.2 0.1"/>'
        ends += "</body>"
    model = tmp_path / "chain.xml"
    model.write_text(
        f'<mujoco model="chain"><worldbody>{bodies}{ends}</worldbody>'
        '<actuator><motor joint="j0"/></actuator></mujoco>',
        encoding="utf-8",
    )
    start = time.process_time()
    with pytest.raises(ModelError, match=r"coordinates at once.*fixed_joints: .j"):
        make(str(model), size=9)
    refused = time.process_time()
    assert make(str(model), size=2, fixed_joints=["j[2-8]"]).num_positions == 2
    # As many sums of products as nine joints have take minutes.
    assert refused - start < 20.0 * (time.process_time() - refused)


def test_contact_across_too_many_joints_is_refused_at_once_with_shapes_to_leave_out(
    tmp_path: Path,
) -> None:
    text = '<mujoco model="hands"><option gravity="0 0 0"/><worldbody>'
    for hand in "ab":
        for i in range(4):
            text += f'<body pos="0.3 0 0"><joint name="{hand}{i}" axis="0 1 0"/><geom name="'
            text += f'{hand}{i}" size="0.1" contype="{i == 3:d}" conaffinity="{i == 3:d}"/>'
        text += "</body>" * 4
    text += '</worldbody><actuator><motor joint="a0"/></actuator></mujoco>'
    model = tmp_path / "hands.xml"
    model.write_text(text, encoding="utf-8")
    start = time.process_time()
    with pytest.raises(ModelError, match="joints: a3 with b3, expected") as caught:
        make(str(model), size=8, ignored_shapes=())
    refused = time.process_time()
    answer = getattr(caught.value, "fields", {})
    assert len(answer["ignored_shapes"]) == 1
    assert not make(str(model), size=8, **answer).contacts
    assert refused - start < 20.0 * (time.process_time() - refused)


def test_joints_of_all_arms_are_fixed_by_one_answer_and_floors_stay(tmp_path: Path) -> None:
    axes = "1 0 0", "0 1 0", "0 0 1"
    text = '<mujoco model="m"><worldbody><geom name="floor" type="plane" size="1 1 1"/>'
    text += '<body name="base" pos="0 0 9"><freejoint/><geom size="0.1" conaffinity="0"/>'
    for arm in "ab":
        for i in range(6):
            text += f'<body pos="0.1 0.2 0.3"><joint name="{arm}{i}" axis="{axes[i % 3]}"/>'
            text += '<geom size="0.1" pos="0.3 0.2 0.1" conaffinity="0"/>'
        text += "</body>" * 6
    text += '</body></worldbody><actuator><motor joint="a0"/></actuator></mujoco>'
    model = tmp_path / "m.xml"
    model.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match="With contact: compliant, links may float") as caught:
        make(str(model), size=12, ignored_shapes=(), allow_ignored=["pairs"])
    answer = getattr(caught.value, "fields", {})
    assert set(answer) == {"weld", "fixed_joints"}
    assert sorted(answer["fixed_joints"]) == ["a5", "b5"]


@pytest.mark.parametrize(("effort", "driven"), [("9", "all"), ("0", [f"j{i}" for i in range(5)])])
def test_an_answer_drives_joints_that_it_does_not_fix(
    tmp_path: Path, effort: str, driven: str | list[str]
) -> None:
    text, parent = '<robot name="arm"><link name="world"/>', "world"
    inertial = INERTIAL.replace("MASS", "1")
    for i in range(7):
        axis = ("1 0 0", "0 1 0", "0 0 1")[i % 3]
        text += f'<link name="l{i}">{inertial}</link><joint name="j{i}" type="revolute">'
        text += f'<parent link="{parent}"/><child link="l{i}"/><origin xyz="0.1 0.2 0.3"/>'
        limit = f'effort="{effort if i == 6 else 9}" lower="-2" upper="2" velocity="9"'
        text += f'<axis xyz="{axis}"/><limit {limit}/></joint>'
        parent = f"l{i}"
    model = tmp_path / "arm.urdf"
    model.write_text(f"{text}</robot>", encoding="utf-8")
    with pytest.raises(ModelError, match="the model lacks an actuator") as caught:
        make(str(model), size=7)
    answer = getattr(caught.value, "fields", {})
    assert answer["fixed_joints"] and answer["actuators"] == driven
    world = make(str(model), size=7 - len(answer["fixed_joints"]), **answer)
    assert world.num_actuators == world.num_positions - (effort == "0")


def test_a_pair_of_unlike_friction_is_noted_where_mujoco_combines_it_otherwise(
    tmp_path: Path,
) -> None:
    text = """<mujoco model="puck"><worldbody><geom name="floor" type="plane" size="1 1 1"/>
      <body name="puck" pos="0 0 0.3"><joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/><geom name="puck" size="0.1" friction="MU"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "puck.xml"
    fields: dict[str, Any] = {"ignored_shapes": (), "goal_position": [0.1, 0.0]}
    for friction, count in (("0.5", 1), ("1", 0)):
        model.write_text(text.replace("MU", friction), encoding="utf-8")
        notes = make(str(model), **fields).notes
        assert len(notes) == count
        assert all("as in MuJoCo: floor with puck::puck" in note for note in notes)


def test_all_links_that_float_are_answered_at_once(tmp_path: Path) -> None:
    text = GANTRY.replace('link="world"', 'link="cart"').replace('name="world"', 'name="cart"')
    second = '<link name="hook">INERTIAL</link>'
    model = write(tmp_path / "gantry.urdf", text, MORE=TRANSMISSION + second)
    with pytest.raises(ModelError, match=r"'cart', so it floats: .*'hook', so it fl") as caught:
        make(model)
    answer = getattr(caught.value, "fields", {})
    assert set(answer["weld"]) == {"cart", "hook"}
    assert make(model, **answer).num_positions == 2


def test_many_pairs_are_listed_by_what_they_are(tmp_path: Path) -> None:
    text = '<mujoco model="m"><option gravity="0 0 0"/><worldbody>'
    for name in "abcd":
        text += f'<body name="{name}"><joint name="{name}" axis="1 1 1"/>'
        text += f'<geom name="{name}" type="ellipsoid" size="0.1 0.1 0.2"/></body>'
    text += '<geom name="e" type="cylinder" size="0.1 0.2"/></worldbody>'
    model = tmp_path / "m.xml"
    model.write_text(f'{text}<actuator><motor joint="a"/></actuator></mujoco>', encoding="utf-8")
    pairs = "Cylinder against Ellipsoid: e with a, b, c, d. Ellipsoid against Ellipsoid: any two of"
    with pytest.raises(ModelError, match=f"contacts: got {pairs} a, b, c, d, expected"):
        make(str(model), size=4, ignored_shapes=())


BRICK = """<robot name="brick"><link name="world"/>
  <link name="cart">INERTIAL
    <collision name="brick"><geometry><box size="2 1 0.2"/></geometry></collision></link>
  <link name="arm">INERTIAL</link>
  <link name="tip">INERTIAL
    <collision name="tip"><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="x" type="prismatic"><parent link="world"/><child link="cart"/>
    <axis xyz="1 0 0"/><limit effort="9" lower="-0.4" upper="0.4" velocity="9"/></joint>
  <joint name="y" type="prismatic"><parent link="world"/><child link="arm"/>
    <axis xyz="1 0 0"/><limit effort="9" lower="-0.5" upper="UPPER" velocity="9"/></joint>
  <joint name="z" type="prismatic"><parent link="arm"/><child link="tip"/>
    <axis xyz="0 0 1"/><limit effort="9" lower="0.15" upper="1" velocity="9"/></joint>
  MORE</robot>"""


def test_of_a_moving_brick_one_face_counts_where_limits_say_so(tmp_path: Path) -> None:
    soft = {"*": {"stiffness": 1e4, "dissipation": 0.1, "friction": 0.0}}
    fields: dict[str, Any] = {"contact": "compliant", "material": soft, "goal_weight": np.ones(3)}
    fields |= {"initial_position": [0.0, 0.0, 0.5], "goal_position": [0.1, 0.0, 0.5]}
    fields |= {"ignored_shapes": ()}
    world = make(write(tmp_path / "brick.urdf", BRICK, UPPER="0.5"), 3, **fields)
    assert [contact.name for contact in world.contacts] == ["tip against cart"]
    q = np.array([0.3, -0.5, 0.21])
    np.testing.assert_allclose(world.calc_signed_distance(q), [0.01], atol=1e-12)
    model = write(tmp_path / "brick.urdf", BRICK, UPPER="0.7")  # Past an edge of the brick.
    in_space = make(model, 3, **fields)
    np.testing.assert_allclose(in_space.calc_signed_distance(q), [0.01], atol=1e-9)
    past = np.array([-0.4, 0.7, 0.15])
    distance = np.hypot(1.1 - 1.0, 0.15 - 0.1) - 0.1
    np.testing.assert_allclose(in_space.calc_signed_distance(past), [distance], atol=1e-9)
    planar = World.from_diagram(in_space.diagram)
    with pytest.raises(ModelError, match=r"several faces .*Take contact: rigid.*\[brick::brick\]"):
        _ = planar.springs
    assert len(make(model, 3, **{**fields, "contact": "rigid"}).contacts) > 1


def test_links_that_several_joints_connect_do_not_touch_each_other(tmp_path: Path) -> None:
    text = """<mujoco model="m"><option gravity="0 0 0"/><worldbody>
      <body name="a"><joint name="x" type="slide"/><geom name="a" size="0.1"/>
        <body name="b" pos="0 0 .5"><joint name="y" axis="0 1 0"/><joint name="z" axis="1 0 0"/>
          <geom name="b" size="0.1" pos="0 0 .5"/>
          <body name="c"><geom name="c" size="0.1" pos="0 .5 .5"/></body>
          <body name="d"><joint name="d" axis="0 1 0"/><geom name="d" size="0.1" pos="0 1 .5"/>
      </body></body></body></worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "m.xml"
    model.write_text(text, encoding="utf-8")
    world = make(str(model), 4, ignored_shapes=(), goal_weight=np.ones(4), friction=0.0)
    assert [contact.name for contact in world.contacts] == ["a against d"]


def test_a_tilted_ground_beside_many_shapes_is_where_it_is_beside_few(tmp_path: Path) -> None:
    # On a link of its own, it ends the process in Drake from 14 shapes on.
    skins = [collision(f"skin_end{k}", SPHERE, f"{0.1 * k} 0.2 0 0 0 0") for k in range(20)]
    tilted = {
        "<normal>0 0 1": "<normal>0 3 4",
        "<static>": "<pose>0.3 0 -2 0.1 0.2 0.4</pose><static>",
        '<link name="ground">': '<link name="ground"><pose>0 0 1 0.3 0 0</pose>',
    }
    few, many = dict[str, float](), dict[str, float]()
    for count, found in ((2, few), (20, many)):
        text = ball_and_finger("".join(skins[:count]))
        for plain, turned in tilted.items():
            text = text.replace(plain, turned)
        start = {"thing": {"xyz": [0.1, -0.2, 3.0], "rpy": [0.3, -0.5, 0.7]}}
        world = World.from_scenario(make_scenario(tmp_path, text, initial_position=start))
        names = [contact.name for contact in world.contacts]
        q = np.array([0.8, 0.2, -0.4, np.sqrt(0.16), 0.1, -0.2, 3.0, 0.4, 0.3, 0.2])
        found.update(zip(names, world.calc_signed_distance(q), strict=True))
    assert few.keys() < many.keys()
    assert "m::skin_end1 with ground::floor" in few
    np.testing.assert_allclose([many[name] for name in few], list(few.values()), atol=1e-12)


@pytest.mark.parametrize("normal", ["0 0 0", "0 1"])
def test_a_plane_among_many_shapes_needs_a_normal(tmp_path: Path, normal: str) -> None:
    skins = "".join(collision(f"skin{k}", SPHERE, f"{0.1 * k} 0 0 0 0 0") for k in range(12))
    text = ball_and_finger(skins).replace("0 0 1</normal>", f"{normal}</normal>")
    with pytest.raises(ModelError, match=f"the normal of plane 'floor' in .*got '{normal}'"):
        World.from_scenario(make_scenario(tmp_path, text))
