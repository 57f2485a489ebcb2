"""`Actuator`: what is commanded by a number: a thruster, a magnetorquer, a reaction wheel.

An actuator is data from the scene, and an effect: what it depends on counts like that of any other. Its present state
follows from its commands and is computed in `actuator_bank.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.command_channels import topic_fault
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.ranges import Range, check_numbers
from rb_dynamics.numerics.argument_checks import instance, shown, whole_number

COMMAND = "/command"
"""What follows the name of an actuator in the topic of its commands."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A command to an actuator: `std_msgs/Float64`.

    Attributes:
        value: in the unit of the actuator.
        stamp_ns: when it takes effect, integer nanoseconds since the start of the run.
    """

    value: float
    stamp_ns: int = 0

    def __post_init__(self) -> None:
        """Keep a float; an invalid value is rejected when it is to take effect.

        Raises:
            TypeError: it is not a number, or the stamp is not a whole number.
        """
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise TypeError(f"setpoint: value is {shown(self.value)}, expected a number; write Setpoint(0.1)")
        object.__setattr__(self, "value", float(self.value))
        whole_number(self.stamp_ns, "setpoint: stamp_ns", "give nanoseconds: round(1e9 * seconds)")


@dataclass(frozen=True, slots=True)
class ActuatorCommand:
    """A command to an actuator was received.

    Attributes:
        time_ns: simulation time.
        topic: of the command, as the scene writes the name of the actuator.
        value: as it came.
        reason: why it is rejected; "" where it is not.
        clipped: whether the limits of the actuator reduced it.
    """

    time_ns: int
    topic: str
    value: float
    reason: str = ""
    clipped: bool = False


class Accepted(NamedTuple):
    """How an actuator honours a command: the value that acts, and whether its limits reduced it."""

    value: float
    clipped: bool = False


@dataclass(frozen=True, kw_only=True)
class Actuator(Effect):
    """A device that is commanded by a number on the topic `<name>/command`.

    Attributes:
        needs_field: whether it acts in a magnetic field.
        ranges: of its numbers.
        unit: of its commands.
        name: the first part of its topics.
    """

    needs_field: ClassVar[bool] = False
    ranges: ClassVar[Mapping[str, Range]]
    delay: ClassVar[float] = 0.0

    name: str

    def __post_init__(self) -> None:
        """Refuse a name that cannot be a topic, and numbers out of range.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: it is not a topic, or a number is out of range.
        """
        instance(self.name, str, f"{self.kind}: name", "write a text")
        if fault := topic_fault(self.name) or topic_fault(self.topic):
            raise SceneError(f"{self.kind}: name is {shown(self.name)}, expected {fault[0]}; {fault[1]}")
        check_numbers(self)

    @property
    def topic(self) -> str:
        """The topic of its commands."""
        return self.name + COMMAND

    @property
    def unit(self) -> str:
        """The unit of its commands."""
        raise NotImplementedError

    def accept(self, value: float) -> Accepted:
        """Return what a command does.

        Raises:
            WrenchError: it cannot be honoured.
        """
        if not math.isfinite(value):
            raise WrenchError(f"{self.topic}: {value!r} {self.unit}, expected a finite number; mend what commands it")
        return self._accept(value)

    def _accept(self, value: float) -> Accepted:
        raise NotImplementedError


def clipped(value: float, limit: float) -> Accepted:
    """Return a value within a limit either way."""
    return Accepted(math.copysign(limit, value), clipped=True) if abs(value) > limit else Accepted(value)
