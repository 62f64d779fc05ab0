"""What explicit steps keep from call to call."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinmpm.dynamics.snapshot import Snapshot

__all__ = ["CallMemory"]


@dataclass
class CallMemory:
    """What explicit steps keep from call to call.

    Attributes:
        state: What a run goes back to.
        moment: End of the last call, since when fields may have been changed; see `FieldArrays`.
            None if all count as changed.
        critical: Critical step that was found last (s).
        since: Steps that have been taken since.
        single: Whether the last call took one step. Only steps of one call each share a critical
            step with those of other calls: a call of many finds its own.
    """

    state: Snapshot
    moment: int | None = None
    critical: float = math.nan
    since: int = 0
    single: bool = False
