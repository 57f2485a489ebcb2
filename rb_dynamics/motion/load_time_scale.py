"""Time scales of a load: how long it stays close to what it is now, and how fast it changes differences of speed."""

from __future__ import annotations

import math
from typing import Any

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.varying_load import Load, evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import MOMENTUM, PhaseState, total
from rb_dynamics.numerics.compilation import workspace
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, norm, scale, subtract

_EPSILON = 2.0**-52
# Of a speed, for one-sided differences.
_DIFFERENCE = 2.0**-26

# Of each of the times, which are at most as many as a run of all nanoseconds has bits: time, force and torque.
_EACH, _ALL = 7, 7 * 66


def steady_time(load: Load, inertia: Inertia, held: HeldWrench, phase: PhaseState, longest: float) -> float:
    """Return for how long (s), at most `longest`, the load stays close to that in `phase`; see `Stepper.steady`."""
    if not 1.0 / NANOSECONDS < longest < math.inf:
        return longest
    (mass, moments), omega, count = inertia, phase.angular_velocity, 0
    velocity = scale(1.0 / mass, total(phase, MOMENTUM))
    half_acceleration = scale(0.5 / mass, add(held.force_world, rotate(phase.orientation, held.force_body)))
    # A change within the rounding error of the velocities does not count.
    least = _EPSILON / longest
    force = least * mass * norm(velocity)
    torque = least * min(moments[0], moments[1], moments[2]) * (norm(omega) + 1.0 / longest)
    seen, powers = workspace(_ALL), int(math.log2(longest * NANOSECONDS))
    for number in range(powers + 2):
        t = longest * 2.0 ** -(powers + 1 - number) if number > 0 else 0.0
        away = add_scaled(scale(t, velocity), t * t, half_acceleration)
        turned = multiply(phase.orientation, exp(scale(t, omega)))
        known, push, twist = _seen(load, t, away, velocity, turned, omega)
        if not known:
            break
        i, count = _EACH * count, count + 1
        seen[i] = t
        seen[i + 1], seen[i + 2], seen[i + 3] = push
        seen[i + 4], seen[i + 5], seen[i + 6] = twist
        force, torque = max(force, 0.5 * norm(push)), max(torque, 0.5 * norm(twist))
    now = (seen[1], seen[2], seen[3]), (seen[4], seen[5], seen[6])
    for number in range(count):
        i = _EACH * number
        push, twist = (seen[i + 1], seen[i + 2], seen[i + 3]), (seen[i + 4], seen[i + 5], seen[i + 6])
        if norm(subtract(push, now[0])) > force or norm(subtract(twist, now[1])) > torque:
            return float(seen[i])
    return longest


def fastest_rate(load: Load, inertia: Inertia, phase: PhaseState) -> float:
    """Return the largest rate (1/s) at which the load makes small differences of velocities decay, turn or grow.

    An explicit method is stable while a step times this rate is no more than about 3.

    Raises:
        ConvergenceError: the load is not known in `phase`.
    """
    rates = [0.0] * 36
    write_rates(load, inertia, phase, rates)
    return largest_rate(rates)


def largest_rate(rates: Any) -> float:
    """Return the largest eigenvalue (1/s) of what `write_rates` has written; inf if that is not finite."""
    import numpy as np

    found = np.reshape(rates, (6, 6))
    return float(abs(np.linalg.eigvals(found)).max()) if np.isfinite(found).all() else math.inf


def write_rates(load: Load, inertia: Inertia, phase: PhaseState, rates: Any) -> None:
    """Write the changes of the six accelerations with each of the six velocities to `rates`, row by row."""
    q, w, v = phase.orientation, phase.angular_velocity, scale(1.0 / inertia.mass, total(phase, MOMENTUM))
    here, now = _accelerations(load, inertia, q, v, w), (v[0], v[1], v[2], w[0], w[1], w[2])
    for k in range(6):
        size = norm(v if k < 3 else w)
        a = now[k] + _DIFFERENCE * (size if size > 0.0 else 1.0)
        ahead = a if k == 0 else v[0], a if k == 1 else v[1], a if k == 2 else v[2]
        spun = a if k == 3 else w[0], a if k == 4 else w[1], a if k == 5 else w[2]
        there = _accelerations(load, inertia, q, ahead, spun)
        for j in range(6):
            rates[6 * k + j] = (there[j] - here[j]) / (a - now[k])


def _accelerations(
    load: Load, inertia: Inertia, orientation: Quaternion, velocity: Vector, omega: Vector
) -> tuple[float, float, float, float, float, float]:
    force, torque = evaluated(load, 0.0, ZERO, velocity, orientation, omega)
    a, b = scale(1.0 / inertia.mass, force), divide(torque, inertia.moments)
    return a[0], a[1], a[2], b[0], b[1], b[2]


def _seen(
    load: Load, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, omega: Vector
) -> tuple[bool, Vector, Vector]:
    """Return whether there is a load, a finite one, with force and torque. A kernel has its own version."""
    try:
        push, twist = load(t, displacement, velocity, orientation, omega)
    except ConvergenceError:
        return False, ZERO, ZERO
    return are_finite(push, twist), push, twist


def are_finite(push: Vector, twist: Vector) -> bool:
    """Return whether force and torque are."""
    return math.isfinite((push[0] + push[1] + push[2]) + (twist[0] + twist[1] + twist[2]))
