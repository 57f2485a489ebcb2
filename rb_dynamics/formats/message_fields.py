"""The fields of a message type, from its definition as a bag has it, so that two definitions can be compared.

Definitions of one type differ in comments, spaces, constants and defaults, and still describe the same bytes.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping

from rb_dynamics.formats.mcap_records import Schema
from rb_dynamics.formats.message_definitions import DEFINITIONS, schema_text

# Two names of one byte.
_ALSO = {"byte": "uint8", "char": "uint8"}
_PRIMITIVE = frozenset(
    ("bool", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "string")
) | {"wstring"}
_BETWEEN = re.compile(r"^={3,}\s*$", re.MULTILINE)
# Bounds of strings and sequences change no byte.
_BOUND = re.compile(r"<=\s*\d+")
_ARRAY = re.compile(r"\[\d*\]$")


def differ(one: Schema, other: Schema) -> bool:
    """Return whether two definitions of a type are of other fields; False where one cannot be read here."""
    fields = _fields(one), _fields(other)
    return None not in fields and fields[0] != fields[1]


@functools.lru_cache(maxsize=256)
def is_other(schema: Schema) -> bool:
    """Return whether a schema has the name of a type that is known here, and other fields."""
    name = schema.name.replace("/", "/msg/") if schema.name.count("/") == 1 else schema.name
    return name in DEFINITIONS and differ(schema, Schema(name, "ros2msg", schema_text(name).encode()))


@functools.lru_cache(maxsize=256)
def _fields(schema: Schema) -> tuple[str, ...] | None:
    """Return type and name of each field, those of inner types in their places; None if that cannot be read."""
    if schema.encoding != "ros2msg" or not schema.data:
        return None
    first, *others = _BETWEEN.split(schema.data.decode("utf-8", "replace"))
    inner: dict[str, str] = {}
    for part in others:
        title, _, text = part.lstrip().partition("\n")
        inner[title.removeprefix("MSG:").strip().replace("/msg/", "/")] = text
    try:
        return tuple(_flat(first, schema.name.partition("/")[0], inner, ""))
    except (LookupError, ValueError, RecursionError):
        return None


def _flat(text: str, package: str, inner: Mapping[str, str], path: str) -> Iterator[str]:
    """Yield the fields of a definition.

    Raises:
        LookupError: the definition of an inner type is missing.
        ValueError: a line is none of a field.
    """
    for line in _BOUND.sub("", text).splitlines():
        content = line.partition("#")[0]
        if not content.strip() or "=" in content:
            continue
        kind, name = content.split(maxsplit=2)[:2]
        array = "".join(_ARRAY.findall(kind))
        kind = kind.removesuffix(array).replace("/msg/", "/")
        kind = _ALSO.get(kind, kind)
        if kind in _PRIMITIVE:
            yield f"{kind}{array} {path}{name}"
            continue
        full = "std_msgs/Header" if kind == "Header" else kind if "/" in kind else f"{package}/{kind}"
        yield from _flat(inner[full], full.partition("/")[0], inner, f"{path}{name}{array}.")
