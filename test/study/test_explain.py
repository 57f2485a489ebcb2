"""`explain`: its statements about a scene hold for the run."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import mpmath
import pytest

from rb_dynamics.cli import main
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.wrench_bags import read_wrenches
from rb_dynamics.motion import fixed_step_kernel
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.read import parse_scene, read_scene
from rb_dynamics.sensors.sensor_types import SENSORS
from rb_dynamics.study.explain import NOT_MODELLED, explain, probed
from rb_dynamics.study.stopwatch import Stopwatch

ROOT = Path(__file__).parents[2]
# The other scenes are much like these.
OFTEN = ("boxes", "central_gravity", "particle", "rotor", "slew", "wheels")
CLOCK = time.process_time
RIGID = "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\ninitial: {angular_velocity_body: [0.3, 1, 0.2]}\n"


needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compile with: numba is not installed")


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")


def said(text: str) -> str:
    return explain(parse_scene(text)).as_text()


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem not in OFTEN))
        for path in sorted((ROOT / "config").glob("*.yaml"))
    ],
)
def test_every_shipped_scene_can_be_explained(path: Path) -> None:
    scene = read_scene(path)
    found = explain(scene, budget=0.3)
    of_scene = {"effects": scene.effects, "actuators": scene.actuators, "sensors": scene.sensors}
    for key, kinds in (("effects", EFFECTS.own), ("actuators", ACTUATORS), ("sensors", SENSORS)):
        listed = {each.kind for each in of_scene[key]}
        absent = [item for item in found.left_out if item.endswith(f": not listed in {key}")]
        told = {kind for item in absent for kind in item.partition(":")[0].split(", ")}
        assert told == {kind for kind in kinds if kind not in listed}
    for kind in EFFECTS.own:
        assert any(f"effect {kind}:" in item for item in found.modelled) == (kind in {e.kind for e in scene.effects})
    assert found.trial_s > 0.0
    # The budget may be too short for another method: then nothing is said.
    if found.attitude_error is None:
        assert "attitude error      not known" in found.as_text()
    else:
        assert found.attitude_error >= 0.0


def test_a_budget_for_less_than_a_few_steps_tells_no_cost() -> None:
    found = explain(read_scene(ROOT / "config" / "linear_drag.yaml"), budget=1e-9)
    assert found.as_dict()["bare_cost_per_s"] is None
    assert "computing           not known" in found.as_text()


def test_a_free_body_is_in_closed_form() -> None:
    text = said(RIGID + "wrenches: []\nduration: 10")
    assert "auto: exact, as nothing turns the body" in text
    assert "moved by            exact" in text
    assert "Jacobi's elliptic functions" in text
    assert "bounds of the closed form" in text


@pytest.mark.parametrize(
    ("moments", "words"), [("[1, 1, 1]", "uniform rotation"), ("[1, 1, 2]", "trigonometric functions")]
)
def test_the_class_of_the_body_says_how_it_turns(moments: str, words: str) -> None:
    assert words in said(f"body: {{mass: 1, inertia: {{diagonal: {moments}}}}}\nduration: 1\nwrenches: []")


def test_a_particle_has_three_degrees_of_freedom() -> None:
    found = explain(parse_scene("body: {mass: 1}\nduration: 1\nwrenches: []"))
    assert found.modelled == ("body: a particle, three degrees of freedom",)
    assert "attitude and rotation: the body has no inertia" in found.left_out


def test_the_error_it_names_is_the_error_there_is() -> None:
    """rk4 at a coarse step: against a run that is a million times better."""
    scene = read_scene(ROOT / "config" / "dzhanibekov.yaml", {"solver.method": "rk4", "solver.step": 0.02})
    exact = simulate(read_scene(ROOT / "config" / "dzhanibekov.yaml")).sample
    true = angle_between(simulate(scene).sample.orientation_xyzw, exact.orientation_xyzw)

    found = explain(scene, budget=60.0)

    assert found.trial_s == 100.0
    assert found.steps_per_s == pytest.approx(50.0)
    assert found.attitude_error == pytest.approx(true, rel=0.05)


@pytest.mark.parametrize("solver", [Solver("midpoint", step=5.0), Solver("rk4", accuracy=0.01)])
def test_the_error_is_that_though_commands_leave_no_finer_steps(solver: Solver) -> None:
    """With commands every 20 ms, steps of 0.05 s and 5 s would give the same run."""
    scene = replace(read_scene(ROOT / "config" / "slew.yaml", {"duration": 12.0}), solver=solver)
    commands = read_wrenches(str(ROOT / "examples" / "slew.mcap"), [channel.topic for channel in scene.channels])
    truth = simulate(replace(scene, solver=Solver("dop853", accuracy=1e-13)), commands).sample
    true = angle_between(simulate(scene, commands).sample.orientation_xyzw, truth.orientation_xyzw)

    found = explain(scene, commands, budget=60.0)

    assert true > 1e-14
    assert found.attitude_error == pytest.approx(true, rel=0.1)
    assert "difference from a run by taylor" in found.error_basis


def test_the_error_of_a_part_is_that_at_the_time_it_names() -> None:
    """Without commands and outputs before the end, both compared states used to be the start."""
    scene = parse_scene(
        "body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nwrenches: []\nduration: 1.0e+6\n"
        "initial: {angular_velocity_body: [0, 0, 1]}\nsolver: {method: rk4, step: 0.3}\n"
        "effects: [{type: linear_drag, rotation: 1.0e-6}]\n"
    )
    found = explain(scene, budget=0.1)
    turn = 1e6 * -math.expm1(-1e-6 * found.error_s)
    end = simulate(replace(scene, duration=found.error_s)).sample

    assert 0.0 < found.error_s < 1e6
    true = angle_between(end.orientation_xyzw, (0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn)))
    assert found.attitude_error == pytest.approx(true, rel=0.1)


BRAKED = (
    "body: {{mass: 2, inertia: {{diagonal: [1, 2, 2.5]}}}}\ninitial: {{angular_velocity_body: [0, 0, 1000]}}\n"
    "wrenches: []\neffects: [{{type: scheduled_wrench, schedule: [{{time: 100000, torque: [0, 0, -250]}}, "
    "{{time: 100010}}]}}]\nduration: 1.0001e+5\nsolver: {{method: auto, accuracy: {accuracy}}}\n"
)


def test_the_bound_of_the_closed_form_holds_what_came_before_the_end() -> None:
    scene = parse_scene(BRAKED.format(accuracy=1e-6))
    # 1e8 rad, and 5000 rad while it is braked.
    half = float(mpmath.fmod(mpmath.mpf(100_005_000) / 2, 2 * mpmath.pi))
    true = angle_between(simulate(scene).sample.orientation_xyzw, (0.0, 0.0, math.sin(half), math.cos(half)))

    found = explain(scene)

    assert 1e-12 < true <= found.attitude_error <= 1e-5


def test_where_no_other_method_comes_to_an_end_the_error_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module("rb_dynamics.study.explain"), "_FAMILIES", ())
    found = explain(parse_scene(RIGID + "duration: 1\nsolver: {method: rk4, step: 0.1}\n"))
    assert (found.attitude_error, found.position_error) == (None, None)
    assert "attitude error      not known" in found.as_text()


def test_a_run_with_wheels_has_an_error_too() -> None:
    """It was said that no other method could run it."""
    wheel = "actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.01, speed: 10}]"
    found = explain(parse_scene(RIGID + f"duration: 1\n{wheel}\n"))
    assert found.attitude_error is not None
    assert "dverk" in found.as_text()


def test_channels_are_tried_with_the_commands_of_a_bag_or_a_probe() -> None:
    scene = read_scene(ROOT / "config" / "slew.yaml", {"duration": 5.0})
    commands = read_wrenches(str(ROOT / "examples" / "slew.mcap"), [channel.topic for channel in scene.channels])

    # A budget that no machine is too busy for: both are tried to the end.
    probed, flown = explain(scene, budget=60.0), explain(scene, commands, budget=60.0)

    assert any("probe" in remark for remark in probed.remarks)
    assert not any("probe" in remark for remark in flown.remarks)
    assert flown.attitude_error < 1e-12 < probed.attitude_error


def test_what_is_in_no_scene_is_what_the_page_of_limits_says() -> None:
    page = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    rows = [line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if line.startswith("| ")]
    assert tuple(rows[1 : rows.index("if you want")]) == NOT_MODELLED
    found = explain(parse_scene(RIGID + "duration: 1"), budget=0.1)
    assert found.left_out[-len(NOT_MODELLED) :] == tuple(f"{thing}: never modelled" for thing in NOT_MODELLED)
    assert all(thing in found.as_text() for thing in NOT_MODELLED)


def test_a_scene_without_end_is_tried_for_the_budget() -> None:
    found = explain(parse_scene(RIGID + "effects: [{type: linear_drag, rotation: 0.1}]\nwrenches: []"), budget=0.2)
    assert 0.0 < found.trial_s < 3600.0
    assert any(
        remark.startswith("cost: measured over the first ") and "of 3600 s" in remark for remark in found.remarks
    )


def test_a_trial_with_time_enough_reaches_the_end() -> None:
    """For any length, the doubling pieces end exactly there."""
    found = explain(
        parse_scene(RIGID + "effects: [{type: linear_drag, rotation: 0.1}]\nduration: 0.30001"), budget=60.0
    )
    assert found.trial_s == 0.30001
    assert not any("measured over" in remark for remark in found.remarks)


def test_the_error_is_that_at_the_end_though_outputs_leave_the_trial_no_time_to_go_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By a clock on which only outputs take time, a millisecond each."""
    spent = [0.0]

    class Timed(Simulation):
        def __init__(self, scene: Scene) -> None:
            super().__init__(scene)
            self._every = 1e-12 * scene.output_rate

        def advance(self, time_ns: int) -> None:
            spent[0] += self._every * (time_ns - self.time_ns)
            super().advance(time_ns)

    module = importlib.import_module("rb_dynamics.study.explain")
    monkeypatch.setattr(module, "Simulation", Timed)
    monkeypatch.setattr(module, "Stopwatch", lambda: Stopwatch(lambda: spent[0]))
    scene = parse_scene(RIGID + "wrenches: []\nduration: 40\nsolver: {method: rk4, step: 0.02}\n")
    ends = [simulate(replace(scene, solver=solver)).sample for solver in (scene.solver, Solver())]

    found = explain(scene, budget=0.5)

    assert found.trial_s < 20.0
    assert (found.error_s, found.whole_s) == (40.0, 40.0)
    assert found.attitude_error == pytest.approx(
        angle_between(ends[0].orientation_xyzw, ends[1].orientation_xyzw), rel=0.05
    )
    assert f"attitude error      {found.attitude_error:.2g} rad after all 40 s" in found.as_text()


def test_a_closed_form_keeps_to_the_budget_with_a_million_outputs() -> None:
    """It has one step, so the number of steps cannot limit the trial."""
    changes = {"duration": 1e9, "solver.accuracy": 1e-3}
    found = explain(read_scene(ROOT / "config" / "dzhanibekov.yaml", changes), budget=0.05)
    assert found.methods == "exact"
    assert 0.0 < found.trial_s < 1e4
    assert found.cost_per_s > 100.0 * found.bare_cost_per_s


def test_commands_act_in_the_order_in_which_simulate_takes_them() -> None:
    """Both are stamped before the start, where the later stamp wins: a zero wrench, so the motion has a closed form."""
    scene = parse_scene(RIGID + "duration: 1")
    commands = [
        ("wrench", Wrench(stamp_ns=-1)),
        ("wrench", Wrench(torque=(0.1, 0.2, 0.3), stamp_ns=-2)),
    ]
    assert explain(scene, commands, budget=0.1).methods == simulate(scene, commands).method == "exact"


def test_commands_that_cannot_be_honoured_are_left_out_and_counted() -> None:
    found = explain(
        parse_scene(RIGID + "duration: 1"), [("wrench", Wrench(frame_id="nowhere")), ("wrench", Wrench())], budget=0.1
    )
    (remark,) = (remark for remark in found.remarks if "rejected" in remark)
    assert remark.startswith("1 of 2 commands were rejected; the first: wrench at simulation time 0.000000000 s: ")


def test_an_error_that_is_not_that_of_the_end_says_so_on_its_line() -> None:
    found = explain(parse_scene(RIGID + "effects: [{type: linear_drag, rotation: 0.1}]\nwrenches: []"), budget=0.2)
    assert 0.0 < found.error_s < found.whole_s == 3600.0
    lines = [line for line in found.as_text().splitlines() if " error  " in line]
    assert len(lines) == 2
    assert all(line.endswith(f"after {found.error_s:g} s of 3600 s only") for line in lines)


def test_a_scene_without_end_whose_first_output_is_hours_away() -> None:
    assert explain(parse_scene(RIGID + "wrenches: []\noutput_rate: 1.0e-4"), budget=60.0).trial_s == 3600.0


def test_a_scene_that_is_over_at_once_is_refused() -> None:
    scene = replace(parse_scene(RIGID + "wrenches: []"), duration=0.0)
    with pytest.raises(SceneError, match=r"duration: found .* expected a motion to measure"):
        explain(scene)


def test_outputs_have_a_cost_of_their_own() -> None:
    """The closed form needs one step for the end, and one for each output."""
    found = explain(parse_scene(RIGID + "wrenches: []\nduration: 10"), budget=60.0)
    assert found.cost_per_s > 10.0 * found.bare_cost_per_s > 0.0
    assert "with all outputs" in found.as_text()


def test_no_cost_holds_what_happens_once_or_a_while_in_which_the_machine_was_busy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By a clock on which a step takes a millisecond, the first call of all a minute, and a trial's second one more."""
    module = importlib.import_module("rb_dynamics.study.explain")
    spent = [0.0]
    calls: list[int] = []

    class Timed(Simulation):
        def advance(self, time_ns: int) -> None:
            before = self.steps_computed
            super().advance(time_ns)
            calls.append(time_ns)
            spent[0] += 1e-3 * (self.steps_computed - before) + (60.0 if len(calls) in (1, 3) else 0.0)

    monkeypatch.setattr(module, "Simulation", Timed)
    monkeypatch.setattr(module, "Stopwatch", lambda: Stopwatch(lambda: spent[0]))
    found = explain(
        parse_scene(RIGID + "effects: [{type: linear_drag, rotation: 1.0e-3}]\nwrenches: []\nduration: 600"), budget=0.5
    )

    assert found.bare_cost_per_s < 0.1
    assert found.cost_per_s < 0.1
    assert found.trial_s < 600.0


@pytest.mark.slow
def test_a_run_without_outputs_ends_when_half_of_its_budget_is_spent(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock on which a step takes a millisecond; the steps are counted though no edge is reached."""
    module = importlib.import_module("rb_dynamics.study.explain")
    spent, steps, timed = [0.0], [0], []

    class Timed(Simulation):
        def advance(self, time_ns: int) -> None:
            before = self.steps_computed
            super().advance(time_ns)
            spent[0] += 1e-3 * (self.steps_computed - before)
            steps[0] = self.steps_computed if self.plan.name == "rk4" and self.steps == 0 else 0

    def clock() -> float:
        timed.append(steps[0])
        return spent[0]

    monkeypatch.setattr(module, "Simulation", Timed)
    monkeypatch.setattr(module, "Stopwatch", lambda: Stopwatch(clock))
    drag = "effects: [{type: linear_drag, rotation: 1.0e-3}]\nwrenches: []\nduration: 100\n"
    found = explain(parse_scene(RIGID + drag + "solver: {method: rk4, step: 0.01}\noutput_rate: 1"), budget=1.0)

    assert 250 < max(timed) <= 500
    assert found.steps_per_s == 100.0


def test_a_probe_ends() -> None:
    """Its last torque, held for a day, spun the body up until no step could be taken."""
    scene = parse_scene(RIGID + "duration: 1200\nsolver: {method: rk4, step: 0.05}\n")
    commands, _ = probed(scene, [], 1200.0)
    assert len(commands) == 1001
    state = simulate(scene, commands).sample
    assert norm(state.angular_velocity_body) < 50.0


@needs_numba
@pytest.mark.parametrize(("duration", "worth_it"), [("1.0e+5", True), ("1", False)])
def test_the_cost_is_that_of_the_whole_run(duration: str, worth_it: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of ten million steps is compiled although the trial has few; one of a hundred is not."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    fixed_step_kernel.kernel.cache_clear()
    scene = parse_scene(RIGID + f"duration: {duration}\nsolver: {{method: rk4, step: 0.01}}\noutput_rate: 1")
    found = explain(scene, budget=0.2)
    assert found.compiled is worth_it
    assert any(remark.startswith("kernels compiled or loaded: ") for remark in found.remarks) is worth_it
    assert ("moved by            rk4, compiled" in found.as_text()) is worth_it


@needs_numba
def test_a_cost_without_kernels_is_not_called_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Six thousand steps in plain Python were, where another kernel was there, and nothing said that it passes."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    scene = parse_scene(RIGID + "duration: 60\nsolver: {method: rk4, step: 0.01}\noutput_rate: 1")

    found = explain(scene, budget=0.2)

    assert not found.compiled
    (remark,) = [remark for remark in found.remarks if "plain Python" in remark]
    assert remark.startswith("the cost is that of plain Python, as kernels are not compiled yet")
    assert "_run_on_numbers_rk4" in remark


def test_json_has_all_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", str(ROOT / "config" / "boxes.yaml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["methods"] == "exact"
    assert found["cost_per_s"] > 0.0
    assert {"modelled", "left_out", "solver", "attitude_error", "position_error"} <= found.keys()


@pytest.mark.parametrize(
    ("rate", "speed", "said"),
    [(0.1, 0.0, ""), (0.18, 0.0, "comes near that"), (0.3, 0.0, "saturates"), (0.1, 150.0, "saturates")],
)
def test_wheels_that_cannot_hold_the_momentum_are_named(rate: float, speed: float, said: str) -> None:
    """About y: 0.1 kg m^2 times the rate, of which the wheel holds 1e-4 kg m^2 times 200 rad/s."""
    wheels = "".join(
        f"  - {{type: reaction_wheel, name: wheel_{axis}, axis: {direction}, inertia: 1.0e-4, max_speed: 200.0, "
        f"speed: {speed if axis == 'y' else 0.0}}}\n"
        for axis, direction in (("x", "[1, 0, 0]"), ("y", "[0, 3, 0]"), ("z", "[0, 0, 1]"))
    )
    text = "body: {mass: 10, inertia: {diagonal: [0.1, 0.1, 0.1]}}\n"
    text += f"initial: {{angular_velocity_body: [0, {rate}, 0], orientation: {{x: 0, y: 0, z: 0.6, w: 0.8}}}}\n"
    scene = parse_scene(f"{text}wrenches: []\nactuators:\n{wheels}duration: 1\n")
    found = [remark for remark in explain(scene, budget=0.02).remarks if "max_speed" in remark]
    assert len(found) == bool(said)
    assert all(remark.startswith("wheel_y holds 0.02 N m s") and said in remark for remark in found)


def test_sensors_slower_than_the_body_turns_are_named() -> None:
    """2 rad/s: 0.2 rad in a period of the IMU, 2 rad in one of the star tracker."""
    sensors = "[{type: imu, name: imu, rate: 10}, {type: star_tracker, name: tracker, rate: 1}]"
    text = "body: {mass: 10, inertia: {diagonal: [0.1, 0.1, 0.1]}}\ninitial: {angular_velocity_body: [0, 2, 0]}\n"
    scene = parse_scene(f"{text}wrenches: []\nsensors: {sensors}\nduration: 1\n")
    (found,) = (remark for remark in explain(scene, budget=0.02).remarks if "message" in remark)
    assert found.startswith("tracker: the body turns by 2 rad from one message to the next")


@pytest.mark.slow
def test_the_first_imports_are_not_part_of_the_cost() -> None:
    code = (
        "import functools, sys\n"
        "from rb_dynamics.study import explain as module\n"
        "module.Stopwatch = functools.partial(module.Stopwatch, lambda: 1e-3 * len(sys.modules))\n"
        f"found = module.explain({str(ROOT / 'config' / 'dzhanibekov.yaml')!r})\n"
        "print(found.cost_per_s, found.bare_cost_per_s, 'numpy' in sys.modules)"
    )

    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert result.stdout.split() == ["0.0", "0.0", "True"]


@needs_numba
def test_the_cost_of_the_end_alone_is_by_the_kernels_of_the_run_with_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of few steps in plain Python, it was several times that with all outputs, which load kernels."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    assert main(["compile", "_run_on_numbers_rk4", "propagate", "_no_strides"]) == 0
    text = RIGID + "solver: {method: rk4, step: 0.1}\nduration: 4\noutput_rate: 1000\n"
    found = explain(parse_scene(text), budget=100.0)
    assert found.compiled
    assert sum("a process that computes only this end does so in plain Python" in each for each in found.remarks) == 1


def test_set_up_is_no_part_of_the_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """It took fifteen times as long as the few steps of a whole orbit."""
    hour, late = 3600.0, [0.0]
    begin = Simulation.__init__

    def slow(self: Simulation, *arguments: object) -> None:
        late[0] += hour
        begin(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "__init__", slow)
    monkeypatch.setattr("rb_dynamics.study.explain.Stopwatch", lambda: Stopwatch(lambda: CLOCK() + late[0]))
    found = explain(parse_scene(RIGID + "duration: 2\n"))
    assert 0.0 < found.cost_per_s < hour
    assert 0.0 < found.bare_cost_per_s < hour
    assert any(remark.startswith("the times leave out set-up: 3.6e+06 ms") for remark in found.remarks)
