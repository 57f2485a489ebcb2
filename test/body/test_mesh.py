"""Bodies from meshes: closed forms, rotation and translation, holes, and every kind of defective surface."""

from __future__ import annotations

import itertools
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from rb_dynamics.body import mesh, shapes
from rb_dynamics.errors import BodyError, MissingExtraError
from rb_dynamics.numerics import rotation
from rb_dynamics.scene.read import parse_scene

trimesh = pytest.importorskip("trimesh", reason="extra 'mesh' is not installed")

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
CUBE = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])

lengths = st.floats(0.1, 10.0)
turns = st.tuples(*(st.floats(-3.0, 3.0),) * 3)


def box(size: Any, at: Any = (0.0, 0.0, 0.0)) -> tuple[Any, Any]:
    """Return a box with its centre `at`."""
    return (CORNERS - 0.5) * np.array(size) + np.array(at), CUBE


def joined(*parts: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def inverted(part: tuple[Any, Any]) -> tuple[Any, Any]:
    return part[0], part[1][:, ::-1]


def hull(points: Any) -> tuple[Any, Any]:
    """Return the convex hull as a mesh that is oriented outwards."""
    found = ConvexHull(points)
    faces = found.simplices.copy()
    a, b, c = (found.points[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    return found.points, faces


@given(st.tuples(lengths, lengths, lengths), st.sampled_from([0.0, 1.0, 1e3]))
def test_a_box_is_the_box(size: Any, offset: float) -> None:
    """To 1e-14, also far from the origin: corners are then rounded, and the box is that of the rounded corners."""
    vertices, faces = box(size, (offset, -offset, 2.0 * offset))
    edges = vertices.max(axis=0) - vertices.min(axis=0)
    shape = shapes.box(edges.tolist())

    solid = mesh.solid(vertices, faces)

    assert solid.volume == pytest.approx(shape.volume, rel=1e-14)
    assert [solid.squared_gyration[i][i] for i in range(3)] == pytest.approx(shape.squared_gyration, rel=1e-14)
    products = [solid.squared_gyration[i][j] for i, j in ((0, 1), (0, 2), (1, 2))]
    assert products == pytest.approx([0.0] * 3, abs=1e-14 * max(shape.squared_gyration))
    center = 0.5 * (vertices.max(axis=0) + vertices.min(axis=0))
    assert solid.center_of_mass == pytest.approx(center, rel=1e-15, abs=1e-15 * max(size))
    assert solid.reach == pytest.approx(0.5 * math.hypot(*edges), rel=1e-14)
    assert not solid.inside_out


@given(st.lists(st.tuples(*(st.floats(-1.0, 1.0),) * 3), min_size=4, max_size=4))
def test_a_tetrahedron_has_the_second_moments_of_its_corners(corners: Any) -> None:
    """A uniform simplex has the covariance of its corners, each with 1/20 of the mass, about the centre.

    Independent of the code: int (x - X)(x - X)^T dV = V / 20 sum (v_k - X)(v_k - X)^T.
    """
    vertices = np.array(corners)
    volume = np.linalg.det(vertices[1:] - vertices[0]) / 6.0
    if abs(volume) < 1e-3:
        return
    arms = vertices - vertices.mean(axis=0)
    second = arms.T @ arms / 20.0
    expected = np.trace(second) * np.eye(3) - second

    solid = mesh.solid(vertices, TETRAHEDRON)

    assert solid.inside_out == (volume < 0.0)
    assert solid.volume == pytest.approx(abs(volume), rel=1e-11)
    np.testing.assert_allclose(solid.center_of_mass, vertices.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(solid.squared_gyration, expected, atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), turns, st.tuples(*(st.floats(-100.0, 100.0),) * 3))
def test_a_turned_and_moved_body_has_the_turned_inertia(seed: int, turn: Any, offset: Any) -> None:
    vertices, faces = hull(np.random.default_rng(seed).normal(size=(20, 3)))
    a = np.array(rotation.matrix(rotation.exp(turn)))
    here = mesh.solid(vertices, faces)

    there = mesh.solid(vertices @ a.T + np.array(offset), faces)

    assert there.volume == pytest.approx(here.volume, rel=1e-12)
    np.testing.assert_allclose(there.center_of_mass, a @ here.center_of_mass + offset, atol=1e-12)
    np.testing.assert_allclose(there.squared_gyration, a @ np.array(here.squared_gyration) @ a.T, atol=1e-12)


@pytest.mark.parametrize("size", [1e-60, 1e-9, 1e9, 1e60])
def test_any_unit_will_do(size: float) -> None:
    solid = mesh.solid(*box((size, 2.0 * size, 3.0 * size)))

    assert solid.volume == pytest.approx(6.0 * size**3, rel=1e-13)
    assert solid.squared_gyration[0][0] == pytest.approx(13.0 / 12.0 * size**2, rel=1e-13)


def test_a_plate_and_a_needle_keep_their_digits() -> None:
    for size in ((1.0, 1.0, 1e-6), (1e-6, 1e-6, 1.0)):
        solid, shape = mesh.solid(*box(size)), shapes.box(size)
        assert [solid.squared_gyration[i][i] for i in range(3)] == pytest.approx(shape.squared_gyration, rel=1e-14)


def test_a_ball_of_triangles_converges_like_the_square_of_its_edges() -> None:
    ball = shapes.sphere(1.0)
    errors = []
    for level in range(2, 6):
        ico = trimesh.creation.icosphere(subdivisions=level)
        solid = mesh.solid(np.asarray(ico.vertices), np.asarray(ico.faces))
        errors.append((1.0 - solid.volume / ball.volume, 1.0 - solid.squared_gyration[2][2] / ball.squared_gyration[2]))

    for coarse, fine in itertools.pairwise(errors):
        assert coarse[0] / fine[0] == pytest.approx(4.0, rel=0.05)
        assert coarse[1] / fine[1] == pytest.approx(4.0, rel=0.05)
    assert max(errors[-1]) < 3e-3


def test_an_inside_out_surface_is_turned_and_says_so() -> None:
    right, wrong = mesh.solid(*box((1.0, 2.0, 3.0))), mesh.solid(*inverted(box((1.0, 2.0, 3.0))))

    assert wrong.inside_out
    assert wrong.volume == right.volume
    assert wrong.center_of_mass == right.center_of_mass
    np.testing.assert_allclose(wrong.squared_gyration, right.squared_gyration, atol=1e-15)


@pytest.mark.parametrize("turn", [lambda part: part, inverted], ids=["outwards", "inwards"])
def test_a_hole_is_taken_out(turn: Any) -> None:
    """Both of the surface's parts may be inside out together."""
    solid = mesh.solid(*turn(joined(box((2.0, 2.0, 2.0)), inverted(box((1.0, 1.0, 1.0))))))

    assert solid.volume == pytest.approx(7.0, rel=1e-14)
    assert solid.squared_gyration[0][0] == pytest.approx((8.0 * 8.0 - 2.0) / 12.0 / 7.0, rel=1e-14)


def test_parts_beside_each_other_add_up() -> None:
    solid = mesh.solid(*joined(box((1.0, 1.0, 1.0), (3.0, 0.0, 0.0)), box((1.0, 1.0, 1.0), (-3.0, 0.0, 0.0))))

    assert solid.volume == pytest.approx(2.0, rel=1e-15)
    assert solid.squared_gyration[2][2] == pytest.approx(1.0 / 6.0 + 9.0, rel=1e-14)


@pytest.mark.slow
@given(st.tuples(lengths, lengths, lengths), st.tuples(lengths, lengths, lengths))
def test_unlike_parts_add_up_about_their_common_centre(first: Any, second: Any) -> None:
    """The mean of the vertices is not the centre of mass here."""
    places = np.array([[-20.0, 3.0, -5.0], [20.0, 1.0, 2.0]])
    shares = np.array([np.prod(first), np.prod(second)]) / (np.prod(first) + np.prod(second))
    center = shares @ places
    expected = np.zeros((3, 3))
    for size, share, place in zip((first, second), shares, places, strict=True):
        r = place - center
        own = np.diag(shapes.box(size).squared_gyration)
        expected += share * (own + r @ r * np.eye(3) - np.outer(r, r))

    solid = mesh.solid(*joined(box(first, places[0]), box(second, places[1])))

    np.testing.assert_allclose(solid.center_of_mass, center, atol=1e-13)
    np.testing.assert_allclose(solid.squared_gyration, expected, atol=1e-14 * np.trace(expected))


@pytest.mark.parametrize("apart", [1e3, 1e5, 1e7])
def test_small_parts_far_from_each_other_keep_their_digits(apart: float) -> None:
    """Boxes whose corners are exact; the second moments of the arms are the whole."""
    sizes, places = ((0.5, 1.0, 0.25), (1.0, 0.5, 2.0)), ((-apart, 0.0, 0.0), (apart, 2.0, -1.0))

    solid = mesh.solid(*joined(*(box(size, place) for size, place in zip(sizes, places, strict=True))))

    masses = [math.prod(size) for size in sizes]
    arm = np.subtract(places[1], places[0])
    expected = masses[0] * masses[1] / sum(masses) ** 2 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    for mass, size in zip(masses, sizes, strict=True):
        expected += mass / sum(masses) * np.diag(shapes.box(size).squared_gyration)
    assert solid.volume == pytest.approx(sum(masses), rel=1e-14)
    np.testing.assert_allclose(solid.squared_gyration, expected, rtol=1e-14, atol=1e-14 * expected[1, 1])


@given(st.integers(0, 2**32 - 1), st.tuples(*[st.floats(0.1, 0.9)] * 2), st.sampled_from([np.float32, np.float64]))
def test_parts_that_touch_are_beside_each_other(seed: int, along: Any, precision: Any) -> None:
    """Turned, and rounded as in an STL file: each is inside the other by as much as that."""
    vertices, faces = joined(box((1.0, 1.0, 1.0)), box((1.0, 1.0, 1.0), (1.0, *along)))
    turn = Rotation.random(random_state=seed)

    solid = mesh.solid(turn.apply(vertices).astype(precision).astype(np.float64), faces)

    assert solid.volume == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("apart", [1.99, 2.01])
def test_balls_and_long_thin_triangles_are_told_apart(apart: float) -> None:
    """Mirror images of each other, so that edges meet edges; and a rod of slivers through a ring that it misses."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    pair = joined(*((ball.vertices + np.array([x, 0.0, 0.0]), ball.faces) for x in (0.0, apart)))
    if apart < 2.0:
        with pytest.raises(BodyError, match="crosses another part"):
            mesh.solid(*pair)
    else:
        assert mesh.solid(*pair).volume == pytest.approx(2.0 * ball.volume, rel=1e-12)
    ring, rod = trimesh.creation.torus(1.0, 0.2, 40, 40), trimesh.creation.cylinder(0.75 if apart > 2.0 else 0.85, 4.0)
    both = joined((ring.vertices, ring.faces), (rod.vertices, rod.faces))
    if apart < 2.0:
        with pytest.raises(BodyError, match="crosses another part"):
            mesh.solid(*both)
    else:
        assert mesh.solid(*both).volume == pytest.approx(ring.volume + rod.volume, rel=1e-12)


def prism(corners: Any, sides: int, cap: Any) -> tuple[Any, Any]:
    """Return a prism of height 1 over a polygon of `sides` corners, maybe with more points in its faces."""
    n, cap = len(corners), np.array(cap)
    vertices = np.array([[*corner, z] for z in (0.0, 1.0) for corner in corners])
    turn = [(k, (k + 1) % sides) for k in range(sides)]
    walls = [each for i, j in turn for each in ([i, j, j + n], [i, j + n, i + n])]
    return vertices, np.concatenate([walls, cap[:, ::-1], cap + n])


def test_a_surface_that_crosses_itself_is_refused() -> None:
    """A star, also turned, and a bow of two triangles, one of which would be subtracted."""
    points = [[math.cos(0.8 * math.pi * k), math.sin(0.8 * math.pi * k)] for k in range(5)]
    star = prism([*points, [0.0, 0.0]], 5, [[5, k, (k + 1) % 5] for k in range(5)])
    bow = prism([[0, 0], [2, 2], [2, 0], [0, 1]], 4, [[0, 1, 2], [0, 2, 3]])
    for vertices, faces in (star, bow, (star[0] @ Rotation.random(random_state=1).as_matrix().T, star[1])):
        with pytest.raises(BodyError, match=r"the surface of the mesh crosses itself \(near .*count twice"):
            mesh.solid(vertices, faces)


def test_a_tube_through_itself_is_told_from_one_beside_itself() -> None:
    turns, square = np.linspace(0.0, 4.0 * math.pi - 1.0, 40), np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.2
    side = np.arange(4)
    quads = [(4 * i + side, 4 * i + (side + 1) % 4) for i in range(39)]
    faces = [np.stack([[a, b, b + 4], [a, b + 4, a + 4]]).transpose(2, 0, 1).reshape(-1, 3) for a, b in quads]
    faces += [np.array([[0, 3, 2], [0, 2, 1], [156, 157, 158], [156, 158, 159]])]
    for rise, sound in ((0.02, False), (0.1, True)):
        place = [[[(2 + x) * math.cos(a), (2 + x) * math.sin(a), rise * a + z] for x, z in square] for a in turns]
        coil = np.array(place).reshape(-1, 3), np.concatenate(faces)
        if sound:
            assert not mesh.solid(*coil).unchecked
        else:
            with pytest.raises(BodyError, match="crosses itself"):
                mesh.solid(*coil)


def test_triangles_that_only_fold_over_each_other_or_touch_do_not_cross() -> None:
    """A face that is not convex, cut as OBJ readers cut it: outside of it, its triangles cancel. And a foil."""
    corners = [[2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]]
    folded = mesh.solid(*prism(corners, 6, [[0, k, k + 1] for k in range(1, 5)]))
    assert folded.volume == pytest.approx(3.0, rel=1e-14)
    assert not folded.unchecked
    foil = trimesh.creation.icosphere(subdivisions=3)
    assert mesh.solid(foil.vertices * [1.0, 1.0, 1e-7], foil.faces).volume == pytest.approx(1e-7 * foil.volume)


@pytest.mark.slow
def test_what_cannot_be_checked_is_named(tmp_path: Path) -> None:
    """The edges of a fan of 6000 triangles are all close to all its triangles."""
    trimesh.creation.cylinder(1.0, 0.01, sections=6000).export(tmp_path / "disc.ply")
    scene = parse_scene(
        "body: {mass: 2, inertia: {mesh: {file: disc.ply}}}\nduration: 1\n", source=f"{tmp_path}/scene.yaml"
    )
    assert "not checked whether disc.ply crosses itself" in str(scene.findings[-1])
    assert scene.body.principal_moments[2] == pytest.approx(1.0, rel=1e-6)


def test_a_body_in_a_hole_in_a_body_counts() -> None:
    parts = (box((3.0, 3.0, 3.0)), inverted(box((2.0, 2.0, 2.0))), box((1.0, 1.0, 1.0)))

    assert mesh.solid(*joined(*parts)).volume == pytest.approx(27.0 - 8.0 + 1.0, rel=1e-14)


def test_repeated_and_unused_vertices_and_triangles_without_area_do_not_matter() -> None:
    vertices, faces = box((1.0, 2.0, 3.0))
    soup = vertices[faces].reshape(-1, 3)
    soup[soup == 0.0] = -0.0
    triangles = np.arange(36).reshape(12, 3)

    solid = mesh.solid(np.concatenate([soup, [[9.0, 9.0, 9.0]]]), np.concatenate([triangles, [[0, 1, 0]]]))

    assert solid.volume == pytest.approx(6.0, rel=1e-15)
    assert solid.reach == pytest.approx(0.5 * math.sqrt(14.0))


BAD = {
    "open": (box((1, 1, 1))[0], CUBE[1:], r"found 3 open edges, .*near \[-0.5, -0.5, 0.0\].* close the holes"),
    "cracked": (
        *joined((box((1, 1, 1))[0], CUBE[:6]), (box((1, 1, 1))[0] + 1e-9, CUBE[6:])),
        r"open edges.*merge vertices that nearly meet",
    ),
    "one turned": (box((1, 1, 1))[0], np.concatenate([CUBE[1:], CUBE[:1, ::-1]]), "3 edges along which two triangles"),
    "with a fin": (
        np.concatenate([box((1, 1, 1))[0], [[0.0, 0.0, 3.0]]]),
        np.concatenate([CUBE, [[1, 7, 8]]]),
        "open edges",
    ),
    "doubled": (box((1, 1, 1))[0], np.concatenate([CUBE, CUBE]), "18 edges with more than two triangles"),
    "inner wall": (
        *joined(box((1, 1, 1)), box((1, 1, 1), (1.0, 0.0, 0.0))),
        "5 edges with more than two triangles",
    ),
    "part in a part": (*joined(box((2, 2, 2)), box((1, 1, 1))), "lies inside another part"),
    "part turned": (*joined(box((2, 2, 2)), inverted(box((1, 1, 1), (5.0, 0.0, 0.0)))), "is oriented inwards"),
    "corner in a part": (
        *joined(box((1, 1, 1)), box((1, 1, 1), (0.9, 0.9, 0.9))),
        "part 1 of the 2 .* crosses another",
    ),
    "bar through a part": (*joined(box((1, 1, 1)), box((3, 0.2, 0.2))), "crosses another part.* unite the parts"),
    "part moved along an edge": (*joined(box((1, 1, 1)), box((1, 1, 1), (0.5, 0, 0))), "crosses another part"),
    "sheet": (CORNERS[:4], np.array([[0, 1, 2], [0, 2, 1], [1, 3, 2], [1, 2, 3]]), "more than two|no volume"),
    "flat": (CORNERS * [1, 1, 0], CUBE, "no volume|more than two"),
    "two triangles": (CORNERS, CUBE[:2], "2 triangles with an area"),
    "no triangle": (CORNERS, np.zeros((0, 3), dtype=int), "expected triangles"),
    "squares": (CORNERS, np.zeros((6, 4), dtype=int), "expected triangles"),
    "index too large": (CORNERS, CUBE + 1, "the vertex 8 of 8"),
    "index negative": (CORNERS, CUBE - 1, "expected indices"),
    "NaN": (np.where(CORNERS == 1.0, math.nan, 0.0), CUBE, "not finite"),
    "too small": (CORNERS * 1e-160, CUBE, r"size 1e-160 m, expected one from 1e-70 to 1e\+70 m"),
    "too large": (CORNERS * 1e103, CUBE, r"size 1e\+103 m, expected"),
    "too far": (CORNERS * [-1e308, 1.7e308, 1.0], CUBE, r"size 1.7e\+308 m, expected"),
    "infinite": (np.where(CORNERS == 1.0, math.inf, 0.0), CUBE, "not finite"),
}


@pytest.mark.parametrize(("vertices", "faces", "says"), BAD.values(), ids=BAD)
def test_what_is_no_closed_surface(vertices: Any, faces: Any, says: str) -> None:
    with pytest.raises(BodyError, match=says):
        mesh.solid(vertices, faces)


class TestFiles:
    @pytest.mark.parametrize("suffix", ["stl", "STL", "obj", "ply"])
    def test_formats(self, tmp_path: Path, suffix: str) -> None:
        vertices, faces = box((1.0, 2.0, 4.0), (8.0, 0.0, 0.0))
        path = tmp_path / f"part.{suffix}"
        trimesh.Trimesh(vertices, faces, process=False).export(path, file_type=suffix.lower())

        solid = mesh.read_solid(path, 0.5)

        assert solid.volume == pytest.approx(1.0, rel=1e-7)
        assert solid.center_of_mass == pytest.approx((4.0, 0.0, 0.0), abs=1e-7)

    def test_ascii_stl_keeps_its_digits(self, scene_dir: Path) -> None:
        solid = mesh.read_solid(scene_dir / "meshes" / "wedge.stl")

        assert solid.volume == pytest.approx(72_000.0, rel=1e-15)
        assert solid.center_of_mass == pytest.approx((80.0, 20.0, 10.0), rel=1e-15)
        assert solid.squared_gyration[0][2] == pytest.approx(-100.0, rel=1e-14)

    @pytest.mark.parametrize(
        "face",
        ["  f {} {} {}", "f\t{}\t{}\t{}", "fo {} {} {}", "f {} {} {} # c", "f {} \\\n{} {}", "f {}/1/1 {}//1 {}"],
    )
    def test_no_face_of_an_obj_is_passed_over(self, face: str, tmp_path: Path) -> None:
        path = tmp_path / "part.obj"
        lines = [f"v {x} {y} {z}" for x, y, z in (*CORNERS, *(CORNERS + 2.0))] + ["vt 0 0", "vn 0 0 1"]
        lines += ["f {} {} {}".format(*corners) for corners in CUBE + 1]
        path.write_text("\n".join([*lines, *(face.format(*corners) for corners in CUBE + 9)]) + "\n")
        assert mesh.read_solid(path).volume == pytest.approx(2.0)

    def test_indices_below_0_of_an_obj_count_from_the_last_vertex_so_far(self, tmp_path: Path) -> None:
        path, lines = tmp_path / "part.obj", list[str]()
        for corners in (CORNERS, 2.0 * CORNERS + 3.0):
            lines += [f"v {x} {y} {z}" for x, y, z in corners]
            lines += ["f {}/-1 {}//-1 {}".format(*face) for face in CUBE - len(CORNERS)]
        path.write_text("\n".join(lines))
        assert mesh.read_solid(path).volume == pytest.approx(9.0)

    @pytest.mark.parametrize("first", ["0", "-7"])
    def test_an_obj_with_a_vertex_before_the_first_is_refused(self, first: str, tmp_path: Path) -> None:
        # Counted from 0, this octahedron would become a closed solid of a quarter of its volume.
        path = tmp_path / "part.obj"
        corners = ["1 0 0", "0 1 0", "-1 0 0", "0 -1 0", "0 0 1", "0 0 -1"]
        faces = ["014", "124", "234", "304", "105", "215", "325", "035"]
        lines = [f"v {corner}" for corner in corners]
        lines += ["f " + " ".join(first if digit == "0" else digit for digit in face) for face in faces]
        path.write_text("\n".join(lines))
        with pytest.raises(BodyError, match=rf"part.obj: a face has the vertex {first}, expected 1 for the first"):
            mesh.read_solid(path)

    def test_a_vertex_below_0_is_named(self) -> None:
        with pytest.raises(BodyError, match=r"the vertex -1 of 4, expected indices from 0 to 3"):
            mesh.solid(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, -1]]))

    def test_what_an_obj_names_is_not_read(self, tmp_path: Path) -> None:
        path = tmp_path / "part.obj"
        corners = [f"v {x:g} {y:g} {z:g}" for x, y, z in CORNERS]
        faces = ["f " + " ".join(str(i + 1) for i in face) for face in CUBE]
        path.write_text("\n".join(["mtllib ../../secret.mtl", *corners, "usemtl secret", *faces, ""]))

        assert mesh.read_solid(path).volume == pytest.approx(1.0)

    def test_squares_are_taken_as_triangles(self, tmp_path: Path) -> None:
        path = tmp_path / "part.obj"
        squares = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
        path.write_text(
            "\n".join(["v {:g} {:g} {:g}".format(*v) for v in CORNERS] + ["f " + s for s in squares] + [""])
        )

        assert mesh.read_solid(path).volume == pytest.approx(1.0)

    @pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"\x00" * 200,
            b"solid x\nfacet\n",
            b"ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n",
            b"f 1 2 3\n",
            b"\xff" * 84,
            b"\x00" * 80 + struct.pack("<I", 2**32 - 1) + b"\x00" * 50,
        ],
    )
    def test_broken_files_are_answered(self, tmp_path: Path, suffix: str, content: bytes) -> None:
        path = tmp_path / f"part.{suffix}"
        path.write_bytes(content)

        with pytest.raises(BodyError, match=r"part\."):
            mesh.read_solid(path)

    def test_other_formats_pipes_folders_and_urls_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "a.stl").mkdir()
        cases = {
            "part.step": "ends in .stl, .obj, .ply",
            str(tmp_path / "a.stl"): "not a regular file",
            str(tmp_path / "none.stl"): "No such file",
            "https://example.org/part.stl": "URLs",
            "package://robot/part.stl": "URLs",
            "a\0.stl": "cannot be read",
        }
        for path, says in cases.items():
            with pytest.raises(BodyError, match=says):
                mesh.read_solid(path)

    def test_size_is_bounded(self, tmp_path: Path) -> None:
        path = tmp_path / "part.stl"
        with path.open("wb") as file:
            file.truncate(mesh.MAX_BYTES + 1)

        with pytest.raises(BodyError, match="more than 64 MiB"):
            mesh.read_solid(path)

    @pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
    def test_scale_is_positive(self, scene_dir: Path, factor: float) -> None:
        with pytest.raises(BodyError, match="scale is"):
            mesh.read_solid(scene_dir / "meshes" / "wedge.stl", factor)

    def test_without_trimesh_the_error_names_the_extra(self, scene_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "trimesh", None)

        with pytest.raises(MissingExtraError, match=r"'mesh'|\[mesh\]"):
            mesh.read_solid(scene_dir / "meshes" / "wedge.stl")


def test_what_a_reader_tries_first_is_not_shown(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_text(
        "solid a\n"
        + "".join(
            "facet normal 0 0?0\nouter loop\n"
            + "".join("vertex {} {} {}\n".format(*CORNERS[corner]) for corner in face)
            + "endloop\nendfacet\n"
            for face in CUBE
        )
        + "endsolid a\n"
    )
    code = "import sys; from rb_dynamics.body.mesh import read_solid; print(read_solid(sys.argv[1]).volume)"
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert (float(done.stdout), done.stderr) == (pytest.approx(1.0), "")
