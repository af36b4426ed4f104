"""Meshes in files that Drake does not read: copies have their corners, units and colors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from other_models import GANTRY, INERTIAL, MESH, make, write
from pydrake.geometry import Convex, Mesh, Role, Sphere

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.show import read_actors
from drake_aigto.world import MESHES, read_mesh, uncolored

# A tetrahedron away from the origin, no two of whose axes are alike [m].
CORNERS = np.array([[0.1, 0.0, 0.2], [0.4, 0.0, 0.2], [0.1, 0.2, 0.2], [0.1, 0.0, 0.9]])
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="UNIT" meter="METER"/><up_axis>Y_UP</up_axis></asset>
  <library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert>
    <diffuse><color>0.8 0.1 0.2 1</color></diffuse></lambert></technique></profile_COMMON></effect>
  </library_effects>
  <library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="12">PLACES</float_array><technique_common>
      <accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
      <param name="Y" type="float"/><param name="Z" type="float"/></accessor>
    </technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="4" material="s"><input semantic="VERTEX" source="#v" offset="0"/>
      <p>FACES</p></triangles></mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g">
    <bind_material><technique_common><instance_material symbol="s" target="#m"/>
    </technique_common></bind_material></instance_geometry></node></visual_scene>
  </library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>
</COLLADA>"""


def join(values: Any) -> str:
    return " ".join(map(str, np.ravel(values)))


def write_mesh(path: Path, meter: float = 1.0) -> Path:
    if path.suffix == ".dae":
        text = COLLADA.replace("METER", str(meter)).replace("FACES", join(FACES))
        text = text.replace("PLACES", join(CORNERS / meter))
    elif path.suffix == ".ply":
        head = "ply|format ascii 1.0|element vertex 4|property float x|property float y"
        head += "|property float z|element face 4|property list uchar int vertex_indices|end_header"
        lines = [*map(join, CORNERS), *(f"3 {join(face)}" for face in FACES)]
        text = "\n".join([*head.split("|"), *lines, ""])
    elif path.suffix == ".stl":
        facets = ("".join(f"vertex {join(CORNERS[i])}\n" for i in face) for face in FACES)
        sides = (f"facet normal 0 0 0\nouter loop\n{each}endloop\nendfacet" for each in facets)
        text = "\n".join(["solid s", *sides, "endsolid s", ""])
    else:
        lines = [f"v {join(each)}" for each in CORNERS]
        lines += [f"f {join(np.array(face) + 1)}" for face in FACES]
        text = "\n".join([*lines, ""])
    path.write_text(text, encoding="utf-8")
    return path


def sort_corners(hull: Any) -> Floats:
    corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return corners[np.lexsort(corners.T.round(6))]


@pytest.mark.parametrize("kinds", [MESHES, (".obj",)])
@pytest.mark.parametrize(("name", "meter"), [("m.ply", 1), ("m.STL", 1), ("m.dae", 0.0254)])
def test_a_copy_has_the_corners_of_the_mesh_in_meters(
    tmp_path: Path, name: str, meter: float, kinds: tuple[str, ...]
) -> None:
    file = write_mesh(tmp_path / name.lower(), meter).rename(tmp_path / name)
    copy = read_mesh(file, kinds)
    assert copy is not None and copy.suffix in kinds and copy == read_mesh(file, kinds)
    expected = CORNERS[np.lexsort(CORNERS.T)]
    np.testing.assert_allclose(sort_corners(Convex(copy).GetConvexHull()), expected, atol=1e-7)


def test_a_mesh_that_changes_has_another_copy(tmp_path: Path) -> None:
    file = write_mesh(tmp_path / "m.dae")
    first = read_mesh(file)
    write_mesh(file, 2.0)
    file.write_text(file.read_text(encoding="utf-8").replace("2.0", "1.0"), encoding="utf-8")
    second = read_mesh(file)
    assert first and second and first != second
    sizes = [np.ptp(sort_corners(Convex(each).GetConvexHull()), axis=0) for each in (first, second)]
    np.testing.assert_allclose(sizes[1], sizes[0] / 2)


def test_a_copy_keeps_the_colors(tmp_path: Path) -> None:
    copy = read_mesh(write_mesh(tmp_path / "m.dae"))
    assert copy is not None
    (material,) = json.loads(copy.read_text(encoding="utf-8"))["materials"]
    color = material["pbrMetallicRoughness"]["baseColorFactor"]
    np.testing.assert_allclose(color, [0.8, 0.1, 0.2, 1.0], atol=1 / 255)


def test_ghosts_have_a_copy_that_takes_their_color(tmp_path: Path) -> None:
    copy = read_mesh(write_mesh(tmp_path / "m.dae"))
    assert copy is not None
    own = copy.rename(tmp_path / "own.gltf")
    assert uncolored(kept := Mesh(str(own))) is kept and uncolored(ball := Sphere(1.0)) is ball
    own.rename(copy)
    plain = uncolored(Mesh(str(copy), [1.0, 2.0, 3.0]))
    assert isinstance(plain, Mesh) and plain.extension() == ".obj"
    np.testing.assert_array_equal(plain.scale3(), [1.0, 2.0, 3.0])
    one, other = (
        sort_corners(Convex(file).GetConvexHull()) for file in (plain.source().path(), copy)
    )
    np.testing.assert_allclose(one, other, atol=1e-7)


def put(tmp_path: Path, collision: str, visual: str, **fields: Any) -> Any:
    shapes = MESH.replace("NAME", "hook").replace("FILE", collision)
    picture = MESH.replace("NAME", "look").replace("FILE", visual)
    shapes += picture.replace("collision", "visual")
    model = write(tmp_path / "gantry.urdf", GANTRY, COLLISION=shapes, INERTIAL=INERTIAL)
    return make(model, 2, **fields)


def test_meshes_of_a_model_touch_and_are_drawn(tmp_path: Path) -> None:
    write_mesh(tmp_path / "hull.stl")
    write_mesh(tmp_path / "body.dae", 0.01)
    world = put(tmp_path, "hull.stl", "body.dae")
    inspector = world.scene_graph.model_inspector()
    (hull,) = inspector.GetAllGeometryIds(Role.kProximity)
    assert len(sort_corners(inspector.GetConvexHull(hull))) == 4
    (drawn,) = (actor for actor in read_actors(world) if isinstance(actor.shape, Mesh))
    np.testing.assert_allclose(drawn.corners.max(axis=0), CORNERS.max(axis=0), atol=0.1)
    assert not any("not drawn" in note for note in world.notes)


def test_without_the_extra_its_name_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mesh(tmp_path / "hull.stl")
    write_mesh(tmp_path / "body.dae")
    monkeypatch.setattr("drake_aigto.world.meshes.find_spec", lambda name: None)
    install = r"Drake reads .obj, .vtk and .gltf; pip install 'drake_aigto\[meshes\]' reads .dae"
    with pytest.raises(ModelError, match=rf"can't be read: hook \(hull.stl: {install}"):
        put(tmp_path, "hull.stl", "body.dae")
    world = put(tmp_path, "hull.stl", "body.dae", collisions="none")
    (note,) = world.notes
    assert note.startswith("not drawn: body.dae: Drake reads")


def test_a_damaged_mesh_is_refused_where_it_touches_and_not_drawn_else(tmp_path: Path) -> None:
    for name in ("hull.stl", "body.dae"):
        (tmp_path / name).write_text("nothing of the kind", encoding="utf-8")
    with pytest.raises(ModelError, match=r"hook \(hull.stl: it holds no mesh\)"):
        put(tmp_path, "hull.stl", "body.dae")
    world = put(tmp_path, "hull.stl", "body.dae", collisions="none")
    assert world.notes == ("not drawn: body.dae: it holds no mesh",)


def test_a_mesh_of_an_mjcf_weighs_as_much_as_its_copy(tmp_path: Path) -> None:
    masses = []
    for kind in (".obj", ".stl"):
        file = write_mesh(tmp_path / f"bone{kind}")
        model = tmp_path / "m.xml"
        model.write_text(
            f"""<mujoco model="m"><asset><mesh name="bone" file="{file.name}"/></asset><worldbody>
            <body name="a"><joint name="x" type="slide"/><geom name="g" type="mesh" mesh="bone"/>
            </body></worldbody><actuator><motor joint="x"/></actuator></mujoco>""",
            encoding="utf-8",
        )
        masses.append(make(str(model), 1).plant.GetBodyByName("a").default_mass())
    assert masses[0] == pytest.approx(masses[1]) and masses[0] == pytest.approx(7.0)
