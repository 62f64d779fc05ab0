"""Films, meshes for PyVista, tables for notebooks, pictures of histories."""

from __future__ import annotations

import builtins
import shutil
import sys

import numpy as np
import pytest
from dolfinx.mesh import CellType, create_unit_interval, create_unit_square
from mpi4py import MPI
from PIL import Image

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    CheckpointError,
    MissingPackageError,
    ParameterError,
    UnknownNameError,
)
from dolfinmpm.io import encoding
from dolfinmpm.io.frames import Series

COMM = MPI.COMM_SELF
SMALL = {"size": (2.0, 1.5), "dpi": 50}


def block(n=4):
    grid = create_unit_square(COMM, n, n, CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1000.0)
    return points, mpm.Space(grid, "gimp")


def pressed():
    points, V = block()
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.0), points, V.increment, V.test)
    down = mpm.prescribed(V, lambda x: x[1] > 0.4, 1, increment=-0.02)
    return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom") + down)


def film_of(path, **options):
    problem = pressed()
    with mpm.animate(problem, path, **{**SMALL, **options}) as film:
        for t in (1.0, 2.0, 3.0):
            problem.step()
            film.write(t)
    return problem


def test_a_film_has_a_frame_per_time_of_one_size(tmp_path):
    film_of(tmp_path / "film.gif", colour="displacement")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 3
        assert film.info["duration"] == 100
        colours = []
        for k in range(3):
            film.seek(k)
            colours.append(np.asarray(film.convert("RGB"), float))
    assert colours[0].shape == colours[2].shape
    # the block moves on
    assert np.abs(colours[0] - colours[2]).max() > 100


def test_two_films_have_paths_of_their_own(tmp_path):
    """The film that was closed last had replaced the other one in silence."""
    first, second = (
        mpm.animate(block()[0], tmp_path / "film.gif", "density", **SMALL) for _ in range(2)
    )
    second.write(0.0)
    with pytest.raises(ParameterError, match=r"another film writes '.*film\.gif'"), first:
        first.write(0.0)
    second.close()


def test_a_closed_film_takes_no_frame(tmp_path):
    with mpm.animate(block()[0], tmp_path / "film.gif", "density", **SMALL) as film:
        film.write(0.0)
    with pytest.raises(ParameterError, match=r"film\.gif is closed"):
        film.write(1.0)


def test_a_film_of_files_is_that_of_the_run(tmp_path):
    problem = pressed()
    stress = {"colour": "stress", "title": "{time:.0f}", "size": (3.1, 2.3), "dpi": 50}
    with mpm.animate(problem.points, tmp_path / "run.gif", **stress) as film:
        series = mpm.ParaView(tmp_path / "run.pvd", problem.points)
        for t in (1.0, 2.0):
            problem.step()
            film.write(t)
            series.write(t)
    assert mpm.animate(tmp_path / "run.pvd", tmp_path / "files.gif", **stress) is None
    with Image.open(tmp_path / "run.gif") as a, Image.open(tmp_path / "files.gif") as b:
        for k in range(2):
            a.seek(k)
            b.seek(k)
            pixels = [np.asarray(film.convert("RGB"), float) for film in (a, b)]
            # ticks hang on the last bits of the grid's box
            assert (np.abs(pixels[0] - pixels[1]).max(axis=2) > 30).mean() < 0.02


def test_a_series_is_read_as_it_was_written(tmp_path):
    points, _ = block()
    wall = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), name="wall")
    series = mpm.ParaView(tmp_path / "block.pvd", points, bodies=[wall])
    series.write(0.5)
    read = Series(tmp_path / "block.pvd")
    assert (read.gdim, len(read), read.units["stress"]) == (2, 1, "Pa")
    assert np.allclose(read.box, [[0, 1], [0, 1]])
    assert [len(line) for line in read.lines] == [5, 5]
    frame = read.frame(0, "stress")
    assert frame.time == 0.5
    assert np.array_equal(frame.x, points["x"])
    assert np.array_equal(frame.F, points["F"])
    assert frame.values.shape == (len(points), 3, 3)
    assert len(frame.bodies) == 1
    with pytest.raises(ParameterError, match="no field 'heat'; it has id"):
        read.frame(0, "heat")


def test_a_film_along_a_line(tmp_path):
    grid = create_unit_interval(COMM, 4)
    points = mpm.fill(grid, mpm.Box(0, 0.5), 2, 1.0)
    with mpm.animate(points, tmp_path / "line.gif", "density", **SMALL) as film:
        film.write(0.0)
    assert (tmp_path / "line.gif").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": "film.avi"}, r"ends in \.mp4 or \.gif, got 'film\.avi'"),
        ({"colour": "heat"}, "no field 'heat'"),
        ({"limits": (1, 0)}, "must rise"),
        ({"rate": 0.0}, "rate"),
        ({"title": "{step}"}, "title = '{step}' may have {time} in it alone"),
        ({"draw": "lines"}, "draw"),
        ({"size": (0, 1)}, "size"),
    ],
)
def test_what_makes_no_film_is_told(options, message):
    points, _ = block()
    with pytest.raises(ParameterError, match=message):
        mpm.animate(points, **{"path": "film.gif", **options})


def test_no_film_without_frames_or_files(tmp_path):
    points, _ = block()
    with pytest.raises(ParameterError, match="a frame or more"):
        mpm.animate(points, tmp_path / "empty.gif").close()
    with pytest.raises(CheckpointError, match="cannot read the series"):
        mpm.animate(tmp_path / "none.pvd", tmp_path / "none.gif")
    with pytest.raises(ParameterError, match=r"must be a \.pvd file, material points"):
        mpm.animate(3.0, tmp_path / "none.gif")


def without(monkeypatch, *packages):
    """Let an import of these packages fail."""
    real = builtins.__import__

    def refuse(name, *rest, **more):
        if name.partition(".")[0] in packages:
            raise ImportError(name)
        return real(name, *rest, **more)

    for name in packages:
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)


def test_a_missing_ffmpeg_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    without(monkeypatch, "imageio_ffmpeg")
    points, _ = block()
    with pytest.raises(MissingPackageError, match=r"apt install ffmpeg.* or write a \.gif"):
        mpm.animate(points, tmp_path / "film.mp4")


def size_of(picture):
    with Image.open(picture) as image:
        return image.size


def test_ffmpeg_gets_even_pictures_in_order(monkeypatch, tmp_path):
    seen = {}

    def run(command, **_):
        seen["command"] = command
        folder = command[command.index("-i") + 1].rpartition("/")[0]
        seen["sizes"] = [size_of(f"{folder}/{k:06d}.png") for k in range(3)]
        return type("Done", (), {"returncode": 1, "stderr": "no such codec"})

    monkeypatch.setattr(encoding, "ffmpeg", lambda: "ffmpeg")
    monkeypatch.setattr(encoding.subprocess, "run", run)
    monkeypatch.setattr("dolfinmpm.io.animation.ffmpeg", lambda: "ffmpeg")
    with pytest.raises(OSError, match=r"film\.mp4: ffmpeg says no such codec"):
        film_of(tmp_path / "film.mp4")
    assert len(set(seen["sizes"])) == 1
    assert not any(side % 2 for side in seen["sizes"][0])
    assert seen["command"][-1] == str(tmp_path / "film.mp4")


def test_a_missing_pyvista_is_told(monkeypatch):
    without(monkeypatch, "pyvista")
    points, _ = block()
    with pytest.raises(MissingPackageError, match="pip install pyvista"):
        points.to_pyvista()


def test_a_film_in_3d_tells_a_missing_pyvista_before_the_run(monkeypatch, tmp_path):
    without(monkeypatch, "pyvista")
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3)] * 3)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), per_cell=1, density=1.0)
    with pytest.raises(MissingPackageError, match="pip install pyvista"):
        mpm.animate(points, tmp_path / "film.gif", "density")


def test_points_as_a_mesh_of_their_domains():
    pytest.importorskip("pyvista")
    problem = pressed()
    problem.step()
    points = problem.points
    mesh = points.to_pyvista()
    assert mesh.n_cells == len(points)
    areas = mesh.compute_cell_sizes()["Area"]
    assert areas == pytest.approx(points["V"])
    assert np.allclose(mesh["displacement"][:, :2], points["x"] - points["x0"])
    assert mesh["stress"].shape == (len(points), 9)


def test_notebooks_show_tables():
    problem = pressed()
    problem.step()
    html = problem.points._repr_html_()
    assert "<th>points on this rank</th><td>32</td>" in html
    assert "stress (Pa)" in html
    assert "<th>iterations</th>" in problem.history[-1]._repr_html_()
    assert problem._repr_html_().startswith("<pre>")
    assert "&lt;" not in problem.history[-1]._repr_html_()
    history = mpm.History(COMM)
    history.record(t=1.0, load=2.5)
    assert "<th>t</th><th>load</th>" in history._repr_html_()
    assert "<td>1</td><td>2.5</td>" in history._repr_html_()


def test_a_history_is_drawn(tmp_path):
    history = mpm.History(COMM)
    for t in (0.0, 1.0):
        history.record(t=t, load=t**2, way=2 * t)
    history.plot(tmp_path / "all.png", "t")
    history.plot(tmp_path / "one.png", "t", "load", labels={"load": "load (N)"})
    history.plot(tmp_path / "two.png", "t", "load", "t", ylabel="load (N), time (s)")
    assert (tmp_path / "all.png").stat().st_size > 1000
    with pytest.raises(UnknownNameError, match="'force'"):
        history.plot(tmp_path / "none.png", "t", "force")
    with pytest.raises(ParameterError, match=r"plot\(path, 't', 'load', 't'\)"):
        history.plot(tmp_path / "none.png", "t", ["load", "t"])
    alone = mpm.History(COMM)
    alone.record(t=0.0)
    with pytest.raises(ParameterError, match="nothing to draw over 't'"):
        alone.plot(tmp_path / "none.png", "t")
