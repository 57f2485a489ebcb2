"""Versions of software in the metadata of a log."""

from __future__ import annotations

from importlib import metadata

from rb_dynamics.formats.log_metadata import version


def test_a_version_is_looked_up_once() -> None:
    # A run that begins asks for six; to read each from disk would cost more than to begin the run.
    assert version("numpy") == metadata.version("numpy")
    assert version("numpy") is version("numpy")
    assert version("no such package") == "not installed"
