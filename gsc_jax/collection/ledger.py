"""The ledger of a scan: which scene has a content, and how often it was begun.

One actor for the whole scan, so that a content is computed once wherever its copies are. It knows
attempts that no worker has survived, such as those on a node that disappeared.
"""

import dataclasses
from collections import Counter
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Claim:
    """Answer to a claim.

    Attributes:
        owner: Id of the scene that has this content already; None if the claim is granted.
        attempt: Number of the attempt, from 1.
    """

    owner: str | None = None
    attempt: int = 1


class Ledger:
    """Claims of the contents of scenes.

    Args:
        finished: Ids of finished scenes by key, of an earlier scan, the first one for each.
    """

    def __init__(self, finished: Mapping[str, list[str]]) -> None:
        self._finished = {key: set(ids) for key, ids in finished.items()}
        self._owners = {key: ids[0] for key, ids in finished.items()}
        self._begun: Counter[str] = Counter()
        self._slots: dict[str, dict[str, int]] = {}

    def claim(self, key: str, scene: str) -> Claim:
        """Claim a content for a scene; the same scene may claim again, as after a lost node."""
        if scene in self._finished.get(key, ()):
            return Claim(owner=scene)
        owner = self._owners.setdefault(key, scene)
        if owner != scene:
            return Claim(owner=owner)
        self._begun[key] += 1
        return Claim(attempt=self._begun[key])

    def slot(self, node: str, worker: str) -> int:
        """Number of a worker on its node, from 0; a restarted worker keeps it."""
        slots = self._slots.setdefault(node, {})
        return slots.setdefault(worker, len(slots))
