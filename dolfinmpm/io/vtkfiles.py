"""VTK's files: arrays, pieces of the ranks, and the texts that list pieces and times.

VTK's parallel writers do not take over the lists. Without an MPI build of VTK, and its
wheels are none, theirs holds rank 0's piece only; with one it leaves out the units and the
components' names; and it is written in place, where a reader, or a run that is broken off,
meets half of it. There is no writer in VTK for the series.

VTKHDF would be one file for all times and ranks, and ParaView 5.13 of Debian 13 opens it. But it
has no place for units and names of components, and a run that is broken off in a write spoils all
times.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = [
    "Arrays",
    "index_text",
    "replace_file",
    "series_text",
    "vtk_cells",
    "vtk_points",
    "write_piece",
]

Arrays = dict[str, npt.NDArray[Any]]


def _vtk_array(values: npt.NDArray[Any], name: str, unit: str):
    """Values of shape (n, components) as VTK takes them, with their name and unit."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkDataArray

    array = numpy_to_vtk(values, deep=1)
    array.SetName(name)
    for component, label in enumerate(_labels(values)):
        array.SetComponentName(component, label)
    if unit:
        array.GetInformation().Set(vtkDataArray.UNITS_LABEL(), unit)
    return array


def vtk_points(x: npt.NDArray[np.float64]):
    """Positions (m), shape (n, 3), as VTK takes them."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints

    result = vtkPoints()
    result.SetData(numpy_to_vtk(x, deep=1))
    return result


def vtk_cells(connectivity: npt.NDArray[np.int64]):
    """Nodes of each cell, shape (cells, nodes of a cell), as VTK takes them."""
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    number, per_cell = connectivity.shape
    ends = numpy_to_vtkIdTypeArray(np.arange(number + 1) * per_cell, deep=1)
    result = vtkCellArray()
    result.SetData(ends, numpy_to_vtkIdTypeArray(connectivity.ravel(), deep=1))
    result.ConvertTo32BitStorage()
    return result


def write_piece(
    piece, path: Path, point_data: Arrays, cell_data: Arrays, units: Mapping[str, str]
) -> None:
    """Write the points or cells of a rank with their data.

    Args:
        piece: VTK's object.
        path: File to write, in .vtp or .vtu.
        point_data: Arrays of the points by name, shape (points, components).
        cell_data: Arrays of the cells by name, shape (cells, components).
        units: Units of arrays by name.

    Raises:
        OSError: The file cannot be written.
    """
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    for target, arrays in ((piece.GetPointData(), point_data), (piece.GetCellData(), cell_data)):
        for name, values in arrays.items():
            target.AddArray(_vtk_array(values, name, units.get(name, "")))
    writer = vtkXMLPolyDataWriter() if path.suffix == ".vtp" else vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(piece)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetHeaderTypeToUInt64()
    # zlib takes eight times longer to make floating-point numbers a fifth smaller
    writer.SetCompressorTypeToLZ4()
    # a failure is the caller's to tell, not VTK's
    writer.AddObserver("ErrorEvent", lambda *_: None)
    if not writer.Write() or writer.GetErrorCode():
        raise OSError(f"cannot write {path}; is the folder writable and the disk not full?")


def _labels(values: npt.NDArray[Any]) -> Sequence[str]:
    return {3: "xyz", 9: [i + j for i in "xyz" for j in "xyz"]}.get(values.shape[1], ())


_KINDS = {"f": "Float", "i": "Int", "u": "UInt"}


def _declared(name: str, values: npt.NDArray[Any], unit: str = "") -> str:
    kind = f"{_KINDS[values.dtype.kind]}{8 * values.dtype.itemsize}"
    labels = "".join(f' ComponentName{k}="{label}"' for k, label in enumerate(_labels(values)))
    key = '<InformationKey name="UNITS_LABEL" location="vtkDataArray">'
    key = f"{key}{escape(unit)}</InformationKey>" if unit else ""
    return (
        f'<PDataArray type="{kind}" Name="{escape(name)}" '
        f'NumberOfComponents="{values.shape[1]}"{labels}>{key}</PDataArray>'
    )


def index_text(
    kind: str, files: list[str], point_data: Arrays, cell_data: Arrays, units: Mapping[str, str]
) -> str:
    """Text of the file that lists the ranks' pieces, "vtp" or "vtu", and what is in them."""
    name = {"vtp": "PPolyData", "vtu": "PUnstructuredGrid"}[kind]
    lines = [
        '<?xml version="1.0"?>',
        f'<VTKFile type="{name}" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f'<{name} GhostLevel="0">',
    ]
    for section, arrays in (("PPointData", point_data), ("PCellData", cell_data)):
        declared = (_declared(key, values, units.get(key, "")) for key, values in arrays.items())
        lines += [f"<{section}>", *declared, f"</{section}>"]
    lines += ["<PPoints>", _declared("Points", np.empty((0, 3))), "</PPoints>"]
    lines += [f'<Piece Source="{escape(file)}"/>' for file in files]
    return "\n".join([*lines, f"</{name}>", "</VTKFile>", ""])


def series_text(times: Iterable[float], files: Iterable[str]) -> str:
    """Text of the file that lists the times."""
    sets = [
        f'<DataSet timestep="{time!r}" part="0" file="{escape(file)}"/>'
        for time, file in zip(times, files)
    ]
    head = '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">'
    lines = ['<?xml version="1.0"?>', head, "<Collection>", *sets, "</Collection>", "</VTKFile>"]
    return "\n".join([*lines, ""])


def replace_file(path: Path, text: str) -> None:
    """Write a file so that at no moment half of it is on disk."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
