"""`read_csv_flight`: a flight from a CSV file with named columns, in SI units.

Each row has a time. An empty cell was not measured at that time, so each sensor may have its own rate.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.acting_wrenches import channels_of, which_channel
from rb_dynamics.analysis.gaps import without_strays
from rb_dynamics.analysis.identification.flights import (
    ACCELERATION,
    ATTITUDE,
    NO_WRENCH,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    WrenchSeries,
    acting_elsewhere,
    commanded,
    unknown_commands,
)
from rb_dynamics.analysis.read_track import TopicChoice
from rb_dynamics.analysis.track import Array, Times, unit_rows
from rb_dynamics.analysis.wheel_speeds import WheelSpeeds
from rb_dynamics.errors import LogError, did_you_mean
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.numerics.number_parsing import real_number, time_in_ns
from rb_dynamics.scene.model import Scene

# ns in the unit of each column of times.
_TIMES = {"time_s": 10**9, "time_ms": 10**6, "time_us": 10**3, "time_ns": 1}
# ns; differences of times fit in 64 bits.
_END_OF_TIME = 2**62
_XYZ = ("x", "y", "z")
# Columns by which `convert` says of which run, bag and topic a row is.
_ORIGINS = ("run", "source", "topic")

Mask = NDArray[np.bool_]

QUANTITIES = {
    "time_s": ("time_s",),
    "time_ms": ("time_ms",),
    "time_us": ("time_us",),
    "time_ns": ("time_ns",),
    "attitude": ("orientation_x", "orientation_y", "orientation_z", "orientation_w"),
    "position": tuple(f"position_world_{axis}" for axis in _XYZ),
    "velocity_world": tuple(f"linear_velocity_world_{axis}" for axis in _XYZ),
    "velocity_body": tuple(f"linear_velocity_body_{axis}" for axis in _XYZ),
    "rates": tuple(f"angular_velocity_body_{axis}" for axis in _XYZ),
    "gyro": tuple(f"gyro_{axis}" for axis in _XYZ),
    "accelerometer": tuple(f"accelerometer_{axis}" for axis in _XYZ),
    "force": tuple(f"force_{axis}" for axis in _XYZ),
    "torque": tuple(f"torque_{axis}" for axis in _XYZ),
}
"""What columns may hold, and their names unless others are given; those that `convert` writes, and of sensors.

Of a scene with reaction wheels also `wheels`: `wheel_speed_NAME` of each.
"""

_KINDS = {
    "attitude": ATTITUDE, "position": POSITION, "velocity_world": VELOCITY, "velocity_body": VELOCITY, "rates": RATES,
    "gyro": RATES, "accelerometer": ACCELERATION,
}  # fmt: skip

_ACTING = ("force", "torque", "wheels")


def read_csv_flight(
    path: str,
    scene: Scene,
    commands: Sequence[str] = (),
    columns: Mapping[str, Sequence[str]] | None = None,
    wrench_topics: tuple[str, ...] = (),
) -> Flight:
    """Return what the table measured; `columns` are the names of its columns by `QUANTITIES`, where they are others.

    Position and velocity are those of the body origin; `gyro`, `rates`, `accelerometer`, `force` and `torque` are in
    body axes; `wheels` are the speeds (rad/s) of all reaction wheels of the scene, in its order. A wrench is held until
    the next; `commands` are bags with wrenches of the same clock, on `wrench_topics`, or all of them.

    Raises:
        LogError: the file cannot be read, lacks a column, has a cell that is not a number, or has times that go back.
    """
    turning = {"wheels": tuple(f"wheel_speed_{wheel.name}" for wheel in scene.wheels)} if scene.wheels else {}
    times, found = _read(path, dict(columns or {}), QUANTITIES | turning)
    if missing := [name for name in turning if name not in found]:
        raise LogError(
            f"{path}: found no speeds of {', '.join(wheel.name for wheel in scene.wheels)}, expected a column of each: "
            f"{', '.join(turning[missing[0]])}; name them, as in --columns wheels=a,b, or leave the wheels out with "
            "--set actuators=[] if they stood still"
        )
    measured: dict[str, Mask] = {name: np.asarray(np.isfinite(v).all(axis=1)) for name, v in found.items()}
    moving = [quantity for quantity in _KINDS if quantity in found and measured[quantity].any()]
    if not moving:
        raise LogError(
            f"{path}: found no motion in its columns, expected some of {', '.join(_KINDS)}; name the columns, as in "
            "--columns gyro=wx,wy,wz"
        )
    seen = np.logical_or.reduce([measured[quantity] for quantity in moving])
    kept, notes = without_strays(times[seen]), list[str]()
    zero, end = (int(each) for each in times[seen][kept][[0, -1]])
    if far := int(((times < zero) | (times > end))[seen].sum()):
        notes.append(f"{far} of {int(seen.sum())} times are far from all the others, and are left out")
    streams = []
    for quantity in moving:
        rows = measured[quantity] & (times >= zero) & (times <= end)
        at, values = times[rows] - zero, found[quantity][rows]
        if quantity == "attitude":
            _require_unit(path, values)
            values = unit_rows(values)
        world, gyro = quantity == "velocity_world", quantity == "gyro"
        streams.append(Stream(quantity, _KINDS[quantity], at, values, world=world, gyro=gyro))
    channels = [*_wrench(found, times - zero, scene, path)]
    elsewhere, heard = acting_elsewhere(commands, scene, zero, end, path, notes, TopicChoice(wrenches=wrench_topics))
    channels += elsewhere
    unknown = unknown_commands(scene, heard, False, notes)
    notes += [] if channels else [NO_WRENCH]
    wheels = WheelSpeeds.of("wheels", times - zero, found["wheels"]) if turning else None
    notes += [*wheels.remarks, *wheels.beyond(scene.wheels)] if wheels else []
    flight = Flight(path, tuple(streams), tuple(channels), tuple(notes), zero_ns=zero, unknown=unknown)
    return (flight.turning(wheels) if wheels else flight).between_commands()


def _wrench(found: Mapping[str, Array], times: Times, scene: Scene, path: str) -> Iterator[WrenchSeries]:
    empty = np.full((len(times), 3), np.nan)
    cells = np.hstack([found.get(name, empty) for name in ("force", "torque")])
    given = np.isfinite(cells).any(axis=1)
    if given.any():
        cells = cells[given]
        # Force and torque may have rows of their own: each number is held until the next in its column.
        last = np.maximum.accumulate(np.where(np.isfinite(cells), np.arange(len(cells))[:, None], -1), axis=0)
        held = np.where(last < 0, 0.0, np.take_along_axis(cells, np.maximum(last, 0), axis=0))
        nothing = np.zeros((len(cells), 9))
        channel = channels_of(["wrench"], scene).get("wrench")
        if doubt := which_channel({"wrench": channel}, scene):
            raise LogError(f"{path}: {doubt}; call the channel of its force and torque wrench in the scene")
        acting = commanded("wrench", times[given], np.hstack([held, nothing]), channel or Channel())
        # Only a change is a command.
        changes = np.append(True, (np.diff(acting.held, axis=0) != 0.0).any(axis=1))[: len(acting.held)]
        yield WrenchSeries(acting.topic, acting.time_ns[changes], acting.held[changes])


def _require_unit(path: str, attitudes: Array) -> None:
    norms = np.linalg.norm(attitudes, axis=1)
    if len(norms) and float(np.abs(norms - 1.0).max()) > 1e-2:
        worst = float(norms[int(np.abs(norms - 1.0).argmax())])
        raise LogError(
            f"{path}: found a quaternion of length {worst:.3g} in the columns of attitude, expected 1; name those of "
            "x, y, z, w"
        )


def _read(
    path: str, columns: dict[str, Sequence[str]], quantities: Mapping[str, tuple[str, ...]]
) -> tuple[Times, dict[str, Array]]:
    """Return the times (ns) and the values (n, k) of each quantity; NaN where a cell is empty."""
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            header = file.readline()
            # As spreadsheets of some countries write it.
            separator = max(",;\t", key=header.count)
            names = [name.strip() for name in next(csv.reader([header], delimiter=separator), [])]
            wanted = _places(path, names, columns, quantities)
            marks = [names.index(name) for name in _ORIGINS if name in names]
            rows, origins = [], []
            for number, cells in enumerate(csv.reader(file, delimiter=separator), start=2):
                if cells:
                    rows.append(_numbers(path, number, cells, names, wanted))
                    origins.append(tuple(cells[k] for k in marks))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"cannot read {path}: {reason}; check the path, and give a CSV file in UTF-8") from error
    if not rows:
        raise LogError(f"{path}: found a header and no row, expected one for each sample; record the flight again")
    times = np.array([time for time, _ in rows], dtype=np.int64)
    steps = np.diff(times)
    if back := np.flatnonzero(steps < 0).tolist():
        raise LogError(
            f"{path}, row {back[0] + 2} of numbers: found a time {-steps[back[0]] * 1e-9:.6g} s before that of the row "
            "above, expected ascending times; sort the rows, or name the column of the time that counts up"
        )
    table = np.array([numbers for _, numbers in rows], dtype=np.float64)
    found, at = {}, 0
    for quantity, places in wanted.items():
        if quantity not in _TIMES:
            found[quantity] = table[:, at : at + len(places)]
            at += len(places)
            of = {origins[row] for row in np.flatnonzero(np.isfinite(found[quantity]).any(axis=1)).tolist()}
            if len(of) > 1:
                one, other, *_ = (" ".join(filter(None, each)) for each in sorted(of))
                raise LogError(
                    f"{path}: found {quantity} of {one} and of {other}, expected one run and one topic, as of one "
                    "sensor; convert them to tables of their own"
                )
    return times, found


def _places(
    path: str, names: Sequence[str], columns: dict[str, Sequence[str]], quantities: Mapping[str, tuple[str, ...]]
) -> dict[str, list[int]]:
    """Return where the columns of each quantity stand, one of times among them."""
    for quantity, given in columns.items():
        usual = quantities.get(quantity)
        if usual is None:
            mend = did_you_mean(quantity, quantities, "write one of them")
            raise LogError(f"columns: found {quantity!r}, expected some of {', '.join(quantities)}; {mend}")
        if isinstance(given, str) or len(given) != len(usual):
            raise LogError(
                f"columns: found {shown(given)} for {quantity}, expected {len(usual)} "
                f"name{'s' if len(usual) > 1 else ''} of columns; give them in the order of {', '.join(usual)}"
            )
    # Where columns are named, no other sensors count; but the time and what acts need not be named.
    times = [name for name in _TIMES if name in columns] or [name for name in _TIMES if name in names]
    if len(times) != 1:
        raise LogError(
            f"{path}: found {len(times) or 'no'} column{'s' * (len(times) != 1)} of time among {', '.join(names)}, "
            f"expected one of {', '.join(_TIMES)}; name it, as in --columns time_s=stamp"
        )
    known = {q: own for q, own in quantities.items() if q not in _TIMES and set(own) <= set(names)}
    asked = {q: tuple(given) for q, given in columns.items() if q not in _TIMES}
    asked = {q: own for q, own in known.items() if q in _ACTING} | asked if asked else known
    for quantity in ("force", "torque"):
        # A sensor may be left out, but not a part of what acts.
        if not columns and quantity not in asked and (part := sorted(set(quantities[quantity]) & set(names))):
            raise LogError(
                f"{path}: found of {quantity} only {', '.join(part)}, expected {', '.join(quantities[quantity])}; add "
                "the others, with 0 where nothing acts, or rename these"
            )
    asked[times[0]] = tuple(columns.get(times[0], quantities[times[0]]))
    if "gyro" in asked and not columns:
        # Of a table with both, the gyro is what was measured.
        asked.pop("rates", None)
    taken = Counter(name for given in asked.values() for name in given)
    for quantity, given in asked.items():
        for name in given:
            if taken[name] > 1:
                raise LogError(f"columns: found {name!r} {taken[name]} times, expected each column once; name another")
            if names.count(name) != 1:
                raise LogError(
                    f"{path}: found {names.count(name) or 'no'} columns {name!r} for {quantity} among "
                    f"{', '.join(names)}, expected one; name another column"
                )
    return {quantity: [names.index(name) for name in given] for quantity, given in asked.items()}


def _numbers(
    path: str, line: int, cells: Sequence[str], names: Sequence[str], wanted: Mapping[str, Sequence[int]]
) -> tuple[int, list[float]]:
    """Return the time (ns) and the numbers of a row."""
    if len(cells) != len(names):
        raise LogError(
            f"{path}, line {line}: found {len(cells)} cells, expected {len(names)}, as many as columns; write numbers "
            "with a decimal point, and cells with a comma in quotes"
        )
    time_ns, found = 0, []
    for quantity, places in wanted.items():
        for place in places:
            cell = cells[place].strip()
            try:
                if quantity in _TIMES:
                    # As the decimal number that was written: a float would lose nanoseconds of a wall clock.
                    time_ns = _time_ns(cell, _TIMES[quantity])
                else:
                    found.append(real_number(cell) if cell else math.nan)
            except ValueError as error:
                expected = error if quantity in _TIMES else "a number"
                raise LogError(
                    f"{path}, line {line}, {names[place]}: found {shown(cells[place])}, expected {expected}; correct "
                    "the cell" + ("" if quantity in _TIMES else ", or leave it empty where nothing was measured")
                ) from None
    return time_ns, found


def _time_ns(cell: str, unit: int) -> int:
    """Return a time, ns; see `time_in_ns`."""
    time_ns = time_in_ns(cell, unit)
    if abs(time_ns) >= _END_OF_TIME:
        raise ValueError("less than 2^62 ns (146 years) either way")
    return time_ns
