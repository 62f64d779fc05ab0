"""Bodies with fields of their own: which points belong to which of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.cut.activation import Field, movers
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["check_bodies", "refuse_bodies"]


def check_bodies(fields: Sequence[Field], form: WeakForm) -> None:
    """Raise unless each point is moved by one field, where fields have tags. Collective.

    Args:
        fields: Fields of a problem.
        form: Its weak form.

    Raises:
        ParameterError: The tags of two displacements meet, or points have none of them, or a field
            without tags would move points that others move.
    """
    spaces = [field.space for field in fields]
    if all(space.tags is None for space in spaces):
        return
    points = form.points
    shape = (points.gdim,)
    if spaces[0].tags is None and spaces[0].increment.ufl_shape == shape:
        return
    own = [(k, spaces[k].tags or ()) for k in movers(spaces)]
    for k, space in enumerate(spaces):
        if space.tags is None and space.increment.ufl_shape == shape:
            raise ParameterError(
                f"field {k + 1} is a displacement of all points, and others are of those of tags: "
                "give each a Space with the tags of its own points"
            )
    for at, (k, tags) in enumerate(own):
        for j, others in own[:at]:
            if set(tags) & set(others):
                raise ParameterError(
                    f"fields {j + 1} and {k + 1} both move the points of tag "
                    f"{min(set(tags) & set(others))}; give their Spaces tags that share the points"
                )
    every = [tag for _, tags in own for tag in tags]
    stray = np.flatnonzero(~np.isin(points["tag"], every))
    error = None
    if stray.size and own:
        p = stray[0]
        error = ParameterError(
            f"{stray.size} points, such as that of tag {points['tag'][p]} at {points['x'][p]} m, "
            f"are moved by no field; the fields' tags are {tuple(every)}: give one of the Spaces "
            "their tag too"
        )
    raise_together(points.comm, error)


def refuse_bodies(fields: Sequence[Field], what: str, instead: str) -> None:
    """Raise ParameterError where fields have tags.

    Args:
        fields: Fields of a problem.
        what: What knows no such fields.
        instead: What to do.
    """
    for k, field in enumerate(fields):
        if field.space.tags is not None:
            raise ParameterError(
                f"field {k + 1} is of points of the tags {field.space.tags}, and {what} has one "
                f"field for all points; {instead}"
            )
