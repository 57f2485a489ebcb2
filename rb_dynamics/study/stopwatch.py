"""`Stopwatch`: measures run times without the time that kernels take to compile or load.

Whether a kernel is used is decided in `motion/fixed_step_kernel.py`, from the counts made here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Literal

from rb_dynamics.motion.fixed_step_kernel import Tally

Clock = Callable[[], float]
"""Returns the time in s; only differences count."""


class Stopwatch:
    """A clock that stands still while kernels are compiled or loaded.

    Attributes:
        kernels: time (s) that this took, by the name of the kernel.
    """

    def __init__(
        self,
        clock: Clock = time.perf_counter,
        room: float = math.inf,
        compiling: Callable[[str], None] | None = None,
    ) -> None:
        """Measure with `clock`; compile nothing more after `room` s of compiling, and call `compiling` before each."""
        self.kernels: dict[str, float] = {}
        self._clock, self._room, self._compiling = clock, room, compiling

    def __call__(self) -> float:
        """Return the time (s), without compiling and loading."""
        return self._clock() - math.fsum(self.kernels.values())

    def tally(self, scale: float = 1.0, *, none: bool = False, missing: Literal["here", "plain"] = "here") -> Tally:
        """Return a tally that records here what is compiled or loaded."""
        none = none or math.fsum(self.kernels.values()) >= self._room
        return Tally(scale, self._clock, self.kernels, self._compiling, missing, none=none)
