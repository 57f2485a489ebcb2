"""`InputHash`: a SHA-256 that is equal exactly if scene and commands agree, in whatever order commands arrived.

`AppliedHash` is its predecessor, over the loads in the order in which they were applied: that of logs without
`inputs_rule`.
"""

from __future__ import annotations

import hashlib
import struct
from operator import itemgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.loads.actuator import ActuatorCommand
    from rb_dynamics.loads.wrench_channels import AppliedWrench
    from rb_dynamics.loads.wrench_command_arrays import Changes
    from rb_dynamics.run.state_change import StateChange
    from rb_dynamics.scene.model import Scene

RULE = "2"
"""Value of `inputs_rule` that belongs to `InputHash`."""

_NUMBERS, _MOVE = struct.Struct("<6d"), struct.Struct("<13d")


class InputHash:
    """SHA-256 over the text of a scene and every command that took effect on one of its channels, in order of time.

    Commands of the same nanosecond are ordered by the scene's channels, those of one channel by arrival. Each is a line
    of UTF-8, `TIME TOPIC STAMP NUMBERS FRAME` and a newline: when it took effect and its stamp (ns), the topic as
    written in the scene, force and torque as 6 float64, little endian, in 96 hexadecimal digits, and its `frame_id`.
    """

    def __init__(self, scene: Scene) -> None:
        """Start with the scene."""
        self._hash = hashlib.sha256(scene.text.encode())
        self._places = {channel.topic: place for place, channel in enumerate(scene.channels)}
        self._actuators = {actuator.topic: place for place, actuator in enumerate(scene.actuators)}
        self._time_ns = 0
        self._lines: list[tuple[int, str]] = []

    def update(self, applied: AppliedWrench) -> None:
        """Add a change of load; timeouts and effects follow from the scene and do not count."""
        command, place = applied.received, self._places.get(applied.topic)
        if command is None or place is None:
            return
        if applied.time_ns > self._time_ns:
            self._end_nanosecond()
            self._time_ns = applied.time_ns
        numbers = _NUMBERS.pack(*command.force, *command.torque).hex()
        line = f"{applied.time_ns} {applied.topic} {command.stamp_ns} {numbers} {command.frame_id}\n"
        self._lines.append((place, line))

    def move(self, change: StateChange) -> None:
        """Add a change of state, after all commands of its nanosecond: `TIME ~/set_state NUMBERS`, 13 float64."""
        if change.time_ns > self._time_ns:
            self._end_nanosecond()
            self._time_ns = change.time_ns
        pose = *change.position_world, *change.orientation_xyzw
        numbers = _MOVE.pack(*pose, *change.linear_velocity_body, *change.angular_velocity_body).hex()
        place = len(self._places) + len(self._actuators)
        self._lines.append((place, f"{change.time_ns} ~/set_state {numbers}\n"))

    def update_all(self, changes: Changes) -> None:
        """Add changes that come after all before, or at the time of the last of them."""
        import numpy as np

        commanded = (changes.row >= 0) & (changes.channel < len(self._places))
        rows, came = changes.row[commanded], changes.came
        numbers = np.ascontiguousarray(came.wrench[rows], dtype="<f8").tobytes().hex()
        columns = changes.time_ns[commanded], changes.channel[commanded], came.stamp_ns[rows], came.frame[rows]
        lines = [
            f"{time_ns} {changes.topics[place]} {stamp_ns} {numbers[96 * i : 96 * i + 96]} {came.frame_ids[frame]}\n"
            for i, (time_ns, place, stamp_ns, frame) in enumerate(zip(*(c.tolist() for c in columns), strict=True))
        ]
        times, places = columns[:2]
        # Only the first nanosecond may have lines already, and only the last may get more.
        first, last = times.searchsorted(self._time_ns, "right"), times.searchsorted(times.max(initial=0))
        self._lines += zip(places[:first].tolist(), lines[:first], strict=True)
        if first < len(lines):
            self._end_nanosecond()
            order = np.lexsort((places[first:last], times[first:last])) + first
            self._hash.update("".join([lines[i] for i in order.tolist()]).encode("utf-8", "replace"))
            self._lines += zip(places[last:].tolist(), lines[last:], strict=True)
            self._time_ns = int(times[-1])

    def actuate(self, command: ActuatorCommand) -> None:
        """Add a command to an actuator, after those on channels of its nanosecond: `TIME TOPIC NUMBER`.

        Those of several actuators come in the order of the scene.
        """
        if command.time_ns > self._time_ns:
            self._end_nanosecond()
            self._time_ns = command.time_ns
        number = struct.pack("<d", command.value).hex()
        place = len(self._places) + self._actuators[command.topic]
        self._lines.append((place, f"{command.time_ns} {command.topic} {number}\n"))

    def hexdigest(self) -> str:
        """Return the hash so far; later changes must not have the same nanosecond."""
        self._end_nanosecond()
        return self._hash.hexdigest()

    def _end_nanosecond(self) -> None:
        if len(self._lines) > 1:
            self._lines.sort(key=itemgetter(0))
        for _, line in self._lines:
            self._hash.update(line.encode("utf-8", "replace"))
        self._lines.clear()


class AppliedHash:
    """SHA-256 over the text of a scene and every change of load, effects and timeouts included, in the given order."""

    def __init__(self, scene: Scene) -> None:
        """Start with the scene."""
        self._hash = hashlib.sha256(scene.text.encode())

    def update(self, applied: AppliedWrench) -> None:
        """Add one change."""
        came = applied.received
        received = came and (
            f"Wrench(force={came.force!r}, torque={came.torque!r}, frame_id={came.frame_id!r}, "
            f"stamp_ns={came.stamp_ns!r})"
        )
        line = (
            f"AppliedWrench(time_ns={applied.time_ns!r}, topic={applied.topic!r}, received={received}, "
            f"frame_id={applied.frame_id!r}, force={applied.force!r}, torque={applied.torque!r})"
        )
        self._hash.update(line.encode())

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return self._hash.hexdigest()
