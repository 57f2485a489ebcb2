"""Arguments of a node: parameters as rcl reads them, and those of the launch files. Must not import rclpy."""

from __future__ import annotations

import os

LOGS = ("mcap", "bag", "rerun", "sink")
"""The parameters that ask a node for a log."""


def parameter(name: str, text: str) -> str:
    """Return a parameter as rcl reads it: YAML, where only quotes keep a text what it is."""
    quoted = text.replace("'", "''")
    return f"{name}:='{quoted}'"


def apart(target: object, name: str) -> object:
    """Return the target of a log, or of several, with the name of a body: out/run.mcap is out/run_body_1.mcap."""
    if isinstance(target, list):
        return [apart(each, name) for each in target]
    # Not by Path, which would take the target of a plug-in's sink, tcp://host/run, for a path.
    stem, suffix = os.path.splitext(str(target).rstrip("/"))
    return f"{stem}_{name}{suffix}"


def value_of(name: str, text: str, kind: type) -> object:
    """Return the value that the text of argument `name` means; `kind` is bool, float, int or str.

    Raises:
        ValueError: it means none.
    """
    truths = {"true": True, "false": False}
    try:
        return truths[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        expected = {bool: "true or false", int: "a whole number"}.get(kind, "a number")
        raise ValueError(f"argument {name}: found {text!r}, expected {expected}") from None


def values_of(name: str, text: str) -> dict[str, object]:
    """Return the values that the text of argument `name` means, such as {body.mass: 17.0}; none where it is empty.

    Raises:
        ValueError: it means none.
    """
    import yaml

    try:
        values = yaml.safe_load(text) if text else {}
    except yaml.YAMLError:
        values = None
    if isinstance(values, dict):
        return values
    raise ValueError(f"argument {name}: found {text!r}, expected values by name such as '{{body.mass: 17.0}}'")
