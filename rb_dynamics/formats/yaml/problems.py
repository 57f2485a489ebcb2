"""Collects the problems of a scene, so that one error reports all of them."""

from __future__ import annotations

from rb_dynamics.errors import SceneError

MAX_REPORTED = 20


class Problems:
    """The problems found so far in one scene."""

    def __init__(self, source: str) -> None:
        """Start without problems; `source` is the file name at the beginning of messages."""
        self.source = source
        self._found: list[tuple[float, str]] = []

    def __bool__(self) -> bool:
        """Return whether there are problems."""
        return bool(self._found)

    @property
    def count(self) -> int:
        """Number of problems."""
        return len(self._found)

    def add(self, line: int | None, key: str, text: str) -> None:
        """Record a problem of the dotted `key` on `line`, or in an override if `line` is None."""
        place = "override" if line is None else str(line)
        message = f"{self.source}:{place}: {printable(key, 120) + ': ' if key else ''}{text}"
        self._found.append((float("inf") if line is None else line, message))

    def error(self) -> SceneError:
        """Return the error that lists them in the order of the file, one per line."""
        messages = [message for _, message in sorted(self._found, key=lambda found: found[0])]
        shown = messages[:MAX_REPORTED]
        if len(messages) > MAX_REPORTED:
            shown.append(f"{self.source}: and {len(messages) - MAX_REPORTED} more problems; correct these first")
        return SceneError("\n".join(shown))


def printable(text: str, limit: int = 60) -> str:
    """Return `text` on one line, quoted if it contains control characters, and cut at `limit`."""
    shown = text[: limit + 1]
    if not shown.isprintable():
        shown = ascii(shown)
    return shown if len(shown) <= limit else shown[:limit] + "..."
