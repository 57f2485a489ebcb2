"""A motion as bags of other programs: with other stamps, axes, holes or without a twist; for tests of `compare`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from bag_rows import Row, write_rows
from numpy.typing import NDArray

from rb_dynamics.formats import cdr
from rb_dynamics.formats.message_types import POSE, TWIST, WRENCH
from rb_dynamics.logs.bag_reader import Bag, read_bag
from rb_dynamics.numerics.rotation_arrays import product

Array = NDArray[Any]
TURN = np.array([0.0, 0.0, np.sin(0.05), np.cos(0.05)])  # 0.1 rad about z


def foreign(
    path: Path,
    log: Path,
    *,
    later_ns: int = 0,
    every: int = 1,
    without: Iterable[tuple[float, float]] = (),
    twist: bool = True,
    negative: bool = False,
    turned_body: bool = False,
    shifted: tuple[float, float, float] = (0.0, 0.0, 0.0),
    commands: Iterable[tuple[str, int, tuple[float, ...]]] = (),
    frame: str = "body",
    pauses: Mapping[float, float] | None = None,
) -> Path:
    """Write the motion in `log` as a bag of another program.

    Args:
        path: of the new bag.
        log: of this package.
        later_ns: is added to all stamps.
        every: of so many samples one is kept.
        without: first and last time (s) of holes.
        twist: whether the bag has one.
        negative: turns the sign of every other quaternion.
        turned_body: the body axes are turned by `TURN`.
        shifted: is added to the positions, m.
        commands: topic, time (ns) and force and torque in the axes of `frame`.
        frame: of the commands.
        pauses: how long (s) the body stood still after which time (s), while the stamps went on.
    """

    def later(at: int) -> int:
        return at + later_ns + sum(round(1e9 * by) for since, by in (pauses or {}).items() if at > 1e9 * since)

    source: Bag = read_bag(log)
    times, poses = source.poses("/pose")
    _, twists = source.twists("/twist")
    kept = np.arange(len(times)) % every == 0
    for begin, end in without:
        kept &= (times * 1e-9 <= begin) | (times * 1e-9 >= end)
    rows: list[Row] = []
    for number in np.flatnonzero(kept).tolist():
        at, position, attitude = later(int(times[number])), poses[number, :3] + shifted, poses[number, 3:]
        if turned_body:
            attitude = product(attitude, TURN)
        if negative and number % 2:
            attitude = -attitude
        values = (*position.tolist(), *attitude.tolist())
        rows.append(("/vicon/pose", POSE, at, cdr.encode(POSE, at, "world", values)))
        if twist:
            rows.append(("/vicon/twist", TWIST, at, cdr.encode(TWIST, at, "body", tuple(twists[number].tolist()))))
    for topic, at, numbers in commands:
        rows.append((topic, WRENCH, later(at), cdr.encode(WRENCH, later(at), frame, numbers)))
    return write_rows(path, sorted(rows, key=lambda row: row[2]))
