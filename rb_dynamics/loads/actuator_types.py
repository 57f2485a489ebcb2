"""All actuators that a scene can list, by their `type`. A new one is a file with one `Actuator` and an entry here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.magnetorquer import Magnetorquer
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster

_ALL: tuple[type[Actuator], ...] = (ReactionWheel, Thruster, Magnetorquer)

ACTUATORS: Mapping[str, type[Actuator]] = MappingProxyType({actuator.kind: actuator for actuator in _ALL})
"""By the name of their type."""
