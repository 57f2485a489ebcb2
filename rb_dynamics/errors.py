"""The errors that the package raises on purpose; each names what was found, what was expected and the remedy.

Programming errors must raise Python's own exceptions, with their traceback.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class RigidBodyError(Exception):
    """Base of all errors below; the command line prints it as one message and exits with code 2."""


class SceneError(RigidBodyError):
    """An invalid scene: the message names file, line, key, value, expectation and remedy."""


class BodyError(RigidBodyError):
    """Mass properties that no rigid body can have."""


class WrenchError(RigidBodyError):
    """A wrench command that is rejected: not finite, or in an undeclared frame."""


class ConvergenceError(RigidBodyError):
    """A step could not be solved or an accuracy could not be reached; names the step and the residual."""


class LogError(RigidBodyError):
    """A log or bag that cannot be read or written as asked."""


class PluginError(RigidBodyError):
    """A plug-in that was asked for cannot be loaded, or is not what its entry point promises."""


class MissingExtraError(RigidBodyError):
    """An optional dependency is not installed; names the extra that brings it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        """State which `package` is missing, the `extra` that installs it and the `purpose` it serves."""
        super().__init__(
            f"{purpose} needs the package {package!r}, which is not installed; install the extra {extra!r}: "
            f"pip install 'rb_dynamics[{extra}]', or '.[{extra}]' in the source tree"
        )


def did_you_mean(name: object, known: Iterable[str], otherwise: str) -> str:
    """Return a remedy for an unknown `name`: whether the nearest of `known` was meant, or `otherwise` if none is."""
    import difflib

    near = difflib.get_close_matches(str(name)[:60], list(known), n=1, cutoff=0.5)
    return f"did you mean {near[0]}?" if near else otherwise


@contextmanager
def needing(package: str, extra: str, purpose: str) -> Iterator[None]:
    """Say which extra brings `package` where an import in this context fails.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        yield
    except ImportError:
        raise MissingExtraError(package, extra, purpose) from None
