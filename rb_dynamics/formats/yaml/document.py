"""YAML text as a tree of plain values with line numbers.

Size, depth and number of values are bounded, so that no input takes much time or memory. Tags are refused, so that no
object is ever constructed from a file. `read.py` defines the keys of a scene.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, TypeAlias, TypeVar

import yaml

from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml.problems import Problems, printable
from rb_dynamics.numerics import number_parsing

MAX_CHARACTERS = 1 << 20
MAX_DEPTH = 32
MAX_VALUES = 100_000

Value: TypeAlias = "bool | float | str | list[Node] | dict[str, Node] | None"

# YAML 1.1 reads 1e-9 as text, 010 as octal, 1_000 as 1000 and 1:30 as 90. Here a number is what people and other
# languages write in decimal, and anything else stays text and is reported if a number is expected.
_WHOLE = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"[-+]?0[0-9]")
_NOT_FINITE = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")


@dataclass(slots=True)
class Node:
    """One value of a document.

    Attributes:
        value: every number is a float; mappings keep the order of the file.
        line: where the value begins, from 1; None if it comes from an override.
        key_line: line of its key; the value's line for an item of a list.
        text: a scalar as written, for messages.
        quoted: whether a scalar was in quotes.
    """

    value: Value
    line: int | None = None
    key_line: int | None = None
    text: str = ""
    quoted: bool = False


def parse(text: str, problems: Problems, kind: str = "scene", needed: str = "body") -> Node:
    """Return the mapping in `text`; duplicate keys are added to `problems`.

    Messages call it a `kind` with the key `needed`.

    Raises:
        SceneError: the text is not YAML, not one mapping, or beyond the limits of this module.
    """
    source = problems.source
    root = _loaded(text, source, kind, _Loader, _Loader.get_single_node)
    if root is None:
        raise SceneError(f"{source}: found an empty document, expected a {kind}; it needs at least the key {needed}")
    document = _Converter(problems).convert(root, 0)
    if not isinstance(document.value, dict):
        raise SceneError(
            f"{source}:{document.line}: found {show(document)}, expected a mapping with the key {needed}; "
            f"check that this is a {kind} file"
        )
    return document


def holds(document: Node, keys: Iterable[str], absent: str) -> bool:
    """Return whether `document` is a mapping with all of these `keys`, and without the one that is `absent`."""
    value = document.value
    return isinstance(value, dict) and absent not in value and all(key in value for key in keys)


def load(text: str, source: str, kind: str) -> object:
    """Return the plain values in `text` from another program, as PyYAML reads it, without aliases.

    Raises:
        SceneError: the text is not YAML, has aliases, or is beyond the limits of this module.
    """
    return _loaded(text, source, kind, _PlainLoader, _PlainLoader.get_single_data)


def value_of(text: str, source: str) -> object:
    """Return the node for `text` as the value of a key.

    Raises:
        SceneError: it is not YAML, has a key twice, or goes on with another key.
    """
    problems = Problems(source)
    document = parse(f"value: {text}", problems).value
    keys = document if isinstance(document, dict) else {}
    for key, node in keys.items():
        if key != "value":
            problems.add(node.key_line, key, "found another key, expected one value; give each an option of its own")
    if problems:
        raise problems.error()
    return plain(keys["value"])


def plain(node: Node, as_written: bool = False) -> object:
    """Return `node` as numbers, strings, lists and mappings of Python; long whole numbers keep all digits.

    `as_written`: other whole numbers are integers, too, where they are written as such.
    """
    if isinstance(node.value, dict):
        return {key: plain(value, as_written) for key, value in node.value.items()}
    if isinstance(node.value, list):
        return [plain(item, as_written) for item in node.value]
    if isinstance(node.value, float) and _WHOLE.fullmatch(node.text):
        whole = int(node.text)
        # -0 is not 0.
        if abs(node.value) > 2.0**53 or (as_written and node.text == str(whole)):
            return whole
    return node.value


def from_python(value: object) -> Node:
    """Return `value` (scalar, sequence, mapping or array) as a node of an override."""
    if type(value) is float:
        return Node(value, text=repr(value))
    tolist = getattr(value, "tolist", None)  # numpy and array.array, without importing either
    if callable(tolist):
        value = tolist()
    if value is None or isinstance(value, bool):
        return Node(value, text={None: "null", True: "true", False: "false"}[value])
    if isinstance(value, Real):
        return Node(_float(value), text=repr(value))
    if isinstance(value, str):
        return Node(value, text=value, quoted=True)
    if isinstance(value, Mapping):
        return Node({str(key): from_python(item) for key, item in value.items()})
    if isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return Node([from_python(item) for item in value])
    return Node(None, text=repr(value))


def to_text(document: Node, comment: str) -> str:
    """Return YAML that `parse` reads as `document`, headed by `comment`."""
    values = plain(document, as_written=True)
    body = yaml.dump(values, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return f"# {printable(comment, 1000)}\n{body}"


def show(node: Node, limit: int = 60) -> str:
    """Return the value of `node` as written, on one line and cut at `limit` characters."""
    value = node.value
    if isinstance(value, list):
        return printable(f"[{', '.join(show(item) for item in value[:10])}{', ...' if len(value) > 10 else ''}]", limit)
    if isinstance(value, dict):
        items = [f"{printable(key)}: {show(item)}" for key, item in list(value.items())[:10]]
        return printable("{" + ", ".join(items) + (", ..." if len(value) > 10 else "") + "}", limit)
    if value is None and node.text in ("", "null", "~"):
        return "nothing"
    return printable(f"'{node.text}'" if node.quoted else node.text, limit)


def is_decimal(text: str) -> bool:
    """Return whether `text` is a number in decimal notation."""
    return number_parsing.is_decimal(text) and _OCTAL.match(text) is None


class _Dumper(yaml.SafeDumper):
    """PyYAML's dumper, with quotes around text that `parse` would read as a number, such as '1e-9'."""


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="'" if is_decimal(text) else None)


_Dumper.add_representer(str, _represent_text)


class _Loader(yaml.SafeLoader):
    """PyYAML's composer, stopped at the limits of this module while it composes."""

    def __init__(self, text: str, source: str) -> None:
        super().__init__(text)
        self._source = source
        self._depth = 0
        self._count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise SceneError(
                f"{self._source}:{line}: found the YAML tag {printable(tag)}, expected plain values; remove the tag"
            )
        self._count += 1
        _check_limits(self._depth, self._count, self._source, line)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


_L = TypeVar("_L", bound=_Loader)
_T = TypeVar("_T")


class _PlainLoader(_Loader):
    """The same without aliases: merged ones (<<: *name) could expand to very many values."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise SceneError(f"{self._source}: found an alias (*name), expected plain values; write it out")
        return super().compose_node(parent, index)


def _check_limits(depth: int, count: int, source: str, line: int) -> None:
    if depth > MAX_DEPTH:
        raise SceneError(
            f"{source}:{line}: found values nested more than {MAX_DEPTH} deep, expected fewer levels; "
            "check the brackets and aliases (*name)"
        )
    if count > MAX_VALUES:
        raise SceneError(
            f"{source}:{line}: found more than {MAX_VALUES} values, those behind aliases (*name) counted each time, "
            "expected fewer; write a smaller file"
        )


def _loaded(text: str, source: str, kind: str, loads: type[_L], take: Callable[[_L], _T]) -> _T:
    """Return the result of `take` with a loader of `text`; PyYAML's errors become ours."""
    if len(text) > MAX_CHARACTERS:
        raise SceneError(
            f"{source}: found {len(text)} characters, expected at most {MAX_CHARACTERS}; a {kind} is a short text, "
            "check that this is the right file"
        )
    try:
        loader = loads(text, source)
        try:
            return take(loader)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        raise _not_yaml(error, source) from error
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise SceneError(
            f"{source}:{line}: found the character {chr(error.character)!a}, expected a text file in UTF-8; "
            "check that this is the right file"
        ) from error
    except (ValueError, OverflowError) as error:  # bugs of PyYAML, as for "\UFFFFFFFF"
        raise SceneError(
            f"{source}: found no valid YAML ({error}), expected a text in it; check escapes such as \\U in quotes"
        ) from error


def _not_yaml(error: yaml.MarkedYAMLError, source: str) -> SceneError:
    mark = error.problem_mark or error.context_mark
    place = f"{source}:{mark.line + 1}" if mark else source
    what = ", ".join(text for text in (error.context, error.problem) if text)
    tab = "'\\t'" in what
    remedy = "indent with spaces, not with tabs" if tab else _YAML_REMEDIES.get(error.problem or "", _MEND)
    return SceneError(f"{place}: found no valid YAML ({what}), expected key: value pairs; {remedy}")


_MEND = "correct this line or the one above it"
_YAML_REMEDIES = {
    "mapping values are not allowed here": "check the indentation and the colons of this line and the one above it",
    "could not find expected ':'": "write a space after each colon, and close brackets and quotes",
}


@dataclass
class _Converter:
    """Turns PyYAML's nodes into ours; aliases are expanded, and counted at each use."""

    problems: Problems
    count: int = field(default=0, init=False)

    def convert(self, node: yaml.Node, depth: int, key: str = "", key_line: int | None = None) -> Node:
        self.count += 1
        line = node.start_mark.line + 1
        _check_limits(depth, self.count, self.problems.source, line)
        if isinstance(node, yaml.ScalarNode):
            return Node(_scalar(node), line, key_line or line, node.value, node.style is not None)
        if isinstance(node, yaml.SequenceNode):
            items = [self.convert(item, depth + 1, f"{key}[{i}]") for i, item in enumerate(node.value)]
            return Node(items, line, key_line or line)
        return Node(self._mapping(node, depth, key), line, key_line or line)

    def _mapping(self, node: yaml.Node, depth: int, key: str) -> dict[str, Node]:
        items: dict[str, Node] = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            name = name_node.value
            if not isinstance(name_node, yaml.ScalarNode) or name_node.tag == "tag:yaml.org,2002:merge":
                self.problems.add(line, key, "found a key that is no plain name, expected names; write the keys out")
                continue
            path = join(key, name)
            if name in items:
                first = items[name].key_line
                self.problems.add(line, path, f"found again, first on line {first}, expected once; remove one of them")
                continue
            items[name] = self.convert(value_node, depth + 1, path, line)
        return items


def join(key: str, name: str) -> str:
    """Return the dotted key of `name` in the section `key`."""
    return f"{key}.{name}" if key else name


def _scalar(node: yaml.ScalarNode) -> bool | float | str | None:
    text: str = node.value
    if node.style is not None:
        return text
    if is_decimal(text):
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    if node.tag == "tag:yaml.org,2002:bool":
        return text.lower() in ("yes", "true", "on")
    return None if node.tag == "tag:yaml.org,2002:null" else text


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:  # an integer beyond the doubles; reported as not finite
        return float("inf") if value > 0 else float("-inf")
