"""A problem in words: the lines of `print(problem)`, and the description in a checkpoint."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.errors import DifferentProblemWarning, warn
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.cut.activation import Field
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.solve.weakform import WeakForm

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem
    from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["describe", "size_and_solver", "summary", "warn_of_differences"]


def describe(fields: Sequence[Field], form: WeakForm, bcs: Sequence[Condition]) -> dict[str, str]:
    """Name → description of each part of a problem. Collective.

    The configuration of the Spaces is left out, because a checkpoint may change it.

    Args:
        fields: Its fields.
        form: Its weak form.
        bcs: Its essential conditions.
    """
    found: dict[str, str] = {}
    for k, law in enumerate(form.parts.declarations):
        found[f"law {k + 1}"] = _law(law)
    for k, field in enumerate(fields):
        space, basis = field.space, field.space.basis
        name = f"bspline{basis.degree}" if basis.degree > 1 else ("linear", "gimp")[basis.averaged]
        domains = f"averaged ({space.domains})" if basis.averaged else "not averaged"
        more = f"coarsen = {space.coarsen}, tag = {space.tags}"
        found[f"basis of field {k + 1}"] = f'"{name}", {domains}, {more}'
        if space.refinement is not None:
            found[f"leaves of field {k + 1}"] = space.refinement.told
        found[f"stabilisation of field {k + 1}"] = str(field.stabilisation)
    found["conditions"] = "; ".join(sorted(_condition(one) for one in bcs)) or "none"
    told = [(term.kind, told) for term in form.terms if (told := term.describe()) is not None]
    found |= {f"{kind} {k + 1}": one for k, (kind, one) in enumerate(told)}
    return found


def warn_of_differences(
    comm: MPI.Comm, path: str, before: Mapping[str, str], now: Mapping[str, str]
) -> None:
    """Warn of differences between a checkpoint's problem and the problem that reads it.

    Args:
        comm: The ranks.
        path: The file.
        before, now: Results of `describe` for both. Files of older versions have none.
    """
    if not before:
        return
    names = [*now, *(name for name in before if name not in now)]
    pairs = [(name, before.get(name, "none"), now.get(name, "none")) for name in names]
    other = [f"{name}: {old} there, {new} here" for name, old, new in pairs if old != new]
    if other:
        text = f"{path} goes on in a problem that is not the one that wrote it: {'; '.join(other)}"
        warn(comm, text, DifferentProblemWarning)


def summary(problem: Problem) -> str:
    """Lines on fields, bases, stabilisation, laws, terms, conditions, scheme and solver.

    The call is not collective. Parameters that vary from point to point are shown as "varying".

    Args:
        problem: The problem.
    """
    form, points = problem.form, problem.points
    where = "axisymmetry" if points.axisymmetric else f"{points.gdim} dimensions"
    lines = [f"{type(problem).__name__}: {points.total} points in {where}"]
    for k, field in enumerate(problem.fields):
        space, of = field.space, field.space.increment.ufl_shape
        kind = "displacement" if of == (points.gdim,) else f"field of shape {of}"
        lines.append(
            f"field {k + 1}: {kind}, {_basis(space)}, {space.configuration} configuration; "
            f"stabilisation: {field.stabilisation.kind}"
        )
    for law in form.parts.declarations:
        tags = "" if law.tags is None else f", tags {', '.join(map(str, law.tags))}"
        fbar = ", F-bar" if law.fbar else ""
        lines.append(f"law: {law.law!r}, {law.strain} strain{fbar}{tags}")
    lines.append(f"terms: {', '.join(_terms(problem)) or 'none'}")
    conditions = [f"{c.where}: component {c.component} {_value(c)}" for c in problem.bcs]
    lines.append(f"conditions: {'; '.join(conditions) or 'none'}")
    lines += [f"rigid body: '{body.name}'" for body in problem.bodies.all]
    return "\n".join(lines + problem.scheme_lines())


def _law(declaration: Declaration) -> str:
    values: Mapping[str, Any] = getattr(declaration.law, "values", {})
    told = [
        f"{name}={value!r}" if isinstance(value, float) else f"{name}={_mean(declaration, k)}"
        for k, (name, value) in enumerate(values.items())
    ]
    words = (str, bool, int, float)
    for k, v in vars(declaration.law).items():
        # private integers are addresses of compiled functions, which each process has anew
        if isinstance(v, words) and not (k.startswith("_") and isinstance(v, int)):
            told.append(f"{k}={v!r}")
    tags = "" if declaration.tags is None else f" of tags {declaration.tags}"
    fbar = ", F-bar" if declaration.fbar else ""
    return f"{type(declaration.law).__name__}({', '.join(told)}){tags}{fbar}"


def _mean(declaration: Declaration, k: int) -> str:
    """Description of a varying parameter by its mean over the points. Collective."""
    values = declaration.parameters()[:, k]
    sums = np.array([values.sum(), float(values.size)])
    total, count = declaration.points.comm.allreduce(sums, op=MPI.SUM)
    return f"varying about {total / max(count, 1.0):.6g}"


def _condition(condition: Condition) -> str:
    if condition.velocity is not None:
        value = "velocity"
    elif isinstance(condition.value, fem.Constant):
        value = "a constant"
    else:
        value = f"{condition.value:g}" if np.ndim(condition.value) == 0 else "values by node"
    return f"component {condition.component} at '{condition.where}': {value}"


def _basis(space: Any) -> str:
    degree, averaged = space.basis.degree, space.basis.averaged
    name = f"B-splines of degree {degree}" if degree > 1 else ("linear", "GIMP")[averaged]
    return name if space.coarsen == 1 else f"{name} on cells of {space.coarsen} times the size"


def _terms(problem: Problem) -> Iterable[str]:
    """Kinds of terms in the form."""
    form = problem.form
    if form.regions:
        yield "sums over points"
    yield from (told for term in form.terms if (told := term.summary()))


def _value(condition: Any) -> str:
    if condition.velocity is not None:
        return "moves by a velocity"
    if isinstance(condition.value, fem.Constant):
        return "increment by a constant"
    if np.ndim(condition.value):
        return "increments by node"
    return "held" if condition.value == 0 else f"increment {condition.value:g} m"


def size_and_solver(problem: QuasiStatic) -> str:
    """Lines on points, unknowns and the linear solver at present. Collective."""
    points, here, comm = problem.points, problem.here, problem.comm
    counts = comm.allgather((len(points), 0 if here is None else here.unknowns.owned))
    lines = [_spread("points", [count[0] for count in counts])]
    if here is not None:
        lines.append(_spread("unknowns", [count[1] for count in counts], here.unknowns.total))
        lines.append(f"active cells: {here.active_cells}, ghost facets: {here.ghost_facets}")
    method = problem.newton.linear.used
    lines.append(f"linear solver: {method or 'chosen in the first step'}")
    return "\n".join(lines)


def _spread(what: str, counts: list[int], total: int | None = None) -> str:
    """Sum of a number over all ranks, and its range over the ranks."""
    text = f"{what}: {sum(counts) if total is None else total}"
    if len(counts) == 1:
        return text
    mean = sum(counts) / len(counts)
    most = f", {max(counts) / mean:.2f} times the mean" if mean else ""
    return f"{text}, {min(counts)} to {max(counts)} per rank{most}"
