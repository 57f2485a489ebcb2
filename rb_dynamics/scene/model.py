"""`Scene`: a validated scene as values; `read.py` makes one from a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from rb_dynamics.body.plausibility import Finding
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.number_ranges import TIME
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel, ChannelBias, ChannelLag, topic_fault
from rb_dynamics.numerics.argument_checks import instance, instances, number, shown, whole_number
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.sensors.sensor import Sensor

DEFAULT_ACCURACY = 1e-9
"""Error (rad, and relative to the path) accepted at the end of a run with neither a step nor an accuracy."""

MOST_SEED = 2**53
"""Largest seed: numbers of a scene are doubles."""


@dataclass(frozen=True, slots=True)
class Solver:
    """How the motion is computed: the name of a method with a `step` (s), or with an `accuracy` that sets the step."""

    method: str = "auto"
    step: float | None = None
    accuracy: float | None = DEFAULT_ACCURACY

    def __post_init__(self) -> None:
        """Validate the fields; whether the method supports the load is checked when a run is planned.

        Raises:
            TypeError: a field has the wrong type.
            SceneError: there is no such method, step or accuracy is not greater than 0, or the accuracy is not below 1.
        """
        # Do not import the methods for a scene without a named method.
        if instance(self.method, str, "solver.method", "write its name") != "auto":
            from rb_dynamics.motion import METHODS, remedy

            if self.method not in METHODS:
                known, mend = ", ".join(METHODS), remedy(self.method, ("auto", *METHODS), "write one")
                raise SceneError(f"solver.method is {shown(self.method)}, expected auto or one of {known}; {mend}")
        for name in ("step", "accuracy"):
            if (value := getattr(self, name)) is not None:
                expected = "a finite number greater than 0, or None"
                object.__setattr__(self, name, number(value, f"solver.{name}", expected, SceneError, above=0.0))
        if self.accuracy is not None and self.accuracy >= 1.0:
            raise SceneError(
                f"solver.accuracy is {self.accuracy!r}, expected less than 1 (rad, and relative to the distance "
                "travelled); write a smaller one, or a step"
            )


@dataclass(frozen=True)
class Past:
    """The run that a scene continues, from its beginning: so that it continues with the same bits.

    Attributes:
        length_ns: how long it lasted until the scene begins.
        initial: its state at its time 0.
        duration: s, as it was planned; None for an open-ended run.
        commands: channel, command and when it took effect, ns from time 0 of that run; each before `length_ns`.
    """

    length_ns: int
    initial: State
    duration: float | None = None
    commands: tuple[tuple[str, Wrench, int], ...] = ()


@dataclass(frozen=True)
class Scene:
    """A scene, validated and in SI units.

    Attributes:
        body: mass properties.
        frames: names of world and body, fixed frames and the wrench rule. Centre of mass and inertia are taken from
            `body`, also after `replace(scene, body=...)`.
        initial: state at time 0.
        channels: wrench channels, in the order of the scene.
        solver: method and step or accuracy.
        duration: s, or None for an open-ended run.
        output_rate: Hz of published and logged states; 0 for every step.
        text: the scene as YAML, as read; with overrides applied, and with the contents of files that define the body
            (mesh, URDF). It defines the scene completely.
        source: file name, for messages.
        effects: loads in addition to the wrenches, in the order of the scene.
        actuators: what is commanded by a number, in the order of the scene.
        sensors: what measures the motion, in the order of the scene; their topics are their names.
        seed: of the noise of the sensors.
        past: the run that it continues; None for a scene that begins by itself.
        findings: suspicious properties of the body; not part of the scene.
        surface: mesh file of the body and its unit in m, for pictures; not part of the scene.
    """

    body: RigidBody
    frames: WrenchFrames
    initial: State
    channels: tuple[Channel, ...] = (Channel(),)
    solver: Solver = Solver()
    duration: float | None = None
    output_rate: float = 100.0
    text: str = ""
    source: str = "<scene>"
    effects: tuple[Effect, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    seed: int = 0
    past: Past | None = None
    findings: tuple[Finding, ...] = field(default=(), compare=False)
    surface: tuple[str, float] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Validate the fields; whether the solver can run the scene is checked when a run is planned.

        Raises:
            TypeError: a field has the wrong type.
            ValueError: a number in `initial` is not finite, or the norm of its attitude is not 1.
            SceneError: the time of `initial` is not 0, the topic of a channel is not allowed or used twice, duration
                or output rate is out of range, or the frames were made for another centre of mass.
        """
        instance(self.body, RigidBody, "body", "make one with RigidBody.from_diagonal(mass, moments)")
        instance(self.frames, WrenchFrames, "frames", "write WrenchFrames()")
        instance(self.initial, State, "initial", "write State()")
        self._check_numbers()
        if self.initial.time_ns:
            raise SceneError(
                f"initial.time_ns is {self.initial.time_ns}, expected 0: a run begins at time 0; write "
                "replace(state, time_ns=0), and count the times of commands from there"
            )
        object.__setattr__(self, "channels", instances(self.channels, Channel, "channels", "write Channel(topic)"))
        object.__setattr__(self, "effects", instances(self.effects, Effect, "effects", "write one, as LinearDrag(...)"))
        instance(self.solver, Solver, "solver", "write Solver(method, step=..., accuracy=...)")
        if self.duration is not None:
            object.__setattr__(self, "duration", TIME.require(self.duration, "duration"))
        expected = f"a number from 0 to {NANOSECONDS:g} (Hz)"
        rate = number(self.output_rate, "output_rate", expected, SceneError, least=0.0, most=NANOSECONDS)
        object.__setattr__(self, "output_rate", rate)
        for channel in self.channels:
            if fault := topic_fault(channel.topic):
                raise SceneError(f"the topic of a channel is {shown(channel.topic)}, expected {fault[0]}; {fault[1]}")
        self._check_sensors_and_actuators()
        named = [topic for each in self.actuators for topic in (each.topic, each.name)]
        commanded = [*(channel.topic for channel in self.channels), *named]
        topics = [topic.removeprefix("/") for topic in (*commanded, *self.sensor_topics)]
        if len(set(topics)) < len(topics):
            raise SceneError(
                f"channels, actuators and sensors have the topics {topics}, expected different ones: of two channels "
                "with one topic, a command would reach the last alone; rename one"
            )

    def with_numbers(self, body: RigidBody, initial: State, seed: int) -> Scene:
        """Return the scene with another body, state at time 0 and seed, without its text.

        As `replace` does, but only these are checked: campaigns make one scene for each run.

        Raises:
            ValueError, SceneError: as when a scene is made.
        """
        found = object.__new__(Scene)
        vars(found).update(vars(self), body=body, initial=initial, seed=seed, text="", findings=(), surface=None)
        vars(found).pop("combined_effects", None)
        found._check_numbers()
        # Effects and actuators check the body.
        _ = found.combined_effects
        return found

    def _check_numbers(self) -> None:
        object.__setattr__(self, "frames", self.frames.of(self.body))
        object.__setattr__(self, "initial", self.initial.checked("initial"))
        seed = whole_number(self.seed, "seed", "write one, such as 1")
        if not 0 <= seed <= MOST_SEED:
            raise SceneError(f"seed is {seed}, expected a whole number from 0 to {MOST_SEED}; write another")
        object.__setattr__(self, "seed", seed)

    def _check_sensors_and_actuators(self) -> None:
        sensors = instances(self.sensors, Sensor, "sensors", "write one, as Imu(...)")
        actuators = instances(self.actuators, Actuator, "actuators", "write one, as Thruster(...)")
        object.__setattr__(self, "sensors", sensors)
        object.__setattr__(self, "actuators", actuators)
        if actuators and self.past is not None:
            raise SceneError(
                "actuators: their state in the run that the scene continues is not known, expected none; remove "
                "continues"
            )
        for sensor in sensors:
            sensor.fixed(self.frames)
            if fault := topic_fault(sensor.name):
                raise SceneError(f"sensors: a name is {shown(sensor.name)}, expected {fault[0]}; {fault[1]}")
        magnetic = self.combined_effects.magnetic
        for part, parts in (("sensors", sensors), ("actuators", actuators)):
            lacking = [f"{each.kind} {each.name}" for each in parts if each.needs_field and not magnetic]
            if lacking:
                raise SceneError(
                    f"{part}: {lacking[0]} finds no magnetic field in the scene, expected one; add MagneticField(...) "
                    "to effects"
                )

    @cached_property
    def end_ns(self) -> int | None:
        """`duration` in whole nanoseconds, the end of a run."""
        return None if self.duration is None else nanoseconds(self.duration)

    @cached_property
    def wheels(self) -> tuple[ReactionWheel, ...]:
        """The actuators that are reaction wheels."""
        return tuple(each for each in self.actuators if isinstance(each, ReactionWheel))

    @property
    def sensor_topics(self) -> tuple[str, ...]:
        """The topics of the sensors."""
        return tuple(sensor.name for sensor in self.sensors)

    @cached_property
    def combined_effects(self) -> CombinedEffects:
        """The effects, the biases and lags of channels and what actuators are, combined, for this body."""
        biases = tuple(ChannelBias(channel) for channel in self.channels if channel.bias is not None)
        lags = tuple(ChannelLag(channel) for channel in self.channels if channel.lag)
        return CombinedEffects(self.body, (*self.effects, *biases, *lags, *self.actuators), self.frames)


__all__ = ["Channel", "Scene", "Solver"]
