"""`Actuator`: a device that is commanded by a number: a thruster, a magnetorquer, a reaction wheel.

An actuator holds data from the scene. It is an effect, so it declares what its load depends on. `actuator_bank.py`
computes its present state from its commands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.number_ranges import Range, check_numbers
from rb_dynamics.loads.wrench_channels import topic_fault
from rb_dynamics.numerics.argument_checks import instance, shown, whole_number


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
        """Convert the value to a float; an invalid value is rejected only when it would take effect.

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
        topic: of the command, with the name of the actuator as in the scene.
        value: as received.
        reason: why it is rejected; "" if it is not.
        clipped: whether the limits of the actuator reduced it.
    """

    time_ns: int
    topic: str
    value: float
    reason: str = ""
    clipped: bool = False


class Accepted(NamedTuple):
    """Result of a command: the value that acts, and whether the limits of the actuator reduced it."""

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
        """Check the name, which has to be a topic, and the ranges of numbers.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: the name is not a topic, or a number is out of range.
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
        """Return the result of a command.

        Raises:
            WrenchError: the command is invalid.
        """
        if not math.isfinite(value):
            raise WrenchError(f"{self.topic}: {value!r}, expected a finite number; correct what commands it")
        return self._accept(value)

    def _accept(self, value: float) -> Accepted:
        raise NotImplementedError

    def rest(self, value: float, _: float) -> float:
        """Return the command with which a run begins, if this one came so many seconds before: it is held."""
        return value


def clipped(value: float, limit: float) -> Accepted:
    """Return `value`, clipped to -limit and limit."""
    return Accepted(math.copysign(limit, value), clipped=True) if abs(value) > limit else Accepted(value)
