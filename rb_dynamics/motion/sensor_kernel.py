"""The kernels that read a sensor on many bodies, and make up what it senses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import phase_in
from rb_dynamics.motion.phase_state import of_origin
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.sensors.many_readings import read_all

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers


def find_truths(phases: Numbers, bodies: Numbers, truth: Numbers) -> None:
    """Write position, attitude and angular velocity of bodies, as in `Truth`.

    Args:
        phases: (`PHASE` or more, N).
        bodies: (7, N), of each the centre of mass, and the rotation from principal to body axes.
        truth: (N, 10).
    """
    for i in range(len(truth)):
        (q, omega, high, low), b, t = phase_in(phases, i), bodies, truth
        at: Vector = (high[0] + low[0], high[1] + low[1], high[2] + low[2])
        axes = (b[3, i], b[4, i], b[5, i], b[6, i])
        (t[i, 0], t[i, 1], t[i, 2]), turn, _, spin = of_origin((b[0, i], b[1, i], b[2, i]), axes, at, q, ZERO, omega)
        t[i, 3], t[i, 4], t[i, 5], t[i, 6] = turn
        t[i, 7], t[i, 8], t[i, 9] = spin


READ_ALL = OnDemand(
    "rk4", read_all, "void(int64, float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1])", steps=20.0
)
FIND_TRUTHS = OnDemand("rk4", find_truths, "void(Array(float64, 2, 'A', True), float64[:, ::1], float64[:, ::1])", 20.0)
