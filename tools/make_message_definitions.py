"""Write rb_dynamics/formats/message_definitions.py: message definitions and RIHS01 type hashes of ROS 2 Jazzy.

Run after a message type was added to `rb_dynamics.formats.cdr.LAYOUTS`: python tools/make_message_definitions.py
"""

from __future__ import annotations

from pathlib import Path

from rosbags.typesys import Stores, get_typestore

from rb_dynamics.formats.cdr import LAYOUTS

TARGET = Path(__file__).parents[1] / "rb_dynamics" / "formats" / "message_definitions.py"

SEPARATOR = "=" * 80 + "\n"

HEAD = '''"""Definitions and type hashes of the ROS 2 messages in a log, by tools/make_message_definitions.py."""

from __future__ import annotations

from collections.abc import Iterator

SEPARATOR = "=" * 80 + "\\n"


def schema_text(type_name: str) -> str:
    """Return the `ros2msg` schema: the definition of `type_name`, then of each type inside it."""
    parts = [DEFINITIONS[type_name]]
    inside = dict.fromkeys(_inside(type_name))
    parts += [f"MSG: {inner.replace('/msg/', '/')}\\n{DEFINITIONS[inner]}" for inner in inside]
    return SEPARATOR.join(parts)


def _inside(type_name: str) -> Iterator[str]:
    """Yield the type of each field that is a message, and behind it those inside."""
    for line in DEFINITIONS[type_name].splitlines():
        package, slash, name = line.partition(" ")[0].partition("[")[0].partition("/")
        if slash:
            inner = f"{package}/msg/{name}"
            yield from (inner, *_inside(inner))


'''


def generate() -> str:
    """Return the text of message_definitions.py."""
    store = get_typestore(Stores.ROS2_JAZZY)
    definitions: dict[str, str] = {}
    for name in LAYOUTS:
        first, *others = str(store.generate_msgdef(name, ros_version=2)[0]).split(SEPARATOR)
        named = [part.removeprefix("MSG: ").split("\n", 1) for part in others]
        definitions[name] = first
        definitions.update({inner.replace("/", "/msg/"): text for inner, text in named})
    lines = ["# Of each type in a log: its RIHS01 hash.", "TYPE_HASHES: dict[str, str] = {"]
    for name in LAYOUTS:
        line = f'    "{name}": "{store.hash_rihs01(name)}",'
        lines += [line] if len(line) <= 120 else [line.replace(": ", ": (\n        ", 1)[:-1], "    ),"]
    lines += ["}", "", "DEFINITIONS: dict[str, str] = {"]
    lines += [f'    "{name}": """\\\n{definitions[name]}""",' for name in sorted(definitions)]
    return HEAD + "\n".join([*lines, "}", ""])


if __name__ == "__main__":
    TARGET.write_text(generate(), encoding="utf-8")
