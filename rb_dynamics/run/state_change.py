"""`StateChange`: a body is moved to another state during a run, as by motion capture; the balances include the jump."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError
from rb_dynamics.motion.method import Increment
from rb_dynamics.motion.phase_state import IMPULSE, PhaseState, grown
from rb_dynamics.numerics.rotation import Quaternion, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, subtract
from rb_dynamics.run.sample import kinetic_energy


@dataclass(frozen=True, slots=True)
class StateChange:
    """A state to which the body is moved, in the form of the log, so that a replay has the same bits.

    Attributes:
        time_ns: simulation time.
        position_world: of the body origin, m.
        orientation_xyzw: body to world.
        linear_velocity_body: of the body origin, body axes, m/s.
        angular_velocity_body: rad/s.
    """

    time_ns: int
    position_world: Vector
    orientation_xyzw: Quaternion
    linear_velocity_body: Vector
    angular_velocity_body: Vector

    @classmethod
    def to(cls, state: State, body: RigidBody) -> StateChange:
        """Return the change of `body` to `state`, at its time.

        Raises:
            SceneError: it is not a state of the body.
        """
        try:
            state = state.checked("state")
        except (TypeError, ValueError) as error:
            raise SceneError(str(error)) from None
        if body.is_particle and state.angular_velocity_body != ZERO:
            raise SceneError(
                "state.angular_velocity_body: expected none, as a body without inertia is a particle; leave it 0"
            )
        return cls(
            state.time_ns,
            state.position_world,
            state.orientation_xyzw,
            rotate_inverse(state.orientation_xyzw, state.linear_velocity_world),
            state.angular_velocity_body,
        )

    @property
    def state(self) -> State:
        """The state."""
        velocity = rotate(self.orientation_xyzw, self.linear_velocity_body)
        return State(self.time_ns, self.position_world, self.orientation_xyzw, velocity, self.angular_velocity_body)

    def at(self, time_ns: int) -> StateChange:
        """Return this change at another time."""
        return replace(self, time_ns=time_ns)


def moved(body: RigidBody, phase: PhaseState, change: StateChange) -> PhaseState:
    """Return `phase` after `change`: an instantaneous impulse, angular impulse and work."""
    new = PhaseState.of(body, change.state)
    jump = Increment(
        ZERO,
        new.orientation,
        new.angular_velocity,
        subtract(new.linear_momentum_world, phase.linear_momentum_world),
        subtract(new.angular_momentum_world(body), phase.angular_momentum_world(body)),
        kinetic_energy(body, new) - kinetic_energy(body, phase),
    )
    high, low = grown(phase.high, phase.low, jump, 0.0)
    # Position and momentum are exactly the new ones.
    return PhaseState(
        new.orientation,
        new.angular_velocity,
        new.high[:IMPULSE] + high[IMPULSE:],
        new.low[:IMPULSE] + low[IMPULSE:],
    )
