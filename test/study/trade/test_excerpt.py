"""The excerpt and its reference: no caches between runs, and no accuracy below round-off."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import fixed_step_kernel
from rb_dynamics.motion.taylor import _expand
from rb_dynamics.numerics import compilation
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Solver
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.study.stopwatch import Stopwatch
from rb_dynamics.study.trade.excerpt import Excerpt, accepted, trial_of
from rb_dynamics.study.trade.reference import find_reference

CLOCK = time.process_time
TORQUE = [("wrench", Wrench(torque=(0.1, 0.2, 0.0)))]

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compile with: numba is not installed")


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")


def trial(spin: str, duration: str, limit: float, clock: Callable[[], float] = CLOCK) -> Excerpt:
    body = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}"
    text = f"{body}\ninitial: {{angular_velocity_body: {spin}}}\nduration: {duration}"
    return trial_of(parse_scene(text), TORQUE, limit, Stopwatch(clock))


def test_a_run_finds_nothing_that_another_one_has_computed() -> None:
    """The motion has one cached expansion, which must be computed again to be timed."""
    one = trial("[0.1, 2, 0.1]", "0.01", 1.0)
    looked_up = []
    for _ in range(2):
        assert one.run(Solver("taylor", accuracy=1e-6), one.as_the_whole(), parts=1) is not None
        looked_up.append(_expand.cache_info())
    assert looked_up[0] == looked_up[1]
    assert looked_up[0].misses > 0


def test_a_very_short_part_that_costs_more_than_a_longer_one_is_no_limit() -> None:
    """Of two wheels whose motors let go, 1 µs takes 40 times as long as 10 ms: "no two methods could run the scene"."""
    scene = parse_scene("""
body: {mass: 30, inertia: {diagonal: [1.6, 2.0, 2.1]}}
initial: {angular_velocity_body: [0.07, -0.36, -0.42]}
actuators:
  - {type: reaction_wheel, name: a, axis: [-1.4, -1, -0.8], inertia: 0.09, command: speed, speed: 12.6,
     max_torque: 0.0455, friction: {coulomb: 0.015, viscous: 0.0166}}
  - {type: reaction_wheel, name: b, axis: [1.05, 0.1, 1.02], inertia: 0.02, command: speed, speed: -2.8,
     max_torque: 0.0467, max_speed: 8.4}
duration: 4
""")
    whole = Excerpt(scene, [], 4.0, 4.0, Stopwatch(CLOCK), Solver("dop853", accuracy=1e-9), 4.0)
    short, longer = (
        min(run.time for run in [part.run(part.pilot, part.clock.tally(none=True)) for _ in range(3)] if run)
        for part in (whole.part(1e-6), whole.part(1e-2))
    )
    found = trial_of(scene, [], min(0.5 * short, 20.0 * longer), Stopwatch(CLOCK))
    assert found.seconds > 1e-2


def test_an_accuracy_that_rounding_does_not_leave_is_loosened_until_it_can_be_kept() -> None:
    """At 200 rad/s the finest accuracies are refused; the finest achievable one is the reference."""
    one = trial("[10, 200, 10]", "200", 0.05)
    same, reference, _ = find_reference(one, [CLOCK() + 60.0], lambda: None)
    method, accuracy = reference.method.split(", accuracy ")
    assert same == one
    assert 1e-14 < float(accuracy) < 1e-9
    assert reference.is_useful
    with pytest.raises(ConvergenceError, match="rounding alone"):
        one.run(Solver(method, accuracy=0.1 * float(accuracy)), one.as_the_whole())


def test_commands_act_in_the_order_in_which_simulate_takes_them() -> None:
    """Both are stamped before the start, where the later stamp wins."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 1\nsolver: {method: rk4, step: 0.1}"
    )
    commands = [("wrench", Wrench(torque=(0.1 * k, 0.2, 0.0), stamp_ns=-k)) for k in (1, 3, 2)]
    one = trial_of(scene, accepted(scene, commands), 1.0, Stopwatch(CLOCK))
    run = one.run(scene.solver, one.as_the_whole())
    assert run is not None
    assert run.sample == simulate(scene, commands).sample


@needs_numba
class TestCompiled:
    """An hour passes whenever a kernel is compiled or loaded."""

    @pytest.fixture
    def hours(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[float]:
        passed: list[float] = []
        compile_kernel = fixed_step_kernel.compile_kernel

        def slowly(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
            passed.append(3600.0)
            return compile_kernel(function, signature)

        monkeypatch.setattr(fixed_step_kernel, "compile_kernel", slowly)
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
        # What other tests have loaded is not to be found.
        fixed_step_kernel.kernel.cache_clear()
        return passed

    def test_a_run_is_compiled_as_the_whole_would_be_and_its_time_does_not_hold_that(self, hours: list[float]) -> None:
        rk4 = Solver("rk4", step=0.05, accuracy=None)
        ends = {}
        for duration in ("10", "5000"):
            hours.clear()
            one = trial("[0.1, 2, 0.1]", duration, 0.02, clock=lambda: CLOCK() + sum(hours)).part(10.0)
            for _ in range(2):
                run = one.run(rk4, one.as_the_whole())
                assert run is not None
                # 200 steps, or 100 000.
                assert run.compiled is (duration == "5000")
                assert run.time < 3600.0
                ends[duration] = run.sample
            assert [*one.clock.kernels] == (["_run_on_numbers_rk4"] if duration == "5000" else [])
            assert all(3600.0 <= took < 7200.0 for took in one.clock.kernels.values())
        assert ends["10"] == ends["5000"]

    def test_what_is_loaded_is_not_used_where_the_whole_would_not(self, hours: list[float]) -> None:
        rk4 = Solver("rk4", step=0.01, accuracy=None)
        one = trial("[0.1, 2, 0.1]", "1", 1.0)
        used = []
        for tally in (one.clock.tally(1e3), one.clock.tally(), one.clock.tally(1e3, none=True)):
            run = one.run(rk4, tally)
            assert run is not None
            used.append(run.compiled)
        assert used == [True, False, False]
        assert len(hours) == 1
