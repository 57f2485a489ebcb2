"""Propagate a body and the derivatives of its state: the variational equations on the group, compiled where possible.

The state is attitude q, angular velocity w (body axes), and position p and velocity v of the centre of mass (world
axes). A column of sensitivities is the change of the state with one parameter: a turn e of the attitude in body axes,
R -> R exp(e), and the changes of w, p and v. State and columns take the same steps of the classical Runge-Kutta method.

    R' = R hat(w)          I w' = t + R^T t_w - (k + k2 |w|) w - w x (I w + h) - h'
    p' = v                 v' = (R (f - (c + c2 |u|) u) + f_w) / m + g,   u = R^T (v - wind)

Each interval of the grid holds a wrench f, t (body axes), f_w, t_w (world axes) and has a rotor momentum h (body axes)
that is linear in time. Other effects, also those of plug-ins, are functions of time, state and parameters, added to f_w
and t. They alone are differentiated by central differences, column by column.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.loads.compiled_load import EffectLoad
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.plugin_kernels import are_ready, plugin_kernels
from rb_dynamics.numerics.compilation import block, compiled_apart, flat, lane, specialise
from rb_dynamics.numerics.rotation import Quaternion, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add_scaled

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Counts = npt.NDArray[np.int64]

STATE = 13
"""Size of a state: x, y, z, w of the attitude, w, p, v."""

COLUMN = 12
"""Size of a column: turn, and changes of w, p and v."""

HELD = 19
"""Size of an interval: f, t, f_w, t_w, h at its start, h', and its start (s)."""

BODY = 28
"""Size of a body: Ixx, Iyy, Izz, Ixy, Ixz, Iyz, m, then k, c, k2, c2, wind of c, wind of c2 and g, three each."""

LANES = 4
"""Columns that are computed side by side: a kernel works on a multiple of them, the last of which may be zeros."""

LOADED = 5
"""Numbers of a row of other effects before theirs: 1 / (difference of a parameter), and principal to body axes."""

# Of a state, by how much it is moved for a difference: its truncation and its rounding are as small as each other.
_MOVED = 1e-6

_SIGNATURE = (
    "void(float64[::1], float64[:, ::1], float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], "
    "float64[:, :, ::1], float64[:, ::1], float64[::1], int64[::1], int64[::1], int64, int64, "
    "float64[:, ::1], float64[:, :, ::1], float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[:, ::1], "
    "float64[:, :, ::1])"
)


def rates(
    x: Numbers,
    s: Numbers,
    body: Numbers,
    inverse: Numbers,
    body_by: Numbers,
    held: Numbers,
    held_by: Numbers,
    loads: Any,
    time: float,
    moves: int,
    dx: Numbers,
    ds: Numbers,
) -> None:
    """Write the rates of state `x` and columns `s`, `time` (s) after the start of the interval, to `dx` and `ds`.

    `inverse` is the inverse inertia, row by row. `body_by` (BODY, n) and `held_by` (HELD, n) are the derivatives of
    `body` and `held` with respect to the parameters of the n columns, a multiple of `LANES`.
    `loads` are the other effects: none, or rows of `LOADED` numbers and those of `EffectLoad`. The first is at the
    parameters, and two of each column are at one that is larger, and smaller; 1 / difference is 0 if it does not count.
    If `moves` is 0, p and v are left out.
    """
    qx, qy, qz, qw = x[0], x[1], x[2], x[3]
    w1, w2, w3 = x[4], x[5], x[6]
    i11, i22, i33, i12, i13, i23 = body[0], body[1], body[2], body[3], body[4], body[5]
    # The rotation matrix, of a stage whose quaternion is of unit length only to the order of the method.
    n = 2.0 / (qx * qx + qy * qy + qz * qz + qw * qw)
    r11, r12, r13 = 1.0 - n * (qy * qy + qz * qz), n * (qx * qy - qw * qz), n * (qx * qz + qw * qy)
    r21, r22, r23 = n * (qx * qy + qw * qz), 1.0 - n * (qx * qx + qz * qz), n * (qy * qz - qw * qx)
    r31, r32, r33 = n * (qx * qz - qw * qy), n * (qy * qz + qw * qx), 1.0 - n * (qx * qx + qy * qy)
    dx[0] = 0.5 * (qw * w1 + qy * w3 - qz * w2)
    dx[1] = 0.5 * (qw * w2 + qz * w1 - qx * w3)
    dx[2] = 0.5 * (qw * w3 + qx * w2 - qy * w1)
    dx[3] = 0.5 * (-qx * w1 - qy * w2 - qz * w3)
    # H = I w + h, and the torque in body axes.
    h1 = i11 * w1 + i12 * w2 + i13 * w3 + held[12] + held[15] * time
    h2 = i12 * w1 + i22 * w2 + i23 * w3 + held[13] + held[16] * time
    h3 = i13 * w1 + i23 * w2 + i33 * w3 + held[14] + held[17] * time
    g1 = r11 * held[9] + r21 * held[10] + r31 * held[11]
    g2 = r12 * held[9] + r22 * held[10] + r32 * held[11]
    g3 = r13 * held[9] + r23 * held[10] + r33 * held[11]
    rate = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    slope = 1.0 / rate if rate > 0.0 else 0.0
    k1, k2, k3 = body[7] + body[13] * rate, body[8] + body[14] * rate, body[9] + body[15] * rate
    t1 = held[3] + g1 - k1 * w1 - (w2 * h3 - w3 * h2) - held[15]
    t2 = held[4] + g2 - k2 * w2 - (w3 * h1 - w1 * h3) - held[16]
    t3 = held[5] + g3 - k3 * w3 - (w1 * h2 - w2 * h1) - held[17]
    l1, l2, l3 = 0.0, 0.0, 0.0
    if len(loads) > 0:
        (l1, l2, l3), (y1, y2, y3) = load_at(loads, 0, held[18] + time, state_of(x))
        t1, t2, t3 = t1 + y1, t2 + y2, t3 + y3
    a1 = inverse[0] * t1 + inverse[1] * t2 + inverse[2] * t3
    a2 = inverse[3] * t1 + inverse[4] * t2 + inverse[5] * t3
    a3 = inverse[6] * t1 + inverse[7] * t2 + inverse[8] * t3
    dx[4], dx[5], dx[6] = a1, a2, a3
    m = body[6]
    # Speeds against both media, body axes.
    d1, d2, d3 = x[10] - body[19], x[11] - body[20], x[12] - body[21]
    u1, u2, u3 = r11 * d1 + r21 * d2 + r31 * d3, r12 * d1 + r22 * d2 + r32 * d3, r13 * d1 + r23 * d2 + r33 * d3
    d1, d2, d3 = x[10] - body[22], x[11] - body[23], x[12] - body[24]
    z1, z2, z3 = r11 * d1 + r21 * d2 + r31 * d3, r12 * d1 + r22 * d2 + r32 * d3, r13 * d1 + r23 * d2 + r33 * d3
    speed = math.sqrt(z1 * z1 + z2 * z2 + z3 * z3)
    steep = 1.0 / speed if speed > 0.0 else 0.0
    f1 = held[0] - body[10] * u1 - body[16] * speed * z1
    f2 = held[1] - body[11] * u2 - body[17] * speed * z2
    f3 = held[2] - body[12] * u3 - body[18] * speed * z3
    p1 = r11 * f1 + r12 * f2 + r13 * f3 + held[6] + l1
    p2 = r21 * f1 + r22 * f2 + r23 * f3 + held[7] + l2
    p3 = r31 * f1 + r32 * f2 + r33 * f3 + held[8] + l3
    dx[7], dx[8], dx[9] = x[10], x[11], x[12]
    dx[10], dx[11], dx[12] = p1 / m + body[25], p2 / m + body[26], p3 / m + body[27]
    # Side by side, and to memory that is apart: so the compiler vectorises over columns.
    out, other = block(COLUMN, LANES), block(6, LANES)
    for begin in range(0, s.shape[1], LANES):
        write_other(other, loads, begin, held[18] + time, x, s)
        for c in columns_from(begin, s):
            o, j = lane(c), column(begin, c)
            e1, e2, e3 = s[0, j], s[1, j], s[2, j]
            o1, o2, o3 = s[3, j], s[4, j], s[5, j]
            out[0, o] = o1 - (w2 * e3 - w3 * e2)
            out[1, o] = o2 - (w3 * e1 - w1 * e3)
            out[2, o] = o3 - (w1 * e2 - w2 * e1)
            b11, b22, b33 = body_by[0, j], body_by[1, j], body_by[2, j]
            b12, b13, b23 = body_by[3, j], body_by[4, j], body_by[5, j]
            # Change of H.
            y1 = b11 * w1 + b12 * w2 + b13 * w3 + i11 * o1 + i12 * o2 + i13 * o3
            y2 = b12 * w1 + b22 * w2 + b23 * w3 + i12 * o1 + i22 * o2 + i23 * o3
            y3 = b13 * w1 + b23 * w2 + b33 * w3 + i13 * o1 + i23 * o2 + i33 * o3
            along = (w1 * o1 + w2 * o2 + w3 * o3) * slope
            t1 = -k1 * o1 - (body_by[7, j] + body_by[13, j] * rate + body[13] * along) * w1
            t2 = -k2 * o2 - (body_by[8, j] + body_by[14, j] * rate + body[14] * along) * w2
            t3 = -k3 * o3 - (body_by[9, j] + body_by[15, j] * rate + body[15] * along) * w3
            # R^T t_w turns back as the body turns.
            t1 += g2 * e3 - g3 * e2
            t2 += g3 * e1 - g1 * e3
            t3 += g1 * e2 - g2 * e1
            t1, t2, t3 = t1 + other[3, o], t2 + other[4, o], t3 + other[5, o]
            y1 += held_by[12, j] + held_by[15, j] * time
            y2 += held_by[13, j] + held_by[16, j] * time
            y3 += held_by[14, j] + held_by[17, j] * time
            d1, d2, d3 = held_by[9, j], held_by[10, j], held_by[11, j]
            t1 += held_by[3, j] + r11 * d1 + r21 * d2 + r31 * d3 - held_by[15, j]
            t2 += held_by[4, j] + r12 * d1 + r22 * d2 + r32 * d3 - held_by[16, j]
            t3 += held_by[5, j] + r13 * d1 + r23 * d2 + r33 * d3 - held_by[17, j]
            t1 -= o2 * h3 - o3 * h2 + w2 * y3 - w3 * y2 + b11 * a1 + b12 * a2 + b13 * a3
            t2 -= o3 * h1 - o1 * h3 + w3 * y1 - w1 * y3 + b12 * a1 + b22 * a2 + b23 * a3
            t3 -= o1 * h2 - o2 * h1 + w1 * y2 - w2 * y1 + b13 * a1 + b23 * a2 + b33 * a3
            out[3, o] = inverse[0] * t1 + inverse[1] * t2 + inverse[2] * t3
            out[4, o] = inverse[3] * t1 + inverse[4] * t2 + inverse[5] * t3
            out[5, o] = inverse[6] * t1 + inverse[7] * t2 + inverse[8] * t3
        if moves != 0:
            for c in columns_from(begin, s):
                o, j = lane(c), column(begin, c)
                e1, e2, e3 = s[0, j], s[1, j], s[2, j]
                l1, l2, l3 = other[0, o], other[1, o], other[2, o]
                out[6, o], out[7, o], out[8, o] = s[9, j], s[10, j], s[11, j]
                c1, c2, c3 = s[9, j] - body_by[19, j], s[10, j] - body_by[20, j], s[11, j] - body_by[21, j]
                v1 = r11 * c1 + r21 * c2 + r31 * c3 + u2 * e3 - u3 * e2
                v2 = r12 * c1 + r22 * c2 + r32 * c3 + u3 * e1 - u1 * e3
                v3 = r13 * c1 + r23 * c2 + r33 * c3 + u1 * e2 - u2 * e1
                c1, c2, c3 = s[9, j] - body_by[22, j], s[10, j] - body_by[23, j], s[11, j] - body_by[24, j]
                n1 = r11 * c1 + r21 * c2 + r31 * c3 + z2 * e3 - z3 * e2
                n2 = r12 * c1 + r22 * c2 + r32 * c3 + z3 * e1 - z1 * e3
                n3 = r13 * c1 + r23 * c2 + r33 * c3 + z1 * e2 - z2 * e1
                grows = (z1 * n1 + z2 * n2 + z3 * n3) * steep
                v1 = -body_by[10, j] * u1 - body[10] * v1 - body_by[16, j] * speed * z1
                v2 = -body_by[11, j] * u2 - body[11] * v2 - body_by[17, j] * speed * z2
                v3 = -body_by[12, j] * u3 - body[12] * v3 - body_by[18, j] * speed * z3
                v1 -= body[16] * (grows * z1 + speed * n1) + f2 * e3 - f3 * e2
                v2 -= body[17] * (grows * z2 + speed * n2) + f3 * e1 - f1 * e3
                v3 -= body[18] * (grows * z3 + speed * n3) + f1 * e2 - f2 * e1
                v1, v2, v3 = v1 + held_by[0, j], v2 + held_by[1, j], v3 + held_by[2, j]
                l1, l2, l3 = l1 + held_by[6, j], l2 + held_by[7, j], l3 + held_by[8, j]
                lighter = body_by[6, j] / m
                out[9, o] = (r11 * v1 + r12 * v2 + r13 * v3 + l1 - p1 * lighter) / m + body_by[25, j]
                out[10, o] = (r21 * v1 + r22 * v2 + r23 * v3 + l2 - p2 * lighter) / m + body_by[26, j]
                out[11, o] = (r31 * v1 + r32 * v2 + r33 * v3 + l3 - p3 * lighter) / m + body_by[27, j]
        for r in range(s.shape[0]):
            for c in columns_from(begin, s):
                ds[r, column(begin, c)] = out[r, lane(c)]


def write_other(other: Any, loads: Any, begin: int, at: float, x: Numbers, s: Numbers) -> None:
    """Write the changes of force and torque of other effects with the parameters of columns side by side."""
    for c in range(min(LANES, s.shape[1] - begin)):
        o, force, torque = lane(c), ZERO, ZERO
        if 1 + 2 * (begin + c) < len(loads):
            force, torque = load_changes(loads, begin + c, at, x, s)
        other[0, o], other[1, o], other[2, o] = force
        other[3, o], other[4, o], other[5, o] = torque


@compiled_apart
def load_at(loads: Any, row: int, at: float, state: tuple[float, ...]) -> tuple[Vector, Vector]:
    """Return force (world axes) and torque (body axes) of other effects at a time and a state."""
    qx, qy, qz, qw, w1, w2, w3, p1, p2, p3, v1, v2, v3 = state
    n = 1.0 / math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    axes = (loads[row, 1], loads[row, 2], loads[row, 3], loads[row, 4])
    orientation = multiply((n * qx, n * qy, n * qz, n * qw), axes)
    force, torque = load_of(loads, row, at, (p1, p2, p3), (v1, v2, v3), orientation, rotate_inverse(axes, (w1, w2, w3)))
    return force, rotate(axes, torque)


def load_of(
    loads: Any, row: int, at: float, position: Vector, velocity: Vector, orientation: Quaternion, rate: Vector
) -> tuple[Vector, Vector]:
    """Return force (world axes) and torque (principal axes) of a row."""
    load: Any = EffectLoad(loads[row], at, position)
    return evaluated(load, 0.0, ZERO, velocity, orientation, rate)


def state_of(x: Numbers) -> tuple[float, ...]:
    """Return the numbers of a state."""
    return (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])


@compiled_apart
def load_changes(loads: Any, j: Any, at: float, x: Numbers, s: Numbers) -> tuple[Vector, Vector]:
    """Return the derivatives of force and torque of other effects by the parameter of a column, with the state's."""
    force, torque = ZERO, ZERO
    e1, e2, e3, o1, o2, o3 = s[0, j], s[1, j], s[2, j], s[3, j], s[4, j], s[5, j]
    a1, a2, a3, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if s.shape[0] > 6:
        a1, a2, a3, b1, b2, b3 = s[6, j], s[7, j], s[8, j], s[9, j], s[10, j], s[11, j]
    size = max(
        length(e1, e2, e3),
        length(o1, o2, o3) / (1.0 + length(x[4], x[5], x[6])),
        length(a1, a2, a3) / (1.0 + length(x[7], x[8], x[9])),
        length(b1, b2, b3) / (1.0 + length(x[10], x[11], x[12])),
    )
    q = (x[0], x[1], x[2], x[3])
    for side in (1.0, -1.0):
        if size > 0.0:
            h = side * _MOVED / size
            turn = multiply(q, (0.5 * h * e1, 0.5 * h * e2, 0.5 * h * e3, 1.0))
            rate = (x[4] + h * o1, x[5] + h * o2, x[6] + h * o3)
            place = (x[7] + h * a1, x[8] + h * a2, x[9] + h * a3)
            speed = (x[10] + h * b1, x[11] + h * b2, x[12] + h * b3)
            more = load_at(loads, 0, at, (*turn, *rate, *place, *speed))
            force, torque = add_scaled(force, 0.5 / h, more[0]), add_scaled(torque, 0.5 / h, more[1])
        row = 1 + 2 * j + (0 if side > 0.0 else 1)
        if loads[row, 0] != 0.0:
            more = load_at(loads, row, at, state_of(x))
            slope = side * loads[row, 0]
            force, torque = add_scaled(force, slope, more[0]), add_scaled(torque, slope, more[1])
    return force, torque


def length(x: float, y: float, z: float) -> float:
    """Return the norm."""
    return math.sqrt(x * x + y * y + z * z)


def propagate_sensitivities(
    start: Numbers,
    start_by: Numbers,
    body: Numbers,
    inverse: Numbers,
    body_by: Numbers,
    held: Numbers,
    held_by: Numbers,
    loads: Any,
    lengths: Numbers,
    steps: Counts,
    shifts: Counts,
    first: int,
    moves: int,
    work: Numbers,
    work_by: Numbers,
    work_held: Numbers,
    states: Numbers,
    columns: Numbers,
    slopes: Numbers,
    slopes_by: Numbers,
) -> None:
    """Propagate from `start` (STATE,) and `start_by` (COLUMN, n); write state and columns after each interval.

    Args:
        start: state.
        start_by: columns.
        body: (BODY,).
        inverse: (9,), of the inertia.
        body_by: (BODY, N): the next multiple N of `LANES`, with zeros after n.
        held: (k, HELD), of each interval.
        held_by: (k, HELD, m), for the last m of the columns; or (1, HELD, m), the same for all.
        loads: (0 or 1 + 2 n, ...), see `rates`.
        lengths: (k,), s.
        steps: (k,), Runge-Kutta steps of each interval.
        shifts: (k,), the column that is the time at which the interval starts, or -1.
        first: the interval at whose start `start` is: 1 if the flight goes on and interval 0 is the one before, else 0.
        moves: 1 if position and velocity count; 0 if not, and then columns may end before their changes.
        work: (4, STATE), overwritten.
        work_by: (4, COLUMN, N), overwritten; zeros after n.
        work_held: (HELD, N), likewise, and zeros before the last m of the n.
        states: (k, STATE), to be written.
        columns: (k, COLUMN, n), likewise.
        slopes: (k, STATE), rates of the state, likewise; or (0, STATE), and they are left out.
        slopes_by: (k, COLUMN, n), rates of the columns, likewise.
    """
    x, at, dx, end = work[0], work[1], work[2], work[3]
    s, at_by, ds, end_by = work_by[0], work_by[1], work_by[2], work_by[3]
    first_held = start_by.shape[1] - held_by.shape[2]
    copy(start, start_by, x, s)
    for k in range(first, len(lengths)):
        if shifts[k] >= 0 and k > 0:
            # If the interval starts later, the rates before its start act for longer, and those after it for less.
            for side in range(2):
                b, ahead = k - 1 + side, lengths[k - 1] * (1 - side)
                take(held_by, b, first_held, work_held)
                rates(x, s, body, inverse, body_by, held[b], work_held, loads, ahead, moves, dx, ds)
                for i in range(3):
                    s[3 + i, shifts[k]] += (1 - 2 * side) * dx[4 + i]
                    s[9 + i, shifts[k]] += (1 - 2 * side) * dx[10 + i]
        take(held_by, k, first_held, work_held)
        h = lengths[k] / steps[k]
        for step in range(steps[k]):
            copy(x, s, at, at_by)
            copy(x, s, end, end_by)
            for stage in range(4):
                ahead = (step + 0.5 * ((stage + 1) // 2)) * h
                rates(at, at_by, body, inverse, body_by, held[k], work_held, loads, ahead, moves, dx, ds)
                add(h / (3.0 if stage in (1, 2) else 6.0), dx, ds, end, end_by, end, end_by)
                add(h * (1.0 if stage == 2 else 0.5), dx, ds, x, s, at, at_by)
            copy(end, end_by, x, s)
            length = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
            for i in range(4):
                x[i] /= length
        copy(x, s, states[k], columns[k])
        if len(slopes) > 0:
            rates(x, s, body, inverse, body_by, held[k], work_held, loads, lengths[k], moves, dx, ds)
            copy(dx, ds, slopes[k], slopes_by[k])


def take(held_by: Numbers, k: int, first: int, to: Numbers) -> None:
    """Copy the derivatives of what is held in interval k to the columns from `first` on."""
    k = min(k, len(held_by) - 1)
    for r in range(held_by.shape[1]):
        for i in range(held_by.shape[2]):
            to[r, first + i] = held_by[k, r, i]


def copy(x: Numbers, s: Numbers, to_x: Numbers, to_s: Numbers) -> None:
    """Copy a state and as many of its columns as both have."""
    for i in range(len(x)):
        to_x[i] = x[i]
    for i in range(s.shape[0]):
        for j in range(min(s.shape[1], to_s.shape[1])):
            to_s[i, j] = s[i, j]


def add(h: float, dx: Numbers, ds: Numbers, x: Numbers, s: Numbers, to_x: Numbers, to_s: Numbers) -> None:
    """Write a state and its columns, with h times the rates added."""
    for i in range(len(x)):
        to_x[i] = x[i] + h * dx[i]
    rates_by, by, to = flat(ds), flat(s), flat(to_s)
    for i in range(len(by)):
        to[i] = by[i] + h * rates_by[i]


def columns_from(_begin: int, _s: Numbers) -> Iterable[Any]:
    """Return the indices of columns side by side."""
    return range(LANES)


def column(begin: int, c: Any) -> Any:
    """Return the index of the column that is the c-th from `begin` on."""
    return lane(begin) + lane(c)


# Without a compiler, numpy computes many columns at once: the same bits, ten times as fast.
_MANY = 64


def _all_from(begin: int, s: Numbers) -> Iterable[Any]:
    return (slice(0, min(_MANY, s.shape[1] - begin)),)


def _slice_from(begin: int, c: Any) -> Any:
    return slice(begin, begin + c.stop)


def _copy_whole(x: Numbers, s: Numbers, to_x: Numbers, to_s: Numbers) -> None:
    count = min(s.shape[1], to_s.shape[1])
    to_x[:], to_s[:, :count] = x, s[:, :count]


def _add_whole(h: float, dx: Numbers, ds: Numbers, x: Numbers, s: Numbers, to_x: Numbers, to_s: Numbers) -> None:
    to_x[:], to_s[:] = x + h * dx, s + h * ds


def _take_whole(held_by: Numbers, k: int, first: int, to: Numbers) -> None:
    to[:, first : first + held_by.shape[2]] = held_by[min(k, len(held_by) - 1)]


def _load_in_python(loads: Any, row: int, at: float, *where: Any) -> tuple[Vector, Vector]:
    """Return the load of a row that ends with a function of a point; NaN where it fails, as compiled."""
    try:
        found: tuple[Vector, Vector] = loads[row, LOADED](Point(at, *where))
    except RigidBodyError:
        nothing = (math.nan, math.nan, math.nan)
        return nothing, nothing
    return found


def _other_or_none(other: Any, loads: Any, *where: Any) -> None:
    other[:] = 0.0
    if len(loads) > 0:
        _other_in_python(other, loads, *where)


_load_at_in_python = specialise(load_at, "load_in_python", load_of=_load_in_python)
_changes_in_python = specialise(load_changes, "changes_in_python", load_at=_load_at_in_python)
_other_in_python = specialise(write_other, "other_in_python", LANES=_MANY, load_changes=_changes_in_python)

plain = specialise(
    propagate_sensitivities,
    "sensitivities_of_rows",
    rates=specialise(
        rates,
        "rates_of_rows",
        LANES=_MANY,
        columns_from=_all_from,
        column=_slice_from,
        load_at=_load_at_in_python,
        write_other=_other_or_none,
    ),
    take=_take_whole,
    copy=_copy_whole,
    add=_add_whole,
)

# Cost of a step in plain Python, in steps of rk4, for any number of columns; how often one evaluates other effects.
_EVALUATED = 100.0
VARIATIONAL = OnDemand("identify", propagate_sensitivities, _SIGNATURE, steps=50.0)


def kernel(steps: int, calls: int, effects: tuple[float, ...] | None = ()) -> Callable[..., None]:
    """Return `propagate_sensitivities`, compiled if that pays for this number of calls and steps.

    It is plain if other effects have no numbers (None), or functions that do not compile.
    """
    ahead = steps * calls
    if effects is None or not are_ready(plugin_kernels(effects), [VARIATIONAL], _EVALUATED * ahead, _EVALUATED * steps):
        return plain
    return VARIATIONAL.get(ahead, steps) or plain
