"""Material points as a table: arrays of fields by name, one row per point, and UFL's symbols."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import array_of, shown
from dolfinmpm._platform.collective import check_same_call, collective
from dolfinmpm._platform.errors import (
    DolfinMPMError,
    FieldShapeError,
    ParameterError,
    UnknownNameError,
    call_together,
)
from dolfinmpm._platform.html import listing
from dolfinmpm._platform.readonce import set_by_user
from dolfinmpm._platform.uncopied import Uncopied
from dolfinmpm.basis import Placement
from dolfinmpm.body.axisymmetry import section
from dolfinmpm.body.familyids import ancestors_of
from dolfinmpm.body.fieldarrays import FieldArrays, checksums
from dolfinmpm.body.fields import PointField, no_field
from dolfinmpm.body.location import Destinations, migrate
from dolfinmpm.body.pointchecks import OF_STRAIN, astray, check_numbers, error_in_fields
from dolfinmpm.body.pointsymbols import PointSymbols

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["BUILT_IN", "PointTable"]

# Units of the fields that every point has. Fields of whole numbers cannot stand in a form.
BUILT_IN = {
    "x": "m",
    "x0": "m",
    "V": "m^d",
    "V0": "m^d",
    "density": "kg/m^d",
    "F": "",
    "l": "m",
    "l0": "m",
    "stress": "Pa",
}


class PointTable(Uncopied):
    """Fields of material points by name: their arrays on this rank, and their symbols for UFL.

    Args:
        grid: Background grid.
        axisymmetric: Whether the body is axisymmetric about x[0] = 0.

    Attributes:
        fields: Arrays by name, one row per point of this rank.
        symbols: Measures, constants and fields for UFL.
        total: Number of points on all ranks.
        revision: Number of changes of the rows of the arrays.
        configuration: Positions that give the cells and ranks, "updated" or "total"; see
            `use_configuration`.
    """

    def __init__(self, grid: Mesh, axisymmetric: bool):
        self.grid = grid
        self.axisymmetric = axisymmetric
        self.fields = FieldArrays()
        self.symbols = PointSymbols(grid)
        self.total = self.revision = self._next_id = 0
        self.configuration = "updated"
        self._located: tuple[float, ...] = ()

    def take_first(self, values: dict[str, npt.NDArray[Any]]) -> None:
        """Make the fields that every point has.

        Args:
            values: Values of "id", "cell", "tag", "x", "V", "l" and "density" on this rank, shape
                (n, ...).
        """
        n, e = len(values["x"]), self.strain_dim
        values |= {"x0": values["x"], "V0": values["V"], "l0": values["l"]}
        values |= {"F": np.broadcast_to(np.eye(e), (n, e, e)), "stress": np.zeros((n, 3, 3))}
        # strain formulation of the last step, see kinematics.strainhistory
        values["moved_under"] = np.zeros(n, np.int8)
        for name in ("id", "cell", "tag", "moved_under"):
            self.fields[name] = values[name]
        for name, unit in BUILT_IN.items():
            self.symbols.fields[name] = PointField(
                cast("MaterialPoints", self), name, values[name].shape[1:], unit
            )
            self.fields[name] = values[name].copy()
        self.fields.seal("V")

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the grid."""
        return self.grid.comm

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.grid.geometry.dim

    @property
    def strain_dim(self) -> int:
        """Dimension of deformation gradients, gdim or 3."""
        return 3 if self.axisymmetric else self.gdim

    # -- UFL's symbols --------------------------------------------------------

    @property
    def number(self) -> int:
        """Number of the points in the metadata of their measures."""
        return self.symbols.number

    @property
    def dX(self) -> ufl.Measure:
        """Measure over the points, with their first volume V0."""
        return self.symbols.dX

    @property
    def dx(self) -> ufl.Measure:
        """Measure over the points, with their volume V at the start of the step."""
        return self.symbols.dx

    @property
    def dS(self) -> ufl.Measure:
        """Measure over the facets of a ghost penalty."""
        return self.symbols.dS

    @property
    def dC(self) -> ufl.Measure:
        """Measure over the whole active cells."""
        return self.symbols.dC

    @property
    def dt(self) -> fem.Constant:
        """Time of the step's increments (s), a constant for UFL."""
        return self.symbols.dt

    @property
    def inertia(self) -> fem.Constant:
        """Derivative of the body's acceleration by the increment (1/s²), a constant for UFL."""
        return self.symbols.inertia

    @property
    def declarations(self) -> dict[int, Any]:
        """Declarations of laws in forms, see `PointSymbols`."""
        return self.symbols.declarations

    @property
    def laws(self) -> list[Any]:
        """Laws whose parameters vary from point to point."""
        return self.symbols.laws

    # -- rows and fields ------------------------------------------------------

    def __len__(self) -> int:
        return len(self.fields.read("id"))

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self.fields

    def __iter__(self) -> Iterator[str]:
        # without it, Python asks for points[0]; a loop over the names may add fields
        return iter(list(self.fields))

    def recount(self) -> None:
        """Count the points again after rows were added, removed or replaced. Collective."""
        ids = self.fields.read("id")
        self.total = self.comm.allreduce(len(ids), op=MPI.SUM)
        # children of points that split have numbers above all others
        highest = self.comm.allreduce(int(ancestors_of(ids).max(initial=-1)), op=MPI.MAX)
        # numbers of removed points are not used again
        self._next_id = max(self._next_id, highest + 1)
        self.revision += 1
        self.fields.seal("id")

    def add_field(
        self, name: str, shape: tuple[int, ...] = (), unit: str = "", value: Any = 0.0
    ) -> PointField:
        """Add a field, or return the existing field. Collective if the value is a function.

        Args:
            name: Name of the field.
            shape: Shape of the value at one point.
            unit: Unit.
            value: First value of all points, or a function of first positions (m), shape
                (gdim, n), that returns values of shape (n, *shape). Points that join the body
                later get the first value too.

        Raises:
            FieldShapeError: The existing field, or the first value, has another shape.
            ParameterError: The name is not possible, or a function does not return first values.
        """
        if not isinstance(name, str):
            raise ParameterError(f"name = {shown(name)} must be a word: it names a field")
        if not isinstance(shape, (tuple, list)) or not all(isinstance(n, int) for n in shape):
            raise ParameterError(
                f"shape = {shown(shape)} of field '{name}' must be a tuple: () for a number, "
                f"({self.gdim},) for a vector"
            )
        if not isinstance(unit, str):
            raise ParameterError(f"unit = {shown(unit)} of field '{name}' must be a word")
        shape = tuple(shape)
        if name in self.symbols.fields:
            if self.symbols.fields[name].ufl_shape != shape:
                raise FieldShapeError(
                    f"field '{name}' has shape {self.symbols.fields[name].ufl_shape} at a point, "
                    f"asked for {shape}; choose another name"
                )
            given = callable(value) or bool(np.any(np.not_equal(value, 0.0)))
            # laws ask for their fields once more, with values of their own
            if given and set_by_user(type(self), name):
                self.symbols.fields[name].refuse_other(value, name in BUILT_IN)
            return self.symbols.fields[name]
        if not name.isidentifier() or name in self.__dict__ or hasattr(type(self), name):
            raise ParameterError(f"'{name}' cannot name a field; use a new identifier")
        field = PointField(cast("MaterialPoints", self), name, shape, unit, value)

        def first():
            return field.first_values(self["x0"])

        if callable(value):
            check_same_call(self.comm, "MaterialPoints.add_field", name=name)
        # a function may fail at the points of some ranks only
        values = call_together(self.comm, first) if callable(value) else first()
        self.fields[name] = values
        self.symbols.fields[name] = field
        return field

    def __getattr__(self, name: str) -> PointField:
        # a copy has no symbols at first
        known = self.__dict__["symbols"].fields if "symbols" in self.__dict__ else {}
        try:
            return known[name]
        except KeyError:
            raise UnknownNameError(no_field(name, known)) from None

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        if not isinstance(name, str):
            raise UnknownNameError(
                f"points[{shown(name)}]: fields go by their names, one at a time, as in points['x']"
            )
        try:
            return self.fields[name]
        except KeyError:
            raise UnknownNameError(no_field(name, self.fields)) from None

    def __setitem__(self, name: str, values: npt.ArrayLike) -> None:
        """Set a field's values on this rank; a single value is for all points.

        The next step checks the values, and raises on all ranks if a density is negative, say.
        Setting "stress" or "id" is collective.

        Raises:
            FieldShapeError: The array has another shape.
            ParameterError: Values are no numbers, or no whole numbers for such a field; or they are
                stresses of points that have moved.
        """
        if not isinstance(name, str) or name not in ("stress", "id"):
            self._set(name, values)
            return
        # points of one rank alone may have moved, or may be fewer than the values
        check_same_call(self.comm, f"setting points['{name}']")
        old = self[name].copy()
        call_together(self.comm, lambda: self._set(name, values))
        if name == "id":
            check_numbers(self, old)

    def _set(self, name: str, values: npt.ArrayLike) -> None:
        target = self[name]
        if name == "cell":
            raise ParameterError(
                "'cell' cannot be set: it follows from the positions. Set points['x'], and call "
                "points.locate()"
            )
        if name == "stress" and np.isin(self.fields.read("moved_under"), OF_STRAIN).any():
            raise ParameterError(
                "'stress' cannot be set any more: the points have moved, and the next step "
                "computes it from their strain. Call mpm.set_stress(law, points, stress)"
            )
        if np.ma.is_masked(values):
            raise ParameterError(
                f"{np.ma.count_masked(values)} values for field '{name}' are masked, and each "
                "point needs one: fill them, as values.filled(0.0)"
            )
        given = array_of(f"points['{name}']", values)
        if not np.can_cast(given.dtype, target.dtype, "same_kind"):
            raise ParameterError(
                f"field '{name}' takes values of kind {target.dtype}, got {given.dtype}"
            )
        if given.shape not in (target.shape, target.shape[1:]):
            raise FieldShapeError(
                f"field '{name}' should have shape {target.shape} (this rank's points first) or "
                f"{target.shape[1:]} (one value for all), got {given.shape}"
            )
        target[:] = given

    def __setattr__(self, name: str, value: Any) -> None:
        # without this `points.density = 5000.0` would hide the field and change nothing
        if name in self.__dict__.get("fields", ()):
            self[name] = value
            return
        if name != "overlapping" and set_by_user(type(self), name):
            raise UnknownNameError(no_field(name, self.fields))
        super().__setattr__(name, value)

    def placement(self, configuration: str = "updated") -> Placement:
        """Positions and domains of the points for a basis.

        Args:
            configuration: "updated" for present positions, "total" for first positions.
        """
        x, half, volume = ("x0", "l0", "V0") if configuration == "total" else ("x", "l", "V")
        size = section(self, volume, x) if self.axisymmetric else self[volume]
        return Placement(self[x], self[half], size, self["cell"], self.axisymmetric)

    def error_in_fields(self) -> DolfinMPMError | None:
        """Error for an impossible value in the fields of this rank's points, or None."""
        error = error_in_fields(self)
        updated = self.configuration == "updated"
        if error is None and updated and self._located != (at := checksums(self.fields.read("x"))):
            # the user has changed x: steps locate the points that they move
            error = astray(self)
            self._located = at if error is None else ()
        return error

    def note_places(self) -> None:
        """Note that the points are in their cells."""
        self._located = checksums(self.fields.read("x"))

    def migrate(self, to: Destinations) -> int:
        """Move points to the ranks that compute their cells; returns their number. Collective."""
        moved = migrate(self, to)
        # in a total formulation, the present positions have no cells
        self.note_places()
        if moved:
            self.fields.seal("id")
        self.revision += moved > 0
        return moved

    @collective
    def gather(self, *names: str) -> tuple[npt.NDArray[Any], ...] | None:
        """Fields of all ranks in the order of `id`, on rank 0; None on other ranks. Collective.

        Args:
            names: Names of the fields.
        """
        pieces = self.comm.gather([self["id"], *(self[name] for name in names)], root=0)
        if pieces is None:
            return None
        order = np.argsort(np.concatenate([piece[0] for piece in pieces]))
        return tuple(
            np.concatenate([piece[k + 1] for piece in pieces])[order] for k in range(len(names))
        )

    def unit_of(self, name: str) -> str:
        """Unit of a field, or of "displacement"; "" for numbers without a unit."""
        if name == "displacement" and name not in self.fields:
            return "m"
        unit = getattr(getattr(self, name, None), "unit", "")
        return unit.replace("^d", f"^{self.strain_dim}")

    def _repr_html_(self) -> str:
        """Number of points, dimension and fields with their units, for notebooks."""
        units = {name: self.unit_of(name) for name in self.fields}
        fields = ", ".join(f"{name} ({unit})" if unit else name for name, unit in units.items())
        here = {"points on this rank": len(self), "dimension": self.gdim, "fields": fields}
        return listing(here, "material points")

    @collective
    def to_pyvista(self, *, deformed: bool = True) -> Any:
        """The points as a mesh of PyVista, with their domains as cells. Collective.

        All fields of the points and their displacement (m) are arrays of the cells; tensors have
        nine components, or those that they have.

        Args:
            deformed: Whether cells are the first domains, deformed by F. Else they are boxes with
                the half-lengths `l`.

        Returns:
            A `pyvista.UnstructuredGrid` of the points of all ranks on rank 0; None elsewhere.

        Raises:
            MissingPackageError: PyVista is not installed.
        """
        from dolfinmpm.body.pyvistamesh import of_points

        return of_points(cast("MaterialPoints", self), deformed=deformed)
