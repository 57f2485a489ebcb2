"""Run each peer in its own process: libraries, threads, floating-point modes and crashes affect no other."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from multiprocessing.connection import Connection
from typing import Any

from peers.problem import Answer, Problem

# Short runs are repeated until so much time (s) has passed: a clock and a cache are not what is measured.
SHORTEST = 0.02

# A run that takes longer (s) is not made twice to measure it.
LONG = 2.0


class PeerError(Exception):
    """A peer is not there, or did not do what it was asked."""


@dataclass(frozen=True)
class Tried:
    """What a setting led to: seconds of set-up with compilation and the first run, seconds of a run, and its answer."""

    setup: float
    seconds: float
    answer: Answer


class Worker:
    """The process of one peer, as seen from outside."""

    def __init__(self, module: str, patience: float = 60.0) -> None:
        """Start it; `patience` is how long (s) it may take for an answer."""
        self._module, self._patience = module, patience
        self._problem: Problem | None = None
        self._start()
        try:
            self.name, self.versions = self._ask("hello")
        except PeerError:
            self.close()
            raise

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(self._module, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def ways(self, problem: Problem) -> list[tuple[str, str, float]]:
        """Return name, kind of setting and first setting of each way."""
        self._problem = problem
        return self._ask("ways", problem)

    def attempt(self, way: str, setting: float) -> Tried:
        """Try a setting on the problem that `ways` was last asked for."""
        return self._ask("attempt", way, setting)

    def choose(self, way: str, setting: float) -> None:
        """Prepare a setting, to be run again and again."""
        self._ask("choose", way, setting)

    def run(self, way: str) -> float:
        """Return how long (s) the chosen setting takes."""
        return self._ask("run", way)

    def kernels(self, problem: Problem, h: float, n: int) -> list[tuple[str, Any]]:
        """Return the names of rk4 implementations, and the numbers that n steps of h s lead to."""
        return self._ask("kernels", problem, h, n)

    def close(self) -> None:
        """End the process: by itself, so that what it holds is given back, or else by force."""
        self._connection.close()
        self._process.join(2.0)
        self._process.terminate()
        self._process.join()

    def _start_again(self) -> None:
        """Begin anew with a process that does not still work on an old question."""
        self.close()
        self._start()
        if self._problem is not None:
            self._connection.send(("ways", self._problem))
            self._connection.recv()

    def _ask(self, *question: Any) -> Any:
        try:
            self._connection.send(question)
            if not self._connection.poll(self._patience):
                self._start_again()
                raise PeerError(f"gave no answer in {self._patience:g} s")
            found = self._connection.recv()
        except (EOFError, OSError) as error:
            self._process.join(5.0)
            code = self._process.exitcode
            self._start_again()
            raise PeerError(f"ended with exit code {code}") from error
        if isinstance(found, PeerError):
            raise found
        return found


def _serve(module: str, connection: Connection) -> None:
    try:
        peer = import_module(f"peers.{module}")
    except ImportError as error:
        connection.send(PeerError(f"is not there: {error}"))
        return
    served = _Served(peer)
    while True:
        try:
            name, *arguments = connection.recv()
        except (EOFError, OSError):
            return
        try:
            connection.send(getattr(served, name)(*arguments))
        except Exception as error:  # noqa: BLE001
            connection.send(PeerError("".join(traceback.format_exception_only(error)).strip()))


class _Served:
    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self._ways: dict[str, Any] = {}
        self._warm: set[str] = set()
        self._chosen: dict[str, Callable[[], Callable[[], Any]]] = {}

    def hello(self) -> tuple[str, str]:
        found = [f"{package} {version(package)}" for package in self._peer.PACKAGES]
        return self._peer.NAME, ", ".join(found) or self._peer.version()

    def ways(self, problem: Problem) -> list[tuple[str, str, float]]:
        can = problem.orbit is None or getattr(self._peer, "ORBITS", False)
        ways = self._peer.ways(problem) if can else []
        self._ways, self._chosen, self._warm = {way.name: way for way in ways}, {}, set()
        return [(way.name, way.kind, way.first) for way in self._ways.values()]

    def attempt(self, way: str, setting: float) -> Tried:
        begin = time.perf_counter()
        run = self._ways[way].prepare(setting)
        prepared = time.perf_counter()
        read = run()
        end = time.perf_counter()
        answer = read()
        # What takes long is not run twice, but for the first time: there may be compilation in it.
        again = way not in self._warm or end - prepared < LONG
        self._warm.add(way)
        seconds = _seconds(run, once=True) if again else end - prepared
        return Tried(end - begin, seconds, answer)

    def choose(self, way: str, setting: float) -> None:
        self._chosen[way] = self._ways[way].prepare(setting)
        self._chosen[way]()()

    def run(self, way: str) -> float:
        return _seconds(self._chosen[way])

    def kernels(self, problem: Problem, h: float, n: int) -> list[tuple[str, Any]]:
        self._chosen = self._peer.kernels(problem, h, n)
        return [(name, run()()) for name, run in self._chosen.items()]


def _seconds(run: Callable[[], Callable[[], Any]], *, once: bool = False) -> float:
    """Return the mean time of a run; what it returns is read outside of it."""
    total, count = 0.0, 0
    while count == 0 or (total < SHORTEST and not once):
        begin = time.perf_counter()
        read = run()
        total += time.perf_counter() - begin
        read()
        count += 1
    return total / count
