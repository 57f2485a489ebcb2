"""`SceneEntry`: one entry of a list of effects, actuators or sensors in a scene, from which each kind reads its values.

Every problem is recorded with its line, so that one error reports all of them; the returned value is then a
placeholder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats.yaml.fields import Rule, Section
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.numerics.nanoseconds import LONGEST
from rb_dynamics.numerics.vector import ZERO, Vector

_TIME = Rule(f"a number from 0 to {LONGEST:.1e} (s)", lambda v: 0.0 <= v <= LONGEST, "write the time since the start")


def _any(_: float) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class SceneEntry:
    """The values of one entry, and what is needed to check them.

    Attributes:
        section: the values by key.
        body: the body of the scene; None if the scene has no valid one.
        frames: the frames that wrenches may be given in.
    """

    section: Section
    body: RigidBody | None
    frames: WrenchFrames

    @property
    def is_particle(self) -> bool:
        """Whether the body is a particle."""
        return self.body is not None and self.body.is_particle

    @property
    def name(self) -> str:
        """The text at the key `name`; its faults have been recorded."""
        node = self.section.values.get("name")
        return node.value if node is not None and isinstance(node.value, str) else ""

    def has(self, name: str) -> bool:
        """Return whether the entry has the key `name`."""
        return name in self.section.values

    def is_list(self, name: str) -> bool:
        """Return whether the value of `name` is a list."""
        field = self.section.get(name)
        return field is not None and isinstance(field.node.value, list)

    def reject(self, expected: str, remedy: str, key: str = "") -> None:
        """Record that the entry, or its value at `key` if there is one, is not what was `expected`."""
        field = self.section.get(key) if key else self.section.field
        if field is not None:
            field.reject(expected, remedy)

    def number(
        self,
        name: str,
        expected: str,
        accepts: Callable[[float], bool] = _any,
        remedy: str = "",
        default: float | None = None,
    ) -> float:
        """Return the finite number at `name` that `accepts` accepts; required if there is no `default`."""
        rule = Rule(expected, accepts, remedy)
        return self.section.number(name, rule, 1.0 if default is None else default, required=default is None)

    def vector(self, name: str, expected: str, default: Vector | None = None) -> Vector:
        """Return the three finite numbers at `name`; required if there is no `default`."""
        field = self.section.get(name)
        if field is not None:
            return field.vector(Rule(expected))
        if default is None:
            self.section.missing(name, f"a list of 3 numbers, each {expected}", f"add {name}: [x, y, z]")
        return default or ZERO

    def inner(self, name: str, keys: Sequence[str]) -> SceneEntry | None:
        """Return the mapping at `name`, which may have these keys; None if it is absent."""
        field = self.section.get(name)
        return None if field is None else SceneEntry(field.section(keys), self.body, self.frames)

    def per_axis(self, name: str, expected: str, accepts: Callable[[float], bool] = _any, remedy: str = "") -> Vector:
        """Return one number per body axis, zero if `name` is absent; a single number applies to all axes."""
        rule, field = Rule(expected, accepts, remedy), self.section.get(name)
        if field is None:
            return ZERO
        if isinstance(field.node.value, list):
            return field.vector(rule)
        value = field.number(rule, 0.0)
        return (value, value, value)

    def flag(self, name: str, default: bool = False) -> bool:
        """Return a boolean."""
        field = self.section.get(name)
        return default if field is None else field.flag(default)

    def text(self, name: str, expected: str, default: str) -> str:
        """Return a string."""
        field = self.section.get(name)
        return default if field is None else field.text(expected, lambda _: True, "write a name", default)

    def choice(self, name: str, among: Sequence[str], default: str) -> str:
        """Return one of several words."""
        field, words = self.section.get(name), " or ".join(among)
        return default if field is None else field.text(words, lambda text: text in among, f"write {words}", default)

    def direction(self, name: str, remedy: str) -> Vector:
        """Return a vector that is not zero; required."""
        found = self.vector(name, "a finite number")
        if found == ZERO:
            if self.has(name):
                self.reject("a direction, not zero", remedy, name)
            return (0.0, 0.0, 1.0)
        return found

    def timeline(self, name: str, keys: Sequence[str], expected: str, remedy: str) -> list[tuple[float, SceneEntry]]:
        """Return the entries of a list, each with its `time` (s) and `keys`, in ascending order of time."""
        field = self.section.get(name)
        if field is None:
            self.section.missing(name, expected, remedy)
            return []
        entries = []
        for item in field.items(expected, remedy):
            values = item.section(("time", *keys))
            time = values.number("time", _TIME, 0.0, required=True)
            entries.append((time, SceneEntry(values, self.body, self.frames)))
        times = [time for time, _ in entries]
        if not times:
            field.reject("at least one entry", "add one, or remove the effect")
        if any(later <= earlier for earlier, later in pairwise(times)):
            remedy = "sort the entries and give each its own time"
            field.reject("times that grow from entry to entry", remedy, str(times))
        return entries
