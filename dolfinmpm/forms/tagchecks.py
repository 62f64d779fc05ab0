"""Checks for tags that no point, cell or facet has, and for points without a law."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FormError, IdlePointsWarning, call_together, warn
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formsigns import FACETS, MARK
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS, MaterialPoints
from dolfinmpm.body.tags import in_order, tags_in_use
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.forms.termqueries import brief, depends_on, operators_in, summands, tags_of

__all__ = ["TagChecks", "check_subdomains", "tags_by_term"]

_SYMBOLS = {"cell": "dx", "exterior_facet": "ds", "interior_facet": "dS"}


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
        known: Tags whose points have been checked.
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

        Warns:
            IdlePointsWarning: Points without a load have no law, or no term of a field.
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
        self._check_fields(in_use)
        self.known.update(in_use)

    def check_new(self) -> None:
        """Check points of new tags, if `of_laws` has tags. Collective.

        The user may have set tags since, or added points.

        Raises:
            FormError: Loaded points have no law.
        """
        new = tags_in_use(self.points) - self.known
        self._check_fields(new)
        self.known.update(new)

    def _check_fields(self, tags: set[int]) -> None:
        """Check that points of some tags have terms of each field. Collective."""
        for tag in sorted(tags):
            for k, space in enumerate(self.spaces):
                if _has(space.tags, tag):
                    self._check_field(tag, k)

    def _check_field(self, tag: int, k: int) -> None:
        """Refuse a load on points without a resisting term; warn of points without terms."""
        space, load = self.spaces[k], None
        increments = [one.increment for one in self.spaces]
        moves = space.increment.ufl_shape == (self.points.gdim,)
        for integral in self.integrals:
            # loads and footings of a `Surface` act on few points
            if not _has(tags_of(integral), tag) or "surface" in integral.metadata():
                continue
            for term in summands(integral.integrand()):
                if not any(a == space.test for a in extract_arguments(term)):
                    continue
                laws = operators_in(term)
                if not moves:
                    return
                if depends_on(term, increments):
                    if not laws or any(_has(law.tags, tag) for law in laws):
                        return
                elif MARK not in integral.metadata():
                    load = term
        count = int(np.count_nonzero(self.points["tag"] == tag))
        count = self.points.comm.allreduce(count, op=MPI.SUM)
        if load is not None:
            raise FormError(
                f"the {count} points of tag {tag} have the load '{brief(load)}', and no law or "
                "other term of the form resists their motion: give them a law, mpm.momentum(law, "
                f"points, u, v, tag={tag}), or restrict the load to other points, points.dX(tag)"
            )
        if moves:
            text = (
                f"the {count} points of tag {tag} have no law, and are a hole in the body: give "
                f"them one, mpm.momentum(law, points, u, v, tag={tag}), or remove them, "
                f'points.remove(points["tag"] == {tag})'
            )
        else:
            text = (
                f"the {count} points of tag {tag} have no term of field {k + 1}, which no equation "
                f"determines there: give them one, such as mpm.poromechanics(..., tag={tag}), or "
                "make the field of other points only, mpm.Space(grid, ..., tag=...)"
            )
        warn(self.points.comm, text, IdlePointsWarning)


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


def check_subdomains(integrals: Sequence[Any], grid: Mesh) -> None:
    """Refuse subdomains over which nothing, or something else, would be integrated. Collective.

    Args:
        integrals: Integrals over cells and facets of the grid.
        grid: The grid.

    Raises:
        FormError: `points.dS` or `points.dC` is restricted; a tag has no subdomain data, or no
            cell or facet has it; the data are of entities of another dimension; or integrals of
            one kind have two sets of data, of which DOLFINx takes only one.
    """
    seen: dict[str, Any] = {}
    for integral in integrals:
        term, kind, data = (
            f"the term '{brief(integral.integrand())}'",
            integral.integral_type(),
            integral.subdomain_data(),
        )
        own = {"interior_facet": GHOST_FACETS, "cell": ACTIVE_CELLS}.get(kind)
        if FACETS in (integral.metadata() or {}):
            if data is not None or integral.subdomain_id() != own:
                name = "points.dS" if kind == "interior_facet" else "points.dC"
                raise FormError(
                    f"{term} restricts {name} to a subdomain; it integrates over all ghost facets "
                    "or active cells: multiply the integrand by a function of DG 0 that is 0 or 1"
                )
            continue
        if data is not None and seen.setdefault(kind, data) is not data:
            raise FormError(
                f"{term} has other subdomain data than another {kind} term of the form; put all "
                "tags of a kind into one MeshTags"
            )
        for tag in _tags_of_entities(integral):
            _check_tag(tag, data, term, kind, grid)


def _tags_of_entities(integral: Any) -> Iterator[int]:
    given = integral.subdomain_id()
    for one in given if isinstance(given, tuple) else (given,):
        if not isinstance(one, str) and one not in (GHOST_FACETS, ACTIVE_CELLS):
            yield one


def _check_tag(tag: int, data: Any, term: str, kind: str, grid: Mesh) -> None:
    """Refuse a tag that no entity of the right dimension has. Collective."""
    here = call_together(grid.comm, lambda: _has_entities(data, tag, term, kind, grid))
    if not grid.comm.allreduce(here, op=MPI.LOR):
        raise FormError(
            f"{term} is integrated over {_SYMBOLS[kind]}({tag}), and nothing has the tag {tag} in "
            "its subdomain data, on any rank: the term would vanish"
        )


def _has_entities(data: Any, tag: int, term: str, kind: str, grid: Mesh) -> bool:
    """Whether an entity of this rank has a tag."""
    symbol = _SYMBOLS[kind]
    if data is None:
        raise FormError(
            f"{term} is integrated over {symbol}({tag}), and no subdomain data tell where that "
            f'is: give them, ufl.Measure("{symbol}", domain=grid, subdomain_data=tags)({tag})'
        )
    if not isinstance(data, MeshTags):
        return any(int(number) == tag and len(entities) for number, entities in data)
    dim = grid.topology.dim - (kind != "cell")
    if data.dim != dim:
        raise FormError(
            f"{term} is integrated over {symbol}, and its subdomain data are tags of entities of "
            f"dimension {data.dim}: give tags of dimension {dim}"
        )
    return bool(np.any(data.values == tag))
