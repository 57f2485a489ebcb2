"""Layout of body, wrench and phase in the arrays of the kernels.

For one body the numbers are consecutive from index i on; for many, each number is a row, with body i in column i.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import PhaseState, Sums, of_origin
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

Constants = tuple[Inertia, HeldWrench]
"""What is constant from step to step: body and held wrench."""

CONSTANTS = 16
"""Number of constants: mass, principal moments, force and torque in principal axes, force and torque in world axes."""

PHASE = 35
"""Size of a phase: attitude, angular velocity, high sums, low sums; see `PhaseState`."""


def constant_numbers(inertia: Inertia, held: HeldWrench) -> tuple[float, ...]:
    """Return the `CONSTANTS` numbers of body and wrench."""
    return (inertia.mass, *inertia.moments, *held[0], *held[1], *held[2], *held[3])


def constants_at(numbers: Numbers) -> Constants:
    """Return the body and the wrench at the beginning of `numbers`."""
    c = numbers
    held = HeldWrench((c[4], c[5], c[6]), (c[7], c[8], c[9]), (c[10], c[11], c[12]), (c[13], c[14], c[15]))
    return Inertia(c[0], (c[1], c[2], c[3])), held


def constants_in(rows: Numbers, i: int) -> Constants:
    """Return the body and the wrench in column i."""
    c = rows
    held = HeldWrench(
        (c[4, i], c[5, i], c[6, i]),
        (c[7, i], c[8, i], c[9, i]),
        (c[10, i], c[11, i], c[12, i]),
        (c[13, i], c[14, i], c[15, i]),
    )
    return Inertia(c[0, i], (c[1, i], c[2, i], c[3, i])), held


def write_held(rows: Numbers, i: int, held: HeldWrench) -> None:
    """Write the wrench to column i."""
    c = rows
    c[4, i], c[5, i], c[6, i] = held.force_body
    c[7, i], c[8, i], c[9, i] = held.torque_body
    c[10, i], c[11, i], c[12, i] = held.force_world
    c[13, i], c[14, i], c[15, i] = held.torque_world


def phase_numbers(phase: PhaseState) -> tuple[float, ...]:
    """Return the `PHASE` numbers of `phase`."""
    return (*phase.orientation, *phase.angular_velocity, *phase.high, *phase.low)


def phase_of(numbers: tuple[float, ...]) -> PhaseState:
    """Return the phase for these `PHASE` numbers."""
    s = numbers
    return PhaseState((s[0], s[1], s[2], s[3]), (s[4], s[5], s[6]), s[7:21], s[21:])


def phase_at(numbers: Numbers, i: int) -> PhaseState:
    """Return the phase that begins at number i."""
    s = numbers
    high = (
        *(s[i + 7], s[i + 8], s[i + 9], s[i + 10], s[i + 11], s[i + 12], s[i + 13]),
        *(s[i + 14], s[i + 15], s[i + 16], s[i + 17], s[i + 18], s[i + 19], s[i + 20]),
    )
    low = (
        *(s[i + 21], s[i + 22], s[i + 23], s[i + 24], s[i + 25], s[i + 26], s[i + 27]),
        *(s[i + 28], s[i + 29], s[i + 30], s[i + 31], s[i + 32], s[i + 33], s[i + 34]),
    )
    return PhaseState((s[i], s[i + 1], s[i + 2], s[i + 3]), (s[i + 4], s[i + 5], s[i + 6]), high, low)


def write_phase(numbers: Numbers, i: int, phase: PhaseState) -> None:
    """Write `phase` from number i on."""
    numbers[i], numbers[i + 1], numbers[i + 2], numbers[i + 3] = phase.orientation
    numbers[i + 4], numbers[i + 5], numbers[i + 6] = phase.angular_velocity
    for k in range(14):
        numbers[i + 7 + k] = phase.high[k]
        numbers[i + 21 + k] = phase.low[k]


# Tuples, as in `run` of a kernel, and no loop, so that the compiler can vectorise over bodies.
def phase_in(rows: Numbers, i: int) -> tuple[Quaternion, Vector, Sums, Sums]:
    """Return attitude, angular velocity, high and low sums in column i."""
    s = rows
    return (s[0, i], s[1, i], s[2, i], s[3, i]), (s[4, i], s[5, i], s[6, i]), _sums(s, 7, i), _sums(s, 21, i)


def write_phase_in(rows: Numbers, i: int, q: Quaternion, w: Vector, high: Sums, low: Sums) -> None:
    """Write attitude, angular velocity, high and low sums to column i."""
    s = rows
    s[0, i], s[1, i], s[2, i], s[3, i] = q
    s[4, i], s[5, i], s[6, i] = w
    _write_sums(s, 7, i, high)
    _write_sums(s, 21, i, low)


def _sums(s: Numbers, r: int, i: int) -> Sums:
    return (
        *(s[r, i], s[r + 1, i], s[r + 2, i], s[r + 3, i], s[r + 4, i], s[r + 5, i], s[r + 6, i]),
        *(s[r + 7, i], s[r + 8, i], s[r + 9, i], s[r + 10, i], s[r + 11, i], s[r + 12, i], s[r + 13, i]),
    )


def _write_sums(s: Numbers, r: int, i: int, a: Sums) -> None:
    s[r, i], s[r + 1, i], s[r + 2, i], s[r + 3, i], s[r + 4, i], s[r + 5, i], s[r + 6, i] = a[:7]
    s[r + 7, i], s[r + 8, i], s[r + 9, i], s[r + 10, i], s[r + 11, i], s[r + 12, i], s[r + 13, i] = a[7:]


def find_truths(rows: Numbers, bodies: Numbers, truth: Numbers) -> None:
    """Write position, attitude and angular velocity of bodies, as in `Truth`.

    Args:
        rows: (groups, ..., lanes), of body i the numbers of lane i % lanes in group i // lanes: constants, then phase.
        bodies: (7, N), of each the centre of mass, and the rotation from principal to body axes.
        truth: (N, 10 and more).
    """
    for i in range(len(truth)):
        group, at = divmod(i, rows.shape[2])
        (q, omega, high, low), b, t = phase_in(rows[group, CONSTANTS : CONSTANTS + PHASE], at), bodies, truth
        place: Vector = (high[0] + low[0], high[1] + low[1], high[2] + low[2])
        axes = (b[3, i], b[4, i], b[5, i], b[6, i])
        (t[i, 0], t[i, 1], t[i, 2]), turn, _, spin = of_origin((b[0, i], b[1, i], b[2, i]), axes, place, q, ZERO, omega)
        t[i, 3], t[i, 4], t[i, 5], t[i, 6] = turn
        t[i, 7], t[i, 8], t[i, 9] = spin


TRUTHS = "void(float64[:, :, ::1], float64[:, ::1], float64[:, ::1])"
"""Types of the arguments of `find_truths`, as numba writes them."""
