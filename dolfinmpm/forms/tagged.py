"""Tags in a form that no point has, and points that carry a load and have no law."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.acting import MARK
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import in_order, tags_in_use
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.forms.termqueries import brief, depends_on, operators_in, summands, tags_of

__all__ = ["Tagged", "tags_by_term"]


@dataclass(frozen=True)
class Tagged:
    """What of a form is for points of some tags only.

    Attributes:
        points: The material points.
        integrals: Integrals over the points, as they were given.
        others: Tags of further terms, with their names in messages.
        declarations: The laws at the points.
        spaces: Spaces of the increments.
        alone: Whether the form has no terms on the grid but ghost penalties.
    """

    points: MaterialPoints
    integrals: Sequence[Any]
    others: Sequence[tuple[str, Tags]]
    declarations: Sequence[Declaration]
    spaces: Sequence[Space]
    alone: bool

    @property
    def _of_laws(self) -> list[Tags]:
        return [d.tags for d in self.declarations] + [s.tags for s in self.spaces]

    def check(self) -> None:
        """Refuse tags that match nothing, and loads on points without a law. Collective.

        Raises:
            FormError: There are such; the message names tags and term.
        """
        terms = tags_by_term(self.integrals)
        named = [*((f"the term '{brief(term)}'", tags) for term, tags in terms), *self.others]
        if not any((*self._of_laws, *(tags for _, tags in named))):
            return
        in_use = tags_in_use(self.points)
        # points of a law's or a Space's tags may come later
        waiting = {tag for tags in self._of_laws for tag in tags or ()}
        for name, tags in named:
            if tags is not None and not set(tags) & (in_use | waiting):
                raise FormError(
                    f"{name} is for points with {in_words(tags)}, and no point has it: the points "
                    f"have the tags {in_order(in_use)}. Give one of them; for points that come "
                    "later give the form their law too, mpm.momentum(law, points, u, v, tag=...)"
                )
        if self.alone and self.declarations and not any(
            d.tags is None or set(d.tags) & in_use for d in self.declarations
        ):  # fmt: skip
            raise FormError(
                f"no point has a law: those of the form are for {_all_of(self.declarations)}, and "
                f"the points have the tags {in_order(in_use)}"
            )
        for tag in sorted(in_use):
            for space in self.spaces:
                moves = space.increment.ufl_shape == (self.points.gdim,)
                if moves and _has(space.tags, tag):
                    self._check_load(tag, space)

    def _check_load(self, tag: int, space: Space) -> None:
        """Refuse points of a tag that a load moves and nothing resists. Collective if refused."""
        increments, load = [one.increment for one in self.spaces], None
        for integral in self.integrals:
            if not _has(tags_of(integral), tag):
                continue
            for term in summands(integral.integrand()):
                if not any(a == space.test for a in extract_arguments(term)):
                    continue
                laws = operators_in(term)
                if depends_on(term, increments):
                    if not laws or any(_has(law.tags, tag) for law in laws):
                        return
                elif MARK not in integral.metadata():
                    # faces of a `Surface` are of few points: others have none
                    load = term
        if load is None:
            return
        count = int(np.count_nonzero(self.points["tag"] == tag))
        count = self.points.comm.allreduce(count, op=MPI.SUM)
        raise FormError(
            f"the {count} points of tag {tag} have the load '{brief(load)}', and no law or other "
            "term of the form resists their motion: give them a law, mpm.momentum(law, points, "
            f"u, v, tag={tag}), or restrict the load to the others, points.dX(tag)"
        )


def tags_by_term(integrals: Iterable[Any]) -> Iterator[tuple[Expr, Tags]]:
    """Integrands, each once, with the tags of the points that integrate them."""
    # UFL makes an integral of every tag
    found: dict[Expr, list[Tags]] = {}
    for integral in integrals:
        found.setdefault(integral.integrand(), []).append(tags_of(integral))
    for term, several in found.items():
        yield term, None if None in several else tuple(t for tags in several for t in tags or ())


def _has(tags: Tags, tag: int) -> bool:
    return tags is None or tag in tags


def _all_of(declarations: Sequence[Declaration]) -> str:
    return ", ".join(dict.fromkeys(in_words(d.tags) for d in declarations))
