"""The command line `rb-dynamics`: each module in `commands/` is a command, with `HELP`, `add_arguments` and `run`.

The other modules here are shared by commands: the parser, arguments that several commands have, work on many logs, and
output. This file only dispatches to the command and turns errors into one message and an exit code: 0 success, 1 the
command ran and its check failed, 2 bad input. Command modules import what they need inside `run`, so that `--help`
stays quick.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Any, TextIO, cast

from rb_dynamics.cli.parser import Parser
from rb_dynamics.errors import LogError, RigidBodyError, did_you_mean
from rb_dynamics.run.stop_signals import Stopped, interrupted_by_signals

COMMANDS = (
    "simulate", "node", "replay", "inspect", "compare", "recover", "convert", "explain", "trade", "campaign", "body",
    "identify", "compile", "demo",
)  # fmt: skip

# New objects after which Python looks for cycles among them, in place of 700.
_OBJECTS = 100_000

_EPILOG = """\
examples:
  rb-dynamics explain config/slew.yaml --wrench examples/slew.mcap
  rb-dynamics simulate config/slew.yaml --wrench examples/slew.mcap --mcap run.mcap
  rb-dynamics inspect run.mcap --html run.html
  rb-dynamics node config/slew.yaml --ros-args -p real_time_factor:=1.0

exit codes: 0 done, 1 ran and failed its check, 2 bad input
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = Parser(
        prog="rb-dynamics",
        description="Simulate one free-floating rigid body: offline or as a ROS 2 node, with reproducible logs.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    top.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = top.add_subparsers(dest="command", metavar="COMMAND")
    for name in COMMANDS:
        module = importlib.import_module(f"rb_dynamics.cli.commands.{name}")
        command = commands.add_parser(
            name,
            help=module.HELP,
            description=module.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            # An abbreviation may become ambiguous with a new option: `--run` is neither `--runs` nor `--rerun`.
            allow_abbrev=False,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run, parser=command)
    return top


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from rb_dynamics.formats.log_metadata import version

        print(f"{parser.prog} {version()}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    # Before numpy is loaded. Our matrices are small: more threads of OpenBLAS only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with open(os.devnull, "w", encoding="utf-8") as nowhere, interrupted_by_signals():
            # There is no stdout under `>&-`, as a daemon may start a command.
            stream = cast(TextIO, _WhileRead(sys.stdout or nowhere))
            with contextlib.redirect_stdout(stream):
                try:
                    code = _run(arguments)
                except SystemExit:  # of `--help` and `--version`
                    sys.stdout.flush()
                    raise
                sys.stdout.flush()
    except RigidBodyError as error:
        print(f"rb-dynamics: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        with contextlib.suppress(OSError):  # of a terminal that was closed
            print("rb-dynamics: interrupted", file=sys.stderr)
        return 128 + (error.number if isinstance(error, Stopped) else signal.SIGINT)
    return code


def _run(arguments: Sequence[str]) -> int:
    """Run the command that the arguments name, and return its exit code."""
    # Everything after --ros-args is parsed by rcl.
    split = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    args = _parsed(parser(), arguments[:split])
    if args is None:
        return 2
    if "" in arguments[:split]:
        before = arguments[arguments.index("") - 1]
        args.parser.error(f"found nothing after {before}, as of a variable that is not set; give a value")
    if arguments[split:] and args.command not in ("node", "replay"):
        args.parser.error(
            f"found --ros-args, which belongs to the commands node and replay, not to {args.command}; leave it out"
        )
    args.ros_args = arguments[split:]
    # Imports and runs make many objects that last, and few cycles: looking for these takes some percent of a command.
    # Not in the node, for which many short pauses are better than a long one.
    if args.command != "node":
        gc.set_threshold(_OBJECTS)
    code: int = args.run(args)
    return code


class _WhileRead:
    """A stream that drops what is printed once the reader of a pipe has gone (`| head`): the exit code stays true.

    Output that is lost to a full disk is an error. Characters that it lacks, as of a file name that is no UTF-8, are
    escaped.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        encoding = self._stream.encoding or "utf-8"
        try:
            return self._stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _give_up(self, error: OSError) -> None:
        # What is still in its buffer goes nowhere, too: the flush at exit must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        if not isinstance(error, BrokenPipeError):
            raise LogError(f"cannot print the output: {error.strerror or error}; let it go elsewhere") from error


def _parsed(top: argparse.ArgumentParser, arguments: Sequence[str]) -> argparse.Namespace | None:
    """Return the parsed `arguments`, or None if they name no command; the help is then shown on stderr.

    argparse itself reports an unknown option with the usage of all commands, not of the one it was given to.
    """
    command = next((argument for argument in arguments if not argument.startswith("-")), None)
    if command is not None and command not in COMMANDS:
        top.error(f"found {command!r}, expected a command{_near(command, COMMANDS) or _meant(command)}")
    args, unknown = top.parse_known_args(arguments)
    if unknown:
        asked: argparse.ArgumentParser = top if command is None else args.parser
        known = ["--help", *re.findall(r"--[\w-]+", asked.format_usage())]
        found = ", ".join(argument + _near(argument.partition("=")[0], known) for argument in unknown)
        advice = args.advice(unknown) if "advice" in args else ""
        asked.error(f"unrecognized arguments: {found}{advice}")
    if command is None:
        top.print_help(sys.stderr)
        return None
    return args


def _meant(found: str) -> str:
    """Return a remedy if a file was given in place of a command; "" if `found` is not a file."""
    use = {".yaml": "simulate", ".yml": "simulate", ".mcap": "inspect"}.get(os.path.splitext(found)[1])
    return f" before the file, such as rb-dynamics {use} {found}" if use else ""


def _near(found: str, known: Sequence[str]) -> str:
    """Return a question whether the nearest of `known` was meant; "" if none is near."""
    near = did_you_mean(found, known, "")
    return f" ({near})" if near else ""
