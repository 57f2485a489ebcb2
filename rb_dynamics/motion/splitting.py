"""Splitting into kick and free motion: the wrench changes the momenta only, in between the body moves freely and exactly.

All of the error comes from the wrench: none without torque and, with the near-integrable schemes, one proportional to a
small torque even at large steps. Energy and angular momentum change in the kicks only, by exactly what is booked.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import exact
from rb_dynamics.motion.composition import KAHAN_LI6, SUZUKI4
from rb_dynamics.motion.free import FreeRotation
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.rotation import Quaternion, multiply, normalize, rotate, rotate_inverse
from rb_dynamics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale

# flow(moments, orientation, angular velocity, t): orientation and angular velocity after t s of free rotation.
Flow = Callable[[Vector, Quaternion, Vector, float], tuple[Quaternion, Vector]]

# (kick, free), in units of the step: first the kick, then the free motion.
Stages = tuple[tuple[float, float], ...]


def kick_free_kick(coefficients: tuple[float, ...]) -> Stages:
    """Return the composition of Strang's splitting, half a kick, free motion, half a kick; halves that meet are one."""
    stages, before = [], 0.0
    for coefficient in coefficients:
        stages.append((0.5 * (before + coefficient), coefficient))
        before = coefficient
    return (*stages, (0.5 * before, 0.0))


def free_kick_free(free: tuple[float, ...], kicks: tuple[float, ...]) -> Stages:
    """Return the scheme free[0], kicks[0], free[1], ..., free[-1]."""
    return ((0.0, free[0]), *zip(kicks, free[1:], strict=True))


def advance(
    flow: Flow,
    stages: Stages,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> Increment:
    """Advance by kicks I w += t (tau_body + R^T tau_world), p += t F, and by free motion with `flow`.

    A kick does the work (mean of w) . impulse of torque + (mean of v) . impulse of force: what T grows by.

    Raises:
        ConvergenceError: the wrench is so large that the angular velocity overflows.
    """
    mass, moments = inertia
    q, omega = orientation, angular_velocity
    moment, impulse, torque_impulse, work = ZERO, ZERO, ZERO, 0.0
    for kick, free in stages:
        t = kick * h
        if t != 0.0:
            push = scale(t, add(rotate(q, held.force_body), held.force_world))
            twist = scale(t, add(held.torque_body, rotate_inverse(q, held.torque_world)))
            gain = divide(twist, moments)
            work += dot(add_scaled(velocity, 1.0 / mass, add_scaled(impulse, 0.5, push)), push)
            work += dot(add_scaled(omega, 0.5, gain), twist)
            omega = add(omega, gain)
            impulse = add(impulse, push)
            torque_impulse = add_scaled(torque_impulse, t, add(rotate(q, held.torque_body), held.torque_world))
        t = free * h
        if t != 0.0:
            if not norm(omega) < math.inf:
                raise ConvergenceError(
                    f"splitting: a step of {h:g} s with a torque of {norm(held.torque_body):.3g} N m in body and "
                    f"{norm(held.torque_world):.3g} N m in world axes overflows the angular velocity; use a shorter step"
                )
            moment = add_scaled(moment, t, impulse)
            q, omega = flow(moments, q, omega, t)
    return Increment(
        add_scaled(scale(h, velocity), 1.0 / mass, moment), normalize(q), omega, impulse, torque_impulse, work
    )


def _exact_flow(moments: Vector, orientation: Quaternion, angular_velocity: Vector, t: float) -> tuple[Quaternion, Vector]:
    turn, omega = FreeRotation(moments, angular_velocity).at(t)
    return multiply(orientation, turn), omega


def _method(name: str, order: int, stages: Stages, scheme: str) -> Method:
    def step(
        inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> Increment:
        if exact.is_free(held):
            return exact.step(inertia, held, h, velocity, orientation, angular_velocity)
        return advance(_exact_flow, stages, inertia, held, h, velocity, orientation, angular_velocity)

    step.__doc__ = f"""Advance by kicks and exact free motion: {scheme}.

    Order {order}, symmetric; splittings: HLW II.5. Exact where no torque and no force in body axes acts. Energy and
    world-frame angular momentum change by the booked work and torque impulse, to round-off.

    Raises:
        ConvergenceError: the wrench is so large that the angular velocity overflows.
    """
    return Method(name, order, exact.EXACT.invariants, step)


_GAUSS = (math.sqrt(525.0 - 70.0 * math.sqrt(30.0)) / 70.0, math.sqrt(525.0 + 70.0 * math.sqrt(30.0)) / 70.0)
_GAUSS_WEIGHTS = ((18.0 + math.sqrt(30.0)) / 72.0, (18.0 - math.sqrt(30.0)) / 72.0)


def _mirrored(half: tuple[float, ...], middle: tuple[float, ...] = ()) -> tuple[float, ...]:
    return (*half, *middle, *half[::-1])


ABA82_STAGES = free_kick_free(
    _mirrored((0.5 - _GAUSS[1], _GAUSS[1] - _GAUSS[0]), (2.0 * _GAUSS[0],)), _mirrored(_GAUSS_WEIGHTS[::-1])
)

_ABA84_FREE = (0.075346960269892888416527803683474464, 0.517916854688256782300773978496315644)
_ABA84_KICKS = (0.190225939373676619245230762738453897, 0.846524070443526257055080544646775834)
ABA84_STAGES = free_kick_free(
    _mirrored((*_ABA84_FREE, 0.5 - sum(_ABA84_FREE))), _mirrored(_ABA84_KICKS, (1.0 - 2.0 * sum(_ABA84_KICKS),))
)

_ABA104_FREE = (
    0.04706710064597250612947887637243678556564,
    0.1847569354170881069247376193702560968574,
    0.2827060056798362053243616565541452479160,
)
_ABA104_KICKS = (
    0.1188819173681970199453503950853885936957,
    0.2410504605515015657441667865901651105675,
    -0.2732866667053238060543113981664559460630,
)
ABA104_STAGES = free_kick_free(
    _mirrored((*_ABA104_FREE, 0.5 - sum(_ABA104_FREE))), _mirrored(_ABA104_KICKS, (1.0 - 2.0 * sum(_ABA104_KICKS),))
)

_ABA864_FREE = (
    0.0711334264982231177779387300061549964174,
    0.241153427956640098736487795326289649618,
    0.521411761772814789212136078067994229991,
)
_ABA864_KICKS = (
    0.183083687472197221961703757166430291072,
    0.310782859898574869507522291054262796375,
    -0.0265646185119588006972121379164987592663,
)
ABA864_STAGES = free_kick_free(
    _mirrored((*_ABA864_FREE, 0.5 - sum(_ABA864_FREE))), _mirrored(_ABA864_KICKS, (1.0 - 2.0 * sum(_ABA864_KICKS),))
)

_BLANES = "Blanes, Casas, Farres, Laskar, Makazaga & Murua, Appl. Numer. Math. 68 (2013) 58"

STRANG2 = _method("strang2", 2, kick_free_kick((1.0,)), "Strang, SIAM J. Numer. Anal. 5 (1968) 506")
STRANG4 = _method(
    "strang4", 4, kick_free_kick(SUZUKI4), "Strang's splitting composed after Suzuki, Phys. Lett. A 146 (1990) 319"
)
STRANG6 = _method(
    "strang6", 6, kick_free_kick(KAHAN_LI6), "Strang's splitting composed after Kahan & Li, Math. Comp. 66 (1997) 1089"
)
ABA82 = _method(
    "aba82",
    2,
    ABA82_STAGES,
    "for a torque of size eps the error is O(eps h^8 + eps^2 h^2); SABA4 of Laskar & Robutel, Celest. Mech. Dyn. "
    "Astron. 80 (2001) 39: Gauss's nodes and weights",
)
ABA84 = _method(
    "aba84",
    4,
    ABA84_STAGES,
    "for a torque of size eps the error is O(eps h^8 + eps^2 h^4); McLachlan, BIT 35 (1995) 258; " + _BLANES,
)
ABA104 = _method(
    "aba104", 4, ABA104_STAGES, "for a torque of size eps the error is O(eps h^10 + eps^2 h^4); " + _BLANES
)
ABA864 = _method(
    "aba864",
    4,
    ABA864_STAGES,
    "for a torque of size eps the error is O(eps h^8 + eps^2 h^6 + eps^3 h^4); " + _BLANES,
)
