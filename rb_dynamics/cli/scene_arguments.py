"""The scene of a command: its file or a log, overrides of its keys, and the wrench commands of bags."""

from __future__ import annotations

import argparse
import math
from decimal import Decimal
from typing import TYPE_CHECKING, cast

from rb_dynamics.cli.parser import require_with
from rb_dynamics.numerics.command_line_numbers import real

if TYPE_CHECKING:
    from rb_dynamics.loads.wrench import Wrench
    from rb_dynamics.logs.wrench_bags import RecordedWrenches, Start
    from rb_dynamics.run.posting import Command
    from rb_dynamics.scene.model import Scene


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene and `--set`."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML), or a log: its scene with its commands")
    add_set(
        parser,
        "override any key of the scene, such as body.mass=2, wrenches[0].timeout=0.5, sensors.imu.rate=50 or "
        "effects=[]; may be repeated",
    )


def add_set(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Add `--set`, which `overrides_of` reads."""
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=meaning)


def overrides_of(args: argparse.Namespace) -> dict[str, object]:
    """Return the values of `--set` by key.

    Raises:
        SceneError: one cannot be read.
    """
    return dict(map(_override, args.set))


def add_wrench(parser: argparse.ArgumentParser) -> None:
    """Add the bags of wrench commands, their start, and the assignment of their topics to channels."""
    parser.add_argument(
        "--wrench", action="append", default=[], metavar="BAG",
        help="bag with wrench commands, MCAP or a rosbag2 folder; may be repeated to combine bags",
    )  # fmt: skip
    add_start_and_topics(parser)


def add_start_and_topics(parser: argparse.ArgumentParser, of: str = "") -> None:
    """Add the start of the bags and the assignment of their topics; `of` says of which run."""
    parser.add_argument(
        "--wrench-start", type=_start, metavar="auto|bag|first|stamp|SECONDS",
        help=of + "time 0 of the run. stamp: time 0 of the commands' stamps; bag: start of the bags; first: the "
        "first command; SECONDS: that stamp; auto (default): stamp if commands then lie within the run, else bag",
    )  # fmt: skip
    parser.add_argument(
        "--topic", action="append", default=[], metavar="TOPIC=CHANNEL",
        help=of + "topic of the bag for a channel or actuator of the scene, if their names differ; may be repeated",
    )  # fmt: skip


def add_solver(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace the scene's duration and solver."""
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
    """Return the scene selected by `args`; of a log, the scene that was run.

    Raises:
        SceneError: it is not valid, or a value cannot be read.
        LogError: a log is not one of this package.
    """
    return _read(args)[0]


def _read(args: argparse.Namespace) -> tuple[Scene, dict[str, str], bool]:
    """Return the scene, and of a log the channel of each topic that has another name, and whether it was open-ended."""
    from rb_dynamics.formats.output_file import is_log
    from rb_dynamics.scene import read_scene

    overrides = overrides_of(args)
    keys = {"duration": "duration", "method": "solver.method", "step": "solver.step", "accuracy": "solver.accuracy"}
    for name, key in keys.items():
        if (value := getattr(args, name, None)) is not None:
            overrides[key] = value
    if is_log(args.scene):
        from rb_dynamics.logs.own_log import scene_of_log

        return scene_of_log(args.scene, overrides)
    return read_scene(args.scene, overrides), {}, False


def listed(commands: RecordedWrenches | list[tuple[str, Wrench]]) -> list[Command]:
    """Return all of what `read_with_commands` gives, commands to actuators too, and to those that are not there."""
    if isinstance(commands, list):
        return list(commands)
    from rb_dynamics.loads.actuator import Setpoint

    absent = [(topic, each) for topic, times_ns in commands.to_absent.items() for each in times_ns.tolist()]
    return [*commands, *commands.setpoints, *((topic, Setpoint(math.nan, time_ns)) for topic, time_ns in absent)]


def read_with_commands(args: argparse.Namespace) -> tuple[Scene, RecordedWrenches | list[tuple[str, Wrench]]]:
    """Return the scene and the commands of `--wrench`, or of the log; says on stderr which have no effect.

    Raises:
        SceneError: the scene is not valid, or a value cannot be read.
        LogError: a bag cannot be read, none of its commands has an effect, or `--topic` is not TOPIC=CHANNEL.
    """
    require_with(args, "--topic", bool(args.topic), "--wrench", args.wrench)
    require_with(args, "--wrench-start", args.wrench_start is not None, "--wrench", args.wrench)
    from rb_dynamics.cli import output
    from rb_dynamics.formats.output_file import is_log

    scene, names, open_ended = _read(args)
    if open_ended:
        output.note_open_end(scene)
    repeated = not args.wrench and is_log(args.scene)
    if not (args.wrench or (repeated and (scene.channels or scene.actuators))):
        return scene, []
    from rb_dynamics.loads.wrench_channels import WrenchChannels
    from rb_dynamics.logs.wrench_bags import RecordedWrenches

    end_ns = math.inf if scene.end_ns is None else scene.end_ns
    topics, start = [channel.topic for channel in scene.channels], args.wrench_start
    channels = WrenchChannels(scene.channels, scene.frames, body=scene.body)
    if repeated:
        # In a log, a command took effect when the log says, whatever its stamp is.
        commands = RecordedWrenches([args.scene], topics, end_ns, names, 0, channels, scene.actuators)
        output.note_start(commands)
        return scene, commands
    commands = RecordedWrenches(
        args.wrench, topics, end_ns, mapping_of(args), "auto" if start is None else start, channels, scene.actuators
    )
    output.note_start(commands)
    commands.require_some(continues=scene.past is not None)
    output.warn_outside(commands, scene)
    return scene, commands


def _start(text: str) -> Start:
    """Return the time that is time 0 of a run: a word, or seconds as an exact decimal, converted to ns."""
    if text in ("auto", "bag", "first", "stamp"):
        return cast("Start", text)
    real("auto, bag, first, stamp or a number of seconds", lambda value: abs(value) < 2.0**31)(text)
    return round(Decimal(text) * 10**9)


def mapping_of(args: argparse.Namespace) -> dict[str, str]:
    """Return the channel of each topic given with `--topic`."""
    from rb_dynamics.errors import LogError

    pairs = [text.partition("=") for text in args.topic]
    for topic, equals, channel in pairs:
        if not (topic and equals and channel):
            raise LogError(
                f"--topic: found {topic + equals + channel!r}, expected TOPIC=CHANNEL; write it as in /cmd=wrench"
            )
    return {topic: channel for topic, _, channel in pairs}


def _override(text: str) -> tuple[str, object]:
    from rb_dynamics.errors import SceneError
    from rb_dynamics.formats.yaml.document import value_of

    key, equals, value = text.partition("=")
    if not (key and equals and value.strip()):
        raise SceneError(f"--set: found {text!r}, expected KEY=VALUE; write it as in body.mass=2")
    return key, value_of(value, f"--set {key}")
