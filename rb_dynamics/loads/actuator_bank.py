"""`ActuatorBank`: the actuators of one run, the times at which their commands act, and their present state."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import WrenchError
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.loads.actuator import Actuator, ActuatorCommand
from rb_dynamics.loads.effect import Field, Wrenching
from rb_dynamics.loads.gradual_wrench import Transient
from rb_dynamics.loads.magnetorquer import Magnetorquer, turned_in_field
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wheel_set import WheelSet
from rb_dynamics.loads.wrench import HeldWrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import HUGE, AppliedWrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add


class _Edge(NamedTuple):
    """A command that comes (`is_new`), or an actuator that changes.

    At equal times the actuators come in the order of the scene; of each, changes come before new commands. Changes have
    the order in which their commands came, and not that in which `post` was told of them, possibly long before.
    """

    time_ns: int
    actuator: int
    is_new: bool
    number: int
    value: float


class ActuatorBank:
    """The actuators of one run, in the order of the scene, all at zero at the start.

    Attributes:
        wheels: the reaction wheels; None if there are none.
        changed: whether the last `apply` changed what an actuator does.
    """

    def __init__(
        self,
        actuators: Sequence[Actuator],
        body: RigidBody,
        frames: WrenchFrames,
        field: Callable[[float], Field],
    ) -> None:
        """Start without commands; `field` is the magnetic flux density (T) at a time (s of the run)."""
        self._actuators, self._body, self._frames, self._field = tuple(actuators), body, frames, field
        self._index = {actuator.topic.lstrip("/"): k for k, actuator in enumerate(actuators)}
        self._queue: list[_Edge] = []
        self.changed = False
        self._number = 0
        # The present value of each actuator, and the number of the command that opened a thruster, to which its closing
        # belongs.
        self._values = [0.0] * len(self._actuators)
        self._opened = [0] * len(self._actuators)
        # When the command to each thruster last changed, and its level just before.
        self._before = [(-1, 0.0)] * len(self._actuators)
        # Thrusters whose force rises or falls: the transient, and the levels between which it goes.
        self._ramps: dict[int, tuple[Transient, tuple[float, float]]] = {}
        wheels = [actuator for actuator in self._actuators if isinstance(actuator, ReactionWheel)]
        self.wheels = WheelSet(wheels, body) if wheels else None
        self._wheel = {wheel.topic: (k, wheel) for k, wheel in enumerate(wheels)}

    def accept(self, topic: str, value: float) -> bool:
        """Return whether the limits of an actuator reduce a command, without applying it.

        Raises:
            WrenchError: there is no such actuator, or the command is invalid.
        """
        return self._actuators[self._place(topic)].accept(value).clipped

    def post(self, topic: str, value: float, time_ns: int) -> None:
        """Receive a command at `time_ns`.

        Raises:
            WrenchError: there is no such actuator.
        """
        self._push(time_ns, self._place(topic), value, is_new=True)

    def next_change_ns(self) -> int | None:
        """Return the next time at which a command takes effect or an actuator changes; None if there is none."""
        times = [transient.end_ns for transient in self.transients()]
        return min([*times, *(edge.time_ns for edge in self._queue[:1])], default=None)

    def transients(self) -> list[Transient]:
        """Return the transients of the thrusters whose force rises or falls."""
        return [transient for transient, _ in self._ramps.values()]

    def on_their_way(self, now_ns: int) -> list[AppliedWrench]:
        """Return the present wrench at `now_ns` of each thruster whose force rises or falls."""
        going = [k for k, (ramp, _) in sorted(self._ramps.items()) if ramp.since_ns < now_ns < ramp.end_ns]
        return [replace(self._applied(k, now_ns), on_its_way=True) for k in going]

    def apply(self, now_ns: int) -> list[ActuatorCommand | AppliedWrench]:
        """Make every change due at `now_ns`; return the commands, and the thrusters that changed, in order."""
        told: list[ActuatorCommand | AppliedWrench] = []
        self.changed = False
        for k in [k for k, (ramp, _) in sorted(self._ramps.items()) if ramp.end_ns <= now_ns]:
            del self._ramps[k]
            self.changed = True
            told.append(replace(self._applied(k, now_ns), on_its_way=True))
        while self._queue and self._queue[0].time_ns <= now_ns:
            edge = heapq.heappop(self._queue)
            if not edge.is_new:
                told += self._act(edge)
                continue
            actuator = self._actuators[edge.actuator]
            try:
                value, clipped = actuator.accept(edge.value)
            except WrenchError as error:
                told.append(ActuatorCommand(now_ns, actuator.topic, edge.value, str(error)))
                continue
            told.append(ActuatorCommand(now_ns, actuator.topic, edge.value, "", clipped))
            self._push(now_ns + nanoseconds(actuator.delay), edge.actuator, value, is_new=False)
        return told

    def turn(self, told: Sequence[ActuatorCommand | AppliedWrench], omega: Vector, states: Sequence[float]) -> None:
        """Apply the commands of wheels among `told`, while the body turns with `omega` (principal axes)."""
        if self.wheels is not None:
            speeds = self.wheels.speeds(omega, states)
            for _, k, _, value in self._to_wheels(told):
                self.wheels.command(k, value, speeds[k])

    def huge(self, told: Sequence[ActuatorCommand | AppliedWrench]) -> list[int]:
        """Return the places of the commands of wheels that are larger than any motor gives: see `HUGE`."""
        return [place for place, _, wheel, value in self._to_wheels(told) if wheel.spin_up(value) > HUGE]

    def _to_wheels(
        self, told: Sequence[ActuatorCommand | AppliedWrench]
    ) -> Iterator[tuple[int, int, ReactionWheel, float]]:
        """Yield the place of each accepted command to a wheel, the wheel with its number, and the value that acts."""
        for place, each in enumerate(told):
            if isinstance(each, ActuatorCommand) and not each.reason and each.topic in self._wheel:
                k, wheel = self._wheel[each.topic]
                yield place, k, wheel, wheel.accept(each.value).value

    def held(self) -> HeldWrench:
        """Return the wrench of the thrusters about the centre of mass, body axes, without those of `transients`."""
        total = HeldWrench()
        for k, (actuator, value) in enumerate(zip(self._actuators, self._values, strict=True)):
            if isinstance(actuator, Thruster) and value > 0.0 and k not in self._ramps:
                total = total + actuator.held(self._frames, value)
        return total

    @property
    def dipole(self) -> Vector:
        """The dipole of the magnetorquers as commanded now, A m^2, principal axes."""
        dipole: Vector = ZERO
        for actuator, value in zip(self._actuators, self._values, strict=True):
            if isinstance(actuator, Magnetorquer):
                dipole = add(dipole, actuator.dipole(value))
        return dipole if dipole == ZERO else rotate_inverse(self._body.principal_orientation_xyzw, dipole)

    def wrenching(self) -> Wrenching | None:
        """Return the load of the magnetorquers in the field, as commanded now; None if there is none."""
        dipole, field = self.dipole, self._field
        if dipole == ZERO:
            return None
        return lambda point: turned_in_field(dipole, field(point.time)(point.position), point)

    def _place(self, topic: str) -> int:
        place = self._index.get(topic.lstrip("/"))
        if place is None:
            known = ", ".join(sorted(self._index)) or "none: the scene lists no actuators"
            remedy = "name one of these" if topic.endswith(COMMAND) else f"name it with {COMMAND}"
            raise WrenchError(f"topic {topic!r}, expected that of an actuator, one of {known}; {remedy}")
        return place

    def _push(self, time_ns: int, actuator: int, value: float, is_new: bool) -> None:
        self._number += 1
        heapq.heappush(self._queue, _Edge(time_ns, actuator, is_new, self._number, value))

    def _act(self, edge: _Edge) -> list[AppliedWrench]:
        """Apply a command to an actuator; return its effect on the body if that is a wrench."""
        k = edge.actuator
        actuator, value = self._actuators[k], edge.value
        if not isinstance(actuator, Thruster):
            self.changed = True
            self._values[k] = value
            return []
        if value < 0.0:
            # The end of a pulse, unless another command has replaced it.
            if self._opened[k] != edge.number:
                return []
            value = 0.0
        elif actuator.command == "on_time":
            self._opened[k] = edge.number
            if value > 0.0:
                end_ns = edge.time_ns + max(1, nanoseconds(value))
                heapq.heappush(self._queue, edge._replace(time_ns=end_ns, value=-1.0))
            value = 1.0 if value > 0.0 else 0.0
        if value == self._values[k]:
            return []
        self.changed = True
        # Of several changes at one nanosecond only the last acts: a pulse that follows on another finds it open.
        if self._before[k][0] != edge.time_ns:
            self._before[k] = edge.time_ns, self._level(k, edge.time_ns)
        _, was = self._before[k]
        self._values[k] = value
        self._ramps.pop(k, None)
        way = actuator.way(value - was)
        if length_ns := nanoseconds(way):
            length = length_ns / NANOSECONDS
            # It ends on a whole nanosecond, at the level that keeps its impulse.
            levels = was, value + (value - was) * (1.0 - way / length)
            before, after = (actuator.held(self._frames, level) for level in levels)
            self._ramps[k] = Transient(before, after, edge.time_ns, length, is_linear=True), levels
        return [self._applied(k, edge.time_ns)]

    def _level(self, k: int, now_ns: int) -> float:
        """Return the fraction of its force that a thruster exerts."""
        value = self._values[k]
        if k not in self._ramps:
            return value
        ramp, (was, end) = self._ramps[k]
        return was + (end - was) * ((now_ns - ramp.since_ns) / NANOSECONDS / ramp.length)

    def _applied(self, k: int, now_ns: int) -> AppliedWrench:
        thruster = self._actuators[k]
        assert isinstance(thruster, Thruster)
        held = thruster.held(self._frames, self._level(k, now_ns))
        frame = self._frames.body_frame
        return AppliedWrench(now_ns, thruster.name, None, frame, held.force_body, held.torque_body)
