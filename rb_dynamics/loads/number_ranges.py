"""`Range`: the numbers that an effect, an actuator or a sensor accepts, defined once for scenes and for Python."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from rb_dynamics.errors import SceneError
from rb_dynamics.numerics.argument_checks import number, vector
from rb_dynamics.numerics.nanoseconds import LONGEST, SHORTEST
from rb_dynamics.numerics.vector import ZERO, resized

if TYPE_CHECKING:
    from rb_dynamics.loads.effect import Effect
    from rb_dynamics.loads.scene_entry import SceneEntry


class Range(NamedTuple):
    """The finite numbers from `least` to `most` and greater than `above`, or zero: in words, and the remedy."""

    expected: str
    remedy: str
    least: float = -math.inf
    above: float = -math.inf
    most: float = math.inf
    or_zero: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a finite number is in the range."""
        return (self.least <= value <= self.most and value > self.above) or (self.or_zero and value == 0.0)

    def require(self, value: object, name: str) -> float:
        """Return a value as a float.

        Raises:
            TypeError: it is not a number.
            SceneError: it is out of the range.
        """
        found = number(value, name, self.expected, SceneError)
        if not self.holds(found):
            raise SceneError(f"{name} is {found!r}, expected {self.expected}")
        return found


# A shorter time would be rounded to no nanosecond.
TIME = Range(
    f"a time of 0 or from {SHORTEST:g} to {LONGEST:.1e} (s)", "write 0 for none", SHORTEST, most=LONGEST, or_zero=True
)


class Ranged(Protocol):
    """A frozen dataclass whose numbers have `ranges`; `kind` is its name in errors."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    kind: ClassVar[str]
    ranges: ClassVar[Mapping[str, Range]]


def check_numbers(item: Ranged) -> None:
    """Convert each number with a range to a float.

    Raises:
        TypeError: one is not a number.
        SceneError: one is out of its range.
    """
    for name, each in item.ranges.items():
        object.__setattr__(item, name, each.require(getattr(item, name), f"{item.kind}: {name}"))


def check_vector(item: Effect | Ranged, name: str, expected: str, *, direction: bool = False) -> None:
    """Convert the attribute `name` to three floats; a `direction` is scaled so that it can be normalised.

    Raises:
        TypeError: it is not a sequence of numbers.
        SceneError: it is not three finite numbers, or zero where a `direction` is needed.
    """
    found = vector(getattr(item, name), f"{item.kind}: {name}", expected, SceneError)
    if direction and found == ZERO:
        raise SceneError(f"{item.kind}: {name} is zero, expected {expected}; write one, as (0, 0, 1)")
    object.__setattr__(item, name, resized(found) if direction else found)


def read_numbers(kind: type[Ranged], entry: SceneEntry, names: Collection[str] = ()) -> dict[str, float]:
    """Return the numbers with a range in an entry of a scene, all or `names`; those without a default are required."""
    defaults = {each.name: None if each.default is MISSING else each.default for each in fields(kind)}
    return {
        name: entry.number(name, each.expected, each.holds, each.remedy, defaults[name])
        for name, each in kind.ranges.items()
        if not names or name in names
    }
