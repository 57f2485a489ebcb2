"""`Health`: counts what went wrong with commands, and puts the state of the node into one diagnostics status."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from rb_dynamics.recording.sink import Status
from rb_dynamics.ros.pacing import Pacer
from rb_dynamics.simulate import Simulation

OK, WARN, ERROR = 0, 1, 2
_PERIOD_NS = 1_000_000_000


@dataclass(slots=True)
class _Counts:
    accepted: int = 0
    rejected: int = 0
    late: int = 0
    lost: int = 0


class Health:
    """What `/diagnostics` says. A warning stays for the run: nobody has to be looking when it happens."""

    def __init__(self, name: str, topics: Sequence[str]) -> None:
        """Begin with no complaints about the node `name` and its wrench `topics`."""
        self._name = name
        self._counts = {topic: _Counts() for topic in topics}
        self._warning = ""
        self._failure = ""
        self._next_ns = time.monotonic_ns()

    @property
    def failure(self) -> str:
        """The newest failure, or ""."""
        return self._failure

    def accepted(self, topic: str, late: bool) -> None:
        """Count a command, and whether its stamp had passed."""
        self._counts[topic].accepted += 1
        self._counts[topic].late += late

    def rejected(self, topic: str) -> None:
        """Count a command that was not honoured."""
        self._counts[topic].rejected += 1

    def lost(self, topic: str, number: int) -> None:
        """Count commands that the middleware lost."""
        self._counts[topic].lost += number

    def warn(self, message: str) -> None:
        """Remember the newest warning."""
        self._warning = message

    def failed(self, message: str) -> None:
        """Remember the newest failure."""
        self._failure = message

    def due(self) -> bool:
        """Return whether a second has passed since this last returned True."""
        now = time.monotonic_ns()
        if now < self._next_ns:
            return False
        self._next_ns = now + _PERIOD_NS
        return True

    def status(self, simulation: Simulation, pacer: Pacer, state: str) -> Status:
        """Return the status of the node."""
        sample = simulation.sample
        values = {
            "state": state,
            "time": f"{sample.time_ns / 1e9:.9f} s",
            "method": simulation.plan.description,
            "steps": str(simulation.steps),
            "energy defect": f"{sample.energy_defect:.3g} J",
            "angular momentum defect": f"{math.hypot(*sample.angular_momentum_defect_world):.3g} kg m^2/s",
            "linear momentum defect": f"{math.hypot(*sample.linear_momentum_defect_world):.3g} kg m/s",
            "real-time factor": f"{pacer.factor:g}",
            "overruns": str(pacer.overruns),
            "time dropped": f"{pacer.dropped_ns / 1e9:.3f} s",
        }
        for topic, counts in self._counts.items():
            values |= {
                f"{topic}: accepted": str(counts.accepted),
                f"{topic}: rejected": str(counts.rejected),
                f"{topic}: late": str(counts.late),
                f"{topic}: lost": str(counts.lost),
            }
        if self._failure:
            return Status(sample.time_ns, ERROR, self._failure, values, self._name)
        if self._warning:
            return Status(sample.time_ns, WARN, self._warning, values, self._name)
        if pacer.overruns:
            message = f"{pacer.overruns} overruns: the machine is too slow for this"
            return Status(sample.time_ns, WARN, message, values, self._name)
        return Status(sample.time_ns, OK, state, values, self._name)
