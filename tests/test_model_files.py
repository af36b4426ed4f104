"""URDF and SDF, and the files that they name: what Drake leaves out is read, or refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from other_models import GANTRY, INERTIAL, MESH, make, write

from drake_aigto.errors import ModelError


@pytest.mark.parametrize("mass", ["-1", "nan"])
def test_a_bad_mass_is_refused_by_its_link(gantry: Any, mass: str) -> None:
    with pytest.raises(ModelError, match=rf"mass of 'bridge' in .*: got '?{mass}"):
        gantry(MASS=mass)


def test_meshes_that_can_not_be_read_are_listed_and_left_out_before_they_are(gantry: Any) -> None:
    meshes = "".join(
        MESH.replace("NAME", name).replace("FILE", file)
        for name, file in (("hook", "hook.stl"), ("box", "package://crane/box.obj"))
    )
    message = r"read: hook .hook\.stl., box .in the unknown package crane: name its folder by pack"
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


def test_a_mesh_that_gives_a_link_its_mass_has_to_be_converted(tmp_path: Path) -> None:
    text = """<mujoco model="m"><asset><mesh name="bone" file="bone.stl"/></asset><worldbody>
      <body name="a"><joint name="x" type="slide"/><geom name="g" type="mesh" mesh="bone"/></body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    model = tmp_path / "m.xml"
    model.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"give links their mass: g .bone\.stl.*Convert them to"):
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
