"""`convert`: a log to a table (CSV, Parquet), a Rerun recording or its scene; a table of commands to an MCAP bag.

Numbers are those of the log, with all digits. What a log does not hold (the defects of the momenta) is left out of a
table and is NaN in a recording.
"""

from __future__ import annotations

import csv
import itertools
import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from rb_dynamics.conversion.bag_to_table import (
    ORIENTATION,
    POSITION,
    QUANTITIES,
    Poses,
    Skip,
    Span,
    columns_of,
    quantities_of,
    table_of,
)
from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.channel_metadata import log_channel, qos_profile
from rb_dynamics.formats.log_metadata import EPOCH, RESULT, RUN, SCENE, loss, version
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.merging import merge
from rb_dynamics.formats.message_types import SCALAR, TRANSFORM, TRANSFORMS, WRENCH
from rb_dynamics.formats.output_file import OutputFile, renamed, require_other
from rb_dynamics.formats.tables import Column, Rows, write_table
from rb_dynamics.formats.transforms import transforms
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import NAMING, AppliedWrench, is_topic_name
from rb_dynamics.logs.bag_reader import IMUS, POSES, TWISTS, named_type
from rb_dynamics.logs.messages import (
    APPLIED,
    COMMAND_DEPTH,
    WHEELS,
    acting,
    decode_wrench,
    encode_received,
    encode_setpoint,
)
from rb_dynamics.logs.own_log import (
    SampleRow,
    logged_scene,
    received_commands,
    received_setpoints,
    row_blocks,
    row_columns,
    rows,
    scene_and_names,
)
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.number_parsing import real_number, time_in_ns
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.run.sample import unit_of
from rb_dynamics.run.sink import RunInfo, Sample
from rb_dynamics.scene.model import Scene

_logger = logging.getLogger(__name__)

_NUMBERS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
_TIMES = ("time_ns", "time_s")
_BATCH = 10_000
_TO_CONVERT = "converted, as nothing says which of its topics are the samples of one body"

_COMMAND_COLUMNS = (
    Column("time_ns", "whole", "ns"),
    Column("topic", "text"),
    Column("frame_id", "text"),
    *(Column(name, unit="N" if name.startswith("force") else "N m") for name in _NUMBERS),
)
_SETPOINT = "command"
_SETPOINT_COLUMNS = (
    Column("time_ns", "whole", "ns"),
    Column("topic", "text"),
    Column(_SETPOINT),
    Column("unit", "text"),
)


class Written(NamedTuple):
    """A table that was written: the file, the number of its rows, and what they are."""

    path: Path
    rows: int
    what: str


Window = tuple[float | None, float | None]
"""First and last time, s; None: from the start, or to the end."""

_WHOLE: Window = (None, None)
_MOTIONS = {*POSES, *TWISTS, *IMUS}


@dataclass(frozen=True)
class _Input:
    """A log or bag that has been read through: its kind, and the messages of each topic and type.

    One topic may be of two types, in a bag or in two of them.
    """

    path: Path
    source: Source
    motion_ns: int
    counts: Counter[tuple[str, str]]
    ends_ns: tuple[int, int]

    def span(self, window_s: Window) -> Span:
        """Return the log times of a window: s of simulation time, or since the first message of a motion.

        Raises:
            LogError: there is no time in it.
        """
        begin_s, end_s = window_s
        if begin_s is not None and end_s is not None and end_s < begin_s:
            raise LogError(
                f"{self.path}: found --from {begin_s:g} --to {end_s:g} s, expected a time in between; exchange them"
            )
        zero_ns = 0 if self.own else self.motion_ns
        return Span(
            -math.inf if begin_s is None else zero_ns + round(begin_s * 1e9),
            math.inf if end_s is None else zero_ns + round(end_s * 1e9),
        )

    @property
    def own(self) -> bool:
        return RUN in self.source.metadata

    def of(self, topics: set[str]) -> list[tuple[str, str]]:
        """Return topic and type of those of these topics that it has."""
        return [(topic, kind) for topic, kind in self.counts if topic in topics]


def to_table(
    paths: Sequence[str | Path],
    target: Path,
    topics: Sequence[str] = (),
    skip: Skip | None = None,
    window_s: Window = _WHOLE,
    covariances: bool = False,
) -> list[Written]:
    """Write logs or bags to one table, .csv or .parquet; returns the files with their rows.

    Of logs of this package: their samples, and beside it their commands, if any, those of wrenches to `*.wrenches.*`
    and those to actuators to `*.actuators.*`; of several, with a column `run`. Of bags of other programs, and where
    `topics` are named: a row for each message.

    Args:
        paths: the logs or bags.
        target: the table.
        topics: names of topics; all, if empty.
        skip: called with each log of several, and of each topic with messages, that cannot be read, with the reason;
            without it that is an error.
        window_s: the part of the time that is wanted: simulation time, or since the first message of a motion.
        covariances: of messages, whether they are wanted, too.

    Raises:
        LogError: nothing can be converted, logs of this package are mixed with bags, or a file is read itself or cannot
            be written.
        MissingExtraError: a .parquet file without pyarrow.
    """
    beside = {kind: target.with_name(f"{target.stem}.{kind}{target.suffix}") for kind in _COMMANDS}
    for path in (target, *beside.values()):
        require_other(path, *paths)
    inputs = list(_looked_through(paths, skip, bool(topics)))
    _require_some(inputs, window_s)
    own = [each for each in inputs if each.own]
    if not topics and own and len(own) < len(inputs):
        other = next(each for each in inputs if not each.own)
        raise LogError(
            f"found logs of rb_dynamics ({own[0].path}) and bags of other programs ({other.path}), expected one kind "
            "for one table; convert them to two"
        )
    if own and not topics:
        if covariances:
            raise LogError(
                f"{own[0].path}: samples have no covariances, expected messages; name topics with --pose-topic, or "
                "leave out --covariances"
            )
        return _samples_to_table(own, target, beside, skip, window_s)
    kinds = dict.fromkeys(pair for each in inputs for pair in each.counts)
    quantities = quantities_of(kinds, ", ".join(str(each.path) for each in inputs), topics, covariances)
    for each in inputs:
        _name_left_out(each, topics)
    spans = {each.path: each.span(window_s) for each in inputs}
    blocks = table_of([each.path for each in inputs], quantities, topics, spans, skip)
    return [Written(target, write_table(target, columns_of(quantities), blocks), "messages")]


def poses_to_table(poses: Iterable[tuple[Path, Poses]], target: Path, paths: Sequence[Path]) -> Written:
    """Write poses of frames, each with the bag it comes from, to a table .csv or .parquet; `paths` are all bags.

    Raises:
        LogError: a bag cannot be read, or `target` is one of them or cannot be written.
        MissingExtraError: a .parquet file without pyarrow.
    """
    require_other(target, *paths)
    rows = (found.rows(str(path)) for path, found in poses)
    return Written(target, write_table(target, columns_of((POSITION, ORIENTATION)), rows), "poses")


def _looked_through(paths: Sequence[str | Path], skip: Skip | None, split: bool) -> Iterator[_Input]:
    """Yield each input; `split`: with the pairs of frames of a log of this package too."""
    found = False
    for number, path in enumerate(map(Path, paths)):
        source, counts = open_source(path), Counter[tuple[str, str]]()
        first: dict[bool, int] = {}
        last_ns = 0
        try:
            for block in source.blocks():
                kind = named_type(block.channel)
                counts[block.channel.topic, kind] += len(block.log_times)
                moves, begin_ns = kind in _MOTIONS, int(block.log_times.min())
                first[moves] = min(first.get(moves, begin_ns), begin_ns)
                last_ns = max(last_ns, int(block.log_times.max()))
                if kind == TRANSFORMS and (split or RUN not in source.metadata):
                    for part in transforms(block).blocks:
                        counts[part.channel.topic, TRANSFORM] += len(part.log_times)
        except LogError as error:
            if skip is None or (number == len(paths) - 1 and not found):
                raise
            skip(path, error)
            continue
        found = True
        if skip is not None and (lost := loss(source.complete, source.metadata)):
            skip(path, LogError(f"{path} {lost}"))
        ends_ns = min(first.values(), default=0), last_ns
        yield _Input(source.path, source, first.get(True, first.get(False, 0)), counts, ends_ns)


def _require_some(inputs: Sequence[_Input], window_s: Window, span: Span | None = None) -> None:
    """Refuse a part of the time in which nothing was recorded; `span`: that of all, instead of one of each.

    Raises:
        LogError: it is before or behind all inputs.
    """
    for each in inputs:
        part, (first_ns, last_ns) = span or each.span(window_s), each.ends_ns
        if part.first_ns <= last_ns and part.last_ns >= first_ns:
            return
    each = inputs[0]
    zero_ns = 0 if each.own else each.motion_ns
    first_s, last_s = ((end - zero_ns) * 1e-9 for end in each.ends_ns)
    named = zip(("from", "to"), window_s, strict=True)
    asked = " ".join(f"{name} {value:g} s" for name, value in named if value is not None)
    raise LogError(
        f"{each.path}: found nothing {asked}, expected a part of the recording, which goes from {first_s:.6g} to "
        f"{last_s:.6g} s; give --from and --to within it"
    )


def _name_left_out(found: _Input, topics: Sequence[str]) -> None:
    """Warn of topics with messages, of those wanted, whose quantities are not known."""
    wanted = {name.lstrip("/") for name in topics}
    left = {
        (topic, kind)
        for topic, kind in found.counts
        if kind not in (*QUANTITIES, TRANSFORMS) and (not wanted or topic.lstrip("/") in wanted)
    }
    _warn_of(found, left, "left out, as types without known quantities")


def _warn_of(found: _Input, left: Iterable[tuple[str, str]], why: str) -> None:
    named = [f"{topic} ({kind}, {found.counts[topic, kind]} messages)" for topic, kind in sorted(left)]
    if named:
        _logger.warning("%s: %s: %s", found.path, why, ", ".join(named))


def _samples_to_table(
    logs: Sequence[_Input], target: Path, beside: Mapping[str, Path], skip: Skip | None, window_s: Window
) -> list[Written]:
    parts: list[_Part] = []
    span = logs[0].span(window_s)
    for each in logs:
        try:
            scene, names = scene_and_names(each.source, _TO_CONVERT)
        except LogError as error:
            if skip is None or (each is logs[-1] and not parts):
                raise
            skip(each.path, error)
            continue
        parts.append((each.path, scene, names))
        devices = {names[sensor.name] for sensor in scene.sensors}
        _warn_of(each, each.of(devices), "not in the samples, a table of messages has those that --pose-topic names")
        wheels = {names[WHEELS[0]] for _ in scene.wheels}
        _warn_of(each, each.of(wheels), "in no table, inspect shows them")
    wide = dict.fromkeys(name for _, scene, names in parts for name in row_columns(scene, names))
    run = [Column("run", "text")] if len(logs) > 1 else []
    columns = [*run, Column("time_ns", "whole", "ns"), *(Column(name, unit=unit_of(name)) for name in wide)]

    def samples() -> Iterator[Rows]:
        for path, scene, names in parts:
            place = {name: k for k, name in enumerate(row_columns(scene, names))}
            for times, numbers in row_blocks(scene, names, open_source(path).blocks()):
                kept = (times >= span.first_ns) & (times <= span.last_ns)
                if not kept.any():
                    continue
                found = numbers[kept]
                block: list[Any] = [times[kept], *(found[:, place[name]] if name in place else None for name in wide)]
                yield [[str(path)] * len(found), *block] if run else block

    written = [Written(target, write_table(target, columns, samples()), "samples")]
    commands = (_commands_to_table(kind, parts, run, beside[kind], span) for kind in _COMMANDS)
    return [*written, *filter(None, commands)]


def _commands_to_table(
    kind: str, parts: Sequence[_Part], run: Sequence[Column], target: Path, span: Span
) -> Written | None:
    """Write one of `_COMMANDS` of logs to a table, if there are any; `run` is a column for the log, if it is wanted."""
    columns, lines, what = _COMMANDS[kind]

    def blocks() -> Iterator[Rows]:
        for path, scene, names in parts:
            for batch in _batches(line for line in lines(path, scene, names) if line[0] in span):
                block = list(zip(*batch, strict=True))
                yield [[str(path)] * len(batch), *block] if run else block

    found = blocks()
    # An earlier table beside these samples would look like their commands.
    if not (first := list(itertools.islice(found, 1))) and not target.exists():
        return None
    return Written(target, write_table(target, [*run, *columns], itertools.chain(first, found)), what)


def _wrench_lines(path: Path, scene: Scene, names: dict[str, str]) -> Iterator[tuple[Any, ...]]:
    messages = _messages_of(path, {names[channel.topic] for channel in scene.channels})
    for topic, wrench, time_ns in received_commands(scene, names, messages):
        yield time_ns, topic, wrench.frame_id, *wrench.force, *wrench.torque


def _setpoint_lines(path: Path, scene: Scene, names: dict[str, str]) -> Iterator[tuple[Any, ...]]:
    units = {actuator.topic: actuator.unit for actuator in scene.actuators}
    messages = _messages_of(path, {names[topic] for topic in units}) if units else iter(())
    for topic, value, time_ns in received_setpoints(scene, names, messages):
        yield time_ns, topic, value, units[topic]


_Part: TypeAlias = "tuple[Path, Scene, dict[str, str]]"
"""A log, its scene, and what the topics of the scene are called in it."""
_Lines: TypeAlias = Callable[[Path, Scene, "dict[str, str]"], Iterator[tuple[Any, ...]]]
"""Gives the rows of commands in a log, the time first."""

# Tables of commands beside that of the samples, by what stands in their names.
_COMMANDS: dict[str, tuple[tuple[Column, ...], _Lines, str]] = {
    "wrenches": (_COMMAND_COLUMNS, _wrench_lines, "commands"),
    "actuators": (_SETPOINT_COLUMNS, _setpoint_lines, "commands to actuators"),
}


def _messages_of(path: Path, topics: set[str]) -> Iterator[Message]:
    """Yield messages among which are those of these topics, in the order of the file."""
    source = open_source(path)
    if len(topics) > 1:
        yield from source.messages()
        return
    for block in source.blocks():
        if block.channel.topic in topics:
            yield from block.messages()


def log_to_rerun(
    log: str | Path, target: Path, topics: Sequence[str] = (), window_s: Window = _WHOLE, skip: Skip | None = None
) -> int:
    """Write a log as a Rerun recording; returns the samples, of a bag of another program the messages.

    `skip` is called with each topic of a bag with messages that cannot be read; without it that is an error.

    Raises:
        LogError: `log` has nothing to show, or `target` is `log` itself or cannot be written.
        MissingExtraError: rerun-sdk is not installed.
    """
    from rb_dynamics.conversion.bag_to_rerun import bag_to_rerun
    from rb_dynamics.sinks.rerun_sink import RerunSink

    require_other(target, log)
    (found,) = _looked_through([log], skip, bool(topics))
    _require_some([found], window_s)
    if topics or not found.own:
        quantities_of(found.counts, str(found.path), topics)
        _name_left_out(found, topics)
        return bag_to_rerun(found.path, target, topics, found.span(window_s), skip)
    source = found.source
    scene, names = scene_and_names(source, _TO_CONVERT)
    facts = source.metadata[RUN]
    applied = {names[name + APPLIED]: name for name in acting(scene)}
    count, span = 0, found.span(window_s)
    with renamed(target) as new:
        sink = RerunSink(new, called=target)
        sink.open(RunInfo(scene, facts.get("method", ""), facts))
        try:
            columns = row_columns(scene, names)
            for item in _part(_events(scene, names, applied, open_source(log).messages()), span):
                if isinstance(item, SampleRow):
                    sink.write(_sample(dict(zip(columns, item.numbers, strict=True)), item.time_ns))
                    count += 1
                else:
                    sink.write(item)
        finally:
            sink.close(source.metadata.get(RESULT, {}))
    return count


def merge_bags(paths: Sequence[Path], target: Path, window_s: Window = _WHOLE) -> tuple[Written, list[str]]:
    """Write bags, or a part of one, to one MCAP file, which is a bag and not a log of a run; returns remarks, too.

    `window_s` counts from the first message of a motion in any of them; with a log of this package, from its time 0.

    Raises:
        LogError: as `merge`, or two logs of this package have the same topics.
    """
    require_other(target, *paths)
    inputs = list(_looked_through(paths, None, split=False))
    notes = [*_logs_together([each for each in inputs if each.own])]
    moving = [each for each in inputs if _MOTIONS & {kind for _, kind in each.counts}] or inputs
    span = min(moving, key=lambda each: 0 if each.own else each.motion_ns).span(window_s)
    _require_some(inputs, window_s, span)
    found = merge(paths, target, span)
    return Written(target, found.messages, "messages"), [*notes, *found.notes]


def _logs_together(logs: Sequence[_Input]) -> Iterator[str]:
    """Yield remarks on logs of this package that become one bag.

    Raises:
        LogError: two have a topic of motion in common: each begins at time 0, so two bodies would be on it.
    """
    if logs:
        yield "the messages are those of the log, but no run: replay needs the log itself"
    for one, other in itertools.combinations(logs, 2):
        theirs = {topic for topic, _ in other.counts}
        common = [topic for topic, kind in one.counts if kind in _MOTIONS and topic in theirs]
        if common:
            raise LogError(
                f"{one.path} and {other.path} are two runs, both with {common[0]} from time 0 on, expected topics "
                "of its own for each body: they would look like one body that jumps. Run the nodes in namespaces, or "
                "write the logs to one table (.csv, .parquet), which says what is of which"
            )
        scenes = [logged_scene(each.source.attachments) for each in (one, other)]
        frames = {scene.frames.body_frame for scene in scenes if scene is not None}
        if len(frames) == 1 and None not in scenes:
            yield (
                f"{one.path} and {other.path} both move the frame {min(frames)} on /tf: viewers show one body there; "
                "give each its own body.frame"
            )
        epochs = [each.source.metadata.get(EPOCH, {}).get("epoch_ns", "") for each in (one, other)]
        if all(each.isdecimal() for each in epochs) and epochs[0] != epochs[1]:
            yield (
                f"time 0 of {other.path} is {(int(epochs[1]) - int(epochs[0])) * 1e-9:.9g} s after that of {one.path} "
                "on the ROS clock; both are 0 here, as in the logs"
            )


def log_to_scene(log: str | Path, target: Path) -> None:
    """Write the scene of a log as it is attached: the text that was run, with changes and meshes as numbers in it.

    Raises:
        LogError: `log` is not a log of this package, or `target` is `log` itself or cannot be written.
    """
    require_other(target, log)
    source = open_source(log)
    for _ in source.messages():
        pass
    if SCENE not in source.attachments:
        raise LogError(f"{source.path} has no {SCENE} attached, expected a log of this package; give one of its logs")
    with OutputFile.whole(target) as file:
        file.write(source.attachments[SCENE])


def table_to_bag(table: Path, target: Path) -> int:
    """Write a CSV of commands as an MCAP bag; returns the rows.

    Columns: `time_ns` (integer) or `time_s`; of wrenches `force_x` ... `torque_z` (N, N m) and, where they are given,
    `topic` (default "wrench") and `frame_id` (default "": body axes); to actuators `command` and `topic`.

    Raises:
        LogError: the table cannot be read, naming line and column, or has no commands, or `target` is `table` or cannot
            be written.
    """
    require_other(target, table)
    # Topics may follow each other in a table, and rows stand in any order.
    commands = sorted(_read_commands(table), key=lambda each: each[0])
    if not commands:
        raise LogError(f"{table}: found no rows below the columns, expected commands; give a table with at least one")
    qos = qos_profile(COMMAND_DEPTH)
    kinds = {topic: SCALAR if isinstance(command, float) else WRENCH for _, topic, command in commands}
    channels = {topic: log_channel(topic, kind, qos) for topic, kind in kinds.items()}
    with OutputFile.whole(target) as file:
        writer = McapWriter(file, f"rb_dynamics {version()}")
        writer.begin()
        ids = {topic: writer.add_channel(channel) for topic, channel in channels.items()}
        for time_ns, topic, command in commands:
            data = encode_setpoint(command) if isinstance(command, float) else encode_received(command)
            writer.add_messages((ids[topic],), (data,), time_ns, time_ns)
        writer.finish()
    return len(commands)


def _read_commands(table: Path) -> Iterator[tuple[int, str, Wrench | float]]:
    """Yield time, topic and command of each row; warn of those that no run accepts."""
    odd: list[str] = []
    back: list[str] = []
    last: dict[str, int] = {}
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            found = reader.fieldnames or []
            numbers = (_SETPOINT,) if _SETPOINT in found else _NUMBERS
            missing = [name for name in numbers if name not in found]
            if missing or not set(_TIMES) & set(found):
                raise LogError(
                    f"{table}: the columns are {list(found)}, expected time_ns or time_s, and of wrenches "
                    f"{', '.join(_NUMBERS)}, with topic and frame_id if need be, of commands to actuators topic and "
                    f"{_SETPOINT}; name them so, separated by commas"
                )
            twice = [name for name in (*numbers, *_TIMES, "topic", "frame_id") if found.count(name) > 1]
            if twice or set(found) >= set(_TIMES):
                raise LogError(
                    f"{table}: there are several columns {', '.join(twice or _TIMES)}, expected one; remove the others"
                )
            run = None
            for row in reader:
                where = f"{table}, line {reader.line_num}"
                # A decimal comma adds a cell, and shifts all that follow.
                if None in row or None in row.values():
                    raise LogError(
                        f"{where}: found {'more' if None in row else 'fewer'} cells than the {len(found)} columns, "
                        "expected as many; write numbers with a decimal point, and cells with a comma in quotes"
                    )
                run = row.get("run") if run is None else run
                if row.get("run") != run:
                    raise LogError(
                        f"{where}, run: found {row['run']}, expected one run, {run}, as each begins at time 0; make a "
                        "table of the commands of each"
                    )
                time_ns = _time_ns(row, where)
                values = [_number(row[name], f"{where}, {name}") for name in numbers]
                topic = row.get("topic") or ("wrench" if numbers is _NUMBERS else "")
                if not is_topic_name(topic):
                    raise LogError(f"{where}, topic: found {shown(topic)}, expected a ROS topic name; {NAMING}")
                topic = "/" + topic.removeprefix("/")
                back += [where] * (time_ns < last.get(topic, time_ns))
                last[topic] = time_ns
                cells = zip(numbers, values, strict=True)
                odd += [f"{where}, {name}: {row[name]}" for name, number in cells if not math.isfinite(number)][:1]
                if numbers is _NUMBERS:
                    force, torque = (values[0], values[1], values[2]), (values[3], values[4], values[5])
                    yield time_ns, topic, Wrench(force, torque, row.get("frame_id") or "", time_ns)
                else:
                    yield time_ns, topic, values[0]
        if odd:
            _logger.warning("commands that are not finite, which a run rejects: %d; the first: %s", len(odd), odd[0])
        if back:
            _logger.warning(
                "commands that are earlier than the one before on their topic, put in the order of time: %d; first: "
                "%s; if these are several runs, make a table of each",
                len(back),
                back[0],
            )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"cannot read {table}: {reason}; check the path, and give a CSV file in UTF-8") from error


def _time_ns(row: dict[str, str], where: str) -> int:
    name, unit = ("time_ns", 1) if "time_ns" in row else ("time_s", 10**9)
    try:
        # As the decimal number that was written: a float would lose nanoseconds of a long run.
        time_ns = time_in_ns(row[name].strip(), unit)
    except ValueError as error:
        raise LogError(f"{where}, {name}: found {shown(row[name])}, expected {error}; correct the cell") from None
    if not 0 <= time_ns < 2**31 * 10**9:
        raise LogError(
            f"{where}, {name}: found {shown(row[name])}, expected a time from 0 to 2^31 s (68 years); count from the "
            "start of the run"
        )
    return time_ns


def _number(text: str | None, where: str) -> float:
    try:
        return real_number((text or "").strip())
    except ValueError:
        raise LogError(f"{where}: found {shown(text)}, expected a number; correct the cell") from None


def _events(
    scene: Scene, names: dict[str, str], applied: dict[str, str], messages: Iterator[Message]
) -> Iterator[SampleRow | AppliedWrench]:
    """Yield rows and changes of wrench in the order of the log."""
    changes: list[AppliedWrench] = []
    # The wrench of a channel with a lag is logged at each output: only when a command begins to act is it a change.
    lagging = {names[each.topic]: each for each in scene.channels if each.lag}
    began: dict[str, set[int]] = {each.topic: set() for each in scene.channels if each.lag}

    def noted() -> Iterator[Message]:
        for message in messages:
            if channel := lagging.get(message.channel.topic):
                began[channel.topic].add(message.log_time + channel.delay_ns)
            topic = applied.get(message.channel.topic)
            if topic is not None:
                time_ns = message.log_time
                wrench = decode_wrench(WRENCH, time_ns, message.data)
                change = AppliedWrench(time_ns, topic, None, wrench.frame_id, wrench.force, wrench.torque)
                if topic in began and time_ns not in began[topic]:
                    change = replace(change, on_its_way=True)
                elif topic in began:
                    began[topic].remove(time_ns)
                changes.append(change)
            yield message

    for row in rows(scene, names, noted()):
        # A change at the time of a sample comes after it.
        before = [change for change in changes if change.time_ns < row.time_ns]
        yield from before
        del changes[: len(before)]
        yield row
    yield from changes


def _part(events: Iterator[SampleRow | AppliedWrench], span: Span) -> Iterator[SampleRow | AppliedWrench]:
    """Yield the events of a part of the time, beginning with the wrenches held at its start."""
    held: dict[str, AppliedWrench] = {}
    for event in events:
        if event.time_ns in span:
            held.pop(event.topic if isinstance(event, AppliedWrench) else "", None)
            yield event
            yield from (replace(change, time_ns=event.time_ns) for change in held.values())
            held = {}
        elif isinstance(event, AppliedWrench) and event.time_ns < span.first_ns:
            held[event.topic] = event


def _sample(numbers: dict[str, float], time_ns: int) -> Sample:
    def vector(name: str) -> tuple[float, float, float]:
        return numbers[f"{name}_x"], numbers[f"{name}_y"], numbers[f"{name}_z"]

    attitude = (*vector("orientation"), numbers["orientation_w"])
    unknown = (math.nan, math.nan, math.nan)
    return Sample(
        time_ns,
        vector("position_world"),
        attitude,
        rotate(attitude, vector("linear_velocity_body")),
        vector("angular_velocity_body"),
        vector("angular_momentum_world"),
        vector("linear_momentum_world"),
        numbers["kinetic_energy"],
        numbers["work"],
        numbers["energy_defect"],
        unknown,
        unknown,
        numbers.get("potential_energy"),
        motor_work=numbers.get("motor_work"),
        friction_heat=numbers.get("friction_heat"),
    )


def _batches(lines: Iterable[Sequence[Any]]) -> Iterator[list[Sequence[Any]]]:
    lines = iter(lines)
    while batch := list(itertools.islice(lines, _BATCH)):
        yield batch
