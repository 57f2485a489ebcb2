"""The bodies of a block of runs: side by side in the kernels of `Ensemble`, or one alone through `Simulation`.

Both give the same bits. Side by side is for runs without effects, with one method and a fixed step (or without torque,
in closed form); every other scene runs alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol

from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.exact import EXACT
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import subtract
from rb_dynamics.run.ensemble import Ensemble
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sample_arrays import Samples
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.scene.model import Scene

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.arrays import Numbers
    from rb_dynamics.run.sink import Sink

CHANNEL = "control"
"""The wrench channel of the controller's commands."""


def go_side_by_side(scenes: Sequence[Scene], driven: bool) -> bool:
    """Return whether the runs can go side by side; `driven`: by a controller."""
    first = scenes[0]
    shared = first.solver, first.duration, ()
    if any((scene.solver, scene.duration, scene.combined_effects.effects) != shared for scene in scenes):
        return False
    if first.solver.method in ("auto", "exact"):
        return not driven
    return first.solver.step is not None


def step_ns(scene: Scene) -> int | None:
    """Return the step of `scene` in nanoseconds; None if it has none, or it is not a whole number of them."""
    if scene.solver.step is None or METHODS.get(scene.solver.method, EXACT).order is None:
        return None
    length = Fraction(repr(scene.solver.step)) * NANOSECONDS
    return int(length) if length.denominator == 1 else None


class Bodies(Protocol):
    """N bodies that move through time."""

    def samples(self) -> Samples:
        """Return their present state and bookkeeping."""

    def hold(self, torque: Numbers, changed: npt.NDArray[np.bool_]) -> None:
        """Hold the torques (N, 3), body axes, N m, from now on; only those marked in `changed` (N,) are new."""

    def advance_to(self, time_ns: int) -> None:
        """Advance to a later time.

        Raises:
            ConvergenceError: a step cannot be solved.
        """


class SideBySide:
    """Bodies in an `Ensemble`."""

    def __init__(self, scenes: Sequence[Scene], threads: int | None) -> None:
        """Start at the initial states of the scenes."""
        solver = scenes[0].solver
        method = "exact" if solver.method == "auto" else solver.method
        self._ensemble = Ensemble(
            [scene.body for scene in scenes], [scene.initial for scene in scenes], method, solver.step, threads
        )

    def samples(self) -> Samples:
        """Return their state; see `Bodies`."""
        return self._ensemble.samples()

    def hold(self, torque: Numbers, changed: npt.NDArray[np.bool_]) -> None:
        """Hold the torques; see `Bodies`. On the grid of steps, holding the same torque again changes nothing."""
        self._ensemble.hold(torque_body=torque)

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`."""
        self._ensemble.advance_to(time_ns)


_FIELDS = [name for name in Sample.__slots__ if name in vars(Samples)]


class Alone:
    """One body, in the loop that `simulate` runs; `sinks` receive its outputs."""

    def __init__(self, scene: Scene, sinks: Sequence[Sink] = ()) -> None:
        """Start at the initial state of the scene."""
        self._run = Simulation(scene if sinks else without_outputs(scene), sinks)
        self._now_ns, self._body_frame = 0, scene.frames.body_frame
        self._first = self._run.sample
        self._run.start()

    def samples(self) -> Samples:
        """Return its state; see `Bodies`."""
        import numpy as np

        first, sample = self._first, self._run.look()
        columns = {name: np.array([getattr(sample, name)]) for name in _FIELDS}
        impulses = {
            "impulse_world": (
                sample.linear_momentum_world, first.linear_momentum_world, sample.linear_momentum_defect_world
            ),
            "torque_impulse_world": (
                sample.angular_momentum_world, first.angular_momentum_world, sample.angular_momentum_defect_world
            ),
        }  # fmt: skip
        for name, (now, before, defect) in impulses.items():
            columns[name] = np.array([subtract(subtract(now, before), defect)])
        return Samples.known(sample.time_ns, **columns)

    def hold(self, torque: Numbers, changed: npt.NDArray[np.bool_]) -> None:
        """Hold the torque; see `Bodies`."""
        if changed[0]:
            x, y, z = torque[0].tolist()
            torque_body = Wrench(torque=(x, y, z), frame_id=self._body_frame, stamp_ns=self._now_ns)
            self._run.post(CHANNEL, torque_body, self._now_ns)

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`."""
        self._run.advance(time_ns)
        self._now_ns = time_ns

    def finish(self) -> None:
        """Close the sinks; a run that was not advanced to its end is marked as cut off."""
        self._run.finish()
