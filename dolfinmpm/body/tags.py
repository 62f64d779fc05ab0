"""Tags that the points have, and arguments that name others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError

if TYPE_CHECKING:
    from dolfinmpm._platform.argumentchecks import Tags
    from dolfinmpm.body.boundary import Boundary
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["check_body_left", "check_in_use", "in_order", "tags_in_use"]


def tags_in_use(points: MaterialPoints) -> set[int]:
    """Tags that points of any rank carry. Collective."""
    return set().union(*points.comm.allgather(set(np.unique(points["tag"]).tolist())))


def in_order(tags: Iterable[int]) -> str:
    """Tags in a message."""
    return ", ".join(str(tag) for tag in sorted(tags))


def check_in_use(points: MaterialPoints, tags: Tags) -> None:
    """Raise ParameterError if no point has one of some tags. Collective.

    Args:
        points: Material points.
        tags: The tags, or None for all points.
    """
    if tags is None:
        return
    in_use = tags_in_use(points)
    if not set(tags) & in_use:
        raise ParameterError(
            f"tag = {tags[0] if len(tags) == 1 else tags}: no point has it; the points have the "
            f"tags {in_order(in_use)}"
        )


def check_body_left(points: MaterialPoints, tags: Tags, boundaries: Sequence[Boundary]) -> None:
    """Raise ParameterError if boundaries follow a body of which no point is left. Collective.

    Markers alone would make cells active that have neither stiffness nor mass.

    Args:
        points: Material points.
        tags: Tags of a field, or None for all points.
        boundaries: Boundaries in the terms of the field.
    """
    following = [one for one in boundaries if one.follows and one.activates]
    if tags is None or not following:
        return
    left = bool(np.isin(points["tag"], tags).any())
    if not points.comm.allreduce(left, op=MPI.LOR):
        raise ParameterError(
            f"no point has the tags {in_order(tags)} any longer, and {following[0]!r} follows "
            "these points: make a new problem without its terms, or add points before the next step"
        )
