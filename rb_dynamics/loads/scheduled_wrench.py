"""A scheduled wrench: commands that the scene itself gives, each held until the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.wrench import Wrench


@dataclass(frozen=True)
class ScheduledWrench(Effect):
    """Wrenches by the time (s) at which each begins, in order; the wrench rule says in which axes and where they act.

    Energy: their work is booked like that of any wrench; there is no potential.
    """

    kind: ClassVar[str] = "scheduled_wrench"

    entries: tuple[tuple[float, Wrench], ...]

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the entries."""
        return self.entries
