"""A scheduled wrench: commands written in the scene itself, each held until the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.argument_checks import items, number, shown
from rb_dynamics.numerics.vector import ZERO

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


@dataclass(frozen=True)
class ScheduledWrench(Effect):
    """Wrenches with the time (s) at which each begins, in order; the wrench rule says in which axes and where they act.

    Energy: their work is accumulated like that of any wrench; there is no potential.
    """

    kind: ClassVar[str] = "scheduled_wrench"
    keys: ClassVar[tuple[str, ...]] = ("frame_id", "schedule")

    entries: tuple[tuple[float, Wrench], ...]

    def __post_init__(self) -> None:
        """Copy and check the entries.

        Raises:
            TypeError: an entry is not a pair of a time and a wrench.
            SceneError: a time is not finite, or negative.
        """
        entries = []
        for k, entry in enumerate(items(self.entries, "scheduled_wrench: entries", "(time, wrench) pairs")):
            name, expected = f"scheduled_wrench: entries[{k}]", "a pair of time (s, 0 or more) and Wrench"
            found = items(entry, name, expected)
            if len(found) != 2 or not isinstance(found[1], Wrench):
                raise TypeError(f"{name} is {shown(entry)}, expected {expected}; write (0.0, Wrench(...))")
            entries.append((number(found[0], name, expected, SceneError, least=0.0), found[1]))
        object.__setattr__(self, "entries", tuple(entries))

    @classmethod
    def read(cls, entry: SceneEntry) -> ScheduledWrench:
        """Return the effect of an entry."""
        frame_id = entry.text("frame_id", "the name of a frame", "")
        entries = []
        remedy = "write schedule: [{time: 0, force: [0, 0, 1], torque: [0, 0, 0]}]"
        for time, at in entry.timeline("schedule", ("force", "torque"), "a list of wrenches", remedy):
            force, torque = (
                at.vector("force", "a finite number (N)", ZERO),
                at.vector("torque", "a finite number (N m)", ZERO),
            )
            wrench = Wrench(force, torque, frame_id)
            entries.append((time, wrench))
            if entry.body is not None:
                try:
                    entry.frames.hold(wrench)
                except WrenchError as error:
                    at.reject("a wrench that can act", str(error))
        return cls(tuple(entries))

    def schedule(self, body: RigidBody) -> tuple[tuple[float, Wrench], ...]:
        """Return the entries."""
        return self.entries
