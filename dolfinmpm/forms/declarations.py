"""Declarations: data that a law in a form needs at the points.

A declaration is made with the form and bound with the problem. Building a form does not change the
points. The measures of a law's terms carry the number of its declaration in their metadata, which
survives UFL's transformations. A law's coefficients carry the declaration too. A problem collects
the declarations of its own form, and binds only these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.body.tags import tags_in_use

__all__ = [
    "Declaration",
    "ElasticResponse",
    "LawConstant",
    "LawField",
    "check_separate",
    "declared",
    "in_words",
    "rows_within",
    "subdomain",
]


def rows_within(points: MaterialPoints, tags: Tags) -> npt.NDArray[np.int32]:
    """Points of this rank with one of the tags, in increasing order, shape (n,); None means all."""
    if tags is None:
        return np.arange(len(points), dtype=np.int32)
    return np.flatnonzero(np.isin(points["tag"], tags)).astype(np.int32)


@dataclass(frozen=True)
class ElasticResponse:
    """Elastic response of a law at the points of its declaration.

    Attributes:
        energy: Function that returns the elastic energy per initial volume (J/m³), shape (n,), or
            None.
        stiffness: Function that returns the largest stiffness along one axis (Pa), shape (n,).
        moduli: Function that returns the P-wave modulus and the shear modulus (Pa), shape (n, 2)
            or (1, 2).
    """

    energy: Callable[[], npt.NDArray[np.float64] | None]
    stiffness: Callable[[], npt.NDArray[np.float64]]
    moduli: Callable[[], npt.NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Declaration:
    """A law in a form: its points, and its data at the points. "Its points" have its tags.

    Attributes:
        points: The material points.
        law: The law.
        u: The increment of the displacement, on which the stress depends.
        strain: Name of the strain formulation.
        fbar: Whether its points share volume changes over cells (F-bar). With "centres", each
            point counts only in the cell of its centre. With "volumes", the points keep the mean.
        tags: Tags of the points with this law; None means all points.
        given: Parameters of the law in UFL by name, if UFL computes the stress.
        operator: The `PointOperator` that computes the stress; None if UFL alone computes it.
        updates: Fields of its points, and UFL expressions for their values after a converged step.
        mark: Value for the field `moved_under` of its points after a converged step.
        bind: Function that prepares the points. It refuses points that have moved under another
            strain formulation, adds the law's fields, and gives first values to new points.
            It may be called again. Raises on all ranks together. Collective.
        parameters: Function that returns the parameters after binding, shape (1, parameters), or
            (points on this rank, parameters) if a parameter varies.
        elastic: Elastic response at its points.
        weaken: Function that divides the law's strength at its points by a factor, until it is
            called with None. None for laws without strength. Collective.
        terms: Integrands of the momentum terms that were made from the declaration.
    """

    points: MaterialPoints
    law: Any
    u: Any
    strain: str
    fbar: bool | str
    tags: Tags
    given: Mapping[str, Any]
    operator: Any
    updates: Mapping[str, Expr]
    mark: int
    bind: Callable[[], None]
    parameters: Callable[[], npt.NDArray[np.float64]]
    elastic: ElasticResponse
    weaken: Callable[[float | None], None] | None = None
    terms: list[Expr] = field(default_factory=list)

    @property
    def rows(self) -> npt.NDArray[np.int32]:
        """Numbers of its points on this rank, shape (n,)."""
        return rows_within(self.points, self.tags)

    def energy(self) -> npt.NDArray[np.float64] | None:
        """Elastic energy per initial volume at its points (J/m³), or None if not known."""
        return self.elastic.energy()

    def largest(self, name: str) -> float:
        """Largest value of a parameter over its points on all ranks. Collective.

        The value is 0 if the law has no such parameter. The declaration must be bound.

        Args:
            name: Name of the parameter.
        """
        if name not in self.law.values:
            return 0.0
        column = list(self.law.parameters).index(name)
        values = self.parameters()[:, column]
        return float(self.points.comm.allreduce(values.max(initial=-np.inf), op=MPI.MAX))

    def __str__(self) -> str:
        return f"{self.law!r} with {in_words(self.tags)}"


class LawConstant(fem.Constant):
    """A law's parameter in a form, the same at all points. New values compile nothing.

    Attributes:
        declaration: Declaration of the law; None until the declaration exists.
    """

    declaration: Declaration | None = None


class LawField(PointField):
    """A law's parameter in a form that varies from point to point.

    Attributes:
        declaration: Declaration of the law; None until the declaration exists.
    """

    declaration: Declaration | None = None


def subdomain(tags: Tags) -> Any:
    """Tags as the subdomain of a measure of points; "everywhere" for all points."""
    return "everywhere" if tags is None else tags if len(tags) > 1 else tags[0]


def in_words(tags: Tags) -> str:
    """Tags as text for messages."""
    if tags is None:
        return "tag=None, all points"
    return f"tag={tags[0] if len(tags) == 1 else tags}"


def declared(form: ufl.Form, points: MaterialPoints) -> list[Declaration]:
    """Declarations of the laws in a form, each once. Collective.

    Args:
        form: Weak form, as the user wrote it.
        points: Material points that the problem moves.

    Raises:
        FormError: Two laws, or two momentum terms, are for the same points.
    """
    found: list[Declaration] = []
    others: list[Declaration] = []
    seen: dict[int, set[Any]] = {}
    for integral in form.integrals():
        number = integral.metadata().get("law") if integral.metadata() else None
        if number is not None and integral.metadata().get("points") == points.number:
            # UFL makes one integral per tag: a repeated tag means a second term
            where = integral.subdomain_id()
            if number not in seen or where in seen[number]:
                found.append(points.declarations[number])
            seen.setdefault(number, set()).add(where)
        inside: Iterable[Any] = (
            *extract_coefficients(integral.integrand()),
            *extract_constants(integral.integrand()),
        )
        for one in inside:
            declaration = getattr(one, "declaration", None)
            if declaration is not None and declaration.points is points:
                others.append(declaration)
    for other in others:
        if not any(other is one for one in found):
            found.append(other)
    check_separate(found, tags_in_use(points))
    return found


def check_separate(declarations: Sequence[Declaration], in_use: Iterable[int]) -> None:
    """Refuse two laws on the same points.

    Args:
        declarations: Declarations of one form. A law with several momentum terms in the form has
            its declaration once per term.
        in_use: Tags of the points.

    Raises:
        FormError: Two declarations are for points of one tag; the message names both.
    """
    everywhere = set(in_use)
    for k, one in enumerate(declarations):
        for other in declarations[k + 1 :]:
            first, second = (everywhere if d.tags is None else set(d.tags) for d in (one, other))
            shared = first & second
            if shared or (one.tags is None and other.tags is None):
                raise FormError(
                    f"two terms of the form have a law on the same points: {one}, and {other}"
                    + (f" (points of tag {sorted(shared)} are in both)" if shared else "")
                    + ". A point has one stress: tag the points with mpm.fill(..., tag=...) or "
                    'points["tag"], and give each law its own tag, mpm.momentum(law, points, u, v, '
                    "tag=...); mpm.stress takes the same law, strain, fbar and tag as mpm.momentum"
                )
