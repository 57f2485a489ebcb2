"""The names of the metadata of a log, and what they record about the files of a bag and about software versions."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping

SCENE = "scene.yaml"
"""Name of the attachment of a log that contains its scene."""

RUN = "rb_dynamics"
"""Name of the metadata of a log with the facts of the run: `run_metadata`."""

RESULT = "rb_dynamics.result"
"""Name of the metadata of a log with the result of the run."""

CONTINUES_IN = "continues_in"
"""Key in it, in a file that is not the last of a bag, of the next file; such a result is not the end of a run."""

INTERRUPTED = "rb_dynamics.interrupted"
"""Name of the metadata in a log whose run, disk or power ended before the log was finished."""

CUT_OFF, DAMAGED = "cut off", "damaged"
"""Value of `reason` in it for a recovered file; "cut off and damaged" if it was both."""

UNPLACED = "unknown"
"""Stands in `missing_ns` beside the times of what is missing: a piece of which no time is known."""

MISSING_FILES = "missing_files"
"""Key in it of the missing files of a bag that has later ones."""

TOPICS = "rb_dynamics.topics"
"""Name of the metadata of a log that maps the scene's topic names to those in the log."""

INPUTS_RULE = "inputs_rule"
"""Key in the result of the rule by which `inputs_sha256` was computed; absent in logs of the first rule."""

CHECKPOINT = "rb_dynamics.checkpoint"
"""Name of the metadata written between samples: their number and the hash of all of them so far."""

EPOCH = "rb_dynamics.epoch"
"""Name of the metadata with the ROS time of simulation time 0, where messages are stamped with ROS time."""

EARLIER = "earlier"
"""Key in it, as it is read, of those before it: time from which each applies, and ROS time of time 0, in order."""

MERGED = "rb_dynamics.merged"
"""Name of the metadata of a bag that was made of others, or of a part of one."""

SIMULATION_TIME = {"log_time": "simulation"}
"""In it, if it has no messages but those of logs of this package."""


PART_NS = "part_ns"
"""Key in the metadata of a part of a bag: its first and last log time, without what is held from before."""

UNLOGGED = "effects_not_logged_as_wrench"
"""Key, in the facts of a run, of effects whose force and torque no topic has."""


def with_earlier(name: str, before: Mapping[str, str] | None, facts: dict[str, str]) -> dict[str, str]:
    """Return the metadata of a record that follows `before`, of the same name: of epochs, all count."""
    if name != EPOCH or before is None:
        return facts
    told = [each for each in (*_epochs_of(before), *_epochs_of(facts))[:-1] if each]
    return facts | {EARLIER: ", ".join(dict.fromkeys(told))}


def _epochs_of(facts: Mapping[str, str]) -> list[str]:
    last = f"{facts.get('from_time_ns', '')} {facts.get('epoch_ns', '')}"
    return [*facts.get(EARLIER, "").split(", "), last]


def epochs(metadata: Mapping[str, Mapping[str, str]]) -> list[tuple[int, int]]:
    """Return from which simulation time on time 0 was which ROS time, ns, in order; empty if that is not logged."""
    told = ", ".join(_epochs_of(metadata.get(EPOCH, {})))
    return [(int(since), int(zero)) for since, zero in re.findall(r"([0-9]{1,19}) ([0-9]{1,19})", told)]


def unlogged_key(topic: str) -> str:
    """Return the key that replaces it in a bag made of logs, one for each body: by the namespace of its topics."""
    return f"{UNLOGGED} {topic.rpartition('/')[0] or '/'}"


def unlogged(metadata: Mapping[str, Mapping[str, str]], topic: str) -> str:
    """Return the names of effects whose force and torque no topic has, as text; "" if there are none.

    `topic` is one of the motion: it says which body is meant in a bag that was made of several logs.
    """
    if RUN in metadata:
        return metadata[RUN].get(UNLOGGED, "")
    return metadata.get(MERGED, {}).get(unlogged_key(topic), "")


def in_simulation_time(metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Return whether the log time of each command is when it took effect in a run, whatever its stamp."""
    return RUN in metadata or metadata.get(MERGED, {}).items() >= SIMULATION_TIME.items()


def part_ns(metadata: Mapping[str, Mapping[str, str]]) -> tuple[int, int] | None:
    """Return first and last log time of a part, without what is held from before; None for what is no part."""
    found = re.fullmatch(r"([0-9]{1,19}) ([0-9]{1,19})", metadata.get(MERGED, {}).get(PART_NS, ""))
    return None if found is None else (int(found[1]), int(found[2]))


def missing_pieces(metadata: Mapping[str, Mapping[str, str]]) -> list[tuple[int, int]]:
    """Return first and last log time (ns) of each piece that is not here, in order: damaged, or between two files."""
    told = metadata.get(INTERRUPTED, {}).get("missing_ns", "")
    pieces = [(int(begin), int(end)) for begin, end in re.findall(r"([0-9]{1,19}) ([0-9]{1,19})", told)]
    return sorted((begin, end) for begin, end in pieces if begin <= end < 2**63)


def next_file(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return the file of a bag that follows the one with this metadata; "" if it is the last or does not say."""
    return metadata.get(RESULT, {}).get(CONTINUES_IN, "")


@functools.cache
def version(package: str = "rb_dynamics") -> str:
    """Return the installed version of `package` when first asked, or "not installed"."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def loss(complete: bool, metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return that a part of a bag is lost, to be said of its path; "" if none is known to be.

    `complete` and `metadata` are as reading the bag to its end leaves them.
    """
    if complete and INTERRUPTED not in metadata and not next_file(metadata):
        return ""
    return f"was {metadata.get(INTERRUPTED, {}).get('reason', CUT_OFF)}: what is missing is lost"
