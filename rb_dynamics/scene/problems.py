"""Collects the problems of a scene, so that one error reports all of them."""

from __future__ import annotations

from rb_dynamics.errors import SceneError

MAX_REPORTED = 20


class Problems:
    """The problems found so far in one scene."""

    def __init__(self, source: str) -> None:
        """Start with none; `source` is the file name that messages begin with."""
        self.source = source
        self._found: list[tuple[float, str]] = []

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self._found)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._found)

    def add(self, line: int | None, key: str, text: str) -> None:
        """Note a problem of the dotted `key` on `line`, or in an override where `line` is None."""
        place = "override" if line is None else str(line)
        message = f"{self.source}:{place}: {printable(key, 120) + ': ' if key else ''}{text}"
        self._found.append((float("inf") if line is None else line, message))

    def error(self) -> SceneError:
        """Return the error that lists them in the order of the file, one on each line."""
        messages = [message for _, message in sorted(self._found, key=lambda found: found[0])]
        shown = messages[:MAX_REPORTED]
        if len(messages) > MAX_REPORTED:
            shown.append(f"{self.source}: and {len(messages) - MAX_REPORTED} more problems; mend these first")
        return SceneError("\n".join(shown))


def printable(text: str, limit: int = 60) -> str:
    """Return `text` on one line: as it stands, or quoted where it holds control characters; cut at `limit`."""
    shown = text[: limit + 1]
    if not shown.isprintable():
        shown = ascii(shown)
    return shown if len(shown) <= limit else shown[:limit] + "..."
