"""The options that say which topics of a bag describe the body."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.analysis.read_track import TopicChoice


def add_topics(parser: argparse.ArgumentParser, of_two: str = "") -> None:
    """Add the options; without them topics are found by type and name. `of_two` says what a second one is for."""
    action = "append" if of_two else "store"
    # Of two motions, one pose may be that of a topic, the other that of frames.
    topic, frames = ("pose", "pose") if of_two else ("pose_topic", "frames")
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", action=action, dest=topic,
        help="topic of the pose: PoseStamped, Odometry, TransformStamped, Imu, ..." + of_two,
    )  # fmt: skip
    parser.add_argument(
        "--twist-topic", metavar="TOPIC", action=action,
        help="topic of the velocities: TwistStamped, Odometry, Imu, ..." + of_two,
    )  # fmt: skip
    parser.add_argument(
        "--wrench-topic", metavar="TOPIC[=CHANNEL]", action="append", default=[],
        help="topic of a wrench, and the scene's channel of these commands; may be repeated",
    )  # fmt: skip
    also = "; given twice, or once beside --pose-topic: of A and of B, in that order" * bool(of_two)
    add_frames(parser, "take the pose of the frame BODY in WORLD from /tf" + also, action, frames)


def add_frames(parser: argparse.ArgumentParser, text: str, action: str = "store", dest: str = "frames") -> None:
    """Add `--frames` with the help `text`."""
    parser.add_argument("--frames", metavar="WORLD:BODY", type=_frames, action=action, dest=dest, help=text)


def chosen_topics(args: argparse.Namespace) -> TopicChoice:
    """Return what the options say."""
    return _choice(args, args.pose_topic, args.twist_topic, args.frames)


def topics_of_two(args: argparse.Namespace) -> TopicChoice | tuple[TopicChoice, TopicChoice]:
    """Return what the options say about both; about each, where one of them is given twice."""
    given = [found or [None] for found in (args.pose, args.twist_topic)]
    most = max(map(len, given))
    if most > 2:
        args.parser.error(f"found a topic or frames {most} times, expected two, of A and of B; leave out the others")
    pairs = [[each[min(k, len(each) - 1)] for each in given] for k in (0, 1)]
    a, b = (
        _choice(args, None, twist, pose) if isinstance(pose, tuple) else _choice(args, pose, twist, None)
        for pose, twist in pairs
    )
    return (a, b) if most == 2 else a


def _choice(
    args: argparse.Namespace, pose: str | None, twist: str | None, frames: tuple[str, str] | None
) -> TopicChoice:
    from rb_dynamics.analysis.read_track import TopicChoice

    if pose and frames:
        args.parser.error("found --pose-topic and --frames, expected one source of the pose; leave out one of them")
    return TopicChoice(pose or "", twist or "", tuple(args.wrench_topic), frames)


def _frames(text: str) -> tuple[str, str]:
    world, colon, body = text.partition(":")
    if not (world and colon and body) or world == body:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected two frames such as world:base_link")
    return world, body
