"""`Sensor`: samples the true motion and publishes it with delay, errors and noise; it does not affect the motion.

A sensor holds data from the scene. For each run it creates a `Reading`, which takes one sample after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Field
from rb_dynamics.loads.number_ranges import TIME, Range, check_numbers, read_numbers
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.numerics.argument_checks import instance, shown
from rb_dynamics.numerics.nanoseconds import LONGEST, NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.sensors.random_numbers import RandomNumbers

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

DROPOUT = "/dropout"
"""What follows the name of a sensor in that of the random numbers by which samples are lost."""

COMMON_KEYS = ("name", "rate", "frame", "delay", "dropout")
"""Keys of every sensor, in addition to `type`."""


class Truth(NamedTuple):
    """The true motion and environment at the time of a sample.

    Attributes:
        position_world: of the body origin, m.
        orientation_xyzw: body to world.
        angular_velocity_body: rad/s.
        acceleration: returns that of the body origin (m/s^2) and the angular one (rad/s^2), body axes.
        gravity: returns the gravitational acceleration (m/s^2, world axes) at a place (m, world axes).
        magnetic_field: returns the magnetic flux density (T, world axes) at a place.
    """

    position_world: Vector
    orientation_xyzw: Quaternion
    angular_velocity_body: Vector
    acceleration: Callable[[], tuple[Vector, Vector]]
    gravity: Field
    magnetic_field: Field


Reading = Callable[[int, Truth], "tuple[float, ...] | None"]
"""Takes the index of a sample and the truth, and returns the numbers of its message; None for no message.

It is called for every sample from 0 on, in order, because a random walk of the bias depends on earlier samples.
"""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A device that measures; each kind adds its own errors.

    Attributes:
        kind: `type` in the scene's list of sensors.
        message: type of its messages.
        in_world: whether their `frame_id` is the world, not the sensor's own frame.
        needs_field: whether it measures a magnetic field.
        keys: keys of its entry in the scene, in addition to `type` and `COMMON_KEYS`.
        ranges: ranges of its numbers.
        values: the measured quantities, each with its place among the numbers of a message.
        name: its topic.
        rate: samples per second of simulation time.
        frame: its frame, fixed on the body; "" for the body frame.
        delay: time from a sample to its message, s; the message has the stamp of the sample.
        dropout: probability that a sample gives no message.
    """

    kind: ClassVar[str]
    message: ClassVar[str]
    in_world: ClassVar[bool] = False
    needs_field: ClassVar[bool] = False
    keys: ClassVar[tuple[str, ...]] = ()
    ranges: ClassVar[Mapping[str, Range]] = {
        "rate": Range(
            f"a number from {1.0 / LONGEST:.1e} to {float(NANOSECONDS):g} (Hz)",
            "write how many samples a second it takes, such as 100",
            least=1.0 / LONGEST,
            most=float(NANOSECONDS),
        ),
        "delay": TIME,
        "dropout": Range(
            "a probability of at least 0 and less than 1", "write 0 for none", least=0.0, most=1.0 - 2.0**-53
        ),
    }
    values: ClassVar[Mapping[str, slice]]

    name: str
    rate: float
    frame: str = ""
    delay: float = 0.0
    dropout: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range.
        """
        for name in ("name", "frame"):
            instance(getattr(self, name), str, f"{self.kind}: {name}", "write a text")
        check_numbers(self)

    @property
    def may_be_silent(self) -> bool:
        """Whether it sends no messages while its target is out of view."""
        return False

    @property
    def ideal(self) -> Sensor:
        """The same sensor without errors and losses."""
        raise NotImplementedError

    @classmethod
    def read(cls, entry: SceneEntry) -> Sensor:
        """Return the sensor of an entry of a scene; problems with its values are recorded in the entry."""
        return cls(**cls._common(entry))

    def reading(self, seed: int, frames: WrenchFrames) -> Reading:
        """Return the reading for a run."""
        measure, random = self.measuring(RandomNumbers(seed, self.name), self.fixed(frames)), None
        if self.dropout > 0.0:
            random = RandomNumbers(seed, self.name + DROPOUT)

        def read(sample: int, truth: Truth) -> tuple[float, ...] | None:
            found = measure(sample, truth)
            lost = random is not None and random.uniform(sample, 0)[0] < self.dropout
            return None if lost else found

        return read

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Return the reading at `place` on the body, with errors from `random`, without lost samples."""
        raise NotImplementedError

    def fixed(self, frames: WrenchFrames) -> FixedFrame:
        """Return its frame on the body.

        Raises:
            SceneError: there is no such frame.
        """
        if self.frame in ("", frames.body_frame):
            return FixedFrame()
        found = (frames.fixed or {}).get(self.frame)
        if found is None:
            known = ", ".join([frames.body_frame, *(frames.fixed or {})])
            raise SceneError(
                f"{self.kind}: frame is {shown(self.frame)}, expected one of {known}; declare it under body.frames"
            )
        return found

    def frame_id(self, frames: WrenchFrames) -> str:
        """Return the `frame_id` of its messages."""
        return frames.world_frame if self.in_world else self.frame or frames.body_frame

    @classmethod
    def _common(cls, entry: SceneEntry) -> dict[str, Any]:
        """Return the values common to all sensors, and all numbers; `scene/read_devices.py` has checked the name."""
        frame = entry.text("frame", "the name of a frame", "")
        if frame and frame not in (entry.frames.body_frame, *(entry.frames.fixed or {})):
            known = ", ".join([entry.frames.body_frame, *(entry.frames.fixed or {})])
            entry.reject(f"a frame of the body, one of {known}", "declare it under body.frames", "frame")
            frame = ""
        return {"name": entry.name, "frame": frame, **read_numbers(cls, entry)}


def diagonal(values: Sequence[float]) -> tuple[float, ...]:
    """Return the matrix with these values on its diagonal, row by row."""
    size = len(values)
    return tuple(value if column == row else 0.0 for row, value in enumerate(values) for column in range(size))
