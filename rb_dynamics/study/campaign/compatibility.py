"""Decide whether rows on disk belong to the same campaign, and if not, what differs.

Only the content of the campaign file counts, not its wording. The number of runs counts if runs depend on it: a Latin
hypercube is designed for it, while random and Sobol samples can be extended.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping

from rb_dynamics.errors import LogError, SceneError
from rb_dynamics.formats.log_metadata import version
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.study.campaign.model import Campaign

Facts = Mapping[str, str]
"""Stored with the rows: the texts of campaign and scene, the version of the package, and hashes of user modules."""

LAID_OUT = "latin_hypercube"
"""The sampling whose runs depend on the total number of runs."""

_SHOWN = 3


def facts_of(campaign: Campaign) -> Facts:
    """Return what the rows of `campaign` depend on; with `modules` if it uses user modules."""
    facts = {"campaign": campaign.text, "scene": campaign.scene_text, "version": version()}
    hashes = campaign.modules.hashes
    return facts | ({"modules": json.dumps(hashes, sort_keys=True)} if hashes else {})


def check_same(facts: Facts, place: str | os.PathLike[str], campaign: Campaign, remedy: str) -> None:
    """Check that rows with these `facts`, stored in `place`, belong to `campaign`; `remedy` ends the message.

    Raises:
        LogError: they do not; the message names what differs.
    """
    here = facts_of(campaign)
    if not isinstance(facts, dict) or not (here.keys() - {"modules"}) <= facts.keys():
        raise LogError(f"found no facts of a campaign in {place}, expected its rows; {remedy}")
    try:
        there, ours = _contents(facts), _contents(here)
    except (SceneError, TypeError, AttributeError, ValueError) as error:
        raise LogError(f"what {place} says of its campaign is damaged ({error}); {remedy}") from error
    found = [
        f"{key} is {there.get(key, 'absent')} there and {ours.get(key, 'absent')} here"
        for key in dict.fromkeys([*ours, *there])
        if there.get(key) != ours.get(key)
    ]
    if not found and list(there) == list(ours):
        return
    # Columns, and the assignment of random numbers to inputs, follow the order of the file.
    found = found or ["the keys are in another order"]
    if len(found) == 1 and found[0].startswith("runs is "):
        remedy = (
            "a Latin hypercube is designed for its number of runs and cannot be extended (random and sobol can); "
            f"do more runs with another --seed and --out, or {remedy}"
        )
    more = [f"{len(found) - _SHOWN} more"] if len(found) > _SHOWN else []
    raise LogError(f"{place} holds runs of another campaign: {', '.join(found[:_SHOWN] + more)}; {remedy}")


def _contents(facts: Facts) -> dict[str, str]:
    """Return the contents of campaign and scene as text, by dotted key."""
    campaign = document.parse(facts["campaign"], Problems("campaign")).value
    if not isinstance(campaign, dict):
        raise TypeError("no campaign in it")
    # The scene's text already contains what `scene` and `set` refer to.
    left_out = {"scene", "set"}
    if "sampling" not in campaign or campaign["sampling"].value != LAID_OUT:
        left_out.add("runs")
    kept = [(name, node) for name, node in campaign.items() if name not in left_out]
    said = {key: text for name, node in kept for key, text in _flat(node, name)}
    said |= _flat(document.parse(facts["scene"], Problems("scene")), "scene")
    hashes = json.loads(facts.get("modules", "{}"))
    said |= {f"the source of the module {name}": sha[:12] for name, sha in hashes.items()}
    return said | {"the version of rb_dynamics": facts["version"]}


def _flat(node: document.Node, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(node.value, dict):
        for name, item in node.value.items():
            yield from _flat(item, document.join(key, name))
    else:
        yield key, repr(document.plain(node)).removesuffix(".0")
