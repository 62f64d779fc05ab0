"""Loads on the faces of points, with increments and test functions at the faces."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.term import Term
from dolfinmpm.basis.facestencils import at_faces
from dolfinmpm.basis.stencils import Stencils, all_pushed_forward, joined, selected
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.surface import Surface
from dolfinmpm.cut.activation import Activation, ActiveDomain, ActiveField, ActiveRegion
from dolfinmpm.cut.prolongation import Prolongation
from dolfinmpm.forms.declarations import LawConstant
from dolfinmpm.forms.splitting import SurfaceTerms

__all__ = ["SurfaceTerm", "face_stencils"]


def face_stencils(surface: Surface, field: ActiveField, here: ActiveDomain) -> Stencils:
    """Stencils of the faces of a surface, with the functions of a field at the faces.

    Args:
        surface: The surface.
        field: An active field.
        here: The activation.
    """
    points = surface.points
    reach = points[surface.offset.name]
    if not here.total:
        reach = np.einsum("pij,pj->pi", in_section(points, points["F"]), reach)
    chosen = np.any(points[surface.area.name] != 0.0, axis=1)
    s = selected(field.full_stencils, chosen)
    faces = at_faces(field.basis, s, here.where, reach, surface.within)
    return faces if field.C is None else Prolongation(field.C).stencils(faces)


class SurfaceTerm(Term):
    """Terms over the faces of points. The points' own terms couple all nodes of the faces.

    Args:
        of: The terms of the form.
    """

    def __init__(self, of: SurfaceTerms):
        self.surface, self.terms = of.surface, of.terms
        self.points = of.surface.points
        # the last activation and its stencils: a step makes several operators on one activation
        self._known: tuple[ActiveDomain | None, ActiveRegion | None] = None, None

    @property
    def loads(self) -> list[Any]:
        """See `Term`."""
        placeholders = self.terms.placeholders
        own = [c for c in placeholders.constants if not isinstance(c, LawConstant)]
        return own + [function for function, _ in placeholders.functions]

    def summary(self) -> str:
        """See `Term`."""
        return f"loads on '{self.surface.name}'"

    def on(self, here: Activation) -> Evaluation:
        """See `Term`."""
        known, region = self._known
        if region is None or known is not here:
            region = self._region(here)
            self._known = here, region
        found = Evaluation([self.terms], self.points, here.unknowns, [region])
        if self.follows:
            # as forces on a boundary that does not fit the grid: their work is that of a load
            found.kind = "boundary"
        return found

    @property
    def follows(self) -> bool:
        """Whether forces depend on the increments, as a pressure that follows the faces."""
        return self.terms.internal is not None

    def _region(self, here: ActiveDomain) -> ActiveRegion:
        """Stencils of the faces on an activation."""
        # fields with common stencils keep them common
        once: dict[tuple[int, int], Stencils] = {}
        keys = [(id(f.full_stencils), id(f.C)) for f in here.fields]
        for key, f in zip(keys, here.fields):
            if key not in once:
                once[key] = face_stencils(self.surface, f, here)
        stencils = joined([once[key] for key in keys])
        if here.total:
            points = self.points
            stencils = all_pushed_forward(stencils, in_section(points, points["F"]))
        within = [(f.basis.nodes, u.nodes) for f, u in zip(here.fields, here.unknowns.fields)]
        return ActiveRegion(stencils, None, within)
