"""Check what wrench commands do on the topics of any node: frames, lever arm, hold, timeout, channels, impulse, QoS.

Needs WrenchStamped in and Odometry out, with stamps that advance, and nothing else acting on the body. The laws of
motion are the criterion, not a model: between two messages the momentum changes by the integral of force and torque.
That integral, and so the check, is exact where the force does not turn with the body. Messages that the node should
give are looked for on /diagnostics.

    python -m rb_dynamics.ros.conformance --frame thruster:0,0.5,0.2 --second push --timed burst:0.2
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.numerics.command_line_numbers import real
from rb_dynamics.numerics.number_parsing import real_number
from rb_dynamics.ros.conversions import to_nanoseconds

Array = npt.NDArray[np.float64]

# Relative error accepted if the integral is exact, and if the wrench rotates with the body between two samples.
EXACT, TURNING = 1e-9, 2e-3
# Simulated time to observe a command, s, and wall time to wait for a message, s.
_WINDOW, _PATIENCE = 0.25, 20.0
# Windows for a command to arrive: at first, and where it seems not to act.
_SETTLING = (1, 8)
# Time for publisher and reader to discover each other, s, and for a node that reports once a second to do so.
_MATCHING, _REPORTING = 3.0, 5.0
_FORCE, _TORQUE = np.array([0.8, -0.4, 0.6]), np.array([0.02, 0.03, -0.01])
_NONE = np.zeros(3)
_BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT


@dataclass(frozen=True)
class Subject:
    """The node under test: mass properties about the centre of mass (SI, body axes), names of topics and frames.

    Attributes:
        mass: kg.
        inertia: 3 × 3, kg m^2.
        center_of_mass: from the body origin, m.
        topic: a channel that holds its command.
        second: another channel, or "".
        timed: a channel with a timeout, or "".
        timeout: of `timed`, simulated s.
        frame: a frame fixed to the body with parallel axes, or "".
        position: of its origin from the body origin, m.
    """

    mass: float
    inertia: Array
    center_of_mass: Array
    topic: str = "wrench"
    second: str = ""
    timed: str = ""
    timeout: float = 0.0
    frame: str = ""
    position: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class ConformanceResult:
    """Result of one check; `error` is relative to the expected change of momentum.

    If nothing is measured, `error` is 0 or infinite, and `note` says what was observed.
    """

    name: str
    passed: bool
    error: float
    accepted: float
    note: str = ""


@dataclass(frozen=True)
class MomentaAtStamp:
    """The momenta at one stamp (s): linear, and angular about the centre of mass, in world axes."""

    time_ns: int
    rotation: Array
    linear: Array
    angular: Array


class Conformance(Node):
    """Sends commands to a node and observes the momenta."""

    def __init__(self, wrench_topics: Sequence[str]) -> None:
        """Prepare to publish on `wrench_topics` and to read `odom`, `inertia` and `/diagnostics`."""
        super().__init__("wrench_conformance")
        self._odometry: list[Odometry] = []
        self._inertia: list[InertiaStamped] = []
        self.create_subscription(Odometry, "odom", self._odometry.append, 1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(InertiaStamped, "inertia", self._inertia.append, latched)
        self._reports = 0
        self._complaints: set[tuple[str, str]] = set()
        self.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_report, QoSProfile(depth=100, reliability=_BEST_EFFORT)
        )
        self._wrenches = {topic: self.create_publisher(WrenchStamped, topic, 10) for topic in wrench_topics if topic}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def mass_properties(self) -> tuple[float, Array, Array]:
        """Return mass, inertia and centre of mass as the node publishes them.

        Raises:
            RigidBodyError: it does not publish them.
        """
        self._until(lambda: bool(self._inertia), "no message on inertia; give --mass, --inertia and --center")
        i = self._inertia[-1].inertia
        matrix = np.array([[i.ixx, i.ixy, i.ixz], [i.ixy, i.iyy, i.iyz], [i.ixz, i.iyz, i.izz]])
        return i.m, matrix, np.array([i.com.x, i.com.y, i.com.z])

    def run(self, subject: Subject) -> Iterator[ConformanceResult]:
        """Yield the result of each check in turn.

        Raises:
            RigidBodyError: the node does not subscribe to the topics, or its stamps do not advance.
        """
        self._subject = subject
        for topic, publisher in self._wrenches.items():
            self._until(partial(_is_heard, publisher), f"no subscriber on {topic}")
        self._moments(0.0)
        world, body = self._odometry[-1].header.frame_id, self._odometry[-1].child_frame_id
        zero = (world, _NONE, _NONE)
        main = subject.topic
        yield self._held("free motion conserves momentum", {main: zero}, EXACT)
        yield self._held("world axes: neither part turns with the body", {main: (world, _FORCE, _TORQUE)}, EXACT)
        yield self._watched(
            "hold: the command acts until the next one", EXACT, self._wrench_of({main: (world, _FORCE, _TORQUE)})
        )
        yield self._held("body axes: both parts turn with the body", {main: (body, _FORCE, _TORQUE)}, TURNING)
        yield self._held("an empty frame_id means body axes", {main: ("", _TORQUE * 10, _NONE)}, TURNING)
        yield self._refused(
            "a command with an unknown frame_id is rejected", main, ("no_such_frame", _FORCE, _NONE), zero
        )
        yield self._refused("a command with a NaN is rejected", main, (world, np.array([np.nan, 0, 0]), _NONE), zero)
        if subject.frame:
            lever = {main: (subject.frame, _FORCE * 0.1, _NONE)}
            yield self._held("lever arm: a force at a fixed frame turns the body", lever, TURNING)
        if subject.second:
            both = {main: (world, _FORCE, _NONE), subject.second: (world, -0.25 * _FORCE, _TORQUE)}
            yield self._held("channels add up", both, EXACT)
            yield self._held(
                "a channel continues while another times out", {main: zero, subject.second: both[subject.second]}, EXACT
            )
            self._send({subject.second: zero})
        self._settle({main: zero})
        if subject.timed:
            yield self._burst(subject.timed, world)
        yield self.quality_of_service(main)

    def quality_of_service(self, topic: str) -> ConformanceResult:
        """Offer commands on `topic` as BEST_EFFORT, and check that a node that cannot receive them reports it.

        Passes if the QoS is compatible, or if a new status of WARN or more on `/diagnostics` mentions QoS.
        """
        name = "a publisher with incompatible QoS is reported on /diagnostics"
        self._within(_REPORTING, lambda: self._reports > 0)
        before = set(self._complaints)
        unfit: list[object] = []
        offered = self.create_publisher(
            WrenchStamped,
            topic,
            QoSProfile(depth=1, reliability=_BEST_EFFORT),
            event_callbacks=PublisherEventCallbacks(incompatible_qos=unfit.append),
        )
        try:
            if not self._within(_MATCHING, lambda: bool(unfit)):
                self._until(partial(_is_heard, offered), f"no subscriber on {topic}")
                return ConformanceResult(
                    name, True, 0.0, 0.0, "BEST_EFFORT is compatible, so there is nothing to report"
                )
            if not self._within(_REPORTING, lambda: self._complaints > before or _is_heard(offered)):
                return ConformanceResult(
                    name, False, math.inf, 0.0, "BEST_EFFORT is incompatible, and no diagnostics report it"
                )
            if not self._complaints > before:
                return ConformanceResult(name, True, 0.0, 0.0, "BEST_EFFORT was incompatible until the node met it")
            node, text = min(self._complaints - before)
            return ConformanceResult(name, True, 0.0, 0.0, f"{node}: {text}")
        finally:
            self.destroy_publisher(offered)

    def _on_report(self, message: DiagnosticArray) -> None:
        self._reports += 1
        for status in message.status:
            if status.level > DiagnosticStatus.OK:
                texts = (status.message, *(f"{pair.key}: {pair.value}" for pair in status.values))
                self._complaints |= {(status.name, text) for text in texts if _of_quality(text)}

    def _held(self, name: str, commands: dict[str, tuple[str, Array, Array]], accepted: float) -> ConformanceResult:
        """Send a command, and compare once it acts."""
        return self._patiently(lambda patience: self._settle(commands, patience), name, accepted, commands)

    def _refused(
        self, name: str, topic: str, bad: tuple[str, Array, Array], good: tuple[str, Array, Array]
    ) -> ConformanceResult:
        def settle(patience: int) -> None:
            self._settle({topic: good}, patience)
            self._settle({topic: bad}, patience)

        return self._patiently(settle, name, EXACT, {topic: good})

    def _patiently(
        self, settle: Callable[[int], None], name: str, accepted: float, commands: dict[str, tuple[str, Array, Array]]
    ) -> ConformanceResult:
        """Compare once `settle` has let `commands` arrive; a failed check is repeated with more time."""
        for patience in _SETTLING:
            settle(patience)
            found = self._watched(name, accepted, self._wrench_of(commands))
            if found.passed:
                break
        return found

    def _watched(self, name: str, accepted: float, wrench: Callable[[Array], tuple[Array, Array]]) -> ConformanceResult:
        """Compare the change of momentum over a time window with the integral (trapezoidal rule) of `wrench`."""
        moments = self._moments(_WINDOW)
        expected = [np.zeros(3), np.zeros(3)]
        for a, b in pairwise(moments):
            step = (b.time_ns - a.time_ns) / 1e9
            for part in (0, 1):
                expected[part] = expected[part] + 0.5 * step * (wrench(a.rotation)[part] + wrench(b.rotation)[part])
        return self._finding(name, accepted, moments[0], moments[-1], expected[0], expected[1])

    def _burst(self, topic: str, frame: str) -> ConformanceResult:
        """Send one command and no more: the total impulse is force times timeout, whenever it began."""
        before = self._moments(0.0)[-1]
        self._send({topic: (frame, _FORCE, _TORQUE)})
        duration = self._subject.timeout
        after = self._moments(duration + 3 * _WINDOW)[-1]
        name = "timeout: a channel without further commands has applied force times duration"
        return self._finding(name, EXACT, before, after, _FORCE * duration, _TORQUE * duration)

    def _finding(
        self, name: str, accepted: float, a: MomentaAtStamp, b: MomentaAtStamp, linear: Array, angular: Array
    ) -> ConformanceResult:
        # Relative to the impulse, or to the momenta if none is expected; linear and angular each in their own unit.
        errors = [
            float(np.linalg.norm(change - wanted))
            / max(float(np.linalg.norm(wanted)), float(np.linalg.norm(scale)) * 1e-3, 1e-6)
            for change, wanted, scale in (
                (b.linear - a.linear, linear, b.linear),
                (b.angular - a.angular, angular, b.angular),
            )
        ]
        return ConformanceResult(name, max(errors) <= accepted, max(errors), accepted)

    def _wrench_of(self, commands: dict[str, tuple[str, Array, Array]]) -> Callable[[Array], tuple[Array, Array]]:
        """Return force and torque about the centre of mass, world axes, as the rule defines them."""
        subject, world = self._subject, self._odometry[-1].header.frame_id

        def wrench(rotation: Array) -> tuple[Array, Array]:
            total = [np.zeros(3), np.zeros(3)]
            for frame, force, torque in commands.values():
                arm = subject.position - subject.center_of_mass if frame and frame == subject.frame else _NONE
                turn = np.eye(3) if frame == world else rotation
                total[0] = total[0] + turn @ force
                total[1] = total[1] + turn @ (torque + np.cross(arm, force))
            return total[0], total[1]

        return wrench

    def _settle(self, commands: dict[str, tuple[str, Array, Array]], patience: int = 1) -> None:
        """Send a command and wait, as many windows as given, until it must have arrived."""
        self._send(commands)
        self._moments(patience * _WINDOW)

    def _send(self, commands: dict[str, tuple[str, Array, Array]]) -> None:
        for topic, (frame, force, torque) in commands.items():
            message = WrenchStamped()
            message.header.stamp, message.header.frame_id = self._odometry[-1].header.stamp, frame
            f, t = message.wrench.force, message.wrench.torque
            f.x, f.y, f.z = force.tolist()
            t.x, t.y, t.z = torque.tolist()
            self._wrenches[topic].publish(message)

    def _moments(self, seconds: float) -> list[MomentaAtStamp]:
        """Return the momenta of the next `seconds` of the node's time."""
        self._odometry.clear()

        def passed() -> bool:
            if len(self._odometry) < 2:
                return False
            first, last = (to_nanoseconds(self._odometry[i].header.stamp) for i in (0, -1))
            return last - first >= seconds * 1e9

        self._until(passed, "no odom arrives, or its stamps do not advance")
        return [self._moment(message) for message in self._odometry]

    def _moment(self, message: Odometry) -> MomentaAtStamp:
        subject = self._subject
        q = message.pose.pose.orientation
        x, y, z, w = q.x, q.y, q.z, q.w
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        v, o = message.twist.twist.linear, message.twist.twist.angular
        omega = np.array([o.x, o.y, o.z])
        velocity = np.array([v.x, v.y, v.z]) + np.cross(omega, subject.center_of_mass)
        return MomentaAtStamp(
            to_nanoseconds(message.header.stamp),
            rotation,
            rotation @ (subject.mass * velocity),
            rotation @ (subject.inertia @ omega),
        )

    def _until(self, condition: Callable[[], bool], problem: str) -> None:
        if not self._within(_PATIENCE, condition):
            raise RigidBodyError(f"{problem}, within {_PATIENCE:g} s")

    def _within(self, seconds: float, condition: Callable[[], bool]) -> bool:
        """Listen until `condition` holds or this time (s) has passed; return whether it holds."""
        give_up = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > give_up:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True


def _is_heard(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())


def _of_quality(text: str) -> bool:
    return "qos" in text.lower() or "reliab" in text.lower()


def _numbers(text: str) -> Array:
    try:
        return np.array([real_number(part) for part in text.split(",")])
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"found {text!r}, expected numbers with commas between; write them as in 1,2,3"
        ) from None


def _vector(text: str) -> Array:
    numbers = _numbers(text)
    if numbers.size != 3:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected three numbers X,Y,Z; write them as in 0,0,1")
    return numbers


def _timed(text: str) -> tuple[str, float]:
    topic, _, seconds = text.partition(":")
    try:
        return topic, real_number(seconds)
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected TOPIC:SECONDS, such as burst:0.2") from None


def _frame(text: str) -> tuple[str, Array]:
    name, _, position = text.partition(":")
    return name, _vector(position)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m rb_dynamics.ros.conformance", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--topic", default="wrench", help="a channel that holds its command (default: wrench)")
    parser.add_argument("--second", default="", metavar="TOPIC", help="another one, to add up with")
    parser.add_argument(
        "--timed", type=_timed, default=("", 0.0), metavar="TOPIC:SECONDS", help="a channel with a timeout"
    )
    parser.add_argument(
        "--frame",
        type=_frame,
        default=("", _NONE),
        metavar="NAME:X,Y,Z",
        help="a fixed frame with the body's axes, and where",
    )
    parser.add_argument(
        "--mass",
        type=real("a number of kilograms greater than 0", lambda v: v > 0.0),
        help="kg; left out: from the topic inertia, as the next two",
    )
    parser.add_argument(
        "--inertia", type=_numbers, metavar="XX,XY,XZ,YY,YZ,ZZ", help="kg m^2, about the centre of mass"
    )
    parser.add_argument("--center", type=_vector, metavar="X,Y,Z", help="centre of mass, m from the body origin")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run all checks and print them; exit code 0 if all pass, 1 if one fails, 2 if the node cannot be tested."""
    parser = _parser()
    known, ros = parser.parse_known_args(args)
    if (known.mass is None) != (known.inertia is None) or (known.inertia is not None and known.inertia.size != 6):
        parser.error("found one of --mass and --inertia, expected both or none; add the other (inertia: six numbers)")
    (frame, position), (timed, timeout) = known.frame, known.timed
    rclpy.init(args=ros)
    node = Conformance([known.topic, known.second, timed])
    try:
        if known.mass is None:
            mass, inertia, center = node.mass_properties()
        else:
            xx, xy, xz, yy, yz, zz = known.inertia
            mass, inertia, center = known.mass, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), _NONE
        subject = Subject(
            mass,
            inertia,
            center if known.center is None else known.center,
            known.topic,
            known.second,
            timed,
            timeout,
            frame,
            position,
        )
        passed = True
        for finding in node.run(subject):
            passed &= finding.passed
            verdict = "holds" if finding.passed else "FAILS"
            measured = f"error {finding.error:.1e}, accepted {finding.accepted:.0e}"
            print(f"{verdict}  {finding.name}: {finding.note or measured}", flush=True)
    except RigidBodyError as error:
        print(f"conformance: {error}", file=sys.stderr)
        return 2
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
