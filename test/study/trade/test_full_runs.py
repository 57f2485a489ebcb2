"""Checks over the whole scene: each verdict includes what the excerpt does not contain."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import motions
import pytest

from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.study.stopwatch import Stopwatch
from rb_dynamics.study.trade.excerpt import trial_of
from rb_dynamics.study.trade.full_runs import FullRuns
from rb_dynamics.study.trade.result import TradeRow, recommend

SCENE = (
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\nduration: 8\n"
)
# After the excerpt, where they have no part in its errors.
COMMANDS = [
    ("wrench", Wrench((1.0, 0.0, 0.0), (0.4 * math.cos(k), 0.4 * math.sin(k), 0.2), "body", (2 + k) * 1_000_000_000))
    for k in range(6)
]
# As measured where nothing acts: the coarsest setting is as good as the reference.
ROW = TradeRow("taylor", None, 1e-3, 0.0, 0.0, 0.0, 1e-14, True, 0.0, 0.0, 0.0, 1e-6, 1e6, 1e-6, 10, None, False)


def runs(rows: list[TradeRow], seconds: float = 1e3) -> tuple[Scene, FullRuns]:
    """Return the scene and the `FullRuns` of `rows` measured over its first second."""
    scene = parse_scene(SCENE)
    trial = trial_of(scene, COMMANDS, 0.01, Stopwatch(time.process_time, 0.0, None)).part(1.0).look()
    return scene, FullRuns(trial, COMMANDS, rows, seconds)


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")


@pytest.mark.parametrize(
    "row",
    [ROW, replace(ROW, method="rk4", step=0.1, accuracy=None)],
    ids=["by accuracy", "by step"],
)
def test_the_most_accurate_row_is_itself_checked_to_the_end(row: TradeRow) -> None:
    scene, whole = runs([row])
    assert whole.checked_by is row
    verdict = whole.judge(row)
    ends = [simulate(replace(scene, solver=one), COMMANDS).sample for one in (row.as_solver, Solver(accuracy=1e-11))]
    error = motions.attitude_error(ends[0].orientation_xyzw, ends[1].orientation_xyzw)
    assert verdict.measured
    assert 1e-9 < error <= verdict.error
    assert recommend([row], 1e-9, None, whole.judge, 1.0) is None


@pytest.mark.parametrize(
    "row",
    [replace(ROW, method="dverk"), replace(ROW, method="rk4", step=0.5, accuracy=None)],
    ids=["by accuracy", "by step"],
)
def test_steps_that_commands_end_do_not_check_themselves(row: TradeRow) -> None:
    """With commands every 0.05 s, coarse and finer settings take the same steps; before, the body hardly turns."""
    torque = (0.6, 0.4, -0.2)
    turning = [("wrench", Wrench((0.0, 0.0, 0.0), torque, "body", k * 50_000_000)) for k in range(20, 160)]
    scene = parse_scene(SCENE.replace("[0.1, 2, 0.1]", "[0.001, 0.002, 0.001]"))
    trial = trial_of(scene, turning, 0.01, Stopwatch(time.process_time, 0.0, None)).part(1.0).look()
    whole = FullRuns(trial, turning, [row], 1e3)
    ends = [simulate(replace(scene, solver=one), turning).sample for one in (row.as_solver, Solver(accuracy=1e-12))]
    error = motions.attitude_error(ends[0].orientation_xyzw, ends[1].orientation_xyzw)
    assert 1e-11 < error <= whole.judge(row).error


def test_where_the_most_accurate_cannot_go_on_the_next_is_compared_with() -> None:
    """A closed form ends where a torque tilts the axis."""
    exact = replace(ROW, method="exact", accuracy=None, error=0.0)
    _, whole = runs([exact, ROW])
    assert whole.checked_by is ROW
    assert whole.judge(exact).error == math.inf
    _, none = runs([exact])
    assert none.checked_by is None
    assert none.judge(ROW).error == math.inf


@pytest.mark.parametrize("budget", [None, 1.0])
def test_what_is_not_checked_to_the_end_is_not_said_to_hold_there(budget: float | None) -> None:
    _, whole = runs([ROW], seconds=1e-9)
    found = recommend([ROW], 1e-9, budget, whole.judge, 1.0)
    assert found is not None
    assert not found.whole.measured
    assert found.reason.endswith(" over the first 1 s; extrapolated from there, not checked to the end")
    checked = recommend([ROW], 1e-9, budget)
    assert checked is not None
    assert "over the first" not in checked.reason


def test_where_a_run_to_the_end_was_worse_than_extrapolated_nothing_is_extrapolated() -> None:
    finer, slow = replace(ROW, accuracy=1e-9, error=1e-15), replace(ROW, accuracy=1e-4, bare_time_per_s=1e9)
    _, whole = runs([finer, ROW, slow])
    assert whole.checked_by is finer
    assert whole.judge(slow).error == 64.0 * slow.error
    assert whole.judge(ROW).error > 64.0 * ROW.error
    assert whole.judge(slow).error == math.inf
    assert not whole.judge(slow).measured
