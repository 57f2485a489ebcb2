"""`Model`: what the sensors of all flights should have measured for given parameters, and its exact derivatives."""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from operator import methodcaller
from typing import Any, NamedTuple, cast

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.flights import (
    ACCELERATION,
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    WrenchSeries,
)
from rb_dynamics.analysis.identification.parameters import InertiaParameters, Layout, ParameterBlock, rows_of
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.analysis.wheel_speeds import WheelSpeeds
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import BodyError, SceneError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect, Point
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import WORLD, Wrench
from rb_dynamics.motion.variational_equations import BODY, COLUMN, HELD, LANES, STATE, kernel, plain
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.scene.model import Scene

DIFFERENTIATED = (UniformGravity, LinearDrag, QuadraticDrag, Rotor, ScheduledWrench)
"""Effects whose derivatives are exact; those of others come from differences of their loads."""

# Where the coefficients of an effect stand in the numbers of the body.
_PLACES = {
    (LinearDrag, "rotation"): 7,
    (LinearDrag, "translation"): 10,
    (QuadraticDrag, "rotation"): 13,
    (QuadraticDrag, "translation"): 16,
    (LinearDrag, "medium_velocity_world"): 19,
    (QuadraticDrag, "medium_velocity_world"): 22,
    (UniformGravity, "acceleration_world"): 25,
}
_ROTOR = ("axis_body", "axial_inertia", "spin_rate")
# In place of these three, all that the motion depends on.
_MOMENTUM = "momentum_body"
_SCHEDULED = re.compile(r"schedule\[([0-9]{1,6})\]\.(force|torque)")

# How often a flight is predicted in a fit, at least.
_CALLS = 20

# No motion has numbers as large, and their products still are some.
_LOST = 1e150

NODE = "state"
"""Kind of a stream of one row: the state (STATE,) in which the next segment of a flight begins; see `restarted`."""

DRAWN = 16
"""Ways in which wheels may have turned, between samples of their speeds or by the noise of these, drawn at random."""

# Of the plausible, by how much a number is moved for a difference.
_MOVED = 1e-6

# rad that a body turns in a step, at first; halved where the error of the steps counts.
TURN = 0.06

# Intervals that are computed at a time: their derivatives stay in the cache of the processor.
_BLOCK = 2048


class Predicted(NamedTuple):
    """What a stream should have measured, compared with what it did measure.

    Attributes:
        key: topic, kind, and number of the flight: noise is that of a sensor in a flight.
        left: (n, 3), predicted less measured; of an attitude the turn between the two.
        by: (n, 3, p), derivatives of `left`; (n, 3, 0) where they were not asked for.
        time_ns: (n,), of the samples.
        measured: (n, 3), of an attitude (n, 4).
    """

    key: tuple[str, str, int]
    left: Array
    by: Array
    time_ns: Times
    measured: Array

    @property
    def flight(self) -> int:
        """The number of the flight."""
        return self.key[2]

    def without_derivatives(self) -> Predicted:
        """Return the same without `by`."""
        return self._replace(by=np.empty((*self.left.shape, 0)))


@dataclass(frozen=True)
class Body:
    """The body of a fit; see `RigidBody`."""

    mass: float
    center_of_mass: Array
    inertia: Array


@dataclass(frozen=True)
class InitialEstimate:
    """State of the body origin at the first sample of a flight, roughly, and of what order its motion is."""

    attitude: Array
    rate: Array
    position: Array
    velocity: Array
    fastest: float
    extent: float


class Model:
    """The flights of a body.

    Attributes:
        layout: where the parameters are.
    """

    def __init__(self, scene: Scene, flights: Sequence[Flight], fit: Sequence[str], like: Body | None = None) -> None:
        """Lay out the parameters that `fit` names; effects are of a size that moves a body `like` that.

        Raises:
            SceneError: an effect of the scene is not modelled here, or `fit` names what the scene does not have.
        """
        self.scene, self.fit = scene, tuple(fit)
        # Where an accelerometer sits and how far it is off must be fitted for it to be of use.
        unused = () if "accelerometer" in fit else (ACCELERATION,)
        self.flights = tuple(flight.without(unused) for flight in flights)
        self.others = [
            i
            for i, effect in enumerate(scene.effects)
            if type(effect) not in DIFFERENTIATED and effect.wrenching(scene.body, 0.0) is not None
        ]
        self._require_modelled()
        self.inertia = InertiaParameters(scene.body)
        self._like = like or Body(scene.body.mass, np.zeros(3), np.array(scene.body.inertia))
        self.starts = [_start(flight) for flight in self.flights]
        measured = [
            any(s.kind in (POSITION, VELOCITY) or (s.kind == ACCELERATION and self._drags) for s in flight.streams)
            for flight in self.flights
        ]
        self.moves = [bool(self.others) or each for each in measured]
        # Other effects depend on position and velocity. Where nothing measures these, an orbit is that of the scene:
        # its gravity gradient tells so little of it that in a fit it would take up errors of the inertia. But the scene
        # does not say where the body is when a later piece of a recording begins.
        fields = [each for i in self.others for each in (scene.effects[i].gravity(), scene.effects[i].magnetic_field())]
        orbits, begun = any(each is not None for each in fields), [flight.name for flight in self.flights]
        self.placed = [
            measured[k] or (self.moves[k] and (not orbits or flight.name in begun[:k]))
            for k, flight in enumerate(self.flights)
        ]
        if self.others:
            self.starts = [
                self._with_initial(start, flight) for start, flight in zip(self.starts, self.flights, strict=True)
            ]
        self.turn = TURN
        self.layout = Layout()
        self._held_from = 0
        self._lay_out()

    def body(self, z: Array) -> Body:
        """Return the body that parameters stand for."""
        mass = self.scene.body.mass
        if "mass" in self.layout:
            with np.errstate(over="ignore"):
                mass *= float(np.exp(z[self.layout["mass"].at][0]))
        center = self.layout.values("center_of_mass", z, np.array(self.scene.body.center_of_mass))
        return Body(mass, center, rows_of(self.inertia.derivative(*self.size_and_shape(z))[0]))

    def size_and_shape(self, z: Array) -> tuple[float, Array]:
        """Return the parameters of the inertia; zeros where it is not fitted."""
        if "shape" not in self.layout:
            return 0.0, np.zeros(5)
        return float(z[self.layout["size"].at][0]), z[self.layout["shape"].at]

    @property
    def arm(self) -> float:
        """The radius of gyration of the body of the scene about its centre, m."""
        body = self.scene.body
        return float(np.sqrt(np.trace(np.array(body.inertia)) / 2.0 / body.mass))

    def predict(self, z: Array, end_ns: Sequence[int] | None = None, derivatives: bool = True) -> Iterator[Predicted]:
        """Yield what each stream should have measured, up to `end_ns` of each flight."""
        for _, blocks in itertools.groupby(self.blocks(z, end_ns, derivatives), lambda block: block[0].flight):
            for parts in zip(*blocks, strict=True):
                left, by, time_ns, measured = (
                    parts[0][k] if len(parts) == 1 else np.concatenate([part[k] for part in parts]) for k in range(1, 5)
                )
                yield Predicted(parts[0].key, left, by, time_ns, measured)

    def blocks(
        self, z: Array, end_ns: Sequence[int] | None = None, derivatives: bool = True
    ) -> Iterator[list[Predicted]]:
        """Yield the same piece by piece: of each stream of a flight the samples in some intervals of its grid."""
        for number, flight in enumerate(self.flights):
            seen = flight if end_ns is None else flight.until(end_ns[number])
            yield from self.of_flight(z, number, seen, derivatives)

    def with_speeds(self, of: Callable[[WheelSpeeds], WheelSpeeds]) -> Model | None:
        """Return the same, with wheels that turn otherwise than recorded; None without wheels."""
        if all(flight.wheels is None for flight in self.flights):
            return None
        other = copy.copy(self)
        other.flights = tuple(
            replace(flight, wheels=of(flight.wheels)) if flight.wheels else flight for flight in self.flights
        )
        return other

    def with_curved_speeds(self, draw: np.random.Generator | None = None) -> Model | None:
        """Return the same, with wheels whose speeds are curved between samples as `draw` says; None without wheels."""
        return self.with_speeds(lambda wheels: wheels.curved(draw))

    def with_noisy_speeds(self) -> list[Model]:
        """Return the same with more noise in the speeds of wheels, see `WheelSpeeds.disturbed`; none without wheels."""
        others = (self.with_speeds(methodcaller("disturbed", number)) for number in range(DRAWN))
        return [other for other in others if other is not None]

    def with_commands(self, of: Callable[[WrenchSeries], WrenchSeries]) -> Model:
        """Return the same, with wrenches that acted otherwise than recorded."""
        other = copy.copy(self)
        other.flights = tuple(replace(each, channels=tuple(map(of, each.channels))) for each in self.flights)
        return other

    def with_drawn_speeds(self) -> list[Model]:
        """Return the same with wheels whose speeds are curved at random between samples; none without wheels."""
        draw = np.random.default_rng(0)
        others = (self.with_curved_speeds(draw) for _ in range(DRAWN))
        return [other for other in others if other is not None]

    def restarted(self, number: int, z: Array, state: Array) -> Model:
        """Return the same, in which a flight begins at the state (STATE,) of the centre of mass and not at its own."""
        other, layout = copy.copy(self), copy.copy(self.layout)
        matrix, center, rate = rotations.matrices(state[:4]), self.body(z).center_of_mass, state[4:7]
        # Of the body origin.
        position, velocity = state[7:10] - matrix @ center, state[10:13] - matrix @ np.cross(rate, center)
        start = replace(self.starts[number], attitude=state[:4], rate=rate, position=position, velocity=velocity)
        other.starts = [*self.starts[:number], start, *self.starts[number + 1 :]]
        layout.blocks = dict(layout.blocks)
        for name, value in (
            ("angular_velocity_body", rate), ("position_world", position), ("linear_velocity_world", velocity)
        ):  # fmt: skip
            if (key := f"initial[{number}].{name}") in layout:
                layout.blocks[key] = replace(layout[key], start=value)
        other.layout = layout
        return other

    def _with_initial(self, start: InitialEstimate, flight: Flight) -> InitialEstimate:
        """Return a start that has from the scene what the flight does not measure: other effects depend on it."""
        initial, kinds = self.scene.initial, {stream.kind for stream in flight.streams}
        if ATTITUDE not in kinds:
            start = replace(start, attitude=np.array(initial.orientation_xyzw))
        if not kinds & {POSITION, VELOCITY}:
            first, last = flight.span_ns
            velocity = np.array(initial.linear_velocity_world)
            extent = max(start.extent, float(np.linalg.norm(velocity)) * (last - first) / NANOSECONDS)
            start = replace(start, position=np.array(initial.position_world), velocity=velocity, extent=extent)
        return start

    @property
    def _drags(self) -> bool:
        return any(
            isinstance(e, (LinearDrag, QuadraticDrag))
            and (any(e.translation) or f"effects[{i}].translation" in self.fit)
            for i, e in enumerate(self.scene.effects)
        )

    def _require_modelled(self) -> None:
        source, left_out = self.scene.source, "derivatives of the motion do not know them"
        wheels = self.scene.wheels
        if others := ", ".join(sorted({name for flight in self.flights for name in flight.unknown})):
            raise SceneError(
                f"{source}: actuators: found commands to {others}, expected only wheels, and thrusters whose force is "
                "known throughout; cut the recording to before or after them, with convert --from or --to"
            )
        if shaking := ", ".join(wheel.name for wheel in wheels if not wheel.is_balanced):
            raise SceneError(
                f"{source}: actuators: found an imbalance of {shaking}, expected none, as {left_out}; remove it from "
                "the scene where it hardly counts"
            )
        if wheels and any(flight.wheels is None for flight in self.flights):
            raise SceneError(
                f"{source}: actuators: found {', '.join(wheel.name for wheel in wheels)}, expected none, as their "
                "speeds are not recorded; leave them out with --set actuators=[] if they stood still"
            )
        if biased := [channel.topic for channel in self.scene.channels if channel.bias is not None]:
            raise SceneError(
                f"{source}: wrenches: found a bias of {', '.join(biased)}, expected none, as {left_out}; write it as "
                "an effect of type scheduled_wrench"
            )
        if lagging := [channel.topic for channel in self.scene.channels if channel.lag]:
            raise SceneError(
                f"{source}: wrenches: found a lag of {', '.join(lagging)}, expected none, as commands are "
                "taken to act at once; leave it out where it hardly counts, or let identify fit delay"
            )
        kinds: list[type] = []
        for effect in self.scene.effects:
            if type(effect) not in DIFFERENTIATED and (effect.knots() or effect.schedule(self.scene.body)):
                raise SceneError(
                    f"{source}: effects: {effect.kind} holds wrenches, or begins or ends at a time, expected a load "
                    "without, as derivatives of the motion do not know these; remove it where it hardly acts, with "
                    "--set effects=[] or in the scene"
                )
            if type(effect) is not UniformGravity and effect.gravity() and "accelerometer" in self.fit:
                raise SceneError(
                    f"{source}: effects: {effect.kind} and an accelerometer that is fitted, expected uniform_gravity, "
                    "as only that is taken off what it measures; fit without accelerometer"
                )
            if isinstance(effect, (LinearDrag, QuadraticDrag)) and type(effect) in kinds:
                raise SceneError(f"{self.scene.source}: effects: found {effect.kind} twice, expected once; add them up")
            kinds.append(type(effect))

    def _lay_out(self) -> None:
        layout, body, arm = self.layout, self.scene.body, self.arm
        for number, start in enumerate(self.starts):
            name = f"initial[{number}]"
            layout.add(f"{name}.rotation", np.ones(3))
            layout.add(f"{name}.angular_velocity_body", np.full(3, start.fastest), start.rate)
            if self.placed[number]:
                layout.add(f"{name}.position_world", np.full(3, start.extent), start.position)
                speed = start.extent / max(1e-9, self.flights[number].seconds) + float(np.linalg.norm(start.velocity))
                layout.add(f"{name}.linear_velocity_world", np.full(3, speed), start.velocity)
        if "mass" in self.fit:
            layout.add("mass", [1.0])
        if "center_of_mass" in self.fit and not self._levers:
            layout.add("center_of_mass", np.full(3, arm), body.center_of_mass)
        if {"inertia", "inertia_ratios"} & set(self.fit):
            layout.add("size", [1.0])
            layout.add("shape", np.ones(5))
        self._lay_out_delays()
        self._lay_out_effects(arm)
        for number, flight in enumerate(self.flights):
            for stream in flight.streams:
                self._lay_out_sensor(number, stream, arm)

    def _lay_out_delays(self) -> None:
        layout = self.layout
        if "delay" in self.fit:
            if any(flight.channels for flight in self.flights):
                layout.add("delay.commands", [0.1])
            # One sensor is the clock.
            for topic in self._topics()[1:]:
                layout.add(f"delay.{topic}", [0.1])

    @property
    def _levers(self) -> bool:
        """Whether a force acts at a point of the body, so that its torque changes with the centre of mass."""
        rows = [channel.held for flight in self.flights for channel in flight.channels]
        rows += [found[1] for effect in self.scene.effects if (found := _scheduled(effect, self.scene))]
        for key in self.fit:
            if key.startswith("effects[") and isinstance((place := self._place(key))[0], ScheduledWrench):
                rows.append(_of_schedule(place[0], place[1], self.scene)[2])
        return any(each[:, 12:].any() for each in rows)

    def _lay_out_effects(self, arm: float) -> None:
        """Lay out effects and scales of wrenches; what changes what is held comes last."""
        layout, keys = self.layout, [key for key in self.fit if key.startswith("effects[")]
        for key in keys:
            if self._place(key)[2] != -1:
                self._add_effect(key)
        self._held_from = layout.count
        if "center_of_mass" in self.fit and self._levers:
            layout.add("center_of_mass", np.full(3, arm), self.scene.body.center_of_mass)
        for key in keys:
            if self._place(key)[2] == -1:
                self._add_effect(key)
        if "wrench_scale" in self.fit:
            for topic in sorted({channel.topic for flight in self.flights for channel in flight.channels}):
                layout.add(f"wrench_scale.{topic}", [1.0], [1.0])
        self._held_to = layout.count

    def _lay_out_sensor(self, number: int, stream: Stream, arm: float) -> None:
        """Lay out what one sensor of a flight adds; a bias is that of a flight, the rest of the sensor."""
        layout, sensor = self.layout, f"[{number}].{stream.topic}"
        of_rates = stream.gyro or not any(each.gyro for each in self.flights[number].streams)
        wanted: list[tuple[str, str, Array, Array]] = []
        if stream.kind == RATES and of_rates:
            fastest = np.full(3, self.starts[number].fastest)
            wanted += [
                ("gyro_bias", f"gyro_bias{sensor}", fastest, np.zeros(3)),
                ("gyro_scale", f"gyro_scale.{stream.topic}", np.ones(3), np.ones(3)),
                ("gyro_alignment", f"gyro_alignment.{stream.topic}", np.ones(3), np.zeros(3)),
            ]
        elif stream.kind == ACCELERATION:
            wanted += [
                ("accelerometer", f"accelerometer_bias{sensor}", np.full(3, 9.81), np.zeros(3)),
                ("accelerometer", f"accelerometer_position.{stream.topic}", np.full(3, arm), stream.place),
            ]
        for group, name, scale, start in wanted:
            if group in self.fit and name not in layout:
                layout.add(name, scale, start)

    def _topics(self) -> list[str]:
        return list(dict.fromkeys(stream.topic for flight in self.flights for stream in flight.streams))

    def _place(self, key: str) -> tuple[Effect, str, int]:
        """Return effect, name and place in the numbers of the body (-1: is held, -2: other effect) of a dotted key.

        Raises:
            SceneError: the scene has no such number.
        """
        number, _, name = key.removeprefix("effects[").partition("].")
        effects = self.scene.effects
        if number.isdecimal() and int(number) < len(effects):
            effect = effects[int(number)]
            if (type(effect), name) in _PLACES:
                return effect, name, _PLACES[type(effect), name]
            if isinstance(effect, Rotor) and (
                name in _ROTOR[:2] or (name in ("spin_rate", _MOMENTUM) and len(effect.spin_rate) == 1)
            ):
                others = [each for each in self.fit if each in {f"effects[{number}].{part}" for part in _ROTOR}]
                if name == _MOMENTUM and others:
                    raise SceneError(
                        f"{self.scene.source}: fit: found {key} and {', '.join(others)}, expected one or the other, as "
                        "momentum_body is axial_inertia times spin_rate along axis_body; leave one of them out"
                    )
                return effect, name, -1
            if int(number) in self.others and name in _numbers_of(effect):
                return effect, name, -2
            entry = _SCHEDULED.fullmatch(name)
            if isinstance(effect, ScheduledWrench) and entry and int(entry[1]) < len(effect.entries):
                return effect, name, -1
        known = [
            f"effects[{i}].{name}"
            for i, effect in enumerate(effects)
            for name in (
                [f"schedule[{k}].{kind}" for k in range(len(effect.entries)) for kind in ("force", "torque")]
                if isinstance(effect, ScheduledWrench)
                else (_numbers_of(effect) if i in self.others else (*effect.keys, _MOMENTUM))
            )
            if (type(effect), name) in _PLACES
            or i in self.others
            or (isinstance(effect, Rotor) and name in (*_ROTOR, _MOMENTUM))
            or isinstance(effect, ScheduledWrench)
        ]
        raise SceneError(
            f"{self.scene.source}: found {key!r} to be fitted, expected a number of an effect of the scene: "
            f"{', '.join(known) or 'it has none'}; add the effect to the scene, or correct the key"
        )

    def _add_effect(self, key: str) -> None:
        effect, name, place = self._place(key)
        if isinstance(effect, ScheduledWrench):
            value: Any = _of_schedule(effect, name, self.scene)[1]
        else:
            value = getattr(effect, name)
        start = np.array([value[0][1]] if name == "spin_rate" else np.atleast_1d(value), dtype=np.float64)
        if place == -2:
            self.layout.add(key, np.full(len(start), float(np.abs(start).max()) or 1.0), start)
            return
        body, start_of = self._like, self.starts[0]
        seconds = max(1e-9, *(flight.seconds for flight in self.flights))
        moment = float(np.linalg.eigvalsh(body.inertia)[-1])
        speed = start_of.extent / seconds + float(np.linalg.norm(start_of.velocity))
        scale = {
            "rotation": moment / seconds / (start_of.fastest if isinstance(effect, QuadraticDrag) else 1.0),
            "translation": body.mass / seconds,
            # It changes the motion by as much as there is of it.
            "torque": moment * start_of.fastest / seconds,
            "force": body.mass * speed / seconds,
            "axial_inertia": moment,
            _MOMENTUM: moment * start_of.fastest,
            "acceleration_world": 9.81,
            "axis_body": 1.0,
        }.get(name.rpartition(".")[2], max(1.0, float(np.abs(start).max())))
        self.layout.add(key, np.full(len(start), scale), start)

    def is_axis(self, name: str) -> bool:
        """Return whether a block is the axis of a rotor, of which only the direction counts."""
        number, _, key = name.removeprefix("effects[").partition("].")
        return key == "axis_body" and isinstance(self.scene.effects[int(number)], Rotor)

    def in_world(self, name: str) -> bool:
        """Return whether a block is a force or torque of a scheduled wrench in world axes."""
        effect, part, _ = self._place(name)
        return isinstance(effect, ScheduledWrench) and bool(_of_schedule(effect, part, self.scene)[2][:, 6:12].any())

    def effects(self, z: Array) -> dict[str, Array]:
        """Return the fitted numbers of effects by their dotted keys."""
        return {name: block.values(z) for name, block in self.layout.blocks.items() if name.startswith("effects[")}

    def _numbers(self, z: Array) -> tuple[Array, Array]:
        """Return the `BODY` numbers of the body and their derivatives by all parameters."""
        numbers, by = np.zeros(BODY), np.zeros((BODY, self.layout.count))
        body, layout = self.body(z), self.layout
        numbers[:6], by_six = self.inertia.derivative(*self.size_and_shape(z))
        if "shape" in layout:
            by[:6, layout["size"].at], by[:6, layout["shape"].at] = by_six[:, :1], by_six[:, 1:]
        numbers[6] = body.mass
        if "mass" in layout:
            by[6, layout["mass"].at] = body.mass
        for i, effect in enumerate(self.scene.effects):
            for (kind, name), place in _PLACES.items():
                if isinstance(effect, kind):
                    key = f"effects[{i}].{name}"
                    numbers[place : place + 3] += layout.values(key, z, np.array(getattr(effect, name)))
                    if key in layout:
                        by[place : place + 3, layout[key].at] = np.diag(layout[key].scale)
        return numbers, by

    def start_of(self, z: Array, number: int) -> tuple[Array, Array]:
        """Return the state of the centre of mass at the start of a flight and its columns by all parameters."""
        layout, start = self.layout, self.starts[number]
        state, by = np.zeros(STATE), np.zeros((COLUMN, layout.count))
        name = f"initial[{number}]"
        block = layout[f"{name}.rotation"]
        turn = block.values(z)
        state[:4] = rotations.products(start.attitude, rotations.quaternions(turn))
        by[:3, block.at] = rotations.right_jacobians(turn)
        block = layout[f"{name}.angular_velocity_body"]
        state[4:7] = rate = block.values(z)
        by[3:6, block.at] = np.diag(block.scale)
        if self.moves[number]:
            state[7:10], state[10:13] = start.position, start.velocity
            if self.placed[number]:
                block = layout[f"{name}.position_world"]
                state[7:10], by[6:9, block.at] = block.values(z), np.diag(block.scale)
                block = layout[f"{name}.linear_velocity_world"]
                state[10:13], by[9:12, block.at] = block.values(z), np.diag(block.scale)
            # From the body origin to the centre of mass, and how that changes.
            center, matrix = self.body(z).center_of_mass, rotations.matrices(state[:4])
            hat, spin = rotations.hats(center), rotations.hats(rate)
            state[7:10] += matrix @ center
            state[10:13] += matrix @ np.cross(rate, center)
            by[6:9] -= matrix @ hat @ by[:3]
            by[9:12] -= matrix @ (rotations.hats(spin @ center) @ by[:3] + hat @ by[3:6])
            if "center_of_mass" in layout:
                at = layout["center_of_mass"]
                by[6:9, at.at] += matrix * at.scale
                by[9:12, at.at] += matrix @ spin * at.scale
        return state, by

    def _delay_ns(self, z: Array, name: str) -> int:
        return round(float(self.layout.values(f"delay.{name}", z, np.zeros(1))[0]) * NANOSECONDS)

    def of_flight(
        self, z: Array, number: int, flight: Flight, derivatives: bool = True, begin_ns: int | None = None
    ) -> Iterator[list[Predicted]]:
        """Yield `blocks` of that flight, or of a segment of it that begins at `begin_ns`."""
        streams = [stream for stream in flight.streams if len(stream.time_ns)]
        if not streams:
            return
        times = [stream.time_ns - self._delay_ns(z, stream.topic) for stream in streams]
        slopes = any(stream.kind == ACCELERATION for stream in streams) or "delay" in self.fit
        begin = flight.span_ns[0] if begin_ns is None else begin_ns
        acting = self._acting(z, flight)
        knots = _knots(acting, begin, times)
        starts = np.concatenate([[begin], knots[:-1]])
        count, lowest = len(knots), int(knots.argmin())
        rows = [lowest + np.searchsorted(knots[lowest:], at) for at in times]
        lengths = (knots - starts) / NANOSECONDS
        # Drag and other effects may vary faster than the body turns: then, too, shorter steps must show their error.
        varies = self.others or any(isinstance(each, LinearDrag | QuadraticDrag) for each in self.scene.effects)
        least = np.ceil(TURN / self.turn) if varies else 1
        steps = np.maximum(least, np.ceil(np.abs(lengths) * self.starts[number].fastest / self.turn)).astype(np.int64)
        numbers, by = self._numbers(z)
        inverse = _inverse(rows_of(numbers[:6])).ravel()
        moves = int(self.moves[number] or slopes)
        state, columns = self.start_of(z, number)
        mine = self._columns(number) if derivatives else np.zeros(0, dtype=np.int64)
        others = self._other_effects(z)
        if others is None:
            numbers[:] = np.nan
        advance, loads = self._others_acting(z, mine, others or CombinedEffects(self.scene.body), int(steps.sum()))
        columns = np.ascontiguousarray(columns[: COLUMN if moves else 6, mine])
        places = -(-len(mine) // LANES) * LANES
        body_by = np.zeros((BODY, places))
        body_by[:, : len(mine)] = by[:, mine]
        work = np.empty((4, STATE)), np.zeros((4, len(columns), places)), np.zeros((HELD, places))
        # The jerk of an accelerometer is taken between its samples.
        size = count if any(stream.kind == ACCELERATION for stream in streams) else _BLOCK
        for first in range(0, count, size):
            # With the interval before, as a command between the two belongs to both.
            these = slice(max(0, first - 1), min(count, first + size))
            n = these.stop - these.start
            held, held_by, commanded = self._held(z, acting, starts[these], knots[these])
            seen = _Seen(
                np.empty((n, STATE)),
                np.empty((n, *columns.shape)),
                np.empty((n if slopes else 0, STATE)),
                np.empty((n if slopes else 0, *columns.shape)),
                np.cumsum(np.diff(held[:, :12], axis=0, prepend=held[:1, :12]).any(axis=1), dtype=np.float64),
            )
            late = -1
            if derivatives and "delay.commands" in self.layout:
                late = int(np.flatnonzero(mine == self.layout["delay.commands"].at.start)[0])
            if not derivatives:
                held_by = held_by[:1, :, :0]
            shifts = np.where(commanded, late, -1)
            going_on = first - these.start
            with np.errstate(all="ignore"):
                advance(
                    state, columns, numbers, inverse, body_by, held, held_by, loads, lengths[these], steps[these],
                    shifts, going_on, moves, *work, *seen[:4]
                )  # fmt: skip
            state, columns = seen.states[-1].copy(), seen.columns[-1].copy()
            seen = _Seen(*(part[going_on:] for part in seen))
            for part in seen:
                # Do not compute with numbers of a diverging motion: their products are not finite.
                if not (part.max(initial=0.0) < _LOST and part.min(initial=0.0) > -_LOST):
                    part[~(np.abs(part) < _LOST)] = np.nan
            if late >= 0:
                for part in (seen.columns, seen.slopes_by):
                    part[:, :, late] *= self.layout["delay.commands"].scale[0]
            yield [
                self._of_stream(z, number, stream, seen, at - first, mine)
                for stream, at in zip(streams, rows, strict=True)
            ]

    def _others_acting(
        self, z: Array, mine: Any, acting: CombinedEffects, steps: int
    ) -> tuple[Callable[..., None], Array]:
        """Return the kernel, and for it the other effects at the parameters and beside them; see `rates`.

        An effect that refuses a number is differentiated to the other side.
        """
        if not acting.effects:
            return kernel(steps, _CALLS), np.zeros((0, 0))
        advance = kernel(steps, _CALLS, acting.numbers(0.0, plugins=True))

        def row(slope: float, acting: CombinedEffects) -> list[Any]:
            load = (_at_a_point(acting),) if advance is plain else acting.numbers(0.0, plugins=True) or ()
            return [slope, *acting.body.principal_orientation_xyzw, *load]

        rows = [row(1.0, acting)]
        counted = [block.at for name, block in self.layout.blocks.items() if self._changes_others(name)]
        for k in mine.tolist():
            sides: list[CombinedEffects | None] = []
            if any(at.start <= k < at.stop for at in counted):
                sides = [self._other_effects(z + side * (np.arange(len(z)) == k)) for side in (_MOVED, -_MOVED)]
            slope = 1.0 / (_MOVED * max(1, sum(each is not None for each in sides))) if any(sides) else 0.0
            rows += [row(slope, each or acting) for each in sides or (None, None)]
        return advance, np.array(rows, dtype=object if advance is plain else np.float64)

    def _changes_others(self, name: str) -> bool:
        number, _, _ = name.removeprefix("effects[").partition("]")
        body = name in ("mass", "center_of_mass", "size", "shape")
        return body or (name.startswith("effects[") and int(number) in self.others)

    def _other_effects(self, z: Array) -> CombinedEffects | None:
        """Return the other effects at parameters; None where one refuses its numbers."""
        if not self.others:
            return CombinedEffects(self.scene.body)
        body, effects = self.body(z), list(self.scene.effects)
        try:
            for name, values in self.effects(z).items():
                number, _, key = name.removeprefix("effects[").partition("].")
                i = int(number)
                if i in self.others:
                    value = tuple(values.tolist()) if isinstance(getattr(effects[i], key), tuple) else float(values[0])
                    effects[i] = replace(cast(Any, effects[i]), **{key: value})
            rigid = RigidBody.from_matrix(body.mass, body.inertia.tolist(), tuple(body.center_of_mass.tolist()))
            return CombinedEffects(rigid, tuple(effects[i] for i in self.others), self.scene.frames)
        except (BodyError, SceneError):
            return None

    def _of_stream(self, z: Array, number: int, stream: Stream, seen: _Seen, rows: Any, mine: Any) -> Predicted:
        """Return what a stream should have measured at those of the ascending `rows` which are in a block."""
        of = slice(*np.searchsorted(rows, [0, len(seen.states)]).tolist())
        part = stream.rows(of)
        at = _span(rows[of])
        here = _Seen(*(each[at] if len(each) else each for each in seen))
        left, by = self._against(z, number, part, here, _span(mine))
        found = Predicted((stream.topic, stream.kind, number), left, by, part.time_ns, part.values)
        return found if len(mine) else found.without_derivatives()

    def _columns(self, number: int) -> Array:
        """Return which parameters change the motion of a flight; those that change what is held come last."""
        own = f"initial[{number}]"
        taken = [
            np.arange(block.at.start, block.at.stop)
            for name, block in self.layout.blocks.items()
            if block.at.start < self._held_to and (name.startswith(own + ".") or not name.startswith("initial["))
        ]
        found: Array = np.concatenate(taken)
        return found

    def grid(self, z: Array, flight: Flight, begin: int, times: Times) -> tuple[Times, Array]:
        """Return the ends of intervals in which what is held stays, and what that is: with an edge at each of `times`.

        From `begin` they go down to the earliest time, at which a sensor that lags may have measured, and then up.
        """
        acting = self._acting(z, flight)
        knots = _knots(acting, begin, [times])
        return knots, self._held(z, acting, np.concatenate([[begin], knots[:-1]]), knots)[0]

    def _acting(self, z: Array, flight: Flight) -> _Acting:
        late = self._delay_ns(z, "commands")
        none: list[tuple[int, ParameterBlock, Array]] = []
        channels = [(c.time_ns + late, c.held, c.topic, none) for c in flight.channels]
        channels += [(*found, "", fits) for found, fits in self._schedules(z)]
        turning = [
            _Turning(
                f"effects[{i}]",
                effect.axis_body,
                effect.axial_inertia,
                np.array([nanoseconds(at) for at, _ in effect.spin_rate], dtype=np.int64),
                np.array([rate for _, rate in effect.spin_rate]),
            )
            for i, effect in enumerate(self.scene.effects)
            if isinstance(effect, Rotor)
        ]
        if flight.wheels is not None:
            turning += [
                _Turning(f"actuators.{wheel.name}", wheel.axis, wheel.inertia, flight.wheels.time_ns, speeds)
                for wheel, speeds in zip(self.scene.wheels, flight.wheels.speeds.T, strict=True)
            ]
        return _Acting(channels, turning)

    def _held(self, z: Array, acting_on: _Acting, starts: Times, knots: Times) -> tuple[Array, Array, Array]:
        """Return what is held from `starts` to `knots`, how it changes, and whether a command begins an interval."""
        held = np.zeros((len(knots), HELD))
        m = self._held_to - self._held_from
        held_by = np.zeros((len(knots) if m else 1, HELD, m))
        commanded = np.zeros(len(knots), dtype=bool)
        still = starts == knots
        # From the centre of mass of the scene, for which torques were computed: (p - c) x f.
        moved = self.body(z).center_of_mass - np.array(self.scene.body.center_of_mass)
        for at, rows, topic, fits in acting_on.channels:
            row = np.searchsorted(at, np.minimum(starts, knots), side="right") - 1
            if topic:
                commanded |= np.isin(starts, at)
                row[still] = np.searchsorted(at, starts[still], side="left") - 1
            acting = np.where((row >= 0)[:, None], rows[row], 0.0)
            acting, at_point = acting[:, :12], acting[:, 12:]
            acting[:, 3:6] -= np.cross(moved, at_point)
            name, factor = f"wrench_scale.{topic}", 1.0
            if name in self.layout:
                block = self.layout[name]
                held_by[:, :12, self._place_of_held(block).start] = acting * block.scale
                factor = block.values(z)[0]
            held[:, :12] += factor * acting
            if "center_of_mass" in self.layout and at_point.any():
                block = self.layout["center_of_mass"]
                held_by[:, 3:6, self._place_of_held(block)] += factor * rotations.hats(at_point) * block.scale
            for k, block, unit in fits:
                by = unit[:, :12].copy()
                by[:, 3:6] -= np.cross(moved, unit[:, 12:])
                held_by[row == k, :12, self._place_of_held(block)] = by.T * block.scale
        seconds = starts / NANOSECONDS
        held[:, 18] = seconds
        for rotor in acting_on.rotors:
            self._add_rotor(z, rotor, seconds, knots, held, held_by)
        return held, held_by, commanded

    def _place_of_held(self, block: ParameterBlock) -> slice:
        """Return where a block is among those that change what is held."""
        return slice(block.at.start - self._held_from, block.at.stop - self._held_from)

    def _schedules(self, z: Array) -> Iterator[tuple[tuple[Times, Array], list[tuple[int, ParameterBlock, Array]]]]:
        """Yield scheduled wrenches as they are fitted; and which row changes with what block by how much, per axis."""
        for i, effect in enumerate(self.scene.effects):
            if found := _scheduled(effect, self.scene):
                times, rows = found
                fits = []
                for name, block in self.layout.blocks.items():
                    if name.startswith(f"effects[{i}].") and isinstance(effect, ScheduledWrench):
                        k, start, unit = _of_schedule(effect, name.partition("].")[2], self.scene)
                        rows[k] += (block.values(z) - start) @ unit
                        fits.append((k, block, unit))
                yield (times, rows), fits

    def _add_rotor(self, z: Array, rotor: _Turning, seconds: Array, knots: Times, held: Array, held_by: Array) -> None:
        """Add the momentum of a rotor and its rate to each interval."""

        def value(name: str, given: Array) -> Array:
            return self.layout.values(f"{rotor.key}.{name}", z, given)

        momentum = self.layout.blocks.get(f"{rotor.key}.{_MOMENTUM}")
        if momentum is not None:
            held[:, 12:15] += momentum.values(z)
            held_by[:, 12:15, self._place_of_held(momentum)] = np.diag(momentum.scale)
            return
        direction = value("axis_body", np.array(rotor.axis_body))
        length = float(np.linalg.norm(direction))
        axis = direction / length
        inertia = float(value("axial_inertia", np.array([rotor.axial_inertia]))[0])
        at, spin = rotor.time_ns / NANOSECONDS, rotor.spin_rate
        spin = value("spin_rate", spin) if len(spin) == 1 else spin
        begin, end = np.interp(seconds, at, spin), np.interp(knots / NANOSECONDS, at, spin)
        span = knots / NANOSECONDS - seconds
        slope = np.divide(end - begin, span, out=np.zeros_like(span), where=span != 0.0)
        unit = np.concatenate([begin[:, None] * axis, slope[:, None] * axis], axis=1)
        held[:, 12:18] += inertia * unit
        across = (np.eye(3) - np.outer(axis, axis)) / length
        turned = np.concatenate([begin[:, None, None] * across, slope[:, None, None] * across], axis=1)
        for name, by in (
            ("axial_inertia", unit[:, :, None]),
            ("spin_rate", inertia * np.concatenate([axis, np.zeros(3)])[None, :, None]),
            ("axis_body", inertia * turned),
        ):
            key = f"{rotor.key}.{name}"
            if key in self.layout:
                block = self.layout[key]
                held_by[:, 12:18, self._place_of_held(block)] = by * block.scale

    def _against(self, z: Array, number: int, stream: Stream, seen: _Seen, mine: Any) -> tuple[Array, Array]:
        """Return predicted less measured of a stream, and its derivatives by all parameters."""
        layout = self.layout
        by = np.zeros((len(seen.states), 3, layout.count))
        attitude, rate = seen.states[:, :4], seen.states[:, 4:7]
        matrix = rotations.matrices(attitude)
        turn, spin, shift, speed = (seen.columns[:, 3 * k : 3 * k + 3] for k in range(4))
        center = self.body(z).center_of_mass
        of_center = layout.blocks.get("center_of_mass")
        delay = f"delay.{stream.topic}"
        if stream.kind == NODE:
            of = 3 * (4 if self.moves[number] else 2)
            turned = rotations.between(stream.values[:, :4], attitude)
            left = np.hstack([turned, seen.states[:, 4 : of + 1] - stream.values[:, 4 : of + 1]])
            columns = seen.columns[:, :of].copy()
            columns[:, :3] = np.linalg.inv(rotations.right_jacobians(turned)) @ columns[:, :3]
            by = np.zeros((len(left), of, layout.count))
            by[:, :, mine] = columns
            return left, by
        if stream.kind == ATTITUDE:
            left = rotations.between(stream.values, attitude)
            inverse = np.linalg.inv(rotations.right_jacobians(left))
            by[:, :, mine] = inverse @ turn
            change = inverse @ rate[:, :, None]
        elif stream.kind == POSITION:
            left = seen.states[:, 7:10] - matrix @ center - stream.values
            by[:, :, mine] = shift + matrix @ rotations.hats(center) @ turn
            if of_center is not None:
                by[:, :, of_center.at] -= matrix * of_center.scale
            change = (seen.states[:, 10:13] - np.einsum("nij,nj->ni", matrix, np.cross(rate, center)))[:, :, None]
        elif stream.kind == VELOCITY:
            arm, swept = rotations.hats(center), np.cross(rate, center)
            inward = np.einsum("nji,nj->ni", matrix, seen.states[:, 10:13]) - swept
            back = np.swapaxes(matrix, 1, 2)
            # R^T v - w x c, in body axes, and how it turns into the world's.
            by_body = back @ speed + rotations.hats(inward + swept) @ turn + arm @ spin
            if of_center is not None:
                by[:, :, of_center.at] -= rotations.hats(rate) * of_center.scale
            by[:, :, mine] += by_body
            left, change = inward, np.zeros((len(inward), 3, 1))
            if len(seen.slopes):
                bent, pushed = seen.slopes[:, 4:7], np.einsum("nji,nj->ni", matrix, seen.slopes[:, 10:13])
                change = (pushed - np.cross(rate, inward + swept) - np.cross(bent, center))[:, :, None]
            if stream.world:
                change = matrix @ (change + np.cross(rate, inward)[:, :, None])
                left = np.einsum("nij,nj->ni", matrix, inward)
                by[:, :, mine] -= rotations.hats(inward) @ turn
                by = matrix @ by
            left = left - stream.values
        elif stream.kind == RATES:
            left, change = self._rates(z, number, stream, seen, matrix, mine, by)
        else:
            left, change = self._specific_force(z, number, stream, seen, matrix, mine, by)
        if delay in layout:
            by[:, :, layout[delay].at] -= change * layout[delay].scale
        return left, by

    def _rates(
        self, z: Array, number: int, stream: Stream, seen: _Seen, matrix: Array, mine: Any, by: Array
    ) -> tuple[Array, Array]:
        """Return the same of rates; what a gyro shows is scale (turned rate) + bias."""
        layout, rate = self.layout, seen.states[:, 4:7]
        turn, spin = seen.columns[:, :3], seen.columns[:, 3:6]
        change = seen.slopes[:, 4:7, None] if len(seen.slopes) else np.zeros((len(rate), 3, 1))
        if stream.world:
            by[:, :, mine] = matrix @ (spin - rotations.hats(rate) @ turn)
            return np.einsum("nij,nj->ni", matrix, rate) - stream.values, matrix @ change
        of_align, of_scale = (f"{name}.{stream.topic}" for name in ("gyro_alignment", "gyro_scale"))
        align, scale = layout.values(of_align, z, np.zeros(3)), layout.values(of_scale, z, np.ones(3))
        mount = rotations.matrices(rotations.quaternions(align)) @ stream.mount
        turned = rate @ mount.T
        by[:, :, mine] = scale[:, None] * (mount @ spin)
        if of_align in layout:
            outer, block = np.swapaxes(rotations.right_jacobians(align), -1, -2), layout[of_align]
            by[:, :, block.at] = -scale[:, None] * (rotations.hats(turned) @ outer) * block.scale
        if of_scale in layout:
            block = layout[of_scale]
            by[:, :, block.at] = turned[:, :, None] * np.diag(block.scale)
        left = self._biased(z, f"gyro_bias[{number}].{stream.topic}", scale * turned - stream.values, by)
        return left, scale[:, None] * (mount @ change)

    def _specific_force(
        self, z: Array, number: int, stream: Stream, seen: _Seen, matrix: Array, mine: Any, by: Array
    ) -> tuple[Array, Array]:
        """Return the same of an accelerometer at l from the centre of mass: R^T (v' - g) + w' x l + w x (w x l)."""
        layout, rate, bent = self.layout, seen.states[:, 4:7], seen.slopes[:, 4:7]
        turn, spin = seen.columns[:, :3], seen.columns[:, 3:6]
        numbers, numbers_by = self._numbers(z)
        place = f"accelerometer_position.{stream.topic}"
        lever = layout.values(place, z, stream.place) - self.body(z).center_of_mass
        back = np.swapaxes(matrix, 1, 2)
        pushed = np.einsum("nij,nj->ni", back, seen.slopes[:, 10:13] - numbers[25:28])
        hat, hats = rotations.hats(lever), rotations.hats(rate)
        inner = pushed + np.cross(bent, lever) + np.cross(rate, np.cross(rate, lever))
        by[:, :, mine] = (
            back @ (seen.slopes_by[:, 9:12] - numbers_by[25:28, mine])
            + rotations.hats(pushed) @ turn
            - hat @ seen.slopes_by[:, 3:6]
            - (rotations.hats(np.cross(rate, lever)) + hats @ hat) @ spin
        )
        arms = rotations.hats(bent) + hats @ hats
        if place in layout:
            by[:, :, layout[place].at] += arms * layout[place].scale
        if "center_of_mass" in layout:
            by[:, :, layout["center_of_mass"].at] -= arms * layout["center_of_mass"].scale
        by[:] = stream.mount @ by
        shown = inner @ stream.mount.T
        left = self._biased(z, f"accelerometer_bias[{number}].{stream.topic}", shown - stream.values, by)
        return left, _jerk(stream.time_ns / NANOSECONDS, shown, seen.pieces)[:, :, None]

    def _biased(self, z: Array, name: str, left: Array, by: Array) -> Array:
        """Return `left` with the bias of a sensor, if it is fitted, and put what that changes into `by`."""
        if name not in self.layout:
            return left
        block = self.layout[name]
        by[:, :, block.at] = np.diag(block.scale)
        return left + block.values(z)


class _Turning(NamedTuple):
    """A rotor or a wheel: its key in the scene, axis, inertia, and its rate (rad/s), linear between times."""

    key: str
    axis_body: Vector
    axial_inertia: float
    time_ns: Times
    spin_rate: Array


class _Acting(NamedTuple):
    """What acts in a flight: times, rows, topic and what of them is fitted of each channel; and what turns inside."""

    channels: list[tuple[Times, Array, str, list[tuple[int, ParameterBlock, Array]]]]
    rotors: list[_Turning]


class _Seen(NamedTuple):
    """States, columns and their rates at the samples of a stream, and the number of the piece of what is held."""

    states: Array
    columns: Array
    slopes: Array
    slopes_by: Array
    pieces: Array


def _jerk(seconds: Array, shown: Array, pieces: Array) -> Array:
    """Return how fast a specific force (n, 3) changes; between samples that is near enough.

    Where a wrench changes between two of them, the force steps: however a delay moves the samples, none crosses that.
    """
    found: Array = np.gradient(shown, seconds, axis=0)
    steps = np.diff(pieces) != 0.0
    slopes = np.where(steps[:, None], 0.0, np.diff(shown, axis=0) / np.diff(seconds)[:, None])
    before, after = np.append(False, steps), np.append(steps, False)
    found[before] = np.vstack([slopes, np.zeros((1, 3))])[before]
    found[after] = np.vstack([np.zeros((1, 3)), slopes])[after]
    return found


def _inverse(inertia: Array) -> Array:
    """Return the inverse (3, 3); NaN where a search tries a body so thin that its inertia rounds to a singular one."""
    try:
        return np.asarray(np.linalg.inv(inertia), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.nan)


def _knots(acting: _Acting, begin: int, times: Sequence[Times]) -> Times:
    """Return the ends of the intervals from `begin` down to the earliest of `times`, and then up to the latest."""
    low, end = min(begin, *(int(at[0]) for at in times)), max(int(at[-1]) for at in times)
    edges = [at for at, *_ in acting.channels]
    edges += [rotor.time_ns for rotor in acting.rotors]
    knots = np.unique(np.concatenate([*times, *(at[(at > low) & (at < end)] for at in edges)]))
    before = knots[knots < begin]
    return np.concatenate([before[::-1], knots[1:] if len(before) else knots])


def _numbers_of(effect: Any) -> list[str]:
    """Return the keys of an effect that are a number or a tuple of some, and that `replace` can change."""
    keys = effect.keys or ([each.name for each in fields(effect)] if is_dataclass(effect) else ())
    values = [(key, getattr(effect, key, ())) for key in keys]
    return [key for key, v in values if v != () and {float} == set(map(type, v if isinstance(v, tuple) else (v,)))]


def _at_a_point(acting: CombinedEffects) -> Callable[[Point], tuple[Vector, Vector]]:
    """Return force and torque of effects as a function of a point."""
    load_from = acting.load_from(0.0)
    assert load_from is not None
    return lambda point: load_from(point)(0.0, ZERO, *point[2:])


def _span(places: Any) -> Any:
    """Return ascending places as a slice where there is none between them: copies are costly."""
    whole = len(places) > 0 and np.array_equal(places, np.arange(places[0], places[0] + len(places)))
    return slice(int(places[0]), int(places[0]) + len(places)) if whole else places


def _scheduled(effect: Effect, scene: Scene) -> tuple[Times, Array] | None:
    """Return when the wrenches of an effect begin and what they are, as in `Channel`; gravity is in the body."""
    if not isinstance(effect, ScheduledWrench):
        return None
    schedule = effect.schedule(scene.body)
    times = np.array([nanoseconds(time) for time, _ in schedule], dtype=np.int64)
    return times, np.array([_row(wrench, scene) for _, wrench in schedule], dtype=np.float64)


def _row(wrench: Wrench, scene: Scene) -> list[float]:
    """Return what a wrench does, as a row of `WrenchSeries`."""
    named = scene.frames.world_frame if wrench.frame_id == WORLD else wrench.frame_id
    held = scene.frames.hold(wrench if named == wrench.frame_id else Wrench(wrench.force, wrench.torque, named))
    at_point = held.force_body if wrench.frame_id in (scene.frames.fixed or {}) else ZERO
    return [*held.force_body, *held.torque_body, *held.force_world, *held.torque_world, *at_point]


def _of_schedule(effect: ScheduledWrench, name: str, scene: Scene) -> tuple[int, Array, Array]:
    """Return place, value and rows (3, 15) of unit forces or torques of an entry, as in schedule[0].torque."""
    number, _, kind = name.removeprefix("schedule[").partition("].")
    wrench = effect.entries[int(number)][1]
    of_unit = [
        Wrench(unit, ZERO, wrench.frame_id) if kind == "force" else Wrench(ZERO, unit, wrench.frame_id)
        for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]
    value = np.array(getattr(wrench, kind), dtype=np.float64)
    return int(number), value, np.array([_row(unit, scene) for unit in of_unit], dtype=np.float64)


def _start(flight: Flight) -> InitialEstimate:
    """Return a rough state at the start, from the first samples of each kind."""
    attitude, rate = np.array([0.0, 0.0, 0.0, 1.0]), None
    position, velocity = np.zeros(3), None
    fastest, extent = 0.0, 0.0
    found = {stream.kind: stream for stream in flight.streams if len(stream.time_ns) > 1}
    if ATTITUDE in found:
        stream = found[ATTITUDE]
        attitude = stream.values[0]
        turned = rotations.between(stream.values[:-1], stream.values[1:])
        seconds = np.diff(stream.time_ns) / NANOSECONDS
        speeds = np.linalg.norm(turned, axis=1)[seconds > 0.0] / seconds[seconds > 0.0]
        fastest = float(np.quantile(speeds, 0.99)) if len(speeds) else 0.0
        near = rotations.between(attitude[None], stream.values)
        rate = _slope(stream.time_ns, near, _within(np.linalg.norm(near, axis=1), 0.5))
    if RATES in found:
        stream = found[RATES]
        speeds = np.linalg.norm(stream.values, axis=1)
        fastest = max(float(np.quantile(speeds, 0.99)), 0.5 * fastest if fastest else 0.0)
        seconds = (stream.time_ns - stream.time_ns[0]) / NANOSECONDS
        few = max(1, min(20, int(np.searchsorted(seconds * max(fastest, 1e-9), 0.05))))
        rate = stream.values[:few].mean(axis=0)
        rate = rotations.matrices(attitude).T @ rate if stream.world else stream.mount.T @ rate
    if POSITION in found:
        stream = found[POSITION]
        position = stream.values[0]
        extent = float(np.ptp(stream.values, axis=0).max())
        velocity = _slope(stream.time_ns, stream.values, max(3, len(stream.values) // 20))
    if VELOCITY in found:
        stream = found[VELOCITY]
        velocity = stream.values[0] if stream.world else rotations.matrices(attitude) @ stream.values[0]
        first, last = flight.span_ns
        path = float(np.linalg.norm(stream.values, axis=1).mean()) * (last - first) / NANOSECONDS
        extent = max(extent, path)
    none = np.zeros(3)
    rate, velocity = none if rate is None else rate, none if velocity is None else velocity
    return InitialEstimate(attitude, rate, position, velocity, max(fastest, 1e-6), max(extent, 1e-6))


def _within(sizes: Array, most: float) -> int:
    beyond = np.flatnonzero(sizes > most)
    return max(2, int(beyond[0]) if len(beyond) else len(sizes))


def _slope(time_ns: Times, values: Array, count: int) -> Array:
    """Return the rate of the first `count` rows at their start, of a parabola through them."""
    seconds = (time_ns[:count] - time_ns[0]) / NANOSECONDS
    degree = 2 if len(np.unique(seconds)) > 5 else 1
    span = max(float(seconds[-1]), 1e-9)
    found: Array = np.polynomial.polynomial.polyfit(seconds / span, values[:count], degree)[1] / span
    return found
