"""`SINKS`: what a run can be told to by name, as `--sink NAME=TARGET` does. A new one is one file and one entry here.

Never opens anything: a name stands for a function that makes a new sink for a target, a file in most cases.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from rb_dynamics.errors import LogError
from rb_dynamics.plugins import Registry
from rb_dynamics.recording.sink import Sink

MakeSink = Callable[[str], Sink]


def _from(module: str, name: str) -> MakeSink:
    """Return what makes the sink `name` of a module of this folder, imported when it is asked for one."""

    def make(target: str) -> Sink:
        made: Sink = getattr(importlib.import_module(f"rb_dynamics.recording.{module}"), name)(target)
        return made

    return make


def _fault(_: str, found: object) -> str:
    return "" if callable(found) else f"{found!r}, expected a function that makes a sink for a target"


SINKS: Registry[MakeSink] = Registry(
    "sink",
    {
        "mcap": _from("mcap_sink", "McapSink"),
        "bag": _from("bag_sink", "BagSink"),
        "rerun": _from("rerun_sink", "RerunSink"),
    },
    _fault,
)


def sink(text: str) -> Sink:
    """Return a new sink for NAME=TARGET.

    Raises:
        LogError: it is not that, or there is no sink of the name.
        PluginError: it is of a plug-in that cannot be loaded.
    """
    name, equals, target = text.partition("=")
    if not (equals and target):
        raise LogError(f"sink: found {text!r}, expected NAME=TARGET such as mcap=run.mcap")
    if name not in SINKS:
        raise LogError(
            f"sink: found {name!r}, expected one of {', '.join(SINKS)}; write one of them, or install the plug-in that "
            "has it"
        )
    return SINKS[name](target)
