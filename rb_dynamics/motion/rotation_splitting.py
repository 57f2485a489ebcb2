"""Splitting of the free body into rotations about its principal axes, after Dullweber, Leimkuhler and McLachlan.

Explicit, cheap, and conserves angular momentum. Each partial flow is a uniform rotation about one axis. Half kicks by
the wrench come before and after, as in `splitting.py`.
"""

from __future__ import annotations

from collections.abc import Callable

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.composition import KAHAN_LI6, SUZUKI4
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method, Step
from rb_dynamics.motion.splitting import Stages, StepStart, Way, advance, arrived, begin, kick_and_free, kick_free_kick
from rb_dynamics.numerics.rotation import Quaternion, multiply
from rb_dynamics.numerics.sincos import sincos
from rb_dynamics.numerics.vector import Vector, divide, norm, scale
from rb_dynamics.numerics.vector import multiply as times


def flow(moments: Vector, orientation: Quaternion, angular_velocity: Vector, t: float) -> tuple[Quaternion, Vector]:
    """Return attitude and angular velocity after t s of free motion, of order 2; exact if two moments are equal.

    With b the axis of the middle moment, T = L^2/(2 I_b) + m_a^2 (1/I_a - 1/I_b)/2 + m_c^2 (1/I_c - 1/I_b)/2. The
    first term turns the body about L and commutes with the others, each of which turns it about its own axis.
    """
    m = times(moments, angular_velocity)
    # Sorted by three exchanges, which are reversed below.
    one, two, three = (moments[0], m[0]), (moments[1], m[1]), (moments[2], m[2])
    first = one[0] > two[0]
    one, two = (two, one) if first else (one, two)
    second = two[0] > three[0]
    two, three = (three, two) if second else (two, three)
    third = one[0] > two[0]
    one, two = (two, one) if third else (one, two)
    (low, m_a), (middle, m_b), (high, m_c) = one, two, three
    x, y, z, w = multiply(orientation, _exp(scale(t, (m[0] / middle, m[1] / middle, m[2] / middle))))
    x, y = (y, x) if first else (x, y)
    y, z = (z, y) if second else (y, z)
    x, y = (y, x) if third else (x, y)
    # 1 if (a, b, c) is right-handed: after an even number of exchanges.
    parity = 1.0 if (first != second) == third else -1.0
    # Ratios first: the inverse of a small moment may overflow although the rate does not.
    half_a, whole_c = 0.5 * t * ((middle - low) / middle), t * ((middle - high) / middle)
    x, y, z, w, m_b, m_c = _turn(x, y, z, w, m_b, m_c, half_a * (m_a / low), parity)
    z, x, y, w, m_a, m_b = _turn(z, x, y, w, m_a, m_b, whole_c * (m_c / high), parity)
    x, y, z, w, m_b, m_c = _turn(x, y, z, w, m_b, m_c, half_a * (m_a / low), parity)
    x, y, m_a, m_b = (y, x, m_b, m_a) if third else (x, y, m_a, m_b)
    y, z, m_b, m_c = (z, y, m_c, m_b) if second else (y, z, m_b, m_c)
    x, y, m_a, m_b = (y, x, m_b, m_a) if first else (x, y, m_a, m_b)
    return (x, y, z, w), divide((m_a, m_b, m_c), moments)


def _exp(v: Vector) -> Quaternion:
    """As `rotation.exp`, without calling the C library."""
    angle = norm(v)
    sine, cosine = sincos(0.5 * angle)
    s = sine / angle if angle > 0.0 else 0.5
    return (s * v[0], s * v[1], s * v[2], cosine)


def _turn(
    q_a: float, q_b: float, q_c: float, q_w: float, m_b: float, m_c: float, angle: float, parity: float
) -> tuple[float, float, float, float, float, float]:
    """Rotate the body by `angle` about axis a: q <- q r, and the vector m, fixed in the world, by r^-1.

    `parity` is 1 if (a, b, c) is right-handed, else -1.
    """
    s, c = sincos(0.5 * angle)
    p = parity * s
    # cos(angle) - 1 from the half angle, to avoid cancellation.
    sine, versine = 2.0 * p * c, 2.0 * s * s
    return (
        c * q_a + s * q_w,
        c * q_b + p * q_c,
        c * q_c - p * q_b,
        c * q_w - s * q_a,
        m_b + (sine * m_c - versine * m_b),
        m_c - (sine * m_b + versine * m_c),
    )


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
    return Method(
        name, order, frozenset({"angular_momentum", "unit_quaternion"}), step, takes=LoadDependence.FIELD, compiles=True
    )


_STAGES = {"dlm2": kick_free_kick((1.0,)), "dlm4": kick_free_kick(SUZUKI4), "dlm6": kick_free_kick(KAHAN_LI6)}

DLM2 = _method("dlm2", 2, _STAGES["dlm2"], "one symmetric step")
DLM4 = _method("dlm4", 4, _STAGES["dlm4"], "composed after Suzuki, Phys. Lett. A 146 (1990) 319")
DLM6 = _method("dlm6", 6, _STAGES["dlm6"], "composed after Kahan & Li, Math. Comp. 66 (1997) 1089")


_Run = Callable[[StepStart, float, Way], Way]


def _lane_step(name: str) -> Step:
    run: _Run = _nothing
    for stage in _STAGES[name]:
        run = _then(run, name, stage)

    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        start, way = begin(inertia, held, velocity, orientation, angular_velocity)
        return arrived(name, start, h, run(start, h, way), load)

    step.__doc__ = (
        f"Do what the step of `{name}` does, its stages written out for many bodies at once (`batch_kernel.py`)."
    )
    return step


def _nothing(_start: StepStart, _h: float, way: Way) -> Way:
    return way


def _then(before: _Run, name: str, stage: tuple[float, float]) -> _Run:
    def run(start: StepStart, h: float, way: Way) -> Way:
        return kick_and_free(name, flow, stage, start, h, before(start, h, way), None)

    return run


LANE_STEPS = {name: _lane_step(name) for name in _STAGES}
"""The same steps under a held wrench, without a loop, for many bodies at once."""
