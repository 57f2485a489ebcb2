"""`names_in_scene`: which recorded topic is which channel or actuator of a scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from rb_dynamics.logs.messages import APPLIED


def names_in_scene(
    topics: Iterable[str], names: Iterable[str], chosen: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the name in the scene of each recorded topic that has one.

    As `chosen`; else that of the topic, where a leading slash makes no difference; else that of the topic without its
    namespace, as /sat/wrench is wrench, if no other name and no other topic fits. What is logged as applied is no
    command.
    """
    given = {topic.removeprefix("/"): name.removeprefix("/") for topic, name in (chosen or {}).items()}
    open_names = {name.removeprefix("/"): name for name in names}
    open_topics = {topic.removeprefix("/"): topic for topic in topics if not topic.endswith(APPLIED)}
    found: dict[str, str] = {}

    def match(pairs: Iterable[tuple[str, str]]) -> None:
        for topic, name in pairs:
            if topic in open_topics and name in open_names:
                found[open_topics[topic]] = open_names[name]
        for topic, name in found.items():
            open_topics.pop(topic.removeprefix("/"), None)
            open_names.pop(name.removeprefix("/"), None)

    match(given.items())
    match((topic, topic) for topic in open_topics)
    fitting = [
        (topic, name)
        for topic in open_topics
        for name, written in open_names.items()
        if topic.endswith(f"/{name}") and not written.startswith("/") and "/effects/" not in f"/{topic}"
    ]
    often = Counter(each for pair in fitting for each in pair)
    match((topic, name) for topic, name in fitting if often[topic] == often[name] == 1)
    return found
