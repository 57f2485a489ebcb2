"""All kernels by name, to compile them in advance."""

from __future__ import annotations

from collections.abc import Iterable

from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.adaptive_kernel import LONGEST, RATES, strides_of
from rb_dynamics.motion.auto_method import CANDIDATES
from rb_dynamics.motion.batch_kernel import mover
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.fixed_step_kernel import OnDemand, dense_kernel, gradual_kernel, kernel
from rb_dynamics.motion.free_motion import FREE_STATES
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.propagation_kernel import NO_STRIDES, PROPAGATE
from rb_dynamics.motion.stateful_kernel import stateful_kernels
from rb_dynamics.motion.variational_equations import VARIATIONAL
from rb_dynamics.motion.wheel_arcs_kernel import ADVANCE_ALL, FIND_ACCELERATIONS
from rb_dynamics.motion.wheel_lanes_kernel import COUNTS, strides_beside
from rb_dynamics.run.many_measurements import FIND_TRUTHS, READ_ALL


def usual_kernels() -> dict[str, OnDemand]:
    """Return the kernels of runs by `auto` under wrenches and under all effects, and of `identify`."""
    of_methods = [each for name in CANDIDATES[LoadDependence.HELD] for each in _of(METHODS[name])]
    under_effects = dict.fromkeys(CANDIDATES[LoadDependence.FIELD] + CANDIDATES[LoadDependence.ANY])
    of_methods += [each for name in under_effects for each in _of(METHODS[name], effects=True)]
    of_methods += [each for name in CANDIDATES[LoadDependence.STATES] for each in _with_wheels(METHODS[name])]
    return _by_name([NO_STRIDES, LONGEST, RATES, PROPAGATE, kernel(EXACT), *of_methods, VARIATIONAL])


def all_kernels() -> dict[str, OnDemand]:
    """Return all kernels, those of plug-ins included."""
    methods = list(METHODS.usable())
    others = (
        each
        for m in methods
        for each in (
            *(*_of(m), *_of(m, effects=True), *_while_gradual(m), *_side_by_side(m)),
            *(*_with_wheels(m), *_with_wheels(m, bare=True)),
        )
    )
    beside = (strides_beside(m, n) for m in methods for n in COUNTS)
    return usual_kernels() | _by_name(
        [FREE_STATES, ADVANCE_ALL, *beside, READ_ALL, FIND_TRUTHS, FIND_ACCELERATIONS, *others]
    )


def _of(method: Method, *, effects: bool = False) -> Iterable[OnDemand | None]:
    within = None if effects else dense_kernel(method)
    return kernel(method, effects=effects), strides_of(method, effects=effects), within


def _while_gradual(method: Method) -> Iterable[OnDemand | None]:
    return gradual_kernel(method), strides_of(method, effects=True, gradual=True)


def _with_wheels(method: Method, *, bare: bool = False) -> Iterable[OnDemand | None]:
    kernels = stateful_kernels(method, bare=bare)
    return () if kernels is None else (kernels.step, kernels.pair)


def _side_by_side(method: Method) -> Iterable[OnDemand | None]:
    return *mover(method).kernels, *mover(method, effects=True).kernels


def _by_name(kernels: Iterable[OnDemand | None]) -> dict[str, OnDemand]:
    return {each.name: each for each in kernels if each is not None}
