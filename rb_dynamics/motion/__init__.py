"""How a body moves: the methods, by name, and the control of their step.

A new method is one file with one `Method` and one entry here.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.midpoint import MIDPOINT
from rb_dynamics.motion.rk4 import RK4
from rb_dynamics.motion.rkmk import RKMK4

METHODS: Mapping[str, Method] = MappingProxyType({m.name: m for m in (RKMK4, MIDPOINT, RK4)})

__all__ = ["METHODS", "Increment", "Inertia", "Method"]
