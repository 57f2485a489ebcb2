"""Read the `effects` section of a scene: loads other than commanded wrenches. Each type reads its own values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import PluginError, SceneError, did_you_mean
from rb_dynamics.formats.yaml.fields import Field
from rb_dynamics.formats.yaml.problems import printable
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.scene_entry import SceneEntry
from rb_dynamics.loads.wrench import WrenchFrames

T = TypeVar("T")
E = TypeVar("E")


def effects(field: Field | None, body: RigidBody | None, frames: WrenchFrames) -> tuple[Effect, ...]:
    """Return the effects in the order of the scene, empty if the section is absent; records problems."""

    def read(kind: type[Effect], entry: Field) -> Effect:
        effect = kind.read(SceneEntry(entry.section(("type", *kind.keys)), body, frames))
        if body is not None:
            CombinedEffects(body, (effect,))
        return effect

    example = "{type: uniform_gravity, ...}"
    return each_entry(field, EFFECTS, "an effect", example, "that can act on this body", read)


def each_entry(
    field: Field | None,
    kinds: Mapping[str, type[T]],
    what: str,
    example: str,
    expected: str,
    read: Callable[[type[T], Field], E],
) -> tuple[E, ...]:
    """Return what `read` makes of each entry of a list, empty if the list is absent; records problems.

    `what` names an entry, with its article. If `read` raises a SceneError, the entry is rejected as not `expected`.
    """
    if field is None:
        return ()
    found = []
    for entry in field.items(f"a list of {what.split()[1]}s", f"write a list such as [{example}], or []"):
        kind, before = _kind_of(entry, kinds, what), entry.problems.count
        if kind is not None:
            try:
                found.append(read(kind, entry))
            except SceneError as error:
                if entry.problems.count == before:
                    entry.reject(f"{what} {expected}", str(error))
    return tuple(found)


def _kind_of(entry: Field, kinds: Mapping[str, type[T]], what: str) -> type[T] | None:
    """Return the class that the `type` of an entry of a list names; None, after a problem, where it names none."""
    values = entry.node.value
    node = values.get("type") if isinstance(values, dict) else None
    if node is None:
        entry.reject("a mapping with the key type", f"write {{type: ...}} with one of {', '.join(kinds)}")
        return None
    name = node.value if isinstance(node.value, str) else ""
    named = Field(node, f"{entry.key}.type", entry.problems)
    try:
        if name in kinds:
            return kinds[name]
    except PluginError as error:
        named.reject(f"{what} that can be loaded", str(error))
        return None
    remedy = did_you_mean(printable(name), kinds, "write one of them, or remove the entry")
    named.reject(f"one of {', '.join(kinds)}", remedy)
    return None
