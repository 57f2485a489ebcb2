"""Commands in this process: to start another for each would take longer than what they do."""

from __future__ import annotations

import contextlib
import io
from subprocess import CompletedProcess

from rb_dynamics.cli import main


def command(*arguments: object) -> CompletedProcess[str]:
    """Return what `rb-dynamics` with these arguments says, and its exit code; what it does not catch is raised."""
    words = [str(each) for each in arguments]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    return CompletedProcess(words, code, out.getvalue(), err.getvalue())
