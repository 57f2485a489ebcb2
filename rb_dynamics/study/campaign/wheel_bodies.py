"""`WithWheels`: the bodies of a block that have reaction wheels, and sensors that their law hears, side by side.

Each has the bits of itself alone. What this does not have, such as forces beside the wheels, it finds out when a law
asks for it: the runs are then repeated alone. They are repeated, too, if a law reads an accelerometer, which takes more
time at each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.many_measurements import ManyMeasurements, has_readable_forces, shared_by_sensors
from rb_dynamics.run.many_measurements import kernel_at_hand as sensors_at_hand
from rb_dynamics.run.sample_arrays import Samples
from rb_dynamics.run.wheel_ensemble import WheelEnsemble, actuators_of, shared_by_wheels
from rb_dynamics.run.wheel_ensemble import kernels_at_hand as wheels_at_hand
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.many_readings import FORCE, IN_BODY, parts_of
from rb_dynamics.study.campaign.control_inputs import OnboardValues, SensorReading
from rb_dynamics.study.campaign.laws import LAWS
from rb_dynamics.study.campaign.model import Control

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Times = npt.NDArray[np.int64]


class NotTogetherError(Exception):
    """These runs have to be executed alone."""


def alike(scene: Scene, control: Control | None) -> tuple[Hashable, Hashable] | None:
    """Return what runs that go side by side with wheels share; None if one cannot."""
    if control is not None and control.law in LAWS and not control.through:
        # It commands a torque on the body.
        return None
    wheels, sensors = shared_by_wheels(scene), () if control is None else shared_by_sensors(scene)
    return None if wheels is None or sensors is None else (wheels, sensors)


def known_ahead(control: Control | None) -> bool:
    """Return whether it is known what a law will ask for and command: a user's may turn out to need runs alone."""
    return control is None or control.law in LAWS


def at_hand(scene: Scene) -> bool:
    """Return whether they can go so at once, as nothing has to be compiled."""
    # Both are asked for.
    found = [wheels_at_hand(scene), not scene.sensors or sensors_at_hand()]
    return all(found)


class _OnRequest(Mapping[str, "Numbers"]):
    """Arrays by name, each made if a law asks for it; the law may overwrite it."""

    def __init__(self, names: Iterable[str], make: Callable[[str], Numbers]) -> None:
        self._names, self._make, self._found = tuple(names), make, dict[str, "Numbers"]()

    def __getitem__(self, name: str) -> Numbers:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._found:
            self._found[name] = self._make(name)
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class WithWheels:
    """Bodies with wheels.

    Attributes:
        failed: none; see `Bodies`.
        lacking: whether a law has asked for what is not there.
    """

    def __init__(
        self, scenes: Sequence[Scene], driven: bool, threads: int | None = None, *, forces: bool = False
    ) -> None:
        """Start at the initial states of the scenes.

        `driven`: by a controller, which hears their sensors; `forces`: also their accelerometers.

        Raises:
            NotTogetherError: the kernels are not there.
        """
        import numpy as np

        self._scene = scenes[0]
        try:
            self._ensemble = WheelEnsemble(scenes, threads)
            self._sensing = ManyMeasurements(scenes, forces=forces) if driven and self._scene.sensors else None
        except LookupError as error:
            raise NotTogetherError from error
        self._wheels = {wheel.name: k for k, wheel in enumerate(self._scene.wheels)}
        self._actuators = {each.name: k for k, each in enumerate(actuators_of(self._scene))}
        self._effects = [scene.combined_effects for scene in scenes]
        # Commands, in the order of their samples: when they take effect, values, and for which bodies they have yet to.
        self._waiting: list[tuple[Times, Numbers, npt.NDArray[np.bool_]]] = []
        self._apart = np.zeros(len(scenes), dtype=np.bool_)
        self.failed: Mapping[int, str] = {}
        self.lacking, self._heard, self._forces = False, False, forces

    @property
    def may_feel(self) -> bool:
        """Whether they can go together with accelerometers, and a law has asked for one."""
        return self.lacking and not self._forces and has_readable_forces(self._scene)

    @property
    def apart(self) -> npt.NDArray[np.bool_]:
        """(N,), which of them have to be executed alone, as they could not go on together."""
        return self._apart | self._ensemble.left_behind

    def samples(self) -> Samples:
        """Return their state; see `Bodies`."""
        samples = self._ensemble.samples()
        samples.clipped_commands = self._ensemble.clipped
        samples.rejected_commands = self._ensemble.rejected
        return samples

    def onboard(self) -> OnboardValues:
        """Return what a controller can measure; see `Bodies`."""
        import numpy as np

        samples, time_s = self._ensemble.samples(), self._ensemble.time_ns / NANOSECONDS

        def field() -> Numbers:
            effects = zip(self._effects, samples.position_world.tolist(), strict=True)
            return np.array([each.magnetic_field(time_s)((x, y, z)) for each, (x, y, z) in effects])

        speeds = _OnRequest(self._wheels, lambda name: samples.wheel_speeds[:, self._wheels[name]].copy())
        found = OnboardValues({}, speeds, field if self._effects[0].magnetic else None)
        if self._sensing is None:
            return found
        self._sensing.deliver(self._ensemble.time_ns)
        return found._replace(
            sensors=dict(self._readings(self._sensing)),
            orientation_xyzw=self._in_body(self._sensing, "orientation_xyzw", 4),
            angular_velocity_body=self._in_body(self._sensing, "angular_velocity", 3),
            silent=self._silent(self._sensing),
        )

    def _readings(self, sensing: ManyMeasurements) -> Iterator[tuple[str, SensorReading]]:
        for sensor, now in zip(self._scene.sensors, sensing.sensors, strict=True):

            def value(
                name: str, newest: Numbers = now.newest, parts: Mapping[str, slice] = parts_of(sensor)
            ) -> Numbers:
                return newest[:, parts[name]].copy() if name != FORCE or self._forces else self._ask()

            yield sensor.name, SensorReading(sensor.name, now.taken_s.copy(), _OnRequest(sensor.values, value))

    def _ask(self) -> Numbers:
        import numpy as np

        self.lacking = True
        return np.full((len(self._ensemble), 3), np.nan)

    def _in_body(self, sensing: ManyMeasurements, name: str, count: int) -> Numbers | None:
        """Return a value for the body, as the first sensor that measures it says; laws compute with its columns."""
        for sensor, now in zip(self._scene.sensors, sensing.sensors, strict=True):
            if name in sensor.values:
                return now.newest[:, IN_BODY : IN_BODY + count].copy(order="F")
        return None

    def _silent(self, sensing: ManyMeasurements) -> tuple[str, ...]:
        """Return the sensors without a message so far; bodies of which others have none are to go apart."""
        if self._heard:
            return ()
        silent = sensing.silent()
        # As the one that has heard most, whose law is called if that is all.
        most = silent[silent.sum(axis=1).argmin()]
        self._apart |= (silent != most).any(axis=1)
        self._heard = not silent.any()
        return tuple(sensor.name for sensor, is_silent in zip(self._scene.sensors, most, strict=True) if is_silent)

    def hold(self, commands: Mapping[str, Numbers], times_ns: Times) -> None:
        """Command the actuators, each body from its time on, (N,).

        Raises:
            NotTogetherError: something else is commanded.
        """
        import numpy as np

        values = np.full((len(self._ensemble), len(self._actuators)), np.nan)
        for name, column in commands.items():
            if name not in self._actuators:
                raise NotTogetherError
            values[:, self._actuators[name]] = column
        self._apart |= self._ensemble.rejects(values)
        self._waiting.append((times_ns, values, np.ones(len(values), dtype=np.bool_)))

    def require_all(self) -> None:
        """Require that laws have asked only for what is there.

        Raises:
            NotTogetherError: one has asked for more.
        """
        if self.lacking:
            raise NotTogetherError

    def advance_to(self, time_ns: int) -> None:
        """Advance; see `Bodies`.

        Raises:
            NotTogetherError: a law has asked for what is not there.
        """
        self.require_all()
        while self._sensing is not None and self._sensing.due_ns <= time_ns:
            self._go_to(self._sensing.due_ns)
            self._sensing.take(self._ensemble.rows, self._ensemble.time_ns)
        self._go_to(time_ns)

    def _go_to(self, time_ns: int) -> None:
        """Advance, with the commands that take effect before then."""
        for times_ns, values, waits in self._waiting:
            now = waits & (times_ns < time_ns)
            if now.any():
                self._ensemble.advance_some(times_ns, now)
                self._ensemble.command(values, None if now.all() else now)
                waits[now] = False
        self._waiting = [each for each in self._waiting if each[2].any()]
        self._ensemble.advance_to(time_ns)
