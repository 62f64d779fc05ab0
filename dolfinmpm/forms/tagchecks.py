"""Checks for tags in a form that no point has, and for loaded points without a law."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formsigns import MARK
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import in_order, tags_in_use
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.forms.termqueries import brief, depends_on, operators_in, summands, tags_of

__all__ = ["TagChecks", "tags_by_term"]


@dataclass(frozen=True)
class TagChecks:
    """Terms, laws and fields of a form, and the tags of their points.

    Attributes:
        points: The material points.
        integrals: Integrals over the points, as the user wrote them.
        others: Names and tags of further terms; the names are for messages.
        declarations: Declarations of the laws at the points.
        spaces: Spaces of the increments.
        alone: Whether the only terms on the grid are ghost penalties.
        known: Tags whose points `check_new` has found to have laws.
    """

    points: MaterialPoints
    integrals: Sequence[Any]
    others: Sequence[tuple[str, Tags]]
    declarations: Sequence[Declaration]
    spaces: Sequence[Space]
    alone: bool
    known: set[int] = field(default_factory=set)

    @functools.cached_property
    def of_laws(self) -> list[Tags]:
        """Tags of each law and of each Space."""
        return [d.tags for d in self.declarations] + [s.tags for s in self.spaces]

    def check(self) -> None:
        """Refuse tags that match no point, and loads on points without a law. Collective.

        Raises:
            FormError: A tag matches no point, or loaded points have no law. The message names tags
                and term.
        """
        terms = tags_by_term(self.integrals)
        named = [*((f"the term '{brief(term)}'", tags) for term, tags in terms), *self.others]
        if not any((*self.of_laws, *(tags for _, tags in named))):
            return
        in_use = tags_in_use(self.points)
        # points with the tags of a law or a Space may be added later
        waiting = {tag for tags in self.of_laws for tag in tags or ()}
        for name, tags in named:
            if tags is not None and not set(tags) & (in_use | waiting):
                raise FormError(
                    f"{name} is for points with {in_words(tags)}, and no point has it: the points "
                    f"have the tags {in_order(in_use)}. Give one of these tags. If the points are "
                    "added later, add their law too, mpm.momentum(law, points, u, v, tag=...)"
                )
        if self.alone and self.declarations and not any(
            d.tags is None or set(d.tags) & in_use for d in self.declarations
        ):  # fmt: skip
            raise FormError(
                f"no point has a law: the laws are for {_all_of(self.declarations)}, and "
                f"the points have the tags {in_order(in_use)}"
            )
        self._check_loads(in_use)

    def check_new(self) -> None:
        """Refuse loads on points of new tags without a law, if `of_laws` has tags. Collective.

        The user may have set tags since, or added points.

        Raises:
            FormError: Loaded points have no law.
        """
        new = tags_in_use(self.points) - self.known
        self._check_loads(new)
        self.known.update(new)

    def _check_loads(self, tags: set[int]) -> None:
        """Refuse loads on points of some tags without a resisting term. Collective."""
        for tag in sorted(tags):
            for space in self.spaces:
                moves = space.increment.ufl_shape == (self.points.gdim,)
                if moves and _has(space.tags, tag):
                    self._check_load(tag, space)

    def _check_load(self, tag: int, space: Space) -> None:
        """Refuse a load on points of a tag without a resisting term. Collective if refused."""
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
                    # loads of a `Surface` act on few points and are not checked
                    load = term
        if load is None:
            return
        count = int(np.count_nonzero(self.points["tag"] == tag))
        count = self.points.comm.allreduce(count, op=MPI.SUM)
        raise FormError(
            f"the {count} points of tag {tag} have the load '{brief(load)}', and no law or other "
            "term of the form resists their motion: give them a law, mpm.momentum(law, points, "
            f"u, v, tag={tag}), or restrict the load to other points, points.dX(tag)"
        )


def tags_by_term(integrals: Iterable[Any]) -> Iterator[tuple[Expr, Tags]]:
    """Integrands, each once, with the tags of the points that integrate them."""
    # UFL makes one integral per tag
    found: dict[Expr, list[Tags]] = {}
    for integral in integrals:
        found.setdefault(integral.integrand(), []).append(tags_of(integral))
    for term, several in found.items():
        yield term, None if None in several else tuple(t for tags in several for t in tags or ())


def _has(tags: Tags, tag: int) -> bool:
    return tags is None or tag in tags


def _all_of(declarations: Sequence[Declaration]) -> str:
    return ", ".join(dict.fromkeys(in_words(d.tags) for d in declarations))
