"""`free_motion`: the exact motion of a body without loads, at any time; the reference for everything else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rb_dynamics.body.rigid_body import RigidBody, require_body
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.phase_state import PhaseState, inertia_of, of_origin
from rb_dynamics.motion.step_checks import LARGEST_FREE_TURN
from rb_dynamics.numerics.argument_checks import as_array, instance
from rb_dynamics.numerics.rotation import multiply, renormalize
from rb_dynamics.numerics.vector import add_scaled, norm, scale

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers


@dataclass(frozen=True)
class FreeMotion:
    """States at the requested times; the leading dimensions of the arrays are those of the times.

    Attributes:
        position_world: (..., 3), of the body origin, m.
        orientation_xyzw: (..., 4), body to world.
        linear_velocity_world: (..., 3), of the body origin, m/s.
        angular_velocity_body: (..., 3), rad/s.
    """

    position_world: npt.NDArray[np.float64]
    orientation_xyzw: npt.NDArray[np.float64]
    linear_velocity_world: npt.NDArray[np.float64]
    angular_velocity_body: npt.NDArray[np.float64]


def free_motion(body: RigidBody, state: State, t: npt.ArrayLike) -> FreeMotion:
    """Return the torque-free motion of `body` that passes through `state`, at times `t` (s, relative to it, any sign).

    `t` is a number or an array of any shape; each time takes the same amount of work. The error of the attitude is
    below 100 eps (1 + |w| t), those of energy and |L| are below 20 eps, see `free_rotation`. Compiled code gives the
    same bits as plain Python (`fixed_step_kernel.py`).

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: a number in `state` is not finite, or the norm of its attitude is not 1.
        ConvergenceError: a time is not finite or too long for any correct digit of the attitude, or the position
            overflows.
    """
    import numpy as np

    require_body(body)
    state = instance(state, State, "state", "make one with State(...), or take scene.initial").checked("state")
    # A copy, because the kernel accepts no read-only array.
    times = np.array(as_array(t, "t", "a time or times (s)"))
    rate, longest = norm(state.angular_velocity_body), float(np.abs(times).max(initial=0.0))
    if not longest * rate < LARGEST_FREE_TURN:
        raise ConvergenceError(
            f"t reaches {longest:g} s at {rate:g} rad/s, expected finite times and less than "
            f"{LARGEST_FREE_TURN:g} rad of turn; beyond that no digit of the attitude is known"
        )
    start = PhaseState.of(body, state)
    numbers = (
        *inertia_of(body).moments,
        *start.angular_velocity,
        *start.orientation,
        *start.center_of_mass_world,
        *scale(1.0 / body.mass, start.linear_momentum_world),
        *body.center_of_mass,
        *body.principal_orientation_xyzw,
    )
    table = _table(numbers, times.ravel()).reshape(*times.shape, _ROW)
    return FreeMotion(table[..., :3], table[..., 3:7], table[..., 7:10], table[..., 10:])


def _table(numbers: tuple[float, ...], times: Numbers) -> Numbers:
    import numpy as np

    compiled = FREE_STATES.get(times.size, times.size)
    if compiled is not None:
        table = np.empty(_ROW * times.size)
        compiled(np.array(numbers), times, table)
        if np.isfinite(table).all():
            return table
    # Plain Python, which raises the errors.
    rows = [0.0] * (_ROW * times.size)
    _free_states(numbers, times.tolist(), rows)
    table = np.array(rows)
    if not np.isfinite(table).all():
        raise ConvergenceError(
            "t is so long that the position is not a finite number, expected one in the range of double precision; use "
            "shorter times, or check the velocity"
        )
    return table


_ROW = 13


def _free_states(numbers: Sequence[float], times: Sequence[float], rows: MutableSequence[float]) -> None:
    """Write position, attitude, velocity and angular velocity, of body origin and axes, at each of `times`.

    `numbers` are the principal moments; the initial angular velocity in principal axes, attitude of the principal axes,
    position and velocity of the centre of mass; and the position of the centre of mass and orientation of the principal
    axes in the body.
    """
    c = numbers
    moments, spin, start = (c[0], c[1], c[2]), (c[3], c[4], c[5]), (c[6], c[7], c[8], c[9])
    position, velocity = (c[10], c[11], c[12]), (c[13], c[14], c[15])
    center_of_mass, axes = (c[16], c[17], c[18]), (c[19], c[20], c[21], c[22])
    for i in range(len(times)):
        turn, omega = free_rotation(moments, spin, times[i])
        at, orientation = add_scaled(position, times[i], velocity), renormalize(multiply(start, turn))
        x, q, v, w = of_origin(center_of_mass, axes, at, orientation, velocity, omega)
        k = _ROW * i
        rows[k], rows[k + 1], rows[k + 2] = x
        rows[k + 3], rows[k + 4], rows[k + 5], rows[k + 6] = q
        rows[k + 7], rows[k + 8], rows[k + 9] = v
        rows[k + 10], rows[k + 11], rows[k + 12] = w


FREE_STATES = OnDemand("exact", _free_states, "void(float64[::1], float64[::1], float64[::1])")
