"""The explicit Runge-Kutta method of order 8 of Dormand and Prince: the general solver that most people reach for."""

from __future__ import annotations

from typing import NamedTuple

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import no_rotation, require_finite
from rb_dynamics.motion.rk4 import turned
from rb_dynamics.rotation import Quaternion, normalize, rotate, rotate_inverse
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, add, add_scaled, cross, dot, multiply, norm, scale, subtract

# The rows without their zeros: of which slopes the weights are is written where they are used.
_NODES = (
    0.0,
    0.05260015195876773,
    0.0789002279381516,
    0.1183503419072274,
    0.2816496580927726,
    0.3333333333333333,
    0.25,
    0.3076923076923077,
    0.6512820512820513,
    0.6,
    0.8571428571428571,
    1.0,
)
_ROW_2 = (0.05260015195876773,)
_ROW_3 = (0.0197250569845379, 0.0591751709536137)
_ROW_4 = (0.02958758547680685, 0.08876275643042054)
_ROW_5 = (0.2413651341592667, -0.8845494793282861, 0.924834003261792)
_ROW_6 = (0.037037037037037035, 0.17082860872947386, 0.12546768756682242)
_ROW_7 = (0.037109375, 0.17025221101954405, 0.06021653898045596, -0.017578125)
_ROW_8 = (0.03709200011850479, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402, 0.008273789163814023)
_ROW_9 = (
    0.6241109587160757,
    -3.3608926294469414,
    -0.868219346841726,
    27.59209969944671,
    20.154067550477894,
    -43.48988418106996,
)
_ROW_10 = (
    0.47766253643826434,
    -2.4881146199716677,
    -0.590290826836843,
    21.230051448181193,
    15.279233632882423,
    -33.28821096898486,
    -0.020331201708508627,
)
_ROW_11 = (
    -0.9371424300859873,
    5.186372428844064,
    1.0914373489967295,
    -8.149787010746927,
    -18.52006565999696,
    22.739487099350505,
    2.4936055526796523,
    -3.0467644718982196,
)
_ROW_12 = (
    2.273310147516538,
    -10.53449546673725,
    -2.0008720582248625,
    -17.9589318631188,
    27.94888452941996,
    -2.8589982771350235,
    -8.87285693353063,
    12.360567175794303,
    0.6433927460157636,
)
_WEIGHTS = (
    0.054293734116568765,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
)
# Those of the two error estimates, of orders 5 and 3.
_FIFTH = (
    0.01312004499419488,
    -1.2251564463762044,
    -0.4957589496572502,
    1.6643771824549864,
    -0.35032884874997366,
    0.3341791187130175,
    0.08192320648511571,
    -0.022355307863886294,
)
_THIRD = (
    -0.18980075407240762,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    -0.4226823213237919,
    -0.1521609496625161,
    0.20136540080403034,
    0.02265179219836082,
)


# What a step has added to q, omega, impulse and displacement, or the slopes of these: in the axes of R0, for an
# observer who moves with the velocity at the start, less what is uniform.
_State = tuple[Quaternion, Vector, Vector, Vector]

# The slopes at a stage: of the state, of the torque impulse and of the work.
_Slope = tuple[_State, Vector, float]
_Slopes = tuple[_Slope, ...]

_START: _State = ((0.0, 0.0, 0.0, 0.0), ZERO, ZERO, ZERO)


class _Frame(NamedTuple):
    """What the stages of a step share; force and torque are those of the world in the axes of R0."""

    moments: Vector
    inverse: Vector
    inverse_mass: float
    held: HeldWrench
    h: float
    velocity: Vector
    orientation: Quaternion
    angular_velocity: Vector
    force: Vector
    torque: Vector


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance (q, omega, v, x) and the books by DOP853 and normalise q (Hairer, Norsett & Wanner I, section II.5).

    The equations are those of `rk4`, with q from the axes of R0 and v and x for an observer who moves with `velocity`:
    small numbers, to which rounding does little. Order 8, under any load too; keeps no invariant but what its accuracy
    keeps.

    Raises:
        ConvergenceError: the step turns the body so far that the end is no rotation any more, or diverges.
    """
    frame = _frame(inertia, held, h, velocity, orientation, angular_velocity)
    slopes = _weighted(frame, load)
    return _end(frame, _total(h, _WEIGHTS, slopes), slopes)


def pair(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> tuple[Increment, Increment]:
    """Return the step and a comparison that is off by the estimate of its error, which falls as that of order 7.

    The estimate combines those of orders 5 and 3, e5 |e5| / sqrt(|e5|^2 + |e3|^2 / 100) (HNW I, eq. II.10.17), for
    each of q, omega, impulse and displacement.

    Raises:
        ConvergenceError: as for `step`.
    """
    frame = _frame(inertia, held, h, velocity, orientation, angular_velocity)
    slopes = _weighted(frame, load)
    end, fifth, third = _total(h, _WEIGHTS, slopes), _total(h, _FIFTH, slopes), _total(h, _THIRD, slopes)
    s = _share(_size(fifth[0]), _size(third[0]))
    (x, y, z, w), (a, b, c, d) = end[0], fifth[0]
    comparison = (
        (x - s * a, y - s * b, z - s * c, w - s * d),
        _off(end[1], fifth[1], third[1]),
        _off(end[2], fifth[2], third[2]),
        _off(end[3], fifth[3], third[3]),
    )
    return _end(frame, end, slopes), _end(frame, comparison, slopes)


def _off(end: Vector, fifth: Vector, third: Vector) -> Vector:
    return add_scaled(end, -_share(norm(fifth), norm(third)), fifth)


def _size(q: Quaternion) -> float:
    return norm((norm((q[0], q[1], q[2])), q[3], 0.0))


def _share(fifth: float, third: float) -> float:
    whole = norm((fifth, 0.1 * third, 0.0))
    return fifth / whole if whole > 0.0 else 0.0


def _frame(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> _Frame:
    a, b, c = inertia.moments
    return _Frame(
        inertia.moments,
        (1.0 / a, 1.0 / b, 1.0 / c),
        1.0 / inertia.mass,
        held,
        h,
        velocity,
        orientation,
        angular_velocity,
        rotate_inverse(orientation, held.force_world),
        rotate_inverse(orientation, held.torque_world),
    )


def _weighted(f: _Frame, load: Load | None) -> _Slopes:
    """Return the slopes of the stages that have a weight: all but the second to the fifth."""
    h = f.h
    k1 = _slope(f, _NODES[0], _START, load)
    k2 = _slope(f, _NODES[1], _total(h, _ROW_2, (k1,)), load)
    k3 = _slope(f, _NODES[2], _total(h, _ROW_3, (k1, k2)), load)
    k4 = _slope(f, _NODES[3], _total(h, _ROW_4, (k1, k3)), load)
    k5 = _slope(f, _NODES[4], _total(h, _ROW_5, (k1, k3, k4)), load)
    k6 = _slope(f, _NODES[5], _total(h, _ROW_6, (k1, k4, k5)), load)
    k7 = _slope(f, _NODES[6], _total(h, _ROW_7, (k1, k4, k5, k6)), load)
    k8 = _slope(f, _NODES[7], _total(h, _ROW_8, (k1, k4, k5, k6, k7)), load)
    k9 = _slope(f, _NODES[8], _total(h, _ROW_9, (k1, k4, k5, k6, k7, k8)), load)
    k10 = _slope(f, _NODES[9], _total(h, _ROW_10, (k1, k4, k5, k6, k7, k8, k9)), load)
    k11 = _slope(f, _NODES[10], _total(h, _ROW_11, (k1, k4, k5, k6, k7, k8, k9, k10)), load)
    k12 = _slope(f, _NODES[11], _total(h, _ROW_12, (k1, k4, k5, k6, k7, k8, k9, k10, k11)), load)
    return (k1, k6, k7, k8, k9, k10, k11, k12)


def _total(h: float, row: tuple[float, ...], slopes: _Slopes) -> _State:
    """Return h times the sum of the slopes of the state with the weights of `row`."""
    a = b = c = d = e = f = g = i = j = k = m = n = o = 0.0
    for stage, s in enumerate(row):
        (a1, b1, c1, d1), (e1, f1, g1), (i1, j1, k1), (m1, n1, o1) = slopes[stage][0]
        a, b, c, d = a + s * a1, b + s * b1, c + s * c1, d + s * d1
        e, f, g = e + s * e1, f + s * f1, g + s * g1
        i, j, k = i + s * i1, j + s * j1, k + s * k1
        m, n, o = m + s * m1, n + s * n1, o + s * o1
    return (h * a, h * b, h * c, h * d), (h * e, h * f, h * g), (h * i, h * j, h * k), (h * m, h * n, h * o)


def _slope(frame: _Frame, node: float, reached: _State, load: Load | None) -> _Slope:
    """Return the slopes of a stage, without the constant parts."""
    moments, axes, ahead = frame.moments, frame.orientation, node * frame.h
    (x, y, z, w), spin_up, pushed, moved = reached
    q, omega = (x, y, z, 1.0 + w), add(frame.angular_velocity, spin_up)
    gain = scale(frame.inverse_mass, add_scaled(pushed, ahead, frame.force))
    # One division is cheaper than a norm.
    twice = 2.0 / (x * x + y * y + z * z + q[3] * q[3])
    push, torque = turned(q, twice, frame.held.force_body), frame.held.torque_body
    if load is not None:
        turn = normalize(q)
        place = add_scaled(rotate(axes, moved), ahead, frame.velocity)
        v = add(frame.velocity, rotate(axes, gain))
        force, more = load(ahead, place, v, compose(axes, turn), omega)
        push, torque = add(push, rotate_inverse(axes, force)), add(torque, more)
    all_torque = torque
    if frame.held.torque_world != ZERO:
        all_torque = add(torque, turned((-x, -y, -z, q[3]), twice, frame.torque))
    omega_dot = multiply(subtract(all_torque, cross(omega, multiply(moments, omega))), frame.inverse)
    half = (0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2], 0.0)
    power = dot(add(push, frame.force), gain) + dot(all_torque, omega)
    return (compose(q, half), omega_dot, push, gain), turned(q, twice, torque), power


def _end(frame: _Frame, total: _State, slopes: _Slopes) -> Increment:
    """Return the increment with this end, and with the books by `slopes`.

    Raises:
        ConvergenceError: the end is no rotation, or not finite.
    """
    h, orientation = frame.h, frame.orientation
    (x, y, z, w), spin_up, pushed, moved = total
    w += 1.0
    square = x * x + y * y + z * z + w * w
    if not 0.5 < square < 2.0:
        return no_rotation("dop853", h, square, norm(frame.angular_velocity))
    twisted, work = ZERO, 0.0
    for stage, weight in enumerate(_WEIGHTS):
        _, twist, power = slopes[stage]
        twisted, work = add_scaled(twisted, weight * h, twist), work + weight * h * power
    impulse = add_scaled(rotate(orientation, pushed), h, frame.held.force_world)
    end = Increment(
        add_scaled(rotate(orientation, moved), h, frame.velocity),
        normalize(compose(orientation, normalize((x, y, z, w)))),
        add(frame.angular_velocity, spin_up),
        impulse,
        add_scaled(rotate(orientation, twisted), h, frame.held.torque_world),
        dot(frame.velocity, impulse) + work,
    )
    return require_finite("dop853", h, end)


DOP853 = Method(
    "dop853",
    order=8,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    takes=Takes.ANY,
    pair=pair,
    compiles=True,
)
