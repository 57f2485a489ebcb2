"""Measure how punctual the node is, what it costs and how fast it answers, beside a plain rclpy node.

Usage: python benchmarks/node.py [--seconds 60] [--rounds 1] [--bodies 4] [--rate 1000] [--priority 10]

There are two runs: steps of 1 ms, each published (pose, twist, odom, momenta, energies: eight topics, all of them
read), and steps of 0.25 ms published at 200 Hz. This process is the reader; it receives serialized messages and
commands a force now and then. A message is "late" if it was published more than a period after its time, by the
middleware's source timestamp, or skipped because the next one was due; it is "lost" if it was published but never
arrived. Latency is from the publishing of a wrench to the arrival of the first pose that shows it, by the middleware's
reception timestamp.

The reference node is plain rclpy: a timer and the same messages, made once, stamped and published at each tick. It
neither simulates nor subscribes. The two nodes take turns, so that other load on the machine affects both. CPU is user
and system time of the whole process.

Lateness of the machine itself is measured by a process without ROS on each processor, which only sleeps from one time
to the next. If one of them oversleeps by 0.3 of a period, the machine stalled, at most since the previous time. The
result says how many late ticks fell into a stall or within the same time after it, and what share of the time that is,
since some would by chance. The other late ticks are due to the node.

`--priority` gives all of these processes, and the reader below them, a real-time priority (SCHED_FIFO, as `chrt -f`
does), which root may do. The sleeping processes run above the node.

Finally, several bodies at 100 Hz, pose and odometry of each read: one process each, and one process for all. Memory is
the proportional set size, which counts shared memory once.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from statistics import median

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Float64

from rb_dynamics.formats import cdr
from rb_dynamics.numerics.compilation import available

TOPICS = {
    "pose": PoseStamped,
    "twist": TwistStamped,
    "odom": Odometry,
    "angular_momentum": Vector3Stamped,
    "linear_momentum": Vector3Stamped,
    "energy/kinetic": Float64,
    "energy/work": Float64,
    "energy/defect": Float64,
}
SCENE = """\
body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.1]}
wrenches: [{topic: wrench}]
"""
# Hz of the steps, Hz of the outputs.
CASES = ((1000, 1000), (4000, 200))
PATIENCE, SETTLE = 30.0, 1.0
# s between two polls of the reader, and between two commands.
LOOK, COMMAND = 0.0002, 0.0473
# Oversleeping of a sleeping process, in periods, that counts as a stall of the machine.
STALL = 0.3
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement")
    parser.add_argument("--rounds", type=int, default=1, help="of node and empty node in turn")
    parser.add_argument("--bodies", type=int, default=4, help="side by side, 0: none")
    parser.add_argument("--rate", type=float, help="Hz: only the run with this output rate")
    parser.add_argument("--priority", type=int, default=0, help="real-time priority, 2 to 99; 0: none")
    parser.add_argument("--empty", type=float, metavar="HZ", help=argparse.SUPPRESS)
    parser.add_argument("--bare", type=float, nargs=2, metavar=("HZ", "CPU"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.empty:
        empty_node(arguments.empty)
        return
    if arguments.bare:
        bare(arguments.bare[0], int(arguments.bare[1]))
        return
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # Two of these on one machine would measure each other's nodes.
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randrange(1, 100)))
    if available():
        os.environ["RB_DYNAMICS_COMPILE"] = "always"
    steps = "compiled" if available() else "in plain Python"
    print(
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before; steps {steps}; {arguments.seconds:g} s each; "
        f"{f'real-time priority {arguments.priority}' if arguments.priority else 'no priority'}"
    )
    at, above = [], []
    if arguments.priority:
        at, above = (["chrt", "-f", str(arguments.priority + more)] for more in (0, 1))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(arguments.priority - 1))
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(SCENE, encoding="utf-8")
        me = [sys.executable, str(Path(__file__).resolve())]
        for steps, rate in (case for case in CASES if arguments.rate in (None, case[1])):
            ratios = []
            for _ in range(arguments.rounds):
                node = [*at, sys.executable, "-m", "rb_dynamics", "node", str(scene), "--ros-args"]
                node += ["-p", f"solver.step:={1 / steps}", "-p", "solver.method:=rkmk4", "-p", f"output_rate:={rate}"]
                empty = [*at, *me, "--empty", str(rate)]
                watcher = [*above, *me, "--bare", str(rate)]
                ours = measured(f"node, {steps} Hz steps", node, watcher, rate, arguments.seconds, commanded=True)
                theirs = measured("empty rclpy node", empty, watcher, rate, arguments.seconds, commanded=False)
                ratios.append(ours / theirs)
            print(f"CPU of the node / CPU of the empty node at {rate} Hz: {median(ratios):.2f}")
        if arguments.bodies:
            several(scene, arguments.bodies, min(20.0, arguments.seconds))
    print(f"load {os.getloadavg()[0]:.1f} after")


def empty_node(rate: float) -> None:
    """Publish messages of the same types at `rate` until SIGTERM."""
    rclpy.init()
    node = Node("empty")
    messages = [(node.create_publisher(kind, topic, 10), kind()) for topic, kind in TOPICS.items()]
    period_ns = round(1e9 / rate)
    count = 0
    begun = time.monotonic_ns()

    def tick() -> None:
        nonlocal count
        # A late timer skips ticks: the stamp is that of the tick that is due, not of the skipped ones.
        count = max(count + 1, (time.monotonic_ns() - begun) // period_ns)
        seconds, nanoseconds = divmod(count * period_ns, 1_000_000_000)
        stamp = Time(sec=seconds, nanosec=nanoseconds)
        for publisher, message in messages:
            if not isinstance(message, Float64):
                message.header.stamp = stamp
            publisher.publish(message)

    node.create_timer(1.0 / rate, tick)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


def bare(rate: float, cpu: int) -> None:
    """Sleep on one processor until each time of `rate`; at SIGTERM print when that was how late."""
    os.sched_setaffinity(0, {cpu})
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    late, count, begun = [], 0, time.time_ns()
    try:
        while True:
            count += 1
            due = begun + round(count * 1e9 / rate)
            time.sleep(max(0, due - time.time_ns()) / 1e9)
            now = time.time_ns()
            if now - due > STALL * 1e9 / rate:
                late.append((due, now))
    finally:
        print(*(moment for pair in late for moment in pair), flush=True)


def punctuality(delays: list[tuple[int, int]], period_ns: float, stalls: list[tuple[int, int]]) -> str:
    """Return how many of `delays` (time, length; ns) exceed a period, and how many of those are in `stalls`.

    `stalls` (start, end; ns) are those of the machine, empty if unknown.
    """
    late = [when for when, delay in delays if delay > period_ns]
    lengths = sorted(delay for _, delay in delays)
    text = f"{len(late)} of {len(delays)} ticks late ({100 * len(late) / len(delays):.3f} %"
    if stalls:
        begun, ended = delays[0][0], delays[-1][0]
        windows = windows_of(stalls)
        within = sum(any(since <= when <= until for since, until in windows) for when in late)
        covered = sum(max(0, min(until, ended) - max(since, begun)) for since, until in windows) / (ended - begun)
        text += f"; {within} of them in stalls of the machine and after, which are {100 * covered:.1f} % of the time"
    return f"{text}), behind p50 {_at(lengths, 0.5):.2f} p99 {_at(lengths, 0.99):.2f} max {lengths[-1] / 1e6:.1f} ms"


def windows_of(stalls: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the windows affected by stalls, which last twice as long as each; overlapping ones are merged."""
    union: list[tuple[int, int]] = []
    for since, until in sorted((since, 2 * woken - since) for since, woken in stalls):
        if union and since <= union[-1][1]:
            union[-1] = (union[-1][0], max(until, union[-1][1]))
        else:
            union.append((since, until))
    return union


def several(scene: Path, count: int, seconds: float) -> None:
    """Print the cost of `count` bodies in one process each, and in a common one."""
    base = [sys.executable, "-m", "rb_dynamics"]
    apart = [[*base, "node", str(scene), "--ros-args", "-r", f"__ns:=/body_{k + 1}"] for k in range(count)]
    together = [[sys.executable, "-m", "rb_dynamics.ros.bodies", str(scene), "--count", str(count)]]
    for name, commands in (("a process each", apart), ("one process", together)):
        with ExitStack() as stack:
            pids = [stack.enter_context(process(command)) for command in commands]
            rclpy.init()
            stack.callback(rclpy.shutdown)
            node = Node("reader")
            readers = [
                node.create_subscription(TOPICS[topic], f"/body_{k + 1}/{topic}", _taken_elsewhere, KEEP_ALL, raw=True)
                for k in range(count)
                for topic in ("pose", "odom")
            ]
            _take_all(readers, 5.0)
            before = sum(map(cpu_seconds, pids))
            received = _take_all(readers, seconds)
            cpu = (sum(map(cpu_seconds, pids)) - before) / seconds
            print(
                f"{count} bodies, {name}: CPU {100 * cpu:.1f} %, {sum(map(memory, pids)):.0f} MiB, "
                f"{received / seconds / count / 2:.1f} Hz"
            )


def _take_all(readers: list[Subscription], seconds: float) -> int:
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        for reader in readers:
            while reader.handle.take_message(reader.msg_type, True) is not None:
                count += 1
        time.sleep(0.005)
    return count


def memory(pid: int) -> float:
    """Return the proportional set size of a process, MiB."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("Pss:"))) / 1024


@contextmanager
def process(command: list[str]) -> Iterator[int]:
    """Run `command` and yield its process id."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield child.pid
    finally:
        child.send_signal(signal.SIGTERM)
        child.wait(PATIENCE)


def measured(name: str, command: list[str], watcher: list[str], rate: float, seconds: float, commanded: bool) -> float:
    """Measure one node, print the result, and return its CPU time in s per s; `watcher` is a sleeping process."""
    with process(command) as pid, ExitStack() as stack:
        reader = Reader(rate, commanded)
        stack.callback(reader.close)
        reader.watch(SETTLE)
        watchers = [
            stack.enter_context(subprocess.Popen([*watcher, str(cpu)], stdout=subprocess.PIPE, text=True))
            for cpu in os.sched_getaffinity(0)
        ]
        for child in watchers:
            stack.callback(child.kill)
        reader.watch(SETTLE)
        reader.forget()
        before, begun, begun_ns = cpu_seconds(pid), time.monotonic(), time.time_ns()
        reader.watch(seconds)
        cpu = (cpu_seconds(pid) - before) / (time.monotonic() - begun)
        period_ns, stalls, slept_over = round(1e9 / rate), [], []
        for child in watchers:
            child.terminate()
            moments = [int(word) for word in child.communicate(timeout=PATIENCE)[0].split()]
            found = [pair for pair in zip(moments[::2], moments[1::2], strict=True) if pair[0] > begun_ns]
            stalls += [(due - period_ns, woken) for due, woken in found]
            late = sum(woken - due > period_ns for due, woken in found)
            slept_over.append(f"{100 * late / (seconds * rate):.3f} %")
        # At the node's own priority, the node itself may have delayed them.
        known = stalls if watcher[0] == "chrt" else []
        print(f"{name:20s} {rate:5g} Hz: CPU {100 * cpu:5.1f} %; {reader.summary(known)}")
        print(f"{'bare sleepers':20s} {rate:5g} Hz: late {' and '.join(slept_over)}", flush=True)
    return cpu


def cpu_seconds(pid: int) -> float:
    """Return user and system time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Reader:
    """Receives serialized messages and commands now and then; keeps only counts and times."""

    def __init__(self, rate: float, commanded: bool) -> None:
        """Wait until all topics arrive and, if it commands, until a subscriber is there."""
        rclpy.init()
        self._node = Node("reader")
        self._subscriptions = {
            topic: self._node.create_subscription(kind, topic, _taken_elsewhere, KEEP_ALL, raw=True)
            for topic, kind in TOPICS.items()
        }
        self._period_ns = 1e9 / rate
        self._sequence = dict.fromkeys(TOPICS, 0)
        self._commands = self._node.create_publisher(WrenchStamped, "wrench", 10) if commanded else None
        self._command = WrenchStamped()
        self._command.header.frame_id = "world"
        self.forget()
        give_up = time.monotonic() + PATIENCE
        while not (
            all(self._sequence.values()) and (self._commands is None or self._commands.get_subscription_count())
        ):
            if time.monotonic() > give_up:
                raise SystemExit(f"within {PATIENCE:g} s these came: {self._sequence}")
            self._take()
            time.sleep(LOOK)

    def forget(self) -> None:
        """Reset the measurement."""
        self._delays: list[tuple[int, int]] = []
        self._recent: deque[int] = deque(maxlen=round(1e9 / self._period_ns))
        self._newest_ns: int | None = None
        self._lost = self._received = 0
        self._latencies: list[tuple[int, int]] = []
        self._positions: deque[float] = deque(maxlen=3)
        self._commanded_ns = 0
        self._next = time.monotonic() + COMMAND

    def watch(self, seconds: float) -> None:
        """Receive and command for `seconds`."""
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            self._take()
            if self._commands is not None and now >= self._next and not self._commanded_ns:
                self._command.wrench.force.x = 0.0 if self._command.wrench.force.x else 1.0
                self._commanded_ns = time.time_ns()
                self._commands.publish(self._command)
                self._next = now + COMMAND * random.uniform(0.8, 1.2)
            time.sleep(LOOK)

    def summary(self, stalls: list[tuple[int, int]]) -> str:
        """Return the results, given the `stalls` of the machine (start, end; ns of the wall clock)."""
        latencies = sorted(latency for _, latency in self._latencies)
        text = f"{self._received} messages, {self._lost} lost, {punctuality(self._delays, self._period_ns, stalls)}"
        if latencies:
            text += (
                f"; wrench to pose p50 {_at(latencies, 0.5):.2f} p99 {_at(latencies, 0.99):.2f} ms of {len(latencies)}"
            )
            windows = windows_of(stalls)
            apart = sorted(
                latency
                for sent, latency in self._latencies
                if not any(since <= sent + latency and sent <= until for since, until in windows)
            )
            if stalls and apart:
                text += f", p99 {_at(apart, 0.99):.2f} ms of the {len(apart)} outside the stalls"
        return text

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        rclpy.shutdown()

    def _take(self) -> None:
        for topic, subscription in self._subscriptions.items():
            while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                data, facts = taken
                number, before = facts["publication_sequence_number"], self._sequence[topic]
                self._lost += number - before - 1 if before else 0
                self._received += 1
                self._sequence[topic] = number
                if topic == "pose":
                    self._see(data, facts["source_timestamp"], facts["received_timestamp"])

    def _see(self, data: bytes, published_ns: int, received_ns: int) -> None:
        seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
        stamp_ns = seconds * 10**9 + nanoseconds
        if self._newest_ns is not None:
            passed_ns = stamp_ns - self._newest_ns
            # A skipped message is as late as the message in its place is behind.
            self._delays += [(published_ns, passed_ns)] * (round(passed_ns / self._period_ns) - 1)
        self._newest_ns = stamp_ns
        # The offset between the clocks is that of the most punctual message in the last second.
        apart = published_ns - stamp_ns
        self._recent.append(apart)
        self._delays.append((published_ns, apart - min(self._recent)))
        (x,) = struct.unpack_from("<d", data, cdr.first_number("geometry_msgs/msg/PoseStamped", data))
        positions = self._positions
        positions.append(x)
        if self._commanded_ns and len(positions) == 3:
            # Constant while a force is held, so a different value shows a new command.
            acceleration = (positions[2] - 2 * positions[1] + positions[0]) / (self._period_ns * 1e-9) ** 2
            old = 0.0 if self._command.wrench.force.x else 0.5
            # Rounding of positions is below 1e-6; a command shows once it has acted for a hundredth of the period.
            if abs(acceleration - old) > 1e-5:
                self._latencies.append((self._commanded_ns, received_ns - self._commanded_ns))
                self._commanded_ns = 0


def _taken_elsewhere(_: bytes) -> None:
    raise AssertionError("nothing spins this node")


def _at(values: list[int], part: float) -> float:
    """Return a quantile of sorted ns, in ms."""
    return values[min(len(values) - 1, int(part * len(values)))] / 1e6


if __name__ == "__main__":
    main()
