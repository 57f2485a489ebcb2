"""Shared by all tests: paths in the tree, and a ROS domain for each test process."""

from __future__ import annotations

import fcntl
import gc
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Generator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import IO

ROOT = Path(__file__).resolve().parent.parent


# The folders whose tests take longest, one by one or all together.
FIRST = ("ros", "packaging", "benchmarks", "docs", "motion", "study", "verification")
# As pytest was started.
NICE = os.nice(0)
OPTIONAL = {"PIL", "mcap", "rerun", "rosbags", "zstandard"}
MODULES = {"rerun-sdk": "rerun", "imageio-ffmpeg": "imageio_ffmpeg"}


def _claim_domain() -> tuple[int, IO[str]]:
    """Return a ROS domain (1 to 101) no other test process here holds, with the lock that keeps it ours.

    Domain 0 stays free: it is where a user's own nodes live.
    """
    folder = Path(tempfile.gettempdir()) / f"rb_dynamics_domains_{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for offset in range(101):
        domain = 1 + (os.getpid() + offset) % 101
        lock = (folder / str(domain)).open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        return domain, lock
    raise RuntimeError(f"all ROS domains from 1 to 101 are held by test processes (locks in {folder}); end some")


def pytest_configure(config: pytest.Config) -> None:
    """Set the environment before anything imports rclpy; child processes inherit it."""
    # How long an example takes says how busy the machine is, not whether the code is right.
    hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
    # New examples every time, and more of them: `make search`.
    hypothesis.settings.register_profile("search", deadline=None, max_examples=1000)
    profile = config.getoption("--hypothesis-profile") or "repeatable"
    hypothesis.settings.load_profile(profile)
    if profile == "repeatable":
        # Constants of the modules imported so far are tried as well: which ones hangs on the tests that ran before.
        providers = import_module("hypothesis.internal.conjecture.providers")
        if hasattr(providers, "_get_local_constants"):  # since 6.131
            nothing = providers.Constants()
            providers._get_local_constants = lambda: nothing
    domain, lock = _claim_domain()
    logs = tempfile.mkdtemp(prefix="rb_dynamics_ros_log_")
    os.environ.update(
        ROS_DOMAIN_ID=str(domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        ROS_LOG_DIR=logs,
        # As the command line has it; three workers of two threads each would wait for each other.
        OPENBLAS_NUM_THREADS="1",
        # Fast DDS 2.14 shares its ports in shared memory among all domains. Where processes are killed, as tests do,
        # another takes over a port that is in use, and its owner crashes when it ends (docs/ros.md).
        FASTDDS_BUILTIN_TRANSPORTS="UDPv4",
    )
    config.add_cleanup(lock.close)
    config.add_cleanup(lambda: shutil.rmtree(logs, ignore_errors=True))
    if "PYTEST_XDIST_WORKER" not in os.environ:
        # What is compiled here is not the user's; workers and the processes they start share it, and each kernel once.
        # Later sessions find it again: the folder is named in the sources and the compiler, as a user's is.
        if not hasattr(config, "cache"):
            raise pytest.UsageError("kernels are kept in pytest's cache; leave out -p no:cacheprovider")
        os.environ["XDG_CACHE_HOME"] = str(config.cache.mkdir("kernels"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage among what is collected, now or later: it stays, and is most of what there is."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Let each worker begin at another folder: in a new clone each then finds files that others have compiled."""
    report = yield
    if collector.path == ROOT / "test" and "PYTEST_XDIST_WORKER" in os.environ:
        worker, workers = os.environ["PYTEST_XDIST_WORKER"], int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
        first = len(report.result) * int(worker.removeprefix("gw")) // workers
        report.result = [*report.result[first:], *report.result[:first]]
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest tests first, so that no worker idles at the end; all workers need the same order."""
    turns = {name: turn for turn, name in enumerate(FIRST)}
    items.sort(key=lambda item: (turns.get(item.nodeid.split("/")[1], len(FIRST)), item.path))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let the tests of ROS go first: they mostly wait, and what they wait for is late while others use all cores."""
    if "PYTEST_XDIST_WORKER" in os.environ and os.nice(0) == NICE and not item.nodeid.startswith("test/ros/"):
        os.nice(5)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Keep the tests of a file in one worker, since they share fixtures; and those of ROS, whose timing interferes.

    Not by `--dist loadgroup`, which with pytest 9.2 groups nothing and does not say so.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "test/ros" if file.startswith("test/ros/") else file

    # As they were collected; xdist would begin with the files that have the most tests.
    config.option.loadscopereorder = False
    return ByFile(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Skip tests that fail because an optional package is missing: `colcon test` has only those that rosdep knows."""
    report = yield
    missing = _missing(call.excinfo.value, report.capstderr) if call.excinfo and report.failed else ""
    if missing:
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1] or 0, f"{missing} is not installed")
    return report


def _missing(error: BaseException, printed: str) -> str:
    """Return the missing optional package that `error`, or the output `printed` by a command, asks for."""
    if isinstance(error, ModuleNotFoundError):
        return error.name if error.name in OPTIONAL else ""
    asked = re.search(r"needs the package '([\w-]+)'", f"{error}{printed}")
    return asked[1] if asked and find_spec(MODULES.get(asked[1], asked[1])) is None else ""


@pytest.fixture(autouse=True)
def _engine_stays() -> Iterator[None]:
    """Refuse a test that leaves the next ones to another engine: they would take minutes, or test nothing."""
    before = os.environ.get("RB_DYNAMICS_COMPILE")
    yield
    after = os.environ.pop("RB_DYNAMICS_COMPILE", None)
    if before is not None:
        os.environ["RB_DYNAMICS_COMPILE"] = before
    assert after == before


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the root of the source tree."""
    return ROOT


@pytest.fixture(scope="session")
def scene_dir() -> Path:
    """Return the folder of the scenes that ship with the package."""
    return ROOT / "config"


@pytest.fixture(scope="session")
def example_dir() -> Path:
    """Return the folder of the recorded wrench logs that ship with the package."""
    return ROOT / "examples"


@pytest.fixture
def signals_of_a_terminal() -> Iterator[None]:
    """Give SIGINT, SIGTERM and SIGHUP the handlers of a terminal, here and in child processes.

    Under nohup or `&` in a script some are ignored; child processes inherit that and would not end.
    """
    handlers = [
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_DFL),
        (signal.SIGHUP, signal.SIG_DFL),
    ]
    before = [(number, signal.signal(number, handler)) for number, handler in handlers]
    yield
    for number, handler in before:
        signal.signal(number, handler)


@pytest.fixture
def bare_environment() -> dict[str, str]:
    """Return this process's environment without the variables of make, the ROS wheels and a sourced workspace.

    The wheels restart the interpreter once to set the library path of their own venv and leave a guard behind; a
    child in another venv would take both over and never set its own.
    """
    inherited = (
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
        "AMENT_PREFIX_PATH",
        "COLCON_PREFIX_PATH",
        "LD_LIBRARY_PATH",
        "PYTHONPATH",
    )
    return {name: value for name, value in os.environ.items() if name not in inherited}
