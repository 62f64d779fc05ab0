"""UMATs: the same digits as built-in laws, tangents, faults that are told."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from umats import ELASTIC, FOLDER, HEAD, NEEDS_FORTRAN, umat, written

import dolfinmpm as mpm
from dolfinmpm.kinematics import strain_formulation
from dolfinmpm.kinematics.strainformulation import symmetric

pytestmark = NEEDS_FORTRAN
COMM = MPI.COMM_WORLD

PAIRS = {
    "elastic": (
        lambda: umat("elastic.f", [1e6, 0.3]),
        lambda: mpm.materials.Hencky(1e6, 0.3),
    ),
    "mises": (
        lambda: umat("mises.f", [1e6, 0.3, 2e5, 1e5], ["plastic_strain"]),
        lambda: mpm.materials.VonMises(1e6, 0.3, yield_stress=2e5, hardening=1e5),
    ),
    "mohr_coulomb": (
        lambda: umat("mohr_coulomb.f90", [1e6, 0.3, 1e5, 30.0, 10.0]),
        lambda: mpm.materials.MohrCoulomb(1e6, 0.3, 1e5, 30.0, dilation_angle=10.0),
    ),
}


def bodies(dim):
    """A body of some points, 2D, 3D or axisymmetric, twice."""
    d = 3 if dim == 3 else 2
    grid = mpm.create_lattice(COMM, [range(4)] * d)
    box = mpm.Box((0,) * d, (3,) * d)
    return [mpm.fill(grid, box, 2, 1.0, axisymmetric=dim == "axisymmetric") for _ in range(2)]


@pytest.mark.parametrize("law", PAIRS)
@pytest.mark.parametrize("strain", ["jaumann", "small"])
@pytest.mark.parametrize("dim", [2, 3, "axisymmetric"])
def test_stress_and_tangent_are_those_of_the_built_in_law(dim, strain, law):
    rng = np.random.default_rng(0)
    pair, one = bodies(dim), bodies(dim)[0]
    n, e = len(one), one.strain_dim
    F = np.eye(e) + 0.1 * rng.uniform(-1, 1, (n, e, e))
    H = 0.3 * rng.uniform(-1, 1, (n, e, e))
    components = 3e4 * rng.uniform(-1, 1, (n, 6))
    if dim != 3:
        components[:, 4:] = 0.0
    if dim == "axisymmetric":
        for tensor in (F, H):
            tensor[:, :2, 2] = tensor[:, 2, :2] = 0.0
    rows, found = np.arange(n, dtype=np.int32), []
    for points, make in zip(pair, PAIRS[law]):
        points["F"][:] = F
        formulation = strain_formulation(make(), points, strain)
        formulation.bind()
        mpm.set_stress(formulation.law, points, symmetric(components), strain=strain)
        S, A = np.empty((n, e * e)), np.empty((n, e * e, e * e))
        assert formulation.evaluate(H.reshape(n, -1), S, A, rows) == -1
        new = formulation.commit(H.reshape(n, -1), rows)
        if dim == "axisymmetric":  # nothing moves out of the section
            inside = [0, 1, 3, 4, 8]
            A = A[:, inside][:, :, inside]
        found.append((S, A, new["stress"], *[new[k] for k in ("plastic_strain",) if k in new]))
    for own, exact in zip(*found):
        assert np.abs(own - exact).max() < 1e-12 * np.abs(exact).max()


def column(law, kind, **options):
    """A column that leans on a roller and yields under its weight; steps are taken."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 9), np.linspace(0, 6, 13)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 4.2)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann", **options)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = kind(F, V.increment, points, bcs, stabilisation="ghost")
    if kind is mpm.QuasiStatic:
        for load in (2.0, 4.0, 6.0):
            g.value[1] = -load
            problem.step()
    else:
        g.value[1] = -6.0
        problem.step(0.15)
        problem.step(0.3)
    return problem


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Newmark, mpm.Explicit])
def test_a_column_is_that_of_the_built_in_law(kind):
    properties = [1e6, 0.3, 4e4, 2e5]
    law = umat("mises.f", properties, ["plastic_strain"])
    exact = mpm.materials.VonMises(1e6, 0.3, yield_stress=4e4, hardening=2e5)
    problems = [column(one, kind) for one in (law, exact)]
    own, other = (p.points for p in problems)
    assert own["plastic_strain"].max() > 1e-3
    orders = [np.argsort(p["id"]) for p in (own, other)]
    for name in ("x", "stress", "plastic_strain"):
        a, b = (p[name][order] for p, order in zip((own, other), orders))
        assert np.abs(a - b).max() < 1e-9 * np.abs(b).max(), name
    if kind is mpm.QuasiStatic:
        assert problems[0].history[-1].iterations == problems[1].history[-1].iterations
    else:
        assert problems[0].energies().strain > 0.0
    if kind is mpm.Explicit:
        assert not problems[0].unfused


@pytest.mark.parametrize(
    ("d", "scheme", "strain"), [(2, "usl", "jaumann"), (2, "usf", "small"), (3, "musl", "jaumann")]
)
def test_fused_steps_are_the_general_ones(d, scheme, strain, tmp_path):
    body = (
        ELASTIC
        + """
  stress = stress + 1d2*stran*dtime + 1d3*(dfgrd1(1, 2) - dfgrd0(1, 2)) + 1d-3*noel*dstran
  statev(1:3) = statev(1:3) + [time(2), dtime, coords(2)*celent]
  statev(4) = statev(4) + drot(2, 1)
  sse = sse + sum(stress*dstran)
"""
    )
    turn, found = np.array([[0, 2, 1], [-2, 0, 0], [1, 1, 0]]), []
    for fused in (True, False):
        grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 5)] * d)
        points = mpm.fill(grid, mpm.Box((0.5,) * d, (1.5,) * d), 2, 1000.0)
        points["tag"] = points["x"][:, 0] > 1.0
        V = mpm.Space(grid, "gimp")
        laws = [written(tmp_path, body, state=list("abcd")),
                umat("mises.f", [1e6, 0.3, 1e4, 1e5], ["plastic_strain"])]  # fmt: skip
        F = sum(mpm.momentum(law, points, V.increment, V.test, strain=strain, tag=k)
                for k, law in enumerate(laws))  # fmt: skip
        points.add_field("velocity", (d,), "m/s")
        points["velocity"] = 3.0 * np.sin(points["x"] @ turn[:d, :d])
        problem = mpm.Explicit(F, V.increment, points, scheme=scheme, fused=fused)
        assert problem.unfused == ("" if fused else "fused=False")
        for t in (0.01, 0.03):
            problem.step(t)
            points["stress"][:, 2, 2] -= 10.0
        order = np.argsort(points["id"])
        names = ("x", "F", "stress", "total_strain", "elastic_energy", "plastic_strain", *"abcd")
        found.append({name: points[name][order] for name in names})
    assert found[0]["plastic_strain"].max() > 1e-3
    assert (np.abs(found[0]["d"]).max() > 1e-3) == (strain == "jaumann")
    for name, own in found[0].items():
        other = found[1][name]
        assert np.abs(own - other).max() <= 1e-10 * np.abs(other).max(), name


def test_the_means_of_f_bar_are_those_of_the_built_in_law():
    own, other = (column(make(), mpm.QuasiStatic, fbar=True).points for make in PAIRS["elastic"])
    assert np.abs(own["stress"] - other["stress"]).max() < 1e-9 * np.abs(other["stress"]).max()


def test_energies_of_an_elastic_and_plastic_umat():
    problem = column(umat("mises.f", [1e6, 0.3, 4e4, 2e5], ["plastic_strain"]), mpm.QuasiStatic)
    points = problem.points
    stress, nu, E = points["stress"], 0.3, 1e6
    trace = np.trace(stress, axis1=1, axis2=2)
    stored = ((1 + nu) * (stress**2).sum(axis=(1, 2)) - nu * trace**2) / (2 * E)
    np.testing.assert_allclose(points["elastic_energy"], stored, rtol=1e-12)
    own = points["plastic_strain"]
    np.testing.assert_allclose(points["plastic_dissipation"], own * (4e4 + 2e5 * own / 2), 0.1)


def test_two_umats_in_one_body_and_a_restart(tmp_path):
    grid = mpm.create_lattice(COMM, [range(5), range(6)])
    first = umat("elastic.f", [2e6, 0.2])
    second = umat("mises.f", [1e6, 0.3, 1e4, 1e5], {"plastic_strain": lambda x: 1e-3 * x[1]})

    def made():
        points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 2000.0, tag=1)
        points = points + mpm.fill(grid, mpm.Box((0, 2), (4, 4)), 2, 1800.0, tag=2)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        F = mpm.momentum(first, points, u, v, strain="jaumann", tag=1)
        F += mpm.momentum(second, points, u, v, strain="jaumann", tag=2)
        F -= ufl.inner(ufl.as_vector((0.0, -4.0)) * points.density, v) * points.dX
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        return mpm.QuasiStatic(F, u, points, bcs)

    problem = made()
    problem.step()
    upper = problem.points["tag"] == 2
    height = problem.points["x0"][upper, 1]
    assert (problem.points["plastic_strain"][upper] >= 1e-3 * height - 1e-15).all()
    assert (problem.points["plastic_strain"][~upper] == 0).all()
    problem.save(tmp_path / "state.npz")
    problem.step()
    again = made()
    again.load(tmp_path / "state.npz")
    again.step()
    for name in ("x", "stress", "plastic_strain", "total_strain", "elastic_energy"):
        assert np.array_equal(problem.points[name], again.points[name]), name


def test_a_step_is_halved_where_pnewdt_asks_for_it(tmp_path):
    body = ELASTIC + "  if (maxval(abs(dstran)) > 3d-3) pnewdt = 0.5d0"
    whole = column(written(tmp_path), mpm.QuasiStatic)
    problem = column(written(tmp_path, body), mpm.QuasiStatic)
    assert sum(r.halvings for r in whole.history) == 0
    assert sum(r.halvings for r in problem.history) > 0

    with pytest.raises(mpm.errors.ConvergenceError, match="PNEWDT < 1"):
        column(written(tmp_path, ELASTIC + "  if (noel == 7 .and. stress(2) < -1d3) pnewdt = 0"),
               mpm.QuasiStatic)  # fmt: skip


def test_an_explicit_step_that_the_umat_refuses_is_told_and_taken_back(tmp_path):
    law = written(tmp_path, ELASTIC + "  if (time(2) > 0.02) pnewdt = 0.5d0")
    V = mpm.Space(mpm.create_lattice(COMM, [range(-2, 6)] * 2), "gimp")
    points = mpm.fill(V.grid, mpm.Box((0, 0), (3, 3)), 2, 1000.0)
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    problem = mpm.Explicit(F, V.increment, points)
    points["velocity"] = np.sin(points["x"])[:, ::-1]
    problem.step(0.015)
    before = points["total_strain"].copy()
    with pytest.raises(mpm.errors.InstabilityError, match="the UMAT asks for a shorter step"):
        problem.step(0.2)
    assert not problem.unfused
    assert problem.time == 0.015
    assert np.abs(before).max() > 1e-3
    assert np.array_equal(points["total_strain"], before)


@pytest.mark.parametrize(
    ("trouble", "told"),
    [
        ("stress(1) = sqrt(-dtime)", "not finite"),
        ("call xit", "XIT"),
        ("stop 'no such sand'", "STOP"),
        ("error stop 4", "STOP"),
        ("allocate(nowhere(-1_8 + 2_8**60))", "error at run time"),
    ],
)
def test_a_call_that_fails_in_a_step_is_told(tmp_path, trouble, told):
    body = f"{ELASTIC}  if (stress(2) < -1d3) then\n{trouble}\nend if"
    law = written(tmp_path, body, "  real(8), pointer :: nowhere(:)")
    with pytest.raises(mpm.errors.ConvergenceError, match=told):
        column(law, mpm.QuasiStatic)


@pytest.mark.parametrize(
    ("body", "state", "told"),
    [
        (ELASTIC + "statev(3) = 1d0", 2, r"1 numbers behind the 2 numbers of STATEV: give state=3"),
        (ELASTIC + "stress(1) = stress(1) + props(4)", 0, "reads numbers beyond an array: STRESS"),
        (ELASTIC + "statev(1) = statev(2)", 1, "reads numbers beyond an array: STATEV"),
        ("call xit", 0, "stops the analysis by a call of XIT"),
        ("print *, 'no such sand'\n call xit", 0, "no such sand"),
        ("nowhere => null()\n nowhere(ntens) = 1", 0, "crashes with SIGSEGV"),
        ("stop 3", 0, "exit code 3"),
        ("error stop 'no clay'", 0, r"exit code 1(?s:.*)no clay"),
    ],
)
def test_a_faulty_umat_is_told_before_the_first_step(tmp_path, body, state, told):
    law = written(tmp_path, body, "  real(8), pointer :: nowhere(:)", state=state)
    points = bodies(2)[0]
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    with pytest.raises(mpm.errors.UserLawError, match=told):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    with pytest.raises(mpm.errors.UserLawError, match=told):
        law.check()


def test_a_source_that_does_not_compile_or_link_is_told(tmp_path):
    with pytest.raises(mpm.errors.UserLawError, match=r"law\.f90:\d+(?s:.*)Error:"):
        written(tmp_path, "  stress = nonsense(")
    with pytest.raises(mpm.errors.UserLawError, match="calls lubksb_, which it does not contain"):
        written(tmp_path, "  call lubksb(stress)")
    other = tmp_path / "other.f90"
    other.write_text("subroutine vumat\nend subroutine\n")
    with pytest.raises(mpm.errors.UserLawError, match="no SUBROUTINE UMAT"):
        mpm.materials.UMAT(other)
    with pytest.raises(mpm.errors.ParameterError, match="is not there"):
        mpm.materials.UMAT(tmp_path / "missing.f")
    with pytest.raises(mpm.errors.ParameterError, match=r"must end in \.f"):
        mpm.materials.UMAT(tmp_path / "law.c")


def test_without_a_compiler_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(mpm.errors.MissingPackageError, match="apt-get install gfortran"):
        written(tmp_path)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"state": -1}, "state"),
        ({"state": ["a", "a"]}, "different words"),
        ({"state": ["void ratio"]}, "different words"),
        ({"state": {"e": np.nan}}, "finite"),
        ({"properties": [1e6, np.inf]}, "properties"),
        ({"name": "x" * 81}, "80 ASCII"),
        ({"flags": "-O3"}, "list of words"),
    ],
)
def test_bad_arguments(tmp_path, options, told):
    with pytest.raises(mpm.errors.ParameterError, match=told):
        written(tmp_path, **options)


def test_large_strain_and_reduced_strength_are_refused():
    law = umat("elastic.f", [1e6, 0.3])
    points = bodies(2)[0]
    V = mpm.Space(points.grid, "gimp")
    with pytest.raises(mpm.errors.ParameterError, match='strain="jaumann"'):
        mpm.momentum(law, points, V.increment, V.test)
    with pytest.raises(mpm.errors.ParameterError, match="does not tell its strength"):
        strain_formulation(law, points, "small").weaken(1.5)


def test_another_law_cannot_go_on_with_the_points_unless_a_stress_is_set():
    problem = column(umat("elastic.f", [1e6, 0.3]), mpm.QuasiStatic)
    points = problem.points
    V = mpm.Space(points.grid, "gimp")
    law = mpm.materials.Hencky(1e6, 0.3)
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    with pytest.raises(mpm.errors.StateError, match="under a UMAT"):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    mpm.set_stress(law, points, points["stress"], strain="jaumann")
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))


def test_the_check_finds_state_between_points_and_wrong_tangents(tmp_path):
    kept = written(tmp_path, ELASTIC + "count = count + 1\nstress(1) = stress(1) + count",
                   "  real(8), save :: count = 0")  # fmt: skip
    assert "keeps state between points" in kept.check()[0]
    last = written(tmp_path, ELASTIC + "stress = stress + 1d-3*last\nlast = stress(1)",
                   "  real(8), save :: last = 0")  # fmt: skip
    assert "keeps state between points" in last.check()[0]
    once = written(tmp_path, "if (first) factor = 2\nfirst = .false.\n" + ELASTIC,
                   "  logical, save :: first = .true.\n  real(8), save :: factor")  # fmt: skip
    assert once.check() == []
    wrong = written(tmp_path, ELASTIC + "ddsdde(2, 1) = ddsdde(1, 1)/10")
    (fault,) = wrong.check()
    assert "DDSDDE(2,1) = 100000 Pa" in fault
    (fault,) = written(tmp_path, "ddsdde = 0").check()
    assert "gives the same stress for every DSTRAN" in fault
    with pytest.raises(mpm.errors.ParameterError, match="4 or 6"):
        wrong.check(components=5)


def test_arguments_that_a_umat_overwrites_are_its_own(tmp_path):
    """Properties, sizes, increments, times and the rotation: the results are those without."""
    writes = """
    props(1) = 2*props(1)
    ntens = 3
    nprops = 0
    ndi = 1
    dstran = 7
    stran = 7
    drot = 7
    dfgrd0 = 7
    dfgrd1 = 7
    coords = 7
    time = 7
    dtime = 7
    """
    found = []
    for k, body in enumerate((ELASTIC, ELASTIC + writes)):
        (tmp_path / str(k)).mkdir()
        law = written(tmp_path / str(k), body)
        assert law.check() == []
        found.append(column(law, mpm.QuasiStatic).points)
    assert np.array_equal(found[1]["stress"], found[0]["stress"])
    assert np.array_equal(found[1]["total_strain"], found[0]["total_strain"])


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
