"""`Samples`: state and balances of many bodies, or of one body at many times, as arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.effect import Stored
from rb_dynamics.motion.kernel_layout import phase_of
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.numerics.vector import Vector, add, subtract
from rb_dynamics.run.sample import kinetic_energy

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Times = npt.NDArray[np.int64]


def field(compute: Callable[[Any], Any]) -> cached_property[Numbers]:
    """Return a lazy field with the array that `compute` returns for rows of numbers."""

    @wraps(compute)
    def read(samples: Samples) -> Numbers:
        import numpy as np

        # An energy beyond the range of doubles becomes infinite, as elsewhere.
        with np.errstate(all="ignore"):
            found = compute(samples)
        return _read_only(np.stack(found, axis=-1) if isinstance(found, tuple) else np.asarray(found))

    return cached_property(read)


def _read_only(array: Numbers) -> Numbers:
    """Make `array` read-only: otherwise a change by one reader would be the state for the next."""
    found = array.view()
    found.flags.writeable = False
    return found


class Samples:
    """Samples of many bodies, or at many times: each field of `Sample` with a leading dimension.

    In place of the defects of the momenta it has the impulses. A field is computed when it is first read. Arrays are
    read-only.

    Attributes:
        time_ns: of all bodies, or one for each row; integer nanoseconds.
        wheel_speeds: (N, wheels), relative to the body, rad/s: in campaigns with reaction wheels.
        rejected_commands: (N,), so far: in campaigns.
        clipped_commands: (N,), so far, reduced by the limits of a channel or an actuator: in campaigns.
    """

    wheel_speeds: Numbers
    rejected_commands: Numbers
    clipped_commands: Numbers

    def __init__(
        self,
        body: RigidBody,
        start: Numbers,
        state: Numbers | Callable[[], Numbers],
        time_ns: int | Times,
        storing: Callable[[Numbers], Stored] | None = None,
    ) -> None:
        """Describe `body` (of arrays) in `state`, with balances from `start` on: (..., `PHASE`).

        `state` may be a function, which is called when a field is first read.
        `storing` returns, for such rows, momentum and energy of what moves inside the body; None if nothing does.
        """
        self.time_ns = time_ns
        self._body, self._began, self._given, self._storing = body, start, state, storing

    @classmethod
    def known(cls, time_ns: int | Times, **fields: Numbers) -> Samples:
        """Return samples with only these fields."""
        samples = cls.__new__(cls)
        samples.time_ns = time_ns
        samples.__dict__.update({name: _read_only(field) for name, field in fields.items()})
        return samples

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._state)

    @cached_property
    def _state(self) -> Numbers:
        return self._given() if callable(self._given) else self._given

    @field
    def position_world(self) -> Any:
        """(..., 3), of the body origin, m."""
        return self._seen.position_world

    @field
    def orientation_xyzw(self) -> Any:
        """(..., 4), body to world."""
        return self._seen.orientation_xyzw

    @field
    def linear_velocity_world(self) -> Any:
        """(..., 3), of the body origin, m/s."""
        return self._seen.linear_velocity_world

    @field
    def angular_velocity_body(self) -> Any:
        """(..., 3), rad/s."""
        return self._seen.angular_velocity_body

    @field
    def angular_momentum_world(self) -> Any:
        """(..., 3), about the centre of mass, kg m^2/s."""
        return self._spin_of(self._phase, self._stored)

    @field
    def linear_momentum_world(self) -> Any:
        """(..., 3), kg m/s."""
        return self._phase.linear_momentum_world

    @field
    def kinetic_energy(self) -> Any:
        """(...), translation and rotation, J."""
        energy = kinetic_energy(self._body, self._phase)
        return energy if self._stored is None else energy + self._stored.energy

    @field
    def work(self) -> Any:
        """(...), of the wrenches since the start, J."""
        work = self._phase.work
        return work if self._stored is None else work + (self._stored.energy - self._stored_before.energy)

    @field
    def energy_defect(self) -> Any:
        """(...), T - T0 - work, J; see `SampleBuilder`."""
        body, phase = self._body, self._phase
        return kinetic_energy(body, phase) - kinetic_energy(body, _phase(self._began)) - phase.work

    @field
    def impulse_world(self) -> Any:
        """(..., 3), integral of the force since the start, N s."""
        return self._phase.impulse_world

    @field
    def torque_impulse_world(self) -> Any:
        """(..., 3), integral of the torque about the centre of mass since the start, N m s."""
        if self._stored is None:
            return self._phase.torque_impulse_world
        # Without the exchange with internal parts, which only the torque on the body includes.
        began = _phase(self._began)
        defect = subtract(subtract(self._spin_of(self._phase), self._spin_of(began)), self._phase.torque_impulse_world)
        gained = subtract(self._spin_of(self._phase, self._stored), self._spin_of(began, self._stored_before))
        return subtract(gained, defect)

    def _spin_of(self, phase: PhaseState, stored: Stored | None = None) -> Vector:
        spin = phase.angular_momentum_world(self._body)
        return spin if stored is None else add(spin, rotate(phase.orientation, stored.momentum))

    @cached_property
    def _stored(self) -> Stored | None:
        return None if self._storing is None else self._storing(self._state)

    @property
    def _stored_before(self) -> Stored:
        if self._storing is None:
            raise TypeError("nothing moves inside the bodies")
        return self._storing(self._began)

    @cached_property
    def _phase(self) -> PhaseState:
        return _phase(self._state)

    @cached_property
    def _seen(self) -> State:
        return self._phase.state(self._body, 0)


def _phase(state: Numbers) -> PhaseState:
    import numpy as np

    # Each number contiguous over all rows, which numpy processes fastest.
    return phase_of(tuple(np.ascontiguousarray(state.T)))
