"""Models that other people made: what MJCF, URDF and SDF say is read, or refused by name."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from other_models import ARM, GRAVITY, MOTOR, TRANSMISSION, carry_double_pendulum, make, write

from drake_aigto import plan
from drake_aigto.errors import ModelError


def test_a_gear_multiplies_the_range_of_control_of_a_class_of_defaults(arm: Any) -> None:
    np.testing.assert_array_equal(arm().limits.control, [[-10.0], [15.0]])


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


def test_all_that_is_refused_is_listed_at_once(arm: Any) -> None:
    with pytest.raises(ModelError, match=r"allow_ignored: \[fluid, springdamper\]"):
        arm(OPTION='density="1"', JOINT='springdamper="1 1"')


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


def test_what_drake_asserts_of_a_model_is_an_error_of_the_model(arm: Any) -> None:
    body = '/><body pos="0 0 1"><geom size="-1"/></body><site'
    with pytest.raises(ModelError, match=r"Drake can't parse the model .*arm.xml: got .*radius"):
        arm(JOINT=body)


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
