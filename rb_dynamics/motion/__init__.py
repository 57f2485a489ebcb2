"""Motion of a body: the methods by name, and step control.

A new method is a file with one `Method` and an entry here; in another package it is a plug-in.
"""

from __future__ import annotations

from collections.abc import Sequence

from rb_dynamics.errors import did_you_mean
from rb_dynamics.motion.closed_form import EXACT
from rb_dynamics.motion.commutator_free import CF4
from rb_dynamics.motion.composition import MIDPOINT4, MIDPOINT6
from rb_dynamics.motion.dop853 import DOP853
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.motion.midpoint import MIDPOINT
from rb_dynamics.motion.moser_veselov import DMV82, DMV104, DMV864
from rb_dynamics.motion.radau import RADAU
from rb_dynamics.motion.rk4 import RK4
from rb_dynamics.motion.rkmk import RKMK4, RKMK54
from rb_dynamics.motion.rotation_splitting import DLM2, DLM4, DLM6
from rb_dynamics.motion.semi_implicit_euler import EULER
from rb_dynamics.motion.splitting import STRANG2, STRANG6
from rb_dynamics.motion.taylor import TAYLOR
from rb_dynamics.motion.verner import DVERK
from rb_dynamics.plugins import Registry

_ALL = (
    *(EXACT, TAYLOR, STRANG2, STRANG6),
    *(DMV82, DMV864, DMV104),
    *(DLM2, DLM4, DLM6),
    *(MIDPOINT, MIDPOINT4, MIDPOINT6),
    *(RKMK4, RKMK54, CF4),
    *(RK4, DVERK, DOP853, RADAU, EULER),
)


def _fault(name: str, found: object) -> str:
    if not isinstance(found, Method):
        return f"{found!r}, expected a rb_dynamics.motion.Method"
    if found.name != name:
        return f"a method named {found.name!r}, expected {name!r}, the name of its entry point"
    # The kernel cache identifies a step by the sources of this package and the name of its method.
    if found.compiles:
        return "a method that compiles, expected compiles=False: only steps of rb_dynamics are compiled"
    return ""


METHODS: Registry[Method] = Registry("method", {method.name: method for method in _ALL}, _fault)

REMOVED = dict.fromkeys(("strang4", "aba82", "aba84", "aba104", "aba864"), "dmv104, or strang6 for a slender body")
"""Replacements for removed methods."""


def remedy(name: object, known: Sequence[str], otherwise: str) -> str:
    """Return the remedy for an error message about the unknown `name`."""
    text = str(name).lower()[:60]
    if text in REMOVED:
        return f"{text} was removed; take {REMOVED[text]}"
    return did_you_mean(text, known, otherwise)


__all__ = ["METHODS", "REMOVED", "Increment", "Inertia", "Method", "remedy"]
