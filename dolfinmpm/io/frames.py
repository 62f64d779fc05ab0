"""Frames of a film: the state of the points at one time, from a problem or from ParaView files."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import CheckpointError, ParameterError, call_together
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.io.gridlines import lines_of_boxes

__all__ = ["Frame", "Series", "is_derived", "present_frame"]

Array = npt.NDArray[Any]


@dataclass
class Frame:
    """What a picture of the points needs, on rank 0.

    Attributes:
        time: Time (s) or share of the load.
        x: Positions (m), shape (n, d).
        F: Deformation gradients within the section, shape (n, d, d).
        half: Half-lengths of the points' domains (m), shape (n, d).
        half0: Their first half-lengths (m), shape (n, d).
        values: The field to colour by, shape (n, ...).
        bodies: Facets of rigid bodies (m), each of shape (m, d, d).
        lines: Ends of the lines of leaves (m), shape (n, 2, 2), or None for those of the grid.
    """

    time: float
    x: Array
    F: Array
    half: Array
    half0: Array
    values: Array
    bodies: list[Array]
    lines: Array | None = None

    def edges(self, draw: str) -> Array:
        """Half-edges of the domains as columns, shape (n, d, d); undeformed for "domains"."""
        if draw == "domains":
            return self.half[:, None] * np.eye(self.x.shape[1])
        return self.F * self.half0[:, None]


def is_derived(points: MaterialPoints, colour: str) -> bool:
    """Whether a field to colour by is no field of the points, but follows from their positions."""
    return colour == "displacement" and colour not in points.fields


def present_frame(
    points: MaterialPoints, colour: str, bodies: Sequence[RigidBody], extent: Array,
    lines: Array | None = None, time: float = 0.0,
) -> Frame | None:  # fmt: skip
    """The frame of the present state, on rank 0; None on the others. Collective.

    Args:
        points: The points.
        colour: Field to colour by, or "displacement".
        bodies: Rigid bodies.
        extent: Lowest and highest coordinates of the grid (m), shape (gdim, 2).
        lines, time: See `Frame`.
    """
    derived = is_derived(points, colour)
    gathered = points.gather("x", "F", "l", "l0", "x0" if derived else colour)

    def made() -> Frame | None:
        if gathered is None:
            return None
        x, F, half, half0, values = gathered
        facets = [body.outline(*extent.T) for body in bodies]
        values = x - values if derived else values
        return Frame(time, x, in_section(points, F), half, half0, values, facets, lines)

    return call_together(points.comm, made)


class Series:
    """A series of the points that `ParaView` has written, read from its files.

    Args:
        path: The file of the series, which ends in .pvd.

    Attributes:
        gdim: Dimension of space.
        box: Lowest and highest coordinates of the grid (m), shape (gdim, 2).
        lines: Coordinates of the lines of a rectangular grid (m) per direction, or None.
        fields: Names of the fields.
        units: Unit per field.

    Raises:
        CheckpointError: The files are missing, or are no series of `ParaView`.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._entries = _entries(self.path)
        self._grids = _entries(self.path.with_name(f"{self.path.stem}_grid.pvd"))
        nodes = _array(_read(self._grids[0][1]).GetPoints().GetData())
        sizes = np.ptp(nodes, axis=0)
        self.gdim = max(1, int(np.count_nonzero(sizes > 1e-12 * sizes.max(initial=1e-300))))
        # nodes of one line differ by rounding
        size = sizes.max()
        nodes = np.round(nodes[:, : self.gdim] / size, 10) * size
        self.box = np.column_stack([nodes.min(axis=0), nodes.max(axis=0)])
        lines = [np.unique(nodes[:, d]) for d in range(self.gdim)]
        full = int(np.prod([len(line) for line in lines])) == len(np.unique(nodes, axis=0))
        self.lines = lines if full else None
        first = _read(self._entries[0][1]).GetPointData()
        self.fields = [first.GetArrayName(i) for i in range(first.GetNumberOfArrays())]
        self.units = {name: _unit(first.GetArray(name)) for name in self.fields}
        bodies = self.path.with_name(f"{self.path.stem}_bodies.pvd")
        self._bodies = _entries(bodies) if bodies.exists() else []

    def __len__(self) -> int:
        return len(self._entries)

    def frame(self, index: int, colour: str) -> Frame:
        """The frame of one time, with a field to colour by.

        Raises:
            ParameterError: The files have no such field, or not what a picture needs.
        """
        time, file = self._entries[index]
        data, d = _read(file), self.gdim
        fields = data.GetPointData()
        needed = ["F", "l", "l0"]
        missing = [name for name in [*needed, colour] if not fields.HasArray(name)]
        if missing:
            raise ParameterError(
                f"{self.path} has no field '{missing[0]}'; it has {', '.join(self.fields)}. Write "
                f"all fields, or fields=[{', '.join(map(repr, [*needed, colour]))}]"
            )
        F, half, half0 = (_array(fields.GetArray(name)) for name in needed)
        values = _array(fields.GetArray(colour))
        if values.ndim == 2 and values.shape[1] == 9:
            values = values.reshape(-1, 3, 3)
        elif values.ndim == 2 and values.shape[1] == 3:
            values = values[:, :d]
        x = _array(data.GetPoints().GetData())[:, :d]
        order = np.argsort(_array(fields.GetArray("id"))) if fields.HasArray("id") else slice(None)
        F = F.reshape(-1, 3, 3)[order, :d, :d]
        half, half0 = half[order, :d], half0[order, :d]
        facets, lines = self._facets(index), self._leaves(index)
        return Frame(time, x[order], F, half, half0, values[order], facets, lines)

    def _leaves(self, index: int) -> Array | None:
        """Lines of the leaves of one time in 2D, if the files have leaves."""
        if self.gdim != 2 or index >= len(self._grids):
            return None
        data = _read(self._grids[index][1])
        if not data.GetCellData().HasArray("level"):
            return None
        rows = _array(data.GetCells().GetConnectivityArray()).reshape(-1, 4)
        x = _array(data.GetPoints().GetData())[rows, :2]
        return lines_of_boxes(x.min(axis=1), x.max(axis=1))

    def _facets(self, index: int) -> list[Array]:
        if index >= len(self._bodies):
            return []
        data, d = _read(self._bodies[index][1]), self.gdim
        x = _array(data.GetPoints().GetData())[:, :d].reshape(-1, d, d)
        number = _array(data.GetCellData().GetArray("body"))
        return [x[number == k] for k in np.unique(number)]


def _entries(path: Path) -> list[tuple[float, Path]]:
    """Times and files of a .pvd file."""
    try:
        tree = ElementTree.parse(path)
    except (OSError, ElementTree.ParseError) as cause:
        raise CheckpointError(f"cannot read the series {path}: {cause}") from cause
    found = [
        (float(entry.get("timestep", "nan")), path.parent / entry.get("file", ""))
        for entry in tree.iter("DataSet")
    ]
    if not found:
        raise CheckpointError(f"the series {path} has no time; call write(time) first")
    return found


def _read(file: Path):
    """The data of a file of a series, of all its pieces."""
    from vtkmodules import vtkIOXML

    readers = {
        ".pvtp": vtkIOXML.vtkXMLPPolyDataReader,
        ".vtp": vtkIOXML.vtkXMLPolyDataReader,
        ".pvtu": vtkIOXML.vtkXMLPUnstructuredGridReader,
    }
    if file.suffix not in readers or not file.exists():
        raise CheckpointError(f"there is no file {file} of a ParaView series")
    reader = readers[file.suffix]()
    reader.SetFileName(str(file))
    reader.Update()
    return reader.GetOutput()


def _array(data) -> Array:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    return np.array(vtk_to_numpy(data))


def _unit(data) -> str:
    from vtkmodules.vtkCommonCore import vtkDataArray

    key = vtkDataArray.UNITS_LABEL()
    return data.GetInformation().Get(key) if data.GetInformation().Has(key) else ""
