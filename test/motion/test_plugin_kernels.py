"""Effects of plug-ins, compiled: bits, refusals and words of plain Python; what does not compile runs there."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.compiled_load import effect_numbers, functions_in
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.plugin_load import SIGNATURE, PluginFunction, load_on_numbers
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.motion import METHODS, fixed_step_kernel
from rb_dynamics.motion.plugin_kernels import PluginKernel, kernel_of, plugin_kernels
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Solver
from test.motion.test_effects_in_kernels import ANY, BODY, needs_numba, scene, told
from test.support import plugin_effects as effects
from test.support.plugin_effects import Given, OtherPull, Roped

MIXED: tuple[Effect, ...] = (Roped(), *ANY, OtherPull(2.0, (0.5, 0.0, 0.0), gravity_gradient=True), Roped(3.0))
FAST = Solver("rk4", step=0.01)


@needs_numba
@pytest.mark.parametrize("acting", [(Roped(),), MIXED], ids=["alone", "among others"])
@pytest.mark.parametrize(
    "solver",
    [FAST, Solver("rk4", accuracy=1e-6), pytest.param(Solver("dop853", accuracy=1e-9), marks=pytest.mark.slow)],
    ids=["step", "accuracy", "pair"],
)
def test_a_run_has_the_bits_of_plain_python(
    monkeypatch: pytest.MonkeyPatch, solver: Solver, acting: tuple[Effect, ...]
) -> None:
    plain, compiled = told(monkeypatch, scene(solver, acting), pieces=3)

    assert plain == compiled
    assert isinstance(plain[0], str), plain


@needs_numba
@pytest.mark.parametrize("solver", [FAST, Solver("rk4", accuracy=1e-6)], ids=["step", "accuracy"])
def test_the_kernels_are_used(monkeypatch: pytest.MonkeyPatch, solver: Solver) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    with fixed_step_kernel.counted_by(tally := fixed_step_kernel.Tally()):
        Simulation(scene(solver, MIXED)).advance(NANOSECONDS)

    assert sum(isinstance(each, PluginKernel) for each in tally.used) == 5
    assert fixed_step_kernel.kernel(METHODS["rk4"], effects=True) in tally.used


@needs_numba
@pytest.mark.slow
def test_with_wheels(monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = ReactionWheel(name="wheel", axis=(0.0, 0.6, 0.8), inertia=0.01, speed=20.0)
    plain, compiled = told(monkeypatch, replace(scene(Solver("dop853", step=0.02), MIXED), actuators=(wheel,)))

    assert plain == compiled
    assert isinstance(plain[0], str), plain
    with fixed_step_kernel.counted_by(tally := fixed_step_kernel.Tally()):
        Simulation(replace(scene(Solver("dop853", step=0.02), MIXED), actuators=(wheel,))).advance(NANOSECONDS)
    assert sum(isinstance(each, PluginKernel) for each in tally.used) == 5


@needs_numba
@pytest.mark.parametrize(
    ("acting", "solver", "error"),
    [
        (Given(partial(effects.inverse, 1.0)), Solver("rk4", step=0.125), ConvergenceError),
        (Roped(see=effects.blind), Solver("rk4", accuracy=1e-6), None),
    ],
)
def test_failures_are_those_of_plain_python(
    monkeypatch: pytest.MonkeyPatch, acting: Effect, solver: Solver, error: type[Exception] | None
) -> None:
    """Where compiled arithmetic would go on: 1/0 is infinite, and a sight of 0 is a step of 1 ns."""
    found = []
    for when in ("never", "always"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        run = Simulation(scene(solver, (acting,), 8.0))
        with pytest.raises(error or Exception) as raised:
            run.advance(NANOSECONDS)
        found.append((type(raised.value), str(raised.value), repr(run.sample)))

    assert found[0] == found[1]
    assert "fails with ZeroDivisionError" in found[0][1] or "its sight is" in found[0][1]


@needs_numba
@pytest.mark.parametrize(
    ("load", "reason"),
    [
        (lambda point: effects.doubled(1.0, point), "is not functools.partial(function, numbers)"),
        (partial(effects.doubled, 1), "its numbers contain a int (1), expected floats"),
        (partial(effects.squared, 1.0), "squared uses **, expected only +, -, * and / (write x * x for x ** 2)"),
        (partial(effects.whole, 1.0), "does not compile"),
        (partial(effects.counted, 1.0), "counted adds or multiplies whole numbers, which may go beyond 64 bits"),
    ],
    ids=["lambda", "whole number", "power", "refused by numba", "large whole numbers"],
)
def test_what_does_not_compile_runs_in_plain_python_which_is_said_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, load: Any, reason: str
) -> None:
    class Own(Given):
        """Known by its type."""

    what = scene(replace(FAST, step=0.001), (Own(load),))
    plain, compiled = told(monkeypatch, what)
    assert plain == compiled
    with fixed_step_kernel.counted_by(fixed_step_kernel.Tally()):
        Simulation(what).advance(NANOSECONDS)

    (said,) = [each for each in caplog.records if each.levelno == logging.WARNING]
    assert said.getMessage().startswith("given runs in plain Python: ")
    assert reason in said.getMessage()


@needs_numba
def test_other_bits_are_noticed() -> None:
    one, other = (PluginFunction("given", load_on_numbers, partial(f, 1.0)) for f in (effects.doubled, effects.tripled))
    native = compilation.compile_kernel(compilation.specialise(load_on_numbers, one.name), SIGNATURE, one.for_numba)

    with pytest.raises(RuntimeError, match="other bits than in Python at Point"):
        other.enter(native)
    one.enter(native)
    assert (one.cell.value, other.cell.value) == (native.address, 0)


def test_effects_of_one_kind_share_their_functions_and_have_their_own_numbers() -> None:
    one, other = (effect_numbers((Roped(stiffness),), BODY, 0.0, plugins=True) for stiffness in (1.0, 2.0))

    assert one is not None
    assert other is not None
    assert functions_in(one) == functions_in(other)
    assert len(functions_in(one)) == 3
    assert [(a, b) for a, b in zip(one, other, strict=True) if a != b] == [(1.0, 2.0)] * 2
    # As before where kernels cannot call them.
    assert effect_numbers((Roped(),), BODY, 0.0) is None


def test_a_load_that_only_another_part_belongs_to_has_none() -> None:
    class Far(Roped):
        def wrenching(self, body: object, start: float) -> Any:
            return None

    assert effect_numbers((Far(),), BODY, 0.0, plugins=True) is None


def test_another_process_finds_the_same_function() -> None:
    numbers = effect_numbers((Roped(),), BODY, 0.0, plugins=True)
    assert numbers is not None
    for kernel in plugin_kernels(numbers):
        assert kernel.order
        assert kernel_of(kernel.order).name == kernel.name


def test_it_is_not_asked_for_what_it_cannot_import() -> None:
    def inside(strength: float, point: object) -> Any:
        return (strength, 0.0, 0.0), (0.0, 0.0, 0.0)

    assert PluginKernel(PluginFunction("given", load_on_numbers, partial(inside, 1.0))).order is None


SCRIPT = """
import sys
from dataclasses import replace
from functools import partial
from rb_dynamics import parse_scene, simulate
sys.path.insert(0, sys.argv[1])
import edited
scene = parse_scene("{body: {mass: 2.0, inertia: {diagonal: [1, 1, 1]}}, duration: 1.0, "
                    "solver: {method: rk4, step: 0.01}}")
print(simulate(replace(scene, effects=(edited.Push(),))).sample.position_world)
"""
MODULE = """
from functools import partial
from rb_dynamics import Effect
from rb_dynamics.loads.varying_load import LoadDependence

PUSH = 1.0

def stronger(x):
    return PUSH * x

def pushed(strength, point):
    return (stronger(strength), 0.0, 0.0), (0.0, 0.0, 0.0)

class Push(Effect):
    kind, takes = "push", LoadDependence.FIELD

    def wrenching(self, body, start):
        return partial(pushed, 4.0)
"""


@needs_numba
def test_no_old_code_runs_after_a_change_of_the_source(tmp_path: Path, root: Path) -> None:
    def place() -> str:
        env = {**os.environ, "RB_DYNAMICS_COMPILE": "always", "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, str(tmp_path)], env=env, capture_output=True, text=True, check=True
        )
        assert not done.stderr
        return done.stdout

    edits = [("", ""), ("PUSH = 1.0", "PUSH = 2.0"), ("return PUSH * x", "return PUSH * x * 2.0")]
    found = []
    for old, new in edits:
        (tmp_path / "edited.py").write_text(MODULE.replace(old, new) if old else MODULE, encoding="utf-8")
        found.append(float(place().strip("(\n").split(",")[0]))

    assert found == pytest.approx([1.0, 2.0, 2.0], rel=1e-12)
