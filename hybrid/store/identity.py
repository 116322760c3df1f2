"""Of what kept work is, so that nothing is put together that does not belong together."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from compose.base.errors import UserError

if TYPE_CHECKING:
    from pathtrace.dataset.frames import FrameSet
    from splat.model.forest import Forest


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


def require_scene(kept: Forest | FrameSet, name: str, digest: str, holds: object) -> None:
    """Refuses a forest or a frame set of another scene; an imported forest is bound to none.

    Args:
        kept: what is to be used.
        name, digest: of the scene that it is to be used with.
        holds: where it lies, for the message.

    Raises:
        UserError: it is one of another scene, or of the same at another path depth.
    """
    if kept.scene_hash in ("", digest):
        return
    changed = "; the scene has changed, or --max-depth is another one" if kept.scene_name == name else ""
    raise UserError(
        f"{holds} is one of scene {kept.scene_name} ({kept.scene_hash[:8]}), "
        f"not of {name} ({digest[:8]}){changed}"
    )
