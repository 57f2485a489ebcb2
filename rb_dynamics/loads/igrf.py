"""The International Geomagnetic Reference Field: coefficients from the package ppigrf, evaluated at a place and time.

World axes are those of an inertial frame about the Earth: z along its axis, x to the equinox of J2000. The Earth turns
in them by its rotation angle; precession, nutation and polar motion (0.14 degrees of the axis since 2000) are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from functools import cache
from typing import NamedTuple

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.vector import Vector, subtract

EPOCH = "a date and time of UTC within the model, such as 2025-06-01T12:00:00Z"
"""Valid epochs, for error messages."""

# m: the radius to which the coefficients refer, and that of the core, inside which the series is not valid.
_RADIUS, _CORE = 6.3712e6, 3.4855e6

# The Earth rotation angle (IERS Conventions 2010, eq. 5.15), in turns, and turns per day.
_ANGLE, _MORE_PER_DAY = 0.7790572732640, 0.00273781191135448
_DAY = 86400.0
_J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)


class Term(NamedTuple):
    """One term of the series: degree, order, and coefficients (T) for unnormalised associated Legendre functions."""

    n: int
    m: int
    cosine: float
    sine: float


def parsed(epoch: str) -> datetime:
    """Return a time of ISO 8601; without an offset it is UTC.

    Raises:
        ValueError: it is not one.
    """
    text = epoch.strip()
    # Python 3.10 does not know Z.
    time = datetime.fromisoformat(text[:-1] + "+00:00" if text[-1:] in ("Z", "z") else text)
    return time.replace(tzinfo=timezone.utc) if time.tzinfo is None else time.astimezone(timezone.utc)


def rotation_angle(epoch: datetime, seconds: float) -> float:
    """Return the Earth's rotation angle (rad) some time after `epoch`, whose UTC is taken for UT1 (within 0.9 s)."""
    since = epoch - _J2000
    days = since.days + (since - timedelta(days=since.days)).total_seconds() / _DAY
    turns = _ANGLE + (days % 1.0) + _MORE_PER_DAY * days + seconds / _DAY * (1.0 + _MORE_PER_DAY)
    return math.tau * (turns % 1.0)


@cache
def terms_at(epoch: str) -> tuple[Term, ...]:
    """Return the terms at an epoch, interpolated linearly between those of the model.

    Raises:
        SceneError: the epoch is not a time, or beyond the model; or ppigrf is not installed.
    """
    try:
        time = parsed(epoch)
    except ValueError:
        raise SceneError(f"magnetic_field: epoch is {shown(epoch)}, expected {EPOCH}; write one") from None
    try:
        import ppigrf
    except ImportError as error:
        raise SceneError(
            "magnetic_field: model is igrf, expected the package ppigrf, which has its coefficients; install it with "
            "pip install 'rb-dynamics[igrf]', or write model: dipole"
        ) from error
    cosines, sines = ppigrf.ppigrf.read_shc()
    times = [each.to_pydatetime().replace(tzinfo=timezone.utc) for each in cosines.index]
    if not times[0] <= time <= times[-1]:
        raise SceneError(
            f"magnetic_field: epoch is {shown(epoch)}, expected one from {times[0]:%Y-%m-%d} to {times[-1]:%Y-%m-%d}, "
            "which the installed ppigrf covers; write another, or install a newer one"
        )
    k = max(i for i in range(len(times) - 1) if times[i] <= time)
    part = (time - times[k]) / (times[k + 1] - times[k])

    def at(table: object, key: tuple[int, int]) -> float:
        column = table[key].tolist()  # type: ignore[index]
        return float(column[k] + part * (column[k + 1] - column[k]))

    return tuple(term(n, m, at(cosines, (n, m)), at(sines, (n, m))) for n, m in cosines.columns)


def term(n: int, m: int, g: float, h: float) -> Term:
    """Return the term of two Gauss coefficients (nT), which belong to Schmidt's quasi-normalised functions."""
    factor = math.sqrt((2.0 if m else 1.0) * math.factorial(n - m) / math.factorial(n + m)) * 1e-9
    return Term(n, m, factor * g, factor * h)


def flux_density(terms: Sequence[Term], place: Vector) -> Vector:
    """Return B (T) of the series at a place from the centre (m), in axes that turn with the Earth.

    B = -grad V by Cunningham's recursion, which is singular only at the centre (Montenbruck & Gill, Satellite
    Orbits, section 3.2.4-3.2.5, with a for G M / R).

    Raises:
        ConvergenceError: the place is in the core.
    """
    square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
    if square < _CORE * _CORE:
        raise ConvergenceError(
            f"magnetic_field: the body is {math.sqrt(square):.6g} m from the centre of the Earth, expected at least "
            f"{_CORE:g} m, the radius of its core, inside which igrf has no meaning; move center_world or the body"
        )
    degree = max(each.n for each in terms) + 1
    x, y, z, rho = *(_RADIUS * component / square for component in place), _RADIUS * _RADIUS / square
    v = [[0.0] * (degree + 2) for _ in range(degree + 1)]
    w = [[0.0] * (degree + 2) for _ in range(degree + 1)]
    v[0][0] = _RADIUS / math.sqrt(square)
    for m in range(degree + 1):
        if m:
            v[m][m] = (2 * m - 1) * (x * v[m - 1][m - 1] - y * w[m - 1][m - 1])
            w[m][m] = (2 * m - 1) * (x * w[m - 1][m - 1] + y * v[m - 1][m - 1])
        for n in range(m + 1, degree + 1):
            older = (0.0, 0.0) if n == m + 1 else (v[n - 2][m], w[n - 2][m])
            v[n][m] = ((2 * n - 1) * z * v[n - 1][m] - (n + m - 1) * rho * older[0]) / (n - m)
            w[n][m] = ((2 * n - 1) * z * w[n - 1][m] - (n + m - 1) * rho * older[1]) / (n - m)
    bx = by = bz = 0.0
    for n, m, c, s in terms:
        up_v, up_w = v[n + 1][m + 1], w[n + 1][m + 1]
        if m == 0:
            bx, by = bx + c * up_v, by + c * up_w
        else:
            down_v, down_w, k = v[n + 1][m - 1], w[n + 1][m - 1], (n - m + 2) * (n - m + 1)
            bx += 0.5 * (c * up_v + s * up_w - k * (c * down_v + s * down_w))
            by += 0.5 * (c * up_w - s * up_v + k * (c * down_w - s * down_v))
        bz += (n - m + 1) * (c * v[n + 1][m] + s * w[n + 1][m])
    return (bx, by, bz)


def field_in_world(epoch: str, seconds: float, center: Vector, place: Vector) -> Vector:
    """Return B (T, world axes) at a place (m, world axes), `seconds` after `epoch`, whose coefficients are used."""
    angle = rotation_angle(parsed(epoch), seconds)
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = subtract(place, center)
    bx, by, bz = flux_density(terms_at(epoch), (c * x + s * y, c * y - s * x, z))
    return (c * bx - s * by, s * bx + c * by, bz)
