"""Mass properties of a closed surface of triangles: exact integrals over the polyhedron it encloses.

The divergence theorem turns the volume into signed tetrahedra, one from a reference point to each triangle. With the
corners a, b and c from that point, V = a . (b x c) / 6 and s = a + b + c, one has int x dV = V s / 4 and
int x x^T dV = V / 20 (s s^T + a a^T + b b^T + c c^T); F. Tonon, Explicit exact formulas for the 3-D tetrahedron inertia
tensor in terms of its vertex coordinates, J. Math. Stat. 1 (2004) 8. Second moments are taken about the centre of mass,
so that nothing cancels however far away the origin is. `trimesh` only reads the file formats. Never repairs a surface.
"""

from __future__ import annotations

import io
import logging
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.body.body_files import read_bounded
from rb_dynamics.body.particles import inertia_from_second_moments
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.shapes import LARGEST, SMALLEST
from rb_dynamics.errors import BodyError, needing
from rb_dynamics.numerics.rotation import Matrix
from rb_dynamics.numerics.vector import Vector, scale

MAX_BYTES = 64 << 20
MAX_PARTS = 10_000
FORMATS = (".stl", ".obj", ".ply")

Points = NDArray[np.float64]
Faces = NDArray[np.int64]

_EPS = 2.0**-52
# Parts that touch may be this far inside each other, of the size of the mesh: STL has single precision.
_DEEP = 1e-5
_BLOCK = 4096
_MOST_PIECES = 500_000
# Pairs of an edge and a triangle that are close, and solid angles: some ten seconds.
_MOST_PAIRS = 10_000_000
_MOST_WINDING = 10_000_000


@dataclass(frozen=True, slots=True)
class Solid:
    """What a closed surface encloses, filled uniformly.

    Attributes:
        volume: m^3.
        center_of_mass: in the axes of the mesh, m.
        squared_gyration: the inertia matrix per mass about the centre of mass, m^2.
        reach: distance of the farthest vertex from the centre of mass, m.
        inside_out: the triangles were oriented inwards, and have been turned.
        unchecked: there were too many triangles close to each other to look for all places where the surface crosses
            itself.
    """

    volume: float
    center_of_mass: Vector
    squared_gyration: Matrix
    reach: float
    inside_out: bool = False
    unchecked: bool = False

    def body(self, mass: float) -> RigidBody:
        """Return the body that has this shape and `mass` (kg); the axes of the mesh are the body axes.

        Raises:
            BodyError: the mass is not positive, or the moments are beyond double precision.
        """
        return RigidBody.from_matrix(mass, [scale(mass, row) for row in self.squared_gyration], self.center_of_mass)


def read_mesh(path: str | os.PathLike[str]) -> tuple[Points, Faces]:
    """Return the vertices, in the file's unit, and the triangles of an STL, OBJ or PLY file.

    Raises:
        BodyError: it is not such a file, or larger than 64 MiB.
        MissingExtraError: trimesh is not installed.
    """
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in FORMATS:
        raise BodyError(
            f"file is {os.fspath(path)!r}, expected one that ends in {', '.join(FORMATS)}; convert the mesh"
        )
    data = read_bounded(path, MAX_BYTES, "a mesh")
    with needing("trimesh", "mesh", "a body from a mesh"):
        import trimesh
    # It logs how it failed to read what it then reads in another way.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    if suffix == ".obj":
        data = _surface(data, os.fspath(path))
    try:
        # From bytes and without a resolver: materials and textures that an OBJ names are not looked for.
        mesh: Any = trimesh.load_mesh(io.BytesIO(data), file_type=suffix[1:], process=False)
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # a reader of malformed files may raise anything
        raise BodyError(
            f"{os.fspath(path)} cannot be read as {suffix[1:].upper()} ({type(error).__name__}: {error}), expected a "
            "mesh of triangles; export it again"
        ) from error
    return vertices, faces


def _surface(data: bytes, source: str) -> bytes:
    """Return the vertices and faces of an OBJ file, one a line with single spaces.

    trimesh understands only "f 1 2 3": it silently skips a face that is indented or has tabs, and takes vertex 0 for 1.

    Raises:
        BodyError: a face has a vertex before the first, as in files that count from 0.
    """
    lines, vertices = [], 0
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        match line.split(b"#", 1)[0].split():
            case [b"v", *coordinates]:
                lines.append(b"v " + b" ".join(coordinates[:3]))
                vertices += 1
            case [b"f" | b"fo", *corners]:
                places = (corner.split(b"/", 1)[0] for corner in corners)
                lines.append(b"f " + b" ".join(_from_first(place, vertices, source) for place in places))
    return b"\n".join(lines) + b"\n"


def _from_first(place: bytes, vertices: int, source: str) -> bytes:
    """Return the number of a vertex; one below 0 counts back from the last of those so far, not of the file."""
    try:
        number = int(place)
    except ValueError:  # trimesh refuses it
        return place
    if number == 0 or number < -vertices:
        raise BodyError(
            f"{source}: a face has the vertex {number}, expected 1 for the first, or -1 for the last so far, of "
            f"{vertices}; export the mesh again"
        )
    return b"%d" % (vertices + 1 + number) if number < 0 else place


def read_solid(path: str | os.PathLike[str], scale_to_m: float = 1.0) -> Solid:
    """Return what the closed mesh in the file encloses; `scale_to_m` is the unit of its numbers in m.

    Raises:
        BodyError: as `read_mesh` and `solid`, or the scale is not positive.
        MissingExtraError: trimesh is not installed.
    """
    if not (math.isfinite(scale_to_m) and scale_to_m > 0.0):
        raise BodyError(f"scale is {scale_to_m!r}, expected a finite number greater than 0; write 0.001 for mm")
    vertices, faces = read_mesh(path)
    with np.errstate(over="ignore"):  # what is then not finite is reported
        vertices = vertices * scale_to_m
    try:
        return solid(vertices, faces)
    except BodyError as error:
        raise BodyError(f"{os.fspath(path)}: {error}") from error


def solid(vertices: Points, faces: Faces) -> Solid:
    """Return what the closed surface of these triangles encloses; vertices (n, 3) in m, faces (m, 3) their indices.

    Corners with equal coordinates are one vertex, as STL repeats them. A part inside another one is a hole where its
    triangles are oriented the other way.

    Raises:
        BodyError: the surface is not closed, not consistently oriented, crosses itself, encloses nothing, or is not
            finite, or its size is beyond `SMALLEST` and `LARGEST` of `shapes.py`.
    """
    points, triangles = _merged(vertices, faces)
    _check_closed(points, triangles)
    reference = points.mean(axis=0)
    # A power of two: an exact change of unit, after which cubes and fifth powers of any length are in range.
    unit = 2.0 ** math.frexp(float(np.abs(points - reference).max()))[1]
    parts = _parts(triangles, len(points))
    found = [_part(points, part, unit) for part in parts]
    volumes = [part.volume for part in found]
    volume = math.fsum(volumes)
    if volume < 0.0:
        turned = solid(points, triangles[:, ::-1])
        return replace(turned, inside_out=True)
    unchecked = _check_parts((points - reference) / unit, triangles, parts, volumes, points)
    first = found[0].center
    arms = [(part.volume, (part.center - first) / unit) for part in found]
    rest = np.array([math.fsum(share * arm[i] for share, arm in arms) for i in range(3)]) / volume
    moments = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            about_center = (share * (arm[i] - rest[i]) * (arm[j] - rest[j]) for share, arm in arms)
            own = (part.second_moments[i, j] for part in found)
            moments[i, j] = math.fsum((*own, *about_center)) / volume * unit**2
    center = first + rest * unit
    x, y, z = center.tolist()
    inertia = inertia_from_second_moments(lambda i, j: float(moments[i, j]))
    reach = float(np.sqrt((((points - center) / unit) ** 2).sum(axis=1)).max()) * unit
    return Solid(volume * unit**3, (x, y, z), inertia, reach, unchecked=unchecked)


class _Part(NamedTuple):
    """A part of a solid: its volume and second moments in powers of a unit, and its centre of mass (m)."""

    volume: float
    center: Points
    second_moments: Points


def _part(points: Points, triangles: Faces, unit: float) -> _Part:
    """Return a part by itself: about another part far away, a small one would lose digits as the cube of the distance.

    Raises:
        BodyError: it encloses no volume.
    """
    used, index = np.unique(triangles, return_inverse=True)
    reference, own = points[used].mean(axis=0), index.reshape(triangles.shape)
    local = (points[used] - reference) / unit
    volume = _volume(local, own)
    rest = _first_moment(local, own) / volume
    return _Part(volume, reference + rest * unit, _second_moments(local - rest, own))


def _parts(triangles: Faces, points: int) -> list[Faces]:
    """Return the triangles of each part that is connected by its corners.

    Raises:
        BodyError: there are more than `MAX_PARTS`.
    """
    # scipy is slow to import, and a mesh is read by few.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(points, points))
    count, part_of_point = connected_components(graph, directed=False)
    if count > MAX_PARTS:
        raise BodyError(
            f"found a mesh of {count} separate parts, expected at most {MAX_PARTS}; merge vertices that nearly meet, "
            "or leave out small parts"
        )
    part_of_triangle = part_of_point[triangles[:, 0]]
    order = np.argsort(part_of_triangle, kind="stable")
    return np.split(triangles[order], np.flatnonzero(np.diff(part_of_triangle[order])) + 1)


def _merged(vertices: Points, faces: Faces) -> tuple[Points, Faces]:
    """Return the mesh with equal vertices made one, and without triangles that have one vertex twice."""
    if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3 or not len(faces):
        raise BodyError(
            f"found a mesh with vertices of shape {vertices.shape} and faces of shape {faces.shape}, expected "
            "triangles: (n, 3) and (m, 3); export it as triangles"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = int(faces.min() if faces.min() < 0 else faces.max())
        raise BodyError(
            f"found a triangle with the vertex {bad} of {len(vertices)}, expected indices from 0 to "
            f"{len(vertices) - 1}; export the mesh again"
        )
    used, compact = np.unique(faces, return_inverse=True)
    points = vertices[used]
    if not np.isfinite(points).all():
        raise BodyError("found a vertex that is not finite, expected coordinates in m; export the mesh again")
    farthest = float(np.abs(points).max())
    size = float(np.ptp(points, axis=0).max()) if farthest <= LARGEST else farthest
    if not SMALLEST <= size <= LARGEST:
        raise BodyError(
            f"found a mesh of the size {size:.3g} m, expected one from {SMALLEST:g} to {LARGEST:g} m; check the unit "
            "(scale)"
        )
    points, same = np.unique(points + 0.0, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[compact.reshape(faces.shape)]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) < 4:
        raise BodyError(
            f"found {len(triangles)} triangles with an area, expected at least 4: a closed surface; export it again"
        )
    return points, triangles


def _check_closed(points: Points, triangles: Faces) -> None:
    """Raise unless every edge belongs to two triangles that run along it in opposite directions."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys, index, counts = np.unique(low * len(points) + high, return_inverse=True, return_counts=True)
    balance = np.zeros(len(keys), dtype=np.int64)
    np.add.at(balance, index.reshape(-1), np.where(edges[:, 0] < edges[:, 1], 1, -1))
    for bad, what, remedy in (
        (
            counts == 1,
            "open edges, which one triangle alone has",
            "close the holes and merge vertices that nearly meet",
        ),
        (counts > 2, "edges with more than two triangles", "separate the parts or remove inner and doubled faces"),
        (balance != 0, "edges along which two triangles run the same way", "orient all triangles outwards"),
    ):
        if bad.any():
            first = keys[bad][:3]
            middles = 0.5 * (points[first // len(points)] + points[first % len(points)])
            places = ", ".join(str([float(f"{c:.6g}") for c in place]) for place in middles)
            raise BodyError(
                f"the surface of the mesh is not closed: found {int(bad.sum())} {what} (of {len(keys)} edges; near "
                f"{places}), expected each edge to belong to two triangles in opposite directions; {remedy}"
            )


def _check_parts(points: Points, triangles: Faces, parts: list[Faces], volumes: list[float], named: Points) -> bool:
    """Raise where the surface crosses itself, a part lies inside another and is not a hole, or is a hole in nothing.

    Each would count wrongly. `named` are the points as the file has them. Returns whether a crossing may have been
    missed, because there are too many places to look at.
    """
    count = len(parts)
    inwards = _inwards(points, triangles)
    crossing, complete = _crossing(points, inwards, triangles)
    if crossing:
        first, other = sorted(next(k for k, part in enumerate(parts) if (part == at).any()) for at in crossing)
        which = "the surface" if count == 1 else f"part {first + 1} of the {count} parts"
        place = [float(f"{c:.6g}") for c in named[crossing[0]]]
        raise BodyError(
            f"{which} of the mesh crosses {'itself' if first == other else 'another part'} (near {place}), so that "
            "some of its volume would count twice or be subtracted, expected a surface that bounds one volume; unite "
            "the parts that overlap, and export it again"
        )
    if count == 1:
        return not complete
    corners = [points[part.reshape(-1)] for part in parts]
    lows, highs = (np.array([function(c, axis=0) for c in corners]) for function in (np.min, np.max))
    for part, (own, volume) in enumerate(zip(parts, volumes, strict=True)):
        around = (lows <= highs[part]).all(axis=1) & (lows[part] <= highs).all(axis=1)
        around[part] = False
        inner = points[own[0, 0]] + _DEEP * inwards[own[0, 0]]
        inside = math.fsum(_winding(inner, points, parts[other]) for other in np.flatnonzero(around))
        if round(inside) != (0 if volume > 0.0 else 1):
            what = "lies inside another part, oriented as it is" if volume > 0.0 else "is oriented inwards"
            raise BodyError(
                f"part {part + 1} of the {count} parts of the mesh {what}, expected parts beside each other, oriented "
                "outwards, and holes in them, oriented inwards; turn its triangles, or remove the part"
            )
    return not complete


def _inwards(points: Points, triangles: Faces) -> Points:
    """Return the direction from each vertex into the solid; zero where the normals of its triangles cancel."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = _unit(np.cross(b - a, c - a))
    inwards = np.zeros_like(points)
    for i in range(3):
        np.subtract.at(inwards, triangles[:, i], normals)
    return _unit(inwards)


def _unit(vectors: Points) -> Points:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Points = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    return unit


def _crossing(points: Points, inwards: Points, triangles: Faces) -> tuple[tuple[int, int] | None, bool]:
    """Return a vertex of each of two triangles that cross, None if none do; and whether all could be looked at.

    Where an edge goes through a triangle, the surface need not cross itself: parts may touch, and a flat face that is
    not convex may have been cut into triangles that fold over each other. So the winding number decides: about a
    crossing of two sheets it has three values in a row, in a sound surface only 0 and 1.
    """
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    met, complete = [(np.empty((0, 2), dtype=np.int64), np.empty((0, 4, 3)))], True
    try:
        met += [_met(points, inwards, edges[e], triangles[t]) for e, t in _close(points[edges], points[triangles])]
    except _TooManyError:
        complete = False
    vertices, around = (np.concatenate(each) for each in zip(*met, strict=True))
    stride = -(-len(vertices) // max(1, _MOST_WINDING // len(triangles)))
    for number in range(0, len(vertices), max(1, stride)):
        if any(round(_winding(at, points, triangles)) not in (0, 1) for at in around[number]):
            first, other = vertices[number]
            return (int(first), int(other)), True
    return None, complete and stride <= 1


def _met(points: Points, inwards: Points, edges: Faces, triangles: Faces) -> tuple[Faces, Points]:
    """Return where edges (n, 2) go through triangles (n, 3), also at their border: a vertex of both, and four places.

    The ends of such an edge lie well on both sides. The places (m, 4, 3) lie about it, in and out of both sheets.
    """
    (p, q), (a, b, c) = points[edges.T], points[triangles.T]
    normals = _unit(np.cross(b - a, c - a))
    above, below = (((end - a) * normals).sum(axis=1) for end in (p, q))
    which = np.flatnonzero((np.minimum(above, below) < -_DEEP) & (np.maximum(above, below) > _DEEP))
    p, q, a, b, c, normals, above, below = (each[which] for each in (p, q, a, b, c, normals, above, below))
    at = p + (above / (above - below))[:, None] * (q - p)
    x, y, z = a - at, b - at, c - at
    # Heights over the sides of the triangle.
    shares = [(_unit(np.cross(normals, v - u)) * -u).sum(axis=1) for u, v in ((x, y), (y, z), (z, x))]
    inside = np.min(shares, axis=0, initial=math.inf) > -_DEEP
    edges, at, normals = edges[which][inside], at[inside], normals[inside]
    inner = _unit(inwards[edges].sum(axis=1))
    common = (inner * normals).sum(axis=1, keepdims=True)
    u, v = (2.0 * _DEEP * _unit(each) for each in (normals - common * inner, inner - common * normals))
    places = np.stack([at + u + v, at + u - v, at - u + v, at - u - v], axis=1)
    return np.stack([edges[:, 0], triangles[which][inside, 0]], axis=1), places


class _TooManyError(Exception):
    """There are too many triangles close to each other."""


def _close(edges: Points, triangles: Points) -> Iterator[tuple[Faces, Faces]]:
    """Yield which edges (n, 2, 3) and triangles (m, 3, 3) have boxes that overlap, in blocks; some pairs twice."""
    from scipy.spatial import cKDTree

    low, high = edges.min(axis=1), edges.max(axis=1)
    first, last = triangles.min(axis=1), triangles.max(axis=1)
    # Long thin ones are close to nearly everything, their pieces are not.
    largest = float(np.median(np.concatenate([(high - low).max(axis=1), (last - first).max(axis=1)])))
    parts, edge_of = _pieces(edges[:, [0, 1, 1]], largest)
    tiles, triangle_of = _pieces(triangles, largest)
    (middles, reaches), (centers, halves) = _boxes(parts), _boxes(tiles)
    tree, most, pairs = cKDTree(centers), halves.max(), 0
    for begin in range(0, len(middles), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        near, reach = cKDTree(middles[block]), float(reaches[block].max() + most)
        pairs += int(near.count_neighbors(tree, reach, p=math.inf))
        if pairs > _MOST_PAIRS:
            raise _TooManyError
        found = near.sparse_distance_matrix(tree, reach, p=math.inf, output_type="ndarray")
        edge, triangle = edge_of[block][found["i"]], triangle_of[found["j"]]
        both = ((low[edge] <= last[triangle]) & (first[triangle] <= high[edge])).all(axis=1)
        yield edge[both], triangle[both]


def _boxes(shapes: Points) -> tuple[Points, Points]:
    """Return the middle of the box around each shape, (n, 3), and half of its longest side, (n,)."""
    low, high = shapes.min(axis=1), shapes.max(axis=1)
    return 0.5 * (low + high), 0.5 * (high - low).max(axis=1)


def _pieces(triangles: Points, largest: float) -> tuple[Points, Faces]:
    """Return the triangles cut across their longest edges until they are no larger, and which each is a piece of.

    A bounded number: some may stay larger.
    """
    done, whose = [], []
    left, of = triangles, np.arange(len(triangles))
    most = 2 * len(triangles) + _MOST_PIECES
    while len(left):
        small = 2.0 * _boxes(left)[1] <= 2.0 * largest
        if len(left) > most:
            small[:] = True
        done.append(left[small])
        whose.append(of[small])
        left, of = left[~small], of[~small]
        lengths = np.linalg.norm(left - left[:, [1, 2, 0]], axis=2)
        turned = (lengths.argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(left, turned[:, :, None], axis=1).transpose(1, 0, 2)
        half = 0.5 * (a + b)
        left, of = np.concatenate([np.stack([a, half, c], axis=1), np.stack([half, b, c], axis=1)]), np.tile(of, 2)
    return np.concatenate(done), np.concatenate(whose)


def _winding(at: Points, points: Points, triangles: Faces) -> float:
    """Return how often these triangles wind around the point `at`: their solid angle over 4 pi.

    A. van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125, eq. 8.
    """
    a, b, c = (points[triangles[:, i]] - at for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return math.fsum(2.0 * np.arctan2(_six_volumes(a, b, c), below)) / (4.0 * math.pi)


def _six_volumes(a: Points, b: Points, c: Points) -> Points:
    product: Points = (a * np.cross(b, c)).sum(axis=1)
    return product


def _volume(points: Points, triangles: Faces) -> float:
    """Return the signed volume; raises where it is no more than the rounding of its parts."""
    volumes = _six_volumes(*(points[triangles[:, i]] for i in range(3)))
    total = math.fsum(volumes)
    if abs(total) <= 64.0 * _EPS * math.fsum(np.abs(volumes)):
        raise BodyError(
            "the surface of the mesh encloses no volume, expected a solid; give the sheet a thickness, or use another "
            "form of inertia"
        )
    return total / 6.0


def _first_moment(points: Points, triangles: Faces) -> Points:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    terms = _six_volumes(a, b, c)[:, None] * (a + b + c)
    return np.array([math.fsum(column) for column in terms.T]) / 24.0


def _second_moments(points: Points, triangles: Faces) -> Points:
    """Return int x x^T dV."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    volumes, s = _six_volumes(a, b, c), a + b + c
    moments = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            squares = s[:, i] * s[:, j] + a[:, i] * a[:, j] + b[:, i] * b[:, j] + c[:, i] * c[:, j]
            moments[i, j] = moments[j, i] = math.fsum(volumes * squares) / 120.0
    return moments
