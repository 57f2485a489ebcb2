"""Compiled steps have the bits, books and errors of plain ones."""

from __future__ import annotations

import itertools
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import Recorder, forced

from rb_dynamics.errors import ConvergenceError, MissingExtraError, RigidBodyError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, Method, fixed_step_kernel
from rb_dynamics.motion.arc import Arc, Stepper
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import normalize
from rb_dynamics.numerics.vector import ZERO, Vector, scale
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Solver

COMPILED = [name for name, method in METHODS.items() if method.compiles]
# Made of the steps of the others, or much like one, and long to compile.
COMPOSED = {"strang2", "strang6", "dmv82", "dmv864", "midpoint4", "midpoint6", "dlm4", "dlm6"}
needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")


def case(r: random.Random, longest: float = 0.1) -> tuple[Inertia, HeldWrench, float, PhaseState]:
    """Return a body, its wrench, a step and a start; one in ten is symmetric, one in twenty at rest."""

    def vector(size: float) -> Vector:
        return (r.uniform(-size, size), r.uniform(-size, size), r.uniform(-size, size))

    a, b = sorted((10.0 ** r.uniform(-0.5, 0.5), 10.0 ** r.uniform(-0.5, 0.5)))
    moments = [a, a if r.random() < 0.1 else b, r.uniform(b, a + b)]
    r.shuffle(moments)
    if r.random() < 0.5:
        held = HeldWrench(*(vector(1.0) if r.random() < 0.8 else ZERO for _ in range(4)))
    else:
        held = HeldWrench(force_world=vector(1.0))
    spin = ZERO if r.random() < 0.05 else scale(10.0 ** r.uniform(-3.0, 0.7), vector(1.0))
    start = normalize((r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0)))
    high = (*vector(10.0), *vector(10.0), *ZERO, *ZERO, 0.0, 0.0)
    inertia = Inertia(10.0 ** r.uniform(-3.0, 3.0), (moments[0], moments[1], moments[2]))
    return inertia, held, 10.0 ** r.uniform(-3.0, 0.0) * longest, PhaseState(start, spin, high, (0.0,) * 14)


def end(method: Method, what: tuple[Inertia, HeldWrench, float, PhaseState], steps: float = 20.5) -> tuple[object, int]:
    """Return the end of an arc, or the error, and the steps taken."""
    inertia, held, step, phase = what
    arc, time_ns = Arc(method, inertia, held, FixedStep(step), 0, phase), int(steps * step * NANOSECONDS)
    try:
        # By repr, which shows the sign of a zero too.
        return repr(arc.at(time_ns)), arc.steps_to(time_ns)
    except (ConvergenceError, ArithmeticError) as error:
        return (type(error), str(error)), 0


def compare(monkeypatch: pytest.MonkeyPatch, name: str, longest: float, seed: int) -> list[object]:
    method, ends = METHODS[name], []
    for k in range(300):
        found = []
        for when in ("never", "always"):
            monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
            found.append(end(method, case(random.Random(1000 * seed + k), longest)))
        assert found[0] == found[1], k
        ends.append(found[0][0])
    return ends


@needs_numba
def test_several_steps_in_closed_form_are_several(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel took one step, however many were asked for."""
    for k in range(20):
        inertia, _, _, phase = case(random.Random(k))
        found = []
        for when in ("never", "always"):
            monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
            found.append(end(EXACT, (inertia, HeldWrench(force_world=(1.0, 2.0, 3.0)), 0.05, phase)))
        assert found[0] == found[1]


@needs_numba
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in COMPOSED)) for n in COMPILED])
class TestCompiled:
    def test_has_the_bits_of_plain_python(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        ends = compare(monkeypatch, name, 0.1, seed=1)

        assert sum(isinstance(found, str) for found in ends) > 290

    def test_refuses_what_plain_python_refuses_in_its_words(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        ends = compare(monkeypatch, name, 100.0, seed=2)

        assert any(isinstance(found, tuple) for found in ends)
        assert any(isinstance(found, str) for found in ends)


def _called(*arguments: object) -> Any:
    """Placeholder for the function to compile."""
    raise NotImplementedError


def _pair_on_numbers(c: list[float], h: float, _: int, s: list[float]) -> None:
    inertia = Inertia(c[0], (c[1], c[2], c[3]))
    held = HeldWrench((c[4], c[5], c[6]), (c[7], c[8], c[9]), (c[10], c[11], c[12]), (c[13], c[14], c[15]))
    velocity, orientation, omega = (s[7], s[8], s[9]), (s[0], s[1], s[2], s[3]), (s[4], s[5], s[6])
    i = 0
    for found in _called(inertia, held, h, velocity, orientation, omega, None):
        s[i], s[i + 1], s[i + 2] = found.displacement
        s[i + 3], s[i + 4], s[i + 5], s[i + 6] = found.orientation
        s[i + 7], s[i + 8], s[i + 9] = found.angular_velocity
        s[i + 10], s[i + 11], s[i + 12] = found.impulse
        s[i + 13], s[i + 14], s[i + 15] = found.torque_impulse
        s[i + 16] = found.work
        i += 17


def _longest_on_numbers(c: list[float], accuracy: float, horizon: int, s: list[float]) -> None:
    inertia = Inertia(c[0], (c[1], c[2], c[3]))
    held = HeldWrench((c[4], c[5], c[6]), (c[7], c[8], c[9]), (c[10], c[11], c[12]), (c[13], c[14], c[15]))
    velocity, orientation, omega = (s[7], s[8], s[9]), (s[0], s[1], s[2], s[3]), (s[4], s[5], s[6])
    s[0] = _called(inertia, held, velocity, orientation, omega, accuracy, float(horizon))


def compare_beside(
    template: Callable[..., None], name: str, called: Callable[..., object], seconds: list[float], third: int, seed: int
) -> list[int]:
    """Compare a function that is not a step; return how many cases are not refused, for each longest step."""
    on_numbers = compilation.specialise(template, f"{template.__name__}_{name}", _called=called)
    fast = compilation.compile_kernel(on_numbers, "void(float64[::1], float64, int64, float64[::1])")
    accepted = [0] * len(seconds)
    for (i, second), k in itertools.product(enumerate(seconds), range(300)):
        inertia, held, h, phase = case(random.Random(1000 * seed + k), second)
        numbers = [inertia.mass, *inertia.moments, *itertools.chain(*held)]
        state = [*phase.orientation, *phase.angular_velocity, *phase.high, *phase.low]
        array = np.array(state)
        fast(np.array(numbers), h, third, array)
        compiled = repr(array.tolist())
        try:
            on_numbers(numbers, h, third, state)
        except (ConvergenceError, ArithmeticError):
            assert "nan" in compiled or "inf" in compiled, k
        else:
            assert compiled == repr(state), k
            accepted[i] += 1
    return accepted


@needs_numba
@pytest.mark.parametrize("name", [name for name in COMPILED if METHODS[name].pair is not None])
def test_a_pair_has_the_bits_of_plain_python(name: str) -> None:
    pair = METHODS[name].pair
    assert pair is not None

    short, long = compare_beside(_pair_on_numbers, name, pair, [0.1, 30.0], 0, seed=3)

    assert short in range(290, 301)
    assert long in range(50, 290)


@needs_numba
@pytest.mark.parametrize("name", [name for name in COMPILED if METHODS[name].longest_step is not None])
def test_the_longest_step_has_the_bits_of_plain_python(name: str) -> None:
    longest_step = METHODS[name].longest_step
    assert longest_step is not None

    assert compare_beside(_longest_on_numbers, name, longest_step, [1e-6], 10, seed=4) == [300]


@needs_numba
@pytest.mark.parametrize(
    "solver",
    [
        Solver("rk4", step=0.003),
        Solver("strang2", step=0.003),
        Solver("rk4", accuracy=1e-5),
        Solver("auto", accuracy=1e-5),
    ],
    ids=lambda solver: f"{solver.method} by {'step' if solver.step else 'accuracy'}",
)
@pytest.mark.parametrize("output_rate", [7.0, 0.0])
def test_a_run_has_the_same_bits(monkeypatch: pytest.MonkeyPatch, solver: Solver, output_rate: float) -> None:
    """Compares everything a sink receives: commands, books, outputs between steps or at each step."""
    told = []
    for when in ("never", "always"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        sink, case = Recorder(), forced()
        run = Simulation(case.scene(solver, 1.0, output_rate=output_rate), [sink])
        run.start()
        for topic, wrench in case.commands:
            run.post(topic, wrench, 400_000_000)
        run.advance(NANOSECONDS)
        run.finish()
        told.append((repr(sink.events), sink.result))

    assert told[0] == told[1]


@needs_numba
def test_stretches_meet_without_a_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    what = case(random.Random(5))
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    whole = end(METHODS["rk4"], what, 100.5)
    monkeypatch.setattr("rb_dynamics.motion.arc.LONGEST_STRETCH", 7)

    assert end(METHODS["rk4"], what, 100.5) == whole


@needs_numba
def test_what_is_in_the_cache_is_used_after_a_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A short run does not load LLVM; many short ones do, once, and then every step is compiled."""
    monkeypatch.setattr(fixed_step_kernel._of_the_process, "used", set())
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    inertia, held, step, phase = case(random.Random(5))
    runs = fixed_step_kernel.Kernel(METHODS["rk4"])
    runs.build(fixed_step_kernel.Tally())

    assert runs.after(inertia, held, step, 200, phase, 200, 200) is None
    assert runs.after(inertia, held, step, 200, phase, 200, 200) is None
    assert runs.after(inertia, held, step, 200, phase, 200, 200) is not None
    assert runs.after(inertia, held, step, 1, phase, 1, 1) is not None
    # With LLVM the rest of the cache comes at once.
    other = fixed_step_kernel.Kernel(METHODS["euler"])
    other.build(fixed_step_kernel.Tally())
    assert other.after(inertia, held, step, 1, phase, 1, 1) is not None


@needs_numba
def test_a_tally_of_its_own_decides_as_a_new_process_would(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setattr(fixed_step_kernel, "is_cached", lambda name: False)
    inertia, held, step, phase = case(random.Random(5))
    runs, built = fixed_step_kernel.Kernel(METHODS["rk4"]), {}

    def compiles(tally: fixed_step_kernel.Tally, *stretches: int) -> list[bool]:
        with fixed_step_kernel.counted_by(tally):
            return [runs.after(inertia, held, step, n, phase, n, n) is not None for n in stretches]

    assert compiles(fixed_step_kernel.Tally(built=built), 25_000, 24_999, 1, 1) == [False, False, True, True]
    assert built.keys() == {"_run_on_numbers_rk4"}
    # It is loaded now, and this is found out by nobody.
    assert compiles(fixed_step_kernel.Tally(built=(again := {})), 25_000, 24_999) == [False, False]
    # A step stands for many, but for the one or two that any arc may end with.
    assert compiles(fixed_step_kernel.Tally(scale=1e6), 1, 1, 1) == [False, False, True]
    assert compiles(fixed_step_kernel.Tally(none=True), 10**6) == [False]
    assert compiles(fixed_step_kernel.Tally(missing="plain"), 10**6) == [False]
    assert again == {}
    assert not fixed_step_kernel.Tally().asked


@needs_numba
def test_a_new_process_loads_what_is_in_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    inertia, held, step, phase = case(random.Random(5))
    monkeypatch.setattr(fixed_step_kernel._of_the_process, "used", set())
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    fixed_step_kernel.Kernel(METHODS["rk4"]).after(inertia, held, step, 1, phase, 1, 1)
    monkeypatch.setattr(fixed_step_kernel._of_the_process, "used", set())
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")

    assert (
        fixed_step_kernel.Kernel(METHODS["rk4"]).after(
            inertia, held, step, 1, phase, fixed_step_kernel.FEW - 1, fixed_step_kernel.FEW - 1
        )
        is None
    )
    assert (
        fixed_step_kernel.Kernel(METHODS["rk4"]).after(
            inertia, held, step, 1, phase, fixed_step_kernel.FEW, fixed_step_kernel.FEW
        )
        is not None
    )


@needs_numba
def test_another_process_compiles_what_a_run_could_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run does not wait, the next one uses the kernel, and no process is left behind."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    run = (
        "import sys; from rb_dynamics.motion.propagation_kernel import NO_STRIDES; "
        "print(NO_STRIDES.get(10**9, 0) is not None, 'numba' in sys.modules)"
    )

    def ran() -> str:
        return subprocess.run([sys.executable, "-c", run], capture_output=True, check=True, text=True).stdout

    assert ran() == "False False\n"
    deadline = time.monotonic() + 100.0
    while not list(tmp_path.rglob("_no_strides.kernel")) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert ran() == "True False\n"


@needs_numba
def test_what_another_process_cannot_compile_runs_in_plain_python(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    runs = fixed_step_kernel.OnDemand("rk4", _doubled, "void(float64[::1])")
    compilation.keep_failure("_doubled", "for some reason")

    with fixed_step_kernel.counted_by(fixed_step_kernel.Tally(missing="beside")):
        assert runs.get(10**9, 0) is None
    assert "rk4 runs in plain Python: for some reason" in caplog.text


@needs_numba
def test_where_nothing_can_be_compiled_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Uses a step that cannot be compiled."""

    def step(*arguments: object) -> object:
        return [lambda: arguments].pop()

    inertia, held, h, phase = case(random.Random(5))
    runs = fixed_step_kernel.Kernel(replace(METHODS["rk4"], name="hopeless", step=step))
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")

    with fixed_step_kernel.counted_by(fixed_step_kernel.Tally()):
        assert runs.after(inertia, held, h, 1, phase, fixed_step_kernel.MANY, 1) is None
    assert "hopeless runs in plain Python" in caplog.text


@pytest.mark.parametrize("name", COMPILED)
def test_the_loop_of_a_kernel_is_the_loop_of_an_arc(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """In plain Python, so that it is also tested without numba."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    inertia, held, _, phase = case(random.Random(7))
    arc = Arc(METHODS[name], inertia, held, FixedStep(0.001), 0, phase)
    run = fixed_step_kernel.plain(METHODS[name])

    found = run(inertia, held, 0.001, 20, phase.orientation, phase.angular_velocity, phase.high, phase.low)

    assert repr(PhaseState(*found)) == repr(arc.at(20_000_000))


def test_a_load_that_varies_is_for_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    inertia, held, step, phase = case(random.Random(5))
    stepper = Stepper(METHODS["rk4"], inertia, held, lambda phase: lambda *point: (ZERO, ZERO))

    assert stepper.stretch(phase, step, 1, 10**9, 1) is None


def test_never_means_never(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    inertia, held, step, phase = case(random.Random(5))

    assert fixed_step_kernel.Kernel(METHODS["rk4"]).after(inertia, held, step, 1, phase, 10**9, 10**9) is None


@needs_numba
def test_cached_compiles_nothing_and_says_how_to(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "cached")
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    inertia, held, step, phase = case(random.Random(5))
    runs = fixed_step_kernel.Kernel(METHODS["rk4"])

    with fixed_step_kernel.counted_by(tally := fixed_step_kernel.Tally()):
        assert [runs.after(inertia, held, step, 1, phase, 10**9, 10**9) for _ in "12"] == [None, None]

    assert (tally.built, list(tmp_path.iterdir())) == ({}, [])
    assert caplog.text.count("`rb-dynamics compile _run_on_numbers_rk4` does it ahead") == 1


def test_an_unknown_word_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "sometimes")

    with pytest.raises(RigidBodyError, match="'sometimes', expected never, cached, auto or always"):
        end(METHODS["rk4"], case(random.Random(5)))


def test_always_needs_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    monkeypatch.setattr(fixed_step_kernel, "available", lambda: False)

    with pytest.raises(MissingExtraError, match="RB_DYNAMICS_COMPILE=always needs the package 'numba'"):
        end(METHODS["rk4"], case(random.Random(5)))


def _doubled(numbers: Any) -> None:
    numbers[0] *= 2.0


def doubled(value: float) -> float:
    """Return 2 value with a small kernel."""
    numbers = np.array([value])
    compilation.compile_kernel(_doubled, "void(float64[::1])")(numbers)
    return float(numbers[0])


@needs_numba
def test_where_no_cache_can_be_written_none_is_kept_elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Numba would use the folder of the source, where edits of called functions go unnoticed."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path / "file" / "folder")

    assert doubled(3.0) == 6.0
    assert not list(Path(__file__).parent.rglob("*.nb[ic]"))


@needs_numba
def test_what_is_in_the_cache_runs_without_numba(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Importing numba takes longer than most runs."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    run = (
        "import sys, numpy; from rb_dynamics.motion.propagation_kernel import NO_STRIDES; "
        "print(NO_STRIDES.get(1, 0)(numpy.zeros(1), 0, 0), 'numba' in sys.modules)"
    )
    command = [sys.executable, "-c", run]
    printed = [subprocess.run(command, capture_output=True, check=True, text=True).stdout for _ in "12"]

    assert printed == ["(0, 0, 0) True\n", "(0, 0, 0) False\n"]


@needs_numba
def test_compiled_code_takes_no_other_array_than_it_was_made_for() -> None:
    kernel = compilation.compile_kernel(_doubled, "void(float64[::1])")
    for wrong in (np.zeros(4)[::2], np.zeros((2, 2)), np.zeros(2, dtype=np.float32), np.zeros(2, dtype=np.int64)):
        with pytest.raises(TypeError, match="expected float64"):
            kernel(wrong)


@needs_numba
@pytest.mark.parametrize(
    "damage",
    [
        lambda kept: kept[:0],
        lambda kept: kept[:40],
        lambda kept: kept[:-1],
        # The name under which the function is looked up: the code itself is whole.
        lambda kept: kept.replace(b"_doubled", b"_doublee", 1),
    ],
)
def test_a_cache_that_cannot_be_read_is_begun_anew(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    damage: Callable[[bytes], bytes],
) -> None:
    """Damaged cache files must not run, since they contain code."""
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    assert doubled(3.0) == 6.0
    (broken,) = tmp_path.iterdir()
    broken.write_bytes(damage(broken.read_bytes()))

    assert doubled(3.0) == 6.0
    assert "_doubled was compiled, as" in caplog.text
    assert "it is damaged" in caplog.text

    caplog.clear()
    assert doubled(3.0) == doubled(3.0) == 6.0
    assert compilation.is_cached("_doubled")
    assert not caplog.text


@needs_numba
def test_threads_may_compile_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(doubled, [1.0, 2.0, 3.0, 4.0])) == [2.0, 4.0, 6.0, 8.0]


@needs_numba
def test_a_numba_that_is_switched_off_compiles_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It would run the kernel in plain Python with numpy numbers, slower than without numba."""
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compilation.loaded_numba().config, "DISABLE_JIT", 1)

    with pytest.raises(RuntimeError, match="NUMBA_DISABLE_JIT is set; unset it"):
        doubled(3.0)


def test_a_user_without_a_home_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    monkeypatch.setattr(compilation, "_version_of_numba", lambda: "1")
    monkeypatch.setattr(compilation, "processor", lambda: "some")

    assert not compilation.cache_folder.__wrapped__().is_dir()


def test_an_edit_of_what_kernels_are_made_of_is_another_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compilation, "_version_of_numba", lambda: "1")
    monkeypatch.setattr(compilation, "processor", lambda: "some")
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    (tmp_path / "motion").mkdir()
    source, folders = tmp_path / "motion" / "a.py", set()
    for text in ("x = 1\n", "x = 2\n", "x = 1\n"):
        source.write_text(text)
        folders.add(compilation.cache_folder.__wrapped__())

    assert len(folders) == 2


def test_kernels_that_nobody_uses_any_more_are_deleted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compilation, "_version_of_numba", lambda: "1")
    monkeypatch.setattr(compilation, "processor", lambda: "some")
    own = compilation.cache_folder.__wrapped__()
    long_ago = time.time() - 31 * 86400.0
    folders = [tmp_path / "rb_dynamics" / name for name in (16 * "a", 16 * "b", "another")]
    for folder in folders:
        (folder / "inner").mkdir(parents=True)
    for folder in (folders[0], folders[2]):
        os.utime(folder, (long_ago, long_ago))

    assert compilation.cache_folder.__wrapped__() == own
    assert [folder.exists() for folder in folders] == [False, True, True]

    own.mkdir()
    os.utime(own, (long_ago, long_ago))
    compilation.cache_folder.__wrapped__()
    assert own.stat().st_mtime > long_ago + 86400.0


@needs_numba
def test_a_run_tells_at_once_how_far_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole run counts, not only the time to the next output, so compilation starts at the first step."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "auto")
    asked, after = [], fixed_step_kernel.Kernel.after

    def listening(self: fixed_step_kernel.Kernel, *arguments: Any) -> Any:
        asked.append(arguments[5])
        return after(self, *arguments)

    monkeypatch.setattr(fixed_step_kernel.Kernel, "after", listening)
    run = Simulation(forced().scene(Solver("rk4", step=0.001), 20.0, output_rate=10.0))
    run.start()
    run.advance(NANOSECONDS // 10)

    assert asked[0] == 20_000


def test_what_another_process_has_compiled_is_used_where_many_steps_are_taken_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of a block of runs, which asks once: it looked again after 200 requests, so a whole campaign ran without."""
    kernel = fixed_step_kernel.OnDemand("rk4", lambda: None, "void()")
    ready: list[str] = []
    monkeypatch.setattr(fixed_step_kernel, "is_cached", lambda name: bool(ready))
    monkeypatch.setattr(fixed_step_kernel, "ask_for", lambda *_: True)
    monkeypatch.setattr(fixed_step_kernel, "failure_of", lambda name: "")
    monkeypatch.setattr(fixed_step_kernel, "available", lambda: True)
    monkeypatch.setattr(fixed_step_kernel, "_when", lambda: "auto")
    monkeypatch.setattr(fixed_step_kernel, "compile_kernel", lambda function, signature: "compiled")
    with fixed_step_kernel.counted_by(fixed_step_kernel.Tally(missing="beside")):
        assert kernel.get(1000.0, 1000.0) is None
        ready.append(kernel.name)
        assert kernel.get(1000.0, 1.0) is None, "one step of many: it does not look each time"
        assert str(kernel.get(1000.0, 1000.0)) == "compiled"
