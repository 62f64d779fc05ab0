"""Recorded motions of the ground: integrals, correction of the baseline, files, moving sides."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM, unit_grid

import dolfinmpm as mpm
from dolfinmpm._platform.errors import DriftingRecordWarning, ParameterError


def quake(seed=3):
    """A random acceleration of 5 s, corrected."""
    t = np.linspace(0.0, 5.0, 501)
    noise = np.random.default_rng(seed).normal(size=t.size) * np.sin(np.pi * t / 5.0)
    return mpm.InputMotion(t, acceleration=noise + 0.1)


def test_a_linear_acceleration_has_exact_integrals():
    """Acceleration 6 t gives the velocity 3 t² and the displacement t³, between samples too."""
    t = np.array([0.0, 0.3, 1.0, 2.0])
    record = mpm.InputMotion(t, acceleration=6 * t)
    with pytest.warns(DriftingRecordWarning, match="12 m/s"):
        record(0.0)
    for at in (0.1, 0.3, 0.7, 1.9):
        assert record.acceleration(at) == pytest.approx(6 * at, rel=1e-14)
        assert record(at) == pytest.approx(3 * at**2, rel=1e-14)
        assert record.displacement(at) == pytest.approx(at**3, rel=1e-13)
    assert (record.drift, record.left) == (pytest.approx(12.0), pytest.approx(8.0))
    # before it the ground is at rest, after it goes on
    assert record(-1.0) == record.acceleration(3.0) == 0.0
    assert record(3.0) == pytest.approx(12.0)
    assert record.displacement(3.0) == pytest.approx(20.0)


@pytest.mark.parametrize("kind", ["acceleration", "velocity"])
def test_a_corrected_record_comes_to_rest_where_it_began(kind):
    record = quake()
    with pytest.warns(DriftingRecordWarning):
        values = [record(t) for t in record.time]
    if kind == "velocity":
        record = mpm.InputMotion(record.time, velocity=values)
    better = record.corrected()
    largest = max(abs(record.displacement(t)) for t in record.time)
    assert abs(better.drift) < 1e-12
    assert abs(better.left) < 1e-12 * largest
    assert better(0.0) == values[0] == 0.0
    # what is left out is a line in the acceleration
    less = [record.acceleration(t) - better.acceleration(t) for t in record.time[:-1] + 0.005]
    line = np.polyfit(record.time[:-1], less, 1)
    assert less == pytest.approx(np.polyval(line, record.time[:-1]), abs=1e-3)


def test_a_record_is_scaled():
    record = quake().corrected()
    half = record.scaled(0.5)
    for t in (0.7, 2.22, 4.9):
        assert half(t) == pytest.approx(0.5 * record(t), rel=1e-12)


@pytest.mark.parametrize("mark", [",", ";", "  "])
def test_a_record_from_a_file(tmp_path, mark):
    path = tmp_path / "record.csv"
    path.write_text(f"El Centro\ntime{mark}g\n0{mark}0\n1{mark}0.5\n\n2{mark}-0.5\n3{mark}0\n")
    record = mpm.InputMotion.from_csv(path, factor=9.81, skip=2)
    assert record.acceleration(1.5) == pytest.approx(0.0, abs=1e-15)
    assert record(1.0) == pytest.approx(9.81 / 4)
    path.write_text("0 0\n1 2\n")
    with pytest.warns(DriftingRecordWarning):
        assert mpm.InputMotion.from_csv(path, kind="velocity")(0.5) == 1.0


def test_a_record_as_spreadsheets_write_it(tmp_path):
    """With a byte order mark, remarks, and a heading in another encoding."""
    path = tmp_path / "record.csv"
    path.write_bytes(b"\xef\xbb\xbf0;0\r\n1;2 # peak\r\n# end\r\n2;0\r\n")
    assert mpm.InputMotion.from_csv(path, kind="velocity")(1.0) == 2.0
    path.write_bytes("Erschütterung\n0 0\n1 2\n2 0\n".encode("latin-1"))
    assert mpm.InputMotion.from_csv(path, kind="velocity", skip=1)(1.0) == 2.0


def test_steps_that_pass_over_waves_of_a_record():
    """The base had gone another way than the record, in silence."""
    t = np.arange(0.0, 1.0, 0.005)
    record = mpm.InputMotion(t, velocity=np.sin(2 * np.pi * 20 * t) * np.sin(np.pi * t) ** 2)
    points = mpm.fill(unit_grid("quadrilateral", 4), mpm.Box((0.25, 0), (0.5, 0.25)), 2, 1000.0)
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    bcs = [*mpm.moving(V, "bottom", 0, velocity=record), *mpm.rollers(V, "bottom")]
    problem = mpm.Newmark(F, V.increment, points, bcs)
    for t in mpm.times(0.3, dt=0.005):
        problem.step(t)
    with pytest.warns(DriftingRecordWarning, match=r"step of 0.04 s .* passes over waves"):
        problem.step(0.34)


def test_files_that_are_no_records(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(OSError, match=r"record.csv, line 1: 'a,b' is no time .*skip="):
        mpm.InputMotion.from_csv(path)
    path.write_text("0 0\n\n1\n2\n")
    with pytest.raises(OSError, match="line 3: '1' is no time with a value"):
        mpm.InputMotion.from_csv(path)
    with pytest.raises(OSError, match="no line of numbers after 9 of its 4 lines"):
        mpm.InputMotion.from_csv(path, skip=9)
    path.write_bytes("0 Erschütterung".encode("latin-1"))
    with pytest.raises(OSError, match="line 1: '0 Ersch"):
        mpm.InputMotion.from_csv(path)
    with pytest.raises(ParameterError, match="kind = 'force'"):
        mpm.InputMotion.from_csv(path, kind="force")
    with pytest.raises(OSError, match=r"there is no file .*none"):
        mpm.InputMotion.from_csv(tmp_path / "none")


@pytest.mark.parametrize(
    ("time", "given", "message"),
    [
        ([0, 1], {}, "either acceleration= .* or velocity="),
        ([0, 1], {"velocity": [0, 0], "acceleration": [0, 0]}, "one of both"),
        ([0, 1, 2], {"velocity": [0, 0]}, r"shape \(3,\) and velocity \(2,\)"),
        ([0], {"velocity": [0]}, "at least 2"),
        ([0, 2, 1], {"velocity": [0, 0, 0]}, "increase"),
        ([-1, 2], {"velocity": [0, 0]}, "begin at 0"),
        ([0, 1], {"velocity": [0, np.nan]}, "sample 1 .* finite"),
    ],
)
def test_records_that_cannot_be(time, given, message):
    with pytest.raises(ParameterError, match=message):
        mpm.InputMotion(time, **given)


def test_two_velocities_cannot_be_corrected():
    with pytest.raises(ParameterError, match=r"2 velocities .* at least 3"):
        mpm.InputMotion([0, 1], velocity=[0, 1]).corrected()
    assert mpm.InputMotion([0, 1], acceleration=[0, 1]).corrected().drift == pytest.approx(0.0)


def test_a_side_moves_by_a_record():
    """A side takes the velocity by the trapezoidal rule, which is exact between samples."""
    t = np.linspace(0.0, 1.0, 11)
    record = mpm.InputMotion(t, velocity=0.02 * np.sin(np.pi * t) ** 2)
    grid = mpm.create_lattice(COMM, [range(6), range(4)])
    points = mpm.fill(grid, mpm.Box((1, 0), (3, 1)), per_cell=2, density=1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e9, 0.3), points, V.increment, V.test)
    bcs = mpm.moving(V, "bottom", 0, velocity=record) + mpm.prescribed(V, "bottom", 1)
    problem = mpm.Newmark(F, V.increment, points, bcs, mass="lumped")
    for at in t[1:]:
        problem.step(at)
    # the block is nearly rigid, with waves of 1 km/s
    moved = points["x"] - points["x0"]
    assert moved[:, 0] == pytest.approx(record.displacement(1.0), rel=2e-3)
