"""Shapes: every formula against numerical integration, textbook values and limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from rb_dynamics.body import shapes
from rb_dynamics.body.shapes import SHAPES, Shape
from rb_dynamics.errors import BodyError
from rb_dynamics.numerics import rotation

lengths = st.floats(0.01, 100.0)


def revolved(radial: Callable[[float, int], float], low: float, high: float, cuts: list[float]) -> Any:
    """Return (volume, k_x^2, k_z^2, z of the centre) of a body of revolution, by Gauss-Legendre quadrature over z.

    `radial(z, n)` is the integral of r^(2 n + 1) dr over the section at z. Between the cuts it is a polynomial in z of
    degree 4 at most for all bodies here, so that 8 nodes leave only round-off.
    """
    nodes, weights = np.polynomial.legendre.leggauss(8)

    def integral(function: Callable[[float], float]) -> float:
        points = [low, *cuts, high]
        pieces = [(0.5 * (a + b), 0.5 * (b - a)) for a, b in itertools.pairwise(points)]
        return math.fsum(
            w * half * function(mid + half * x) for mid, half in pieces for x, w in zip(nodes, weights, strict=True)
        )

    def area(z: float) -> float:
        return 2.0 * math.pi * radial(z, 0)

    def polar(z: float) -> float:
        return 2.0 * math.pi * radial(z, 1)

    volume = integral(area)
    center = integral(lambda z: z * area(z)) / volume
    along = integral(polar) / volume
    across = integral(lambda z: (z - center) ** 2 * area(z)) / volume + along / 2.0
    return volume, across, along, center


def solid_section(radius: Callable[[float], float], hole: Callable[[float], float] = lambda _: 0.0) -> Any:
    return lambda z, n: (radius(z) ** (2 * n + 2) - hole(z) ** (2 * n + 2)) / (2 * n + 2)


def arc(radius: float) -> Callable[[float], float]:
    return lambda z: math.sqrt(max(radius**2 - z**2, 0.0))


def capsule_radius(r: float, h: float) -> Callable[[float], float]:
    return lambda z: arc(r)(max(abs(z) - h / 2.0, 0.0))


REVOLVED = {
    "cylinder": (shapes.cylinder(0.3, 1.7), solid_section(lambda _: 0.3), -0.85, 0.85, []),
    "cone": (shapes.cone(0.4, 1.3), solid_section(lambda z: 0.4 * (1.0 - z / 1.3)), 0.0, 1.3, []),
    "sphere": (shapes.sphere(0.7), solid_section(arc(0.7)), -0.7, 0.7, []),
    "capsule": (
        shapes.capsule(0.25, 0.9),
        solid_section(capsule_radius(0.25, 0.9)),
        -0.7,
        0.7,
        [-0.45, 0.45],
    ),
    "flat capsule": (
        shapes.capsule(2.0, 0.1),
        solid_section(capsule_radius(2.0, 0.1)),
        -2.05,
        2.05,
        [-0.05, 0.05],
    ),
    "hollow sphere": (shapes.hollow_sphere(0.7, 0.5), solid_section(arc(0.7), arc(0.5)), -0.7, 0.7, [-0.5, 0.5]),
    "hollow cylinder": (
        shapes.hollow_cylinder(0.5, 0.2, 0.8),
        solid_section(lambda _: 0.5, lambda _: 0.2),
        -0.4,
        0.4,
        [],
    ),
}


@pytest.mark.parametrize(("shape", "section", "low", "high", "cuts"), REVOLVED.values(), ids=REVOLVED)
def test_bodies_of_revolution_by_quadrature(
    shape: Shape, section: Any, low: float, high: float, cuts: list[float]
) -> None:
    volume, across, along, _ = revolved(section, low, high, cuts)

    assert shape.volume == pytest.approx(volume, rel=1e-13)
    assert shape.squared_gyration == pytest.approx((across, across, along), rel=1e-13)


def test_centre_of_mass_of_a_cone_is_a_quarter_of_its_height_above_the_base() -> None:
    assert revolved(solid_section(lambda z: 0.4 * (1.0 - z / 1.3)), 0.0, 1.3, [])[3] == pytest.approx(1.3 / 4.0)


def shell(profile: Callable[[float], tuple[float, float, float]], low: float, high: float) -> Any:
    """Return (mass, int x^2 dm, int z^2 dm) of the surface swept by (r, z, ds/dt), t from low to high."""

    def integral(weight: Callable[[float, float], float]) -> float:
        def integrand(t: float) -> float:
            r, z, speed = profile(t)
            return 2.0 * math.pi * r * speed * weight(r, z)

        return float(quad(integrand, low, high, epsabs=0.0, epsrel=1e-12)[0])

    return np.array([integral(lambda _r, _z: 1.0), integral(lambda r, _: r * r / 2.0), integral(lambda _, z: z * z)])


@pytest.mark.parametrize(
    ("shape", "sums"),
    [
        (
            shapes.spherical_shell(0.6),
            shell(lambda t: (0.6 * math.sin(t), 0.6 * math.cos(t), 0.6), 0.0, math.pi),
        ),
        (shapes.cylindrical_shell(0.3, 1.1), shell(lambda t: (0.3, t, 1.0), -0.55, 0.55)),
        (
            shapes.closed_cylindrical_shell(0.3, 1.1),
            shell(lambda t: (0.3, t, 1.0), -0.55, 0.55) + 2.0 * shell(lambda t: (t, 0.55, 1.0), 0.0, 0.3),
        ),
    ],
    ids=["sphere", "tube", "can"],
)
def test_shells_by_quadrature(shape: Shape, sums: Any) -> None:
    mass, xx, zz = sums
    across, along = (xx + zz) / mass, 2.0 * xx / mass

    assert shape.squared_gyration == pytest.approx((across, across, along), rel=1e-11)
    assert shape.volume is None


@pytest.mark.parametrize(
    ("shape", "limits"),
    [
        (shapes.box((1.0, 2.0, 3.0)), [1.0, 2.0, 3.0]),
        (shapes.ellipsoid((0.5, 1.0, 1.5)), None),
    ],
    ids=["box", "ellipsoid"],
)
def test_box_and_ellipsoid_by_quadrature(shape: Shape, limits: list[float] | None) -> None:
    """Gauss-Legendre over a box, and over the unit ball in spherical coordinates: exact for these polynomials."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    if limits:
        grid = np.stack(np.meshgrid(*(0.5 * a * nodes for a in limits), indexing="ij"))
        w = np.prod(np.stack(np.meshgrid(*(0.5 * a * weights for a in limits), indexing="ij")), axis=0)
    else:
        radius, cosine = 0.5 * (nodes + 1.0), nodes
        angle = np.arange(12) * math.pi / 6.0
        r, c, phi = np.meshgrid(radius, cosine, angle, indexing="ij")
        wr, wc, wa = np.meshgrid(0.5 * weights, weights, np.full(12, math.pi / 6.0), indexing="ij")
        sine = np.sqrt(1.0 - c * c)
        scale = np.array([0.5, 1.0, 1.5]).reshape(3, 1, 1, 1)
        grid = scale * np.stack([r * sine * np.cos(phi), r * sine * np.sin(phi), r * c])
        w = wr * wc * wa * r * r * scale.prod()
    volume = w.sum()
    squares = np.array([(w * x * x).sum() for x in grid]) / volume

    assert shape.volume == pytest.approx(volume, rel=1e-13)
    assert shape.squared_gyration == pytest.approx(squares.sum() - squares, rel=1e-13)


TEXTBOOK = {
    "box 1 x 2 x 3, 12 kg": (shapes.box((1, 2, 3)).body(12.0), (13.0, 10.0, 5.0)),
    "cube": (shapes.box((2, 2, 2)).body(3.0), (2.0, 2.0, 2.0)),
    "ball, 2/5 m r^2": (shapes.sphere(3.0).body(5.0), (18.0, 18.0, 18.0)),
    "ellipsoid": (shapes.ellipsoid((1, 2, 3)).body(5.0), (13.0, 10.0, 5.0)),
    "cylinder": (shapes.cylinder(2.0, 6.0).body(1.0), (4.0, 4.0, 2.0)),
    "cone": (shapes.cone(2.0, 4.0).body(10.0), (12.0, 12.0, 12.0)),
    "hollow cylinder": (shapes.hollow_cylinder(3.0, 1.0, 6.0).body(2.0), (11.0, 11.0, 10.0)),
    "spherical shell, 2/3 m r^2": (shapes.spherical_shell(3.0).body(1.0), (6.0, 6.0, 6.0)),
    "hoop with height": (shapes.cylindrical_shell(2.0, 6.0).body(1.0), (5.0, 5.0, 4.0)),
}


@pytest.mark.parametrize(("body", "moments"), TEXTBOOK.values(), ids=TEXTBOOK)
def test_textbook_values(body: Any, moments: tuple[float, float, float]) -> None:
    assert body.principal_moments == pytest.approx(moments, rel=1e-15)


@given(lengths, lengths)
def test_a_hollow_body_is_the_outer_less_the_inner(a: float, b: float) -> None:
    inner, outer = sorted((a, a + b))
    hollow, whole, hole = shapes.hollow_sphere(outer, inner), shapes.sphere(outer), shapes.sphere(inner)
    moment = whole.volume * whole.squared_gyration[0] - hole.volume * hole.squared_gyration[0]

    assert hollow.volume == pytest.approx(whole.volume - hole.volume, abs=1e-13 * whole.volume)
    assert hollow.volume * hollow.squared_gyration[0] == pytest.approx(
        moment, abs=1e-13 * whole.volume * whole.squared_gyration[0]
    )


def test_a_thin_wall_tends_to_the_shell_without_losing_digits() -> None:
    """Evaluated literally, (R^5 - r^5) / (R^3 - r^3) would be noise for a wall of 1e-15."""
    wall = 4.0 * 2.0**-52
    sphere, shell_ = shapes.hollow_sphere(1.0, 1.0 - wall), shapes.spherical_shell(1.0)
    tube, open_ = shapes.hollow_cylinder(1.0, 1.0 - wall, 3.0), shapes.cylindrical_shell(1.0, 3.0)

    assert sphere.squared_gyration == pytest.approx(shell_.squared_gyration, rel=4e-15)
    assert sphere.volume == pytest.approx(4.0 * math.pi * wall, rel=4e-15)
    assert tube.squared_gyration == pytest.approx(open_.squared_gyration, rel=4e-15)


def test_a_capsule_lies_between_ball_and_cylinder() -> None:
    assert shapes.capsule(1.0, 1e-12).squared_gyration == pytest.approx(shapes.sphere(1.0).squared_gyration, rel=1e-11)
    long = shapes.capsule(1.0, 1e9)
    assert long.squared_gyration == pytest.approx(shapes.cylinder(1.0, 1e9).squared_gyration, rel=1e-8)


@given(st.tuples(lengths, lengths, lengths), st.floats(0.01, 100.0), st.tuples(*(st.floats(-3.0, 3.0),) * 3))
def test_the_shape_is_put_where_it_is_told(size: Any, mass: float, turn: Any) -> None:
    shape, q = shapes.box(size), rotation.exp(turn)

    body = shape.body(mass, (1.0, 2.0, 3.0), q)

    assert body.center_of_mass == (1.0, 2.0, 3.0)
    a = np.array(rotation.matrix(q))
    expected = a @ np.diag(mass * np.array(shape.squared_gyration)) @ a.T
    np.testing.assert_allclose(body.inertia, expected, atol=1e-14 * expected.max())


@pytest.mark.parametrize("form", SHAPES.values(), ids=SHAPES)
@given(st.data())
def test_every_shape_is_a_body_of_any_size(form: Any, data: st.DataObject) -> None:
    size = data.draw(st.sampled_from([1e-12, 1.0, 1e12]))
    drawn = [size * data.draw(lengths) for _ in range(3)]
    if form.vector:
        shape = form.make(drawn)
    else:
        named = dict(zip(form.dimensions, sorted(drawn, reverse=True), strict=False))
        if named.get("inner_radius") == named.get("outer_radius", 0.0):
            return
        shape = form.make(**named)
    body = shape.body(2.0)

    assert all(math.isfinite(moment) and moment > 0.0 for moment in body.principal_moments)
    assert shape.volume is None or shape.volume > 0.0


@pytest.mark.parametrize("form", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_dimensions_are_positive(form: Any, bad: float, place: int) -> None:
    count = 3 if form.vector else len(form.dimensions)
    dimensions = [2.0, 1.0, 1.5][:count]
    dimensions[place % count] = bad
    with pytest.raises(BodyError, match="expected a finite number greater than 0"):
        form.make(dimensions) if form.vector else form.make(*dimensions)


def test_what_is_refused() -> None:
    with pytest.raises(BodyError, match="expected inner_radius less than outer_radius"):
        shapes.hollow_sphere(1.0, 1.0)
    with pytest.raises(BodyError, match="expected three numbers"):
        shapes.box((1.0, 2.0))
    with pytest.raises(BodyError, match="thin shell has no volume"):
        shapes.spherical_shell(1.0).mass(2700.0)
    with pytest.raises(BodyError, match="density is -1"):
        shapes.sphere(1.0).mass(-1.0)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e80, 1e300])
def test_a_length_whose_powers_are_no_numbers_is_refused(name: str, size: float) -> None:
    form = SHAPES[name]
    lengths = [(size,) * 3] if form.vector else [size, 0.5 * size, size][: len(form.dimensions)]
    with pytest.raises(BodyError, match=r"expected a length from 1e-70 to 1e\+70 m"):
        form.make(*lengths)
