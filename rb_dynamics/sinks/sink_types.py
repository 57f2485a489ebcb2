"""Sinks by name, as in `--sink NAME=TARGET`. A new one is a file with one sink and an entry here.

A name stands for a function that makes a sink for a target, in most cases a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from rb_dynamics.errors import LogError
from rb_dynamics.plugins import Registry
from rb_dynamics.run.sink import Sink
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.rosbag2_sink import BagSink

MakeSink = Callable[[str], Sink]


@dataclass(frozen=True)
class SinkOptions:
    """Options of our own logs, the same for each way to ask for one.

    Attributes:
        namespace: put before relative topic names.
        remap: absolute names of single topics, by relative name; they win over `namespace`.
        max_bag_size: bytes at which a bag begins its next file; 0: no bound.
        max_bag_duration: s of simulation time in one file of a bag; 0: no bound.
        settings: of MCAP files.
    """

    namespace: str = ""
    remap: Mapping[str, str] | None = None
    max_bag_size: int = 0
    max_bag_duration: float = 0.0
    settings: LogSettings = field(default_factory=LogSettings)


def sinks(texts: Iterable[str], options: SinkOptions) -> list[Sink]:
    """Return a new sink for each NAME=TARGET.

    Raises:
        LogError: one is not that, or there is no sink of the name.
        PluginError: one is of a plug-in that cannot be loaded.
    """
    known = _known(options)
    return [_sink(text, known) for text in texts]


def _known(options: SinkOptions) -> Registry[MakeSink]:
    o = options
    return Registry(
        "sink",
        {
            "mcap": lambda target: McapSink(target, o.namespace, o.remap, o.settings),
            "bag": lambda target: BagSink(target, o.max_bag_size, o.max_bag_duration, o.namespace, o.remap, o.settings),
            "rerun": _rerun,
        },
        _fault,
    )


def _rerun(target: str) -> Sink:
    # It needs more to be imported than the others.
    from rb_dynamics.sinks.rerun_sink import RerunSink

    return RerunSink(target)


def _sink(text: str, known: Registry[MakeSink]) -> Sink:
    name, equals, target = text.partition("=")
    if not (equals and target):
        raise LogError(f"sink: found {text!r}, expected NAME=TARGET such as mcap=run.mcap")
    if name not in known:
        raise LogError(
            f"sink: found {name!r}, expected one of {', '.join(known)}; write one of them, or install the plug-in that "
            "has it"
        )
    return known[name](target)


def _fault(_: str, found: object) -> str:
    return "" if callable(found) else f"{found!r}, expected a function that makes a sink for a target"
