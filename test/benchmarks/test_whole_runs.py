"""The benchmark of whole runs: its scene and bag say what the problem says, and its table what was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

import rb_dynamics as rb
from rb_dynamics.logs.wrench_bags import RecordedWrenches

pytest.importorskip("matplotlib")


def test_scene_and_bag_are_the_problem(script: Callable[[str], ModuleType], tmp_path: Path) -> None:
    whole_runs = script("whole_runs")
    task = whole_runs.problem("driven")
    few = {name: getattr(task, name)[:100] for name in ("force_body", "torque_body", "force_world")}
    whole_runs.write_inputs(replace(task, duration=1.0, **few), tmp_path)

    scene = rb.read_scene(tmp_path / "scene.yaml")
    commands = list(RecordedWrenches([tmp_path / "bag.mcap"], ["thrusters", "wind"]))
    assert (scene.duration, scene.solver.accuracy, len(commands)) == (1.0, 1e-9, 200)
    assert commands[2 * 37 + 1][1].stamp_ns == 370_000_000
    assert commands[2 * 37][1].force == tuple(task.force_body[37])
    assert (commands[2 * 37 + 1][1].frame_id, commands[2 * 37 + 1][1].force) == ("world", tuple(task.force_world[37]))


def test_ratios_are_those_of_each_turn(script: Callable[[str], ModuleType]) -> None:
    whole_runs = script("whole_runs")
    table = whole_runs.rows({whole_runs.PLAIN: [1.0, 2.0, 4.0], "`replay` of the log": [2.0, 4.0, 8.0], "one": [3.0]})

    assert table == [
        ("`simulate SCENE --wrench BAG`", "2.00 s", "1.0"),
        ("`replay` of the log", "4.00 s", "2.0"),
        ("one", "3.00 s", "1.5"),
    ]


def test_goals_are_met_or_missed(script: Callable[[str], ModuleType]) -> None:
    whole_runs = script("whole_runs")
    found = {whole_runs.PLAIN: [1.0], whole_runs.LOGGED: [3.0], whole_runs.SHOWN: [9.0], whole_runs.REPLAYED: [6.0]}
    long = [("360 s, 1 output a second", "", "9,000", ""), ("3600 s, 1 output a second", "", "2,999", "")]
    logs = [("MCAP", "", "1,500,000 messages/s"), ("Rerun", "", "4,999,999 rows/s")]

    assert [row[1:] for row in whole_runs.goals(found, {"heyoka": 0.5}, long, logs)] == [
        ("<= 1", "2.0", "**missed**"),
        ("<= 4", "3.0", "met"),
        ("<= 8", "9.0", "**missed**"),
        ("<= 2", "2.0", "met"),
        (">= 3,000", "2,999", "**missed**"),
        (">= 1,500,000", "1,500,000", "met"),
        (">= 5,000,000", "4,999,999", "**missed**"),
    ]
    assert len(whole_runs.goals(found, {}, long, logs)) == 6
