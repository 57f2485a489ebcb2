"""`Health`: counts problems with commands, and summarizes the state of the node in one diagnostics status.

`Throttle` limits repeated warnings in the log. Neither depends on ROS.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from rb_dynamics.loads.reaction_wheel import NEAR_LIMIT, ReactionWheel
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, seconds_text
from rb_dynamics.ros.command_statistics import Arrival
from rb_dynamics.ros.pacing import ClockFollower, Pacer
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Status

OK, WARN, ERROR = 0, 1, 2
_PERIOD_NS = NANOSECONDS
# Number of different warnings logged per second.
_REASONS = 5
# Characters of a warning or failure: a peer must not make the node log a megabyte every second.
_LONGEST = 1000
_NUMBER = re.compile(r"\d[\d.e+-]*")


@dataclass(slots=True)
class StateCounts:
    """Counts of the states received on ~/set_state."""

    accepted: int = 0
    rejected: int = 0
    left_out: int = 0


@dataclass(slots=True)
class _Counts:
    accepted: int = 0
    rejected: int = 0
    early: int = 0
    late: int = 0
    duplicate: int = 0
    superseded: int = 0
    lost: int = 0
    clipped: int = 0
    missed: int = 0


class Throttle:
    """Passes each message once a second, and a few different ones; texts that differ only in numbers count as equal."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Use `clock`, a steady clock in s."""
        self._clock = clock
        self._said: dict[str, float] = {}

    def lets(self, message: str) -> bool:
        """Return whether `message` should be logged."""
        now, reason = self._clock(), _NUMBER.sub("", message)
        self._said = {each: at for each, at in self._said.items() if now - at < 1.0}
        if reason in self._said or len(self._said) == _REASONS:
            return False
        self._said[reason] = now
        return True


class Health:
    """The content of `/diagnostics`. A warning stays for the whole run, as it may happen when no one is watching.

    A condition is a warning that disappears when it no longer holds.

    Attributes:
        unheard: number of topics with commands to actuators that are not there.
    """

    def __init__(self, name: str, topics: Sequence[str], say: Callable[[int, str], None]) -> None:
        """Start without problems of the node `name` and its wrench `topics`; `say` logs a level and a message."""
        self._name, self._topics, self._say = name, tuple(topics), say
        self._next_ns = time.monotonic_ns()
        # Conditions outside this node; a reset does not change them.
        self._conditions: dict[str, str] = {}
        self.unheard = 0
        self.clear()

    def clear(self) -> None:
        """Clear everything for a new run."""
        self._counts = {topic: _Counts() for topic in self._topics}
        self.states = StateCounts()
        self._mismatches: dict[str, int] = {}
        self._warning = self._failure = self._pause = ""

    @property
    def failure(self) -> str:
        """Why the run is paused, or else the newest failure, or ""."""
        return self._pause or self._failure

    def paused(self, message: str) -> None:
        """Record why the run is paused, until it continues; what is recorded already is not said again."""
        message = _cut(message)
        if message != self._pause:
            self._say(ERROR, message)
        self._pause = message

    def went_on(self) -> None:
        """The run continues; the newest warning says that it was paused, and why."""
        if self._pause:
            self._warning, self._pause = _cut(f"went on after it had {self._pause}"), ""
            self._say(WARN, self._warning)

    def accepted(self, topic: str, arrival: Arrival | None) -> None:
        """Count a command, and how it arrived if stamps matter."""
        counts = self._counts[topic]
        counts.accepted += 1
        counts.early += arrival is Arrival.EARLY
        counts.late += arrival is Arrival.LATE
        counts.duplicate += arrival is Arrival.DUPLICATE

    def superseded(self, topic: str) -> None:
        """Count a command that came after a newer one had taken effect."""
        self._counts[topic].superseded += 1

    def overtaken(self, topic: str) -> None:
        """Count a command as superseded that was accepted at first."""
        self._counts[topic].accepted -= 1
        self._counts[topic].superseded += 1

    def rejected(self, topic: str) -> None:
        """Count a rejected command."""
        self._counts[topic].rejected += 1

    def taken_back(self, topic: str) -> None:
        """Count a command as rejected that was accepted at first."""
        self._counts[topic].accepted -= 1
        self._counts[topic].rejected += 1

    def clipped(self, topic: str) -> None:
        """Count a command reduced by the limits of its channel; it is also counted as accepted."""
        self._counts[topic].clipped += 1

    def missed(self, topic: str) -> None:
        """Count a command that missed its deadline; it is also counted as accepted."""
        self._counts[topic].missed += 1

    def lost(self, topic: str, number: int) -> None:
        """Count lost commands."""
        self._counts[topic].lost += number

    def mismatched(self, topic: str, number: int) -> None:
        """Count peers with incompatible QoS on `topic`: no message will ever pass between us."""
        self._mismatches[topic] = self._mismatches.get(topic, 0) + number

    def holds(self, condition: str, message: str) -> None:
        """Warn of a condition while it holds; an empty `message` ends it."""
        message = _cut(message)
        if message and message != self._conditions.get(condition):
            self._say(WARN, message)
        self._conditions[condition] = message

    def told(self, message: str) -> None:
        """Log a request that was carried out; it is not a problem."""
        self._say(OK, message)

    def warn(self, message: str) -> None:
        """Record the newest warning."""
        self._warning = _cut(message)
        self._say(WARN, self._warning)

    def failed(self, message: str) -> None:
        """Record the newest failure."""
        self._failure = _cut(message)
        self._say(ERROR, self._failure)

    def due(self) -> bool:
        """Return whether a second has passed since this last returned True."""
        now = time.monotonic_ns()
        if now < self._next_ns:
            return False
        self._next_ns = now + _PERIOD_NS
        return True

    def hold_wheels(self, simulation: Simulation) -> list[tuple[ReactionWheel, float]]:
        """Warn of each wheel while it is near its largest speed; return the wheels with their speeds (rad/s)."""
        found = list(zip(simulation.scene.wheels, simulation.sample.wheel_speeds or (), strict=False))
        for wheel, speed in found:
            limit = f"max_speed of {wheel.max_speed:g} rad/s"
            near = f"{wheel.name} is near its {limit}, beyond which its motor does not drive it"
            self.holds(f"speed of {wheel.name}", near if abs(speed) >= NEAR_LIMIT * wheel.max_speed else "")
        return found

    def status(self, simulation: Simulation, pacer: Pacer | ClockFollower, state: str, awaited: str = "") -> Status:
        """Return the status of the node in `state`, and what it waits for."""
        sample = simulation.sample
        offset_ns = pacer.offset_ns
        stamp = "none yet" if offset_ns is None else f"{seconds_text(max(1, sample.time_ns + offset_ns))} s"
        values = {
            "state": state,
            "simulation time": f"{sample.time_ns / 1e9:.9f} s",
            "header.stamp": stamp,
            "method": simulation.plan.description,
            "steps": str(simulation.steps),
            "energy defect": f"{sample.energy_defect:.3g} J",
            "angular momentum defect": f"{math.hypot(*sample.angular_momentum_defect_world):.3g} kg m^2/s",
            "linear momentum defect": f"{math.hypot(*sample.linear_momentum_defect_world):.3g} kg m/s",
            **pacer.values(),
        }
        for topic, counts in self._counts.items():
            values |= {f"{topic}: {name}": str(count) for name, count in asdict(counts).items()}
        if any(asdict(self.states).values()):
            states = asdict(self.states).items()
            values |= {f"~/set_state: {name.replace('_', ' ')}": str(count) for name, count in states}
        values |= {f"{topic}: incompatible QoS": str(count) for topic, count in self._mismatches.items()}
        if self.unheard:
            values["topics of absent actuators"] = str(self.unheard)
        for wheel, speed in self.hold_wheels(simulation):
            values[f"{wheel.name}: speed"] = f"{speed:.6g} rad/s"
        wrong = [
            (ERROR, self._pause),
            (ERROR, self._failure),
            (WARN, self._warning),
            (WARN, pacer.warning()),
            *((WARN, message) for message in self._conditions.values()),
        ]
        level = max((each for each, message in wrong if message), default=OK)
        message = "; ".join(message for each, message in wrong if message and each == level) or state + awaited
        return Status(sample.time_ns, level, message, values, self._name)


def _cut(message: str) -> str:
    return message if len(message) <= _LONGEST else f"{message[:_LONGEST]}..."
