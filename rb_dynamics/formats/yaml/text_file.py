"""Read the text of a scene or campaign file, with a helpful error if a folder or a log was given instead."""

from __future__ import annotations

import os

from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml.document import MAX_CHARACTERS
from rb_dynamics.formats.yaml.problems import printable

_MCAP = b"\x89MCAP"


def read_text(path: str | os.PathLike[str], kind: str) -> str:
    """Return the text of the file `path`, which should contain a `kind`: a scene or a campaign.

    Raises:
        SceneError: the file cannot be read, is not UTF-8 text, or is too long.
    """
    source = os.fspath(path)
    shown = printable(source, 200) or "''"
    if os.path.isdir(source):
        raise SceneError(f"{shown}: found a folder, expected a {kind} in YAML; {_files_of(source)}")
    try:
        with open(source, "rb") as file:
            data = file.read(MAX_CHARACTERS + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(
            f"{shown}: found no readable file ({reason}), expected a {kind} in YAML; check the path"
        ) from error
    if data.startswith(_MCAP):
        raise SceneError(
            f"{shown}: found an MCAP log, expected a {kind} in YAML; look at the log with rb-dynamics inspect {shown}, "
            f"take its scene out with rb-dynamics convert {shown} scene.yaml, or give its commands to a scene with "
            f"--wrench {shown}"
        )
    if len(data) > MAX_CHARACTERS:
        raise SceneError(
            f"{shown}: found more than {MAX_CHARACTERS} bytes, expected a {kind} of at most that; "
            f"a {kind} is a short text, check that this is the right file"
        )
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{shown}: found a byte that is not UTF-8 at offset {error.start}, expected a text file; "
            f"check that this is a {kind} file, and save it as UTF-8"
        ) from error


def _files_of(folder: str) -> str:
    """Return a remedy that names a file of `folder` to give instead."""
    try:
        names = sorted(name for name in os.listdir(folder) if name.endswith((".yaml", ".yml")))
    except OSError:
        names = []
    usual = [name for name in names if name != "metadata.yaml"]
    if not usual:
        return "give the path of a file"
    return f"give a file in it, such as {printable(os.path.join(folder, usual[0]), 200)}"
