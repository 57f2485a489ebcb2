"""Splitting into kicks and free motion: the wrench changes only the momenta; between kicks the body moves exactly.

The whole error comes from the wrench. There is none without torque and, with the stages for near-integrable systems,
one proportional to a small torque even at large steps. Energy and angular momentum change only in the kicks, by exactly
the accumulated work and impulse. A load also acts in the kicks; the method is symplectic if the load has a potential.
It must not be used for a load that depends on the velocities, because these change in a kick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import closed_form
from rb_dynamics.motion.composition import KAHAN_LI6
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import NO_INCREMENT, NOWHERE, require_finite
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale

# flow(moments, orientation, angular velocity, t): orientation and angular velocity after t s of free rotation.
Flow = Callable[[Vector, Quaternion, Vector, float], tuple[Quaternion, Vector]]

# (kick, free), in units of the step: the kick comes first.
Stages = tuple[tuple[float, float], ...]


# A larger rotation (rad) between two kicks does not resolve the wrench.
_LARGEST_TURN_BETWEEN_KICKS = 3.0

# In units of 2^-27, the fraction of an attitude component is practically random.
_DIGITS = 2.0**27
# Numbers of this size have no digits after the point: adding and subtracting it rounds.
_WHOLE = 1.5 * 2.0**52
# Twice the amplitude of the dither, in units of the distance to the next number; less than 1, so that dither alone
# changes nothing.
_DITHER = 1.0 - 2.0**-10
# Relative decrement that gives the number below (Rump, Zimmermann, Boldo & Melquiond, BIT 49 (2009) 419).
_BELOW = 2.0**-53 * (1.0 + 2.0**-52)

# Without kicks, only the rounding of the angle is a limit: 1e-7 rad.
_LARGEST_TURN_WITHOUT_KICKS = 1e9


def kick_free_kick(coefficients: tuple[float, ...]) -> Stages:
    """Return Strang's splitting composed: half a kick, free motion, half a kick; adjacent half kicks are merged."""
    stages, before = [], 0.0
    for coefficient in coefficients:
        stages.append((0.5 * (before + coefficient), coefficient))
        before = coefficient
    return (*stages, (0.5 * before, 0.0))


def free_kick_free(free: tuple[float, ...], kicks: tuple[float, ...]) -> Stages:
    """Return the scheme free[0], kicks[0], free[1], ..., free[-1]."""
    return ((0.0, free[0]), *zip(kicks, free[1:], strict=True))


class StepStart(NamedTuple):
    """Start of a step; `*_0` in the axes of R0, in which everything is computed."""

    inertia: Inertia
    held: HeldWrench
    velocity: Vector
    orientation: Quaternion
    velocity_0: Vector
    force_0: Vector
    torque_0: Vector


class Way(NamedTuple):
    """State within a step; vectors in the axes of R0.

    Only what rotates with the body is summed: the force in world axes acts as if it were constant, because the kicks
    add up to 1 and are symmetric.

    Attributes:
        turn: R0^T R.
        omega: angular velocity, axes of R.
        pushed: impulse of the kicks so far.
        moved: mass times the sum of the displacements by the kicks, kg m.
        twisted: torque impulse of the kicks so far.
        kicked: total length of the kicks, s.
        work: of the kicks so far, J.
        elapsed: total length of the free motions, s.
        moment: displacement by the force in world axes, per acceleration, s^2.
    """

    turn: Quaternion
    omega: Vector
    pushed: Vector
    moved: Vector
    twisted: Vector
    kicked: float
    work: float
    elapsed: float
    moment: float


def advance(
    name: str,
    flow: Flow,
    stages: Stages,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by kicks I w += t (tau_body + R^T tau_world), p += t F, and by free motion with `flow`.

    A kick does the work (mean of w) . torque impulse + (mean of v) . impulse, by which T grows. The load is evaluated
    at the time, position and attitude of a kick, which the kick does not change. It must not use the velocities that it
    gets: they are those before the kick.

    Raises:
        ConvergenceError: the body rotates so far between two kicks that they do not resolve the wrench, or the load
            gives numbers that are not finite.
    """
    start, way = begin(inertia, held, velocity, orientation, angular_velocity)
    for stage in stages:
        way = kick_and_free(name, flow, stage, start, h, way, load)
    return arrived(name, start, h, way, load)


def begin(
    inertia: Inertia, held: HeldWrench, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> tuple[StepStart, Way]:
    """Return the start of a step, and the state before its first stage."""
    start = StepStart(
        inertia,
        held,
        velocity,
        orientation,
        rotate_inverse(orientation, velocity),
        rotate_inverse(orientation, held.force_world),
        rotate_inverse(orientation, held.torque_world),
    )
    return start, Way(IDENTITY, angular_velocity, ZERO, ZERO, ZERO, 0.0, 0.0, 0.0, 0.0)


def kick_and_free(
    name: str, flow: Flow, stage: tuple[float, float], start: StepStart, h: float, way: Way, load: Load | None
) -> Way:
    """Return the state after the kick and the free motion of one stage; see `advance`."""
    (mass, moments), held, velocity, orientation, velocity_0, force_0, torque_0 = start
    turn, omega, pushed, moved, twisted, kicked, work, elapsed, moment = way
    kick, free = stage
    if kick != 0.0:
        t = kick * h
        push, twist = scale(t, rotate(turn, held.force_body)), scale(t, held.torque_body)
        if load is not None:
            gained = add_scaled(rotate(orientation, pushed), kicked, held.force_world)
            gone = add_scaled(rotate(orientation, moved), moment, held.force_world)
            force, torque = evaluated(
                load,
                elapsed,
                add_scaled(scale(elapsed, velocity), 1.0 / mass, gone),
                add_scaled(velocity, 1.0 / mass, gained),
                renormalize(multiply(orientation, turn)),
                omega,
            )
            push = add_scaled(push, t, rotate_inverse(orientation, force))
            twist = add_scaled(twist, t, torque)
        twist_all = add_scaled(twist, t, rotate_inverse(turn, torque_0))
        gain = divide(twist_all, moments)
        before = add_scaled(add_scaled(pushed, 0.5, push), kicked + 0.5 * t, force_0)
        work += dot(add_scaled(velocity_0, 1.0 / mass, before), add_scaled(push, t, force_0))
        work += dot(add_scaled(omega, 0.5, gain), twist_all)
        omega = _kicked(omega, gain, orientation, turn)
        pushed, twisted, kicked = add(pushed, push), add(twisted, rotate(turn, twist)), kicked + t
    if free != 0.0:
        t = free * h
        rate = norm(omega)
        if not rate * abs(free) * abs(h) < _LARGEST_TURN_BETWEEN_KICKS:
            omega = _kicks_miss(name, h, abs(free), rate)
        moved, moment, elapsed = add_scaled(moved, t, pushed), moment + t * kicked, elapsed + t
        turn, omega = flow(moments, turn, omega, t)
    return Way(turn, omega, pushed, moved, twisted, kicked, work, elapsed, moment)


def arrived(name: str, start: StepStart, h: float, way: Way, load: Load | None) -> Increment:
    """Return the increment of the step, after its last stage."""
    mass, held, orientation = start.inertia.mass, start.held, start.orientation
    displacement = add_scaled(rotate(orientation, scale(1.0 / mass, way.moved)), 0.5 * h * h / mass, held.force_world)
    step = Increment(
        add_scaled(displacement, h, start.velocity),
        renormalize(multiply(orientation, way.turn)),
        way.omega,
        add_scaled(rotate(orientation, way.pushed), h, held.force_world),
        add_scaled(rotate(orientation, way.twisted), h, held.torque_world),
        way.work,
    )
    return step if load is None else require_finite(name, h, step)


def _kicked(omega: Vector, gain: Vector, orientation: Quaternion, turn: Quaternion) -> Vector:
    """Return omega + gain, rounded without bias.

    Without dither, a constant gain would be rounded the same way in every kick: the error of n kicks would grow like n,
    not like its root. Dither of at most half the distance to the next number removes the bias; it is taken from the
    last digits of the attitude, and does not change a sum that needs no rounding.
    """
    (a, b, c, d), (e, f, g, h) = orientation, turn
    drawn = _DIGITS * ((0.83 * a + 0.59 * b) + (0.71 * c + 0.97 * d) + ((0.67 * e + 0.79 * f) + (0.89 * g + 0.61 * h)))
    return (
        _dithered(omega[0], gain[0], drawn),
        _dithered(omega[1], gain[1], 0.75 * drawn),
        _dithered(omega[2], gain[2], 0.625 * drawn),
    )


def _dithered(rate: float, gain: float, drawn: float) -> float:
    size = abs(rate)
    unit = size - (size - _BELOW * size)
    return rate + (gain + _DITHER * unit * (drawn - ((drawn + _WHOLE) - _WHOLE)))


@compiled_as(NOWHERE)
def _kicks_miss(name: str, h: float, free: float, rate: float) -> Vector:
    raise _turns_too_far(name, h, free, rate, _LARGEST_TURN_BETWEEN_KICKS)


@compiled_as(NO_INCREMENT)
def _no_kicks(name: str, h: float, rate: float) -> Increment:
    raise _turns_too_far(name, h, 1.0, rate, _LARGEST_TURN_WITHOUT_KICKS)


def _turns_too_far(name: str, h: float, free: float, rate: float, largest: float) -> ConvergenceError:
    return ConvergenceError(
        f"{name}: a step of {h:g} s turns the body by {rate * free * abs(h):.3g} rad between two kicks, expected "
        f"less than {largest:g} rad; use a step below {largest / (rate * free):.3g} s"
    )


def _exact_flow(
    moments: Vector, orientation: Quaternion, angular_velocity: Vector, t: float
) -> tuple[Quaternion, Vector]:
    turn, omega = free_rotation(moments, angular_velocity, t)
    return multiply(orientation, turn), omega


def method(
    name: str,
    order: int,
    stages: Stages,
    scheme: str,
    flow: Flow = _exact_flow,
    free_motion: str = "exact free motion",
) -> Method:
    """Return the splitting with these stages and a `flow` between the kicks that conserves energy and angular momentum.

    Args:
        name: of the method.
        order: under any wrench.
        stages: kicks and free motions.
        scheme: name and reference of the stages.
        flow: free motion of the body.
        free_motion: name and reference of the flow.
    """

    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        if load is None and closed_form.is_free(held):
            rate = norm(angular_velocity)
            if not rate * abs(h) < _LARGEST_TURN_WITHOUT_KICKS:
                return _no_kicks(name, h, rate)
            return closed_form.free_step(inertia, held, h, velocity, orientation, angular_velocity)
        return advance(name, flow, stages, inertia, held, h, velocity, orientation, angular_velocity, load)

    step.__doc__ = f"""Advance by kicks and {free_motion}: {scheme}.

    Order {order}, symmetric; splittings: HLW II.5. Exact where no torque and no force in body axes acts. Energy and
    world-frame angular momentum change by the booked work and torque impulse, to round-off. Takes loads that depend on
    time, place and attitude; symplectic if they have a potential (HLW VI.3).

    Raises:
        ConvergenceError: the body turns so far between two kicks that they miss what the wrench does.
    """
    return Method(name, order, closed_form.EXACT.invariants, step, takes=LoadDependence.FIELD, compiles=True)


_GAUSS = (math.sqrt(525.0 - 70.0 * math.sqrt(30.0)) / 70.0, math.sqrt(525.0 + 70.0 * math.sqrt(30.0)) / 70.0)
_GAUSS_WEIGHTS = ((18.0 + math.sqrt(30.0)) / 72.0, (18.0 - math.sqrt(30.0)) / 72.0)


def _mirrored(half: tuple[float, ...], middle: tuple[float, ...] = ()) -> tuple[float, ...]:
    return (*half, *middle, *half[::-1])


ABA82_STAGES = free_kick_free(
    _mirrored((0.5 - _GAUSS[1], _GAUSS[1] - _GAUSS[0]), (2.0 * _GAUSS[0],)), _mirrored(_GAUSS_WEIGHTS[::-1])
)
"""SABA4 of Laskar & Robutel, Celest. Mech. Dyn. Astron. 80 (2001) 39: Gauss's nodes and weights."""

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
    _mirrored((*_ABA104_FREE, 0.5 - math.fsum(_ABA104_FREE))),
    _mirrored(_ABA104_KICKS, (1.0 - 2.0 * math.fsum(_ABA104_KICKS),)),
)
"""Blanes, Casas, Farres, Laskar, Makazaga & Murua, Appl. Numer. Math. 68 (2013) 58."""

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
    _mirrored((*_ABA864_FREE, 0.5 - math.fsum(_ABA864_FREE))),
    _mirrored(_ABA864_KICKS, (1.0 - 2.0 * math.fsum(_ABA864_KICKS),)),
)
"""From the same paper."""

STRANG2 = method("strang2", 2, kick_free_kick((1.0,)), "Strang, SIAM J. Numer. Anal. 5 (1968) 506")
STRANG6 = method(
    "strang6", 6, kick_free_kick(KAHAN_LI6), "Strang's splitting composed after Kahan & Li, Math. Comp. 66 (1997) 1089"
)
