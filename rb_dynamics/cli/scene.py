"""The scene of a command: its file, other values for its keys, and the wrench commands of a bag.

Shared by the commands that run a scene; never runs it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from rb_dynamics.cli.numbers import real

if TYPE_CHECKING:
    from rb_dynamics.loads.wrench import Wrench
    from rb_dynamics.recording.mcap_reader import RecordedWrenches
    from rb_dynamics.scene.model import Scene


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene and `--set`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="another value for any key of the scene, such as body.mass=2 or effects=[]; may be given again",
    )  # fmt: skip


def add_wrench(parser: argparse.ArgumentParser) -> None:
    """Add the bag of wrench commands."""
    parser.add_argument(
        "--wrench",
        metavar="BAG",
        help="bag with wrench commands, MCAP or a rosbag2 folder; each takes effect at its stamp",
    )


def add_solver(parser: argparse.ArgumentParser) -> None:
    """Add what stands for the scene's duration and solver."""
    parser.add_argument(
        "--duration",
        type=real("a number of seconds, such as 10"),
        metavar="S",
        help="length of the run in s, instead of the scene's",
    )
    parser.add_argument("--method", metavar="M", help="method of integration, instead of the scene's")
    steps = parser.add_mutually_exclusive_group()
    steps.add_argument("--step", type=real("a number of seconds, such as 0.01"), metavar="S", help="fixed step in s")
    steps.add_argument(
        "--accuracy",
        type=real("a number such as 1e-9"),
        metavar="A",
        help="accepted error at the end, in rad; sets the steps",
    )


def read(args: argparse.Namespace) -> Scene:
    """Return the scene that `args` ask for.

    Raises:
        SceneError: it is not valid, or a value cannot be read.
    """
    from rb_dynamics.scene import read_scene

    overrides = dict(map(_override, args.set))
    keys = {"duration": "duration", "method": "solver.method", "step": "solver.step", "accuracy": "solver.accuracy"}
    for name, key in keys.items():
        if (value := getattr(args, name, None)) is not None:
            overrides[key] = value
    return read_scene(args.scene, overrides)


def read_commands(
    bag: str | None, scene: Scene, mapping: Mapping[str, str] | None = None
) -> RecordedWrenches | list[tuple[str, Wrench]]:
    """Return the commands in `bag` for the channels of `scene`, or none; says on stderr what has no effect.

    `mapping` is the channel that each topic of the bag drives, where their names differ.

    Raises:
        LogError: the bag cannot be read.
    """
    from rb_dynamics.cli import output

    topics = [channel.topic for channel in scene.channels]
    if not bag:
        if topics and not scene.effects and "wrenches" in scene.text:
            print(
                f"note: no commands on {', '.join(topics)}: the body coasts; give a bag of commands with --wrench",
                file=sys.stderr,
            )
        return []
    from rb_dynamics.recording.mcap_reader import RecordedWrenches

    end_ns = math.inf if scene.end_ns is None else scene.end_ns
    commands = RecordedWrenches(bag, topics, end_ns, mapping)
    output.warn_outside(commands, scene)
    return commands


def _override(text: str) -> tuple[str, object]:
    from rb_dynamics.errors import SceneError
    from rb_dynamics.scene.document import value_of

    key, equals, value = text.partition("=")
    if not (key and equals and value.strip()):
        raise SceneError(f"--set: found {text!r}, expected KEY=VALUE; write it as in body.mass=2")
    return key, value_of(value, f"--set {key}")
