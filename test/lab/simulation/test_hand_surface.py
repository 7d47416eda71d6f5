# SPDX-License-Identifier: Apache-2.0
"""How far the surface of a real hand lies outside of the boxes of a description."""

from pathlib import Path

import numpy as np
import pytest
from every_case import every_refusal
from scipy.spatial.transform import Rotation

pytest.importorskip("trimesh", reason="needs the extra lab")

from foretouch.errors import FileError
from foretouch_lab.simulation.hand_surface import POINTS, mesh_surface, outside, urdf_surfaces

CUBE = "\n".join(
    [f"v {x} {y} {z}" for x in (0, 20) for y in (0, 20) for z in (0, 20)]
    + ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
)
"""A cube of 20 mm, in millimetres."""

JAW = """<robot name="jaw">
<link name="base"><collision><geometry><box size="0.06 0.2 0.06"/></geometry></collision></link>
<link name="left"><visual><geometry><mesh filename="package://jaw_description/meshes/cube.obj" scale="0.001 0.001 0.001"/></geometry></visual></link>
<link name="right"><collision><origin xyz="0 0 0.01"/><geometry><sphere radius="0.01"/></geometry></collision></link>
<link name="tool"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="left"/><origin xyz="0 0 0.03"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="1" velocity="1"/></joint>
<joint name="other" type="prismatic"><parent link="base"/><child link="right"/><axis xyz="0 -1 0"/><mimic joint="slide"/><limit lower="0" upper="0.04" effort="1" velocity="1"/></joint>
<joint name="mount" type="fixed"><parent link="base"/><child link="tool"/><origin xyz="0 0 0.1" rpy="0 0 1.5707963"/></joint>
</robot>"""


@pytest.fixture
def jaw(tmp_path: Path) -> Path:
    """The URDF of a jaw with one finger as a mesh, in the folders of a ROS package."""
    for folder in ("urdf", "meshes"):
        (tmp_path / "jaw_description" / folder).mkdir(parents=True)
    (tmp_path / "jaw_description" / "meshes" / "cube.obj").write_text(CUBE, encoding="utf-8")
    path = tmp_path / "jaw_description" / "urdf" / "jaw.urdf"
    path.write_text(JAW, encoding="utf-8")
    return path


def test_links_are_where_the_joints_of_the_urdf_put_them(jaw: Path) -> None:
    """Worked by hand: the tool is 100 mm above the base and turned by a quarter about z, and the second finger follows the first."""
    pytest.importorskip("yourdfpy", reason="needs the extra urdf")
    found = urdf_surfaces(jaw, "tool", {"slide": 0.03})
    bounds = {name: np.stack([points.min(axis=0), points.max(axis=0)]).round(4) for name, points in found.items()}
    np.testing.assert_allclose(bounds["base"], [[-0.1, -0.03, -0.13], [0.1, 0.03, -0.07]], atol=1e-4)
    np.testing.assert_allclose(bounds["left"], [[0.03, -0.02, -0.07], [0.05, 0.0, -0.05]], atol=1e-4)
    np.testing.assert_allclose(bounds["right"], [[-0.04, -0.01, -0.1], [-0.02, 0.01, -0.08]], atol=1e-4)
    assert list(urdf_surfaces(jaw, "tool", {}, ["left"])) == ["left"]


@pytest.mark.parametrize(("size", "radius"), [("-1 nan 1", "0.01"), ("0.06 0.2 0.06", "inf")])
def test_a_shape_without_a_finite_size_is_refused(jaw: Path, size: str, radius: str) -> None:
    pytest.importorskip("yourdfpy", reason="needs the extra urdf")
    jaw.write_text(
        JAW.replace('"0.06 0.2 0.06"', f'"{size}"').replace('"0.01"/></geometry>', f'"{radius}"/></geometry>')
    )
    with pytest.raises(FileError, match=r"link (base|right): a shape has a size that is not finite"):
        urdf_surfaces(jaw, "tool", {})


def test_what_is_outside_of_turned_boxes_is_measured(rng: np.random.Generator) -> None:
    """Against boxes whose distance is known: points moved out of a face, an edge and a corner."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * [0.02, 0.04, 0.06]
    for turn in Rotation.random(5, rng=rng).as_matrix():
        away_m, nearest = outside(
            np.array([[0.0, 0.0, 0.0], [0.013, 0.0, 0.02], [0.013, 0.024, 0.0], [0.2, 0.0, 0.0]]) @ turn.T,
            np.stack([corners @ turn.T, (corners + np.array([0.2, 0.0, 0.0])) @ turn.T]),
        )
        np.testing.assert_allclose(away_m, [0.0, 0.003, 0.005, 0.0], atol=1e-12)
        assert nearest.tolist() == [0, 0, 0, 1]


def test_points_are_spread_evenly_over_a_mesh(tmp_path: Path) -> None:
    path = tmp_path / "cube.obj"
    path.write_text(CUBE, encoding="utf-8")
    (points,) = mesh_surface(path, 0.001).values()
    for axis in range(3):
        for value in (0.0, 0.02):
            share = float((np.abs(points[:POINTS, axis] - value) < 1e-9).mean())
            assert share == pytest.approx(1.0 / 6.0, abs=0.04)


def test_what_cannot_be_read_is_refused_in_one_line(jaw: Path, tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy", reason="needs the extra urdf")
    folder = jaw.parent

    def urdf(name: str, old: str, new: str) -> Path:
        path = folder / name
        path.write_text(JAW.replace(old, new), encoding="utf-8")
        return path

    def read(
        path: Path, tool: str = "tool", joints: dict[str, float] | None = None, links: tuple[str, ...] = ()
    ) -> None:
        if path.suffix == ".urdf":
            urdf_surfaces(path, tool, joints or {}, links)
        else:
            mesh_surface(path, 1.0)

    files = {
        "empty.obj": "",
        "text.stl": "solid",
        "flat.obj": "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3",
        "mesh.xyz": "0 0 0",
        "mm.obj": CUBE,
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    cases = [
        ("cube2.obj is not found beside the file or in a folder above it", urdf("missing.urdf", "cube.obj", "cube2.obj")),
        ("link left: a shape spans 20 m: is it in millimetres[?] scale=", urdf("mm.urdf", ' scale="0.001 0.001 0.001"', "")),
        ("link: 'tcp' is not one of base, left, right, tool", jaw, "tcp"),
        ("link: 'leftt' is not one of .*left", jaw, "tool", {}, ("leftt",)),
        ("joint: 'slid' is not one of slide", jaw, "tool", {"slid": 0.1}),
        ("is no URDF that can be read", urdf("broken.urdf", "<link", "<lin")),
        ("is no URDF that can be read", urdf("text.urdf", JAW, "nothing")),
        ("no link has a shape", jaw, "tool", {}, ("tool",)),
        ("nowhere.urdf: ", folder / "nowhere.urdf"),
        ("mm.obj: spans 20 m: is it in millimetres[?] --unit mm", tmp_path / "mm.obj"),
        *((f"{name}: holds no triangle", tmp_path / name) for name in ("empty.obj", "text.stl", "flat.obj")),
        ("mesh.xyz: is not one of .obj, .ply", tmp_path / "mesh.xyz"),
    ]  # fmt: skip
    every_refusal(FileError, cases, read)
