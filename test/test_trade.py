"""`trade`: its errors are the true ones, its front is one, its advice does what was asked, and time is shared."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import motions
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.cli import main
from rb_dynamics.cli.trade import as_text
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.load import Takes
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.taylor import _expand
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.read import parse_scene, read_scene
from rb_dynamics.simulate import simulate
from rb_dynamics.trade import (
    TIME_IS_UP,
    Climber,
    Recommendation,
    Row,
    Trade,
    _trial,
    climb,
    recommend,
    trade,
    with_front,
)

ROOT = Path(__file__).parents[1]
SPINNING = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
DRAG = SPINNING + "wrenches: []\neffects: [{type: linear_drag, rotation: 0.1}]\nduration: 2\n"
# So near the middle axis that rounding decides when it turns over: no two methods can agree.
UNTOLD = (
    "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [1.0e-15, 20, 0]}\n"
    "wrenches: []\nduration: 8\n"
)
# What else the machine does is not to change what is found.
CLOCK = time.process_time

ROW = Row("rk4", 0.1, None, 1e-5, 2e-5, 3e-5, 1e-5, False, 0.0, 0.0, 0.0, 1e-3, 1e3, 10)


def row(seconds: float, error: float, method: str = "rk4") -> Row:
    return replace(ROW, method=method, time_per_s=seconds, real_time_factor=1.0 / seconds, error=error)


ROWS = st.lists(
    st.builds(row, st.sampled_from([1e-6, 1e-5, 3e-5, 1e-4, 1.0]), st.sampled_from([0.0, 1e-12, 1e-9, 1e-3, 3.0])),
    max_size=30,
)


def solver_of(line: str) -> Solver:
    """Return what a scene with `line` in it says."""
    return parse_scene(f"{SPINNING}{line}").solver


class Machine:
    """A clock, and runs on it that take as long as they should."""

    def __init__(self, cost: Callable[[Solver], float]) -> None:
        self.now = 0.0
        self.log: list[tuple[str, float, float]] = []
        self._cost = cost

    def clock(self) -> float:
        return self.now

    def measure(self, solver: Solver, limit: float) -> tuple[float, str]:
        cost = self._cost(solver)
        self.log.append((solver.method, cost, limit))
        self.now += min(cost, limit)
        return (cost, "") if cost <= limit else (math.inf, TIME_IS_UP)


def climber(method: str, rungs: int = 40, growth: float = 2.0) -> Climber:
    return Climber(method, [Solver(method, step=0.5**k, accuracy=None) for k in range(rungs)], growth)


def test_methods_get_the_same_time() -> None:
    prices = {"cheap": 1e-5, "dear": 1e-3}
    machine = Machine(lambda solver: prices[solver.method] / (solver.step or 1.0))
    climbers = [climber("cheap"), climber("dear")]

    climb(climbers, machine.measure, 10.0, machine.clock)

    # Runs double, so that each may be short of its half by what the next run would have taken.
    assert machine.now <= 10.0
    for one in climbers:
        assert 1.2 < one.spent < 8.0
        assert one.ended == TIME_IS_UP
    assert climbers[0].runs - climbers[1].runs in (6, 7)


def test_what_one_leaves_the_others_get() -> None:
    machine = Machine(lambda solver: 1e-3 / (solver.step or 1.0))
    climbers = [climber("short", rungs=2), climber("long")]

    climb(climbers, machine.measure, 10.0, machine.clock)

    assert climbers[0].ended == "its finest setting"
    assert climbers[1].spent > 4.0


@given(
    st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=6),
    st.floats(0.1, 10.0),
    st.floats(1.0, 1.9),
)
def test_no_run_is_started_that_would_not_end_in_time(prices: list[float], end: float, true_growth: float) -> None:
    """Where runs grow by no more than expected, only a first run, of which nothing is known, is ever cut off."""
    names = [f"m{k}" for k in range(len(prices))]
    machine = Machine(lambda solver: prices[names.index(solver.method)] * true_growth ** -math.log2(solver.step or 1.0))
    climbers = [climber(name) for name in names]

    climb(climbers, machine.measure, end, machine.clock)

    assert machine.now <= end * (1.0 + 1e-12)
    assert all(one.ended for one in climbers)
    seen = set()
    for method, cost, limit in machine.log:
        assert method not in seen or cost <= limit
        seen.add(method)
    assert seen == set(names) or machine.now > 0.0


def test_refused_at_first_a_method_goes_on_to_finer_settings_and_no_further_than_it_can() -> None:
    def measure(solver: Solver, limit: float) -> tuple[float, str]:
        if not 1e-3 < (solver.step or 0.0) < 0.2:
            raise ConvergenceError("too long or too short")
        return 1e-9, ""

    able, unable = climber("able"), climber("unable", rungs=3)
    climb([able, unable], measure, 1.0, itertools.count(0.0, 1e-6).__next__)

    assert able.runs == 7
    assert able.ended == unable.ended == "refused: too long or too short"
    assert unable.runs == 0


@given(ROWS)
def test_the_front_is_what_nothing_beats(rows: list[Row]) -> None:
    marked = with_front(rows)

    assert [replace(one, front=False) for one in marked] == rows
    for one in marked:
        beaten = any(
            other.time_per_s <= one.time_per_s
            and other.error <= one.error
            and (other.time_per_s, other.error) != (one.time_per_s, one.error)
            for other in rows
        )
        assert one.front is not beaten


@given(ROWS, st.sampled_from([1e-13, 1e-9, 1e-6, 10.0]))
def test_the_recommended_row_keeps_the_target_and_none_that_does_is_faster(rows: list[Row], target: float) -> None:
    found = recommend(rows, target, None)
    able = [one for one in rows if one.error <= target]
    assert (found is None) is (not able)
    if found is not None:
        assert found.row in able
        assert found.row.time_per_s == min(one.time_per_s for one in able)


@given(ROWS, st.sampled_from([1e-3, 1.0, 5e4, 1e7]))
def test_the_recommended_row_keeps_the_budget_and_none_that_does_is_more_accurate(
    rows: list[Row], budget: float
) -> None:
    found = recommend(rows, None, budget)
    able = [one for one in rows if one.real_time_factor >= budget]
    assert (found is None) is (not able)
    if found is not None:
        assert found.row in able
        assert found.row.error == min(one.error for one in able)


@pytest.mark.parametrize(
    ("method", "step", "accuracy", "line"),
    [
        ("rk4", 0.01, None, "solver: {method: rk4, step: 0.01}"),
        ("rk4", 1e-7, None, "solver: {method: rk4, step: 1.0e-7}"),
        ("dop853", None, 2.5e-9, "solver: {method: dop853, accuracy: 2.5e-9}"),
        ("exact", None, None, "solver: {method: exact}"),
    ],
)
def test_the_line_to_paste_says_what_was_measured(
    method: str, step: float | None, accuracy: float | None, line: str
) -> None:
    assert replace(ROW, method=method, step=step, accuracy=accuracy).solver == line
    solver = solver_of(line)
    assert (solver.method, solver.step) == (method, step)
    assert accuracy is None or solver.accuracy == accuracy


def has_true_errors(scene: Scene, found: Trade, case: motions.Case, commands: list[tuple[str, Wrench]]) -> None:
    """Run rows again, each from its line, and compare their errors with those against the digits of `case`."""
    truth, trust = case.states[found.trial_s], found.reference
    rows = [one for one in found.rows if one.steps < 100]
    assert len(rows) > 10
    for one in rows:
        end = simulate(replace(scene, solver=solver_of(one.solver)), commands).sample
        attitude = motions.attitude_error(end.orientation_xyzw, truth["orientation_xyzw"])
        rate = motions.vector_error(end.angular_velocity_body, truth["angular_velocity_body"])
        position = motions.vector_error(end.position_world, truth["position_world"])
        assert abs(one.attitude_error - attitude) <= trust.attitude
        assert abs(one.rate_error - rate) <= trust.rate
        assert abs(one.position_error - position) <= trust.position
        # The trust of the position holds what its doubles cannot resolve.
        assert one.error >= max(attitude - trust.attitude, (position - 2.0 * trust.position) / trust.path)
        assert one.within_trust == (one.attitude_error <= trust.attitude and one.position_error <= trust.position)


@pytest.fixture(scope="module")
def free_scene() -> Scene:
    case = motions.free("boxes_rotation")
    return motions.scene(case.body, case.initial, Solver(), 2.5, output_rate=0.1, channels=())


@pytest.fixture(scope="module")
def free_trade(free_scene: Scene) -> Trade:
    return trade(free_scene, time_s=2.0, clock=CLOCK)


def test_free_motion_has_its_closed_form_and_the_true_errors(free_scene: Scene, free_trade: Trade) -> None:
    assert free_trade.trial_s == 2.5
    assert free_trade.reference.method == "exact, closed form"
    assert free_trade.reference.error < 1e-11
    closed = [one for one in free_trade.rows if one.method in ("exact", "auto")]
    assert [(one.step, one.accuracy, one.steps) for one in closed] == 2 * [(None, None, 1)]
    assert {one.method for one in free_trade.rows} >= {"exact", "auto", "taylor", "rk4", "strang2"}
    has_true_errors(free_scene, free_trade, motions.free("boxes_rotation"), [])
    assert free_trade.target == 1e-9
    assert free_trade.recommended is not None
    assert free_trade.recommended.row.error <= 1e-9


def test_a_driven_scene_has_the_true_errors_and_no_closed_form() -> None:
    case = motions.forced()
    scene = case.scene(Solver(accuracy=1e-8), 1, output_rate=0.1)

    found = trade(scene, case.commands, time_s=2.0, clock=CLOCK)

    assert found.trial_s == 1
    assert not found.remarks
    assert "exact" not in {one.method for one in found.rows}
    assert found.ended["exact"].startswith("refused: exact:")
    assert found.target == 1e-8
    has_true_errors(scene, found, case, case.commands)
    assert len(found.front) > 3
    for coarse, fine in itertools.pairwise(found.front):
        assert coarse.time_per_s < fine.time_per_s
        assert coarse.error > fine.error


def test_under_drag_only_the_methods_that_take_it_are_measured() -> None:
    scene = parse_scene(DRAG)
    # What is imported once is not this trade's to pay for.
    simulate(replace(scene, solver=Solver("dop853")))

    found = trade(scene, budget=1e-3, time_s=1.5, clock=CLOCK)

    able = {name for name, method in METHODS.items() if method.takes >= Takes.ANY}
    assert {one.method for one in found.rows} <= {*able, "auto"}
    assert found.ended.keys() == {*able, "auto"}
    assert found.target is None
    assert found.recommended is not None
    assert found.recommended.row.error == min(one.error for one in found.rows)


def test_each_method_goes_from_coarse_to_fine(free_trade: Trade) -> None:
    groups = [list(group) for _, group in itertools.groupby(free_trade.rows, key=lambda one: one.method)]
    assert len(groups) == len({one.method for one in free_trade.rows})
    for group in groups:
        settings = [one.step or one.accuracy or 0.0 for one in group]
        assert settings == sorted(settings, reverse=True)


def test_channels_without_commands_are_probed_and_a_long_scene_is_measured_in_part() -> None:
    seen: list[float] = []
    found = trade(
        parse_scene(SPINNING + "duration: 1.0e+6"), target=1e-3, time_s=1.0, progress=seen.append, clock=CLOCK
    )

    assert "probe" in found.remarks[0]
    assert f"the first {found.trial_s:.6g} s of 1e+06 s" in found.remarks[1]
    assert 0.0 < found.trial_s < 1e5
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_commands_that_cannot_be_honoured_are_left_out_and_counted() -> None:
    commands = [("wrench", Wrench(torque=(0.1, 0.0, 0.0))), ("wrench", Wrench((1.0, 0.0, 0.0), frame_id="nowhere"))]
    found = trade(parse_scene(SPINNING + "duration: 1"), commands, time_s=1.0, clock=CLOCK)
    assert "1 of 2 wrench commands were rejected" in found.remarks


def test_a_run_finds_nothing_that_another_one_has_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same motion in one step of one expansion: cheap to look up, and what is timed is to compute it."""
    # A kernel looks nothing up.
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    scene = parse_scene(SPINNING + "duration: 0.01")
    trial = _trial(scene, [("wrench", Wrench(torque=(0.1, 0.2, 0.0)))], 1.0, CLOCK)
    looked_up = []
    for _ in range(2):
        assert trial.fly(Solver("taylor", accuracy=1e-6), parts=1) is not None
        looked_up.append(_expand.cache_info())
    assert looked_up[0] == looked_up[1]
    assert looked_up[0].misses > 0


def test_where_rounding_decides_nothing_is_recommended() -> None:
    found = trade(parse_scene(UNTOLD), clock=CLOCK)
    assert not found.reference.is_useful
    assert found.rows == ()
    assert found.recommended is None
    assert "nothing tells which is right" in found.shortfall


def test_a_scene_of_no_length_is_refused() -> None:
    with pytest.raises(SceneError, match="duration: found 0"):
        trade(parse_scene(SPINNING + "duration: 0"))


def test_no_time_is_a_clear_error() -> None:
    with pytest.raises(ConvergenceError, match="give more time"):
        trade(parse_scene(DRAG), time_s=1e-6)


def test_command_prints_json_with_floats_in_full(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, page = tmp_path / "scene.yaml", tmp_path / "trade.html"
    scene.write_text(SPINNING + "wrenches: []\nduration: 2\n")

    assert main(["trade", str(scene), "--time", "0.8", "--target", "1e-6", "--html", str(page), "--json"]) == 0

    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found.keys() >= {"rows", "recommended", "reference"}
    assert all(one.keys() == {field.name for field in fields(Row)} for one in found["rows"])
    assert found["recommended"].keys() == {field.name for field in fields(Recommendation)}
    assert found["recommended"]["row"]["error"] <= 1e-6
    pasted = read_scene(str(scene), {"solver.method": found["recommended"]["row"]["method"]}).solver
    assert solver_of(found["recommended"]["solver"]).method == pasted.method
    assert "<svg" in page.read_text(encoding="utf-8")


def test_command_ends_with_1_where_nothing_is_good_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SPINNING + "wrenches: []\nduration: 2\n")
    for wish, says in ((["--target", "1e-18"], "--target"), (["--budget", "1e12"], "--budget")):
        assert main(["trade", str(scene), "--time", "0.6", *wish]) == 1
        out, err = capsys.readouterr()
        assert "trust " in out
        assert "take " not in out
        assert f"ask for less ({says})" in err


@pytest.mark.parametrize(
    "arguments", [["--target", "0"], ["--budget", "nan"], ["--time", "-1"], ["--target", "1", "--budget", "1"]]
)
def test_bad_wishes_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["trade", str(ROOT / "config" / "dzhanibekov.yaml"), *arguments])
    assert end.value.code == 2
    assert arguments[0] in capsys.readouterr().err


def test_text_shows_the_front_and_the_line_to_paste(free_trade: Trade) -> None:
    steps = [replace(one, front=one.step is not None) for one in free_trade.rows]
    found = replace(free_trade, rows=tuple(steps))
    lines = as_text(found).splitlines()
    assert f"front       of {len(steps)} runs of" in "\n".join(lines)
    assert found.recommended is not None
    assert f"take        {found.recommended.solver}" in lines
    assert sum(" step " in line for line in lines) == len(found.front) > 10
    assert max(map(len, lines)) <= 120
