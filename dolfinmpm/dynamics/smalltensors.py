"""Tensors of one point in two and three dimensions, for compiled loops.

A tensor is an array of 3 x 3 numbers on the stack, see `dolfinmpm._platform.simd`. In two
dimensions only the first two rows and columns count.
"""

from __future__ import annotations

import math

import numba

from dolfinmpm._platform.simd import matrix, numbers
from dolfinmpm.dynamics.passes import FAST

__all__ = [
    "INLINE",
    "add_symmetric",
    "carried",
    "combine",
    "contracted",
    "deformed",
    "determinant",
    "dot",
    "exponential",
    "inside",
    "keep",
    "keep_symmetric",
    "logarithm",
    "logarithm_near_one",
    "neo_hookean",
    "plus_one",
    "root",
    "scaled",
    "spectrum",
    "stretches",
    "take",
    "take_symmetric",
    "trace",
    "transform",
    "turned",
]

# How functions of the loops are compiled: into the loop that calls them
INLINE = {"cache": True, "forceinline": True, "error_model": "numpy", "fastmath": FAST}


@numba.njit(**INLINE)
def logarithm_near_one(z):
    """ln x of z = (x − 1)/(x + 1), for |z| ≤ 0.1."""
    s = z * z
    tail = 1.0 / 9.0 + s * (1.0 / 11.0 + s * (1.0 / 13.0 + s * (1.0 / 15.0)))
    return 2.0 * z * (1.0 + s * (1.0 / 3.0 + s * (0.2 + s * (1.0 / 7.0 + s * tail))))


@numba.njit(**INLINE)
def logarithm(x):
    """ln x; near 1, where stretches of most steps are, without a call."""
    z = (x - 1.0) / (x + 1.0)
    if abs(z) > 0.1:
        return math.log(x)
    return logarithm_near_one(z)


@numba.njit(**INLINE)
def exponential(x):
    """eˣ; near 0, where changes of strain in a step are, without a call."""
    if abs(x) > 0.03:
        return math.exp(x)
    tail = 1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0 + x * (1.0 / 5040.0)))
    return 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * tail)))


@numba.njit(**INLINE)
def component(d, i, j):
    """Place of a component of a symmetric tensor: xx, yy, xy, or xx, yy, zz, xy, yz, xz."""
    if i == j:
        return i
    if d == 2:
        return 2
    return 3 if i + j == 1 else (4 if i + j == 3 else 5)


@numba.njit(**INLINE)
def inside(d, x, start, end):
    """Whether start ≤ x ≤ end."""
    found = True
    for k in range(d):
        found = found and start[k] <= x[k] <= end[k]
    return found


@numba.njit(**INLINE)
def dot(d, a, b):
    """a · b."""
    total = a[0] * b[0]
    for k in range(1, d):
        total += a[k] * b[k]
    return total


@numba.njit(**INLINE)
def take(d, values, p, out):
    """Write the tensor of point p."""
    for i in range(d):
        for j in range(d):
            out[i, j] = values[p, i, j]


@numba.njit(**INLINE)
def keep(d, values, p, A, factor):
    """Set the tensor of point p to a factor times A."""
    for i in range(d):
        for j in range(d):
            values[p, i, j] = factor * A[i, j]


@numba.njit(**INLINE)
def take_symmetric(d, order, values, p, out):
    """Write the symmetric tensor of point p, of components as in that many dimensions."""
    for i in range(d):
        for j in range(d):
            out[i, j] = values[p, component(order, i, j)]


@numba.njit(**INLINE)
def keep_symmetric(d, order, values, p, A):
    """Set the symmetric tensor of point p, of components as in that many dimensions."""
    for i in range(d):
        for j in range(d):
            if j >= i:
                values[p, component(order, i, j)] = A[i, j]


@numba.njit(**INLINE)
def plus_one(d, factor, A, shift, out):
    """Write a factor times A, plus a shift times 1."""
    for i in range(d):
        for j in range(d):
            out[i, j] = factor * A[i, j] + (shift if i == j else 0.0)


@numba.njit(**INLINE)
def trace(d, A):
    """tr A."""
    total = A[0, 0]
    for i in range(1, d):
        total += A[i, i]
    return total


@numba.njit(**INLINE)
def contracted(d, A, B):
    """A : B."""
    total = 0.0
    for i in range(d):
        for j in range(d):
            total += A[i, j] * B[i, j]
    return total


@numba.njit(**INLINE)
def add_symmetric(d, t, A, y):
    """Add t times the symmetric part of A to y."""
    for i in range(d):
        for j in range(d):
            y[i, j] += 0.5 * t * (A[i, j] + A[j, i])


@numba.njit(**INLINE)
def scaled(A, factor):
    """Multiply A by a factor, with what it has across the plane."""
    for i in range(3):
        for j in range(3):
            A[i, j] *= factor


@numba.njit(**INLINE)
def deformed(d, a, F, p, out):
    """Write a F of point p, and set F to it."""
    for i in range(d):
        for j in range(d):
            out[i, j] = 0.0
            for k in range(d):
                out[i, j] += a[i, k] * F[p, k, j]
    keep(d, F, p, out, 1.0)


@numba.njit(**INLINE)
def neo_hookean(d, F, J, lmbda, mu, out):
    """Write Kirchhoff's stress τ = λ ln J 1 + μ (FFᵀ − 1), with that across the plane."""
    volumetric = lmbda * logarithm(J)
    for i in range(d):
        for j in range(d):
            q = -1.0 if i == j else 0.0
            for k in range(d):
                q += F[i, k] * F[j, k]
            out[i, j] = mu * q + (volumetric if i == j else 0.0)
    if d == 2:
        out[2, 2] = volumetric


@numba.njit(**INLINE)
def root(d, x):
    """The d-th root of x."""
    return math.sqrt(x) if d == 2 else x ** (1.0 / 3.0)


@numba.njit(**INLINE)
def adjugate(A, out):
    """adj A = det A A⁻¹ of a tensor in three dimensions."""
    for i in range(3):
        for j in range(3):
            a, b, c, e = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = A[a, c] * A[b, e] - A[a, e] * A[b, c]


@numba.njit(**INLINE)
def determinant(d, A):
    """det A."""
    if d == 2:
        return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    return (
        A[0, 0] * (A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1])
        + A[0, 1] * (A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2])
        + A[0, 2] * (A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0])
    )


@numba.njit(**INLINE)
def transform(d, A, y):
    """Replace a symmetric tensor y by A y Aᵀ."""
    Ay = matrix(3, 3)
    for i in range(d):
        for j in range(d):
            Ay[i, j] = 0.0
            for k in range(d):
                Ay[i, j] += A[i, k] * y[k, j]
    for i in range(d):
        for j in range(d):
            if j >= i:
                total = 0.0
                for k in range(d):
                    total += Ay[i, k] * A[j, k]
                y[i, j] = y[j, i] = total


@numba.njit(**INLINE)
def carried(d, t, H, out):
    """Write H (1 + t H)⁻¹: the gradient H (1/s) at the places to which velocities carry points.

    By the invariants of H and its adjugate it is (H + t (II − adj H) + t² III) / det(1 + t H).

    Args:
        d: Dimension of space.
        t: Time of the motion (s).
        H: The gradient (1/s).
        out: Written (1/s); it may be H.

    Returns:
        det(1 + t H).
    """
    if d == 2:
        z = t * determinant(2, H)
        scale = 1.0 + t * (H[0, 0] + H[1, 1] + z)
        q = 1.0 / scale
        for i in range(2):
            for j in range(2):
                out[i, j] = q * (H[i, j] + z) if i == j else q * H[i, j]
        return scale
    adj = matrix(3, 3)
    adjugate(H, adj)
    second = adj[0, 0] + adj[1, 1] + adj[2, 2]
    third = H[0, 0] * adj[0, 0] + H[0, 1] * adj[1, 0] + H[0, 2] * adj[2, 0]
    z = t * (second + t * third)
    scale = 1.0 + t * (H[0, 0] + H[1, 1] + H[2, 2] + z)
    q = 1.0 / scale
    for i in range(3):
        for j in range(3):
            h = H[i, j] - t * adj[i, j]
            out[i, j] = q * (h + z) if i == j else q * h
    return scale


@numba.njit(**INLINE)
def turned(d, t, H, y):
    """Replace y by R y Rᵀ, R = (1 − W/2)⁻¹ (1 + W/2), with W = t (H − Hᵀ)/2.

    With w·w = ½ W:W it is R = 1 + (W + ½ W²)/(1 + ¼ w·w) (Hughes & Winget 1980, doi
    10.1002/nme.1620151210).
    """
    W, R = matrix(3, 3), matrix(3, 3)
    size = 0.0
    for i in range(d):
        for j in range(d):
            W[i, j] = 0.5 * t * (H[i, j] - H[j, i])
            size += 0.5 * W[i, j] * W[i, j]
    q = 1.0 / (1.0 + 0.25 * size)
    for i in range(d):
        for j in range(d):
            square = 0.0
            for k in range(d):
                square += W[i, k] * W[k, j]
            R[i, j] = q * (W[i, j] + 0.5 * square) + (1.0 if i == j else 0.0)
    transform(d, R, y)


@numba.njit(**INLINE)
def spectrum(d, y, r, P, D):
    """Principal values of a symmetric tensor, and P and D in the place of its axes.

    y = λ₁ P + ½ (λ₂ + λ₃) (1 − P) + ½ (λ₂ − λ₃) D, with λ₂ ≥ λ₃. P is the projector on the first
    axis; D has the eigenvalues 1, −1 and 0. A function of the tensor is a sum of 1, P and D.

    In two dimensions the first axis is that across the plane: P is 0 in the plane, and λ₁ is not
    written. In three dimensions λ₁ is the eigenvalue farthest from the two others: its projector
    is one that rounding cannot harm. The adjugate of y − λ₁ has rank one, and its size is the
    product of both distances. Where λ₂ meets λ₃ rounding makes D, and its factor is as small as
    their gap. (Scherzinger & Dohrmann 2008, doi 10.1016/j.cma.2008.03.031, split so for
    eigenvectors.)

    Args:
        d: Dimension of space.
        y: The tensor.
        r: Written: λ₁, λ₂, λ₃.
        P, D: Written.
    """
    if d == 2:
        mid, gap = 0.5 * (y[0, 0] + y[1, 1]), 0.5 * (y[0, 0] - y[1, 1])
        size = math.sqrt(gap * gap + y[0, 1] * y[0, 1])
        r[1], r[2] = mid + size, mid - size
        cosine, sine = 1.0, 0.0
        if size > 0.0:
            q = 1.0 / size
            cosine, sine = gap * q, y[0, 1] * q
        D[0, 0], D[1, 1], D[0, 1], D[1, 0] = cosine, -cosine, sine, sine
        P[0, 0] = P[1, 1] = P[0, 1] = P[1, 0] = 0.0
        return
    mean = (y[0, 0] + y[1, 1] + y[2, 2]) / 3.0
    b, adj = matrix(3, 3), matrix(3, 3)
    size = 0.0
    for i in range(3):
        for j in range(3):
            b[i, j] = y[i, j] - mean if i == j else y[i, j]
            size += b[i, j] * b[i, j]
    if not size > 1e-180:
        for i in range(3):
            r[i] = mean
            for j in range(3):
                P[i, j] = D[i, j] = 0.0
        P[0, 0] = 1.0
        return
    # eigenvalues of the deviator over its size are roots of x³ − 3x − 2c, the first in [√3, 2]
    square = size / 6.0
    size = math.sqrt(square)
    adjugate(b, adj)
    q = 1.0 / size
    c = 0.5 * (b[0, 0] * adj[0, 0] + b[0, 1] * adj[0, 1] + b[0, 2] * adj[0, 2]) * (q * q * q)
    s = min(abs(c), 1.0)
    x = 1.73205196 + s * (
        0.333245128
        + s * (-0.0951072518 + s * (0.0439555711 + s * (-0.0181083439 + s * (0.0039638132))))
    )
    # one step of Halley's, which triples the digits
    f, slope = x * (x * x - 3.0) - 2.0 * s, 3.0 * (x * x - 1.0)
    x -= f * slope / (slope * slope - 3.0 * x * f)
    x = math.copysign(size * x, c)
    # the adjugate of b − x 1 over its trace
    q = 1.0 / (3.0 * (x * x - square))
    half = 0.5 * x
    gap = 0.0
    for i in range(3):
        for j in range(3):
            own = x if i == j else 0.0
            P[i, j] = q * (adj[i, j] + x * (b[i, j] + own))
            D[i, j] = b[i, j] + 0.5 * own - 1.5 * x * P[i, j]
            gap += D[i, j] * D[i, j]
    gap = math.sqrt(0.5 * gap)
    q = 1.0 / gap if gap > 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            D[i, j] *= q
    middle = mean - half
    r[0], r[1], r[2] = mean + x, middle + gap, middle - gap


@numba.njit(**INLINE)
def combine(d, r, P, D, out):
    """Write the symmetric tensor of the principal values r; see `spectrum` for P and D."""
    middle, gap = 0.5 * (r[1] + r[2]), 0.5 * (r[1] - r[2])
    for i in range(d):
        for j in range(d):
            value = gap * D[i, j] + (middle if i == j else 0.0)
            if d == 3:
                value += (r[0] - middle) * P[i, j]
            out[i, j] = value


@numba.njit(**INLINE)
def stretches(d, F, out):
    """Write the diagonal of U = √(FᵀF); False where it has none."""
    if d == 2:
        # U = (FᵀF + J 1)/√(tr FᵀF + 2 J)
        J = determinant(2, F)
        size = 2.0 * J
        for i in range(2):
            out[i] = J
            for k in range(2):
                out[i] += F[k, i] * F[k, i]
                size += F[k, i] * F[k, i]
        q = 1.0 / math.sqrt(size)
        out[0], out[1] = q * out[0], q * out[1]
        return True
    C, r = matrix(3, 3), numbers(3)
    P, D = matrix(3, 3), matrix(3, 3)
    for i in range(3):
        for j in range(3):
            C[i, j] = 0.0
            for k in range(3):
                C[i, j] += F[k, i] * F[k, j]
    spectrum(3, C, r, P, D)
    if not r[2] > 0.0:
        return False
    for i in range(3):
        r[i] = math.sqrt(r[i])
    combine(3, r, P, D, C)
    for i in range(3):
        out[i] = C[i, i]
    return True
