"""Points from arrays, tables and meshes."""

from __future__ import annotations

import basix
import meshio
import numpy as np
import pytest
from conftest import unit_grid
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    PointsOutsideGridError,
    UnsupportedGridError,
)

from_arrays = mpm.MaterialPoints.from_arrays


def some(d, n=40, seed=3):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.02, 0.98, (n, d)), rng.uniform(1e-3, 2e-3, n)


def test_arrays_on_every_kind_of_grid(any_grid):
    d = any_grid.geometry.dim
    x, volume = some(d)
    points = from_arrays(any_grid, x, volume, lambda x: 1 + x[0], tag=np.arange(40) % 3)
    order = np.lexsort(x.T[::-1])
    assert points.total == 40
    sorted_x, V, tag = points.gather("x", "V0", "tag")
    np.testing.assert_array_equal(sorted_x, x[order])
    np.testing.assert_array_equal(V, volume[order])
    np.testing.assert_array_equal(tag, order % 3)
    np.testing.assert_array_equal(points["density"], 1 + points["x"][:, 0])
    np.testing.assert_allclose(np.prod(2 * points["l"], axis=1), points["V"])
    assert np.ptp(points["l"], axis=1).max() < 1e-15
    assert points.error_in_fields() is None


def test_numbers_half_lengths_and_fields_may_be_given():
    x, volume = some(2)
    points = from_arrays(
        unit_grid("quadrilateral"), x, volume, 2.0, half_length=(0.01, 0.02),
        fields={"load": 3 * x, "water": x[:, 0] > 0.5}, id=np.arange(40)[::-1],
    )  # fmt: skip
    np.testing.assert_array_equal(points.gather("x")[0], x[::-1])
    np.testing.assert_array_equal(points["load"], 3 * points["x"])
    np.testing.assert_array_equal(points["water"], points["x"][:, 0] > 0.5)
    assert points.load.ufl_shape == (2,)
    np.testing.assert_array_equal(points["l0"], [[0.01, 0.02]] * 40)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"x": np.zeros((4, 3))}, FieldShapeError, r"\(n, 2\) on this grid of 2D, got \(4, 3\)"),
        ({"x": "abc"}, FieldShapeError, "x should be numbers"),
        ({"x": np.full((4, 2), np.nan)}, ParameterError, "x = .* of row 0, .* must be finite"),
        ({"x": np.full((4, 2), 0.5)}, ParameterError, "3 points .* in the place of another"),
        ({"x": np.arange(8.0).reshape(4, 2)}, PointsOutsideGridError,
         "3 points are outside the grid, the first of them point 1"),
        ({"x": []}, EmptyShapeError, "no rank gave a point"),
        ({"volume": [1, 2, 3, 0]}, ParameterError, "volume = 0.0 of row 3"),
        ({"volume": [1, 2]}, FieldShapeError, "volume should have shape"),
        ({"density": -1.0}, ParameterError, "density = -1.0 of row 0"),
        ({"density": lambda x: x}, ParameterError, "density should return numbers of shape"),
        ({"tag": -1}, ParameterError, "tag = -1"),
        ({"half_length": -0.1}, ParameterError, "half-lengths"),
        ({"id": [1, 2, 2, 3]}, ParameterError, "id = 2 is given to 2 points"),
        ({"id": [1.0, 2.0, 3.0, 4.0]}, ParameterError, "id should be whole"),
        ({"fields": {"V0": [1, 2, 3, 4]}}, ParameterError, "field 'V0' is one that all points"),
        ({"fields": {"load": [1, 2]}}, FieldShapeError, "field 'load' should have 4 rows"),
        ({"fields": {"dX": [1, 2, 3, 4]}}, ParameterError, "'dX' cannot name a field"),
    ],
)  # fmt: skip
def test_arrays_that_are_refused(changes, error, message):
    x = [[0.1, 0.1], [0.2, 0.4], [0.6, 0.1], [0.9, 0.9]]
    given = {"x": x, "volume": 1e-3, "density": 1.0, **changes}
    if callable(given["density"]):
        given["density"] = lambda x: x
    with pytest.raises(error, match=message):
        from_arrays(unit_grid("quadrilateral"), **given)


# -- tables -------------------------------------------------------------------

TABLE = """x, y, volume, density, tag, water
0.1, 0.1, 1e-3, 2000, 1, 5.5
0.9, 0.2, 2e-3, 1800, 2, 0

0.4, 0.8, 1e-3, 1800, 2, -1
"""


def test_a_table(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(TABLE, encoding="utf-8-sig")
    points = mpm.MaterialPoints.from_csv(unit_grid("triangle"), path)
    x, V, density, tag, water = points.gather("x", "V", "density", "tag", "water")
    # numbers are those of the lines
    assert x.tolist() == [[0.1, 0.1], [0.9, 0.2], [0.4, 0.8]]
    assert V.tolist() == [1e-3, 2e-3, 1e-3]
    assert density.tolist() == [2000, 1800, 1800]
    assert tag.tolist() == [1, 2, 2]
    assert water.tolist() == [5.5, 0, -1]
    path.write_text("x;y;volume;id\n0.1;0.2;0.1;7\n", encoding="utf-8")
    points = mpm.MaterialPoints.from_csv(
        unit_grid("triangle"), path, density=3.0, tag=4, delimiter=";"
    )
    assert points["id"].tolist() == [7]
    assert points["tag"].tolist() == [4]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("1800, 2, 0", "light, 2, 0", "line 3, column 'density': ' light' is not a number"),
        ("1800, 2, -1", "1800, 2.5, -1", "line 5, column 'tag': 2.5 is not a whole number"),
        ("1800, 2, -1", "1800, 2", "line 5: 5 columns, but the first line names 6"),
        ("volume", "size", "line 1: there is no column 'volume', only x, y, size"),
        ("density", "mass", "no column 'density', .* or give density="),
        ("water", "tag", "line 1: column 'tag' is named twice"),
        ("water", "z", "line 1: there is a column 'z', but the grid has 2 dimensions"),
        ("water", "", "a column has no name"),
        ("0.1, 0.1", "nan, 0.1", "x = .*nan.* of row 0"),
        ("water", "F", "field 'F' is one that all points have"),
    ],
)
def test_tables_that_are_refused(tmp_path, old, new, message):
    path = tmp_path / "points.csv"
    path.write_text(TABLE.replace(old, new), encoding="utf-8")
    with pytest.raises(ParameterError, match=message):
        mpm.MaterialPoints.from_csv(unit_grid("triangle"), path)


def test_tables_that_are_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        mpm.MaterialPoints.from_csv(unit_grid("triangle"), tmp_path / "none.csv")
    path = tmp_path / "points.csv"
    path.write_text("x,y,volume\n", encoding="utf-8")
    with pytest.raises(EmptyShapeError, match="no rank gave a point"):
        mpm.MaterialPoints.from_csv(unit_grid("triangle"), path, density=1.0)
    path.write_text(TABLE, encoding="utf-8")
    with pytest.raises(ParameterError, match="has a column 'density'"):
        mpm.MaterialPoints.from_csv(unit_grid("triangle"), path, density=1.0)
    path.write_text("x,y,volume,density,tag\n0.5,0.25,0.1,1.0,3\n", encoding="utf-8")
    with pytest.raises(ParameterError, match="has a column 'tag': leave the argument out"):
        mpm.MaterialPoints.from_csv(unit_grid("triangle"), path, tag=2)


# -- meshes -------------------------------------------------------------------

SQUARE = np.array([[0.1, 0.1], [0.6, 0.15], [0.7, 0.8], [0.1, 0.7]])


def shoelace(p):
    return 0.5 * abs(p[:, 0] @ np.roll(p[:, 1], -1) - p[:, 1] @ np.roll(p[:, 0], -1))


def two_soils():
    """A distorted quadrilateral and two triangles beside it, in two groups, with edges to skip."""
    nodes = np.vstack([SQUARE, [[0.9, 0.2], [0.9, 0.9]]])
    cells = [("line", [[0, 1]]), ("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 2], [4, 5, 2]])]
    groups = [np.array([9]), np.array([1]), np.array([2, 2])]
    flat = np.column_stack([nodes, np.zeros(len(nodes))])
    return meshio.Mesh(flat, cells, cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups})


@pytest.mark.parametrize(
    ("where", "degree"), [("centres", 2), ("quadrature", 1), ("quadrature", 4)]
)
def test_a_mesh_of_two_soils(tmp_path, where, degree):
    path = tmp_path / "soils.msh"
    two_soils().write(path, file_format="gmsh22", binary=False)
    points = mpm.MaterialPoints.from_mesh(
        unit_grid("quadrilateral"), path, {1: 2000.0, 2: 1800.0}, points=where, degree=degree
    )
    first = points["tag"] == 1
    assert set(points["tag"]) == {1, 2}
    assert points["V"][first].sum() == pytest.approx(shoelace(SQUARE), rel=1e-14)
    rest = shoelace(np.array([[0.6, 0.15], [0.9, 0.2], [0.9, 0.9], [0.7, 0.8]]))
    assert points["V"][~first].sum() == pytest.approx(rest, rel=1e-14)
    np.testing.assert_array_equal(points["density"], np.where(first, 2000.0, 1800.0))
    if where == "centres":
        assert points.total == 3
    if (where, degree) != ("quadrature", 1):
        V, x = points["V"][first], points["x"][first]
        np.testing.assert_allclose(V @ x / V.sum(), mpm.Polygon(SQUARE).centroid, rtol=1e-13)


@pytest.mark.parametrize("where", ["centres", "quadrature"])
@pytest.mark.parametrize("kind", ["line", "tetra", "hexahedron"])
def test_meshes_in_other_dimensions(kind, where):
    rng = np.random.default_rng(1)
    cell = {"line": basix.CellType.interval, "tetra": basix.CellType.tetrahedron,
            "hexahedron": basix.CellType.hexahedron}[kind]  # fmt: skip
    corners = np.array(basix.geometry(cell))
    d = corners.shape[1]
    if kind == "hexahedron":
        corners = corners[[0, 1, 3, 2, 4, 5, 7, 6]]
    corners = 0.2 + 0.5 * corners + 0.05 * rng.uniform(-1, 1, corners.shape)
    grid = unit_grid({1: "interval", 3: "hexahedron"}[d])
    given = meshio.Mesh(
        np.pad(corners, ((0, 0), (0, 3 - d))), [(kind, [list(range(len(corners)))])]
    )
    points = mpm.MaterialPoints.from_mesh(grid, given, 1.0, points=where, degree=2, tag=5)
    assert set(points["tag"]) == {5}
    # by very many quadrature points
    exact = mpm.MaterialPoints.from_mesh(grid, given, 1.0, degree=6)
    assert points["V"].sum() == pytest.approx(exact["V"].sum(), rel=1e-13)
    moments = [body["V"] @ body["x"] for body in (points, exact)]
    np.testing.assert_allclose(*moments, rtol=1e-12)


def test_meshes_that_are_refused(tmp_path):
    grid, soils = unit_grid("quadrilateral"), two_soils()

    def read(mesh=soils, density=1.0, on=grid, **options):
        return mpm.MaterialPoints.from_mesh(on, mesh, density, **options)

    with pytest.raises(ParameterError, match="points = 'corners' must be"):
        read(points="corners")
    with pytest.raises(ParameterError, match="degree = 0"):
        read(degree=0)
    with pytest.raises(ParameterError, match=r"degree = 3: .* negative weight"):
        read(meshio.Mesh(np.eye(4, 3) * 0.9, [("tetra", [[0, 1, 2, 3]])]), degree=3,
             on=unit_grid("hexahedron"))  # fmt: skip
    with pytest.raises(ParameterError, match="no value for the tag 2"):
        read(density={1: 5.0})
    with pytest.raises(
        UnsupportedGridError, match="no cells of the grid's 3 dimensions, only line"
    ):
        read(on=unit_grid("hexahedron"))
    with pytest.raises(UnsupportedGridError, match="do not lie in the first 2 coordinates"):
        read(meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])]))
    with pytest.raises(UnsupportedGridError, match="of the kind triangle6"):
        read(meshio.Mesh(np.zeros((6, 2)), [("triangle6", [[0, 1, 2, 3, 4, 5]])]))
    with pytest.raises(ParameterError, match="has no volume or is folded"):
        read(meshio.Mesh(SQUARE, [("quad", [[0, 2, 1, 3]])]))
    # whose volume is not 0 by rounding
    line = np.array([(0.1, 0.1), (0.3, 0.3), (0.6, 0.6)])
    with pytest.raises(ParameterError, match="has no volume or is folded"):
        read(meshio.Mesh(line, [("triangle", [[0, 1, 2]])]))
    with pytest.raises(PointsOutsideGridError, match="points are outside the grid"):
        read(meshio.Mesh(SQUARE * 1000, [("quad", [[0, 1, 2, 3]])]))
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read(tmp_path / "none.msh")
    (tmp_path / "text.msh").write_text("nothing\n")
    with pytest.raises(OSError, match="meshio cannot read"):
        read(tmp_path / "text.msh")
    assert MPI.COMM_WORLD.size == 1
