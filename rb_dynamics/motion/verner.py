"""DVERK, Verner's explicit Runge-Kutta pair of orders 6 and 5: efficient at steps of some hundredths of a turn."""

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
from rb_dynamics.numerics.vector import Vector, subtract

# The stage that only the result of order 5 needs, the sixth of Verner's, is the last here.
_NODES = (0.0, 1.0 / 6.0, 4.0 / 15.0, 2.0 / 3.0, 5.0 / 6.0, 1.0 / 15.0, 1.0, 1.0)
_ROW_2 = (1.0 / 6.0,)
_ROW_3 = (4.0 / 75.0, 16.0 / 75.0)
_ROW_4 = (5.0 / 6.0, -8.0 / 3.0, 5.0 / 2.0)
_ROW_5 = (-165.0 / 64.0, 55.0 / 6.0, -425.0 / 64.0, 85.0 / 96.0)
_ROW_6 = (-8263.0 / 15000.0, 124.0 / 75.0, -643.0 / 680.0, -81.0 / 250.0, 2484.0 / 10625.0)
_ROW_7 = (3501.0 / 1720.0, -300.0 / 43.0, 297275.0 / 52632.0, -319.0 / 2322.0, 24068.0 / 84065.0, 3850.0 / 26703.0)
_ROW_8 = (12.0 / 5.0, -8.0, 4015.0 / 612.0, -11.0 / 36.0, 88.0 / 255.0)
# For all slopes but the second, and the last.
_WEIGHTS = (3.0 / 40.0, 875.0 / 2244.0, 23.0 / 72.0, 264.0 / 1955.0, 125.0 / 11592.0, 43.0 / 616.0)
# The same minus the weights of order 5, for all slopes but the second.
_FIFTH = (13.0 / 160.0, 2375.0 / 5984.0, 5.0 / 16.0, 12.0 / 85.0, 0.0, 0.0, 3.0 / 44.0)
_ERRORS = tuple(a - b for a, b in zip((*_WEIGHTS, 0.0), _FIFTH, strict=True))
_WEIGHTED_NODES = (_NODES[0], *_NODES[2:7])


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance (q, omega, v, x), impulses and work by the formula of order 6 and normalise q.

    Verner, SIAM J. Numer. Anal. 15 (1978) 772; Hairer, Norsett & Wanner I, table II.5.4. Order 6, under any load too;
    has no invariants beyond its accuracy.

    Raises:
        ConvergenceError: the step rotates the body so far that the result is not a rotation, or diverges.
    """
    f = step_constants(inertia, held, h, velocity, orientation, angular_velocity)
    k1, _, k3, k4, k5, k6, k7 = _seven(f, load)
    return end("dverk", f, _WEIGHTED_NODES, _WEIGHTS, (k1, k3, k4, k5, k6, k7), load)


def pair(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> tuple[Increment, Increment]:
    """Return the step and the embedded result of order 5.

    Raises:
        ConvergenceError: as for `step`.
    """
    f = step_constants(inertia, held, h, velocity, orientation, angular_velocity)
    k1, k2, k3, k4, k5, k6, k7 = _seven(f, load)
    k8 = stage(f, _NODES[7], _ROW_8, (k1, k2, k3, k4, k5), load)
    weighted, all_slopes = (k1, k3, k4, k5, k6, k7), (k1, k3, k4, k5, k6, k7, k8)
    turns = total(f.h, _WEIGHTS, weighted), total(f.h, _ERRORS, all_slopes)
    moves = (
        moved(f, _WEIGHTED_NODES, _WEIGHTS, weighted, load),
        moved(f, (*_WEIGHTED_NODES, _NODES[7]), _ERRORS, all_slopes, load),
    )
    return compared(f, turns, moves, booked(f.h, _WEIGHTS, weighted), load)


def compared(
    f: StepConstants, turns: tuple[Turn, ...], moves: tuple[Carried, ...], books: tuple[Vector, float], load: Any
) -> tuple[Increment, Increment]:
    """Return the results of `pair` from the sums of the slopes with the weights of order 6, and of the error.

    Raises:
        ConvergenceError: as for `step`.
    """
    ((x, y, z, w), spin_up), ((a, b, c, d), off) = turns[0], turns[1]
    fifth = (x - a, y - b, z - c, w - d), subtract(spin_up, off)
    by_fifth = subtract(moves[0][0], moves[1][0]), subtract(moves[0][1], moves[1][1])
    return (
        increment("dverk", f, turns[0], moves[0], books, load),
        increment("dverk", f, fifth, by_fifth, books, load),
    )


def _seven(f: StepConstants, load: Load | None) -> Slopes:
    """Return the slopes of all stages but the last."""
    k1 = first(f, load)
    k2 = stage(f, _NODES[1], _ROW_2, (k1,), load)
    k3 = stage(f, _NODES[2], _ROW_3, (k1, k2), load)
    k4 = stage(f, _NODES[3], _ROW_4, (k1, k2, k3), load)
    k5 = stage(f, _NODES[4], _ROW_5, (k1, k2, k3, k4), load)
    k6 = stage(f, _NODES[5], _ROW_6, (k1, k2, k3, k4, k5), load)
    return (k1, k2, k3, k4, k5, k6, stage(f, _NODES[6], _ROW_7, (k1, k2, k3, k4, k5, k6), load))


_ROWS = ((), _ROW_2, _ROW_3, _ROW_4, _ROW_5, _ROW_6, _ROW_7, _ROW_8)
_WEIGHTED = (0, *range(2, 8))
_TABLEAU = SparseTableau(
    _NODES,
    tuple(of_stages(row, *range(len(row))) for row in _ROWS),
    of_stages(_WEIGHTS, *_WEIGHTED[:-1]),
    (of_stages(_ERRORS, *_WEIGHTED), ()),
    compared,
)

DVERK = Method(
    "dverk",
    order=6,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    takes=LoadDependence.STATES,
    pair=pair,
    compiles=True,
    takes_arrays=True,
    tableau=_TABLEAU,
)
