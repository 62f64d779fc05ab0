"""Kernels of one's own that touch more than their arrays, or cannot be compiled."""

from __future__ import annotations

import pytest

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, StateError, UserLawError
from dolfinmpm.materials import Law, Parameter, law_kernel


@law_kernel
def stiff(parameters, strain, old, new, stress, tangent):
    new[0] = old[0]
    new[1] = strain[0]
    for i in range(3):
        stress[i] = parameters[0] * strain[i]
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j)
    return 0


@law_kernel
def too_stiff(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i] + 1e3 * max(strain[i], 0.0)
        for j in range(3):
            tangent[3 * i + j] = 2.0 * parameters[0] * (i == j)
    return 0


@law_kernel
def reading(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[1] * strain[i]
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j)
    return 0


@law_kernel
def leaving(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i]
        tangent[4 * i] = parameters[0]
    return 0


@law_kernel
def without_return(parameters, strain, old, new, stress, tangent):
    stress[0] = 0.0


@law_kernel
def refusing(parameters, strain, old, new, stress, tangent):
    return 1


def own(kernel, *internal):
    """A law of one parameter with a kernel."""
    names = dict.fromkeys(internal, ("", 0.0))
    declared = {"parameters": {"E": Parameter("Pa")}, "internal": names, "kernel": kernel}
    return type("Own", (Law,), declared)(E=1e6)


@pytest.mark.parametrize(
    ("law", "told"),
    [
        (own(stiff, "a"), r"writes beyond `new`, which has 1 numbers here: declare all internal"),
        (own(stiff), r"writes beyond `new`, which has 0 numbers"),
        (own(reading), r"reads beyond its arrays: `stress` depends .* 1 parameters and 0 internal"),
        (own(leaving), r"does not write tangent\[1\]: write every entry"),
        (own(without_return), r"Numba cannot compile the kernel without_return.* return 0 at"),
    ],
)
def test_a_faulty_kernel_is_refused(law, told):
    """One variable too few had written into the next point's, without a message."""
    with pytest.raises(UserLawError, match=told):
        law.respond([[1e-3, 0.0, 0.0]])


def test_a_sound_kernel():
    assert own(stiff, "a", "b").respond([[1e-3, 0.0, 0.0]]).stress[0].tolist() == [1e3, 0.0, 0.0]
    with pytest.raises(StateError, match="Its kernel did not return 0"):
        own(refusing).respond([[0.0, 0.0, 0.0]])
    with pytest.raises(StateError, match=r"Take a smaller strain, or a smaller fall of strength$"):
        mpm.materials.Tresca(1e6, 0.3, 1e3).respond([[float("nan"), 0.0, 0.0]])


def test_a_wrong_tangent_is_told():
    (told,) = own(too_stiff).check()
    assert "has a wrong tangent: tangent[" in told
    assert "differences of the stress give" in told
    assert own(stiff, "a", "b").check() == []
    with pytest.raises(ParameterError, match="strain = 0"):
        own(stiff, "a", "b").check(strain=0.0)


@law_kernel
def wrong_beyond_yield(parameters, strain, old, new, stress, tangent):
    """Yields at a strain of 5 %, with the elastic tangent."""
    for i in range(3):
        stress[i] = parameters[0] * min(max(strain[i], -0.05), 0.05)
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j)
    return 0


def test_a_wrong_tangent_beyond_a_late_yield_is_told():
    (told,) = own(wrong_beyond_yield).check()
    assert "has a wrong tangent" in told
    assert own(wrong_beyond_yield).check(strain=1e-2) == []


def yielding(parameters, strain, old, new, stress, tangent):
    """Each axis alone is perfectly plastic beyond a strain of 0.1 %."""
    new[0] = old[0]
    for i in range(3):
        kept = min(max(strain[i], -1e-3), 1e-3)
        new[0] += abs(strain[i] - kept)
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j) * (kept == strain[i])
        stress[i] = parameters[0] * kept
    return 0


@law_kernel
def keeping(parameters, strain, old, new, stress, tangent):
    new[0] = old[0]
    for i in range(3):
        kept = min(max(strain[i], -1e-3), 1e-3)
        new[0] += abs(strain[i] - kept)
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j) * (kept == strain[i])
        stress[i] = parameters[0] * kept
        strain[i] = kept
    return 0


def test_a_return_mapping_without_elastic_strains_is_refused():
    """Each step had yielded anew by the whole strain, without a message."""
    with pytest.raises(UserLawError, match=r"'flow' changes at the .* write the elastic strains"):
        own(law_kernel(yielding), "flow").respond([[1e-6, 0.0, 0.0]])
    assert own(keeping, "flow").check() == []


@pytest.mark.parametrize(
    "law",
    [
        mpm.materials.Tresca(1e6, 0.3, 1e2),
        mpm.materials.MohrCoulomb(1e6, 0.3, 1e2, 30.0, residual_cohesion=50.0, rate=1.0),
        mpm.materials.VonMises(1e6, 0.3, yield_stress=1e2),
        mpm.materials.DruckerPrager(1e6, 0.3, 1e2, 30.0),
    ],
)
def test_tangents_of_the_library_pass(law):
    assert law.check() == []


@law_kernel
def refusing_tension(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i]
        for j in range(3):
            tangent[3 * i + j] = 2.0 * parameters[0] * (i == j)
    return int(strain[0] + strain[1] + strain[2] > 0.0)


@law_kernel
def writing_and_refusing(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i]
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j)
    return 1


@law_kernel
def layered(parameters, strain, old, new, stress, tangent):
    """Twice as stiff along the first axis."""
    for i in range(3):
        stiffness = parameters[0] * (2.0 if i == 0 else 1.0)
        stress[i] = stiffness * strain[i]
        for j in range(3):
            tangent[3 * i + j] = stiffness * (i == j)
    return 0


@law_kernel
def adding(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = parameters[0] * strain[i] + parameters[1]
        for j in range(3):
            tangent[3 * i + j] = parameters[0] * (i == j)
    return 0


def test_the_check_goes_on_after_a_strain_without_a_stress():
    (fault,) = own(refusing_tension).check()
    assert "has a wrong tangent" in fault
    for kernel in (refusing, writing_and_refusing):
        (fault,) = own(kernel).check()
        assert "finds no stress at any strain" in fault


def test_the_check_finds_a_law_that_is_not_isotropic():
    (fault,) = own(layered).check()
    assert "depends on the order of the axes" in fault


def test_a_sum_with_a_number_beyond_the_parameters_is_a_read():
    with pytest.raises(UserLawError, match="reads beyond its arrays: `stress` depends"):
        own(adding).respond([[0.0, 0.0, 0.0]])


def test_what_python_alone_can_do_is_refused():
    def raising(parameters, strain, old, new, stress, tangent):
        if strain[0] > 1.0:
            raise ValueError("too large")
        return 0

    def printing(parameters, strain, old, new, stress, tangent):
        print(strain[0])
        return 0

    for kernel, told in ((raising, "raises or asserts.* return 1"), (printing, "prints")):
        with pytest.raises(ParameterError, match=told):
            law_kernel(kernel)
