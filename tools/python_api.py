"""Generate docs/reference/python.md: every public name with its signature, types and docstring, as Markdown.

Used by `tools/make_reference.py`. All text except the order of the sections comes from the code.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cached_property
from itertools import groupby
from types import FunctionType
from typing import Any, Protocol

import rb_dynamics as rb

WIDTH = 100  # of a signature on one line

HEAD = """\
Everything here is a name of `rb_dynamics` itself: `import rb_dynamics as rb`. Two of the names are modules,
`rb.poinsot` and `rb.euler_equations`: [the lecture](../lecture.md) uses each of their functions.
`rb.METHODS` holds the methods by name; [Extending](../extending.md) says how to add to them.

Types: a `Vector` is a tuple of three floats, a `Quaternion` one of four, x y z w, and a `Matrix` one of three rows;
`Array` and `Numbers` are numpy arrays of float64, `Times` of int64; `npt.ArrayLike` is what numpy makes one of.
"""

PARTS = {
    "body": "Body and state",
    "loads": "What acts",
    "sensors": "What measures",
    "motion": "Methods and free motion",
    "scene": "Scenes",
    "run.simulate": "Runs",
    "run.simulation": "Runs",
    "run.sample": "Runs",
    "study": "Runs",
    "run.ensemble": "Many bodies at once",
    "run.sample_arrays": "Many bodies at once",
    "analysis": "What a recording says",
    "run.sink": "Sinks",
    "sinks": "Sinks",
    "errors": "Errors",
}
MODULES = {"poinsot": "Poinsot's construction", "euler_equations": "Euler's equations"}

SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$", re.MULTILINE)


class Written:
    """An annotation or default in a signature that is printed as in the source."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def page() -> Iterator[str]:
    """Yield the page, block by block."""
    yield HEAD
    public = [(PARTS[part], name, thing) for name, part, thing in public_names()]
    order = list(dict.fromkeys(PARTS.values()))
    public.sort(key=lambda entry: order.index(entry[0]))
    for part, group in groupby(public, key=lambda entry: entry[0]):
        yield f"## {part}\n"
        for _, name, thing in group:
            yield from entry(name, thing)
    for name, title in MODULES.items():
        module = getattr(rb, name)
        yield f"## {title}\n"
        yield f"In `rb.{name}`. {as_markdown(inspect.getdoc(module) or '')}"
        for each, thing in vars(module).items():
            if not each.startswith("_") and getattr(thing, "__module__", "") == module.__name__:
                yield from entry(each, thing)


def public_names() -> Iterator[tuple[str, str, Any]]:
    """Yield each class and function of the package with the part of the tree that it stands in."""
    for name in rb.__all__:
        thing = getattr(rb, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            below = thing.__module__.removeprefix("rb_dynamics.")
            yield name, below if below in PARTS else below.split(".")[0], thing


def entry(name: str, thing: Any) -> Iterator[str]:
    """Yield the documentation of a class or a function, and of the members of the class."""
    yield f"### {name}\n"
    yield from said(f"class {name}" if inspect.isclass(thing) else name, thing)
    if not inspect.isclass(thing):
        return
    if issubclass(thing, Enum):
        yield f"Members: {', '.join(f'`{member.name}`' for member in thing)}.\n"
    for member, raw in vars(thing).items():
        described = isinstance(raw, (property, cached_property, classmethod, FunctionType)) and raw.__doc__
        if described and not member.startswith("_"):
            yield from said(f"{name}.{member}", raw if isinstance(raw, property) else getattr(thing, member))


def said(name: str, thing: Any) -> Iterator[str]:
    """Yield the signature and the docstring."""
    yield f"```python\n{signature(name, thing)}\n```\n"
    yield as_markdown(inspect.getdoc(thing) or "")


def signature(name: str, thing: Any) -> str:
    """Return the signature of `thing`, on one line or with one line per parameter; for a property, its type."""
    getter = getattr(thing, "fget", getattr(thing, "func", None))
    if getter is not None:
        return f"{name}: {getter.__annotations__['return']}"
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return f"{name}({', '.join(base.__name__ for base in thing.__bases__)})"
    if inspect.isclass(thing) and (issubclass(thing, Enum) or Protocol in thing.__bases__):
        return name
    full = inspect.signature(thing)
    parameters = [as_written(each) for each in full.parameters.values() if each.name != "self"]
    result = "" if inspect.isclass(thing) else f" -> {full.return_annotation}"
    line = str(full.replace(parameters=parameters, return_annotation=inspect.Signature.empty))
    if len(name + line + result) > WIDTH:
        parts = [str(each) for each in parameters]
        names_only = next((i for i, each in enumerate(parameters) if each.kind is each.KEYWORD_ONLY), None)
        if names_only is not None:
            parts.insert(names_only, "*")
        line = "(\n" + textwrap.indent(",\n".join(parts), "    ") + ",\n)"
    return name + line + result


def as_written(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return the parameter with annotation and default that print as the source has them."""
    default = parameter.default
    if isinstance(default, Mapping):
        default = dict(default)
    return parameter.replace(annotation=Written(parameter.annotation), default=default)


def as_markdown(doc: str) -> str:
    """Return a docstring of Google style as Markdown: sections become lists."""
    pieces = SECTION.split(re.sub(r"(?<![`\w])\*(?=\w|_)", r"\\*", doc))
    parts = [pieces[0].rstrip() + "\n"]
    for title, body in zip(pieces[1::2], pieces[2::2], strict=True):
        items = re.sub(r"^(\w+): ", r"`\1`: ", textwrap.dedent(body).strip("\n"), flags=re.MULTILINE)
        items = re.sub(r"^(?=\S)", "- ", items, flags=re.MULTILINE)
        parts.append(f"{title}:\n\n{re.sub(r'^    ', '  ', items, flags=re.MULTILINE)}\n")
    return "\n".join(parts)
