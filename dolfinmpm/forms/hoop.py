"""Check for the hoop term at axisymmetric points, which UFL's gradients of vectors lack."""

from __future__ import annotations

import ufl
from ufl.classes import Div, Dot, FixedIndex, Grad, Indexed, NablaDiv, NablaGrad
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.termqueries import brief

__all__ = ["check_hoop", "check_hoops"]


def check_hoops(form: ufl.Form, points: MaterialPoints) -> None:
    """Refuse a form whose terms over points lack a hoop term; see `check_hoop`.

    Args:
        form: Weak form, as the user wrote it. After UFL's lowering, the use of a gradient is no
            longer visible.
        points: Material points.

    Raises:
        FormError: A term lacks the hoop term; the message says what to write.
    """
    for integral in form.integrals():
        if integral.integral_type() == "custom":
            check_hoop(points, integral.integrand())


def check_hoop(points: MaterialPoints, expression: Expr) -> None:
    """Refuse gradients of vectors that lack the hoop term of axisymmetric points.

    Single components such as `ufl.grad(u)[0, 1]`, and directional derivatives such as
    `ufl.dot(ufl.grad(u), a)`, have no hoop term and pass.

    Args:
        points: Material points that evaluate the expression, axisymmetric or not.
        expression: The expression before UFL's derivatives are expanded.

    Raises:
        FormError: A gradient lacks the hoop term; the message says what to write.
    """
    if not points.axisymmetric:
        return
    for node in (None, *unique_pre_traversal(expression)):
        for operand in (expression,) if node is None else node.ufl_operands:
            if _of_vector(operand) and not _is_part(node, operand):
                raise FormError(
                    f"'{brief(operand)}' lacks the hoop term u_r/r at axisymmetric points "
                    "(axisymmetric=True): write mpm.gradient(points, u), of shape (3, 3), in the "
                    "place of ufl.grad(u) and ufl.nabla_grad(u).T, and its trace in the place of "
                    "ufl.div(u)"
                )


def _of_vector(node: Expr) -> bool:
    """Whether a node is a first gradient or the divergence of a vector or a tensor."""
    if not isinstance(node, (Grad, Div, NablaGrad, NablaDiv)):
        return False
    (inner,) = node.ufl_operands
    # u[i].dx(i) is the gradient of a component with a free index
    return len(inner.ufl_shape) + len(inner.ufl_free_indices) > 0


def _is_part(node: Expr | None, slope: Expr) -> bool:
    """Whether a node takes only parts of a gradient that do not contain the hoop term."""
    if isinstance(slope, (Div, NablaDiv)):
        return False
    if isinstance(node, Indexed):
        return all(isinstance(i, FixedIndex) for i in node.ufl_operands[1])
    return isinstance(node, Dot) and min(len(o.ufl_shape) for o in node.ufl_operands) == 1
