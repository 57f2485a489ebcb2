"""Compile the kernels that runs use in advance (extra: fast), so that the first run is as quick as the next.

Without it, a first run stays in plain Python while another process compiles what it could use. By default these are the
kernels of runs by `auto` under wrenches; NAME is one of the names printed. The folder of the kernels is below
XDG_CACHE_HOME, or ~/.cache.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.motion.fixed_step_kernel import OnDemand

HELP = "compile the kernels that runs use in advance"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `compile`."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("names", nargs="*", default=[], metavar="NAME", help="kernels, instead of the usual ones")
    what.add_argument("--all", action="store_true", help="every kernel: some minutes")
    what.add_argument("--beside", action="store_true", help="those that a run names, line by line, on standard input")


def run(args: argparse.Namespace) -> int:
    """Compile; exit code 0, or 1 if something does not compile."""
    if args.beside:
        # The run comes first.
        os.nice(19)
    from rb_dynamics.errors import MissingExtraError, RigidBodyError
    from rb_dynamics.numerics.compilation import available, cache_folder
    from rb_dynamics.run.kernels_to_compile import all_kernels, usual_kernels

    if not available():
        raise MissingExtraError("numba", "fast", "rb-dynamics compile")
    kernels = all_kernels() if args.all or args.names or args.beside else usual_kernels()
    if unknown := sorted(set(args.names) - kernels.keys()):
        raise RigidBodyError(f"found kernels {unknown}, expected some of {', '.join(kernels)}; name some of these")
    if args.names or args.beside:
        from rb_dynamics.numerics.background_compilation import asked_for

        names = _ordered(kernels, asked_for()) if args.beside else args.names
        compiled = [_build(kernels[name]) for name in names]
    else:
        from rb_dynamics.cli.many_logs import processes
        from rb_dynamics.numerics.cores import cores

        # Kernels of one method share functions, which each process compiles for itself.
        groups = [[*names] for _, names in groupby(kernels, lambda name: kernels[name].method)]
        with processes(cores()) as pool:
            compiled = [each for group in pool.map(_build_all, groups) for each in group]
    print(f"in {cache_folder()}")
    return 0 if all(compiled) else 1


def _build_all(names: list[str]) -> list[bool]:
    from rb_dynamics.run.kernels_to_compile import all_kernels

    kernels = all_kernels()
    return [_build(kernels[name]) for name in names]


def _build(kernel: OnDemand) -> bool:
    """Compile a kernel, print how long that takes, and return whether it succeeds."""
    from rb_dynamics.motion.fixed_step_kernel import Tally
    from rb_dynamics.numerics.compilation import is_cached, keep_failure

    tally, known = Tally(), is_cached(kernel.name)
    try:
        kernel.build(tally)
    except (ImportError, RuntimeError) as error:
        keep_failure(kernel.name, str(error))
        _tell(f"{kernel.name:34} {error}")
        return False
    done = "was there" if known or not tally.built else f"{tally.built[kernel.name]:.1f} s"
    _tell(f"{kernel.name:34} {done}")
    return True


def _tell(line: str) -> None:
    # In one piece: to an unbuffered stream print writes the end of a line apart, and other processes write there, too.
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _ordered(kernels: dict[str, OnDemand], orders: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield the names of those kernels that can be compiled, functions of plug-ins included."""
    from rb_dynamics.motion.plugin_kernels import kernel_of
    from rb_dynamics.numerics.compilation import cache_folder, keep_failure

    for name, order in orders:
        if order:
            try:
                found = kernel_of(order)
            except Exception as error:  # noqa: BLE001
                keep_failure(name, f"another process cannot import it: {type(error).__name__}: {error}")
                continue
            # Not if its source has changed since.
            kernels |= {found.name: found}
        # A cache that was deleted meanwhile is not made again.
        if name in kernels and cache_folder().is_dir():
            yield name
