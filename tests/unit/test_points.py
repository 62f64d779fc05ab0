"""Material points: their fields, bodies joined, points that come and go between steps."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FieldShapeError, ParameterError, PointsOutsideGridError


def lower_and_upper(grid=None, **options):
    if grid is None:
        grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    lower = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, density=2.0, tag=1, **options)
    upper = mpm.fill(grid, mpm.Box((0, 0.5), (1, 1)), 2, density=3.0, tag=2, **options)
    return lower, upper


def test_fields_keep_their_shape():
    points = mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    points.add_field("load", (2,), "N/m^2")
    points["load"] = (1.0, 2.0)
    assert points["load"].shape == (len(points), 2)
    assert points.load.ufl_shape == (2,)
    with pytest.raises(FieldShapeError, match="should have shape"):
        points["load"] = np.zeros((3, 3))
    with pytest.raises(FieldShapeError, match="has shape"):
        points.add_field("load", (3,))
    with pytest.raises(KeyError, match="no field 'temperature'"):
        points["temperature"]
    with pytest.raises(AttributeError, match="no field 'temperature'"):
        points.temperature  # noqa: B018
    with pytest.raises(ParameterError, match="cannot name a field"):
        points.add_field("dX")


def test_gather_sorts_by_id():
    points = mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    rows = points.gather("id", "x")
    if MPI.COMM_WORLD.rank == 0:
        assert rows is not None
        assert np.array_equal(rows[0], np.arange(points.total))


def test_setting_an_attribute_sets_the_field():
    points, _ = lower_and_upper()
    points.density = 5000.0
    np.testing.assert_array_equal(points["density"], 5000.0)
    assert points.density.ufl_shape == ()
    points.tag = 7
    np.testing.assert_array_equal(points["tag"], 7)
    with pytest.raises(FieldShapeError, match="should have shape"):
        points.x = np.zeros((3, 3))
    with pytest.raises(ParameterError, match="kind int32, got float64"):
        points.tag = 1.5
    with pytest.raises(ParameterError, match="kind float64, got <U5"):
        points["density"] = "heavy"


def arguments(**changes):
    """Of `MaterialPoints`: two points in the cells of a square of 2 × 2."""
    grid = mesh.create_unit_square(MPI.COMM_SELF, 2, 2, mesh.CellType.quadrilateral)
    x = np.array([[0.2, 0.2], [0.7, 0.8]])
    cell = np.array([0, 3], np.int32)
    given = {"x": x, "cell": cell, "volume": [0.01, 0.02], "half_length": np.full((2, 2), 0.05)}
    return (grid,), {**given, "density": 1.0, **changes}


def test_the_constructor_takes_what_is_right():
    grid, given = arguments()
    points = mpm.MaterialPoints(*grid, **given, id=[7, 3], tag=[0, 4])
    assert points["id"].tolist() == [7, 3]
    assert points["tag"].tolist() == [0, 4]
    assert points.total == 2


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"half_length": np.full((2, 2), -0.05)}, ParameterError, "half-lengths = .* not negative"),
        ({"half_length": np.full((2, 2), np.nan)}, ParameterError, "half-lengths = .* finite"),
        ({"half_length": np.full((2, 2), 30.0)}, ParameterError, "does not fit into the grid"),
        ({"half_length": np.full((2, 3), 0.1)}, FieldShapeError, "half_length should have shape"),
        ({"volume": [0.01, -0.02]}, ParameterError, "volume = -0.02 .* positive and finite"),
        ({"volume": [0.01]}, FieldShapeError, "volume should have shape"),
        ({"volume": ["a", "b"]}, FieldShapeError, "volume should be numbers"),
        ({"cell": np.array([0])}, FieldShapeError, "cell should have shape"),
        ({"cell": np.array([0.0, 3.0])}, ParameterError, "cell should be whole numbers"),
        ({"cell": np.array([0, 4])}, ParameterError, "cell = 4 .* one of the 4 cells"),
        ({"cell": np.array([0, 1])}, PointsOutsideGridError, "point 1 .* is not in the cell 1"),
        ({"x": [[0.2, 0.2], [0.7, np.nan]]}, ParameterError, "must be finite"),
        ({"x": np.zeros((2, 3))}, FieldShapeError, r"shape \(n, 2\) .* got \(2, 3\)"),
        ({"density": [1.0, np.inf]}, ParameterError, "density = inf"),
        ({"tag": [0.5, 1.0]}, ParameterError, "tag = .* whole number"),
        ({"tag": [1, 2, 3]}, FieldShapeError, "tag should have shape"),
        ({"id": [1]}, FieldShapeError, "id should have shape"),
    ],
)
def test_the_constructor_refuses_what_is_not(changes, error, message):
    grid, given = arguments(**changes)
    with pytest.raises(error, match=message):
        mpm.MaterialPoints(*grid, **given)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("V0", -1.0, "first volume = -1.0"),
        ("V", np.nan, "volume = nan"),
        ("density", 0.0, "density = 0.0"),
        ("l", -0.1, "half-lengths = "),
        ("l0", np.inf, "first half-lengths = "),
        ("l", 100.0, "does not fit into the grid"),
        ("x", np.nan, "must be finite"),
        ("x", 0.01, "is not in the cell"),
        ("x", 7.0, "is not in the cell"),
        ("F", np.nan, "must be finite"),
        ("F", np.diag([-1.0, 1.0]), "determinant must be positive"),
    ],
)
@pytest.mark.parametrize("kind", ["quadrilateral", "triangle"])
def test_fields_set_wrongly_are_found(kind, name, value, message):
    points = mpm.fill(unit_grid(kind), mpm.Box((0, 0), (1, 1)), 2, density=1.0)
    assert points.error_in_fields() is None
    points[name][-1] = value
    assert message in str(points.error_in_fields())


def test_points_moved_by_hand_are_located():
    points, _ = lower_and_upper()
    points["x"] += (0.0, 0.5)
    assert "points.locate()" in str(points.error_in_fields())
    points.locate()
    assert points.error_in_fields() is None
    points["x"] += (0.0, 0.5)
    with pytest.raises(PointsOutsideGridError, match="32 points are outside the grid, the first"):
        points.locate()


# -- bodies joined ------------------------------------------------------------


def test_a_joined_body_has_the_points_and_fields_of_both():
    lower, upper = lower_and_upper()
    lower.add_field("water", (), "Pa", 4.0)
    lower["water"] = 5.0
    upper.add_field("wind", (2,), "m/s", lambda x: 2 * x.T)
    both = lower + upper
    n = len(lower)
    assert both.total == len(both) == n + len(upper)
    assert np.unique(both["id"]).size == both.total
    assert both["tag"].tolist() == [1] * n + [2] * len(upper)
    np.testing.assert_array_equal(both["density"], np.where(both["tag"] == 1, 2.0, 3.0))
    np.testing.assert_array_equal(both["water"], np.where(both["tag"] == 1, 5.0, 4.0))
    np.testing.assert_array_equal(both["wind"], 2 * both["x0"])
    assert both.water.unit == "Pa"
    assert both.volume_error == pytest.approx(0, abs=1e-14)
    # its parts stay as they are
    assert "wind" not in lower.fields
    both["x"] += 0.01
    np.testing.assert_array_equal(lower["x"], lower["x0"])


def test_a_body_that_has_moved_is_joined_as_it_is():
    lower, upper = lower_and_upper()
    lower["x"] += 0.01
    lower["F"] = np.diag([1.1, 1.0])
    lower["V"] *= 1.1
    both = lower + upper
    for name in ("x", "x0", "F", "V", "V0", "l0"):
        expected = np.concatenate([lower[name], upper[name]])
        np.testing.assert_array_equal(both[name], expected)


def test_bodies_that_cannot_be_joined():
    lower, upper = lower_and_upper()
    with pytest.raises(ParameterError, match=r"the bodies overlap: 32 points .* take one shape"):
        lower + mpm.fill(lower.grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    with pytest.raises(ParameterError, match="on two grids"):
        lower + lower_and_upper()[1]
    with pytest.raises(ParameterError, match="joined with points only, got a int"):
        lower + 1
    lower.add_field("load", (2,))
    upper.add_field("load")
    with pytest.raises(FieldShapeError, match="field 'load' has shape"):
        lower + upper


def test_a_joined_body_in_parts_is_the_body_as_a_whole():
    """One step of two halves joined, and of the same body filled at once."""
    figures = []
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    for k in range(2):
        lower, upper = lower_and_upper(grid)
        points = lower + upper
        if k:
            points = mpm.fill(
                grid, mpm.Box((0, 0), (1, 1)), 2, density=lambda x: 2.0 + (x[1] > 0.5)
            )
        problem = column(points)
        problem.step()
        order = np.lexsort(points["x0"].T)
        figures.append(points["x"][order])
    np.testing.assert_allclose(*figures, rtol=0, atol=1e-12)


# -- points that come and go --------------------------------------------------


def column(points, law=None):
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1e3, nu=0.2) if law is None else law
    g = fem.Constant(points.grid, (0.0, -10.0))
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    return problem


def test_excavation_and_fill_between_steps():
    """Taking the upper half off takes its weight off what is below; putting it on adds it."""
    lower, upper = lower_and_upper()
    points = lower + upper
    problem = column(points)
    problem.step()
    loaded = points["stress"][points["tag"] == 1, 1, 1].copy()
    change = points.remove(tag=2)
    assert change == mpm.PointChange(count=32, mass=pytest.approx(1.5))
    assert points.total == len(points) == 32
    assert points.volume_error is None
    problem.step()
    # the weight of what was above, 1.5 · 10 N on a width of 1 m
    np.testing.assert_allclose(points["stress"][:, 1, 1] - loaded, 15.0, rtol=0.02)
    top = points["x"][:, 1].max()
    shape = mpm.Box((0, 0.55), (1, 1))
    change = points.add(mpm.fill(points.grid, shape, 2, density=3.0, tag=2))
    assert change.mass == pytest.approx(3.0 * 0.45)
    assert top < 0.5
    assert np.unique(points["id"]).size == points.total
    assert points["id"].min() == 0
    new = points["tag"] == 2
    assert points["id"][new].min() >= 64, "numbers are not given twice"
    problem.step()
    assert points.error_in_fields() is None


def test_new_points_have_the_first_state_of_the_law():
    lower, upper = lower_and_upper()
    law = mpm.materials.VonMises(E=lambda x: 1e3 + x[1], nu=0.2, radius=1e3)
    problem = column(lower, law)
    problem.step()
    lower.add(upper)
    # a problem gives them what its laws keep before it goes on
    problem.activate()
    new = lower["tag"] == 2
    np.testing.assert_array_equal(lower["be"][new], [[1, 1, 1, 0, 0, 0]] * new.sum())
    parameters = lower["vonmises_parameters"]
    np.testing.assert_array_equal(parameters[:, 0], 1e3 + lower["x0"][:, 1])
    problem.step()
    assert np.abs(lower["stress"][new]).max() > 1


def test_new_points_have_the_first_internal_variables_of_the_law():
    lower, upper = lower_and_upper()
    law = mpm.materials.CamClay(
        swelling=0.01, compression=0.1, M=1.0, mu0=1e3, alpha=0.0, reference_pressure=10.0,
        preconsolidation=lambda x: 50 + x[1],
    )  # fmt: skip
    V = mpm.Space(lower.grid, "gimp")
    F = mpm.momentum(law, lower, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, lower)
    lower["preconsolidation_pressure"] = 77.0
    lower.add(upper)
    problem.activate()
    expected = np.where(lower["tag"] == 1, 77.0, 50 + lower["x0"][:, 1])
    np.testing.assert_array_equal(lower["preconsolidation_pressure"], expected)


def test_removing_by_place_and_by_mask():
    points, _ = lower_and_upper()
    assert points.remove(lambda x: x[0] > 5) == mpm.PointChange(0, 0.0)
    change = points.remove(lambda x: x[0] < 0.25)
    assert change.count == 8
    assert change.mass == pytest.approx(0.25)
    assert points["x"][:, 0].min() > 0.25
    mask = points["x"][:, 0] > 0.75
    assert points.remove(mask).count == 8
    for values in points.fields.values():
        assert len(values) == len(points) == 16


def test_removals_that_are_refused():
    points, _ = lower_and_upper()
    with pytest.raises(ParameterError, match="no body would be left"):
        points.remove(tag=1)
    with pytest.raises(ParameterError, match="either `where` or `tag`"):
        points.remove()
    with pytest.raises(ParameterError, match="booleans, got int64"):
        points.remove(np.arange(32))
    with pytest.raises(FieldShapeError, match="should be 32 booleans"):
        points.remove(np.zeros(3, bool))
    with pytest.raises(ParameterError, match="the bodies overlap"):
        points.add(mpm.fill(points.grid, mpm.Box((0, 0), (1, 1)), 2, 1.0))
    assert points.total == 32


def test_a_table_in_another_encoding_is_told_by_its_line(tmp_path):
    """It had ended in a UnicodeDecodeError."""
    grid, path = unit_grid("quadrilateral", 4), tmp_path / "points.csv"
    path.write_bytes("x,y,volume,density\n0.3,0.3,0.01,groß\n".encode("latin-1"))
    with pytest.raises(ParameterError, match=r"points.csv, line 2, column 'density': 'gro"):
        mpm.MaterialPoints.from_csv(grid, path)
    with pytest.raises(FileNotFoundError, match=r"there is no file .*other.csv"):
        mpm.MaterialPoints.from_csv(grid, tmp_path / "other.csv")
