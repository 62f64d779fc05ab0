"""UMATs from sources and libraries: compilation, included files, utility routines, arguments."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from mpi4py import MPI
from umats import ELASTIC, FOLDER, HEAD, NEEDS_FORTRAN, column, written

import dolfinmpm as mpm

pytestmark = NEEDS_FORTRAN
COMM = MPI.COMM_WORLD


def test_the_same_source_is_compiled_once(tmp_path, monkeypatch):
    law = written(tmp_path)
    monkeypatch.setattr(subprocess, "run", _refuse(subprocess.run))
    assert written(tmp_path).library == law.library
    assert written(tmp_path, properties=[2e6]).library == law.library
    with pytest.raises(AssertionError):
        written(tmp_path, ELASTIC + "! another")


def _refuse(run):
    def only_versions(command, *args, **options):
        assert command[1:] == ["--version"]
        return run(command, *args, **options)

    return only_versions


def test_long_lines_and_included_files(tmp_path):
    (tmp_path / "half.inc").write_text("      HALF = 0.5D0\n")
    text = (FOLDER / "elastic.f").read_text().replace("0.5D0*PROPS(1)", "HALF*PROPS(1)")
    line = "      G = HALF"
    text = text.replace(
        line, "      INCLUDE 'half.inc'\n      ZERO = 0D0" + " " * 80 + "+ 1D0\n" + line
    )
    source = tmp_path / "long.for"
    source.write_text(text.replace("+ 1D0", "+ 0D0 + 0D0"))
    law = mpm.materials.UMAT(source, [1e6, 0.3])
    assert law.check() == []
    (tmp_path / "half.inc").write_text("      HALF = 0.25D0\n")
    assert mpm.materials.UMAT(source, [1e6, 0.3]).library != law.library


def test_a_library_compiled_elsewhere(tmp_path):
    source = tmp_path / "own.f90"
    source.write_text(f"{HEAD}\n{ELASTIC}\n if (props(1) < 0) call xit\nend subroutine\n")
    command = ["gfortran", "-shared", "-fPIC", "own.f90", "-o", "own.so"]
    subprocess.run(command, cwd=tmp_path, check=True)
    law = mpm.materials.UMAT(tmp_path / "own.so", [1e6])
    assert law.check() == []
    source.write_text(f"{HEAD}\n{ELASTIC}\n if (stress(2) < -1d3) stop 1\nend subroutine\n")
    subprocess.run([*command[:-1], "stop.so"], cwd=tmp_path, check=True)
    law = mpm.materials.UMAT(tmp_path / "stop.so", [1e6])
    with pytest.raises(mpm.errors.StateError, match="STOP"):
        mpm.study.element_test(law, "oedometer", -0.1, strain="small")
    source.write_text("subroutine other\nend\n")
    subprocess.run([*command[:-1], "other.so"], cwd=tmp_path, check=True)
    with pytest.raises(mpm.errors.UserLawError, match="umat_"):
        mpm.materials.UMAT(tmp_path / "other.so", [1e6])


def test_utility_routines(tmp_path):
    body = """
    call rotsig(stress, drot, statev, 1, ndi, nshr)
    call rotsig(dstran, drot, statev(7), 2, ndi, nshr)
    call sinv(stress, statev(13), statev(14), ndi, nshr)
    call sprinc(stress, statev(15), 1, ndi, nshr)
    call sprind(stress, statev(18), statev(21), 1, ndi, nshr)
    """
    law = written(tmp_path, body, state=29)
    rng = np.random.default_rng(3)
    work = law.work(rng.uniform(-1, 1, (1, 6)), np.zeros((1, 29)))
    Q = np.linalg.qr(rng.uniform(-1, 1, (3, 3)))[0]
    work[0, 6:12], work[0, 54:63] = rng.uniform(-1, 1, 6), Q.ravel(order="F")
    order = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]

    def tensor(v, shear=1.0):
        v = np.concatenate([v[:3], shear * v[3:]])
        return v[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]

    sigma, strain = tensor(work[0, :6]), tensor(work[0, 6:12], 0.5)
    assert law.call(work).tolist() == [0]
    out = work[0, -29:]
    np.testing.assert_allclose(out[:6], (Q @ sigma @ Q.T)[order], atol=1e-14)
    engineering = np.array([1, 1, 1, 2, 2, 2])
    np.testing.assert_allclose(out[6:12], (Q @ strain @ Q.T)[order] * engineering, atol=1e-14)
    deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
    mises = np.sqrt(1.5 * np.sum(deviator**2))
    np.testing.assert_allclose(out[12:14], [np.trace(sigma) / 3, mises])
    np.testing.assert_allclose(np.sort(out[14:17]), np.linalg.eigvalsh(sigma), atol=1e-14)
    directions = out[20:29].reshape(3, 3, order="F")
    rebuilt = directions.T @ np.diag(out[17:20]) @ directions
    np.testing.assert_allclose(rebuilt, sigma, atol=1e-14)


def test_time_position_and_number_reach_the_umat(tmp_path):
    body = ELASTIC + "statev(1:5) = [time(2), dtime, coords(1), coords(2), real(noel, 8)]"
    names = ["started", "lasts", "place", "height", "noel"]
    problem = column(written(tmp_path, body, state=names), mpm.Newmark)
    points = problem.points
    np.testing.assert_allclose(points["started"], 0.15)
    np.testing.assert_allclose(points["lasts"], 0.15)
    assert np.array_equal(points["noel"], points["id"])
    moved = np.abs(points["place"] - points["x"][:, 0])
    assert 0 < moved.max() < 0.2
