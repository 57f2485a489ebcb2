"""Find the laws and functions that a campaign names: those of this package, and user functions by dotted name."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from rb_dynamics.errors import RigidBodyError, SceneError
from rb_dynamics.study.campaign.user_modules import PACKAGE, UserModules

_PACKAGE = Path(__file__).parents[2]
_LONGEST_REASON = 300


class FunctionError(RigidBodyError):
    """A user function raised, or returned something else than the numbers expected of it: the run fails."""


def find_function(name: str, known: Mapping[str, Callable[..., Any]], modules: UserModules) -> Callable[..., Any]:
    """Return the `known` function `name`, or the function `module.function` of the user's `modules`.

    Raises:
        SceneError: there is no such module or function, or its module cannot be loaded.
    """
    if name in known:
        return known[name]
    module, dot, function = name.rpartition(".")
    if not dot:
        raise SceneError(f"found {name}, expected one of {', '.join(known)}, or module.function; correct the name")
    try:
        with _prints_to_stderr():
            found = getattr(modules.load(module), function)
    except (SceneError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise SceneError(
            f"found {name}, expected a function that can be imported ({_described(error)}); put its module beside the "
            "campaign file or install it, or correct it"
        ) from error
    if not callable(found):
        raise SceneError(f"found {name}, which is {found!r}, expected a function; correct the name")
    result: Callable[..., Any] = found
    return result


def _prints_to_stderr() -> contextlib.redirect_stdout[TextIO]:
    """Return the context in which what user code prints goes to stderr: stdout is for results, such as `--json`."""
    return contextlib.redirect_stdout(sys.stderr)


def called(what: str, function: Callable[..., Any], *arguments: object) -> Any:
    """Return the result of a user function.

    Raises:
        FunctionError: it raised.
        SceneError: it raised an error of the machine, not of the run.
    """
    try:
        with _prints_to_stderr():
            return function(*arguments)
    except KeyboardInterrupt:
        raise
    except (OSError, MemoryError) as error:
        raise SceneError(
            f"{what} raised {_described(error)}; what a law or a metric needs has to be there on every worker"
        ) from error
    except BaseException as error:
        raise FunctionError(f"{what} raised {_described(error)}") from error


def called_for_numbers(what: str, function: Callable[..., Any], *arguments: object) -> Any:
    """Return the result of a user function as an array of float64, NaN where it is masked.

    Raises:
        FunctionError: it raised, or returned what is not made of real numbers.
        SceneError: it raised an error of the machine, not of the run.
    """
    import numpy as np

    found = called(what, lambda: function(*arguments))
    values = called(what, lambda: np.asarray(found))
    # Converted, a complex number would silently lose a part, and a text would pass as a number.
    if values.dtype.kind not in "biufO":
        raise FunctionError(f"{what} returned values of type {values.dtype}, expected real numbers")
    numbers = called(what, lambda: values.astype(np.float64))
    # What is masked is unknown, whatever stands beneath.
    return np.where(np.ma.getmaskarray(found), np.nan, numbers) if np.ma.is_masked(found) else numbers


def _described(error: BaseException) -> str:
    """Return the message of `error` and where in the user's file it was raised, in one line."""
    text = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
    text = re.sub(rf"{PACKAGE}[0-9a-f]+\.", "", text)
    # The line of the user: what it calls, of this package too, may raise further in.
    frames = traceback.extract_tb(error.__traceback__)
    inner = [frame for frame in frames if "importlib" not in frame.filename and not _is_ours(frame.filename)]
    where = f", {os.path.basename(inner[-1].filename)}:{inner[-1].lineno}" if inner else ""
    return f"{text[:_LONGEST_REASON]}{where}"


def _is_ours(file: str) -> bool:
    return Path(file).is_relative_to(_PACKAGE)
