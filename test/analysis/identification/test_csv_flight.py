"""Flights from tables with named columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from identified_flights import flown, guess

from rb_dynamics import LogError, RigidBody, identify
from rb_dynamics.analysis.identification.csv_flight import read_csv_flight
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, Flight

BODY = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
PHONE = {"time_s": ["Time (s)"], "gyro": ["Gyroscope x (rad/s)", "Gyroscope y (rad/s)", "Gyroscope z (rad/s)"]}


def write(path: Path, header: str, rows: list[str]) -> str:
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return str(path)


def phone(path: Path, flight: Flight) -> str:
    """Return a table as the app phyphox writes it, from some time of the day on."""
    stream = flight.streams[0]
    rows = [
        ",".join([f"{12.5 + time * 1e-9:.9f}", *map(repr, rate)])
        for time, rate in zip(stream.time_ns.tolist(), stream.values.tolist(), strict=True)
    ]
    return write(path, ",".join(f'"{name}"' for names in PHONE.values() for name in names), rows)


def test_a_gyro_in_a_table_tells_what_the_same_flight_does(tmp_path: Path) -> None:
    made = flown(BODY, np.random.default_rng(3), seconds=2.0, spin=(0.3, 5.0, 0.5), gyro=1e-3)
    found, same = (
        identify(guess(BODY), [given], ["inertia_ratios"], columns=PHONE)
        for given in (phone(tmp_path / "phone.csv", made), made)
    )

    assert found.passed
    assert [each.value for each in found.parameters] == [each.value for each in same.parameters]


def test_sensors_have_rates_of_their_own_and_only_changes_are_commands(tmp_path: Path) -> None:
    parts = {"gyro": "xyz", "orientation": "xyzw", "torque": "xyz"}
    header = ";".join(["time_ns", *(f"{part}_{axis}" for part, axes in parts.items() for axis in axes)])
    rows = [f"{k}0000000;0.{k};0;0;{'0;0;0;1' if k % 2 else ';;;'};{k // 4};0;0" for k in range(1, 9)]
    flight = read_csv_flight(write(tmp_path / "mixed.csv", header, rows), guess(BODY))

    assert [(stream.kind, len(stream.time_ns), stream.gyro) for stream in flight.streams] == [
        (ATTITUDE, 4, False),
        (RATES, 8, True),
    ]
    assert flight.span_ns == (0, 70_000_000)
    (channel,) = flight.channels
    assert channel.time_ns.tolist() == [0, 30_000_000, 70_000_000]
    assert channel.held[:, 3].tolist() == [0.0, 1.0, 2.0]


def test_force_and_torque_in_rows_of_their_own_are_held_until_their_next(tmp_path: Path) -> None:
    """Only rows with both counted: the others were left out without a word, and none with both was a traceback."""
    header = ",".join(["time_ns", *(f"{part}_{axis}" for part in ("gyro", "force", "torque") for axis in "xyz")])
    rows = ["0,0,0,1,,,,,,", "1,0,0,1,1,2,3,,,", "2,0,0,1,,,,4,5,6", "3,0,0,1,,,,,,", "4,0,0,1,7,,,,,"]
    (channel,) = read_csv_flight(write(tmp_path / "apart.csv", header, rows), guess(BODY)).channels

    assert channel.time_ns.tolist() == [1, 2, 4]
    assert channel.held[:, :6].tolist() == [[1, 2, 3, 0, 0, 0], [1, 2, 3, 4, 5, 6], [7, 2, 3, 4, 5, 6]]


def test_columns_of_wrenches_without_a_number_are_no_wrench(tmp_path: Path) -> None:
    header = ",".join(["time_ns", *(f"{part}_{axis}" for part in ("gyro", "force") for axis in "xyz")])
    assert not read_csv_flight(
        write(tmp_path / "none.csv", header, [f"{k},0,0,1,,," for k in range(5)]), guess(BODY)
    ).channels


def test_a_wrench_that_lacks_a_column_is_refused(tmp_path: Path) -> None:
    """It was passed over in silence, and the flight was fitted as if nothing of it had acted."""
    header = "time_ns,gyro_x,gyro_y,gyro_z,torque_x,torque_y"
    table = write(tmp_path / "part.csv", header, [f"{k},0,0,1,1,2" for k in range(5)])
    with pytest.raises(LogError, match="torque only torque_x, torque_y, expected torque_x, torque_y, torque_z"):
        read_csv_flight(table, guess(BODY))

    assert not read_csv_flight(table, guess(BODY), columns={"gyro": ["gyro_x", "gyro_y", "gyro_z"]}).channels


def test_what_acts_counts_by_its_usual_names_where_sensors_are_named(tmp_path: Path) -> None:
    """It was passed over, and the flight was fitted as one without a wrench; named sensors leave out all others."""
    header = "time_ns,wx,wy,wz,torque_x,torque_y,torque_z,position_world_x,position_world_y,position_world_z"
    table = write(tmp_path / "acting.csv", header, [f"{k},0,0,1,0,0,2,0,0,{k}" for k in range(5)])
    flight = read_csv_flight(table, guess(BODY), columns={"gyro": ["wx", "wy", "wz"]})

    assert [stream.kind for stream in flight.streams] == [RATES]
    assert flight.channels[0].held[:, :6].tolist() == [[0, 0, 0, 0, 0, 2]]


@pytest.mark.parametrize(("of", "words"), [("run", "gyro of a and of b"), ("topic", "gyro of a and of b")])
def test_a_sensor_of_several_runs_or_topics_is_refused(tmp_path: Path, of: str, words: str) -> None:
    """Their rows were taken for samples of one sensor; sensors of different topics are measured in their own rows."""
    header = f"{of},time_ns,gyro_x,gyro_y,gyro_z,position_world_x,position_world_y,position_world_z"
    apart = [f"{'ac'[k % 2]},{k}," + ("0,0,1,,,", ",,,0,0,1")[k % 2] for k in range(10)]
    assert len(read_csv_flight(write(tmp_path / "two.csv", header, apart), guess(BODY)).streams) == 2
    with pytest.raises(LogError, match=words):
        read_csv_flight(write(tmp_path / "one.csv", header, [*apart, "b,10,0,0,1,,,"]), guess(BODY))


def test_columns_that_convert_writes_need_no_names(tmp_path: Path) -> None:
    header = "time_ns," + ",".join(
        f"{part}_{axis}" for part in ("position_world", "angular_velocity_body") for axis in "xyz"
    )
    flight = read_csv_flight(write(tmp_path / "log.csv", header, [f"{k},0,0,{k},1,2,3" for k in range(5)]), guess(BODY))

    assert [stream.kind for stream in flight.streams] == [POSITION, RATES]
    assert flight.streams[1].values[0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("columns", "rows", "expected"),
    [
        ({"gyr": ["a"]}, [], "found 'gyr', expected some of .*; did you mean gyro?"),
        ({"gyro": ["wx", "wy"]}, [], "for gyro, expected 3 names of columns"),
        ({"gyro": ["wx", "wy", "wx"]}, [], "columns: found 'wx' 2 times, expected each column once"),
        ({"gyro": ["wx", "wy", "wq"]}, [], "found no columns 'wq' for gyro among time_s, wx"),
        ({"time_s": ["stamp"]}, ["0,1,2,3"] * 5, "found no columns 'stamp'"),
        ({"gyro": ["wx", "wy", "wz"]}, ["0,1,2,x"], "line 2, wz: found 'x', expected a number"),
        (
            {"time_ns": ["time_s"], "gyro": ["wx", "wy", "wz"]},
            ["1.5,1,2,3"],
            "line 2, time_s: found '1.5', expected a whole number",
        ),
        ({"gyro": ["wx", "wy", "wz"]}, ["0,1,2"], "line 2: found 3 cells, expected 4"),
        ({"gyro": ["wx", "wy", "wz"]}, ["1,1,2,3", "0,1,2,3"], "row 2 of numbers: found a time 1 s before"),
        ({"gyro": ["wx", "wy", "wz"]}, [], "a header and no row"),
        ({"gyro": ["wx", "wy", "wz"]}, ["0,1,2,3"], "found 1 samples of the motion"),
        ({}, ["0,1,2,3"], "found no motion in its columns"),
    ],
)
def test_tables_that_tell_nothing_are_refused(
    tmp_path: Path, columns: dict[str, list[str]], rows: list[str], expected: str
) -> None:
    with pytest.raises(LogError, match=expected):
        read_csv_flight(write(tmp_path / "bad.csv", "time_s,wx,wy,wz", rows), guess(BODY), columns=columns)


@pytest.mark.parametrize(("name", "time"), [("time_s", "1e300"), ("time_ns", str(2**63 + 5)), ("time_us", "-1e16")])
def test_a_time_that_64_bits_do_not_hold_is_named(tmp_path: Path, name: str, time: str) -> None:
    table = write(tmp_path / "far.csv", f"{name},gyro_x,gyro_y,gyro_z", [f"{time},1,2,3"])
    with pytest.raises(
        LogError, match=rf"far.csv, line 2, {name}: found '{re.escape(time)}', expected less than 2\^62"
    ):
        read_csv_flight(table, guess(BODY))


@pytest.mark.parametrize("far", [-(10**18), 10**18])
def test_a_time_far_from_all_the_others_is_left_out(tmp_path: Path, far: int) -> None:
    rows = [f"{time},0,0,1" for time in sorted([far, *range(0, 3 * 10**9, 10**7)])]
    found = read_csv_flight(write(tmp_path / "one.csv", "time_ns,gyro_x,gyro_y,gyro_z", rows), guess(BODY))
    assert found.span_ns == (0, 299 * 10**7)
    assert any("1 of 301 times are far from all the others" in note for note in found.notes)


@pytest.mark.parametrize("held", [25, 1])
def test_an_accelerometer_at_the_time_of_a_command_does_not_make_a_delay(tmp_path: Path, held: int) -> None:
    """Whether a sample shows what acted before a command at its very time or after it is not known."""
    random, count = np.random.default_rng(2), 200
    made = flown(BODY, random, seconds=2.0, torque=1.0, force=2.0, gyro=1e-3, pose=1e-3)
    (channel,), (gyro, attitude, position) = made.channels, made.streams
    acting = np.vstack([channel.held, channel.held[-1:]])[:, :6]
    told = acting + 1e-9 * (np.arange(count + 1) % 2)[:, None] * (held == 1)
    # This sensor shows what acts from a command on.
    force = acting[:, :3] / BODY.mass + 1e-2 * random.standard_normal((count + 1, 3))
    parts = {"gyro": gyro.values, "orientation": attitude.values, "position": position.values, "accelerometer": force}
    parts |= {"force": told[:, :3], "torque": told[:, 3:]}
    names = ["time_ns", *(f"{part}_{'xyzw'[k]}" for part, v in parts.items() for k in range(v.shape[1]))]
    rows = np.hstack(list(parts.values())).tolist()
    lines = [",".join([str(t), *map(repr, row)]) for t, row in zip(gyro.time_ns.tolist(), rows, strict=True)]
    path = write(tmp_path / "flight.csv", ",".join(names), lines)

    found = identify(guess(BODY), [path], ["inertia", "mass", "accelerometer"])

    assert not any(each.found for each in found.omissions)
    assert all(each.white for each in found.residuals)
    left_out = 8 if held == 25 else 201
    assert any(f"{left_out} of 201 samples of accelerometer acceleration" in note for note in found.notes)
