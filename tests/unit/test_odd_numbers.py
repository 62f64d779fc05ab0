"""Numbers of odd kinds: huge, masked, of few bits, complex, and functions of time that fail."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import DolfinMPMError, ParameterError

HUGE = 10**400
AT = [(0.5, 0.5), (1.5, 0.5)]
MASKED = np.ma.array([0.2, 0.3], mask=[False, True])


def grid_of():
    return mpm.create_lattice(COMM, [range(4), range(3)])


def points_of(**given):
    usual = {"x": AT, "volume": 0.2, "density": 1000.0}
    return mpm.MaterialPoints.from_arrays(grid_of(), **(usual | given))


LARGE = {
    "Hencky": lambda: mpm.materials.Hencky(HUGE, 0.3),
    "VonMises": lambda: mpm.materials.VonMises(1e6, 0.3, yield_stress=HUGE),
    "Box": lambda: mpm.Box((0, 0), (1, HUGE)),
    "Disc": lambda: mpm.Disc((0, 0), HUGE),
    "Disc of 1e300": lambda: mpm.Disc((0, 0), 1e300),
    "Wedge": lambda: mpm.Wedge((0, 0), 30.0, 1e300),
    "fill": lambda: mpm.fill(grid_of(), mpm.Box((0, 0), (1, 1)), 2, HUGE),
    "per_cell": lambda: mpm.fill(grid_of(), mpm.Box((0, 0), (1, 1)), HUGE, 1.0),
    "from_arrays": lambda: points_of(volume=HUGE),
    "Fluid": lambda: mpm.Fluid(HUGE),
    "times": lambda: list(mpm.times(HUGE, dt=1.0)),
    "set": lambda: points_of().__setitem__("density", HUGE),
    "reversals": lambda: mpm.materials.HardinDrnevich(
        1e6, 0.3, reference_strain=1e-3, reversals=HUGE
    ),
}


@pytest.mark.parametrize("name", LARGE)
def test_numbers_beyond_floats(name):
    with pytest.raises(DolfinMPMError):
        LARGE[name]()


@pytest.mark.parametrize("name", ["volume", "density", "half_length"])
def test_masked_values_are_not_what_is_under_the_mask(name):
    # as of rasters and files of netCDF
    given = (
        MASKED if name != "half_length" else np.ma.array(np.full((2, 2), 0.2), mask=[[1, 0]] * 2)
    )
    with pytest.raises(DolfinMPMError, match="nan"):
        points_of(**{name: given})
    points_of(**{name: np.ma.array(given.data)})


def test_masked_values_of_fields_and_laws():
    points = points_of()
    with pytest.raises(ParameterError, match=r"1 values for field 'density' are masked"):
        points["density"] = MASKED
    with pytest.raises(ParameterError, match=r"Hencky: E = .* must be a number"):
        mpm.materials.Hencky(MASKED, 0.3)
    assert np.all(points["density"] == 1000.0)
    points["density"] = np.ma.array([900.0, 800.0])
    assert points["density"].tolist() == [900.0, 800.0]


def test_complex_values_do_not_lose_their_imaginary_part():
    with pytest.raises(DolfinMPMError, match="volume should be numbers"):
        points_of(volume=np.array([0.2 + 1j, 0.2]))
    with pytest.raises(DolfinMPMError, match="density should return numbers"):
        points_of(density=lambda x: 1000.0 + 1j * x[0])


def test_whole_numbers_of_few_bits():
    box = mpm.Box((0, 0), (2, 1))
    points = mpm.fill(grid_of(), box, np.int8(12), 1.0)
    assert points.total == 2 * 12**2
    assert points["V"].sum() == pytest.approx(2.0)


def test_arguments_that_may_be_infinite_are_single_numbers():
    several = np.array([1.0, 2.0])
    with pytest.raises(ParameterError, match="bottom = "):
        mpm.Layer(several, 18e3, 0.5)
    with pytest.raises(ParameterError, match="bulk_modulus = "):
        mpm.Fluid(bulk_modulus=several)
    with pytest.raises(ParameterError, match="surface = None must be a number"):
        mpm.Deposit(None, [mpm.Layer(-5.0, 18e3, 0.5)])
    with pytest.raises(ParameterError, match="needs lines"):
        mpm.Terrain(np.array(0.5), np.zeros((2, 2)))
    mpm.Layer(-np.inf, 18e3, 0.5)
    assert not mpm.Fluid(bulk_modulus=np.float64(np.inf)).compressible


@pytest.mark.parametrize("error", [ZeroDivisionError, IndexError, ValueError])
def test_functions_of_time_that_fail(error):
    def velocity(t):
        raise error("of the user")

    with pytest.raises(ParameterError, match=f"velocity, a .* at 0 s with {error.__name__}: of"):
        mpm.moving(mpm.Space(grid_of()), "left", 0, velocity=velocity)
