"""`free_motion`: where a body is after any time without load, in closed form; the reference for everything else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.exact import step
from rb_dynamics.motion.phase import Phase, inertia_of
from rb_dynamics.motion.refusal import LARGEST_FREE_TURN
from rb_dynamics.vector import norm, scale

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


@dataclass(frozen=True)
class FreeMotion:
    """States at the times asked for; the leading axes are those of the times.

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
    """Return the torque-free motion of `body` that passes through `state`, at times `t` (s, from there, any sign).

    Constant work for each time; `t` is a number or an array of any shape. The error of the attitude is below
    100 eps (1 + |w| t), those of energy and |L| are below 20 eps, see `FreeRotation`.

    Raises:
        ConvergenceError: a time is not finite, or so long that the turn has no correct digit left.
    """
    import numpy as np

    times = np.asarray(t, dtype=np.float64)
    rate = norm(state.angular_velocity_body)
    if times.size and not (np.isfinite(times).all() and float(np.abs(times).max()) * rate < LARGEST_FREE_TURN):
        raise ConvergenceError(
            f"t reaches {np.abs(times).max():g} s at {rate:g} rad/s, expected finite times and less than "
            f"{LARGEST_FREE_TURN:g} rad of turn; beyond that no digit of the attitude is known"
        )
    inertia, start = inertia_of(body), Phase.of(body, state)
    velocity = scale(1.0 / body.mass, start.linear_momentum_world)
    rows = []
    for time in times.ravel().tolist():
        increment = step(inertia, HeldWrench(), time, velocity, start.orientation, start.angular_velocity)
        moved = start.after(increment, time).state(body, state.time_ns)
        rows.append(
            (
                *moved.position_world,
                *moved.orientation_xyzw,
                *moved.linear_velocity_world,
                *moved.angular_velocity_body,
            )
        )
    table = np.array(rows, dtype=np.float64).reshape(*times.shape, 13)
    return FreeMotion(table[..., :3], table[..., 3:7], table[..., 7:10], table[..., 10:])
