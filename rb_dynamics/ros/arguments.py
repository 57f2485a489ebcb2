"""What a node is started with, as rcl reads it. Never imports rclpy."""

from __future__ import annotations


def parameter(name: str, text: str) -> str:
    """Return a parameter as rcl reads it: YAML, where only quotes keep a text what it is."""
    quoted = text.replace("'", "''")
    return f"{name}:='{quoted}'"
