"""Write a log in another format, chosen by the name of OUT: a Rerun recording, a CSV or a Parquet table, or its scene.

A table has one line per logged sample, with all digits; commands go to files beside it, with .wrenches or .actuators
before the ending of OUT. Of a bag of another program, or of named topics, a table has one line per message: source,
topic, type, frames, log time, stamp, and the quantities with their units. Several inputs make one table, which says in
the column run or source where each row comes from. The scene is the text in the log, which can be run again or edited;
with --at S, it continues from the state at S with the same bits. Bags and logs become one MCAP file, each message byte
for byte, with --from and --to a part; it is a bag, which replay does not accept. A log and one that continues it (--at)
become the log of the whole run. A CSV of wrenches (time_ns or time_s, force_x ... torque_z, and topic and frame_id if
needed) or of commands to actuators (time_ns or time_s, topic, command) becomes an MCAP bag for simulate --wrench. An
earlier OUT is replaced.

Exit codes: 0 done; 1 what could not be read, some of several inputs or some messages, is left out and named; 2 bad
input.
"""

from __future__ import annotations

import argparse
import sys
from decimal import Decimal
from typing import TYPE_CHECKING

from rb_dynamics.cli.parser import add_window
from rb_dynamics.cli.topic_arguments import add_frames
from rb_dynamics.numerics.command_line_numbers import real

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from rb_dynamics.conversion.bag_to_table import Poses, Skip
    from rb_dynamics.conversion.convert import Window, Written

_TABLES = (("log", ".csv"), ("log", ".parquet"))

HELP = "write a log as .rrd, .csv or .parquet, its scene as .yaml, bags or a .csv of commands as .mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `convert`."""
    parser.add_argument(
        "source", metavar="IN", nargs="+",
        help="log of a run or any bag (file or rosbag2 folder), or .csv of commands; several give one table",
    )  # fmt: skip
    parser.add_argument("target", metavar="OUT", help="name that ends in .rrd, .csv, .parquet, .yaml or .mcap")
    parser.add_argument(
        "--at", type=real("a number of seconds, 0 or more", lambda v: v >= 0.0), metavar="S",
        help="of a .yaml: begin the scene with the state at S, so that it continues with the same bits",
    )  # fmt: skip
    add_window(parser, "convert")
    for kind in ("pose", "twist", "wrench"):
        parser.add_argument(
            f"--{kind}-topic", dest="topics", metavar="TOPIC", action="append", default=[],
            help=f"convert this topic of a {kind}, and no others that are not named; may be repeated",
        )  # fmt: skip
    parser.add_argument(
        "--covariances", action="store_true", help="of a table of messages: with a column for each element"
    )
    add_frames(parser, "of a table: the pose of the frame BODY in WORLD alone, through all transforms between them")


def run(args: argparse.Namespace) -> int:
    """Convert; exit code 0, or 1 if a log of several or a message could not be read."""
    from pathlib import Path

    from rb_dynamics.conversion import convert
    from rb_dynamics.errors import LogError

    sources, target = [Path(source) for source in args.source], Path(args.target)
    source, bad = sources[0], list[Path]()
    way = ("table" if source.suffix == ".csv" else "log", target.suffix)
    window = (args.from_s, args.to_s)
    _require_fitting(args, target, way)

    def skip(path: Path, error: LogError) -> None:
        bad.append(path)
        print(f"rb-dynamics: left out: {error}", file=sys.stderr)

    if way == ("log", ".mcap"):
        written = [_merged(sources, target, window)]
    elif args.frames:
        written = [convert.poses_to_table(_poses(sources, args.frames, window, skip), target, sources)]
    elif way in _TABLES:
        written = convert.to_table(sources, target, args.topics, skip, window, args.covariances)
    elif way == ("log", ".rrd"):
        written = [convert.Written(target, convert.log_to_rerun(source, target, args.topics, window, skip), "rows")]
    elif way in (("log", ".yaml"), ("log", ".yml")) and args.at is not None:
        return _scene_at(source, target, args.at)
    elif way in (("log", ".yaml"), ("log", ".yml")):
        convert.log_to_scene(source, target)
        print(f"wrote {target}: the scene of {source}")
        return 0
    elif way == ("table", ".mcap"):
        written = [convert.Written(target, convert.table_to_bag(source, target), "commands")]
    else:
        raise LogError(
            f"cannot convert {source.name} to {target.name}, expected a log to .rrd, .csv, .parquet or .yaml, a "
            "bag to .rrd, .csv, .parquet or .mcap, or a .csv of commands to .mcap; give OUT such an ending"
        )
    for path, count, what in written:
        print(f"wrote {path}: {count} {what}")
    return 1 if bad else 0


def _require_fitting(args: argparse.Namespace, target: Path, way: tuple[str, str]) -> None:
    """End with a usage error where an option does not fit what is converted to what."""
    if len(args.source) > 1 and way not in (*_TABLES, ("log", ".mcap")):
        args.parser.error(
            f"found {len(args.source)} inputs for {target.name}, expected one; only .csv, .parquet and .mcap take more"
        )
    if args.at is not None and way not in (("log", ".yaml"), ("log", ".yml")):
        args.parser.error(
            f"found --at for {target.name}, expected a scene; give OUT the ending .yaml, or leave out --at"
        )
    if (args.from_s, args.to_s) != (None, None) and way not in (*_TABLES, ("log", ".rrd"), ("log", ".mcap")):
        args.parser.error(f"found --from or --to for {target.name}, expected a .csv, .parquet, .rrd or .mcap")
    if args.topics and way not in (*_TABLES, ("log", ".rrd")):
        args.parser.error(f"found a topic for {target.name}, expected none; only .csv, .parquet and .rrd have topics")
    if args.covariances and (args.frames or way not in _TABLES):
        args.parser.error(
            f"found --covariances for {target.name}, expected a .csv or .parquet of messages; leave it out"
        )
    if args.frames and (args.topics or way not in _TABLES):
        args.parser.error(f"found --frames for {target.name}, expected a .csv or .parquet and no topics; leave one out")


def _merged(sources: Sequence[Path], target: Path, window_s: Window) -> Written:
    from rb_dynamics.conversion.convert import Written, merge_bags
    from rb_dynamics.study.continued_run import whole_run

    if len(sources) > 1 and window_s == (None, None) and (samples := whole_run(sources, target)) is not None:
        return Written(target, samples, "samples of one run")
    written, notes = merge_bags(sources, target, window_s)
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    return written


def _poses(
    sources: Sequence[Path], frames: tuple[str, str], window_s: Window, skip: Skip
) -> Iterator[tuple[Path, Poses]]:
    """Yield the poses of one frame in another in each bag; of several, those without them are left out."""
    from rb_dynamics.analysis.transform_tree import other_ways, pose_between
    from rb_dynamics.conversion.bag_to_table import Poses
    from rb_dynamics.errors import LogError
    from rb_dynamics.formats.log_metadata import RUN, loss
    from rb_dynamics.logs.bag_reader import read_bag

    found = False
    for number, path in enumerate(sources):
        try:
            bag = read_bag(path)
            pose = pose_between(bag, *frames)
            for told in other_ways(bag, *frames):
                print(f"note: {path}: {told}", file=sys.stderr)
            if lost := loss(bag.complete, bag.metadata):
                skip(path, LogError(f"{path} {lost}"))
            used = {name.partition(" ")[0] for name in pose.topics}
            for topic in (each for each in bag.topics.values() if each.name in used and each.damaged):
                skip(path, LogError(f"{path}: topic {topic.name}: {topic.unread}"))
        except LogError as error:
            if number == len(sources) - 1 and not found:
                raise
            skip(path, error)
            continue
        found = True
        time_s = (pose.time_ns - (0 if RUN in bag.metadata else pose.time_ns[0])) * 1e-9
        first_s, last_s = window_s
        wanted = (time_s >= (time_s[0] if first_s is None else first_s)) & (
            time_s <= (time_s[-1] if last_s is None else last_s)
        )
        yield path, Poses(", ".join(pose.topics), frames, pose.time_ns[wanted], pose.values[wanted])


def _scene_at(source: Path, target: Path, at_s: float) -> int:
    """Write the scene that continues a log at a time; exit code 0."""
    from rb_dynamics.formats.output_file import OutputFile, require_other
    from rb_dynamics.study.continued_run import scene_at

    require_other(target, source)
    found = scene_at(source, round(Decimal(repr(at_s)) * 10**9))
    with OutputFile.whole(target) as file:
        file.write(found.text.encode())
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"wrote {target}: continues {source} from {at_s!r} s")
    if found.later:
        print(f"with its later commands: simulate {target} --wrench {source} --wrench-start {at_s!r}")
    return 0
