"""The scene of one run: the base scene with the inputs of the run, validated like any scene.

If the inertia is dispersed, each second moment of the mass, the integral of x_k^2 dm along principal axis k, is
multiplied by a positive factor, and the axes are rotated. Each moment I_k is the sum of two second moments, so every
sample is the inertia of a real body.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import RigidBodyError
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.document import Node
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, normalize
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.overrides import apply_overrides, find
from rb_dynamics.scene.read import parse_scene, rest_is_independent, scene_of
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.sampling import seed_of_run

INERTIA, ORIENTATION = "body.inertia", "initial.orientation"
FACTORS = tuple(f"{INERTIA}.second_moment[{i}]" for i in range(3))
AXES = tuple(f"{INERTIA}.turn[{i}]" for i in range(3))
TURNS = tuple(f"{ORIENTATION}.turn[{i}]" for i in range(3))
ANYHOW = tuple(f"{ORIENTATION}.any[{i}]" for i in range(3))
_NUMBERS = {"seed", "body.mass", "body.center_of_mass", INERTIA, ORIENTATION}
_ELEMENT = re.compile(
    r"(body\.center_of_mass|initial\.(?:position_world|linear_velocity_world|angular_velocity_body))\[([0-2])\]"
)


class Scenes:
    """Makes the scenes of the runs of one campaign; reads base and inputs once."""

    def __init__(self, campaign: Campaign) -> None:
        """Read the base scene.

        Raises:
            SceneError: the base scene is not valid.
        """
        problems = Problems(campaign.source)
        self._campaign = campaign
        self._tree = document.parse(campaign.scene_text, problems)
        self.base = scene_of(_copy(self._tree), problems, campaign.scene_text)
        self._keys = {each.name for each in campaign.inputs if not each.whole and not each.name.startswith("control.")}
        self._wholes = {each.whole for each in campaign.inputs}
        stated = any(find(self._tree, f"{INERTIA}.{form}") for form in ("matrix", "diagonal", "principal"))
        # Whether a run with other numbers of body and initial state need not be read.
        self._is_known = (
            rest_is_independent(self.base)
            and (stated or INERTIA in self._wholes)
            and find(self._tree, "initial.linear_velocity_body") is None
        )

    def scene(self, values: Mapping[str, float], run: int = 0) -> Scene:
        """Return the scene of a run with these inputs, without its text.

        Raises:
            SceneError: the scene is not valid with these inputs.
        """
        changes = self.overrides(values, run)
        if self._is_known and (found := self._changed(changes)):
            return found
        problems, tree = Problems(self._campaign.source), _copy(self._tree)
        apply_overrides(tree, changes, problems)
        return scene_of(tree, problems, "")

    def _changed(self, changes: Mapping[str, Any]) -> Scene | None:
        """Return the base scene with these numbers, without its text; None if others change, or it is not valid."""
        base, found = self.base, dict[str, Any]()
        for key, value in changes.items():
            if key in _NUMBERS:
                found[key] = value
            elif element := _element(key):
                whole, part, name, k = element
                vector = found.get(whole, getattr(getattr(base, part), name))
                found[whole] = (*vector[:k], value, *vector[k + 1 :])
            else:
                return None
        mass, center = (found.pop(key, getattr(base.body, key[5:])) for key in ("body.mass", "body.center_of_mass"))
        inertia, seed = found.pop(INERTIA, None), found.pop("seed", base.seed)
        if ORIENTATION in found:
            found["initial.orientation_xyzw"] = tuple(found.pop(ORIENTATION).values())
        try:
            if inertia is None:
                body = replace(base.body, mass=mass, center_of_mass=center)
            else:
                moments, axes = inertia["principal"].values()
                body = RigidBody.from_principal(mass, moments, tuple(axes.values()), center)
            initial = replace(base.initial, **{key.removeprefix("initial."): vector for key, vector in found.items()})
            return base.with_numbers(body, initial, seed)
        except (RigidBodyError, ValueError):
            return None

    def whole(self, values: Mapping[str, float], run: int = 0) -> Scene:
        """Return the scene of a run with these inputs, with its complete text.

        Raises:
            SceneError: the scene is not valid with these inputs.
        """
        return parse_scene(self._campaign.scene_text, self._campaign.source, self.overrides(values, run))

    def overrides(self, values: Mapping[str, float], run: int = 0) -> dict[str, object]:
        """Return the changes to the base scene for a run with these inputs, by dotted key."""
        changes: dict[str, object] = {}
        if INERTIA in self._wholes:
            # Some forms of inertia also define the mass and its centre.
            changes["body.mass"] = self.base.body.mass
            changes["body.center_of_mass"] = self.base.body.center_of_mass
            changes[INERTIA] = self._inertia(values)
        if ORIENTATION in self._wholes:
            changes[ORIENTATION] = dict(zip("xyzw", self._orientation(values), strict=True))
        if self.base.sensors:
            # Each run has noise of its own.
            changes["seed"] = seed_of_run(self._campaign.seed, run)
        return changes | {key: values[key] for key in values if key in self._keys}

    def _inertia(self, values: Mapping[str, float]) -> dict[str, object]:
        body = self.base.body
        total = 0.5 * math.fsum(body.principal_moments)
        # A plate has a second moment of 0, which rounding may make negative.
        a, b, c = (
            max(0.0, total - moment) * values[name]
            for moment, name in zip(body.principal_moments, FACTORS, strict=True)
        )
        axes = multiply(_turn(values, AXES), body.principal_orientation_xyzw)
        return {
            "principal": {
                "moments": (b + c, a + c, a + b),
                "orientation": dict(zip("xyzw", normalize(axes), strict=True)),
            }
        }

    def _orientation(self, values: Mapping[str, float]) -> Quaternion:
        if ANYHOW[0] in values:
            return any_attitude(*(values[name] for name in ANYHOW))
        return normalize(multiply(self.base.initial.orientation_xyzw, _turn(values, TURNS)))


@lru_cache(maxsize=4)
def scenes_of(campaign: Campaign) -> Scenes:
    """Return the `Scenes` of `campaign`, read once per process."""
    return Scenes(campaign)


@cache
def _element(key: str) -> tuple[str, str, str, int] | None:
    """Return key, part, name and place of a component of a vector; None for any other key."""
    match = _ELEMENT.fullmatch(key)
    return match and (match[1], *match[1].split("."), int(match[2]))


def any_attitude(u: float, v: float, w: float) -> Quaternion:
    """Return an attitude; uniformly distributed over all attitudes if u, v, w are uniform from 0 to 1.

    Shoemake, Uniform random rotations, Graphics Gems III (1992) 124.
    """
    a, b = math.sqrt(1.0 - u), math.sqrt(u)
    first, second = 2.0 * math.pi * v, 2.0 * math.pi * w
    return normalize((a * math.sin(first), a * math.cos(first), b * math.sin(second), b * math.cos(second)))


def _turn(values: Mapping[str, float], names: Sequence[str]) -> Quaternion:
    """Return the rotation by the vector with these names, rad."""
    x, y, z = (values[name] for name in names)
    return exp((x, y, z))


def _copy(node: Node) -> Node:
    value = node.value
    if isinstance(value, dict):
        value = {key: _copy(item) for key, item in value.items()}
    elif isinstance(value, list):
        value = [_copy(item) for item in value]
    return Node(value, node.line, node.key_line, node.text, node.quoted)
