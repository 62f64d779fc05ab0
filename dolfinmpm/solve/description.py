"""What a problem is, in words: what a checkpoint tells where it goes on in another problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.errors import DifferentProblemWarning, warn
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.cut.activation import Field
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["describe", "warn_of_differences"]


def describe(fields: Sequence[Field], form: WeakForm, bcs: Sequence[Condition]) -> dict[str, str]:
    """What a problem is made of, by name. Collective.

    The configuration of its Spaces is left out, which may be another one.

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
        found[f"stabilisation of field {k + 1}"] = str(field.stabilisation)
    found["conditions"] = "; ".join(sorted(_condition(one) for one in bcs)) or "none"
    told = [(term.kind, told) for term in form.terms if (told := term.describe()) is not None]
    found |= {f"{kind} {k + 1}": one for k, (kind, one) in enumerate(told)}
    return found


def warn_of_differences(
    comm: MPI.Comm, path: str, before: Mapping[str, str], now: Mapping[str, str]
) -> None:
    """Warn of what a checkpoint's problem and the one that reads it differ in.

    Args:
        comm: The ranks.
        path: The file.
        before, now: What `describe` tells of both; nothing is known of files of older versions.
    """
    if not before:
        return
    names = [*now, *(name for name in before if name not in now)]
    pairs = [(name, before.get(name, "none"), now.get(name, "none")) for name in names]
    other = [f"{name}: {old} there, {new} here" for name, old, new in pairs if old != new]
    if other:
        text = f"{path} goes on in a problem that is not the one that wrote it: {'; '.join(other)}"
        warn(comm, text, DifferentProblemWarning)


def _law(declaration: Declaration) -> str:
    values: Mapping[str, Any] = getattr(declaration.law, "values", {})
    told = [
        f"{name}={value!r}" if isinstance(value, float) else f"{name}={_mean(declaration, k)}"
        for k, (name, value) in enumerate(values.items())
    ]
    words = (str, bool, int, float)
    told += [f"{k}={v!r}" for k, v in vars(declaration.law).items() if isinstance(v, words)]
    tags = "" if declaration.tags is None else f" of tags {declaration.tags}"
    fbar = ", F-bar" if declaration.fbar else ""
    return f"{type(declaration.law).__name__}({', '.join(told)}){tags}{fbar}"


def _mean(declaration: Declaration, k: int) -> str:
    """What tells a parameter that varies from another one: its mean over points. Collective."""
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
