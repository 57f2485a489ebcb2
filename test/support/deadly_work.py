"""Work on logs that ends its process, for tests of what is done with many: a process of its own imports it."""

from __future__ import annotations

import os

from rb_dynamics.cli.many_logs import PASSED, Row


def deadly(log: str) -> Row:
    """End the process for one log, as the system does where memory is short."""
    if log == "b":
        os._exit(1)
    if log == "c":
        raise MemoryError("too large")
    return Row(log, PASSED, "")
