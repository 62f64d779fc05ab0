"""Checkpoints that are refused, and files that stay whole."""

from __future__ import annotations

import io
import os
import resource
import zipfile

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scenes import arch
from test_checkpoint import QUADRILATERAL, bits, block

import dolfinmpm as mpm
from dolfinmpm import errors
from dolfinmpm._platform.errors import CheckpointError
from dolfinmpm.io.checkpoint import VERSION


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A file of two steps, what it holds, and another problem of the same kind after one step."""
    path = tmp_path_factory.mktemp("saved") / "two.npz"
    problem, step = block()
    step()
    step()
    problem.save(path)
    other, step = block()
    step()
    return path, problem, other


def refused(path, problem, match):
    before = bits(problem), problem.points["cell"], problem.share
    with pytest.raises(CheckpointError, match=match):
        problem.load(path)
    after = bits(problem), problem.points["cell"], problem.share
    assert after[0] == before[0]
    assert after[1] is before[1]
    assert after[2] == before[2]


def test_a_file_that_is_cut_short_is_refused(saved, tmp_path):
    path, _, other = saved
    data = path.read_bytes()
    cut = tmp_path / "cut.npz"
    for length in [0, 1, 7, 8, 100, 511, 512, 4000, *range(5000, len(data), 9973), len(data) - 1]:
        cut.write_bytes(data[:length])
        refused(cut, other, "cannot read .*cut short or damaged")


def test_bytes_that_flip_are_found_or_change_nothing(saved, tmp_path):
    path, problem, _ = saved
    data, bad, fresh = path.read_bytes(), tmp_path / "bad.npz", block()[0]
    rng = np.random.default_rng(1)
    found = 0
    for at in rng.integers(0, len(data), 150):
        bad.write_bytes(data[:at] + bytes([data[at] ^ int(rng.integers(1, 256))]) + data[at + 1 :])
        try:
            fresh.load(bad)
        except CheckpointError:
            found += 1
        else:
            assert bits(fresh) == bits(problem)
    # dates and the like may flip
    assert found > 100
    # what an array holds is never lost in silence
    with zipfile.ZipFile(path) as file:
        info = file.getinfo("points/x.npy")
        size = np.load(path)["points/x"].nbytes
        start = info.header_offset + 30 + len(info.filename) + 20 + info.file_size - size
    for at in range(start, start + size, 37):
        bad.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        refused(bad, fresh, "damaged")


def copied(path, target, changes):
    """A copy of an archive, with members changed, or left out."""
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(target, "w") as out:
        for name in file.namelist():
            change = changes.get(name, lambda data: data)
            if change is not None:
                out.writestr(name, change(file.read(name)))


def test_what_is_no_checkpoint_is_refused(saved, tmp_path):
    path, _, other = saved
    refused(tmp_path / "none.npz", other, "there is no file .*none.npz")
    refused(tmp_path, other, "there is no file")
    (tmp_path / "text.npz").write_text("time,load\n" * 1000)
    refused(tmp_path / "text.npz", other, "it is no archive of NumPy")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    refused(tmp_path / "other.npz", other, "is an archive, but no dolfinmpm checkpoint")
    for version, remedy in (VERSION + 1, "update it"), (VERSION - 1, "write the file anew"):
        changed = tmp_path / "changed.npz"
        old, now = (b'"version": %d' % n for n in (VERSION, version))
        change = {"header.json": lambda text, old=old, now=now: text.replace(old, now)}
        copied(path, changed, change)
        refused(changed, other, f"has version {version} .* reads version {VERSION}: {remedy}")
    headless = tmp_path / "headless.npz"
    copied(path, headless, {"header.json": None})
    refused(headless, other, "is an archive, but no dolfinmpm checkpoint")
    short = io.BytesIO()
    np.save(short, np.zeros((3, 2)))
    copied(path, tmp_path / "short.npz", {"points/x.npy": lambda _: short.getvalue()})
    refused(tmp_path / "short.npz", other, "array points/x has not the 36 rows")
    copied(path, tmp_path / "less.npz", {"points/x.npy": None})
    refused(tmp_path / "less.npz", other, "cut short or damaged")


def test_another_grid_is_refused(saved):
    path, _, _ = saved
    refused(path, block(cells=(6, 5))[0], "of another grid: 24 in place of 30 cells")
    refused(path, block(width=6.5)[0], r"its highest corner at \[6.0, 4.0\] m in place of \[6.5")
    triangles = block(basis="linear", kind=mesh.CellType.triangle, cells=(4, 3))[0]
    refused(path, triangles, "quadrilateral in place of triangle as type of cell")


@pytest.mark.parametrize("kind", ["vertex", "diagonals"])
def test_a_grid_that_differs_inside_is_refused(kind, tmp_path):
    def build(diagonal=mesh.DiagonalType.right, shift=0.0):
        grid = mesh.create_rectangle(
            COMM, [(0, 0), (4, 4)], (4, 4), mesh.CellType.triangle, diagonal=diagonal
        )
        inner = np.all((grid.geometry.x[:, :2] > 0.1) & (grid.geometry.x[:, :2] < 3.9), axis=1)
        grid.geometry.x[np.flatnonzero(inner)[:1], 0] += shift
        points = mpm.fill(grid, mpm.Box((0, 0), (3, 3)), 2, 1.0)
        V = mpm.Space(grid, "linear")
        F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, V.increment, V.test)
        return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))

    build().save(tmp_path / "a.npz")
    build(shift=1e-15).load(tmp_path / "a.npz")  # rounding
    other = {"shift": 1e-6} if kind == "vertex" else {"diagonal": mesh.DiagonalType.left}
    refused(tmp_path / "a.npz", build(**other), "vertices or cells lie elsewhere in the same box")


def test_what_differs_from_the_problem_of_the_file_is_told(saved, tmp_path):
    """A next stage may differ in it; nothing is said where nothing does."""
    path, _, _ = saved
    block()[0].load(path)
    soft = mpm.materials.VonMises(E=5e5, nu=0.3, radius=lambda x: 5e3 + 1e3 * x[1])
    weak = mpm.materials.VonMises(E=1e6, nu=0.3, radius=lambda x: 4e3 + 1e3 * x[1])
    ghost = mpm.Stabilisation("ghost", E=2e6)
    for options, words in (
        ({"law": soft}, r"law 1: VonMises\(E=1000000\.0, .* there, VonMises\(E=500000\.0,"),
        ({"law": weak}, r"radius=varying about .* there, .*radius=varying about"),
        ({"basis": "linear"}, 'basis of field 1: "gimp", averaged .* there, "linear"'),
        ({"stabilisation": ghost}, r"stabilisation of field 1: .*E=1000000\.0.*E=2000000\.0"),
    ):
        with pytest.warns(errors.DifferentProblemWarning, match=words) as told:
            block(**options)[0].load(path)
        assert len(told) == 1
        assert "; " not in str(told[0].message)
    # a basis of more nodes: the first guess of the file has nodes that this one has not
    spline, step = block(basis="bspline2")
    step()
    spline.save(tmp_path / "spline.npz")
    problem, step = block()
    with pytest.warns(errors.DifferentProblemWarning, match='"bspline2".* there, "gimp"'):
        problem.load(tmp_path / "spline.npz")
    step()
    points, V, F = (problem := block()[0]).points, problem.fields[0].space, problem.form.given
    for bcs, words in (
        (mpm.fixed(V, "left", "bottom"), "conditions: component 0 at 'left'.*component 0 at 'bott"),
        ((), "conditions: component 0 at 'left': 0; component 1 at 'bottom': 0 there, none here"),
    ):
        other = mpm.QuasiStatic(
            F, V.increment, points, bcs, stabilisation=mpm.Stabilisation("ghost", E=1e6)
        )
        with pytest.warns(errors.DifferentProblemWarning, match=words):
            other.load(path)

    def moving(**options):
        points = mpm.fill(problem.points.grid, mpm.Box((0, 0), (3, 2.7)), 2, 1000.0)
        law = mpm.materials.Hencky(E=1e6, nu=0.3)
        ball = mpm.RigidBody(mpm.Disc((1, 3.5), 0.5), name="ball")
        friction = options.pop("friction", 0.1)
        F = mpm.momentum(law, points, V.increment, V.test)
        F += mpm.contact(ball, points, V.increment, V.test, friction=friction)
        return mpm.Newmark(F, V.increment, points, **options)

    moving().save(tmp_path / "in_time.npz")
    moving().load(tmp_path / "in_time.npz")
    for options, words in (
        ({"friction": 0.4}, "contact 1: friction = 0.1, .* there, friction = 0.4"),
        (
            {"gamma": 0.6, "beta": 0.3},
            r"steps: NewmarkRule\(beta=0.25, gamma=0.5.* there, NewmarkRule\(beta=0.3",
        ),
    ):
        with pytest.warns(errors.DifferentProblemWarning, match=words):
            moving(**options).load(tmp_path / "in_time.npz")


def test_another_problem_is_refused(saved, tmp_path):
    path, _, _ = saved
    hencky = mpm.materials.Hencky(E=1e6, nu=0.3)
    refused(path, block(hencky)[0], "of the points' laws it has VonMises under large strain")
    more = block()[0]
    more.points.add_field("temperature")
    refused(path, more, r"fields it has nothing .* lacks temperature float64\(\)")
    problem_arch, step = arch()
    step()
    problem_arch.save(tmp_path / "arch.npz")
    refused(tmp_path / "arch.npz", arch("displacement")[0], "its control is spherical")
    heavier, _ = arch()
    heavier.path.load._reference[0][1] = -200.0
    refused(tmp_path / "arch.npz", heavier, r"load at factor 1 is \(0, -100\), .* \(0, -200\)")


def test_another_number_of_unknown_fields_or_loads_is_refused(tmp_path):
    def build(pressure=False, loads=1, arc=False):
        grid = mesh.create_rectangle(COMM, [(0, 0), (3, 3)], (3, 3), QUADRILATERAL)
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
        points.add_field("arc_increment", (2,), "m")
        U, P = mpm.Space(grid, "linear"), mpm.Space(grid, "linear", shape=())
        u, v, p, q = U.increment, U.test, P.increment, P.test
        F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, u, v)
        forces = [fem.Constant(grid, (0.0, -1.0)) for _ in range(loads)]
        for force in forces:
            F -= ufl.inner(force, v) * points.dX
        fields = [u]
        if pressure:
            F += (p * q - p * ufl.div(v)) * points.dX
            fields = [u, p]
        if arc:
            return mpm.ArcLength(F, fields, points, mpm.fixed(U, "bottom"), load=forces)
        return mpm.QuasiStatic(F, fields, points, mpm.fixed(U, "bottom"))

    path = tmp_path / "a.npz"
    build().save(path)
    build().load(path)
    refused(path, build(pressure=True), r"unknown fields is \[\(2,\)\], .*, \(\)\]")
    refused(path, build(loads=2), r"its loads is \[\(2,\)\], that of this one")
    refused(
        tmp_path / "a.npz", build(arc=True), "solver is QuasiStatic, that of this one ArcLength"
    )


def test_a_file_that_cannot_be_written_leaves_the_old_one(saved, tmp_path):
    path, problem, other = saved
    with pytest.raises(CheckpointError, match=r"cannot write .*is its folder there"):
        problem.save(tmp_path / "missing" / "a.npz")
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(CheckpointError, match=r"cannot write .*folder\.npz"):
        problem.save(tmp_path / "folder.npz")
    target = tmp_path / "a.npz"
    target.write_bytes(path.read_bytes())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (0, 3000, 20_000):
        # the disk is full, as far as this process can tell
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
        try:
            with pytest.raises(CheckpointError, match="A file that had this name before is as"):
                other.save(target)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert target.read_bytes() == path.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "folder.npz"]


def test_a_save_replaces_the_file_and_clears_what_killed_ones_left(saved, tmp_path):
    _, problem, other = saved
    real = tmp_path / "scratch" / "a.npz"
    real.parent.mkdir()
    (tmp_path / "a.npz").symlink_to(real)
    problem.save(tmp_path / "a.npz")
    (real.parent / "a.npz.part-99").write_bytes(b"half")
    (real.parent / "b.npz.part-99").write_bytes(b"of another file")
    other.save(os.fspath(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").is_symlink()
    assert sorted(p.name for p in real.parent.iterdir()) == ["a.npz", "b.npz.part-99"]
    fresh = block()[0]
    fresh.load(real)
    assert bits(fresh) == bits(other)


def test_a_function_without_values_at_nodes_is_refused(tmp_path):
    grid = mesh.create_unit_square(COMM, 2, 2)
    points, V = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 1, 1.0), mpm.Space(grid)
    edges = fem.Function(fem.functionspace(grid, ("N1curl", 1)))
    F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, V.increment, V.test)
    F -= ufl.inner(edges, V.test) * ufl.dx
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    with pytest.raises(CheckpointError, match="has no values at nodes; interpolate it into"):
        problem.save(tmp_path / "edges.npz")
