"""`ThrusterArrays`: the thrusters of many bodies, of which each opens and closes at times of its own.

What happens to a thruster is what `ActuatorBank` does to it, to the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import WrenchFrames, about_point
from rb_dynamics.numerics.nanoseconds import LONGEST, nanoseconds, nanoseconds_of_each
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Times = npt.NDArray[np.int64]
    Marks = npt.NDArray[np.bool_]

_NEVER = 2**62


class ThrusterArrays:
    """K thrusters on each of N bodies, all closed at the start; their force does not rise or fall gradually.

    Attributes:
        count: K.
        next_ns: when one of a body opens or closes next, (N,); after all times if none does.
        clipped: commands of each body that were reduced, (N,).
        rejected: commands of each body that were rejected, (N,).
    """

    def __init__(
        self,
        thrusters: Sequence[Sequence[Thruster]],
        frames: Sequence[WrenchFrames],
        bodies: Sequence[RigidBody],
    ) -> None:
        """Begin without commands; the thrusters of all bodies have the same kinds of commands."""
        import numpy as np

        self.count, shape = len(thrusters[0]), (len(thrusters), len(thrusters[0]))
        self._pulsed = np.array([each.command == "on_time" for each in thrusters[0]])
        self._least = np.array([[max(each.minimum_on, 0.0) for each in some] for some in thrusters])
        self._delays = np.array([[nanoseconds(each.delay) for each in some] for some in thrusters])
        self._forces = np.array([[each.force for each in some] for some in thrusters])
        places = [[(of.fixed or {})[each.frame] for each in some] for some, of in zip(thrusters, frames, strict=True)]
        self._positions = np.array([[place.position for place in some] for some in places])
        self._turns = np.array([[place.orientation_xyzw for place in some] for some in places])
        self._centers = np.array([each.center_of_mass or ZERO for each in frames])
        self._axes = np.array([body.principal_orientation_xyzw for body in bodies])
        # Commands, in their order: when they act, and their values.
        self._waiting: list[tuple[Times, Numbers]] = []
        self._levels, self._ends = np.zeros(shape), np.full(shape, _NEVER)
        # Force and torque about the centre of mass, body axes: of the open thrusters, and of all as they are.
        every = np.arange(shape[0])
        self._open = np.stack([self._exerted(k, every, np.ones(shape[0])) for k in range(self.count)], axis=1)
        self._acting = np.zeros_like(self._open)
        self.next_ns = np.full(shape[0], _NEVER)
        self.clipped, self.rejected = np.zeros(shape[0]), np.zeros(shape[0])

    def receive(self, values: Numbers, times_ns: Times) -> None:
        """Receive commands, (N, K), NaN for none, at times (N,)."""
        import numpy as np

        told = ~np.isnan(values)
        short = self._pulsed & (values != 0.0) & ~((values >= self._least) & (values <= LONGEST))
        beyond = ~self._pulsed & ~((values >= 0.0) & (values <= 1.0))
        self.rejected = self.rejected + np.count_nonzero(told & short, axis=1)
        self.clipped = self.clipped + np.count_nonzero(told & beyond, axis=1)
        values = np.where(beyond, np.clip(values, 0.0, 1.0), values)
        acts = np.where(told & ~short, times_ns[:, np.newaxis] + self._delays, _NEVER)
        self._waiting.append((acts, values))
        self.next_ns = np.minimum(self.next_ns, acts.min(axis=1))

    def change(self, which: Marks) -> tuple[Times, Numbers]:
        """Make the changes of the bodies `which`, (N,), at their `next_ns`.

        Return the numbers of the bodies whose wrench may have changed, and force and torque on them about their centre
        of mass (principal axes), (n, 6).
        """
        import numpy as np

        now = np.where(which, self.next_ns, -1)[:, np.newaxis]
        # A pulse ends before a command of the same time acts.
        changed = self._ends == now
        self._levels[changed], self._ends[changed] = 0.0, _NEVER
        for times, values in self._waiting:
            acts = times == now
            levels = np.where(self._pulsed, values > 0.0, values)
            changed |= acts & (levels != self._levels)
            self._levels[acts] = levels[acts]
            pulses = acts & self._pulsed
            ends = now + np.maximum(1, nanoseconds_of_each(np.where(pulses, values, 0.0)))
            self._ends[pulses] = np.where(values > 0.0, ends, _NEVER)[pulses]
            times[acts] = _NEVER
        self._waiting = [each for each in self._waiting if each[0].min() < _NEVER]
        self.next_ns = np.min([self._ends, *(times for times, _ in self._waiting)], axis=(0, 2))
        self._act(changed)
        bodies = changed.any(axis=1).nonzero()[0]
        # As `ActuatorBank.held` adds them up.
        total = np.zeros((len(bodies), 6))
        for k in range(self.count):
            total = total + self._acting[bodies, k]
        axes: Any = tuple(self._axes[bodies].T)
        parts: Any = tuple(total[:, :3].T), tuple(total[:, 3:].T)
        return bodies, np.stack([each for part in parts for each in rotate_inverse(axes, part)], axis=1)

    def _act(self, changed: Marks) -> None:
        """Write what thrusters exert that have changed, (N, K)."""
        import numpy as np

        self._acting[changed] = np.where(self._levels[changed][:, np.newaxis] > 0.0, self._open[changed], 0.0)
        for k in (~self._pulsed).nonzero()[0].tolist():
            some = (changed[:, k] & (self._levels[:, k] > 0.0)).nonzero()[0]
            self._acting[some, k] = self._exerted(k, some, self._levels[some, k])

    def _exerted(self, k: int, bodies: Times, levels: Numbers) -> Numbers:
        """Return what thruster k of some bodies exerts at these levels; see `Thruster.held`."""
        import numpy as np

        zero = np.zeros(len(bodies))
        force: Any = levels * self._forces[bodies, k], zero, zero
        turn: Any = tuple(self._turns[bodies, k].T)
        position: Any = tuple(self._positions[bodies, k].T)
        center: Any = tuple(self._centers[bodies].T)
        held = about_point(force, ZERO, position, turn, center)
        return np.stack(np.broadcast_arrays(*held.force_body, *held.torque_body), axis=1)
