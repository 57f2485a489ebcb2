"""Every error the package raises on purpose; each says what was found, what was expected and what to do.

Never raised for programming mistakes: those stay Python's own exceptions, with their traceback.
"""

from __future__ import annotations


class RigidBodyError(Exception):
    """Base of all errors below; the command line prints it as one message and exits with code 2."""


class SceneError(RigidBodyError):
    """A scene file does not say what it has to say: names file, line, key, value, expectation and remedy."""


class BodyError(RigidBodyError):
    """Mass properties that no rigid body can have."""


class WrenchError(RigidBodyError):
    """A wrench command that cannot be honoured: not finite, or in a frame nobody declared."""


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
