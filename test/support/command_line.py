"""Run commands in this process, since starting another one takes longer than most commands."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from functools import partial
from subprocess import CompletedProcess

from rb_dynamics.cli import main


def called(main: Callable[[Sequence[str]], int], *arguments: object) -> CompletedProcess[str]:
    """Return output and exit code of a command; uncaught exceptions are raised."""
    words = [str(each) for each in arguments]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    return CompletedProcess(words, code, out.getvalue(), err.getvalue())


command = partial(called, main)
