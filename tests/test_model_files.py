"""URDF and SDF, and the files that they name: what Drake leaves out is read, or refused by name."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from other_models import ARM, GANTRY, GRAVITY, INERTIAL, MESH, TRANSMISSION, make, write
from pydrake.geometry import Role

from drake_aigto import PlanningError, Scenario, World, plan
from drake_aigto.cli import main
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.planning import name_active
from drake_aigto.world import find_model, models_directory, read_model


@pytest.mark.parametrize("mass", ["-1", "nan"])
def test_a_bad_mass_is_refused_by_its_link(gantry: Any, mass: str) -> None:
    with pytest.raises(ModelError, match=rf"mass of 'bridge' in .*: got '?{mass}"):
        gantry(MASS=mass)


def test_meshes_that_can_not_be_read_are_listed_and_left_out_before_they_are(gantry: Any) -> None:
    meshes = "".join(
        MESH.replace("NAME", name).replace("FILE", file)
        for name, file in (("hook", "hook.stl"), ("box", "package://crane/box.obj"))
    )
    message = r"read: hook .no file hook\.stl., box .in the unknown package crane: name its f"
    with pytest.raises(ModelError, match=message):
        gantry(COLLISION=meshes)
    assert not gantry({"collisions": "none"}, COLLISION=meshes).contacts
    with pytest.raises(ModelError, match=r"can't be read: box"):
        gantry({"collisions": ["b*"]}, COLLISION=meshes)


def test_links_without_mass_are_refused_by_their_joints(gantry: Any) -> None:
    with pytest.raises(ModelError, match=r"singular: got no inertia along x, y. Give every link"):
        gantry({"allow_ignored": ["inertias"]}, MASS="0")


def test_inertias_that_drake_would_replace_are_refused(gantry: Any, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"inertia of link 'bridge' without a mass .its inertia,"):
        gantry(MASS="0")
    flat = INERTIAL.replace('izz="1"', 'izz="2.5"')
    with pytest.raises(ModelError, match=r"with moments of 1, 1, 2.5 .*allow_ignored: .inertias"):
        gantry(INERTIAL=flat)
    assert len(gantry({"allow_ignored": ["inertias"]}, INERTIAL=flat).ignored) == 2
    world = GANTRY.replace('<link name="world"/>', f'<link name="world">{flat}</link>')
    make(write(tmp_path / "g.urdf", world))
    mass = "<inertial><mass>2</mass><inertia><ixx>IXX</ixx><iyy>1</iyy><izz>1</izz></inertia>"
    model = tmp_path / "m.sdf"
    for text, count in (("1", 0), ("3", 1)):
        model.write_text(
            f"<sdf version='1.9'><model name='m'><link name='l'>{mass.replace('IXX', text)}"
            "</inertial></link><joint name='j' type='prismatic'><parent>world</parent>"
            "<child>l</child><axis><xyz>1 0 0</xyz></axis></joint></model></sdf>"
        )
        assert len(make(str(model), 1, allow_ignored=["inertias"]).ignored) == count


SLIDER = (
    "<sdf version='1.9'>BEFORE<model name='m'>MORE<link name='l'>LINK<inertial><mass>2</mass>"
    "</inertial></link><joint name='j' type='prismatic'><parent>world</parent><child>l</child>"
    "<axis><xyz>1 0 0</xyz>AXIS</axis></joint></model>AFTER</sdf>"
)


BAD_SDF = {
    "mimic": ({"AXIS": "<mimic joint='k'/>"}, "<mimic> of joint 'j'"),
    "kinematic": ({"LINK": "<kinematic>true</kinematic>"}, "<kinematic> of link 'l'"),
    "velocity_decay": ({"LINK": "<velocity_decay/>"}, "<velocity_decay> of link 'l'"),
    "gravity": ({"LINK": "<gravity>false</gravity>"}, "<gravity> of link 'l' .it has its weight"),
}


def write_slider(path: Path, **parts: str) -> str:
    text = SLIDER
    for name in ("BEFORE", "MORE", "LINK", "AXIS", "AFTER"):
        text = text.replace(name, parts.get(name, ""))
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("word", BAD_SDF)
def test_what_drake_leaves_out_of_an_sdf_is_refused_by_name(tmp_path: Path, word: str) -> None:
    parts, message = BAD_SDF[word]
    model = write_slider(tmp_path / "m.sdf", **parts)
    with pytest.raises(ModelError, match=f"{message}.*allow_ignored: .{word}"):
        make(model, 1)
    assert len(make(model, 1, allow_ignored=[word]).ignored) == 1


@pytest.mark.parametrize("gravity", ["0 0 -9.8", "0 0 -3"])
def test_only_earths_gravity_of_an_sdfs_world_is_read(tmp_path: Path, gravity: str) -> None:
    world = f"<world name='w'><gravity>{gravity}</gravity>"
    model = write_slider(tmp_path / "m.sdf", BEFORE=world, AFTER="</world>")
    if gravity == "0 0 -9.8":
        assert not make(model, 1).ignored
    else:
        with pytest.raises(ModelError, match=r"the gravity 0 0 -3 of a world .9.81 m/s² downwards"):
            make(model, 1)


def test_joints_of_one_name_in_two_models_are_refused_where_names_count(tmp_path: Path) -> None:
    friction = "<dynamics><friction>0.5</friction></dynamics>"
    part = SLIDER.partition(">BEFORE")[2].partition("AFTER")[0].replace("name='m'", "name='n'")
    part = part.replace("AXIS", "").replace("LINK", "").replace("MORE", "")
    assert make(write_slider(tmp_path / "m.sdf", MORE=part), 2).dry_friction is None
    model = write_slider(tmp_path / "m.sdf", MORE=part, AXIS=friction)
    with pytest.raises(ModelError, match=r"joint 'j' in .*m.sdf: got 2 joints of this name"):
        make(model, 2)


def test_an_answer_that_does_not_help_is_given_once(tmp_path: Path) -> None:
    ball = "<joint name='b' type='ball'><parent>l</parent><child>k</child></joint>"
    link = "<link name='k'><inertial><mass>1</mass></inertial></link>"
    model = write_slider(tmp_path / "m.sdf", MORE=ball + link)
    with pytest.raises(ModelError, match=r"joint 'b' .ball_rpy.") as caught:
        make(model, 1)
    assert str(caught.value).count("ball_rpy") == 1
    answer = getattr(caught.value, "fields", {})
    assert make(model, 1, **answer).num_positions == 1
    screw = '<drake:joint name="y" type="screw"><parent link="bridge"/><child link="trolley"/>'
    text = GANTRY.partition('<joint name="y"')
    rest = f'{screw}<axis xyz="0 0 1"/></drake:joint>MORE</robot>'
    model = write(tmp_path / "g.urdf", text[0] + rest)
    assert make(model, 1, fixed_joints=["y"]).num_positions == 1


def test_includes_of_an_sdf_that_are_missing_are_refused(tmp_path: Path) -> None:
    model = tmp_path / "m.sdf"
    for uri, message in (
        ("part.sdf", "an <include> of part.sdf, which is missing, .*relative to the model's"),
        ("package://arm/part.sdf", r"package://arm/part.sdf, .*by the scenario's packages: {arm: "),
    ):
        text = (
            f"<sdf version='1.9'><model name='m'><include><uri>{uri}</uri></include></model></sdf>"
        )
        model.write_text(text, encoding="utf-8")
        with pytest.raises(ModelError, match=message):
            make(str(model), 1)


def test_meshes_of_a_urdf_are_read_from_files_beside_it(gantry: Any, tmp_path: Path) -> None:
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "hook.obj").write_text(tetrahedron, encoding="utf-8")
    mesh = MESH.replace("NAME", "hook").replace("FILE", "hook.obj")
    assert gantry(COLLISION=mesh, INERTIAL=INERTIAL).num_positions == 2


def test_shapes_without_a_name_are_called_by_their_links(gantry: Any) -> None:
    ball = "<collision><geometry><sphere radius='0.1'/></geometry></collision>"
    world = gantry(COLLISION=2 * ball + ball.replace("<collision>", "<collision name='hook'>"))
    inspector = world.scene_graph.model_inspector()
    names = map(inspector.GetName, inspector.GetAllGeometryIds(Role.kProximity))
    ends = [name.rpartition("::")[2] for name in names]
    assert sorted(ends) == ["hook", "trolley", "trolley_2"]


def test_a_mesh_that_gives_a_link_its_mass_has_to_be_converted(tmp_path: Path) -> None:
    text = """<mujoco model="m"><asset><mesh name="bone" file="bone.stl"/></asset><worldbody>
      <body name="a"><joint name="x" type="slide"/><geom name="g" type="mesh" mesh="bone"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "m.xml"
    model.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"their mass: g .no file bone\.stl.*Convert them to"):
        make(str(model), size=1)


def test_meshes_are_not_read_before_a_model_is_refused(gantry: Any, tmp_path: Path) -> None:
    (tmp_path / "hook.obj").write_text("no mesh", encoding="utf-8")
    mesh = MESH.replace("NAME", "hook").replace("FILE", "hook.obj")
    shapes = mesh + mesh.replace("collision", "visual")
    with pytest.raises(ModelError, match="the model lacks an actuator"):
        gantry(COLLISION=shapes, MORE="")
    with pytest.raises(ModelError, match="Drake can't parse the model"):
        gantry(COLLISION=shapes)


def test_a_xacro_is_told_from_a_urdf(gantry: Any) -> None:
    with pytest.raises(ModelError, match=r"got <xacro:if>: an xacro, .*xacro gantry.urdf > gantry"):
        gantry(COLLISION='<xacro:if value="1"/>')


def test_friction_in_files_that_an_sdf_includes_acts(tmp_path: Path) -> None:
    link = """<link name='l'><inertial><mass>2</mass>
      <inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial></link>"""
    joint = """<joint name='j' type='revolute'><parent>base</parent><child>l</child>
      <axis><xyz>0 1 0</xyz><dynamics><friction>.5</friction></dynamics></axis></joint>"""
    part, model = tmp_path / "part.sdf", tmp_path / "model.sdf"
    part.write_text(
        f"<sdf version='1.9'><model name='p'><link name='base'/>{link}{joint}</model></sdf>"
    )
    model.write_text(f"""<sdf version='1.9'><model name='m'>
      <include><uri>file://{part}</uri></include><joint name='w' type='fixed'>
      <parent>world</parent><child>p::base</child></joint></model></sdf>""")
    np.testing.assert_array_equal(make(str(model), 1).dry_friction, [0.5])
    with pytest.raises(ModelError, match=r"got j in the included .*part.sdf, expected joints of"):
        make(str(model), 1, fixed_joints=["j"])


def test_directives_add_models_that_are_read_as_on_their_own(tmp_path: Path) -> None:
    mesh = MESH.replace("NAME", "hook").replace("FILE", "missing.stl")
    write(tmp_path / "gantry.urdf", GANTRY, COLLISION=mesh)
    (tmp_path / "inner.dmd.yaml").write_text(
        "directives: [{add_model: {name: g, file: 'package://own/gantry.urdf', "
        "default_joint_positions: {y: [0.5]}}}]"
    )
    model = tmp_path / "scene.dmd.yaml"
    arm = write(tmp_path / "arm.xml", ARM)
    model.write_text(
        "directives: [{add_directives: {file: 'package://own/inner.dmd.yaml'}}, "
        f"{{add_model: {{name: a, file: 'file://{arm}'}}}}]"
    )
    fields: dict[str, Any] = {"packages": {"own": str(tmp_path)}, "goal_weight": 0}
    fields |= {"control_weight": [1, 1], "initial_position": {}}
    with pytest.raises(ModelError, match=r"meshes that can't be read: hook .no file missing\.stl"):
        make(str(model), 4, **fields)
    fields["collisions"] = "none"
    world = make(str(model), 4, **fields)
    assert world.plant.GetJointByName("y").default_positions() == [0.5]
    np.testing.assert_array_equal(world.dry_friction, [0.7, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(world.limits.control, [[-5.0, -10.0], [5.0, 15.0]])
    assert make(str(model), 3, fixed_joints=["elbow"], **fields).num_positions == 3
    with pytest.raises(ModelError, match=r"a directive that adds package://own/inner.*packages: {"):
        make(str(model), 4)
    for text, got in (
        ("directives: [", "while parsing a flow node"),
        ("- add_model", "no list of directives"),
        ("directives: 3", "no list of directives"),
        ("directives: [add_model]", "no list of directives"),
        ("directives: [{add_model: box.sdf}]", "a directive that adds 'box.sdf'"),
    ):
        model.write_text(text)
        with pytest.raises(ModelError, match=f"got {got}.* expected model directives"):
            make(str(model), 4)


def test_friction_of_a_scenario_stands_in_place_of_the_models(gantry: Any) -> None:
    np.testing.assert_array_equal(gantry().dry_friction, [0.7, 0.0])
    world = gantry({"dry_friction": [0.0, 0.2]})
    np.testing.assert_array_equal(world.dry_friction, [0.0, 0.2])
    for given, found in (({"y": 0.2}, [0.0, 0.2]), ({"*": 0.1, "x": 0.3}, [0.3, 0.1])):
        np.testing.assert_array_equal(gantry({"dry_friction": given}).dry_friction, found)
    with pytest.raises(ScenarioError, match=r"dry_friction\[y\]: got -0.2, expected at least 0"):
        gantry({"dry_friction": {"y": -0.2}})
    with pytest.raises(ScenarioError, match=r"dry_friction\[z\]: got no joint .* one of x, y"):
        gantry({"dry_friction": {"z": 0.2}})


def test_joints_are_driven_and_limited_as_the_scenario_says(gantry: Any) -> None:
    world = gantry({"actuators": ["y"], "effort_limits": {"drive": 3.0}})
    np.testing.assert_array_equal(world.limits.control[1], [3.0, 8.0])
    world = gantry({"actuators": ["y"], "effort_limits": {"*": 2.0, "y": 5.0}})
    np.testing.assert_array_equal(world.limits.control[1], [2.0, 5.0])
    world = gantry({"effort_limits": {"x": 4.0}}, EFFORT="0")
    np.testing.assert_array_equal(world.limits.control, [[-4.0], [4.0]])
    np.testing.assert_array_equal(gantry({"limits": "ignore"}).limits.position[1], np.inf)
    with pytest.raises(ModelError, match=r"limits of effort of 0 at x, .*effort_limits: {x"):
        gantry(EFFORT="0")
    with pytest.raises(ModelError, match=r"none in .*Drive joints by the scenario's actuators: .x"):
        gantry(MORE="")


def test_a_servo_pulls_its_joint_to_where_the_control_says(gantry: Any, arm: Any) -> None:
    q, v, u = np.array([0.3, -0.2]), np.array([0.5, 0.4]), np.array([7.0])
    plain, world = gantry(), gantry({"servos": {"x*": [20, 3]}})
    force = world.actuation @ u - world.calc_bias(q, v)
    force -= plain.actuation @ u - plain.calc_bias(q, v)
    np.testing.assert_allclose(force, [-20 * q[0] - 3 * v[0], 0.0], atol=1e-12)
    at_rest = 20 * np.array([0.35, 0.0])  # The set point times k, where the spring holds it.
    still = world.actuation @ at_rest[:1] - world.calc_bias(np.array([0.35, 0.0]), np.zeros(2))
    np.testing.assert_allclose(still, 0.0, atol=1e-12)
    text = '<position joint="shoulder" gear="2" kp="5" kv="0.5" ctrlrange="-1 2"/>'
    plain, world = arm(), arm(ACTUATORS=text)
    force = plain.calc_bias(q, v) - world.calc_bias(q, v)
    np.testing.assert_allclose(force, [-20 * q[0] - 2 * v[0], 0.0], atol=1e-12)
    np.testing.assert_array_equal(world.limits.control, [[-10.0], [20.0]])
    with pytest.raises(ModelError, match=r"servos in .*: got 'y', expected one of x"):
        gantry({"servos": {"y": 1.0}})
    with pytest.raises(ScenarioError, match=r"servos\[x\]: got \[0, 1\], expected stiffness > 0"):
        gantry({"servos": {"x": [0, 1]}})


def test_goals_that_servos_can_not_hold_are_refused_with_the_effort_that_does(
    tmp_path: Path,
) -> None:
    model = write(tmp_path / "gantry.urdf", GANTRY, EFFORT="5")
    asked: dict[str, Any] = {"model": model, "initial_position": {}, "control_weight": 1.0}
    asked |= {"goal_position": {"x": -0.3}, "goal_weight": {"x": 1.0}, "limits": "ignore"}

    def check(stiffness: float, **changes: Any) -> None:
        world = World.from_scenario(
            given := Scenario(**asked | {"servos": {"x": stiffness}} | changes)
        )
        world.check(world.place(given))

    check(16.0)  # Which pulls with 4.8 of 5 N.
    with pytest.raises(ScenarioError, match=r"x at -0.3, out of reach .*effort_limits: {x: 6.06},"):
        check(20.0)
    check(20.0, effort_limits={"x": 6.06})
    check(20.0, goal_weight={"y": 1.0})
    with pytest.raises(ScenarioError, match="out of reach of set points"):
        check(20.0, goal_weight={"y": 1.0}, hard_goal=True)


def test_a_model_is_without_weight_where_gravity_is_compensated(arm: Any) -> None:
    q, still = np.array([0.5, -0.3]), np.zeros(2)
    assert np.abs(arm().calc_bias(q, still)).max() > 1.0
    world = arm({"weightless": ["arm"]})
    np.testing.assert_allclose(world.calc_bias(q, still), 0.0, atol=1e-12)
    np.testing.assert_array_equal(world.calc_mass_matrix(q), arm().calc_mass_matrix(q))
    with pytest.raises(ModelError, match=r"weightless in .*: got 'leg', expected one of arm"):
        arm({"weightless": ["leg"]})


def test_joints_can_be_fixed(gantry: Any, tmp_path: Path) -> None:
    model = write(tmp_path / "gantry.urdf", GANTRY)
    world = make(model, size=1, fixed_joints=["y"])
    assert world.num_positions == 1
    np.testing.assert_allclose(world.calc_mass_matrix(np.zeros(1)), [[4.0]])
    arm = write(tmp_path / "arm.xml", ARM)
    assert make(arm, size=1, fixed_joints=["elb*"]).num_positions == 1


@pytest.mark.parametrize("is_declared", [True, False])
def test_drakes_own_elements_stay_as_they_are_where_a_text_is_changed(
    tmp_path: Path, is_declared: bool
) -> None:
    text = find_model("package://drake_aigto_models/corridor.sdf").read_text(encoding="utf-8")
    model = tmp_path / "corridor.sdf"
    declared = re.search(r' xmlns:drake="[^"]*"', text)
    assert declared and "point_contact_stiffness" in text
    model.write_text(text if is_declared else text.replace(declared[0], ""), encoding="utf-8")
    shipped = World.from_scenario(Scenario.named("corridor/three_bounces"))
    names = [contact.name for contact in shipped.contacts]
    within = {"initial_position": [0.5], "goal_position": [0.4]}
    pruned = make(str(model), 1, ignored_shapes=[], collisions=["ball*", "left*"], **within)
    assert len(pruned.contacts) == 1 < len(names)
    assert pruned.stiffness[0] == shipped.stiffness[0]


BAD_FIELDS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown joint": ({"actuators": ["z"]}, "actuators in .*: got 'z', expected one of x, y"),
    "driven already": ({"actuators": ["x"]}, "joint 'x', which actuator '.*drive' drives"),
    "unknown actuator": ({"effort_limits": {"y": 1.0}}, "effort_limits .*: got 'y', expected an"),
    "unknown link": ({"weld": {"hook": [0, 0, 0]}}, "weld of 'hook' in .*: got no such link"),
    "held link": ({"weld": {"bridge": [0, 0, 0]}}, "a link that joint 'x' holds"),
    "missing package": ({"packages": {"p": "/none"}}, "package 'p': got no folder /none"),
    "unknown shape": ({"material": {"wall": {"friction": 0}}}, "material: got 'wall', expected of"),
}


@pytest.mark.parametrize("name", BAD_FIELDS)
def test_fields_that_do_not_fit_the_model_are_refused(gantry: Any, name: str) -> None:
    fields, message = BAD_FIELDS[name]
    with pytest.raises(ModelError, match=message):
        gantry(fields)


BAD_VALUES: dict[str, tuple[dict[str, Any], str]] = {
    "no rotation": (
        {"weld": {"a": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}},
        r"weld\[a\]: got a matrix that is no rotation and translation",
    ),
    "no pose": ({"weld": {"a": [1.0, 2.0]}}, r"weld\[a\]: got 2 numbers, expected x, y, z"),
    "twice": ({"actuators": ["a", "a"]}, "actuators: got 'a' twice, expected each name once"),
    "no mapping": (
        {"effort_limits": [3]},
        r"effort_limits: got \[3\], expected a mapping of names, such as {shou",
    ),
    "no effort": ({"effort_limits": {"a": 0}}, r"effort_limits\[a\]: got 0 N or N m, exp"),
    "no material": ({"material": {"a": {"color": 1}}}, r"material\[a\]: got .*expected a map"),
    "negative": ({"material": {"a": {"friction": -1}}}, r"material\[a\]\.friction: got -1, exp"),
    "limits": ({"limits": "none"}, "limits: got 'none', expected 'model' or 'ignore'"),
    "no folder": ({"packages": {"a": 3}}, r"packages\[a\]: got 3, expected a text"),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_fields_that_are_wrong_in_themselves_are_refused(name: str) -> None:
    fields, message = BAD_VALUES[name]
    ends: dict[str, Any] = {"initial_position": 1.0, "initial_velocity": 0.0, "goal_position": 1.0}
    with pytest.raises(ScenarioError, match=message):
        Scenario(**ends, **fields)


def test_a_link_is_welded_where_the_scenario_says(gantry: Any, tmp_path: Path) -> None:
    text = GANTRY.replace('link="world"', 'link="cart"').replace('name="world"', 'name="cart"')
    model = write(tmp_path / "gantry.urdf", text, MORE=TRANSMISSION)
    world = make(model, weld={"cart": [0, 0, 0, 0, np.pi / 2, 0]})
    lift = world.calc_bias(np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(lift, [-4 * GRAVITY, 0.0], atol=1e-12)


def test_limits_of_a_scenario_and_a_model_are_told_apart(arm: Any) -> None:
    world = arm()
    names = "initial_position", "initial_velocity", "goal_position"
    ends: dict[str, Any] = {name: [0, 0] for name in names}
    scenario = Scenario(model=world.model or "", control_upper=4.0, **ends)
    items = world.limits.control_items(world.plant, scenario)
    assert items == ["arm_motor from -10 (model) to 4 (scenario) N m"]


def test_look_tells_what_is_understood(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = write(tmp_path / "arm.xml", ARM, JOINT='frictionloss="0.25"', OPTION='density="2"')
    picture = tmp_path / "arm.png"
    words = ["look", model, "--allow-ignored", "fluid", "--png", str(picture)]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "shoulder  revolute  rad   -inf    inf    0.5      0.25" in text
    assert "arm_motor from -10 (model) to 15 (model) N m" in text
    assert "the density 2 of a fluid: its forces on all links" in text
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["look", "cart_pole/soft_06", "--control-upper", "5"]) == 0
    text = capsys.readouterr().out
    assert "_rail from -20 (model) to 5 (scenario) N" in text
    assert "pole against left_wall   2e+09 | 200" in text
    bounded = tmp_path / "bounded.yaml"
    by_name: dict[str, Any] = {"position_upper": {"finger_x": 0.3}}
    dataclasses.replace(Scenario.named("finger_and_box/push"), **by_name).save(bounded)
    assert main(["look", str(bounded)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("10 coordinates, 0.75 kg that move")  # Of two models.
    floating = [line.split() for line in lines if "floating" in line]
    assert [line[2:5] for line in floating] == 3 * [["rad", "-inf", "inf"]] + 3 * [
        ["m", "-inf", "inf"]
    ]
    assert main(["look", model]) == 2
    assert "allow_ignored: [fluid]" in capsys.readouterr().err
    floats = str(models_directory() / "quadruped.sdf")
    assert main(["look", floats]) == 0
    assert "read with contact: compliant" in capsys.readouterr().out
    assert main(["look", floats, "--contact", "rigid"]) == 2
    assert "so it floats" in capsys.readouterr().err


def test_materials_replace_those_of_a_diagram_in_a_copy_of_it() -> None:
    diagram = read_model("package://drake_aigto_models/pushed_block.sdf").diagram
    own = World.from_diagram(diagram)
    world = World.from_diagram(diagram, stiction_speed=0.01, material={"*": {"stiffness": 3e5}})
    np.testing.assert_allclose(world.stiffness, 1.5e5)
    assert [each.name for each in world.contacts] == [each.name for each in own.contacts]
    np.testing.assert_allclose(own.stiffness, 2e3)
    with pytest.raises(ModelError, match="material: got 'wall', expected of the collision shapes"):
        World.from_diagram(diagram, material={"wall": {"stiffness": 3e5}})
    bare = Scenario.named("pushed_block/slide")
    told = r"material: got {}, expected {'\*': .*stiffness=300000.*}, as the world has it\. Give"
    with pytest.raises(ScenarioError, match=told):
        world.check(bare)
    changed: dict[str, Any] = {"material": world.model_fields.material}
    world.check(dataclasses.replace(bare, **changed))


def test_bounds_that_a_motion_touches_are_named_with_their_origin(arm: Any) -> None:
    world = arm()
    ends = {name: [0, 0] for name in ("initial_position", "initial_velocity", "goal_position")}
    asked: Any = {**ends, "control_upper": 4.0, "velocity_lower": -1.0}
    scenario = Scenario(model=world.model or "", **asked)
    q, v = np.array([[0.0, 0.0], [9.0, np.deg2rad(120)]]), np.array([[0.0, -1.0], [5.0, 1.0]])
    active = world.limits.active_items(world.plant, scenario, q, v, np.array([[-10.0], [3.0]]))
    assert active == [
        "position of arm_elbow_q at most 2.0944 (model)",
        "velocity of arm_elbow_w at least -1 (scenario)",
        "control of arm_motor at least -10 (model)",
    ]


def test_limits_that_are_none_are_refused_or_noted(gantry: Any, tmp_path: Path) -> None:
    model = write(tmp_path / "gantry.urdf", GANTRY.replace('lower="-2"', 'lower="3"'))
    with pytest.raises(ModelError, match=r"range of joint 'x' in .*: got from 3 to 2, expected l"):
        make(model)
    model = write(tmp_path / "gantry.urdf", GANTRY.replace('velocity="9"', 'velocity="0"'))
    world = make(model)
    assert np.isinf(world.limits.velocity).all()
    assert world.notes[0] == "the velocity limit 0 of joint 'x' counts as none"


@pytest.mark.slow
def test_a_search_that_finds_nothing_names_the_bounds_that_are_active(tmp_path: Path) -> None:
    model = write(tmp_path / "arm.xml", ARM)
    task: dict[str, Any] = {"goal_position": 3.0, "hard_goal": True, "goal_velocity": 0.0}
    task |= {"initial_position": 0.0, "initial_velocity": 0.0, "duration": 0.3, "time_step": 0.05}
    with pytest.raises(PlanningError, match=r"These bounds are active: control of arm_motor at l"):
        plan(Scenario(model=model, fixed_joints=["elbow"], ignored_shapes="all", **task))


def test_of_many_active_bounds_those_that_most_candidates_touch_are_named() -> None:
    def touch(*numbers: int) -> Any:
        arrays = dict.fromkeys(("positions", "velocities"))
        return SimpleNamespace(trajectory=SimpleNamespace(controls=numbers, **arrays))

    limits = SimpleNamespace(active_items=lambda *asked: [f"bound {i}" for i in asked[-1]])
    world: Any = SimpleNamespace(plant=None, limits=limits)
    world.bounds = lambda _: SimpleNamespace(are_any=True)
    scenario: Any = None
    few = name_active(world, scenario, [touch(1, 2), touch(2)])
    assert few == "These bounds are active: bound 2; bound 1. "
    many = name_active(world, scenario, [touch(*range(20)), touch(17)])
    assert many.startswith("These bounds are active: bound 17; bound 0; ")
    assert many.endswith("bound 6; and 12 others. ") and not name_active(world, scenario, [touch()])
