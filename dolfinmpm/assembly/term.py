"""The protocol of terms. Each kind of force is a `Term`, and nobody else knows it by name.

A term lives as long as its problem. In each step it makes an `ActiveTerm`: its forces as functions
of the nodal increments, on the cells that are active. A new kind of force is one file with these
two classes. Both have neutral defaults, so that a term writes only what it needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.body.location import Destinations
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation, ActiveDomain, ActiveField, Coupling
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.forms.declarations import Declaration

__all__ = ["ActiveTerm", "NewState", "Term", "as_form"]

Array = npt.NDArray[np.float64]


@dataclass
class NewState:
    """The state at the end of a step. It is computed first and written later, by `commit`.

    Attributes:
        fields: New values of the points' fields, by name.
        moves: Whether the points move.
        to: Where the points go, or None if they stay in their cells.
        markers: The same of the markers of boundaries: markers, new values, where they go.
        moved: Displacements of markers in the step (m), shape (markers, gdim), by the number of
            the markers.
    """

    fields: dict[str, Array]
    moves: bool = True
    to: Destinations | None = None
    markers: list[tuple[MaterialPoints, dict[str, Array], Destinations | None]] = field(
        default_factory=list
    )
    moved: dict[int, Array] = field(default_factory=dict)

    def of(self, markers: MaterialPoints) -> dict[str, Array]:
        """New values of the fields of some markers, which a term may add to."""
        return next(fields for one, fields, _ in self.markers if one is markers)


class ActiveTerm:
    """A term on an activation: forces as functions of the increments.

    Who calls what, in this order, in a step of `QuasiStatic` or `Newmark`:

    1. `Operator`, once: `external`.
    2. `Newton`, per residual: `move`, `internal`, and `stiffness` in the first one; per tangent
       also `tangent`. Contacts find their forces in `touch`, which `Operator` calls before both.
    3. `new_state`, at the end: `update`, and `follow` once it is known where the points go.

    Explicit steps call `renew` or `external`, `internal`, and 3. Contacts have further methods, see
    `dolfinmpm.contact.contactpoints.ActiveContact`.

    Attributes:
        kind: "points", "boundary", "grid", "contact", "springs" or "inertia"; sums of forces may
            leave out a kind.
        is_load: Whether its external forces are loads, whose work counts as external.
        stiffness: Blocks K that do not depend on the increments u: K u is added to the internal
            forces.
    """

    kind: str = "force"
    is_load: bool = True
    stiffness: Sequence[Blocks] = ()

    def renew(self) -> None:
        """Take DOLFINx constants and functions as they are now; `external` does so, too."""

    def external(self, out: Sequence[Array]) -> None:
        """Add the forces that do not depend on the increments.

        Args:
            out: Nodal forces (N), shape (nodes, components) for each field; the share of this rank.
        """

    def move(self, u: Sequence[Array]) -> None:
        """Take nodal increments, shape (nodes, components) for each field. Collective."""

    def internal(self, out: Sequence[Array]) -> bool:
        """Add the forces that depend on the increments, without K u.

        Args:
            out: See `external`.

        Returns:
            Whether every law found a stress.
        """
        return True

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """Add the derivative of `internal` to the matrix. Collective.

        Args:
            entries: The matrix, by the numbers of the row field and the column field.
        """

    def work_at_end(self) -> float:
        """Work of forces that it stores on the motion of an explicit step (J). Collective.

        The forces are those at the end of the step. Stress, contact and boundaries have theirs
        elsewhere, see `dolfinmpm.dynamics.energies`.
        """
        return 0.0

    def update(self, new: NewState) -> None:
        """Add what the points keep of the term at the end of the step."""

    def follow(self, new: NewState, step: int) -> None:
        """Add the state of what moves beside the points, such as markers. Collective.

        Args:
            new: The new state; where the points go is known.
            step: Number of the step, for messages.
        """


class Term:
    """A kind of force of a problem, and all that it keeps from step to step.

    Attributes:
        points: The material points that it acts on.
        integrand: Its symbol in a weak form, see `as_form`.
        kind: Its name in messages.
        layers: Layers of cells around the cells of a rank that the term looks at, at least.
        tags: Tags of the points that it acts on, or None for all.
        symmetric: Whether its tangent is symmetric.
        definite: Whether a positive definite tangent stays positive definite with this term.
        fusable: Whether fused explicit steps know it.
        holds_faces: Whether it resists a shift of the faces of points, F R.
    """

    points: MaterialPoints
    integrand: Expr
    kind: str = "term"
    layers: int = 0
    tags: Tags = None
    symmetric: bool = True
    definite: bool = True
    fusable: bool = False
    holds_faces: bool = False

    @property
    def sides(self) -> Sequence[tuple[Any, Any]]:
        """Boundaries whose markers it needs, each with the increment that moves it."""
        return ()

    @property
    def moving(self) -> set[int]:
        """Ids of its measures over active facets and cells, which change from step to step."""
        return set()

    @property
    def loads(self) -> list[Any]:
        """DOLFINx constants and functions in it, which steps take in parts."""
        return []

    def bind(self, declarations: Sequence[Declaration]) -> None:
        """Give points that came since the last call the fields that it keeps. Collective.

        Args:
            declarations: The laws of the form.
        """

    def start_in_time(self, weights: Any) -> None:
        """Act in steps in time: in the mean over a step, or with None at its start or end.

        Args:
            weights: See `dolfinmpm.contact.meanforces`.
        """

    def act(self, weights: Any, follows: bool | None) -> None:
        """Act as in the steps of one form, if several forms share the term.

        Args:
            weights: See `start_in_time`.
            follows: Whether gaps of contact are followed in time; None in steps without time.
        """

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """Blocks that are the same for a whole step, by their kind. Collective.

        Kinds are those of `Activation.blocks`, and "pattern" of what is assembled later.

        Args:
            fields: The active fields.
        """
        return {}

    def couple(self, here: ActiveDomain) -> list[Coupling]:
        """Which nodes it couples beside those that the points couple. Collective."""
        return []

    def on(self, here: Activation) -> ActiveTerm | None:
        """The term on an activation, or None if it has no forces there. Collective."""
        return None

    def rate(self, scaling: float) -> float:
        """Largest square of a frequency that it gives the body (1/s²). Collective.

        Args:
            scaling: Factor of the points' mass in their inertia.
        """
        return 0.0

    def energy(self) -> tuple[float, float]:
        """Energy that it stores, and work of its friction since the first step (J). Collective.

        Both are sums over all ranks. Contact with rigid bodies has none here, see `RigidBodies`.
        """
        return 0.0, 0.0

    def regrid(self) -> None:
        """Forget what belongs to the grid's lines, which have been placed anew."""

    def summary(self) -> str:
        """What it is, in some words for `print(problem)`."""
        return repr(self)

    def describe(self) -> str | None:
        """Its parameters, in words; a checkpoint tells where they differ."""
        return None

    def state(self) -> dict[str, Any]:
        """All that it keeps from step to step beside the points' fields, by name. Collective.

        Values are numbers, words, None or arrays that are the same on all ranks, or `Local` and
        `OfCells`, see `dolfinmpm.assembly.state`.
        """
        return {}

    def needed(self) -> list[str]:
        """Names that `set_state` cannot do without."""
        return []

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Take what `state` returned; values of a rank are missing if ranks differ. Collective."""


def as_form(term: Term, u: Any, v: Any) -> ufl.Form:
    """A term as a part of a weak form, to be added to the internal forces: F += ...

    Args:
        term: The term; `term.points` are the points that it acts on.
        u: Increment of the field that it acts on, `Space.increment`.
        v: Test function, `Space.test`.
    """
    # UFL needs an integrand. It is never evaluated: the metadata lead to the term
    term.integrand = ufl.inner(u, v)
    metadata = {**term.points.dX.metadata(), "term": term}
    return term.integrand * term.points.dX.reconstruct(metadata=metadata)
