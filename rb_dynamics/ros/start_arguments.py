"""Start arguments of a node: parameters as rcl parses them, and launch arguments. Must not import rclpy."""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import yaml

from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.document import Node
from rb_dynamics.formats.yaml.problems import Problems, printable
from rb_dynamics.numerics.number_parsing import real_number, whole_number
from rb_dynamics.scene.overrides import root_of
from rb_dynamics.scene.read import ROOT_KEYS, read_scene

LOGS = ("mcap", "bag", "rerun", "sink")
"""The parameters that request a log."""


def parameter(name: str, text: str) -> str:
    """Return a parameter in rcl's syntax: YAML, in which only quotes keep a text a text."""
    quoted = text.replace("'", "''")
    return f"{name}:='{quoted}'"


def apart(target: object, name: str) -> object:
    """Return one or several log targets with the name of a body inserted: out/run.mcap becomes out/run_body_1.mcap."""
    if isinstance(target, list):
        return [apart(each, name) for each in target]
    # Not with Path, which would change the target of a plug-in's sink such as tcp://host/run.
    stem, suffix = os.path.splitext(str(target).rstrip("/"))
    return f"{stem}_{name}{suffix}"


def value_of(name: str, text: str, kind: type) -> object:
    """Return the value of the argument `name` from its `text`; `kind` is bool, float, int or str.

    Raises:
        ValueError: the text is not of that kind.
    """
    readers: dict[type, Callable[[str], object]] = {bool: _truth, int: whole_number, float: real_number, str: str}
    try:
        return readers[kind](text)
    except (KeyError, ValueError):
        expected = {bool: "true or false", int: "a whole number"}.get(kind, "a number")
        raise ValueError(f"argument {name}: found {text!r}, expected {expected}") from None


def values_of(name: str, text: str) -> dict[str, object]:
    """Return the values of the argument `name` from its `text`, such as {body.mass: 17}; empty if the text is.

    They are read as in a scene file, except that a whole number is an int, which a parameter may require.

    Raises:
        ValueError: the text is not such a mapping.
    """
    problems = Problems(f"argument {name}")
    expected = f"argument {name}: found {printable(text)!r}, expected values by name such as '{{body.mass: 17.0}}'"
    try:
        found = _plain(document.parse(text or "{}", problems))
    except SceneError as error:
        raise ValueError(f"{expected} ({error})") from None
    if problems:
        raise ValueError(f"{expected} ({problems.error()})")
    assert isinstance(found, dict)
    return found


def spacing_of(text: str) -> tuple[float, float, float]:
    """Return the distance between bodies (m, world axes): a number is along y, three as in [1, 0, 0.5] any direction.

    Raises:
        ValueError: it is neither.
    """
    found = text.strip()
    parts = found[1:-1].split(",") if found.startswith("[") and found.endswith("]") else ["0", found, "0"]
    try:
        x, y, z = (real_number(part.strip()) for part in parts)
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"argument spacing: found {text!r}, expected metres along y, or three as in [1.0, 0.0, 0.5]")
    return x, y, z


def side_by_side(
    scene: str, given: Mapping[str, object], count: int, prefix: str, spacing: Sequence[float]
) -> dict[str, dict[str, object]]:
    """Return the parameters of `count` bodies, by their names: prefix1, prefix2, ...

    The first starts where the scene, with the parameters `given` to all, puts it.

    Raises:
        SceneError: the scene is not valid.
    """
    overrides = {name: value for name, value in given.items() if root_of(name) in ROOT_KEYS}
    first = read_scene(scene, overrides).initial.position_world
    places = [[x + k * each for x, each in zip(first, spacing, strict=True)] for k in range(count)]
    return {f"{prefix}{k + 1}": {"initial.position_world": place} for k, place in enumerate(places)}


def bodies_in(path: str) -> dict[str, dict[str, object]]:
    """Return the parameters of each body in a file such as `{bodies: {chaser: {scene: a.yaml, body.mass: 2.0}}}`.

    Files of scenes are relative to it; parameters may be nested or have dotted names.

    Raises:
        SceneError: the file is no such mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"cannot read {path}: {error}; give a file of bodies") from None
    problems = Problems(path)
    found = _plain(document.parse(text, problems))
    if problems:
        raise problems.error()
    listed = found.get("bodies") if isinstance(found, dict) and len(found) == 1 else None
    if not (isinstance(listed, dict) and listed and all(isinstance(each, dict) for each in listed.values())):
        raise SceneError(
            f"{path}: expected bodies by name, each with its parameters; write "
            "{bodies: {chaser: {scene: chaser.yaml, initial.position_world: [0, 0, 0]}}}"
        )
    bodies = {name: dict(_parameters(values, "")) for name, values in listed.items()}
    for name, values in bodies.items():
        if None in values.values():
            raise SceneError(f"{path}: bodies.{name}: found a parameter without a value; write one, or leave it out")
        if "scene" in values:
            values["scene"] = str(Path(path).parent / str(values["scene"]))
    return bodies


def is_bodies(path: str) -> bool:
    """Return whether the file lists bodies and is not a scene."""
    try:
        return any(line.startswith("bodies:") for line in Path(path).read_text(encoding="utf-8").splitlines())
    except (OSError, UnicodeDecodeError):
        return False


def _parameters(values: object, key: str) -> Iterator[tuple[str, object]]:
    if isinstance(values, dict):
        for name, inner in values.items():
            yield from _parameters(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(values, list) and any(isinstance(each, float) for each in values):
        # A parameter that is a list has one type.
        yield key, [float(each) if isinstance(each, int) else each for each in values]
    else:
        yield key, values


def shared_parameters(arguments: Sequence[str], node: str) -> set[str]:
    """Return the parameters that a parameter file in `arguments` gives to all nodes, as under `/**`, and not to `node`.

    Files that cannot be read are left to rcl.
    """
    return _given(arguments, node)[0]


def with_file(message: str, arguments: Sequence[str], node: str) -> str:
    """Return an error message, with the parameter file in `arguments` that gives `node` the parameter it is about."""
    for name, path in _given(arguments, node)[1].items():
        if re.search(rf"(?:^|[ :]){re.escape(name)}: ", message):
            return f"{message}; {name} is set in {path}"
    return message


def _given(arguments: Sequence[str], node: str) -> tuple[set[str], dict[str, str]]:
    """Return the parameters that files give to all nodes, and not to `node`, and the file of each that it gets."""
    shared, own, files = set[str](), set[str](), dict[str, str]()
    for option, text in pairwise(arguments):
        if option in ("-p", "--param"):
            name = text.partition(":=")[0].rpartition(":")[2]
            own.add(name)
            files.pop(name, None)
        elif option == "--params-file":
            with contextlib.suppress(OSError, yaml.YAMLError, UnicodeDecodeError):
                content = yaml.safe_load(Path(text).read_text())
                for names, parameters in _sections(content, ()):
                    found, last = set(_dotted(parameters, "")), names[-1].rpartition("/")[2]
                    if last in ("*", "**"):
                        shared |= found
                    elif last == node:
                        own |= found
                    if last in ("*", "**", node):
                        files |= dict.fromkeys(found, text)
    return shared - own, files


def _sections(content: object, names: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], object]]:
    if isinstance(content, dict):
        for name, inner in content.items():
            if name == "ros__parameters" and names:
                yield names, inner
            else:
                yield from _sections(inner, (*names, str(name)))


def _dotted(parameters: object, key: str) -> Iterator[str]:
    if not isinstance(parameters, dict):
        yield key
        return
    for name, inner in parameters.items():
        yield from _dotted(inner, f"{key}.{name}" if key else str(name))


def _truth(text: str) -> bool:
    return {"true": True, "false": False}[text.lower()]


def _plain(node: Node) -> object:
    if isinstance(node.value, dict):
        return {key: _plain(value) for key, value in node.value.items()}
    if isinstance(node.value, list):
        return [_plain(item) for item in node.value]
    if isinstance(node.value, float):
        with contextlib.suppress(ValueError):
            return whole_number(node.text)
    return node.value
