"""Every scene of `cases` on 1, 2 and 3 ranks: the same figures, and no hang."""

from __future__ import annotations

import functools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cases import CASES
from conftest import start

# where a point yields a little earlier, rounding is carried on from step to step
TOLERANCES = {"plastic": 1e-8, "law_in_ufl": 1e-8}
# derivatives are differences of two runs over 2e-6 of a parameter
TOLERANCES |= {"derivatives": 1e-6, "derivatives_in_contact": 1e-6}
# variants of other cases, which run with --long only, on three ranks
VARIANTS = {
    "adaptive_penalties",
    "bodies_that_collide",
    "bodies_that_rub",
    "boundaries_triangles",
    "boundaries_total",
    "boundary_3d",
    "contact_in_fused_steps",
    "contact_restart_in_fused_steps",
    "deposits",
    "derivatives_in_contact",
    "dynamics_lumped",
    "dynamics_restart",
    "explicit_boundaries",
    "explicit_restart",
    "facets_of_few_ranks",
    "fbar_3d",
    "fbar_bases",
    "fbar_layers",
    "fbar_triangles",
    "law_in_ufl",
    "nested_bases",
    "nested_restart",
    "regridded",
    "regraded_splines",
    "rest_of_splines",
    "stabilisations_gimp",
    "stabilisations_linear",
    "stabilisations_triangles",
    "restart_arch",
    "restart_boundaries",
    "restart_boundaries_total",
    "restart_splines",
    "restart_triangles",
    "rings_bases",
    "rings_in_time",
    "rings_stabilisations",
    "rings_restart",
    "touching_restart",
    "umat_explicit",
    "waves",
}
# of cases that one launch runs: imports are paid for once, and workers still share the launches
GROUP = 28
GROUPS = [list(CASES)[k : k + GROUP] for k in range(0, len(CASES), GROUP)]


@functools.cache
def launched(cases: tuple[str, ...], ranks: int) -> tuple[dict[str, dict], str]:
    """Figures of the cases that one launch brought to their end, and how it ended itself."""
    done = start("tests/mpi/run_case.py", *cases, ranks=ranks)
    lines = [json.loads(x) for x in done.stdout.splitlines() if x.startswith('{"case": ')]
    found = {line["case"]: line["figures"] for line in lines}
    return found, f"exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-4000:]}"


@pytest.fixture(scope="session")
def asked(request):
    """Names of the cases that this run asks for, such as by -k."""
    here = (item for item in request.session.items if item.path == Path(__file__))
    return {item.callspec.params["case"] for item in here}


def figures(case: str, ranks: int, asked) -> dict:
    (group,) = (names for names in GROUPS if case in names)
    alike = [x for x in group if x in asked and (x in VARIANTS) == (case in VARIANTS)]
    found, end = launched(tuple(alike), ranks)
    if case not in found:
        # another one may have ended the launch
        found, end = launched((case,), ranks)
    assert case in found, f"{case} on {ranks} ranks: {end}"
    return found[case]


def leaves(figures, path=()):
    """Every number and every list of numbers, by where it stands."""
    if isinstance(figures, dict):
        return {k: v for key in figures for k, v in leaves(figures[key], (*path, key)).items()}
    return {path: figures}


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.parametrize(
    ("case", "ranks"),
    [
        pytest.param(
            case,
            ranks,
            marks=[pytest.mark.xdist_group(f"ranks-{k}")]
            + [pytest.mark.long] * (ranks > 2 or case in VARIANTS),
        )
        for k, names in enumerate(GROUPS)
        for case in names
        for ranks in ((3,) if case in VARIANTS else (2, 3))
    ],
)
def test_figures_do_not_depend_on_the_ranks(case, ranks, asked):
    one, many = (leaves(figures(case, n, asked)) for n in (1, ranks))
    assert one.keys() == many.keys()
    few = TOLERANCES.get(case, 1e-9)
    texts = {path for path in one if isinstance(one[path], str)}
    assert {path: many[path] for path in texts} == {path: one[path] for path in texts}
    for path in one.keys() - texts - {path for path in one if path[-1] == "moved"}:
        a, b = np.array(one[path], float), np.array(many[path], float)
        # rounding may decide about a last iteration
        within = 1 if path[-1] == "iterations" else few * np.abs(a).max(initial=0.0)
        np.testing.assert_allclose(b, a, rtol=0, atol=within, err_msg=str(path))
    moved = [many[path] for path in many if path[-1] == "moved"]
    if moved and case not in ("driven", "tall"):
        assert all(moved), "no point changed rank: the scene tests nothing"
