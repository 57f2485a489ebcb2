"""The options that say which topics of a bag tell of the body."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.analysis.read_track import TopicChoice


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Add the options; without them topics are found by type and name; `compare` applies them to foreign bags."""
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", help="topic of the pose: PoseStamped, Odometry, TransformStamped, Imu, ..."
    )
    parser.add_argument(
        "--twist-topic", metavar="TOPIC", help="topic of the velocities: TwistStamped, Odometry, Imu, ..."
    )
    parser.add_argument(
        "--wrench-topic", metavar="TOPIC", action="append", default=[], help="topic of a wrench; may be repeated"
    )
    add_frames(parser, "take the pose of the frame BODY in WORLD from /tf")


def add_frames(parser: argparse.ArgumentParser, text: str) -> None:
    """Add `--frames` with the help `text`."""
    parser.add_argument("--frames", metavar="WORLD:BODY", type=_frames, help=text)


def chosen_topics(args: argparse.Namespace) -> TopicChoice:
    """Return what the options say."""
    from rb_dynamics.analysis.read_track import TopicChoice

    if args.pose_topic and args.frames:
        args.parser.error("found --pose-topic and --frames, expected one source of the pose; leave out one of them")
    return TopicChoice(args.pose_topic or "", args.twist_topic or "", tuple(args.wrench_topic), args.frames)


def _frames(text: str) -> tuple[str, str]:
    world, colon, body = text.partition(":")
    if not (world and colon and body) or world == body:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected two frames such as world:base_link")
    return world, body
