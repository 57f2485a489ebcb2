"""`method: auto`: the cheapest method that meets the accuracy, from the cost of a step and the possible step size.

Each method's own step control determines the step size at the given state and load; only the cost of a step is
tabulated. Must not read a clock or look ahead at commands: the same scene and commands must always give the same
choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.motion.adaptive_kernel import LONGER
from rb_dynamics.motion.arc import Stepper
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import StepControl
from rb_dynamics.numerics.nanoseconds import NANOSECONDS

COST_OF_A_STEP: Mapping[str, float] = MappingProxyType(
    {"dverk": 1.0, "dop853": 1.5, "taylor": 1.8, "dlm6": 3.7, "dmv864": 3.7, "dmv104": 3.5, "radau": 16.0}
)
"""Run time of an accepted stride, relative to one of `dverk`; measured by `benchmarks/strides.py`."""

CANDIDATES: Mapping[LoadDependence, tuple[str, ...]] = MappingProxyType(
    {
        LoadDependence.HELD: ("taylor", "dop853", "dmv104", "dlm6", "dverk"),
        LoadDependence.FIELD: ("dop853", "dlm6", "dmv864", "dverk"),
        LoadDependence.ANY: ("dop853", "dverk", "radau"),
        LoadDependence.STATES: ("dop853",),
    }
)
"""The methods on the front of speed and accuracy for each kind of load, in the order in which they are tried."""

FOR_STIFF = frozenset({"radau"})
"""Candidates that pay off only where stability, and not accuracy, limits the stride of the others."""

STIFF = 1.0
"""They are tried if a stride times the fastest rate of the load is more; explicit methods are stable up to about 3."""

TRIALS = 12
"""Attempts to find the longest stride; each can lengthen it fivefold."""


def costs_least(method: Method, takes: LoadDependence) -> bool:
    """Return whether no candidate has a lower price: where one stride of `method` covers an arc, none is cheaper."""
    return COST_OF_A_STEP[method.name] == min(COST_OF_A_STEP[name] for name in CANDIDATES[takes])


def cheapest(
    candidates: tuple[Method, ...],
    control_for: Callable[[Method], StepControl],
    advance_with: Callable[[Method], Stepper],
    phase: PhaseState,
    arc: float,
    rest: float,
) -> tuple[Method, StepControl]:
    """Return the cheapest candidate for arcs of `arc` s from `phase` on, with a control that has learnt its step.

    Candidates are tried in the given order, and only if the trial can pay off in the `rest` of the run (s).

    Raises:
        ConvergenceError: none of them meets the accuracy; with the message of the first.
    """
    best: tuple[float, Method, StepControl] | None = None
    failure: ConvergenceError | None = None
    for method in candidates:
        price = COST_OF_A_STEP[method.name]
        # The cost is never below `price / arc`.
        if best is not None and (TRIALS * price > best[0] * rest or price / arc >= best[0]):
            continue
        advance = advance_with(method)
        try:
            if best is not None and method.name in FOR_STIFF:
                stride = COST_OF_A_STEP[best[1].name] / best[0]
                if stride * advance.fastest_rate(phase) < STIFF:
                    continue
            control = control_for(method)
            stride = longest_stride(control, advance, phase)
        except ConvergenceError as error:
            failure = failure or error
            continue
        cost = price / min(stride, arc)
        if best is None or cost < best[0]:
            best = (cost, method, control)
    if best is None:
        raise failure or ConvergenceError("auto: found no method to choose from, expected at least one")
    return best[1], best[2]


def longest_stride(control: StepControl, advance: Stepper, phase: PhaseState) -> float:
    """Return the longest stride (s) from `phase` on; the control has then learnt it.

    Raises:
        ConvergenceError: no stride meets the accuracy.
    """
    found = advance.longest_stride(control, phase, TRIALS)
    if found is not None:
        return found
    longest = 0.0
    for _ in range(TRIALS):
        stride = control.stride(phase, advance)[0] / (control.denominator * NANOSECONDS)
        control.begin()
        if stride < LONGER * longest:
            break
        longest = stride
    return longest
