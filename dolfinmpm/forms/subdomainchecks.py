"""Checks of the subdomains of integrals over cells and facets of the grid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI

from dolfinmpm._platform.errors import FormError, call_together
from dolfinmpm.body.formsigns import FACETS
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS
from dolfinmpm.forms.termqueries import brief

__all__ = ["check_subdomains"]

_SYMBOLS = {"cell": "dx", "exterior_facet": "ds", "interior_facet": "dS"}


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
        for tag in _tags_of(integral):
            _check_tag(tag, data, term, kind, grid)


def _tags_of(integral: Any) -> Iterator[int]:
    given = integral.subdomain_id()
    for one in given if isinstance(given, tuple) else (given,):
        if not isinstance(one, str) and one not in (GHOST_FACETS, ACTIVE_CELLS):
            yield one


def _check_tag(tag: int, data: Any, term: str, kind: str, grid: Mesh) -> None:
    """Refuse a tag that no entity of the right dimension has. Collective."""
    here = call_together(grid.comm, lambda: _has(data, tag, term, kind, grid))
    if not grid.comm.allreduce(here, op=MPI.LOR):
        raise FormError(
            f"{term} is integrated over {_SYMBOLS[kind]}({tag}), and nothing has the tag {tag} in "
            "its subdomain data, on any rank: the term would vanish"
        )


def _has(data: Any, tag: int, term: str, kind: str, grid: Mesh) -> bool:
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
