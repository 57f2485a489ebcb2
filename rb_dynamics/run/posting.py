"""Post what is commanded in a run: a list in any order, an iterator, or arrays of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol, cast

from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_command_arrays import CommandBatch, Wrenches, listed
from rb_dynamics.numerics.argument_checks import shown, whole_number
from rb_dynamics.run.edge_schedule import FEWEST

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.run.simulation import Simulation

Command = tuple[str, Wrench | Setpoint]
"""A topic and what is commanded on it."""

Commands = Command | tuple[str, Wrenches]
"""The same, or many commands on one topic."""

LOOK_AHEAD = 1000
"""Commands that `simulate` reads ahead: within this number they may be in any order, and memory stays bounded."""

# Commands of a sequence that are posted together.
_AT_ONCE = 4_000


class Batches(Protocol):
    """Commands as arrays, such as those of a recording.

    Attributes:
        setpoints: commands to actuators, by topic.
        to_absent: times (ns) of commands to actuators that the scene does not have, by topic.
        first_stamps: topic and stamp (ns) of the first commands on each channel.
    """

    setpoints: Sequence[tuple[str, Setpoint]]
    to_absent: Mapping[str, npt.NDArray[np.int64]]
    first_stamps: Sequence[tuple[str, int]]

    def batches(self) -> Iterator[tuple[CommandBatch, int | None]]:
        """Yield batches in the order of effect, each with the time (ns) before which all commands have been yielded."""


def rejected_words(reasons: Sequence[str]) -> list[str]:
    """Return the warning about commands rejected for these reasons; none without any."""
    if not reasons:
        return []
    if len(reasons) == 1:
        return [f"1 command was rejected and had no effect: {reasons[0]}"]
    return [f"{len(reasons)} commands were rejected and had no effect; the first: {reasons[0]}"]


def _post_batches(run: Simulation, commands: Batches, rejected: list[str]) -> Iterator[int]:
    """As `post_ahead`, for commands as arrays."""
    rejected += _post(run, commands.setpoints)
    for topic, times_ns in commands.to_absent.items():
        # Not one text for each: a robot may have many such topics.
        first_ns = int(times_ns.min())
        rejected += run.try_post(topic, Setpoint(math.nan, first_ns), first_ns) * len(times_ns)
    for batch, until_ns in commands.batches():
        rejected += run.post_batch(batch)
        if until_ns is not None and until_ns > 0 and not run.ended:
            yield until_ns - 1
    if run.end_ns is not None:
        yield run.end_ns


def _post_sequence(run: Simulation, commands: Sequence[Commands], rejected: list[str]) -> Iterator[int]:
    """As `post_ahead`, for commands in any order."""
    came = _without_few(run, commands if _are_plain(commands) else [*each_command(commands)], rejected)
    if came is not None:
        first, order = 0, came.time_ns.argsort(kind="stable")
        times_ns = came.time_ns[order]
        while first < len(order):
            # Those of one time together, so that they keep their order of arrival.
            last_ns = int(times_ns[first : first + _AT_ONCE][-1])
            last = int(times_ns.searchsorted(last_ns, side="right"))
            rejected += run.post_batch(came.some(order[first:last]))
            first = last
            if last < len(order) and last_ns > 0 and not run.ended:
                yield last_ns
    if run.end_ns is not None:
        yield run.end_ns


def _stamp_ns(command: Command) -> int:
    return command[1].stamp_ns


def each_command(commands: Iterable[object]) -> Iterator[Command]:
    """Yield `commands` one by one, those of `Wrenches` too.

    Raises:
        TypeError: one is not a pair of a topic and a wrench or a setpoint.
    """
    for command in commands:
        if not (isinstance(command, (tuple, list)) and len(command) == 2 and isinstance(command[0], str)):
            raise _not_a_command(command)
        topic, wrench = command
        if isinstance(wrench, Wrenches):
            yield from ((topic, each) for each in wrench)
        elif isinstance(wrench, (Wrench, Setpoint)):
            if type(wrench.stamp_ns) is not int:
                whole_number(wrench.stamp_ns, "commands: stamp_ns", "give nanoseconds: round(1e9 * seconds)")
            # Not copied, because a run may have a million.
            yield command if isinstance(command, tuple) else (topic, wrench)
        else:
            raise _not_a_command(command)


def _not_a_command(found: object) -> TypeError:
    return TypeError(
        f"commands has {shown(found)}, expected a channel and a Wrench; write [('wrench', Wrench(force, torque))]"
    )


def _are_plain(commands: Sequence[object]) -> bool:
    """Return whether all are pairs of a topic and a `Wrench` with a stamp, or `Wrenches`: fast, for a million."""
    pairs = cast("Sequence[Commands]", commands)
    if {*map(type, pairs)} != {tuple} or {*map(len, pairs)} != {2}:
        return False
    topics, wrenches = {type(topic) for topic, _ in pairs}, [wrench for _, wrench in pairs]
    kinds = {*map(type, wrenches)}
    return topics == {str} and (
        kinds == {Wrenches} or (kinds == {Wrench} and {*map(type, map(attrgetter("stamp_ns"), wrenches))} == {int})
    )


def post_all(run: Simulation, commands: Sequence[Command]) -> list[str]:
    """Post `commands` to a run in the same order as `simulate`; return the reason for each rejected one.

    Raises:
        TypeError: one is not a pair of a topic and a wrench.
    """
    rejected: list[str] = []
    for _ in post_ahead(run, commands, rejected):
        pass
    return rejected


def post_ahead(run: Simulation, commands: Iterable[Commands], rejected: list[str]) -> Iterator[int]:
    """Post commands; yield repeatedly the time (ns) until which all have been posted, and finally the end."""
    if hasattr(commands, "batches"):
        yield from _post_batches(run, cast("Batches", commands), rejected)
        return
    if isinstance(commands, Sequence):
        yield from _post_sequence(run, commands, rejected)
        return
    if not isinstance(commands, Iterable):
        raise TypeError(f"commands is {shown(commands)}, expected (topic, wrench) pairs; give a list of them")
    known_ns, newest_ns = -1, 0
    waiting: list[Command] = []
    for topic, command in each_command(commands):
        stamp_ns = command.stamp_ns
        if stamp_ns > newest_ns:
            if len(waiting) >= LOOK_AHEAD and not run.ended:
                rejected += _post(run, waiting)
                known_ns, waiting = newest_ns, []
                yield known_ns
            newest_ns = stamp_ns
        elif max(stamp_ns, 0) <= known_ns:
            raise ValueError(
                f"commands: found one at {stamp_ns} ns when the run had reached {known_ns} ns, expected them in the "
                "order of their stamps; give a list, which may be in any order"
            )
        waiting.append((topic, command))
    rejected += _post(run, waiting)
    if run.end_ns is not None:
        yield run.end_ns


def _post(run: Simulation, commands: Sequence[Command]) -> list[str]:
    """Post commands that may be in any order; return the reason for each rejected one."""
    rejected: list[str] = []
    came = _without_few(run, commands, rejected)
    return rejected if came is None else rejected + run.post_batch(came.some(came.time_ns.argsort(kind="stable")))


def _without_few(run: Simulation, commands: Sequence[Commands], rejected: list[str]) -> CommandBatch | None:
    """Post those for which arrays do not pay: setpoints, those without a channel, a few; return the others as given."""
    topics, kinds = {topic for topic, _ in commands}, {type(command) for _, command in commands}
    numbers = {topic: number for topic in topics if (number := run.number_of(topic)) is not None}
    few = sum(len(each) if isinstance(each, Wrenches) else 1 for _, each in commands[:FEWEST]) < FEWEST
    if few or len(numbers) < len(topics) or Setpoint in kinds:
        apart = [each for each in commands if few or each[0] not in numbers or isinstance(each[1], Setpoint)]
        for topic, command in sorted(each_command(apart), key=_stamp_ns):
            rejected += run.try_post(topic, command, command.stamp_ns)
        if few:
            return None
        commands = [each for each in commands if each[0] in numbers and not isinstance(each[1], Setpoint)]
    channels, wrenches = [numbers[topic] for topic, _ in commands], [each for _, each in commands]
    if wrenches and isinstance(wrenches[0], Wrenches):
        many = zip(cast("list[Wrenches]", wrenches), channels, strict=True)
        return CommandBatch.joined([each.batch(channel, place) for place, (each, channel) in enumerate(many)])
    return listed(channels, cast("list[Wrench]", wrenches))
