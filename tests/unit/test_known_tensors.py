"""Tensors of facets that an earlier problem has computed."""

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.assembly.facettensors import FacetTensors
from dolfinmpm.assembly.knowntensors import KnownTensors


def settled(basis="gimp", h=0.25, **penalty):
    """Positions of the points of a block that leans on a wall, after a step under its weight."""
    lines = [h * np.arange(7), h * np.arange(9)]
    grid = mpm.create_lattice(MPI.COMM_SELF, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (4.3 * h, 5.6 * h)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    F += mpm.ghost(points, u, v, **(penalty or {"factor": 1.0}))
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    mpm.QuasiStatic(F, u, points, bcs).step()
    return points["x"].copy()


@pytest.fixture
def computed(monkeypatch):
    """The places of all facets whose tensors are computed from now on."""
    places, parts = [], FacetTensors.parts

    def counted(self, place, moduli):
        places.append(place)
        return parts(self, place, moduli)

    monkeypatch.setattr(FacetTensors, "parts", counted)
    return places


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_second_run_computes_no_tensors_and_is_the_same(basis, computed):
    first = settled(basis, h=0.2501)
    assert computed
    computed.clear()
    again = settled(basis, h=0.2501)
    assert not computed
    assert np.array_equal(first, again)


@pytest.mark.parametrize(
    "other", [{"h": 0.2503}, {"factor": 3.0}, {"gamma": 4e5}, {"basis": "bspline3"}]
)
def test_another_penalty_or_grid_has_tensors_of_its_own(other, computed, monkeypatch):
    settled(h=0.2502)
    computed.clear()
    found = settled(**({"h": 0.2502} | other))
    # as without any tensor that is known
    monkeypatch.setattr("dolfinmpm.assembly.splinefacets.KNOWN", KnownTensors(1))
    count = len(computed)
    assert np.array_equal(found, settled(**({"h": 0.2502} | other)))
    assert len(computed) > count


def test_tensors_are_forgotten_before_they_take_too_much():
    known, calls = KnownTensors(100), []

    def tensor():
        calls.append(1)
        return np.zeros(6)

    for key in ("a", "b", "a"):
        assert not known.get(key, tensor).flags.writeable
    assert len(calls) == 2
    # three of 48 bytes are more than 100
    known.get("c", tensor)
    known.get("a", tensor)
    assert len(calls) == 4
