"""Overrides: values from the command line, ROS parameters or a campaign, applied to a document before validation.

They are validated like any value of the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from rb_dynamics.formats.yaml.document import Node, from_python, join, show
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.numerics.argument_checks import mapping

# A dotted key, with [n] for an item of a list, as messages write it: wrenches[0].timeout. An item that has a name is
# found by it, too: actuators.wheel_x.max_torque
_PART = re.compile(r"([^.\[\]]+)((?:\[[0-9]{1,6}\])*)")


_EITHER = (("solver", "step", "accuracy"), ("initial", "linear_velocity_world", "linear_velocity_body"))
"""Section and keys of which it has one."""


def root_of(key: str) -> str:
    """Return the key of the whole document with which a dotted key begins."""
    return re.split(r"[.\[]", key, maxsplit=1)[0]


def merged(overrides: Mapping[str, object], later: Mapping[str, object]) -> dict[str, object]:
    """Return both; `later` ones win, and replace what cannot stand beside them, as `apply_overrides` says."""
    gone = {
        f"{section}.{other}"
        for section, one, two in _EITHER
        for given, other in ((one, two), (two, one))
        if f"{section}.{given}" in later
    }
    return {key: value for key, value in overrides.items() if key not in gone} | dict(later)


def apply_overrides(document: Node, overrides: Mapping[str, object], problems: Problems) -> None:
    """Set each dotted key of `overrides` in `document`; keys without a place there are added to `problems`.

    `solver.step` replaces `solver.accuracy` and vice versa, unless both are overridden; the two linear velocities, too.
    """
    for key, value in mapping(overrides, "overrides", "write {'body.mass': 2.0}").items():
        _set(document, str(key), from_python(value), problems)
    for section, one, two in _EITHER:
        for given, other in ((one, two), (two, one)):
            if f"{section}.{given}" in overrides and f"{section}.{other}" not in overrides:
                _drop(document, section, other)


def _drop(document: Node, section: str, name: str) -> None:
    found = document.value.get(section) if isinstance(document.value, dict) else None
    if found is not None and isinstance(found.value, dict):
        found.value.pop(name, None)


def _set(document: Node, key: str, new: Node, problems: Problems) -> None:
    steps = _steps(key)
    if not steps:
        problems.add(None, key, "found this as an override, expected a dotted key; write it as in body.mass")
    node, path = document, ""
    for i, step in enumerate(steps):
        child = _enter(node, step, new if i + 1 == len(steps) else None)
        if child is None and (unknown := _unknown(node, step, path)):
            problems.add(None, key, f"found {unknown[0]}, expected {unknown[1]}; correct the override")
            return
        if child is None:
            wanted = f"the key {step}" if isinstance(step, str) else f"an item [{step}]"
            meant = isinstance(step, str) and step.isdecimal() and _enter(node, int(step), None) is not None
            mend = f"did you mean {path}[{step}]?" if meant else "correct the override"
            text = f"found {path or 'the scene'} to be {show(node)}, expected it to hold {wanted}; {mend}"
            problems.add(None, key, text)
            return
        node, path = child, join(path, step) if isinstance(step, str) else f"{path}[{step}]"


def _enter(node: Node, step: str | int, new: Node | None) -> Node | None:
    """Return the child `step` of `node`, after replacing it by `new`; None if there is no such place."""
    if isinstance(step, str) and isinstance(node.value, dict):
        if new is not None:
            node.value[step] = new
        return node.value.setdefault(step, Node({}))
    if isinstance(node.value, list):
        index = step if isinstance(step, int) else _named(node.value, step)
        if index < len(node.value):
            if new is not None:
                node.value[index] = new
            return node.value[index]
    return None


def _named(items: list[Node], name: str) -> int:
    """Return the place of the item that has this name, the number of items if there is none."""
    return next((i for i, found in enumerate(_names(items)) if found == name), len(items))


def _names(items: list[Node]) -> list[object]:
    """Return the name of each item, None for those without."""
    names = (item.value.get("name") if isinstance(item.value, dict) else None for item in items)
    return [None if found is None else found.value for found in names]


def _unknown(node: Node, step: str | int, path: str) -> tuple[str, str] | None:
    """Return what was found and what was expected if `step` is the name of no item of `node`, a list of named ones."""
    names = [str(name) for name in _names(node.value) if name is not None] if isinstance(node.value, list) else []
    if not names or not isinstance(step, str) or step.isdecimal() or step in names:
        return None
    return f"no {path.removesuffix('s')} {step}", f"one of {', '.join(names)}"


def unknown_item(document: Node, key: str) -> tuple[str, str] | None:
    """Return what was found and what was expected if a dotted key names an item that a list lacks; else None."""
    path = ""
    for step in _steps(key):
        node = find(document, path) if path else document
        if node is not None and (unknown := _unknown(node, step, path)):
            return unknown
        path = join(path, step) if isinstance(step, str) else f"{path}[{step}]"
    return None


def find(document: Node, key: str) -> Node | None:
    """Return what stands under a dotted key, None if there is nothing."""
    node: Node | None = document
    for step in _steps(key):
        if node is None or (isinstance(node.value, dict) and step not in node.value):
            return None
        node = _enter(node, step, None)
    return node if _steps(key) else None


@lru_cache(maxsize=256)
def _steps(key: str) -> tuple[str | int, ...]:
    """Return the names and indices in `key`; empty if it is not a dotted key."""
    steps: list[str | int] = []
    for part in key.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            return ()
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall("[0-9]+", match[2]))
    return tuple(steps)
