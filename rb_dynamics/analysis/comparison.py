"""`Comparison`: differences between a motion and a recorded one, at every stamp of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rb_dynamics.errors import LogError
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, subtract

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rb_dynamics.formats.bag_reader import Bag
    from rb_dynamics.numerics.rotation import Quaternion
    from rb_dynamics.numerics.vector import Vector

_ROWS = 7


@dataclass(frozen=True)
class Comparison:
    """Differences at each stamp.

    Attributes:
        times_ns: the stamps.
        attitude: angle between the attitudes, rad.
        position: m.
        rate: of the angular velocities, rad/s.
        velocity: of the linear velocities, m/s.
    """

    times_ns: tuple[int, ...]
    attitude: tuple[float, ...]
    position: tuple[float, ...]
    rate: tuple[float, ...]
    velocity: tuple[float, ...]

    @classmethod
    def of(
        cls,
        truth: Bag,
        poses: Mapping[int, tuple[Vector, Quaternion]],
        twists: Mapping[int, tuple[Vector, Vector]],
        pose_topic: str = "/truth/pose",
        twist_topic: str = "/truth/twist",
    ) -> Comparison:
        """Return the differences of `poses` and `twists` (body axes), by stamp in ns, from the topics of a recording.

        The first sample of the recording is left out, since it is the common initial state.

        Raises:
            LogError: there is no pose or no twist at a stamp of the recording.
        """
        times, true_poses = truth.poses(pose_topic)
        twist_times, true_twists = truth.twists(twist_topic)
        by_time = dict(zip(twist_times.tolist(), true_twists.tolist(), strict=True))
        rows = []
        for time_ns, (x, y, z, *q) in list(zip(times.tolist(), true_poses.tolist(), strict=True))[1:]:
            if time_ns not in poses or time_ns not in twists or time_ns not in by_time:
                raise LogError(
                    f"found no pose or no twist at {time_ns / 1e9:.9g} s, expected both, as {truth.path.name} has one "
                    "there; set an output_rate that meets its stamps"
                )
            position, orientation = poses[time_ns]
            linear, angular = twists[time_ns]
            true = by_time[time_ns]
            rows.append(
                (
                    time_ns,
                    angle_between((q[0], q[1], q[2], q[3]), orientation),
                    norm(subtract(position, (x, y, z))),
                    norm(subtract(angular, (true[3], true[4], true[5]))),
                    norm(subtract(linear, (true[0], true[1], true[2]))),
                )
            )
        return cls(*(tuple(column) for column in zip(*rows, strict=True)))

    def worst(self) -> dict[str, float]:
        """Return the largest difference of each kind."""
        return {name: max(values) for name, values in self.series().items()}

    def series(self) -> dict[str, tuple[float, ...]]:
        """Return the differences by name with unit."""
        return {
            "attitude (rad)": self.attitude,
            "position (m)": self.position,
            "rate (rad/s)": self.rate,
            "velocity (m/s)": self.velocity,
        }

    def within(self, tolerance: float) -> bool:
        """Return whether every difference is at most `tolerance`."""
        return all(value <= tolerance for value in self.worst().values())

    def as_text(self, tolerance: float) -> str:
        """Return a table: the differences at some stamps, the largest differences, and the verdict."""
        names = list(self.series())
        lines = [f"{'time (s)':>12}" + "".join(f"{name:>18}" for name in names)]
        last = len(self.times_ns) - 1
        shown = sorted({round(k * last / (_ROWS - 1)) for k in range(_ROWS)})
        columns = list(self.series().values())
        lines += [self._line(f"{self.times_ns[i] / 1e9:.1f}", [column[i] for column in columns]) for i in shown]
        lines.append(self._line("worst", list(self.worst().values())))
        verdict = "all within" if self.within(tolerance) else "NOT all within"
        lines.append(f"{len(self.times_ns)} stamps compared with the recording: {verdict} {tolerance:g}")
        return "\n".join(lines)

    @staticmethod
    def _line(head: str, numbers: list[float]) -> str:
        return f"{head:>12}" + "".join(f"{number:>18.2e}" for number in numbers)
