"""What a weak form sees of material points: measures, constants and fields."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm.body.formsigns import FACETS
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.serialnumbers import next_number

if TYPE_CHECKING:
    from dolfinmpm.body.fields import PointField

__all__ = ["ACTIVE_CELLS", "GHOST_FACETS", "UNSET", "PointSymbols"]

_numbers = itertools.count(1)

# Subdomain ids of the facets that ghost penalty acts on, and of the active cells.
GHOST_FACETS = 990_001
ACTIVE_CELLS = 990_002

# Length of a step (s) that nobody has set
UNSET = math.nextafter(1.0, 2.0)


class PointSymbols:
    """UFL's symbols of one set of points, and what laws in forms keep with them.

    Args:
        grid: Background grid.

    Attributes:
        number: Number of the points in the metadata of their measures.
        order: Number of the points among the points of their grid.
        dX, dx, dS, dC, dt, inertia: See `MaterialPoints`.
        fields: Fields by name.
        declarations: Data of the points that laws in forms need, by the number in the metadata of
            their measures.
        laws: Laws whose parameters vary from point to point, each with a field of its own.
    """

    def __init__(self, grid: Mesh):
        self.number, self.order = next(_numbers), next_number(grid, "points")
        domain = grid.ufl_domain()
        first, now = ({"points": self.number, "volume": volume} for volume in ("V0", "V"))
        self.dX = ufl.Measure("dc", domain=domain, metadata=first)
        self.dx = ufl.Measure("dc", domain=domain, metadata=now)
        # facets and cells themselves are found by the solver, which knows the active cells
        own = {FACETS: self.number}
        self.dS = ufl.Measure("dS", domain=domain, subdomain_id=GHOST_FACETS, metadata=own)
        self.dC = ufl.Measure("dx", domain=domain, subdomain_id=ACTIVE_CELLS, metadata=own)
        # length of a step in time (s), which whoever steps in time sets
        self.dt: fem.Constant = own_constant(grid, UNSET)
        self.inertia: fem.Constant = own_constant(grid, 0.0)
        self.fields: dict[str, PointField] = {}
        self.declarations: dict[int, Any] = {}
        self.laws: list[Any] = []
