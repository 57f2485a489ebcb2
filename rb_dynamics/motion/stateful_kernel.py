"""Kernels for a step under a load with inner states, such as wheels: the stages of `inner_states.py`, compiled.

Each call takes one step, with the same bits as plain Python. If a step is refused, plain Python repeats it and raises
the error.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple

from rb_dynamics.loads.compiled_load import (
    EffectLoad,
    GradualLoad,
    evaluated_by_numbers,
    evaluated_with_transients,
    has_effects,
    has_transients,
)
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wheel_numbers import inner_torque, length_of, momentum_in, states_of
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.inner_states import difference
from rb_dynamics.motion.kernel_layout import (
    CONSTANTS,
    PHASE,
    constant_numbers,
    constants_at,
    phase_at,
    phase_of,
    write_phase,
)
from rb_dynamics.motion.method import Increment, Inertia, Method, SparseTableau
from rb_dynamics.motion.phase_state import MOMENTUM, POSITION, SUMS, PhaseState, grown, total, two_sum
from rb_dynamics.motion.plugin_kernels import are_ready, plugin_kernels
from rb_dynamics.numerics.compilation import compiled_by, specialise
from rb_dynamics.numerics.rotation import Quaternion, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, scale

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

# Layout of the array of a kernel: body and wrench, phase, second result of a pair, number of the next stage, and the
# weights of the tableau, in a row for each stage and three for the result and its errors. Then `WheelSet.now`; and of
# the inner states: sums, rounding errors of the sums, values at a stage, and rates, first at the present stage, then at
# each stage. The numbers of the effects come last.
OTHER = CONSTANTS + PHASE
STAGE = OTHER + PHASE
ROWS = STAGE + 1
MOST_STAGES = 12
WHEELS = ROWS + MOST_STAGES * (MOST_STAGES + 3)
OF_EACH_STATE = 4 + MOST_STAGES
_RESULT, _FIFTH, _THIRD = MOST_STAGES, MOST_STAGES + 1, MOST_STAGES + 2
_SIGNATURE = "void(float64[::1], float64)"
_PHASE = Struct(f"{PHASE}d")


class CompiledWheelLoad(NamedTuple):
    """A load with inner states, in a kernel.

    Attributes:
        numbers: the array of the kernel, see above.
        h: length of the step, s.
        high: the sum of the time at the start of the step, s since the start of the run, see `PhaseState`.
        low: its rounding error.
        position: of the centre of mass at the start, world axes, m.
        moments: of the body, principal axes.
        held: the held wrench.
    """

    numbers: Numbers
    h: float
    high: float
    low: float
    position: Vector
    moments: Vector
    held: HeldWrench


@compiled_by(evaluated, CompiledWheelLoad)
def evaluated_with_wheels(
    load: CompiledWheelLoad,
    t: float,
    displacement: Vector,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> tuple[Vector, Vector]:
    """Return force (N, world axes) and torque (N m, principal axes) at the next stage of the tableau."""
    c, force, torque, stage = load.numbers, ZERO, ZERO, int(load.numbers[STAGE])
    m, sums, states = layout(c)
    _gain(c, load.h, stage, stage)
    for k in range(m):
        c[states + k] = (c[sums + k] + c[sums + m + k]) + c[states + k]
    if has_transients(c):
        gradual = GradualLoad(c, load.high + load.low, load.position, load.high, load.low)
        force, torque = evaluated_with_transients(gradual, t, displacement, velocity, orientation, angular_velocity)
    elif has_effects(c):
        at = EffectLoad(c, load.high + load.low, load.position)
        force, torque = evaluated_by_numbers(at, t, displacement, velocity, orientation, angular_velocity)
    held = add(load.held.torque_body, rotate_inverse(orientation, load.held.torque_world))
    outside = add(held, torque)
    inner = inner_torque(c, WHEELS, states, load.moments, outside, orientation, angular_velocity)
    rates = states + m
    for k in range(m):
        c[rates + (stage + 1) * m + k] = c[rates + k]
    c[STAGE] = stage + 1.0
    return force, add(torque, inner)


def layout(c: Numbers) -> tuple[int, int, int]:
    """Return the number of inner states, and the offsets of their sums and of their values at a stage."""
    m, sums = states_of(c, WHEELS), WHEELS + length_of(c, WHEELS)
    return m, sums, sums + 2 * m


def _gain(c: Numbers, h: float, row: int, stages: int) -> None:
    """Write h times the sums of the rates at the first stages, with the weights of a row, to where the states stand."""
    m, _, states = layout(c)
    weights, rates = ROWS + row * MOST_STAGES, states + 2 * m
    for k in range(m):
        c[states + k] = 0.0
    for stage in range(stages):
        if c[weights + stage] != 0.0:
            for k in range(m):
                c[states + k] += c[weights + stage] * c[rates + stage * m + k]
    for k in range(m):
        c[states + k] = h * c[states + k]


def _begun(c: Numbers, h: float, inertia: Inertia, held: HeldWrench, start: PhaseState) -> CompiledWheelLoad:
    """Return the load of a step from `start`, before its first stage."""
    c[STAGE] = 0.0
    return CompiledWheelLoad(c, h, start.high[13], start.low[13], total(start, POSITION), inertia.moments, held)


def _begun_without(c: Numbers, h: float, inertia: Inertia, held: HeldWrench, start: PhaseState) -> None:
    """As `_begun` where nothing acts but the held wrench, which has stages of its own."""


def _grow_states(c: Numbers, h: float) -> None:
    m, sums, states = layout(c)
    _gain(c, h, _RESULT, MOST_STAGES)
    for k in range(m):
        c[sums + k], c[sums + m + k] = two_sum(c[sums + k], c[states + k], c[sums + m + k])


def _step(*arguments: Any) -> Increment:
    """Placeholder for the step of a method."""
    raise NotImplementedError


def _pair(*arguments: Any) -> tuple[Increment, Increment]:
    """Placeholder for the pair of a method."""
    raise NotImplementedError


def _step_on_numbers(c: Numbers, h: float) -> None:
    """Take a step of h s."""
    (inertia, held), start = constants_at(c), phase_at(c, CONSTANTS)
    velocity, load = scale(1.0 / inertia.mass, total(start, MOMENTUM)), _begun(c, h, inertia, held, start)
    step = _step(inertia, held, h, velocity, start.orientation, start.angular_velocity, load)
    high, low = grown(start.high, start.low, step, h)
    write_phase(c, CONSTANTS, PhaseState(step.orientation, step.angular_velocity, high, low))
    _grow_states(c, h)


def _pair_on_numbers(c: Numbers, h: float) -> None:
    """Take a step of h s, and write the second result of the pair with the addition of `StagedLoad.compared`."""
    (inertia, held), start = constants_at(c), phase_at(c, CONSTANTS)
    velocity, load = scale(1.0 / inertia.mass, total(start, MOMENTUM)), _begun(c, h, inertia, held, start)
    step, other = _pair(inertia, held, h, velocity, start.orientation, start.angular_velocity, load)
    high, low = grown(start.high, start.low, step, h)
    write_phase(c, CONSTANTS, PhaseState(step.orientation, step.angular_velocity, high, low))
    m, _, states = layout(c)
    _gain(c, h, _FIFTH, MOST_STAGES)
    for k in range(m):
        c[states + m + k] = c[states + k]
    _gain(c, h, _THIRD, MOST_STAGES)
    for k in range(m):
        c[states + k] = difference(c[states + m + k], c[states + k])
    omega = add_scaled(other.angular_velocity, 1.0, divide(momentum_in(c, WHEELS, states), inertia.moments))
    high, low = grown(start.high, start.low, other, h)
    write_phase(c, OTHER, PhaseState(other.orientation, omega, high, low))
    _grow_states(c, h)


class StatefulKernels(NamedTuple):
    """Kernels of a method with wheels: its step, its embedded pair if any, and the weights of its tableau as bytes."""

    step: OnDemand
    pair: OnDemand | None
    weights: bytes


@cache
def stateful_kernels(method: Method, *, bare: bool = False) -> StatefulKernels | None:
    """Return the kernels of `method` with wheels, `bare`: without, and without effects; None if it has none."""
    tableau = method.tableau
    if tableau is None or not (method.compiles and method.compiles_loads) or len(tableau.rows) > MOST_STAGES:
        return None

    name = f"without_wheels_{method.name}" if bare else f"with_wheels_{method.name}"
    begun: Callable[..., Any] = _begun_without if bare else _begun
    step = specialise(_step_on_numbers, f"step_{name}", _step=method.step, _begun=begun)
    pair = None
    if method.pair is not None:
        pair = specialise(_pair_on_numbers, f"pair_{name}", _pair=method.pair, _begun=begun)
    return StatefulKernels(
        OnDemand(method.name, step, _SIGNATURE),
        None if pair is None else OnDemand(method.name, pair, _SIGNATURE),
        _weights(tableau),
    )


def _weights(tableau: SparseTableau) -> bytes:
    rows = (*tableau.rows, *((),) * (MOST_STAGES - len(tableau.rows)), tableau.weights, *tableau.errors)
    found = [0.0] * (MOST_STAGES * len(rows))
    for k, row in enumerate(rows):
        for stage, weight in row:
            found[k * MOST_STAGES + stage] = weight
    return _packed(found)


class StatefulSteps:
    """Takes the steps of one arc with wheels, by kernels.

    Attributes:
        numbers: that the kernels are given, as bytes, without phase and states.
    """

    def __init__(
        self,
        kernels: StatefulKernels,
        inertia: Inertia,
        held: HeldWrench,
        wheels: Sequence[float],
        effects: Sequence[float],
    ) -> None:
        """Use a held wrench, wheels (`WheelSet.now`) and effects (`effect_numbers`)."""
        self._kernels, self._plugins = kernels, plugin_kernels(tuple(effects))
        count = states_of(wheels, 0)
        before = (*constant_numbers(inertia, held), *(0.0,) * (2 * PHASE + 1))
        behind = (*wheels, *(0.0,) * (OF_EACH_STATE * count), *effects)
        self.numbers = _packed(before) + kernels.weights + _packed(behind)
        self._sums = Struct(f"{2 * count}d"), 8 * (WHEELS + len(wheels))

    def step(self, phase: PhaseState, h: float) -> PhaseState | None:
        """Return the phase after a step of h s; None if plain Python has to take it."""
        numbers = self._after(self._kernels.step, phase, h)
        return None if numbers is None else self._phase(numbers)

    def pair(self, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState] | None:
        """Return the same, and the second result of the pair, without inner states."""
        numbers = None if self._kernels.pair is None else self._after(self._kernels.pair, phase, h)
        if numbers is None:
            return None
        after, other = self._phase(numbers), _PHASE.unpack_from(numbers, 8 * OTHER)
        return None if after is None or not all(map(math.isfinite, other)) else (after, phase_of(other))

    def _after(self, kernel: OnDemand, phase: PhaseState, h: float) -> bytearray | None:
        """Return the array after a step."""
        compiled = kernel.get(1.0, 1.0) if are_ready(self._plugins, (kernel,), 1.0, 1.0) else None
        if compiled is None:
            return None
        numbers, (sums, at) = bytearray(self.numbers), self._sums
        q, w, high, low = phase
        _PHASE.pack_into(numbers, 8 * CONSTANTS, *q, *w, *high[:SUMS], *low[:SUMS])
        sums.pack_into(numbers, at, *high[SUMS:], *low[SUMS:])
        compiled.on_doubles((ctypes.c_double * (len(numbers) // 8)).from_buffer(numbers), h)
        return numbers

    def _phase(self, numbers: bytearray) -> PhaseState | None:
        sums, at = self._sums
        end, states = _PHASE.unpack_from(numbers, 8 * CONSTANTS), sums.unpack_from(numbers, at)
        if not (all(map(math.isfinite, end)) and all(map(math.isfinite, states))):
            return None
        phase, count = phase_of(end), len(states) // 2
        return phase._replace(high=phase.high + states[:count], low=phase.low + states[count:])


def _packed(numbers: Sequence[float]) -> bytes:
    return Struct(f"{len(numbers)}d").pack(*numbers)
