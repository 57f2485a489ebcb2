"""`LogOptions`: the logs of a run that the command line or the node parameters ask for, and their sinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rb_dynamics.errors import LogError
from rb_dynamics.formats.output_file import require_apart, require_other
from rb_dynamics.sinks.mcap_sink import LogSettings
from rb_dynamics.sinks.sink_types import SinkOptions, sinks

if TYPE_CHECKING:
    from rb_dynamics.run.sink import Sink


@dataclass(frozen=True)
class LogOptions:
    """What to write; "" where a log is not asked for.

    Attributes:
        mcap: MCAP file.
        bag: rosbag2 folder, instead of `mcap`.
        rerun: Rerun recording.
        max_bag_size: bytes at which a bag begins its next file; 0: no bound.
        max_bag_duration: s of simulation time in one file of a bag; 0: no bound.
        settings: how MCAP is kept.
        named: further sinks, such as those of plug-ins, as NAME=TARGET.
        reads: files that the run reads, which no log may replace.
    """

    mcap: str = ""
    bag: str = ""
    rerun: str = ""
    max_bag_size: int = 0
    max_bag_duration: float = 0.0
    settings: LogSettings = field(default_factory=LogSettings)
    named: Sequence[str] = ()
    reads: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check that they go together.

        Raises:
            LogError: they do not.
        """
        if self.mcap and self.bag:
            raise LogError(f"found both mcap ({self.mcap}) and bag ({self.bag}), expected one; leave out one of them")
        bags = [text for text in self._asked if text.startswith("bag=")]
        if (self.max_bag_size or self.max_bag_duration) and not bags:
            raise LogError(
                "found max-bag-size or max-bag-duration without bag, expected a folder to split; give a bag instead of "
                "mcap"
            )
        targets = [*filter(None, (text.partition("=")[2] for text in self._asked))]
        require_apart(targets)
        for target in targets:
            require_other(target, *self.reads)

    @property
    def names(self) -> list[str]:
        """The outputs: files and folders, and the further sinks."""
        return [name for name in (self.mcap, self.bag, self.rerun, *self.named) if name]

    def sinks(self, namespace: str = "", remap: Mapping[str, str] | None = None) -> list[Sink]:
        """Return new sinks.

        Args:
            namespace: put before relative topic names.
            remap: absolute names of single topics, by relative name; they win over `namespace`.

        Raises:
            LogError: there is no sink of a name.
            PluginError: a sink is of a plug-in that cannot be loaded.
        """
        options = SinkOptions(namespace, remap, self.max_bag_size, self.max_bag_duration, self.settings)
        return sinks(self._asked, options)

    @property
    def _asked(self) -> list[str]:
        """All of them as NAME=TARGET."""
        ours = {"mcap": self.mcap, "bag": self.bag, "rerun": self.rerun}
        return [*(f"{name}={target}" for name, target in ours.items() if target), *self.named]
