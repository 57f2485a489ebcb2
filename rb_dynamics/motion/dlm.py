"""Splitting of the free body into rotations about its principal axes: explicit, cheap, keeps the angular momentum.

Each axis alone turns the body uniformly. Between half kicks by the wrench, as in `splitting.py`.
"""

from __future__ import annotations

import math

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.composition import KAHAN_LI6, SUZUKI4
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.splitting import Stages, advance, kick_free_kick
from rb_dynamics.rotation import Quaternion, exp, multiply
from rb_dynamics.vector import Vector, scale


def flow(moments: Vector, orientation: Quaternion, angular_velocity: Vector, t: float) -> tuple[Quaternion, Vector]:
    """Return attitude and angular velocity after t s of free motion, of order 2; exact if two moments are equal.

    With b the axis of the middle moment, T = L^2/(2 I_b) + m_a^2 (1/I_a - 1/I_b)/2 + m_c^2 (1/I_c - 1/I_b)/2. The
    first term turns the body about L and commutes with the others, each of which turns it about its own axis.
    """
    a, b, c = sorted(range(3), key=lambda i: moments[i])
    middle = moments[b]
    m = [i * w for i, w in zip(moments, angular_velocity, strict=True)]
    q = list(multiply(orientation, exp(scale(t, (m[0] / middle, m[1] / middle, m[2] / middle)))))
    # Relative first: the inverse of a small moment may be no number where the rate is one.
    half_a, whole_c = 0.5 * t * ((middle - moments[a]) / middle), t * ((middle - moments[c]) / middle)
    _turn(q, m, a, half_a * (m[a] / moments[a]))
    _turn(q, m, c, whole_c * (m[c] / moments[c]))
    _turn(q, m, a, half_a * (m[a] / moments[a]))
    return (q[0], q[1], q[2], q[3]), (m[0] / moments[0], m[1] / moments[1], m[2] / moments[2])


def _turn(q: list[float], m: list[float], axis: int, angle: float) -> None:
    """Turn the body by `angle` about a principal axis: q <- q r, and the vector m, fixed in the world, by r^-1."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    q[axis], q[j], q[k], q[3] = (
        c * q[axis] + s * q[3],
        c * q[j] + s * q[k],
        c * q[k] - s * q[j],
        c * q[3] - s * q[axis],
    )
    # cos(angle) - 1 by the half angle, so that nothing cancels.
    sine, versine = 2.0 * s * c, 2.0 * s * s
    m[j], m[k] = m[j] + (sine * m[k] - versine * m[j]), m[k] - (sine * m[j] + versine * m[k])


def _method(name: str, order: int, stages: Stages, scheme: str) -> Method:
    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        return advance(name, flow, stages, inertia, held, h, velocity, orientation, angular_velocity, load)

    step.__doc__ = f"""Advance by kicks and turns about the principal axes: {scheme}.

    Order {order}, symmetric. World-frame angular momentum changes by the booked torque impulse, to round-off. Takes
    loads that depend on time, place and attitude; symplectic if they have a potential.
    Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840; HLW VII.5.3. The part that all axes share is
    taken out: compare Fasso, J. Comput. Phys. 189 (2003) 527.

    Raises:
        ConvergenceError: the body turns too far between two kicks.
    """
    return Method(name, order, frozenset({"angular_momentum", "unit_quaternion"}), step, takes=Takes.FIELD)


DLM2 = _method("dlm2", 2, kick_free_kick((1.0,)), "one symmetric step")
DLM4 = _method("dlm4", 4, kick_free_kick(SUZUKI4), "composed after Suzuki, Phys. Lett. A 146 (1990) 319")
DLM6 = _method("dlm6", 6, kick_free_kick(KAHAN_LI6), "composed after Kahan & Li, Math. Comp. 66 (1997) 1089")
