"""What a law in a form needs of the points: declared with the form, bound with the problem.

To build a form changes no body. Its measures carry the number of a declaration in
their metadata, which survive UFL's transformations, and so do a law's coefficients; a
problem collects the declarations of its own form and binds these only.
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

from dolfinmpm._platform.checks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.body.tags import tags_in_use

__all__ = [
    "Declaration",
    "LawConstant",
    "LawField",
    "check_separate",
    "declared",
    "in_words",
    "rows_within",
]


def rows_within(points: MaterialPoints, tags: Tags) -> npt.NDArray[np.int32]:
    """Which points of this rank carry one of the tags, in rising order; None means all."""
    if tags is None:
        return np.arange(len(points), dtype=np.int32)
    return np.flatnonzero(np.isin(points["tag"], tags)).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Declaration:
    """A law in a form: which points it is for, and what it keeps at them.

    Attributes:
        points: The material points.
        law: The law.
        u: The increment that it is a function of.
        strain: Its measure of strain.
        fbar: Whether its points share changes of volume over cells, or "centres" if each counts
            in the cell of its centre.
        tags: Tags of the points that it is for; None means all.
        given: Its parameters in UFL by name, where UFL computes its stress.
        operator: What computes its stress, a `PointOperator`; None if UFL alone does.
        updates: Fields of its points that a converged step sets to UFL expressions.
        mark: What a converged step writes to its points' field `moved_under`.
        bind: Makes the points ready: refuses those that have moved under another measure of
            strain, adds what the law keeps, and gives first values to points that have none.
            Called again it does what is left to do; raises on all ranks together. Collective.
        parameters: Gives its parameters once bound, shape (1, parameters), or (its points on
            this rank, parameters) if any varies.
        energy: Gives the elastic energy per initial volume at its points (J/m³), or None.
        stiffness: Gives the largest stiffness along one axis at its points (Pa).
        moduli: Gives the elastic P-wave and shear modulus at its points (Pa), shape (n, 2) or
            (1, 2).
        weaken: Divides the law's strength at its points by a factor, until it is called with None;
            None of laws that have no strength. Collective.
        terms: Integrands of the momentum terms that have been made of it.
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
    energy: Callable[[], npt.NDArray[np.float64] | None]
    stiffness: Callable[[], npt.NDArray[np.float64]]
    moduli: Callable[[], npt.NDArray[np.float64]]
    weaken: Callable[[float | None], None] | None = None
    terms: list[Expr] = field(default_factory=list)

    @property
    def rows(self) -> npt.NDArray[np.int32]:
        """Its points on this rank."""
        return rows_within(self.points, self.tags)

    def largest(self, name: str) -> float:
        """Largest value of a parameter over its points on all ranks; 0 if it has none. Collective.

        The declaration must be bound.
        """
        if name not in self.law.values:
            return 0.0
        column = list(self.law.parameters).index(name)
        values = self.parameters()[:, column]
        return float(self.points.comm.allreduce(values.max(initial=-np.inf), op=MPI.MAX))

    def __str__(self) -> str:
        return f"{self.law!r} with {in_words(self.tags)}"


class LawConstant(fem.Constant):
    """A law's parameter in a form, the same at all points: a new number compiles nothing.

    Attributes:
        declaration: Where it comes from; None until that exists.
    """

    declaration: Declaration | None = None


class LawField(PointField):
    """A law's parameter in a form where it varies from point to point.

    Attributes:
        declaration: Where it comes from; None until that exists.
    """

    declaration: Declaration | None = None


def in_words(tags: Tags) -> str:
    """Tags as messages show them."""
    if tags is None:
        return "tag=None, all points"
    return f"tag={tags[0] if len(tags) == 1 else tags}"


def declared(form: ufl.Form, points: MaterialPoints) -> list[Declaration]:
    """Declarations of the laws in a form, each once. Collective.

    Args:
        form: Weak form, as the user made it.
        points: Material points that the problem moves.

    Raises:
        FormError: Two laws, or two momentum terms, stand on the same points.
    """
    found: list[Declaration] = []
    others: list[Declaration] = []
    seen: dict[int, set[Any]] = {}
    for integral in form.integrals():
        number = integral.metadata().get("law") if integral.metadata() else None
        if number is not None and integral.metadata().get("points") == points.number:
            # UFL makes an integral of every tag; it is a second term that has the tag again
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
        declarations: Those of one form, in which a law's is repeated for every further
            momentum term that it has there.
        in_use: Tags that points carry.

    Raises:
        FormError: Two of them are for points of one tag; the message names both.
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
                    'points["tag"], and give each law its own, mpm.momentum(law, points, u, v, '
                    "tag=...); terms with mpm.stress take law, strain, fbar and tag of its momentum"
                )
