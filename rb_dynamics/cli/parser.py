"""The argument parser: reports bad options in one line that says where to find help.

argparse alone would print the usage of all options, which hides the line that matters.
"""

from __future__ import annotations

import argparse
from typing import NoReturn

from rb_dynamics.numerics.command_line_numbers import real, whole


class Parser(argparse.ArgumentParser):
    """A parser whose errors take one line."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with code 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def add_many(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the arguments of a command on one or many logs."""
    parser.add_argument(
        "log",
        metavar="RUN.mcap",
        nargs="+",
        help=f"{what}; several, a pattern in quotes, or a folder of logs and bags: one line for each",
    )
    parser.add_argument(
        "--jobs",
        type=whole("a whole number, 1 or more", lambda v: v >= 1),
        metavar="N",
        help="of several logs, so many at a time (default: one per core)",
    )


def require_ros(purpose: str) -> None:
    """Refuse options that need ROS if it is not installed; only `rb_dynamics.ros` imports it.

    Raises:
        MissingExtraError: it is not installed.
    """
    import importlib.util

    if importlib.util.find_spec("rclpy") is None:
        from rb_dynamics.errors import MissingExtraError

        raise MissingExtraError("rclpy", "ros", purpose)


def require_with(args: argparse.Namespace, option: str, is_given: bool, other: str, is_there: object) -> None:
    """Refuse an option that would have no effect without the option `other`."""
    if is_given and not is_there:
        args.parser.error(f"found {option} without {other}, expected both; add {other}, or leave out {option}")


def add_window(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add `--from` and `--to`."""
    seconds = real("a number of seconds")
    parser.add_argument("--from", dest="from_s", type=seconds, metavar="S", help=f"{verb} from t = S on")
    parser.add_argument("--to", dest="to_s", type=seconds, metavar="S", help=f"{verb} up to t = S")
