"""Read values of a document as the expected type: numbers, vectors, quaternions, names, sections.

Each reader records a problem and returns a usable placeholder, so that one pass finds all problems. `read.py` defines
the meaning of the values.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from rb_dynamics.formats.yaml.document import Node, is_decimal, join, show
from rb_dynamics.formats.yaml.problems import Problems, printable
from rb_dynamics.numerics.rotation import IDENTITY, NORM_TOLERANCE, Matrix, Quaternion, unit
from rb_dynamics.numerics.vector import ZERO, Vector


@dataclass(frozen=True, slots=True)
class Rule:
    """Condition on a number: in words, as a test for finite numbers, and the remedy."""

    expected: str
    accepts: Callable[[float], bool] = lambda _: True
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class Field:
    """One value, its dotted key, and where its problems are recorded."""

    node: Node
    key: str
    problems: Problems

    def reject(self, expected: str, remedy: str, found: str = "") -> None:
        """Record that this value is not what was `expected`; `found` replaces the value as written."""
        text = f"found {found or show(self.node)}, expected {expected}; {remedy}"
        self.problems.add(self.node.line, self.key, text)

    def section(self, known: Sequence[str], nested: Sequence[str] = ()) -> Section:
        """Return the mapping here, empty if there is none; keys that are not `known` are recorded.

        `nested` are dotted keys of sections in it, one of which may have been meant.
        """
        value = self.node.value
        if not isinstance(value, dict):
            self.reject(f"a mapping of {', '.join(known)}", "write key: value pairs, or remove the key")
            value = None
        section = Section(self, value or {})
        section.check(known, nested)
        return section

    def mapping(self, expected: str) -> dict[str, Field]:
        """Return the values by name of a mapping with arbitrary names."""
        if isinstance(self.node.value, dict):
            return Section(self, self.node.value).fields()
        self.reject(f"a mapping from names to {expected}", f"write name: {expected}, or remove the key")
        return {}

    def items(self, expected: str, remedy: str) -> list[Field]:
        """Return the items of the list here."""
        if isinstance(self.node.value, list):
            return self._list(self.node.value)
        self.reject(expected, remedy)
        return []

    def number(self, rule: Rule, default: float) -> float:
        """Return a finite number that `rule` accepts."""
        value = self.node.value
        if isinstance(value, float) and math.isfinite(value):
            if rule.accepts(value):
                return value
            self.reject(rule.expected, rule.remedy)
        else:
            self.reject(rule.expected, _number_remedy(self.node))
        return default

    def whole(self, rule: Rule, default: int) -> int:
        """Return a whole number that `rule` accepts, with all digits: a double has them up to 2^53 only."""
        value, text = self.number(rule, default), self.node.text
        if value == default:
            return default
        exact = Fraction(text if is_decimal(text) else value)
        if exact.denominator == 1 and rule.accepts(int(exact)):
            return int(exact)
        self.reject(rule.expected, rule.remedy)
        return default

    def flag(self, default: bool) -> bool:
        """Return a boolean."""
        if isinstance(self.node.value, bool):
            return self.node.value
        self.reject("true or false", "write true or false, without quotes")
        return default

    def text(self, expected: str, accepts: Callable[[str], bool], remedy: str, default: str) -> str:
        """Return a string that `accepts` accepts."""
        value = self.node.value
        if isinstance(value, str):
            if accepts(value):
                return value
            self.reject(expected, remedy)
        elif isinstance(value, (bool, float)):
            self.reject(expected, "YAML does not read this as text; put it in quotes")
        else:
            self.reject(expected, "write a single name")
        return default

    def vector(self, rule: Rule) -> Vector:
        """Return three numbers."""
        value = self.node.value
        if not isinstance(value, list) or len(value) != 3:
            self.reject(f"a list of 3 numbers, each {rule.expected}", "write it as [x, y, z]")
            return ZERO
        x, y, z = (item.number(rule, 0.0) for item in self._list(value))
        return (x, y, z)

    def matrix(self, rule: Rule) -> Matrix | None:
        """Return three rows of three numbers; None if the shape is wrong."""
        rows = self.node.value
        if not isinstance(rows, list) or len(rows) != 3:
            count = f"{len(rows)} values: " if isinstance(rows, list) else ""
            self.reject(
                "a 3 x 3 matrix",
                "write 3 rows of 3 numbers, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]",
                count + show(self.node),
            )
            return None
        first, second, third = (row.vector(rule) for row in self._list(rows))
        return (first, second, third)

    def quaternion(self) -> Quaternion:
        """Return a unit quaternion (x, y, z, w), normalised."""
        if isinstance(self.node.value, list):
            self.reject(
                "{x:, y:, z:, w:}", "name the components, so that their order is unambiguous: {x: 0, y: 0, z: 0, w: 1}"
            )
            return IDENTITY
        section = self.section(("x", "y", "z", "w"))
        rule = Rule("a component of a unit quaternion")
        x, y, z, w = (section.number(name, rule, math.nan, required=True) for name in ("x", "y", "z", "w"))
        norm = math.hypot(x, y, z, w)
        if math.isnan(norm):  # a component is missing or wrong, which has been recorded
            return IDENTITY
        found = unit((x, y, z, w))
        if found is None:
            self.reject(
                f"a unit quaternion, norm 1 within {NORM_TOLERANCE:g}",
                "divide each component by the norm",
                f"norm {norm!r} of {show(self.node)}",
            )
        return found or IDENTITY

    def _list(self, nodes: list[Node]) -> list[Field]:
        return [Field(node, f"{self.key}[{i}]", self.problems) for i, node in enumerate(nodes)]


@dataclass(frozen=True, slots=True)
class Section:
    """A mapping with known keys; `misspelt` holds the known keys that were probably meant by unknown ones."""

    field: Field
    values: dict[str, Node]
    misspelt: set[str] = dataclasses.field(default_factory=set)

    def check(self, known: Sequence[str], nested: Sequence[str] = ()) -> None:
        """Record every key that is not `known`, with the nearest known one or end of a name in `nested`."""
        ends = {key.rpartition(".")[2]: key for key in nested}
        for name, node in self.values.items():
            if name in known:
                continue
            import difflib

            near = difflib.get_close_matches(printable(name), known, n=1, cutoff=0.5)
            self.misspelt.update(near)
            if name in ends or not near:
                near = [ends[end] for end in difflib.get_close_matches(printable(name), ends, n=1)] or near
            remedy = f"did you mean {near[0]}?" if near else "remove it"
            text = f"found an unknown key, expected one of {', '.join(known)}; {remedy}"
            self.field.problems.add(node.key_line, join(self.field.key, name) or "''", text)

    def fields(self) -> dict[str, Field]:
        """Return every value by name, for sections with arbitrary keys."""
        return {
            name: Field(node, join(self.field.key, name), self.field.problems) for name, node in self.values.items()
        }

    def get(self, name: str) -> Field | None:
        """Return the value of `name`, None if it is absent."""
        node = self.values.get(name)
        return None if node is None else Field(node, join(self.field.key, name), self.field.problems)

    def missing(self, name: str, expected: str, remedy: str) -> None:
        """Record that the required key `name` is absent, unless that follows from a problem already recorded."""
        if isinstance(self.field.node.value, dict) and name not in self.misspelt:
            text = f"found nothing, expected {expected}; {remedy}"
            self.field.problems.add(self.field.node.key_line, join(self.field.key, name), text)

    def section(self, name: str, known: Sequence[str]) -> Section:
        """Return the section `name`, empty if it is absent."""
        field = self.get(name)
        if field is not None:
            return field.section(known)
        empty = Node({}, self.field.node.line, self.field.node.key_line)
        return Section(Field(empty, join(self.field.key, name), self.field.problems), {})

    def number(self, name: str, rule: Rule, default: float, *, required: bool = False) -> float:
        """Return the number `name`, `default` if it is absent."""
        field = self._given(name, rule, required)
        return default if field is None else field.number(rule, default)

    def whole(self, name: str, rule: Rule, default: int, *, required: bool = False) -> int:
        """Return the whole number `name`, `default` if it is absent."""
        field = self._given(name, rule, required)
        return default if field is None else field.whole(rule, default)

    def _given(self, name: str, rule: Rule, required: bool) -> Field | None:
        """Return the field `name`; None if it is absent, which is a problem if it is `required`."""
        field = self.get(name)
        if field is None and required:
            self.missing(name, rule.expected, f"add the key {name}")
        return field

    def vector(self, name: str, rule: Rule) -> Vector:
        """Return the vector `name`, zero if it is absent."""
        field = self.get(name)
        return ZERO if field is None else field.vector(rule)

    def quaternion(self, name: str) -> Quaternion:
        """Return the unit quaternion `name`, the identity if it is absent."""
        field = self.get(name)
        return IDENTITY if field is None else field.quaternion()


def _number_remedy(node: Node) -> str:
    """Return the remedy for a value that is not a finite number, and how YAML reads it if that may surprise."""
    value = node.value
    if isinstance(value, bool):
        return "true and false (in YAML also yes, no, on, off) are not numbers, write digits"
    if isinstance(value, (list, dict)):
        return "write a single number"
    if value is None:
        return "give the key a value, or remove it"
    if isinstance(value, float) or value.lower().strip("+-.") in ("nan", "inf", "infinity"):
        return "infinities and NaN are not accepted, write a finite number"
    if node.quoted and is_decimal(value):
        return "remove the quotes around the number"
    return "write a finite number in plain decimals, such as 16.8 or 1.0e-3, without a unit"
