"""Dormand and Prince's explicit Runge-Kutta method of order 8, the usual general-purpose solver."""

from __future__ import annotations

from typing import Any

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.explicit_runge_kutta import (
    Carried,
    Slopes,
    StepConstants,
    Turn,
    booked,
    end,
    first,
    increment,
    moved,
    stage,
    step_constants,
    total,
)
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method, SparseTableau, of_stages
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, add_scaled, norm

# Rows without their zeros; where they are used, the code says to which slopes the weights belong.
NODES = (
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
_WEIGHTED_NODES = (NODES[0], *NODES[5:])
# Weights of the two error estimates, of orders 5 and 3.
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


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance (q, omega, v, x), impulses and work by DOP853 and normalise q (Hairer, Norsett & Wanner I, section II.5).

    Order 8, under any load too; has no invariants beyond its accuracy.

    Raises:
        ConvergenceError: the step rotates the body so far that the result is not a rotation, or diverges.
    """
    f = step_constants(inertia, held, h, velocity, orientation, angular_velocity)
    return end("dop853", f, _WEIGHTED_NODES, _WEIGHTS, _weighted(f, load), load)


def pair(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> tuple[Increment, Increment]:
    """Return the step, and a second result: they differ by the estimated error, which scales like that of order 7.

    The estimate combines those of orders 5 and 3, e5 |e5| / sqrt(|e5|^2 + |e3|^2 / 100) (HNW I, eq. II.10.17), for
    each of q, omega, impulse and displacement.

    Raises:
        ConvergenceError: as for `step`.
    """
    f = step_constants(inertia, held, h, velocity, orientation, angular_velocity)
    slopes = _weighted(f, load)
    turns = total(h, _WEIGHTS, slopes), total(h, _FIFTH, slopes), total(h, _THIRD, slopes)
    carried = (
        moved(f, _WEIGHTED_NODES, _WEIGHTS, slopes, load),
        moved(f, _WEIGHTED_NODES, _FIFTH, slopes, load),
        moved(f, _WEIGHTED_NODES, _THIRD, slopes, load),
    )
    return compared(f, turns, carried, booked(h, _WEIGHTS, slopes), load)


def compared(
    f: StepConstants,
    turns: tuple[Turn, Turn, Turn],
    moves: tuple[Carried, Carried, Carried],
    books: tuple[Vector, float],
    load: Any,
) -> tuple[Increment, Increment]:
    """Return the results of `pair` from the sums of the slopes with the weights of order 8, 5 and 3.

    Raises:
        ConvergenceError: as for `step`.
    """
    (turn, fifth, third), (carried, by_fifth, by_third) = turns, moves
    s = _share(_size(fifth[0]), _size(third[0]))
    (x, y, z, w), (a, b, c, d) = turn[0], fifth[0]
    other = ((x - s * a, y - s * b, z - s * c, w - s * d), _off(turn[1], fifth[1], third[1]))
    off = (_off(carried[0], by_fifth[0], by_third[0]), _off(carried[1], by_fifth[1], by_third[1]))
    return (
        increment("dop853", f, turn, carried, books, load),
        increment("dop853", f, other, off, books, load),
    )


def _off(end: Vector, fifth: Vector, third: Vector) -> Vector:
    return add_scaled(end, -_share(norm(fifth), norm(third)), fifth)


def _size(q: Quaternion) -> float:
    return norm((norm((q[0], q[1], q[2])), q[3], 0.0))


def _share(fifth: float, third: float) -> float:
    whole = norm((fifth, 0.1 * third, 0.0))
    return fifth / whole if whole > 0.0 else 0.0


def _weighted(f: StepConstants, load: Load | None) -> Slopes:
    """Return the slopes of the stages with non-zero weights: all but the second to the fifth."""
    k1 = first(f, load)
    k2 = stage(f, NODES[1], _ROW_2, (k1,), load)
    k3 = stage(f, NODES[2], _ROW_3, (k1, k2), load)
    k4 = stage(f, NODES[3], _ROW_4, (k1, k3), load)
    k5 = stage(f, NODES[4], _ROW_5, (k1, k3, k4), load)
    k6 = stage(f, NODES[5], _ROW_6, (k1, k4, k5), load)
    k7 = stage(f, NODES[6], _ROW_7, (k1, k4, k5, k6), load)
    k8 = stage(f, NODES[7], _ROW_8, (k1, k4, k5, k6, k7), load)
    k9 = stage(f, NODES[8], _ROW_9, (k1, k4, k5, k6, k7, k8), load)
    k10 = stage(f, NODES[9], _ROW_10, (k1, k4, k5, k6, k7, k8, k9), load)
    k11 = stage(f, NODES[10], _ROW_11, (k1, k4, k5, k6, k7, k8, k9, k10), load)
    k12 = stage(f, NODES[11], _ROW_12, (k1, k4, k5, k6, k7, k8, k9, k10, k11), load)
    return (k1, k6, k7, k8, k9, k10, k11, k12)


_WEIGHTED = (0, *range(5, 12))
_TABLEAU = SparseTableau(
    NODES,
    (
        (),
        of_stages(_ROW_2, 0),
        of_stages(_ROW_3, 0, 1),
        of_stages(_ROW_4, 0, 2),
        of_stages(_ROW_5, 0, 2, 3),
        *(
            of_stages(row, 0, *range(3, k))
            for k, row in enumerate((_ROW_6, _ROW_7, _ROW_8, _ROW_9, _ROW_10, _ROW_11, _ROW_12), start=5)
        ),
    ),
    of_stages(_WEIGHTS, *_WEIGHTED),
    (of_stages(_FIFTH, *_WEIGHTED), of_stages(_THIRD, *_WEIGHTED)),
    compared,
)

DOP853 = Method(
    "dop853",
    order=8,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    takes=LoadDependence.STATES,
    pair=pair,
    compiles=True,
    tableau=_TABLEAU,
    takes_arrays=True,
)
