"""Outcomes of the commands in a part of a log: those of what came and acted within it."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_runs import SCENE, fly

import rb_dynamics as rb
from rb_dynamics.loads.wrench import Wrench

PUSHES = [
    ("thrust", Wrench(torque=(0.1, 0.0, 0.0), frame_id=frame, stamp_ns=milliseconds * 1_000_000))
    for milliseconds, frame in ((400, "body"), (500, "nobody"), (1000, "body"), (1100, "world"), (2300, ""))
]


@pytest.mark.parametrize(
    ("channel", "window_s", "outcome"),
    [
        # Dropped to zero before the part: the command held until then was called rejected, the drop one of the part.
        ("timeout: 0.35", (1.6, 2.1), (0, 0, 0, 0)),
        # A rejected command came after the one that is held: that one was called a drop.
        ("timeout: 0.35", (0.6, 1.2), (2, 2, 1, 0)),
        # Waiting for the delay when the part begins, two of them; the last was the only one kept.
        ("timeout: 0.35, delay: 0.3", (1.2, 2.1), (0, 2, 1, 0)),
        # Acts between the last sample of the part and its end.
        ("timeout: 0.35, delay: 0.005", (0.9, 1.106), (2, 2, 0, 0)),
        # Of a lag the last value before the part is kept, not that of the command.
        ("lag: 0.2", (1.2, 2.1), (0, 0, None, 0)),
        ("lag: 0.2", (0.45, 1.2), (3, 2, None, 1)),
    ],
)
def test_a_part_counts_what_came_and_acted_within_it(
    channel: str, window_s: tuple[float, float], outcome: tuple[int | None, ...], tmp_path: Path
) -> None:
    flight = fly(tmp_path / "run.mcap", SCENE.replace("timeout: 0.35", channel), PUSHES)
    summary = rb.inspect(flight.log, window_s=window_s).summary
    (thrust,) = (each for each in summary.channels if each.topic == "/thrust")
    assert (thrust.received, thrust.applied, thrust.timeouts, thrust.rejected) == outcome
    assert any("rejected" in each for each in summary.warnings) == bool(outcome[3])
    assert any("timed out" in each for each in summary.warnings) == bool(outcome[2])


@pytest.mark.parametrize(("window_s", "outcome"), [((None, None), (6, 0, 6)), ((0.3, 0.6), (2, 0, 2))])
def test_a_command_beyond_the_limit_is_rejected_though_it_would_have_acted_after_the_end(
    window_s: tuple[float | None, float | None], outcome: tuple[int, int, int], tmp_path: Path
) -> None:
    """It was counted as one that waits, beside diagnostics that counted it as rejected."""
    late = Wrench(torque=(0.1, 0.0, 0.0), stamp_ns=2_900_000_000)
    bounded = SCENE.replace("timeout: 0.35", "delay: 0.3, max_torque: 0.05")
    flight = fly(tmp_path / "run.mcap", bounded, [*PUSHES, ("thrust", late)])
    summary = rb.inspect(flight.log, window_s=window_s).summary
    (thrust,) = (each for each in summary.channels if each.topic == "/thrust")
    assert (thrust.received, thrust.applied, thrust.rejected) == outcome
