"""Programs that open ParaView series: their text, which is Python."""

from __future__ import annotations

from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.io import ParaView


def quarter():
    return mpm.fill(unit_grid("quadrilateral", 4), mpm.Box((0, 0), (0.5, 0.5)), 2, 80.0)


def recipe(path):
    """The program for ParaView beside a series; it has to be valid Python."""
    text = path.with_name(f"{path.stem}_paraview.py").read_text()
    compile(text, path.name, "exec")
    return text


def test_a_program_opens_the_series_in_paraview(tmp_path):
    path = tmp_path / "quarter.pvd"
    ParaView(path, quarter())
    text = recipe(path)
    assert f"folder = {str(tmp_path.resolve())!r}\n" in text
    assert "series = os.path.join(folder, 'quarter')" in text
    assert "if True:  # each point as its domain" in text
    assert 'series + "_grid.pvd"' in text
    assert "if False:\n    bodies = Show(" in text
    assert "ColorBy(shown, ('POINTS', 'displacement', 'Magnitude'))" in text
    assert "'displacement (m)', 'Magnitude'" in text
    assert '"2D" if True' in text
    assert len(text.splitlines()) <= 60


def test_the_program_for_paraview_follows_what_is_written(tmp_path):
    path = tmp_path / "it's {one}.pvd"
    disc = mpm.RigidBody(mpm.Disc((1.0, 3.0), 0.5))
    ParaView(path, quarter(), fields=["stress", "density"], bodies=[disc])
    text = recipe(path)
    assert "if False:  # each point as its domain" in text
    assert "if True:\n    bodies = Show(" in text
    assert "ColorBy(shown, ('POINTS', 'stress', 'yy'))" in text
    assert "'stress (Pa)', 'yy'" in text
    ParaView(path, quarter(), fields=["id"])
    assert "ColorBy(shown, ('POINTS', 'id'))" in recipe(path)
    assert "bar.Title, bar.ComponentTitle = 'id', ''" in recipe(path)
    grid = mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2, mesh.CellType.hexahedron)
    ParaView(path, mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), 1, 80.0), fields=["F"])
    assert "ColorBy(shown, ('POINTS', 'F', 'zz'))" in recipe(path)
    assert '"2D" if False' in recipe(path)
    ParaView(tmp_path / "none.pvd", quarter(), fields=[])
    assert not (tmp_path / "none_paraview.py").exists()
