"""ParaView series read back with VTK, and pictures read back as pixels."""

from __future__ import annotations

import gc
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDataArray
from vtkmodules.vtkIOXML import (
    vtkXMLPolyDataReader,
    vtkXMLPPolyDataReader,
    vtkXMLPUnstructuredGridReader,
)

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io import ParaView, figure, plot
from dolfinmpm.io.gridlines import grid_lines
from dolfinmpm.io.plots import label_of, scalar_of
from dolfinmpm.io.scene import _stretched

COMM = MPI.COMM_WORLD


@pytest.fixture
def folder(tmp_path):
    """One folder for all ranks."""
    return Path(COMM.bcast(str(tmp_path)))


def rectangle(n=(4, 3), corner=(2.0, 1.5), kind=mesh.CellType.quadrilateral):
    return mesh.create_rectangle(COMM, [(0, 0), corner], n, kind)


def quarter():
    """Points that fill a quarter of a square grid of 2 m, with fields that tell where they are."""
    points = mpm.fill(rectangle((4, 4), (2.0, 2.0)), mpm.Box((0, 0), (1, 1)), 2, 80.0)
    points["stress"][:, 1, 1] = -1e3 * points["x"][:, 0]
    points["x"][:, 0] += 0.01
    return points


def read(path):
    suffix = path.suffix
    reader = {
        ".vtp": vtkXMLPolyDataReader, ".pvtp": vtkXMLPPolyDataReader,
        ".pvtu": vtkXMLPUnstructuredGridReader,
    }[suffix]()  # fmt: skip
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def array(data, name):
    return vtk_to_numpy(data.GetArray(name))


def test_points_that_come_and_go_between_files(tmp_path):
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 1, density=1.0)
    with ParaView(tmp_path / "slope.pvd", points) as out:
        for k in range(3):
            out.write(k)
            points.remove(lambda x: x[0] < 0.25 * (k + 1))  # noqa: B023
    numbers = [read(file).GetNumberOfPoints() for file in listed(tmp_path / "slope.pvd")[1]]
    assert numbers == [20, 15, 10]


def listed(path):
    """Times and files of a series, each of which must exist."""
    sets = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    files = [path.parent / item.attrib["file"] for item in sets]
    assert all(file.is_file() for file in files)
    return [float(item.attrib["timestep"]) for item in sets], files


# -- ParaView -----------------------------------------------------------------


def test_points_are_read_back(folder):
    points = quarter()
    points.add_field("moisture", (), "kg/m^d", 3.5)
    points["F"][:, 0, 1] = 0.25
    path = folder / "new & old" / "soil.pvd"
    with ParaView(path, points) as out:
        out.write(0.5)
    times, files = listed(path)
    output = read(files[0])
    data = output.GetPointData()
    assert times == [0.5]
    assert output.GetNumberOfPoints() == output.GetNumberOfVerts() == points.total == 16
    x, x0 = vtk_to_numpy(output.GetPoints().GetData()), array(data, "x0")
    assert np.array_equal(np.sort(array(data, "id")), np.arange(16))
    np.testing.assert_allclose(x, x0 + np.array([0.01, 0, 0]))
    np.testing.assert_allclose(array(data, "displacement"), np.tile([0.01, 0, 0], (16, 1)))
    np.testing.assert_allclose(array(data, "stress")[:, 4], -1e3 * x0[:, 0])
    assert np.array_equal(array(data, "F"), np.tile([1, 0.25, 0, 0, 1, 0, 0, 0, 1.0], (16, 1)))
    assert np.all(array(data, "moisture") == 3.5)
    unit = vtkDataArray.UNITS_LABEL()
    assert data.GetArray("stress").GetInformation().Get(unit) == "Pa"
    assert data.GetArray("moisture").GetInformation().Get(unit) == "kg/m^2"
    assert data.GetArray("stress").GetComponentName(5) == "yz"
    assert not data.GetArray("x")
    assert not data.GetArray("cell")


def test_only_the_fields_asked_for(folder):
    points = quarter()
    ParaView(folder / "a.pvd", points, fields=["V"]).write(0.0)
    data = read(folder / "a" / "points_000000.pvtp").GetPointData()
    assert [data.GetArrayName(k) for k in range(data.GetNumberOfArrays())] == ["V"]


def test_series_is_complete_after_every_write(folder):
    points = quarter()
    out = ParaView(folder / "run.pvd", points, increments=mpm.Space(points.grid).increment)
    for number, time in enumerate((0.1, 0.2, 0.7)):
        assert len(listed(folder / "run.pvd")[0]) == number
        out.write(time)
    assert listed(folder / "run.pvd")[0] == listed(folder / "run_grid.pvd")[0] == [0.1, 0.2, 0.7]


def test_mesh_alone_is_written_once(folder):
    out = ParaView(folder / "run.pvd", quarter())
    out.write(1.0)
    out.write(2.0)
    assert listed(folder / "run.pvd")[0] == [1.0, 2.0]
    times, files = listed(folder / "run_grid.pvd")
    assert times == [1.0]
    assert read(files[0]).GetNumberOfCells() == 16


# four large triangles hold a quarter less than the box
@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.RoughShapeWarning")
@pytest.mark.parametrize("kind", ["interval", "triangle", "quadrilateral", "hexahedron"])
def test_grid_carries_increments_and_active_cells(folder, kind):
    grid = unit_grid(kind)
    d = grid.geometry.dim
    points = mpm.fill(grid, mpm.Box((0,) * d, (1,) * (d - 1) + (1 / 3,)), 1, 1.0)
    u = mpm.Space(grid).increment
    u.interpolate(lambda x: x[:d] * 2)
    p = fem.Function(fem.functionspace(grid, ("DG", 0)), name="middle")
    p.interpolate(lambda x: x[d - 1])
    ParaView(folder / "g.pvd", points, increments=[u, p]).write(1.0)
    output = read(folder / "g" / "grid_000000.pvtu")
    x = vtk_to_numpy(output.GetPoints().GetData())
    cells = grid.topology.index_map(d)
    np.testing.assert_allclose(array(output.GetPointData(), "increment"), 2 * x, atol=1e-14)
    assert output.GetNumberOfCells() == cells.size_global
    middle, active = (array(output.GetCellData(), name) for name in ("middle", "active"))
    height = [output.GetCell(k).GetBounds()[2 * d - 2 : 2 * d] for k in range(cells.size_global)]
    if kind != "triangle":
        np.testing.assert_allclose(middle, np.mean(height, axis=1))
    occupied = grid.comm.allreduce(len(np.unique(points["cell"])), op=MPI.SUM)
    assert active.sum() == occupied
    assert 0 < occupied < cells.size_global
    assert np.all(np.array(height)[active == 1, 0] < 1 / 3)


def test_quadratic_increment_keeps_its_nodes(folder):
    points = quarter()
    f = fem.Function(fem.functionspace(points.grid, ("Lagrange", 2)), name="f")
    f.interpolate(lambda x: x[0] ** 2)
    ParaView(folder / "q.pvd", points, increments=f).write(0.0)
    output = read(folder / "q" / "grid_000000.pvtu")
    x = vtk_to_numpy(output.GetPoints().GetData())
    assert len(np.unique(x.round(9), axis=0)) == 9 * 9
    np.testing.assert_allclose(array(output.GetPointData(), "f"), x[:, 0] ** 2, atol=1e-14)


def test_active_cells_without_increments(folder):
    out = ParaView(folder / "a.pvd", quarter(), active=True)
    out.write(0.0)
    out.write(1.0)
    _, files = listed(folder / "a_grid.pvd")
    assert [array(read(file).GetCellData(), "active").sum() for file in files] == [4, 4]


def test_no_points_make_an_empty_piece(folder):
    none = np.empty((0, 2))
    points = mpm.MaterialPoints(rectangle(), none, np.empty(0, np.int32), none[:, 0], none, 1.0)
    ParaView(folder / "none.pvd", points).write(0.0)
    for name in ("points_000000.pvtp", f"points_000000_{COMM.rank}.vtp"):
        output = read(folder / "none" / name)
        assert output.GetNumberOfPoints() == output.GetNumberOfVerts() == 0
    assert output.GetPointData().GetArray("stress").GetNumberOfComponents() == 9


@pytest.mark.parametrize(
    ("path", "options", "error", "message"),
    [
        ("a.vtu", {}, ParameterError, r"ends in \.pvd, got '.*a\.vtu'"),
        ("a.pvd", {"fields": ["stres"]}, ParameterError, "no field 'stres'.*stress"),
        ("file/a.pvd", {}, OSError, "cannot write .*a.pvd"),
    ],
)
def test_wrong_arguments(folder, path, options, error, message):
    if COMM.rank == 0:
        (folder / "file").write_text("no folder")
    COMM.barrier()
    with pytest.raises(error, match=message):
        ParaView(folder / path, quarter(), **options)


def test_wrong_increments(folder):
    points = quarter()
    u, p = mpm.Space(points.grid).increment, mpm.Space(points.grid, shape=()).increment
    with pytest.raises(ParameterError, match="2 increments are named 'increment'"):
        ParaView(folder / "a.pvd", points, increments=[u, p])
    p.name = "pressure"
    ParaView(folder / "a.pvd", points, increments=[u, p]).write(0.0)
    q = fem.Function(fem.functionspace(points.grid, ("Lagrange", 2)), name="q")
    with pytest.raises(ParameterError, match="'q' has other nodes than 'increment'"):
        ParaView(folder / "a.pvd", points, increments=[u, q])
    with pytest.raises(ParameterError, match="another grid"):
        ParaView(folder / "a.pvd", quarter(), increments=[u])


def test_two_series_have_paths_of_their_own(folder):
    """The later one has the path; the earlier one is told at its next write."""
    first = ParaView(folder / "a.pvd", quarter())
    first.write(0.0)
    second = ParaView(Path(os.path.relpath(folder)) / "a.pvd", quarter())
    second.write(0.0)
    with pytest.raises(ParameterError, match=r"another ParaView series writes .*a path of its own"):
        first.write(1.0)
    second.write(1.0)
    # the series of the grid beside it
    before = (folder / "a_grid.pvd").read_text()
    with pytest.raises(ParameterError, match=r"writes '.*a_grid\.pvd', which belongs to"):
        ParaView(folder / "a_grid.pvd", quarter(), active=True)
    assert (folder / "a_grid.pvd").read_text() == before
    second.write(2.0)
    # one that nobody has any more is replaced
    del first, second
    ParaView(folder / "a_grid.pvd", quarter()).write(1.0)


def test_two_histories_have_paths_of_their_own(folder):
    one, other = mpm.History(), mpm.History()
    one.record(load=1.0)
    other.record(load=2.0)
    one.write(folder / "curve.csv")
    one.write(folder / "curve.csv")
    with pytest.raises(ParameterError, match="another History writes"):
        other.write(folder / "curve.csv")
    other.write(folder / "other.csv")
    # one that is not there any more writes nothing
    del one
    gc.collect()
    other.write(folder / "curve.csv")
    assert mpm.study.read_table(folder / "curve.csv") == [{"load": 2.0}]


def test_a_history_that_nothing_reaches_any_more_holds_no_path(folder):
    """The names of a script that ended refer to each other until Python collects them."""
    script = "def run():\n    return history\n"
    for load in (1.0, 2.0):
        history = mpm.History()
        history.record(load=load)
        history.write(folder / "curve.csv")
        names = {"history": history}
        exec(script, names)
        del names, history
    assert mpm.study.read_table(folder / "curve.csv") == [{"load": 2.0}]


def test_times_must_increase_and_files_be_writable(folder):
    points = quarter()
    out = ParaView(folder / "a.pvd", points)
    out.write(1.0)
    for time in (1.0, 0.5, np.nan, "2", None, True, [2.0], points):
        with pytest.raises(ParameterError, match="time = "):
            out.write(time)
    COMM.barrier()
    if COMM.rank == 0:
        (folder / "a" / "points_000001_0.vtp").mkdir()
    COMM.barrier()
    with pytest.raises(OSError, match=r"points_000001_0\.vtp"):
        out.write(2.0)
    assert listed(folder / "a.pvd")[0] == [1.0]


# -- pictures -----------------------------------------------------------------


def pixels(path):
    return matplotlib.image.imread(path)[:, :, :3]


def test_picture_fills_the_area_of_the_body(folder):
    points = quarter()
    points["x"][:, 0] -= 0.01
    dpi = 100
    for draw in ("deformed", "domains"):
        path = folder / "new" / f"{draw}.png"
        plot(points, path, "density", draw=draw, grid=False, dpi=dpi)
        middle = matplotlib.colormaps["viridis"](0.5)[:3]
        coloured = np.all(np.abs(pixels(path) - middle) < 0.01, axis=2).sum()
        # the axes are as wide as 3.5 inch less the colour bar allow, 2.6, and square
        assert coloured == pytest.approx((2.6 * dpi / 2) ** 2, rel=0.02)


def test_narrow_column_is_stretched(folder):
    points = mpm.fill(rectangle((1, 64), (0.78, 50.0)), mpm.Box((0, 0), (0.78, 40)), 2, 80.0)
    plot(points, folder / "column.png", dpi=50)
    plot(points, folder / "thin.png", dpi=50, max_aspect=np.inf)
    column, thin = (pixels(folder / name).shape for name in ("column.png", "thin.png"))
    assert column[0] < 3 * column[1]
    assert thin[1] < column[1]
    factors, told = _stretched(np.array([[0, 0.78], [0, 50]]), 5.0)
    assert factors.tolist() == [20, 1]
    assert told == ["stretched 20×", ""]


@pytest.mark.parametrize("name", ["interval", "triangle", "distorted quadrilateral", "hexahedron"])
def test_all_grids_are_drawn(folder, name):
    grid = unit_grid(name)
    d = grid.geometry.dim
    points = mpm.fill(grid, mpm.Box((0,) * d, (1,) * d), 2, 1.0)
    cut = {"cut": ("y", 0.4)} if d == 3 else {}
    for k, options in enumerate(({}, {"view": "points", "title": "all", "draw": "dots", **cut})):
        plot(points, folder / f"{k}.png", "displacement", dpi=40, **options)
        assert pixels(folder / f"{k}.png").std() > 0.05
    if name == "triangle":
        lines = grid_lines(grid, None)
        grid.topology.create_entities(1)
        edges = grid.topology.index_map(1).size_global
        assert lines is None if COMM.rank else len(lines) == edges


def test_components():
    stress = np.zeros((2, 3, 3))
    stress[:, 1, 1] = [-4e3, 2e3]
    assert scalar_of(stress, "mises", 2)[0] == pytest.approx([4e3, 2e3])
    assert scalar_of(stress, "mean", 2)[0] == pytest.approx([-4e3 / 3, 2e3 / 3])
    assert scalar_of(stress, None, 2) == (pytest.approx([-4e3, 2e3]), "yy")
    assert scalar_of(stress, (0, 2), 3)[1] == "xz"
    vector = np.array([[3.0, 4.0]])
    assert scalar_of(vector, None, 2)[0] == pytest.approx([5.0])
    assert scalar_of(vector, 0, 2) == (pytest.approx([3.0]), "x")
    assert label_of("stress", "yy", "kPa") == r"stress $\sigma_{yy}$ (kPa)"
    assert label_of("plastic_strain", "", "") == r"$\mathrm{plastic\ strain}$"
    assert label_of("density", "", "kg/m^2") == r"$\mathrm{density}$ (kg/m$^{2}$)"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colour": "stres"}, "no field 'stres'"),
        ({"component": (0, 3)}, r"component = \(0, 3\) does not fit 'stress'"),
        ({"colour": "V", "component": "mises"}, "component = 'mises'"),
        ({"draw": "spheres"}, "draw = 'spheres'"),
        ({"cut": ("z", 0.1)}, "cut = .* for points in 3D"),
        ({"view": ((0, 1),)}, "view = "),
        ({"view": ((5, 6), (5, 6))}, "no material point is in the view"),
        ({"path": "picture"}, r"ends in \.png"),
        ({"path": "picture.xyz"}, r"ends in \.png, .*Matplotlib writes .*svg"),
    ],
)
def test_wrong_pictures(folder, options, message):
    arguments = {"path": folder / "a.png", **options}
    with pytest.raises(ParameterError, match=message):
        plot(quarter(), **arguments)
    assert not (folder / "a.png").exists()


def test_errors_of_matplotlib_reach_all_ranks(folder):
    with pytest.raises(ValueError, match="Unknown symbol"):
        plot(quarter(), folder / "a.png", title=r"$\nosuchsymbol$")


def test_figure_saves_in_one_look(folder):
    before = matplotlib.rcParams["font.size"]
    with figure(folder / "new" / "f.png", 3.0, 2.0, dpi=100, ncols=2) as (fig, axes):
        assert matplotlib.rcParams["font.size"] == 8
        axes[0].loglog([0.1, 1], [0.1, 1])
    COMM.barrier()
    height, width = pixels(folder / "new" / "f.png").shape[:2]
    assert 280 < width < 310
    assert 180 < height < 210
    assert matplotlib.rcParams["font.size"] == before
    assert len(fig.axes) == 2
