"""Pictures, ParaView files and films show the leaves of refined spaces."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from test_io import array, listed, read

import dolfinmpm as mpm
from dolfinmpm.io.frames import Series
from dolfinmpm.io.gridlines import grid_lines, lines_of_boxes


class Block:
    """A block whose cells are small near a place that moves."""

    def __init__(self, gdim=2, comm=MPI.COMM_SELF):
        self.place = 0.5
        self.grid = mpm.create_lattice(comm, [np.linspace(0, 4, 5)] * gdim)
        self.V = V = mpm.Space(self.grid, "gimp", refine=self.size, levels=2)
        box = mpm.Box((0,) * gdim, (4,) * (gdim - 1) + (2,))
        self.points = mpm.fill(self.grid, box, per_cell=2, density=1e3)
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), self.points, V.increment, V.test)
        bcs = mpm.fixed(V, "bottom")
        self.problem = mpm.QuasiStatic(F, V.increment, self.points, bcs)
        self.problem.adapt()

    def size(self, x):
        return np.where(np.abs(x[0] - self.place) < 0.3, 0.25, 2.0)

    def move(self, place):
        self.place = place
        self.problem.adapt()


def length(lines):
    return np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()


def test_every_line_of_leaves_is_drawn_once():
    # one cell, two cells beside it, four cells beside one of these
    low = np.array([[0, 0], [2, 0], [2, 1], [3, 1], [3, 0], [3.5, 0], [3, 0.5], [3.5, 0.5]])
    edge = np.array([2, 1, 1, 1, 0.5, 0.5, 0.5, 0.5])
    lines = lines_of_boxes(low, low + edge[:, None])
    along = np.diff(lines[:, :, 0], axis=1)[:, 0] > 0
    assert length(lines[along]) == pytest.approx(4 + 4 + 2 + 1)
    assert length(lines[~along]) == pytest.approx(4 * 2 + 1)


@pytest.mark.parametrize("gdim", [2, 3])
def test_the_lines_of_a_picture_are_those_of_the_leaves(tmp_path, gdim):
    block = Block(gdim)
    cut = None if gdim == 2 else ("y", 1.6)
    lines = grid_lines(block.grid, cut)
    assert len(lines) > 30
    # between the lines of the grid there are some near the place alone
    between = np.all(lines[:, :, 0] % 1.0 > 0, axis=1)
    assert between.any()
    assert lines[between, :, 0].max() < 2
    mpm.plot(block.points, tmp_path / "block.png", "density", cut=cut, dpi=40)
    block.move(3.5)
    lines = grid_lines(block.grid, cut)
    assert lines[np.all(lines[:, :, 0] % 1.0 > 0, axis=1), :, 0].min() > 2


@pytest.mark.parametrize("gdim", [2, 3])
def test_paraview_has_the_leaves_of_every_time(tmp_path, gdim):
    block = Block(gdim)
    with mpm.ParaView(tmp_path / "block.pvd", block.points) as out:
        out.write(0.0)
        block.move(3.5)
        out.write(1.0)
    times, files = listed(tmp_path / "block_grid.pvd")
    assert times == [0.0, 1.0]
    for file, place in zip(files, (0.5, 3.5)):
        cells = read(file)
        bounds = [cells.GetCell(k).GetBounds() for k in range(cells.GetNumberOfCells())]
        ends = np.array(bounds).reshape(-1, 3, 2)[:, :gdim]
        sizes = ends[:, :, 1] - ends[:, :, 0]
        assert np.prod(sizes, axis=1).sum() == pytest.approx(4.0**gdim)
        level, active = (array(cells.GetCellData(), name) for name in ("level", "active"))
        np.testing.assert_allclose(sizes, np.repeat(0.5 ** level[:, None], gdim, axis=1))
        assert np.all(np.abs(ends[level == 2].mean(axis=2)[:, 0] - place) < 1.0)
        assert np.array_equal(active == 1, ends[:, -1].max(axis=1) <= 2.0)


def test_paraview_with_increments_keeps_the_cells_of_the_grid(tmp_path):
    block = Block()
    mpm.ParaView(tmp_path / "b.pvd", block.points, increments=block.V.increment).write(0.0)
    assert read(listed(tmp_path / "b_grid.pvd")[1][0]).GetNumberOfCells() == 16


def test_a_film_shows_leaves_that_follow(tmp_path):
    block = Block()
    small = {"size": (2.0, 1.5), "dpi": 50}
    series = mpm.ParaView(tmp_path / "block.pvd", block.points)
    lines = []
    with mpm.animate(block.problem, tmp_path / "run.gif", "density", **small) as film:
        for time, place in enumerate((0.5, 2.0, 3.5)):
            block.move(place)
            film.write(time)
            series.write(time)
            lines.append(grid_lines(block.grid, None))
    assert (tmp_path / "run.gif").stat().st_size > 0
    found = Series(tmp_path / "block.pvd")
    for k, expected in enumerate(lines):
        np.testing.assert_allclose(found.frame(k, "density").lines, expected, atol=1e-12)
    assert not np.array_equal(lines[0][: len(lines[2])], lines[2][: len(lines[0])])
    assert mpm.animate(tmp_path / "block.pvd", tmp_path / "files.gif", "density", **small) is None
