"""DVERK, Verner's explicit Runge-Kutta pair of orders 6 and 5: efficient at steps of some hundredths of a turn."""

from __future__ import annotations

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.explicit_runge_kutta import Slopes, StepConstants, end, first, stage, step_constants
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector

# Rows without their zeros; where they are used, the code says to which slopes the weights belong.
_NODES = (0.0, 1.0 / 6.0, 4.0 / 15.0, 2.0 / 3.0, 5.0 / 6.0, 1.0, 1.0 / 15.0, 1.0)
_ROW_2 = (1.0 / 6.0,)
_ROW_3 = (4.0 / 75.0, 16.0 / 75.0)
_ROW_4 = (5.0 / 6.0, -8.0 / 3.0, 5.0 / 2.0)
_ROW_5 = (-165.0 / 64.0, 55.0 / 6.0, -425.0 / 64.0, 85.0 / 96.0)
_ROW_6 = (12.0 / 5.0, -8.0, 4015.0 / 612.0, -11.0 / 36.0, 88.0 / 255.0)
_ROW_7 = (-8263.0 / 15000.0, 124.0 / 75.0, -643.0 / 680.0, -81.0 / 250.0, 2484.0 / 10625.0)
_ROW_8 = (3501.0 / 1720.0, -300.0 / 43.0, 297275.0 / 52632.0, -319.0 / 2322.0, 24068.0 / 84065.0, 3850.0 / 26703.0)
# For the first, third, fourth, fifth, seventh and eighth slope.
_WEIGHTS = (3.0 / 40.0, 875.0 / 2244.0, 23.0 / 72.0, 264.0 / 1955.0, 125.0 / 11592.0, 43.0 / 616.0)
# Order 5, for the first, third, fourth, fifth and sixth slope.
_FIFTH = (13.0 / 160.0, 2375.0 / 5984.0, 5.0 / 16.0, 12.0 / 85.0, 3.0 / 44.0)


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
    return _sixth(f, _common(f, load), load)


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
    slopes = _common(f, load)
    k1, _, k3, k4, k5 = slopes
    fifth = (k1, k3, k4, k5, stage(f, _NODES[5], _ROW_6, slopes, load))
    nodes = (_NODES[0], _NODES[2], _NODES[3], _NODES[4], _NODES[5])
    return _sixth(f, slopes, load), end("dverk", f, nodes, _FIFTH, fifth, load)


def _common(f: StepConstants, load: Load | None) -> Slopes:
    """Return the slopes of the first five stages."""
    k1 = first(f, load)
    k2 = stage(f, _NODES[1], _ROW_2, (k1,), load)
    k3 = stage(f, _NODES[2], _ROW_3, (k1, k2), load)
    k4 = stage(f, _NODES[3], _ROW_4, (k1, k2, k3), load)
    k5 = stage(f, _NODES[4], _ROW_5, (k1, k2, k3, k4), load)
    return (k1, k2, k3, k4, k5)


def _sixth(f: StepConstants, slopes: Slopes, load: Load | None) -> Increment:
    k1, k2, k3, k4, k5 = slopes
    k7 = stage(f, _NODES[6], _ROW_7, (k1, k2, k3, k4, k5), load)
    k8 = stage(f, _NODES[7], _ROW_8, (k1, k2, k3, k4, k5, k7), load)
    nodes = (_NODES[0], _NODES[2], _NODES[3], _NODES[4], _NODES[6], _NODES[7])
    return end("dverk", f, nodes, _WEIGHTS, (k1, k3, k4, k5, k7, k8), load)


DVERK = Method(
    "dverk",
    order=6,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    takes=LoadDependence.ANY,
    pair=pair,
    compiles=True,
    takes_arrays=True,
)
