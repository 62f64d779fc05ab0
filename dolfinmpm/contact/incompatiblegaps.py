"""Gaps of contact that multipliers do not close, because the functions of the grid cannot.

Each part of a face that touches has a gap of its own. Where they are more than the functions of the
grid can follow, gaps of both signs stay, whatever the multipliers. These then grow against each
other without end, and the pressure alternates from part to part. So augmentation ends where the
penetration stays.
"""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Sequence
from typing import Any

from dolfinmpm._platform.errors import DoubtfulInputWarning, warn

__all__ = ["gaps_stay"]

# Augmentations that each leave more than this share of the penetration close nothing
_STAYS, _COUNT = 0.99, 3
# Contacts that have been told
_told: weakref.WeakSet[Any] = weakref.WeakSet()


def gaps_stay(contacts: Sequence[Any]) -> bool:
    """Whether all penetrations above their bounds stay, and warn once of each. Collective.

    Args:
        contacts: The contacts that exceed their bounds, see `ActiveContact`.
    """
    for active in contacts:
        last = active.depths[-_COUNT - 1 :]
        if len(last) <= _COUNT or any(b <= _STAYS * a for a, b in itertools.pairwise(last)):
            return False
    for active in contacts:
        contact, depth = active.contact, active.depths[-1]
        if contact in _told:
            continue
        _told.add(contact)
        power = 10.0 ** math.floor(math.log10(depth))
        corners = ", or leave surface= out" if getattr(contact, "surface", None) is not None else ""
        warn(
            contact.points.comm,
            f"{contact!r} has penetration = {contact.law.penetration:g} m, and parts of faces stay "
            f"{depth:.2g} m deep, because the functions of the grid follow them no closer. Steps "
            "are taken so, and pressures may alternate from part to part: give "
            f"penetration={math.ceil(2.0 * depth / power) * power:.0e}{corners}",
            DoubtfulInputWarning,
        )
    return True
