"""`EdgeSchedule`: the edges of a run that are known in advance: outputs, and changes by a table of commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.loads.wrench_channels import WrenchChannels
from rb_dynamics.motion.phase_state import in_principal_axes
from rb_dynamics.motion.propagation import Edges
from rb_dynamics.motion.propagation_kernel import CHANGE, OUTPUT
from rb_dynamics.numerics.distinct import distinct

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Whole = npt.NDArray[np.int64]

FEWEST = 8
"""Least number of edges for which a call of the kernel pays."""

# Number of edges looked up at once.
_MANY = 4_000


class EdgeSchedule:
    """The next edges of one run, looked up in blocks.

    Attributes:
        known_ns: time until which all edges are known.
    """

    def __init__(self, channels: WrenchChannels, body: RigidBody, period_ns: tuple[int, int]) -> None:
        """Create the schedule of outputs every `period_ns` (a ratio) and of changes of `channels`."""
        self._channels, self._body, self._period_ns = channels, body, period_ns
        self._edges: Edges | None = None
        self.known_ns = -1

    def forget(self) -> None:
        """Discard what has been looked up, because new commands have arrived."""
        self._edges, self.known_ns = None, -1

    def count(self, time_ns: int, until_ns: int) -> int:
        """Return the approximate number of edges after `time_ns` up to `until_ns`, fast and without numpy."""
        period, parts = self._period_ns
        return (until_ns - time_ns) * parts // period + self._channels.tabled

    def after(self, time_ns: int, outputs: int, until_ns: int, horizon_ns: int) -> Edges | None:
        """Return the edges after `time_ns` up to `until_ns`; None if they are few.

        `outputs` is the number of past outputs; nothing is known beyond `horizon_ns`.
        """
        if self._edges is None or self.known_ns <= time_ns:
            self._edges, self.known_ns = self._look_up(outputs, horizon_ns)
        at = self._edges.at
        first, last = at.searchsorted((time_ns, until_ns), side="right").tolist()
        if first:
            self._edges = self._edges.behind(first)
        return self._edges.before(last - first) if last - first >= FEWEST else None

    def _look_up(self, outputs: int, horizon_ns: int) -> tuple[Edges, int]:
        """Return the next edges, and the time (ns) until which there are no others."""
        import numpy as np

        changes, known_ns = self._channels.timeline(horizon_ns, _MANY)
        output_times = self._outputs(outputs, known_ns)
        if len(output_times) == _MANY:
            known_ns = int(output_times[-1])
        changes = changes.until(known_ns)
        at = distinct(np.concatenate([output_times, changes.time_ns]))
        kinds = np.zeros(len(at), dtype=np.int64)
        kinds[at.searchsorted(output_times)] = OUTPUT
        kinds[at.searchsorted(changes.time_ns)] |= CHANGE
        # By columns that lie together, which is faster.
        columns = tuple(np.ascontiguousarray(changes.held.T))
        held = HeldWrench(columns[:3], columns[3:6], columns[6:9], columns[9:])
        parts = in_principal_axes(self._body, held)
        rows = np.ascontiguousarray(np.concatenate(parts).T)
        return Edges(at, kinds, rows), known_ns

    def _outputs(self, first: int, until_ns: int) -> Whole:
        """Return the times of outputs from that of number `first` on, up to `until_ns`."""
        import numpy as np

        period, parts = self._period_ns
        behind = min(first + _MANY, until_ns * parts // period + 2)
        # Python's integers, where 64 bits do not suffice.
        kind = np.int64 if behind * 2 * period < 2**62 else object
        numbers = np.arange(first, behind, dtype=np.int64).astype(kind)
        times = (2 * numbers * period + parts) // (2 * parts)
        return times[times <= until_ns].astype(np.int64)
