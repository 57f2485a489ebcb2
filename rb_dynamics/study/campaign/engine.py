"""Run a campaign: send blocks of runs to workers, here or on a cluster, and write their rows to disk.

Workers are processes of `dask.distributed` if it is installed, on this machine or behind the address of a scheduler,
and otherwise threads of this process. If a worker dies, its blocks run again, except rows that are already on disk.
"""

from __future__ import annotations

import contextlib
import logging
import math
import platform
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from importlib.util import find_spec
from itertools import chain, islice
from typing import Any

from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.formats.log_metadata import version
from rb_dynamics.numerics.background_compilation import waited_for
from rb_dynamics.numerics.compilation import available
from rb_dynamics.numerics.cores import cores
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.study.campaign.block_of_runs import Columns, simulate_block
from rb_dynamics.study.campaign.block_propagation import go_side_by_side, step_ns, turn_of
from rb_dynamics.study.campaign.control import DELAY
from rb_dynamics.study.campaign.distributions import Choice, Stepped
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.scenes import Scenes
from rb_dynamics.study.campaign.store import Store
from rb_dynamics.study.campaign.wheel_bodies import alike, at_hand, known_ahead

Progress = Callable[[int, int], None]
"""Called with the number of runs done and the number of all runs."""

SIDE_BY_SIDE, IN_TURN, ALONE = 2000, 100, 20
"""Runs in a block: enough to amortize numpy's calls, few enough for memory and to lose little when killed."""

_FEW = 250
"""Smallest number of runs side by side in a block."""

_START_S = 5.0
"""Approximate time to start workers, with their imports and kernels."""

_TELL_S = 1.0
"""Least time between two calls of `progress` within a block."""

_PLAIN_S = 15.0
"""Time after which kernels that are still not compiled are named: the usual ones take less."""

_BLOCKS_EACH = 4
"""Minimum number of blocks per worker, as they do not all end at the same time."""

_AHEAD = 3
"""Blocks per worker submitted to the scheduler at a time."""

_LOOK_S = 0.05
"""Time between two looks whether a block has come back."""

_log = logging.getLogger(__name__)


def run_campaign(
    campaign: Campaign,
    store: Store,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    block: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Run what `store` does not have yet, and finish it.

    Args:
        campaign: to be run.
        store: receives the rows.
        workers: processes on this machine, 0 for threads of this process. By default one per core, unless the first
            block shows that this process would finish before they had started.
        scheduler: address of a running scheduler of `dask.distributed`, such as tcp://host:8786.
        block: runs in a block, chosen by default; results do not depend on it.
        progress: called after each block, and about every second within one of this process.

    Raises:
        LogError: the rows cannot be written, the scheduler cannot be reached or is lost, or a block ends each worker
            that runs it.
        MissingExtraError: `scheduler` is given, and `distributed` is not installed.
        SceneError: a user function cannot be loaded, or lacks what it needs on this machine.
    """
    if store.complete:
        return
    with_dask = find_spec("distributed") is not None
    if scheduler is not None and not with_dask:
        raise MissingExtraError("distributed", "scale", "a campaign on a cluster")
    processes = cores() if workers is None else workers
    size = block or _block(campaign, max(1, processes))
    blocks, done = store.missing(size), store.done
    told = time.monotonic()

    plain = _PlainPython()

    def tell(runs: float) -> None:
        nonlocal told
        plain.look(waited_for)
        if progress is not None and time.monotonic() - told >= _TELL_S:
            told = time.monotonic()
            progress(done + int(runs), campaign.runs)

    local = scheduler is None and (processes == 0 or not with_dask or campaign.runs - done <= size)
    if local:
        flown = _here(campaign, blocks, tell)
    elif scheduler is None and workers is None:
        flown = _here_or_on_workers(campaign, blocks, campaign.runs - done, processes, tell, plain)
    else:
        flown = _on_workers(campaign, blocks, scheduler, processes, plain)
    with contextlib.closing(flown):
        for columns in flown:
            store.write(columns)
            done += len(columns["run"])
            if progress is not None:
                progress(done, campaign.runs)
    store.finish()


class _PlainPython:
    """Says once, after a while, that runs are in plain Python as kernels are not compiled yet."""

    def __init__(self) -> None:
        self._due = time.monotonic() + _PLAIN_S

    def look(self, waited_for: Callable[[], Iterable[str]]) -> None:
        """Warn if it is time, and `waited_for` names any kernels."""
        if time.monotonic() < self._due:
            return
        self._due = math.inf
        if names := sorted({*waited_for()}):
            _log.warning(
                "runs are in plain Python, up to a hundred times slower, until another process has compiled their "
                "kernels; to avoid the wait, press Ctrl-C, run `rb-dynamics compile %s`, and start the same command "
                "again: it continues",
                " ".join(names),
            )


def goes_side_by_side(campaign: Campaign) -> bool:
    """Return whether the runs of `campaign` use the kernels for many bodies, rather than one run at a time."""
    dispersed = {each.name.partition(".")[0] for each in campaign.inputs}
    base = Scenes(campaign).base
    return (
        dispersed.isdisjoint(("solver", "duration"))
        and go_side_by_side([base], campaign.control is not None)
        and _commands_on_grid(campaign, step_ns(base))
    )


def goes_alone(campaign: Campaign) -> bool:
    """Return whether each run of `campaign` goes by itself: neither side by side, as with wheels, nor in turn."""
    with_wheels = available() and alike(Scenes(campaign).base, campaign.control) is not None
    return not (goes_side_by_side(campaign) or with_wheels or _goes_in_turn(campaign))


def _goes_in_turn(campaign: Campaign) -> bool:
    base = Scenes(campaign).base
    return base.combined_effects.compile and turn_of(base, campaign.control is not None) is not None


def _commands_on_grid(campaign: Campaign, step: int | None) -> bool:
    """Return whether all delays are whole multiples of a step (ns); otherwise commands fall between steps."""
    if campaign.control is None or step is None:
        return True
    found = next((each.distribution for each in campaign.inputs if each.name == DELAY), None)
    if found is None:
        delays: tuple[float, ...] = (dict(campaign.control.numbers)[DELAY],)
    else:
        delays = found.values if isinstance(found, Choice) else (found.step,) if isinstance(found, Stepped) else ()
    return bool(delays) and all(round(delay * NANOSECONDS) % step == 0 for delay in delays)


def _block(campaign: Campaign, workers: int) -> int:
    base, control = Scenes(campaign).base, campaign.control
    with_wheels = alike(base, control) is not None and at_hand(base)
    if goes_side_by_side(campaign) or (with_wheels and known_ahead(control)):
        least, most = _FEW, SIDE_BY_SIDE
    else:
        least, most = 1, IN_TURN if _goes_in_turn(campaign) or with_wheels else ALONE
    return max(least, min(most, math.ceil(campaign.runs / (workers * _BLOCKS_EACH))))


def _here(
    campaign: Campaign, blocks: Iterator[tuple[int, int]], tell: Callable[[float], None]
) -> Generator[Columns, None, None]:
    for first, last in blocks:
        yield simulate_block(campaign, first, last, tell=tell)


def _here_or_on_workers(
    campaign: Campaign,
    blocks: Iterator[tuple[int, int]],
    left: int,
    processes: int,
    tell: Callable[[float], None],
    plain: _PlainPython,
) -> Generator[Columns, None, None]:
    """Yield rows of the `left` runs computed here, until starting workers is worth it."""
    for first, last in blocks:
        begin = time.perf_counter()
        columns = simulate_block(campaign, first, last, tell=tell)
        took, left = time.perf_counter() - begin, left - (last - first)
        yield columns
        saved = took / (last - first) * left * (1.0 - 1.0 / processes)
        if saved > _START_S:
            yield from _on_workers(campaign, blocks, None, processes, plain)


def _on_workers(
    campaign: Campaign,
    blocks: Iterator[tuple[int, int]],
    scheduler: str | None,
    processes: int,
    plain: _PlainPython,
) -> Generator[Columns, None, None]:
    """Yield the rows of blocks as they finish; only a few blocks per worker are submitted at a time."""
    from distributed import CancelledError, Client, KilledWorker, LocalCluster, as_completed
    from distributed.utils import silence_logging_cmgr

    with contextlib.ExitStack() as stack:
        if scheduler is None:
            cluster: Any = stack.enter_context(
                LocalCluster(
                    n_workers=processes,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            )
            client = stack.enter_context(Client(cluster))
        else:
            try:
                # What goes wrong is told below, without tracebacks.
                stack.enter_context(silence_logging_cmgr(logging.CRITICAL))
                client = stack.enter_context(Client(scheduler, timeout=_PATIENCE_S))
                client.wait_for_workers(1, timeout=_PATIENCE_S)
            except (OSError, TimeoutError, ValueError) as error:
                raise LogError(
                    f"no scheduler with workers at {scheduler} within {_PATIENCE_S} s ({error}); start dask scheduler "
                    "and dask worker, or correct the address, such as tcp://host:8786"
                ) from error
        workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))

        def submit(some: Iterator[tuple[int, int]]) -> list[Any]:
            futures = []
            for each in some:
                futures.append(client.submit(simulate_on_worker, campaign, version(), *each, pure=False))
                runs[futures[-1].key] = each
            return futures

        runs: dict[Any, tuple[int, int]] = {}
        # Results are fetched on arrival: of a worker that is lost with one, it is computed again without blocking here.
        waiting = as_completed(submit(islice(blocks, _AHEAD * workers)), with_results=True)
        while _wait(waiting, client):
            try:
                future, columns = next(waiting)
            except KilledWorker as error:
                first, last = runs[error.args[0]]
                raise LogError(
                    f"the runs {first} to {last - 1} ended each worker that ran them, {error.args[2] + 1} in turn: too "
                    "little memory (give fewer runs with --block), or a law or metric that ends its process; the logs "
                    "of the workers say more"
                ) from error
            if isinstance(columns, CancelledError):
                raise LogError(
                    f"lost the scheduler at {scheduler or 'this machine'}; start it and its workers, and the same "
                    "command again: it continues"
                ) from columns
            del runs[future.key]
            # Release it before the next one: the scheduler keeps results that are still referenced.
            future.release()
            for new in submit(islice(blocks, 1)):
                waiting.add(new)
                # A worker that is lost says nothing; the campaign goes on without it.
                plain.look(lambda: chain.from_iterable(client.run(waited_for, on_error="ignore").values()))
            yield columns


def _wait(waiting: Any, client: Any) -> bool:
    """Wait for the next block that comes back, False if none is left; say so if no worker is there for a while."""
    begin, told = time.monotonic(), False
    while not (waiting.is_empty() or waiting.has_ready()):
        time.sleep(_LOOK_S)
        if not told and time.monotonic() - begin > _PATIENCE_S:
            begin = time.monotonic()
            told = client.scheduler_info(n_workers=-1).get("workers") == {}
            if told:
                _log.warning(
                    "no worker is left: the campaign goes on as soon as one joins, or press Ctrl-C and start the same "
                    "command later, which continues; the logs of the workers say why they ended, such as without "
                    "rb_dynamics"
                )
    return not waiting.is_empty()


def simulate_on_worker(campaign: Campaign, commander: str, first: int, last: int) -> Columns:
    """Return the rows of a block on a worker, in one thread; `commander` is the version of the commanding process.

    Raises:
        LogError: the worker has another version.
        SceneError: as `simulate_block` says.
    """
    if version() != commander:
        raise LogError(
            f"the worker on {platform.node()} has rb_dynamics {version()}, expected {commander} as here; install the "
            "same everywhere and start the workers again"
        )
    return simulate_block(campaign, first, last, 1)


_PATIENCE_S = 30
