"""`trade`: its errors are the true ones, its times those of the whole scene, and it lists what it left out."""

from __future__ import annotations

import importlib
import itertools
import json
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import motions
import pytest

from rb_dynamics.cli import main
from rb_dynamics.cli.commands.trade import as_text
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS, fixed_step_kernel
from rb_dynamics.numerics import compilation
from rb_dynamics.report.html import write_html
from rb_dynamics.report.trade_page import trade_report
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.read import parse_scene, read_scene
from rb_dynamics.study.trade import Recommendation, Trade, TradeRow, reference, trade, work_precision

# The package: rb_dynamics.study.trade is the function in the namespace of its parent.
TRADE = importlib.import_module("rb_dynamics.study.trade")
ROOT = Path(__file__).parents[3]
SPINNING = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\n"
DRAG = SPINNING + "wrenches: []\neffects: [{type: linear_drag, rotation: 0.1}]\nduration: 2\n"
# So near the middle axis that rounding decides when it turns over: no two methods can agree.
UNTOLD = (
    "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [1.0e-15, 20, 0]}\n"
    "wrenches: []\nduration: 8\n"
)
# What else the machine does is not to change what is found.
CLOCK = time.process_time

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compile with: numba is not installed")


@pytest.fixture(scope="module", autouse=True)
def _plain() -> Iterator[None]:
    """Forbid kernels, whatever was loaded before, except in tests that ask for them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RB_DYNAMICS_COMPILE", "never")
        yield


@pytest.fixture
def by_processor_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command measure processor time."""
    monkeypatch.setattr(TRADE, "trade", partial(trade, clock=CLOCK))


def solver_of(line: str) -> Solver:
    """Return what a scene with `line` in it says."""
    return parse_scene(f"{SPINNING}{line}").solver


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
    # Of so short a run that is most of the cost.
    (remark,) = found.remarks
    assert re.fullmatch(r"the times leave out set-up: .* ms for a whole run of .* ms, and process start", remark)
    assert "exact" not in {one.method for one in found.rows}
    assert found.ended["exact"].startswith("refused: exact:")
    assert found.target == 1e-8
    has_true_errors(scene, found, case, case.commands)
    assert len(found.front) > 3
    for coarse, fine in itertools.pairwise(found.front):
        assert coarse.time_per_s < fine.time_per_s
        assert coarse.error > fine.error


@pytest.mark.parametrize(
    ("rate", "stall"), [pytest.param(0.001, 0.0, marks=pytest.mark.slow), (10.0, 0.0), (10.0, 0.1)]
)
def test_what_is_fastest_is_fastest_with_the_outputs_of_the_scene(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, rate: float, stall: float
) -> None:
    """On a simulated clock, dverk and rk4 take 10 and 20 ms per simulated second, and 10 and 2 ms per output.

    A run unlike the one before it may stand still at first: outputs were said to cost nothing.
    """
    last, spent, each = [("", 0.0)], [0.0], {"dverk": (1e-2, 1e-2), "rk4": (2e-2, 2e-3)}

    class Timed(Simulation):
        def advance(self, until_ns: int) -> None:
            before, kind = self._computed_ns, (self.scene.solver.method, self.scene.output_rate)
            spent[0] += stall * (last[0] != kind)
            last[0] = kind
            super().advance(until_ns)
            bare, output = each.get(self.scene.solver.method, (1e-3, 1e-3))
            spent[0] += 1e-9 * (self._computed_ns - before) * (bare + output * self.scene.output_rate)

    monkeypatch.setattr(importlib.import_module("rb_dynamics.study.trade.excerpt"), "Simulation", Timed)
    found = trade(
        parse_scene(f"{DRAG}output_rate: {rate}"), target=0.01, methods=[*each], time_s=4.0, clock=lambda: spent[0]
    )

    assert {one.method for one in found.rows} == set(each)
    for one in found.rows:
        bare, output = each[one.method]
        # Without outputs, there is one: the end.
        assert one.bare_time_per_s == pytest.approx(bare + output / found.trial_s)
        assert one.time_per_s == pytest.approx(max(bare + rate * output, one.bare_time_per_s))
        assert one.real_time_factor == 1.0 / one.time_per_s
    assert found.recommended is not None
    assert found.recommended.row.method == ("dverk" if rate < 1.0 else "rk4")
    text = as_text(found)
    taken = found.recommended.row
    factors = (
        f"{taken.real_time_factor:.3g} times real time with all outputs, {taken.bare_real_time_factor:.3g} without"
    )
    assert factors in text
    assert "end alone" in text
    write_html(tmp_path / "trade.html", trade_report(found))
    page = (tmp_path / "trade.html").read_text(encoding="utf-8")
    assert "end alone [s per s]" in page
    assert f"real time with all outputs, {taken.bare_real_time_factor:.3g} x without" in page


def test_only_the_methods_asked_for_are_measured_against_the_same_reference(
    free_scene: Scene, free_trade: Trade
) -> None:
    found = trade(free_scene, methods=["rk4", "dverk", "rk4"], time_s=1.0, clock=CLOCK)
    assert found.ended.keys() == {one.method for one in found.rows} == {"rk4", "dverk"}
    assert found.reference.method == free_trade.reference.method
    assert found.recommended is not None
    assert found.recommended.row.method in ("rk4", "dverk")
    assert "measured only rk4, dverk, as requested" in found.remarks
    assert "of 2 methods, from fast" in as_text(found)
    named = {one.method for one in free_trade.rows} - {"auto"}
    assert f"of {len(named)} methods and auto, from fast" in as_text(free_trade)


@pytest.mark.parametrize(
    ("methods", "says"),
    [
        (["rk5"], r"methods has 'rk5', expected names out of auto, exact, .*; did you mean rkmk54\?"),
        (["aba82"], "; aba82 was removed; take dmv104, or strang6 for a slender body"),
        (["?"], "write some of them"),
        ([3], "methods has 3"),
        ([], "methods is empty"),
        (["taylor"], "solver.method: found taylor, expected a method that supports linear_drag"),
    ],
)
def test_methods_that_there_are_not_or_that_cannot_take_the_scene_are_refused(methods: list[Any], says: str) -> None:
    with pytest.raises(SceneError, match=says):
        trade(parse_scene(DRAG), methods=methods)


def test_methods_are_names() -> None:
    with pytest.raises(TypeError, match="methods is 'rk4', expected"):
        trade(parse_scene(DRAG), methods="rk4")


@pytest.mark.slow
def test_how_many_settings_are_far_from_the_target_follows_from_the_order_seen(free_scene: Scene) -> None:
    """From any two rows of rk4, the remaining settings include the target and start a few settings before it."""
    # With all of the time for itself: among others it may get to one setting before its kernel is compiled.
    found = trade(free_scene, methods=["rk4"], time_s=4.0, clock=CLOCK)
    rows = [one for one in found.rows if 1e-8 < one.error < 1e-2]
    steps = [one.step for one in rows if one.step is not None]
    assert len(steps) > 6
    coming = [Solver("rk4", step=step, accuracy=None) for step in steps[2:]]
    far = work_precision.far_from(1e-7, rows[:2], coming)
    kept = [one for one in rows[2 + far :] if one.error > 1e-7]
    assert far > 0
    assert 1 <= len(kept) <= 5
    assert work_precision.far_from(rows[1].error, rows[:2], coming) == 0
    assert work_precision.far_from(1e-7, rows[:1], coming) == 0


def test_under_drag_only_the_methods_that_take_it_are_measured() -> None:
    scene = parse_scene(DRAG)
    # What is imported once is not this trade's to pay for.
    simulate(replace(scene, solver=Solver("dop853")))

    found = trade(scene, budget=1e-3, time_s=1.5, clock=CLOCK)

    able = {name for name, method in METHODS.items() if method.takes >= LoadDependence.ANY}
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


@pytest.mark.slow
def test_channels_without_commands_are_probed_and_a_long_scene_is_measured_in_part() -> None:
    seen: list[float] = []
    found = trade(
        parse_scene(SPINNING + "duration: 1.0e+6"), target=1e-3, time_s=3.0, progress=seen.append, clock=CLOCK
    )

    assert "probe" in found.remarks[0]
    assert f"the first {found.trial_s:.6g} s of 1e+06 s" in found.remarks[1]
    assert 0.0 < found.trial_s < 1e5
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def measured_in_part(monkeypatch: pytest.MonkeyPatch, seconds: float, flown: float = 2.0) -> tuple[Scene, Trade]:
    """Return a scene of which the trial is the first `seconds`, and its trade with `flown` times its time on top."""
    make = TRADE.trial_of
    monkeypatch.setattr(TRADE, "trial_of", lambda *given: make(*given).part(seconds).look())
    monkeypatch.setattr(TRADE, "_WHOLE", flown)
    # Outputs cost every method about the same.
    scene = parse_scene(DRAG.replace("duration: 2", "duration: 60").replace("0.1}", "1.0e-3}") + "output_rate: 0.01\n")
    return scene, trade(scene, target=1e-6, time_s=3.0, clock=CLOCK)


def test_what_is_recommended_keeps_the_target_over_the_whole_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """The excerpt is a twentieth of the scene; many settings that meet the target over it miss it at the end."""
    scene, found = measured_in_part(monkeypatch, 3.0)
    taken = found.recommended
    assert taken is not None
    assert found.trial_s == 3.0
    assert found.whole == 60.0
    assert found.checked_by is not None
    assert taken.whole.measured
    end = simulate(replace(scene, solver=Solver(accuracy=1e-11))).sample.orientation_xyzw

    def missed(row: TradeRow) -> float:
        return motions.attitude_error(simulate(replace(scene, solver=row.as_solver)).sample.orientation_xyzw, end)

    # Both are known to the accuracy of what they are compared with.
    assert missed(taken.row) - 1e-11 <= taken.whole.error <= 1e-6
    coarsest = max((one for one in found.rows if one.error <= 1e-6), key=lambda one: one.error)
    assert missed(coarsest) > 1e-6
    assert "after all 60 s" in as_text(found)


@pytest.mark.slow
def test_where_the_whole_is_too_long_the_error_is_taken_to_grow_and_the_text_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, found = measured_in_part(monkeypatch, 3.0, flown=1e-9)
    taken = found.recommended
    assert taken is not None
    assert not taken.whole.measured
    assert taken.whole.error == taken.row.error * 20.0**2 <= 1e-6
    (line,) = (line for line in as_text(found).splitlines() if "after 3 s of 60 s" in line)
    assert "error" in line

    none = replace(found, recommended=None, target=taken.row.error)
    assert "grows with the square of time" in none.shortfall
    assert found.enough_s is not None
    assert found.enough_s > 2.0
    assert f"about --time {found.enough_s:g}" in none.shortfall
    assert f"about --time {found.enough_s:g} would do" in as_text(found)


def test_commands_that_cannot_be_honoured_are_left_out_and_counted() -> None:
    commands = [("wrench", Wrench(torque=(0.1, 0.0, 0.0))), ("wrench", Wrench((1.0, 0.0, 0.0), frame_id="nowhere"))]
    found = trade(parse_scene(SPINNING + "duration: 1"), commands, time_s=1.0, clock=CLOCK)
    assert "1 of 2 commands were rejected" in found.remarks


@needs_numba
@pytest.mark.parametrize("room", [math.inf, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_long_scene_is_measured_as_it_would_run_and_no_time_holds_what_compiling_takes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, room: float
) -> None:
    """Each compilation takes an hour of a simulated clock: no row includes it, and their number is bounded."""
    monkeypatch.setattr(TRADE, "_KERNELS", room)
    hours, compile_kernel = [], fixed_step_kernel.compile_kernel

    def slowly(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
        hours.append(3600.0)
        return compile_kernel(function, signature)

    monkeypatch.setattr(fixed_step_kernel, "compile_kernel", slowly)
    # What other tests have loaded is not to be found, and two methods are enough.
    fixed_step_kernel.kernel.cache_clear()
    monkeypatch.setattr(
        TRADE,
        "refinements_for",
        lambda trial: [one for one in work_precision.refinements_for(trial) if one.method in ("euler", "rk4")],
    )
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compilation.cache_folder.cache_clear()
    scene, commands = parse_scene(SPINNING + "duration: 1.0e+5"), [("wrench", Wrench(torque=(0.01, 0.02, 0.0)))]
    told: list[str] = []
    try:
        found = trade(scene, commands, time_s=1.0, clock=lambda: CLOCK() + sum(hours), compiling=told.append)
    finally:
        compilation.cache_folder.cache_clear()
    assert found.trial_s < 1e4
    assert len(found.kernels) == len(hours)
    assert told == list(found.kernels)
    assert all(one.time_per_s < 1.0 for one in found.rows)
    if room == 1.0:
        assert len(hours) == 1
        return
    for name in ("euler", "rk4"):
        rows = [one for one in found.rows if one.method == name]
        assert rows
        assert all(one.compiled for one in rows)
        assert found.kernels[f"_run_on_numbers_{name}"] >= 3600.0


@needs_numba
def test_a_short_scene_is_not_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    # What another process compiled for other tests would be loaded.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compilation.cache_folder.cache_clear()
    commands = [("wrench", Wrench(torque=(0.1, 0.2, 0.0)))]
    try:
        found = trade(parse_scene(SPINNING + "duration: 0.5"), commands, time_s=0.5, clock=CLOCK)
    finally:
        compilation.cache_folder.cache_clear()
    assert found.rows
    assert not any(one.compiled for one in found.rows)
    assert found.kernels == {}


@pytest.mark.slow
def test_where_no_two_methods_run_the_trial_in_time_a_shorter_one_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first attempt runs out of time at once."""
    find, tried = reference.find_reference, []

    def find_late(trial: Any, deadlines: list[float], after: Callable[[], None]) -> Any:
        tried.append(trial.seconds)
        return find(trial, [trial.clock() - 1.0, *deadlines], after)

    monkeypatch.setattr(TRADE, "find_reference", find_late)
    found = trade(parse_scene(DRAG), time_s=2.0, clock=CLOCK)
    assert found.trial_s == pytest.approx(tried[0] / 8.0, rel=0.01)
    assert found.rows
    assert any("measured over the first" in remark for remark in found.remarks)


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


@pytest.mark.usefixtures("by_processor_time")
def test_command_prints_json_with_floats_in_full(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, page = tmp_path / "scene.yaml", tmp_path / "trade.html"
    scene.write_text(SPINNING + "wrenches: []\nduration: 2\n")

    assert main(["trade", str(scene), "--time", "0.8", "--target", "1e-6", "--html", str(page), "--json"]) == 0

    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == f"wrote {page}\n"
    assert found.keys() >= {"rows", "recommended", "reference"}
    assert all(one.keys() == {field.name for field in fields(TradeRow)} for one in found["rows"])
    assert found["recommended"].keys() == {field.name for field in fields(Recommendation)}
    assert found["recommended"]["row"]["error"] <= 1e-6
    pasted = read_scene(str(scene), {"solver.method": found["recommended"]["row"]["method"]}).solver
    assert solver_of(found["recommended"]["solver"]).method == pasted.method
    assert "<svg" in page.read_text(encoding="utf-8")


@pytest.mark.usefixtures("by_processor_time")
def test_command_ends_with_1_where_nothing_is_good_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SPINNING + "wrenches: []\nduration: 2\n")
    for wish, says in ((["--target", "1e-18"], "--target"), (["--budget", "1e12"], "--budget")):
        assert main(["trade", str(scene), "--time", "2", *wish]) == 1
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


def test_text_says_in_a_line_what_was_left_out(free_trade: Trade) -> None:
    why = "refused: one: a torque acts, expected free motion; use method auto, which takes any"
    found = replace(free_trade, ended={"one": why, "two": "its time was up", "three": "its time was up"})
    lines = [line for line in as_text(found).splitlines() if line.startswith("left out")]
    assert lines == ["left out    one: a torque acts", "left out    two, three: its time was up"]


WHEEL = """
body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 0.2, 0.3]}
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, speed: 10}]
duration: 1
"""


@pytest.mark.slow
def test_the_two_methods_that_take_wheels_check_each_other() -> None:
    """It was said that only dop853 takes them."""
    found = trade(parse_scene(WHEEL), time_s=3.0, clock=CLOCK)
    assert {each.split(",")[0] for each in (found.reference.method, found.reference.check)} == {"dop853", "dverk"}
    assert {one.method for one in found.rows} >= {"dop853", "dverk"}


def test_a_scene_that_one_method_takes_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing can check it, however much time is given."""
    module = importlib.import_module("rb_dynamics.study.trade.reference")
    monkeypatch.setattr(module, "_FAMILIES", ("taylor", "dop853"))
    with pytest.raises(ConvergenceError, match="only dop853 takes reaction_wheel; leave these out"):
        trade(parse_scene(WHEEL), time_s=1.0)


def test_errors_of_a_body_that_does_not_move_are_said_to_tell_nothing() -> None:
    """Any method with any step was recommended, as exact."""
    told = "the body does not move, so every setting is exact"
    for text, rests in ((SPINNING[: SPINNING.index("initial")], True), (SPINNING, False)):
        found = trade(parse_scene(text + "wrenches: []\nduration: 2\n"), time_s=1.0, methods=["rk4"], clock=CLOCK)
        assert any(remark.startswith(told) for remark in found.remarks) is rests
