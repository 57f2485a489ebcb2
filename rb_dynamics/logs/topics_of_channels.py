"""`names_in_scene`: which recorded topic is which channel or actuator; `of_one_body`: those of one body."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from itertools import takewhile

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


def of_one_body(
    topics: Iterable[str], names: Iterable[str], motion: str, others: Iterable[str] = ()
) -> tuple[list[str], str]:
    """Return the topics that command the body whose motion is on `motion`, and why that cannot be told; "" if it can.

    Of topics of one name in several namespaces, the channel's own is the body's, else that whose namespace is nearest
    to that of the motion, unless another topic or a motion of another body, one of `others`, is nearer still. Bodies
    whose motions are a_pose and b_pose are in the namespaces a and b.
    """
    channels = sorted((name.removeprefix("/") for name in names), key=len, reverse=True)
    last = motion.rpartition("/")[2].rpartition("_")[2]
    bodies = [
        each.removesuffix(last)
        for each in (motion, *others)
        if motion.endswith(f"_{last}") and each.endswith(f"_{last}")
    ]

    def levels(topic: str) -> str:
        body = next((each for each in bodies if topic.startswith(each)), "")
        return f"{body[:-1]}/{topic.removeprefix(body)}" if body else topic

    def near(topic: str, other: str) -> int:
        return _shared(levels(topic), levels(other))

    alike: dict[str, list[str]] = defaultdict(list)
    for topic in topics:
        plain = levels(topic).removesuffix(APPLIED)
        fitting = (name for name in channels if f"/{plain}".endswith(f"/{name}"))
        alike[next(fitting, plain.rpartition("/")[2])].append(topic)
    kept, doubts = list[str](), list[str]()
    for name, group in alike.items():

        def rank(topic: str, name: str = name) -> tuple[bool, int]:
            return topic.removesuffix(APPLIED).removeprefix("/") == name in channels, near(topic, motion)

        best = [topic for topic in group if rank(topic) == max(map(rank, group))]
        foreign = [topic for topic in best if any(near(topic, each) > near(topic, motion) for each in others)]
        if own := [topic for topic in best if topic not in foreign]:
            # The others are those of a body in a namespace below this one.
            best, foreign = own, []
        nearer = [topic for topic in group if near(topic, motion) > near(best[0], motion)]
        kept += best
        if len(best) > 1 or foreign or nearer:
            either = " or ".join(best + nearer)
            doubts.append(f"cannot tell whether {either} commands the body of {motion or 'the scene'}")
    return kept, "; ".join([*doubts, "choose it with --wrench-topic TOPIC=CHANNEL"] if doubts else [])


def foreign_to(motion: str, topics: Iterable[str]) -> list[str]:
    """Return those of `topics` whose namespace has nothing in common with that of the motion."""
    return [each for each in topics if "/" in motion[1:] and "/" in each[1:] and not _shared(each, motion)]


def _shared(topic: str, other: str) -> int:
    """Return how many levels of their namespaces are the same."""
    levels = zip(*(each.removeprefix("/").split("/")[:-1] for each in (topic, other)), strict=False)
    return len([*takewhile(lambda pair: pair[0] == pair[1], levels)])
