"""Time series of material points and background grid for ParaView."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinmpm._platform import stages
from dolfinmpm._platform.argumentchecks import number, shown, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_on_root, call_together
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.basis.refinement import leaves_on, refinements_on
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.loadbalance import occupied
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbody import RigidBody, check_bodies
from dolfinmpm.io.gridmesh import GridMesh, leaf_mesh, padded
from dolfinmpm.io.ownership import refuse_other, refuse_part, take_paths
from dolfinmpm.io.paraviewrecipe import recipe_text
from dolfinmpm.io.vtkfiles import (
    Arrays,
    index_text,
    replace_file,
    series_text,
    vtk_cells,
    vtk_points,
    write_piece,
)

__all__ = ["ParaView"]


class ParaView(Unchanged):
    """Time series of the material points, and of the background grid, for ParaView.

    `output/column.pvd` is the series of the points, and `output/column_grid.pvd` is the series of
    the grid. Each series lists one index per time. The index lists one compressed piece per rank in
    the folder `output/column/`. Both series are complete after every write, so that ParaView opens
    the files of an interrupted run. Parent folders are created. Files of an earlier run are
    replaced. Collective: all ranks must create the writer.

    `output/column_paraview.py` is a program for ParaView. It shows the last time: the points as
    boxes 2 l wide with the colours of the first field, the grid as lines, the bodies.
    `pvpython column_paraview.py last.png` draws it, and `paraview --script=column_paraview.py`
    opens it.

    The points carry the following fields, where d is the dimension of space. Two components are
    padded to three, and 2 × 2 tensors to nine (with F_zz = 1 and the rest 0).

    =============  ==========  =======  =======================================
    name           components  unit     meaning
    =============  ==========  =======  =======================================
    id             1           -        number of the point
    displacement   3           m        x - x0
    x0             3           m        first position
    V, V0          1           m^d      volume, now and at first
    density        1           kg/m^d   mass per initial volume
    F              9           -        deformation gradient
    l, l0          3           m        half-lengths of the GIMP domain
    stress         9           Pa       Cauchy stress
    other fields   as it is    its own  of laws, contact, and `points.add_field`
    =============  ==========  =======  =======================================

    The unit is also in the file, as the array's UNITS_LABEL. The grid's cells carry
    `active`: 1 where a material point is in the cell, else 0. The cells of a refined space are its
    leaves, at every time. They also carry `level`: how often a cell of the grid is halved.

    Args:
        path: File of the points' series; ends in ".pvd".
        points: Material points.
        fields: Names of the points' fields to write; all fields by default. The internal variables
            of a law are fields with the names in `Law.internal`, once a problem has been made.
        increments: Lagrange or piecewise constant functions on the grid, such as
            `Space.increment` (m). They are written with `active` at every time. Without
            increments only the mesh is written, once. With increments the cells are those of the
            grid, where the increments have their nodes, also for a refined space.
        active: True writes the grid with `active` at every time, even without increments.
        bodies: Rigid bodies. Their facets are a separate series, `output/column_bodies.pvd`. The
            facets carry `body`, the number of the body in this list, and the `force` (N) and
            `moment` (N m) on the body.

    Raises:
        ParameterError: The path does not end in ".pvd", the points have no field of
            a given name, an increment cannot be written, or an argument has the wrong type.
        OSError: The folder or the file cannot be written.

    Each call of `write` adds a time:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> series = mpm.ParaView(folder / "block.pvd", points, fields=["displacement", "stress"])
    >>> series.write(0.0)
    >>> sorted(path.name for path in folder.iterdir())
    ['block', 'block.pvd', 'block_grid.pvd', 'block_paraview.py']
    """

    @collective
    def __init__(
        self,
        path: str | os.PathLike[str],
        points: MaterialPoints,
        *,
        fields: Sequence[str] | None = None,
        increments: fem.Function | Sequence[fem.Function] = (),
        active: bool = False,
        bodies: Sequence[RigidBody] = (),
    ):
        # report a missing package before a run, not at the first write
        import vtkmodules.vtkIOXML  # noqa: F401

        self.path = file_path("path", path)
        check_points(points)
        self.points = points
        self.comm = points.comm
        self._fields = _words("fields", fields)
        self._increments = _functions("increments", increments)
        self._leaves = bool(refinements_on(points.grid)) and not self._increments
        self._grid_each_time = truth("active", active) or bool(self._increments) or self._leaves
        check_bodies(bodies, points.gdim)
        self._bodies = list(bodies)
        self._times: list[float] = []
        call_together(self.comm, self._check_arguments)
        self._mesh = call_together(self.comm, lambda: GridMesh(points.grid, self._increments))
        call_together(self.comm, lambda: refuse_part(self._paths, self.path))
        self._on_root(self._write_series)
        self._on_root(self._write_recipe)
        take_paths(self, self._paths)

    def __enter__(self) -> ParaView:
        """The writer itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Do nothing: the files are complete after every write."""

    @collective
    @stages.output
    def write(self, time: float) -> None:
        """Write the present state of the points and of the grid. Collective.

        Args:
            time: Time (s), or share of the load; larger than at the last write.

        Raises:
            ParameterError: The time is not finite, or not after the last time. Or another series
                has begun at this path in the meantime.
            OSError: A file cannot be written.
        """

        def check() -> None:
            number("time", time)
            if self._times and time <= self._times[-1]:
                raise ParameterError(f"time = {time} must be after the last, {self._times[-1]}")
            for path in self._paths:
                refuse_other(self, path, "ParaView series")

        call_together(self.comm, check)
        count = len(self._times)
        self._write_points(f"points_{count:06d}")
        if self._grid_each_time or count == 0:
            self._write_grid(f"grid_{count:06d}")
        if self._bodies:
            self._on_root(self._write_bodies, count)
        self._times.append(float(time))
        self._on_root(self._write_series)

    @property
    def _folder(self) -> Path:
        return self.path.with_suffix("")

    @property
    def _paths(self) -> list[Path]:
        """The series of the points, of the grid and of rigid bodies."""
        endings = ["_grid"] + ["_bodies"] * bool(self._bodies)
        stem = self._folder.name
        return [self.path, *(self.path.with_name(f"{stem}{ending}.pvd") for ending in endings)]

    def _check_arguments(self) -> None:
        if self.path.suffix != ".pvd":
            raise ParameterError(f"the path of a ParaView series ends in .pvd, got '{self.path}'")
        known = [*self.points.fields, "displacement"]
        for name in self._fields or ():
            if name not in known:
                raise ParameterError(
                    f"material points have no field '{name}' to write; they have {', '.join(known)}"
                )
        names = [function.name for function in self._increments]
        for function in self._increments:
            if function.function_space.mesh is not self.points.grid:
                raise ParameterError(f"'{function.name}' lives on another grid than the points")
            if names.count(function.name) > 1:
                raise ParameterError(
                    f"{names.count(function.name)} increments are named '{function.name}'; "
                    "give each its own, as in u.name = 'displacement_increment'"
                )

    def _point_data(self) -> tuple[Arrays, dict[str, str]]:
        """The arrays to write, shape (points, components), and their units."""
        points = self.points
        names = self._fields
        if names is None:
            others = [name for name in points.fields if name not in ("id", "cell", "x")]
            names = ["id", "displacement", *others]
        arrays, units = {}, {}
        for name in names:
            derived = name == "displacement" and name not in points.fields
            values = points["x"] - points["x0"] if derived else points[name]
            arrays[name] = padded(values, 1.0 if name == "F" else 0.0)
            units[name] = points.unit_of(name)
        return arrays, units

    def _write_points(self, stem: str) -> None:
        from vtkmodules.vtkCommonDataModel import vtkPolyData

        piece = vtkPolyData()
        piece.SetPoints(vtk_points(padded(self.points["x"])))
        # without a vertex cell each, most filters would see no points
        piece.SetVerts(vtk_cells(np.arange(len(self.points))[:, None]))
        arrays, units = self._point_data()
        self._write(stem, "vtp", piece, arrays, {}, units)

    def _write_grid(self, stem: str) -> None:
        leaves = leaves_on(self.points.grid) if self._leaves else None
        if leaves is not None:
            mesh, cell_data = leaf_mesh(leaves, self.points)
            self._write(stem, "vtu", mesh, {}, cell_data, {})
            return
        point_data, cell_data = self._mesh.data(self._increments)
        if self._grid_each_time:
            active = np.zeros(self._mesh.cells, np.uint8)
            active[occupied(self.points)] = 1
            cell_data["active"] = active[:, None]
        self._write(stem, "vtu", self._mesh.vtk(), point_data, cell_data, {})

    def _write_bodies(self, count: int) -> None:
        """Write the facets of all bodies; for infinite bodies the facets within the grid."""
        from vtkmodules.vtkCommonDataModel import vtkPolyData

        d = self.points.gdim
        facets = [body.outline(*self._mesh.box) for body in self._bodies]
        x = np.concatenate([f.reshape(-1, d) for f in facets])
        piece = vtkPolyData()
        piece.SetPoints(vtk_points(padded(x)))
        cells = vtk_cells(np.arange(len(x)).reshape(-1, d))
        piece.SetLines(cells) if d == 2 else piece.SetPolys(cells)
        sizes = [len(f) for f in facets]
        turns = len(self._bodies[0].moment)
        data = {
            "body": np.repeat(np.arange(len(facets)), sizes)[:, None],
            "force": padded(np.repeat([b.force for b in self._bodies], sizes, axis=0)),
            "moment": np.repeat([b.moment for b in self._bodies], sizes, axis=0).reshape(-1, turns),
        }
        file = self._folder / f"bodies_{count:06d}.vtp"
        write_piece(piece, file, {}, data, {"force": "N", "moment": "N m"})

    def _write(self, stem, kind, piece, point_data: Arrays, cell_data: Arrays, units) -> None:
        """Write one piece per rank, and the index of all pieces on rank 0. Collective."""
        file = self._folder / f"{stem}_{self.comm.rank}.{kind}"
        call_together(self.comm, lambda: write_piece(piece, file, point_data, cell_data, units))
        files = [f"{stem}_{rank}.{kind}" for rank in range(self.comm.size)]
        index = index_text(kind, files, point_data, cell_data, units)
        self._on_root(replace_file, self._folder / f"{stem}.p{kind}", index)

    def _write_series(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        folder = self._folder.name
        grid_times = self._times if self._grid_each_time else self._times[:1]
        series = [
            (self._times, "points", "pvtp"),
            (grid_times, "grid", "pvtu"),
            (self._times, "bodies", "vtp"),
        ]
        for path, (times, stem, kind) in zip(self._paths, series):
            files = (f"{folder}/{stem}_{number:06d}.{kind}" for number in range(len(times)))
            replace_file(path, series_text(times, files))

    def _write_recipe(self) -> None:
        """Write the program that opens the series in ParaView, if the points have a field."""
        arrays, units = self._point_data()
        names = [name for name in arrays if name != "id"] or list(arrays)
        if not names:
            return
        size, d = arrays[names[0]].shape[1], self.points.gdim
        text = recipe_text(
            str(self._folder.parent.resolve()),
            self._folder.name,
            names[0],
            units[names[0]],
            {1: "", 9: 2 * "xyz"[d - 1]}.get(size, "Magnitude"),
            d < 3,
            boxes="l" in arrays,
            bodies=bool(self._bodies),
        )
        replace_file(self.path.with_name(f"{self._folder.name}_paraview.py"), text)

    def _on_root(self, action, *arguments) -> None:
        def act() -> None:
            try:
                action(*arguments)
            except OSError as cause:
                raise OSError(f"cannot write the series {self.path}: {cause}") from cause

        call_on_root(self.comm, act)


def _words(what: str, given: Any) -> list[str] | None:
    """Names of fields, one or several; None means the default fields."""
    if given is None:
        return None
    several = [given] if isinstance(given, str) else given
    if not isinstance(several, (list, tuple)) or not all(isinstance(w, str) for w in several):
        raise ParameterError(
            f"{what} = {shown(given)} must be names of the points' fields, such as "
            '["displacement", "stress"]'
        )
    return list(dict.fromkeys(several))


def _functions(what: str, given: Any) -> list[fem.Function]:
    """Functions on the grid, one or several."""
    several = [given] if isinstance(given, fem.Function) else given
    if not isinstance(several, (list, tuple)) or not all(
        isinstance(function, fem.Function) for function in several
    ):
        raise ParameterError(
            f"{what} = {shown(given)} must be functions on the grid, such as [Space.increment]"
        )
    return list(several)
