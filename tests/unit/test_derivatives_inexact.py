"""Derivatives of runs with laws whose tangent is not the derivative of their stress."""

from __future__ import annotations

import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.materials import Law, Parameter, law_kernel

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import SOFT, column, errors_of, mean_of, motion_of
from umats import ELASTIC, NEEDS_FORTRAN, written

GIVEN = {"p0": 2e3, "G": 6e3, "load": 300.0, "share": 1.0}


@law_kernel
def _stiffening(parameters, strain, old, new, stress, tangent):
    p0, G, share = parameters[0], parameters[1], parameters[2]
    volume = strain[0] + strain[1] + strain[2]
    for i in range(3):
        stress[i] = p0 * (1.0 - np.exp(-10.0 * volume)) + 2.0 * G * (strain[i] - volume / 3.0)
        for j in range(3):
            # the bulk modulus is that at no strain
            tangent[3 * i + j] = share * 10.0 * p0 - 2.0 * G / 3.0
        tangent[4 * i] += 2.0 * G
    return 0


class Stiffening(Law):
    """Bulk modulus that grows with pressure, with the tangent at no strain times a share."""

    parameters = {name: Parameter("", low=0.0) for name in ("p0", "G", "share")}
    kernel = _stiffening


def compressed(m, share=1.0):
    """A column under a load on its top, in two steps."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1.5, 3.5)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    load = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(Stiffening(p0=m["p0"], G=m["G"], share=share), points, V.increment, V.test)
    F -= ufl.inner(load, V.test) * points.dX
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.rollers(V, "left") + mpm.fixed(V, "bottom"),
        stabilisation="ghost", tolerance=1e-12, max_iterations=100,
    )  # fmt: skip

    def step(k):
        load.value[:] = 0.1 * k * m["load"], -k * m["load"]
        problem.step()

    stress = lambda: mean_of(points, points["stress"])  # noqa: E731
    steps = [partial(step, k) for k in (1, 2)]
    return study.Run(problem, steps, {"motion": motion_of(points), "stress": stress})


@pytest.mark.parametrize(
    ("names", "options"),
    [(["p0"], {}), (["p0", "G", "load"], {}), (["p0", "G"], {"central": True})],
)
def test_tangents_that_are_not_derivatives_need_more_corrections(names, options):
    scene = lambda m: compressed({**GIVEN, **m})  # noqa: E731
    chosen = {name: GIVEN[name] for name in names}
    found = study.differentiate(scene, chosen, **options)
    assert not found.notes
    assert max(errors_of(scene, chosen, found).values()) < 2e-6


def test_tangents_with_which_corrections_do_not_contract_are_told(monkeypatch):
    from dolfinmpm.study import tapedtangent

    monkeypatch.setattr(tapedtangent, "MOST", 1)
    scene = lambda m: compressed({**GIVEN, **m}, share=1.2)  # noqa: E731
    found = study.differentiate(scene, {"p0": GIVEN["p0"]})
    assert "derivatives may be wrong" in found.notes[0]


def test_motions_that_are_lost_in_the_rounding_of_positions_are_told(tmp_path):
    stiff = SOFT | {"E": 1e8}
    found = study.differentiate(column, stiff)
    match = "positions up to 1.89 m are rounded to .* derivatives may have errors of 4e-04; larger"
    assert re.search(match, found.notes[-1])
    error = max(errors_of(column, stiff, found, 1e-3).values())
    assert 1e-6 < error < 1e-3
    # also after a restart
    for _ in range(2):
        again = study.differentiate(column, stiff, restart=tmp_path, every=2)
    assert again.notes[-1] == found.notes[-1]
    more = study.differentiate(column, stiff, central=True, epsilon=1e-5)
    assert not more.notes
    assert max(errors_of(column, stiff, more, 1e-3).values()) < 1e-6
    # what does not move at all has no such errors
    assert not study.differentiate(column, SOFT).notes


@NEEDS_FORTRAN
def test_umats_whose_stress_jumps_as_their_substeps_do(tmp_path):
    """A jump of 1e-7 of the stress beside the strain of the run had more than doubled the slope."""
    jump = "if (abs(dstran(2)) > 0.0025d0*(1 + 4d-8)) stress = stress*(1 + 1d-7)"
    law = written(tmp_path, ELASTIC + jump)

    def pressed(m):
        grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=2000.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(law, points, V.increment, V.test, strain="small")
        bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-m["way"])
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)
        figures = {"stress": lambda: mean_of(points, points["stress"][:, 1, 1])}
        return study.Run(problem, [problem.step], figures)

    found = study.differentiate(pressed, {"way": 0.01})
    ratio = found.derivatives["stress"]["way"] / found.figures["stress"]
    np.testing.assert_allclose(ratio, 1.0, atol=1e-3)
