"""Poinsot's construction in Rerun: the inertia ellipsoid rolls on the invariable plane and draws its two curves.

Drawn in the space of `rb_dynamics.theory.poinsot_contact`, each point from a sample of the run. While no torque
acts, the plane is fixed; a torque moves it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.sinks.picture_style import BLUE, CYAN, GREEN, GREY, ORANGE, YELLOW
from rb_dynamics.sinks.rerun_thinning import Piece, Trail
from rb_dynamics.theory.poinsot_contact import DISC, LARGEST_CHORD, Contact, half_axes, separatrices

if TYPE_CHECKING:
    import rerun as rr

Array = NDArray[np.float64]

ROOT = "poinsot"
POLHODE, HERPOLHODE = f"{ROOT}/body/polhode", f"{ROOT}/herpolhode"
GROWING = (POLHODE, f"{POLHODE}/dots", HERPOLHODE, f"{HERPOLHODE}/dots")
"""What is shown as far as the time cursor."""

MAX_PIECES = 1000


class Curves:
    """Polhode and herpolhode as they arise, and where the plane lies on which they end."""

    def __init__(self, body: RigidBody, rows: int | None) -> None:
        """Start before the first sample; `rows` is their number, None if unknown."""
        self._body, self._trail = body, Trail(6, MAX_PIECES, rows)
        self._time_ns, self._rate = 0, 0.0
        self.normal: Vector | None = None

    def take(self, stamps: NDArray[np.int64], touch: Contact, angular_velocity_body: Array) -> list[Piece]:
        """Take the next points of contact and return the pieces that they complete; stamps (n, 2) as of `Trail`."""
        turning = np.flatnonzero(np.isfinite(touch.distance))
        if self.normal is None and len(turning):
            x, y, z = touch.normal[turning[0]].tolist()
            self.normal = (x, y, z)
        time_ns = np.append(self._time_ns, stamps[:, 0])
        rate = np.append(self._rate, np.linalg.norm(angular_velocity_body, axis=1))
        turn = np.maximum(rate[1:], rate[:-1]) * np.diff(time_ns) * 1e-9
        joined = (rate[1:] > 0.0) & (rate[:-1] > 0.0) & (turn < LARGEST_CHORD)
        self._time_ns, self._rate = int(time_ns[-1]), float(rate[-1])
        return self._trail.take(stamps, np.column_stack([touch.body, touch.world]), joined)

    def finish(self) -> list[Piece]:
        """Return what is left."""
        return self._trail.finish()


def fixed_looks(body: RigidBody) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """Give entity and components of what looks the same throughout a run."""
    import rerun as rr

    fill = rr.components.FillMode.TransparentFillMajorWireframe
    orientation = rr.Quaternion(xyzw=body.principal_orientation_xyzw)
    ellipsoid = rr.Ellipsoids3D(half_sizes=[half_axes(body)], quaternions=[orientation], colors=[BLUE], fill_mode=fill)
    yield f"{ROOT}/body", [rr.TransformAxes3D(1.3)]
    yield f"{ROOT}/body/ellipsoid", [ellipsoid]
    yield f"{ROOT}/body/separatrices", [rr.LineStrips3D(separatrices(body), colors=[GREY], radii=[-0.75])]
    # A little beyond the plane, so that the curve in it is seen on the disc.
    disc = rr.Cylinders3D(lengths=[2e-3], radii=[DISC], centers=[(0.0, 0.0, 8e-3)], colors=[GREY], fill_mode=fill)
    yield f"{ROOT}/plane", [disc]
    for entity, color in ((POLHODE, GREEN), (HERPOLHODE, YELLOW)):
        yield entity, [rr.LineStrips3D.from_fields(colors=[color], radii=[-1.5])]
        yield f"{entity}/dots", [rr.Points3D.from_fields(colors=[color], radii=[-1.5])]
    for name, label, color in (("angular_momentum", "L", ORANGE), ("angular_velocity", "ω", CYAN)):
        shaft = rr.Arrows3D.from_fields(colors=[color], radii=[-3.0])
        letter = rr.Points3D.from_fields(colors=[color], radii=[-0.5], labels=[label], show_labels=True)
        yield f"{ROOT}/{name}", [shaft, letter]


def columns(orientation_xyzw: Array, touch: Contact) -> Iterator[tuple[str, rr.ComponentColumnList]]:
    """Give entity and columns of what moves; arrows end while the body does not turn, the plane stays where it was."""
    import rerun as rr

    yield f"{ROOT}/body", rr.Transform3D.columns(quaternion=orientation_xyzw)
    turns = np.isfinite(touch.distance)
    if not turns.any():
        return
    normal = touch.normal[turns]
    place = normal * touch.distance[turns, None]
    placed = rr.Transform3D.columns(translation=place, quaternion=_from_z(normal))
    yield f"{ROOT}/plane", placed.partition(turns.astype(int))
    # L as far beyond the plane as keeps it in view; only its direction is meant.
    # The letter of w stands halfway: at its tip it would hide where the ellipsoid touches the plane.
    arrows = (("angular_momentum", 1.4 * normal, 1.1), ("angular_velocity", touch.world[turns], 0.5))
    for name, vectors, letter in arrows:
        both = [*rr.Arrows3D.columns(vectors=vectors), *rr.Points3D.columns(positions=letter * vectors)]
        yield f"{ROOT}/{name}", rr.ComponentColumnList(both).partition(turns.astype(int))


def curves(pieces: list[Piece]) -> Iterator[tuple[str, rr.ComponentColumnList]]:
    """Give entity and columns of pieces of both curves: points of contact in body axes, then in world axes."""
    import rerun as rr

    lines = [[strip for strip in piece.strips if len(strip) > 1] for piece in pieces]
    dots = [[strip for strip in piece.strips if len(strip) == 1 and np.isfinite(strip).all()] for piece in pieces]
    for entity, axes in ((POLHODE, slice(0, 3)), (HERPOLHODE, slice(3, 6))):
        strips = [strip[:, axes] for row in lines for strip in row]
        points = [strip[0, axes] for row in dots for strip in row]
        if strips:
            # One array goes many times as fast as a list; pieces are of one length where the curve has no gap.
            alike = len({len(strip) for strip in strips}) == 1
            columns = rr.LineStrips3D.columns(strips=np.array(strips) if alike else strips)
            yield entity, columns.partition([len(row) for row in lines])
        if points:
            yield f"{entity}/dots", rr.Points3D.columns(positions=points).partition([len(row) for row in dots])


def _from_z(normal: Array) -> Array:
    """Return the shortest turn from the z axis to each normal, xyzw; about x where they are opposite."""
    turn = np.column_stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal)), 1.0 + normal[:, 2]])
    turn[normal[:, 2] < -1.0 + 1e-12] = (1.0, 0.0, 0.0, 0.0)
    unit: Array = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return unit
