"""The ground as it is surveyed: rasters, boreholes, sections, and the bodies below them."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import MissingPackageError, ParameterError
from dolfinmpm.contact.shapesurface import mesh_surface


def hills(seed=1, shape=(6, 8)):
    """A terrain of random heights from 3 to 4 m on 14 m by 7.5 m."""
    heights = 3.0 + np.random.default_rng(seed).random(shape)
    return mpm.Terrain.from_raster(heights, spacing=(2.0, 1.5))


def lattice(*ends, h=0.5):
    return mpm.create_lattice(COMM, [np.linspace(0, end, round(end / h) + 1) for end in ends])


def exact_volume(terrain, bottom):
    """Volume above a level bottom: a bilinear function has the mean of its corners on a cell."""
    x, y = terrain.lines
    z = terrain.heights - bottom
    mean = 0.25 * (z[1:, 1:] + z[1:, :-1] + z[:-1, 1:] + z[:-1, :-1])
    return float(np.diff(x) @ mean @ np.diff(y))


# -- volumes --------------------------------------------------------------------------------


def test_the_points_below_a_surface_have_its_volume_and_centroid():
    ground = hills().ground(bottom=0.0)
    assert ground.volume == pytest.approx(exact_volume(hills(), 0.0), rel=1e-13)
    points = mpm.fill(lattice(14.0, 7.5, 5.0), ground, 2, 1800.0, exact=True)
    assert abs(points.volume_error) < 1e-12
    middle = points["V"] @ points["x"] / points["V"].sum()
    assert middle == pytest.approx(ground.centroid, rel=1e-10)
    top = hills()(points["x"].T)
    assert np.all(points["x"][:, 2] < top + 0.05)


def test_a_lens_has_the_volume_of_what_is_above_the_bed():
    """Where two surfaces cross within cells, only the part between them counts."""
    top, bed = hills(1), hills(2)
    lens = top.ground(bottom=bed)
    # the mean over midpoints of 1500 parts per direction
    n = 1500
    x = [np.arange(0.5, n) / n * (line[-1] - line[0]) for line in top.lines]
    total = 0.0
    for part in x[0]:
        at = np.array([np.full(n, part), x[1]])
        total += np.maximum(top(at) - bed(at), 0.0).sum()
    assert lens.volume == pytest.approx(total / n**2 * 14.0 * 7.5, rel=1e-5)
    # both sides of the crossing together are the difference of the whole volumes
    other = bed.ground(bottom=top)
    difference = exact_volume(top, 0.0) - exact_volume(bed, 0.0)
    assert lens.volume - other.volume == pytest.approx(difference, abs=1e-11)
    points = mpm.fill(lattice(14.0, 7.5, 5.0, h=0.25), lens, 2, 1800.0, exact=True)
    assert abs(points.volume_error) < 1e-12


def test_surfaces_on_different_rasters_stay_as_they_are():
    fine, coarse = hills(1, (11, 15)), mpm.Terrain(([0, 3, 20], [0, 10]), [[1, 1], [2, 1], [1, 2]])
    ground = fine.ground(coarse, low=(1.0, 2.0), high=(17.5, 9.0))
    a, b = np.meshgrid(np.linspace(1, 17.5, 1651), np.linspace(2, 9, 701), indexing="ij")
    at = np.array([a.ravel(), b.ravel()])
    thick = (fine(at) - coarse(at)).reshape(a.shape)
    by_trapezoids = np.trapezoid(np.trapezoid(thick, dx=0.01, axis=1), dx=0.01)
    assert ground.volume == pytest.approx(by_trapezoids, rel=1e-6)


def test_a_section_is_a_body_in_2d():
    section = hills().section((0, 0), (14, 0))
    assert section.heights == pytest.approx(hills().heights[:, 0])
    ground = section.ground(1.0)
    x, z = section.lines[0], section.heights - 1.0
    assert ground.volume == pytest.approx(np.trapezoid(z, x), rel=1e-13)
    points = mpm.fill(lattice(14.0, 5.0), ground, 2, 1800.0, exact=True)
    assert abs(points.volume_error) < 1e-12
    slanting = hills().section((1, 1), (11, 6))
    at = np.array([[1.0, 1.0], [11.0, 6.0]]).T
    assert slanting.heights[[0, -1]] == pytest.approx(hills()(at))
    assert len(hills().section((1, 1), (11, 6), count=7).lines[0]) == 8


# -- files ----------------------------------------------------------------------------------

ASCII = """\
ncols 3
nrows 2
xllcorner 100.0
yllcorner 200.0
cellsize 10.0
NODATA_value -9999
1 2 3
4 5 6
"""


def test_esri_ascii_grids(tmp_path):
    file = tmp_path / "dem.asc"
    file.write_text(ASCII)
    terrain = mpm.Terrain.from_raster(file, origin=(105.0, 205.0))
    assert [line.tolist() for line in terrain.lines] == [[0, 10, 20], [0, 10]]
    # the first row of the file is the northern one
    assert terrain.heights.tolist() == [[4, 1], [5, 2], [6, 3]]
    file.write_text(ASCII.replace("llcorner", "llcenter"))
    assert mpm.Terrain.from_raster(file).lines[0][0] == 100.0
    part = mpm.Terrain.from_raster(file, window=(105, 195, 125, 215))
    assert part.heights.tolist() == [[5, 2], [6, 3]]
    file.write_text(ASCII.replace("1 2 3", "1 -9999 3"))
    with pytest.raises(ParameterError, match=r"1 of 6 heights are not known.*\[115.0, 215.0\]"):
        mpm.Terrain.from_raster(file)
    file.write_text(ASCII.replace("1 2 3", "1 2"))
    with pytest.raises(OSError, match="5 heights, not 3 x 2"):
        mpm.Terrain.from_raster(file)
    for bad, text in (
        (ASCII.replace("nrows 2", "nrows 2\nncols 3"), "its header has ncols twice"),
        (ASCII.replace("cellsize 10.0", "cellsize nan"), r"its cells are \[nan, nan\] m large"),
    ):
        file.write_text(bad)
        with pytest.raises(OSError, match=text):
            mpm.Terrain.from_raster(file)
    # a word that is a number, and a mark of missing data that the header does not tell
    for bad, text in (
        (ASCII.replace("1 2 3", "nan 2 3"), "1 of 6 heights are not known"),
        (ASCII.replace("1 2 3", "-32768 2 3"), "1 of 6 heights are -32768 m, a mark of missing"),
    ):
        file.write_text(bad)
        with pytest.raises(ParameterError, match=text):
            mpm.Terrain.from_raster(file)
    # cells that are no squares, as GDAL writes them
    file.write_text(ASCII.replace("cellsize 10.0", "dx 10.0\ndy 4.0"))
    ground = mpm.Terrain.from_raster(file)
    assert ground.lines[0].tolist() == [105.0, 115.0, 125.0]
    assert ground.lines[1].tolist() == [202.0, 206.0]
    with pytest.raises(FileNotFoundError, match="no file"):
        mpm.Terrain.from_raster(tmp_path / "none.asc")


def test_geotiff(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    file = tmp_path / "dem.tif"
    place = rasterio.transform.from_origin(100.0, 220.0, 10.0, 10.0)
    kind = {"driver": "GTiff", "width": 3, "height": 2, "count": 1, "dtype": "float64"}
    with rasterio.open(file, "w", transform=place, nodata=-9999.0, **kind) as out:
        out.write(np.array([[1.0, 2, 3], [4, 5, 6]]), 1)
    (tmp_path / "dem.asc").write_text(ASCII)
    one, other = (mpm.Terrain.from_raster(tmp_path / f"dem.{end}") for end in ("tif", "asc"))
    assert one.heights.tolist() == other.heights.tolist()
    assert all((a == b).all() for a, b in zip(one.lines, other.lines))


def test_geotiff_needs_rasterio(tmp_path, monkeypatch):
    (tmp_path / "dem.tif").write_bytes(b"II*\0")
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingPackageError, match="pip install rasterio"):
        mpm.Terrain.from_raster(tmp_path / "dem.tif")


class Opened:
    """A file as rasterio opens it, in metres, with two rows of whole numbers."""

    crs, units, scales, offsets, count = None, (None,), (1.0,), (0.0,), 1
    transform = types.SimpleNamespace(a=1.0, b=0.0, c=0.0, d=0.0, e=-1.0, f=0.0)

    def __init__(self, **entries):
        vars(self).update(entries)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return False

    def read(self, band, masked):
        return np.ma.masked_equal(np.array([[10, 20], [30, 40]], np.int16), -1)


def opened(tmp_path, monkeypatch, **entries):
    own = types.SimpleNamespace(
        open=lambda file: Opened(**entries), errors=types.SimpleNamespace(RasterioError=OSError)
    )
    (tmp_path / "dem.tif").write_bytes(b"II*\0")
    monkeypatch.setitem(sys.modules, "rasterio", own)
    return mpm.Terrain.from_raster(tmp_path / "dem.tif")


def system(**entries):
    """A coordinate reference system of rasterio."""
    names = {"is_geographic": False, "is_projected": True, "linear_units": "metre"}
    return types.SimpleNamespace(**{**names, "linear_units_factor": ("metre", 1.0), **entries})


TURNED = types.SimpleNamespace(a=1.0, b=0.1, c=0.0, d=0.1, e=-1.0, f=0.0)
DEGREES = system(is_geographic=True, is_projected=False)
FEET = system(linear_units="US survey foot", linear_units_factor=("US survey foot", 0.3048006))


@pytest.mark.parametrize(
    ("entries", "text"),
    [
        ({"transform": TURNED}, "turned against north"),
        ({"crs": DEGREES}, "coordinates in degrees"),
        ({"crs": FEET}, "coordinates in US survey foot"),
        ({"crs": system(), "units": ("ft",)}, "heights in 'ft'"),
        ({"count": 3}, "has 3 bands, .* gdal_translate -b 1"),
    ],
)
def test_rasters_of_other_units_or_directions_are_refused(tmp_path, monkeypatch, entries, text):
    with pytest.raises(ParameterError, match=text):
        opened(tmp_path, monkeypatch, **entries)


def test_heights_have_the_scale_of_the_file(tmp_path, monkeypatch):
    """Whole numbers with a scale and an offset were read as metres."""
    more = {"scales": (0.1,), "offsets": (100.0,), "crs": system(), "units": ("m",)}
    hill = opened(tmp_path, monkeypatch, **more)
    np.testing.assert_allclose(hill.heights, [[103.0, 101.0], [104.0, 102.0]], rtol=1e-14)


# -- layers ---------------------------------------------------------------------------------


def test_boundaries_of_layers_go_through_the_boreholes():
    top = hills()
    rng = np.random.default_rng(4)
    at, z = rng.random((7, 2)) * (14.0, 7.5), 1.0 + rng.random(7)
    fine = mpm.Terrain([np.linspace(0, end, 400) for end in (14.0, 7.5)], np.full((400, 400), 9.0))
    clay = fine.from_boreholes(at, z)
    assert clay(at.T) == pytest.approx(z, abs=0.02)
    # a plane where the boreholes are on one, and never above the surface
    plane = top.from_boreholes(at, 2.0 + 0.1 * at[:, 0])
    inside = 2.0 + 0.1 * top.lines[0][:, None] + 0 * top.lines[1]
    assert plane.heights == pytest.approx(np.minimum(inside, top.heights), abs=1e-9)
    assert top.from_boreholes([(1, 1)], [2.0]).heights == pytest.approx(2.0)
    assert np.all(top.from_boreholes([(1, 1), (5, 5)], [9.0, 9.0]).heights <= top.heights)
    with pytest.raises(ParameterError, match="same position"):
        top.from_boreholes([(1, 1), (1, 1)], [1.0, 2.0])


def test_ground_starts_at_rest_with_layers_and_water():
    """Level ground of two layers is in balance at once; a slope is after a few steps."""
    hill = mpm.Terrain(([0, 4, 8],), [3.0, 3.0, 3.0])
    clay = mpm.Terrain(hill.lines, [1.0, 1.0, 1.0])
    for surface in (hill, mpm.Terrain(hill.lines, [3.5, 3.0, 2.5])):
        layers = [
            mpm.Layer(clay, 18e3, K0=0.5, saturated_unit_weight=20e3),
            mpm.Layer(0.0, 17e3, K0=0.7, saturated_unit_weight=19e3),
        ]
        ground = mpm.Deposit(surface, layers, water_table=2.0)
        grid = lattice(8.0, 4.0)
        points = mpm.fill(grid, surface.ground(clay), 2, 1800.0, exact=True)
        points += mpm.fill(grid, clay.ground(0.0), 2, 1800.0, exact=True, tag=1)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        sand, soft = mpm.materials.Hencky(50e6, 0.3), mpm.materials.Hencky(20e6, 0.3)
        F = mpm.momentum(sand, points, u, v, tag=0) + mpm.momentum(soft, points, u, v, tag=1)
        F -= ufl.inner(ground.body_force(points), v) * points.dX
        bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
        problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")
        steps = mpm.start_at_rest(problem, ground)
        assert (points["x"] == points["x0"]).all()
        if surface is hill:
            assert steps == 0
            low = points["x"][:, 1] < 0.2
            wanted = ground.stress(points["x"][low].T)
            assert points["stress"][low] == pytest.approx(wanted, abs=1e-6)
        else:
            assert 0 < steps < 6
        problem.step()
        assert np.abs(points["x"] - points["x0"]).max() < 1e-6
        points["F"] = 1.01 * np.eye(points["F"].shape[1])
        with pytest.raises(ParameterError, match="deformed"):
            mpm.start_at_rest(problem, ground)


# -- rigid beds -----------------------------------------------------------------------------


def test_a_bed_is_closed_and_below_the_bilinear_surface():
    terrain = hills()
    bed = mesh_surface(terrain.solid(bottom=0.0))
    x, y = (np.linspace(line[0] + 0.01, line[-1] - 0.01, 60) for line in terrain.lines)
    at = np.stack(np.meshgrid(x, y, indexing="ij")).reshape(2, -1)
    above = np.column_stack([at.T, terrain(at) + 1e-6])
    assert (bed.probe(above)[0] > 0).all()
    # at the nodes both surfaces are the same
    nodes = np.stack(np.meshgrid(*terrain.lines, indexing="ij")).reshape(2, -1)
    on = np.column_stack([nodes.T, terrain(nodes)])
    assert bed.probe(on)[0] == pytest.approx(0.0, abs=1e-9)
    assert mpm.RigidBody(terrain.section((0, 0), (14, 0)).solid(0.0)).gdim == 2


def test_debris_on_a_bed_keeps_its_momentum_balance():
    """The momentum of a lens on an inclined bed is the impulse of its weight and of the bed."""
    x, y = np.meshgrid(np.linspace(0, 16, 9), np.linspace(0, 8, 5))
    bed = mpm.Terrain.from_raster(9.0 - 0.5 * x + 0.1 * (y - 4) ** 2, spacing=2.0)
    lens = np.maximum(1.5 - 0.3 * ((x - 5) ** 2 + (y - 4) ** 2), 0.0)
    # the corners of the domains are outside of the bed at first
    debris = bed.raised(lens.T).ground(bottom=bed.raised(0.3))
    grid = mpm.create_lattice(COMM, [np.arange(0, 17.0), np.arange(0, 9.0), np.arange(0, 13.0)])
    points = mpm.fill(grid, debris, 2, 2000.0, exact=True)
    V = mpm.Space(grid, "gimp", domains="volume")
    u, v = V.increment, V.test
    rigid = mpm.RigidBody(bed.solid(bottom=0.0), name="bed")
    F = mpm.momentum(mpm.materials.Hencky(2e5, 0.3), points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, 0.0, -9.81)), v) * points.dX
    F += mpm.contact(rigid, points, u, v, friction=0.2)
    problem = mpm.Explicit(F, u, points, mapping="apic")
    weight = 2000.0 * debris.volume * np.array([0.0, 0.0, -9.81])
    forces, times, momenta = [], [], []
    for t in mpm.times(0.8, dt="auto", at_once=1):
        record = problem.step(t)
        forces.append(record.bodies["bed"]["force"])
        times.append(record.time)
        momenta.append(problem.momentum())
    # the force that a record has acts in the next step
    pushed = (weight - np.array(forces[:-1])) * np.diff(times)[:, None]
    balance = momenta[0] + np.cumsum(pushed, axis=0)
    largest = np.abs(momenta).max()
    assert np.array(momenta[1:]) == pytest.approx(balance, abs=2e-3 * largest)
    assert momenta[-1][0] > 0.2 * abs(weight[2]) * 0.8 * 0.5


# -- bad input ------------------------------------------------------------------------------

MASKED = np.ma.masked_equal([[1.0, 2.0], [-9999.0, 4.0]], -9999.0)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: mpm.Terrain(([0, 1],), [1.0, 2.0, 3.0]), "one value per node"),
        (lambda: mpm.Terrain(([1, 0],), [1.0, 2.0]), "must increase"),
        (lambda: mpm.Terrain.from_raster([[1, 2], [3, 4]]), "needs its spacing"),
        (lambda: mpm.Terrain.from_raster([1, 2], spacing=1.0), "two rows and two columns"),
        (lambda: mpm.Terrain.from_raster([[1, 2], [3, 4]], spacing=-1.0), "spacing = -1 m"),
        (lambda: hills().ground(9.0), "the ground is empty"),
        (lambda: hills().ground(0.0, low=(-1.0, 0.0)), "within the raster"),
        (lambda: hills().solid(5.0), "must be below the lowest height"),
        (lambda: hills().section((0, 0), (0, 0)), "two different ends"),
        (lambda: hills()([[0.0]]), "one row per coordinate"),
        (lambda: hills().raised([1.0]), "one value per node"),
        (lambda: mpm.Terrain.from_raster(MASKED, spacing=1.0), "1 of 4 heights are not known"),
        (lambda: mpm.Terrain.from_raster(MASKED.data, spacing=1.0), "a mark of missing data"),
        (lambda: mpm.Terrain.from_raster(1j * MASKED.data, spacing=1.0), "must be numbers"),
        (lambda: mpm.Terrain.from_raster(MASKED, spacing=1.0, corner=(np.nan, 0)), "2 finite"),
        (lambda: hills().from_boreholes([(1, 1), (1 + 1e-12, 1), (9, 5)], [1, 2, 3]), "same pos"),
        (
            lambda: hills().ground(mpm.Terrain(([50, 60], [0, 5]), np.zeros((2, 2)))),
            "no common ground",
        ),
    ],
)
def test_bad_input_has_a_named_error(make, text):
    with pytest.raises(ParameterError, match=text):
        make()
