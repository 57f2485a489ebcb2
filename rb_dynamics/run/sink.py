"""`Sink`: receives the events of a run by three calls; implemented by MCAP and Rerun logs, arrays, and the node.

Events are values in the units and frames of the log. A sink must not change the run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from rb_dynamics.loads.actuator import ActuatorCommand
from rb_dynamics.loads.wrench_channels import AppliedWrench, ReceivedWrench, RejectedWrench
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.state_change import StateChange

if TYPE_CHECKING:
    from rb_dynamics.scene.model import Scene


@dataclass(frozen=True, slots=True)
class RunInfo:
    """Information about a run at its start.

    Attributes:
        scene: the validated scene, with its text as `scene.text` and its file name as `scene.source`.
        method: name of the method that runs, as in `METHODS`.
        metadata: facts about the run as text: software versions, platform, method, seed, hash of the inputs.
        acceleration: returns the acceleration of the body origin (m/s^2) and the angular one (rad/s^2), body axes, for
            the sample being written; None if there is no simulation.
    """

    scene: Scene
    method: str
    metadata: Mapping[str, str] = field(default_factory=dict)
    acceleration: Callable[[], tuple[Vector, Vector]] | None = None


@dataclass(frozen=True, slots=True)
class Status:
    """Health of a run at one time, as shown on `/diagnostics`.

    Attributes:
        time_ns: simulation time.
        level: 0 OK, 1 WARN, 2 ERROR, as in diagnostic_msgs/DiagnosticStatus.
        message: one line of text.
        values: key and value, as text.
        name: subject of the status: a node by its full name.
    """

    time_ns: int
    level: int
    message: str
    values: Mapping[str, str]
    name: str = "rb_dynamics"


@dataclass(frozen=True, slots=True)
class Latency:
    """The latency of a command to a node; the times of the sender are those of its clock.

    Attributes:
        time_ns: simulation time at which the command was read.
        topic: of the channel, as the scene writes it.
        sent_ns: ROS time at which it was sent.
        received_ns: ROS time at which it was received.
        acted_ns: ROS time at which it takes effect, without a delay of the channel.
        number: the sender's sequence number; 0 if unknown.
    """

    time_ns: int
    topic: str
    sent_ns: int
    received_ns: int
    acted_ns: int
    number: int


@dataclass(frozen=True, slots=True)
class Epoch:
    """From `time_ns` on, messages are stamped with simulation time + `epoch_ns`; logs keep simulation time.

    Attributes:
        time_ns: simulation time.
        epoch_ns: ROS time of simulation time 0.
    """

    time_ns: int
    epoch_ns: int


@dataclass(frozen=True, slots=True)
class Measurement:
    """A measurement of a sensor.

    Attributes:
        time_ns: simulation time at which it arrives, after the sensor's delay.
        taken_ns: time of the sample: the stamp of its message.
        topic: the name of the sensor, as the scene writes it.
        numbers: the numbers of its message, in their order.
    """

    time_ns: int
    taken_ns: int
    topic: str
    numbers: tuple[float, ...]


Event = (
    Sample
    | AppliedWrench
    | ReceivedWrench
    | RejectedWrench
    | ActuatorCommand
    | Measurement
    | Status
    | Epoch
    | StateChange
    | Latency
)


class Sink(Protocol):
    """Receives the events of a run: one `open`, then `write` in order of time, then one `close`.

    A sink may also have `write_block(block)`, see `run/event_arrays.py`. It then receives samples and changes of the
    wrench by the thousand if the run knows them in advance; other sinks receive them one by one. `write_block` may be
    None.
    """

    def open(self, run: RunInfo) -> None:
        """Prepare for `run`; called before the first `write`."""

    def write(self, event: Event) -> None:
        """Receive one event; times never decrease."""

    def close(self, result: Mapping[str, str]) -> None:
        """Receive the facts known only at the end (steps, hash of the states) and release all resources."""


__all__ = [
    "ActuatorCommand",
    "AppliedWrench",
    "Epoch",
    "Event",
    "Latency",
    "Measurement",
    "ReceivedWrench",
    "RejectedWrench",
    "RunInfo",
    "Sample",
    "Sink",
    "StateChange",
    "Status",
]
