"""Of what kept work is, so that long work goes on with its own and never with another's."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from compose.errors import UserError


def short_hash(identity: dict[str, Any]) -> str:
    """Twelve digits that tell identities apart in the names of files."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:12]


def require_same(found: dict[str, Any], ours: dict[str, Any], holds: str, advice: str) -> None:
    """Refuses work that was kept of something else.

    Args:
        found: the identity that was kept, as JSON gives it back.
        ours: of the work that is to go on.
        holds: what is kept, and where, for the message.
        advice: what may be done about it.

    Raises:
        UserError: the two differ; it names in what.
    """
    # Compared as JSON has it: tuples become lists.
    ours = json.loads(json.dumps(ours))
    differs = sorted(key for key in {*found, *ours} if found.get(key) != ours.get(key))
    if differs:
        raise UserError(f"{holds} with another {', '.join(differs)}; {advice}")
