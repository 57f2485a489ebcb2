"""A thruster: a force along the x axis of its frame, in pulses of a commanded length or at a commanded level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.actuator import Accepted, Actuator
from rb_dynamics.loads.number_ranges import TIME, Range, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import HeldWrench, Wrench, WrenchFrames
from rb_dynamics.numerics.argument_checks import instance, shown
from rb_dynamics.numerics.nanoseconds import LONGEST

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

COMMANDS = ("on_time", "level")


@dataclass(frozen=True, kw_only=True)
class Thruster(Actuator):
    """While open, exerts `force` along the x axis of its frame, at the frame's origin.

    A command takes effect `delay` after it arrives: open for `on_time` seconds, or at `level` (0 to 1) times the force
    until the next command. A level beyond its ends, also a negative one, acts as the end, and counts as clipped; an
    on-time that cannot be is rejected. A command replaces the previous one: `on_time` 0 closes. Edges fall on their
    exact nanosecond, so that an impulse is force times time. With `rise` and `fall`, the force ramps linearly to its
    new level from each edge on: a pulse of at least `rise` has the impulse F (on-time - rise / 2 + fall / 2).

    Attributes:
        frame: one of the body's fixed frames, with the thruster at its origin.
        force: of the open thruster, N.
        command: `on_time` or `level`.
        minimum_on: shortest on-time, s; a shorter one greater than 0 is rejected.
        delay: time from a command to its edge, s.
        rise: time from no force to full force, s.
        fall: time from full force to no force, s.
    """

    kind: ClassVar[str] = "thruster"
    keys: ClassVar[tuple[str, ...]] = ("name", "frame", "force", "command", "minimum_on", "delay", "rise", "fall")
    ranges: ClassVar[Mapping[str, Range]] = {
        "force": Range("a number greater than 0 (N)", "write its force", above=0.0),
        "minimum_on": Range("0 or more (s)", "write 0 for none", least=0.0),
        **dict.fromkeys(("delay", "rise", "fall"), TIME),
    }

    frame: str
    force: float
    command: str = "on_time"
    minimum_on: float = 0.0
    delay: float = 0.0  # type: ignore[misc]
    rise: float = 0.0
    fall: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range, or there is no such command.
        """
        super().__post_init__()
        instance(self.frame, str, "thruster: frame", "write the name of a frame")
        if self.command not in COMMANDS:
            raise SceneError(f"thruster: command is {shown(self.command)}, expected {' or '.join(COMMANDS)}")

    @classmethod
    def read(cls, entry: SceneEntry) -> Thruster:
        """Return the actuator of an entry."""
        frame, known = entry.text("frame", "the name of a frame", ""), ", ".join(entry.frames.fixed or {})
        if not frame:
            entry.section.missing("frame", "a fixed frame of the body", "declare one under body.frames and name it")
        elif frame not in (entry.frames.fixed or {}):
            entry.reject(f"a fixed frame of the body, one of: {known}", "declare it under body.frames", "frame")
        return cls(
            name=entry.name or "thruster",
            frame=frame,
            command=entry.choice("command", COMMANDS, COMMANDS[0]),
            **read_numbers(cls, entry),
        )

    @property
    def takes(self) -> LoadDependence:  # type: ignore[override]
        """The load depends on time if the force rises or falls gradually."""
        return LoadDependence.FIELD if self.rise or self.fall else LoadDependence.HELD

    @property
    def unit(self) -> str:
        """The unit of its commands."""
        return "s" if self.command == "on_time" else "of its force"

    def way(self, level: float) -> float:
        """Return the time (s) in which the force rises by `level` times the full force, or falls if it is negative."""
        return level * self.rise if level > 0.0 else -level * self.fall

    def held(self, frames: WrenchFrames, level: float) -> HeldWrench:
        """Return the wrench about the centre of mass at `level` times the full force."""
        return frames.hold(Wrench((level * self.force, 0.0, 0.0), frame_id=self.frame))

    def rest(self, value: float, age: float) -> float:
        """Return the command with which a run begins, if `value` came `age` (s) before: of a pulse, what is left."""
        if self.command == "level" or not value >= self.minimum_on:
            return value
        return value - age if value - age >= self.minimum_on else 0.0

    def _accept(self, value: float) -> Accepted:
        if self.command == "level":
            return Accepted(min(1.0, max(0.0, value)), not 0.0 <= value <= 1.0)
        if value != 0.0 and not max(self.minimum_on, 0.0) <= value <= LONGEST:
            least = f"minimum_on = {self.minimum_on!r} s" if self.minimum_on else "0 s"
            raise WrenchError(
                f"{self.topic}: an on-time of {value!r} s, expected 0 or from {least} to {LONGEST:.1e} s; command "
                "0 for less"
            )
        return Accepted(value)
