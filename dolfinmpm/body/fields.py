"""Fields of the material points, as a weak form contains them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import floats, nearest, shown
from dolfinmpm._platform.errors import FieldShapeError, ParameterError, call_together
from dolfinmpm.grid.lattice import once_per_grid
from dolfinmpm.grid.userfunctions import call_function

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["PointField", "no_field", "space_at"]

_IN_TIME = "mpm.Newmark, mpm.GeneralisedAlpha or mpm.Explicit gives it to them when it is made"
_OF_LAW = "a law gives it to them when the problem is made"
_OF_WATER = "a problem gives it to them when it is made from a form of mpm.poromechanics"
_MAKERS = {
    "velocity": _IN_TIME,
    "acceleration": _IN_TIME,
    "velocity_moment": 'the mapping "apic" gives it to them when the problem is made',
    "velocity_gradient": 'the mapping "tpic" gives it to them when the problem is made',
    "plastic_strain": _OF_LAW,
    "preconsolidation_pressure": _OF_LAW,
    "pressure": _OF_WATER,
    "porosity": _OF_WATER,
    "J_bar": "mpm.momentum(..., fbar=True) gives it to them when the problem is made",
    "arc_increment": "mpm.ArcLength gives it to them when it is made",
    "effective_weight": "the body_force of an mpm.Deposit gives it to them",
    "seepage_force": "the body_force of an mpm.Deposit with a sloping water table gives it to them",
}


def space_at(points: MaterialPoints, shape: tuple[int, ...]) -> ufl.FunctionSpace:
    """What UFL takes for the space of values at the points, of a shape per point."""
    return _space_of_shape(points.grid, shape)


@once_per_grid
def _space_of_shape(grid: Mesh, shape: tuple[int, ...]) -> ufl.FunctionSpace:
    """See `space_at`: fields of one shape share their space, which takes long to make."""
    # degree 1: UFL would drop the gradient of a constant before a check can refuse it
    element = basix.ufl.element("DG", grid.topology.cell_name(), 1, shape=shape)
    return ufl.FunctionSpace(grid.ufl_domain(), element)


class PointField(ufl.Coefficient):
    """A field of the material points for UFL, in integrals over the points' measures.

    Attributes:
        name: Name of the field.
        unit: Unit.
        points: The material points.
        first: Value for points that join without a value: one value for all points, or a function
            of first positions (m), shape (gdim, n), that returns shape (n, *shape of the field).
    """

    def __init__(
        self,
        points: MaterialPoints,
        name: str,
        shape: tuple[int, ...],
        unit: str,
        first: Any = 0.0,
    ):
        super().__init__(space_at(points, shape))
        self.points = points
        self.name = name
        self.unit: str = unit
        self.first: Any = first

    @property
    def array(self) -> npt.NDArray:
        """The values on this rank, shape (points, *shape of the field)."""
        return self.points.fields[self.name]

    def first_values(self, x0: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """First values of points, shape (n, *shape of the field).

        Args:
            x0: First positions of the points (m), shape (n, gdim).

        Raises:
            FieldShapeError: The first value and the field have different shapes.
            ParameterError: A function fails, or returns another shape.
        """
        shape = self.ufl_shape
        if callable(self.first):
            return call_function(
                f"the first value of field '{self.name}'", self.first, x0, shape, True
            )
        given = floats(self.first)
        if given is None:
            raise FieldShapeError(
                f"field '{self.name}' has numbers of shape {shape} at a point, its first value is "
                f"{shown(self.first)}"
            )
        if given.shape not in ((), shape):
            raise FieldShapeError(
                f"field '{self.name}' has shape {shape} at a point, its first value {given.shape}"
            )
        return np.broadcast_to(given, (len(x0), *shape)).copy()

    def refuse_other(self, value: Any, always: bool) -> None:
        """Raise ParameterError for another first value, which would have no effect.

        Args:
            value: First value, see `first`. Collective if it is a function.
            always: Whether the same value is refused too.
        """
        x0, comm = self.points["x0"], self.points.comm
        other = PointField(self.points, self.name, self.ufl_shape, self.unit, value)

        def same() -> bool:
            return np.array_equal(other.first_values(x0), self.first_values(x0), equal_nan=True)

        if always or callable(self.first) != callable(value):
            alike = False
        elif callable(value):
            # functions may differ at the points of some ranks only
            alike = bool(comm.allreduce(call_together(comm, same), MPI.LAND))
        else:
            # a rank without points has no values to compare
            one = np.zeros((1, self.points.gdim))
            given, first = other.first_values(one), self.first_values(one)
            alike = np.array_equal(given, first, equal_nan=True)
        if not alike:
            raise ParameterError(
                f"the points have a field '{self.name}' already, and a first value would have no "
                f"effect: set points['{self.name}'] = ..."
            )

    # otherwise NumPy would make an array of objects from the components
    __array_ufunc__ = None

    def __mul__(self, other: Any) -> Any:
        """The product in UFL.

        Raises:
            ParameterError: `other` is a tuple, a list or an array; or the field is the density,
                and `other` is a vector of another dimension.
        """
        self._check_factor(other)
        return super().__mul__(other)

    def __rmul__(self, other: Any) -> Any:
        """See `__mul__`."""
        self._check_factor(other)
        return super().__rmul__(other)

    def _check_factor(self, other: Any) -> None:
        d = self.points.gdim
        if isinstance(other, (tuple, list, np.ndarray)) and np.ndim(other):
            raise ParameterError(
                f"{self} times {shown(other)}: UFL knows no tuples and arrays; write a constant, "
                f"g = dolfinx.fem.Constant(points.grid, {shown(other)}), whose value steps may "
                "change, or ufl.as_vector"
            )
        shape: tuple[int, ...] = getattr(other, "ufl_shape", ())
        if self.name == "density" and len(shape) == 1 and shape != (d,):
            raise ParameterError(
                f"points.density times a vector of {shape[0]} components, and the points are in "
                f"{d}D: give gravity {d} components (m/s²), the last one upwards"
            )

    def __str__(self) -> str:
        return f"points.{self.name}"


def no_field(name: Any, known: Iterable[str]) -> str:
    """Message about a field that points do not have: who makes it, and which they have.

    Args:
        name: Name that was asked for.
        known: Names that exist.
    """
    listed = list(known)
    text = f"material points have no field {shown(name)}; they have {', '.join(listed)}"
    if name == "displacement":
        return f"{text}. The displacement is points['x'] - points['x0']"
    if name in _MAKERS:
        return f"{text}. {_MAKERS[name]}; or add it before that with points.add_field"
    return text + nearest(name, listed, "'")
