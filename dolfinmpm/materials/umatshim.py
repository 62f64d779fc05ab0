"""The C source between the compiled loops and a UMAT, and the file that UMATs include.

`dolfinmpm_umat` takes one array with all data of a point and makes the call by the interface of
Abaqus (Abaqus User Subroutines Reference Guide, UMAT). It also defines the utility routines that
published UMATs call: XIT, STDB_ABQERR, GETOUTDIR, ROTSIG, SINV, SPRINC and SPRIND. XIT ends the
point and not the program. A UMAT that has routines of these names keeps its own. STOP and ERROR
STOP are calls of gfortran's library, and errors at run time are such calls in part: those that can
be taken over end the point, too.
"""

from __future__ import annotations

import itertools

__all__ = ["INCLUDE", "OFFSETS", "SHIM", "SIZES"]

# Sizes and positions in the array of doubles of a point; the state variables come last.
SIZES = {
    "stress": 6, "dstran": 6, "stran": 6, "ddsdde": 36, "drot": 9, "dfgrd0": 9, "dfgrd1": 9,
    "time": 2, "dtime": 1, "coords": 3, "celent": 1, "energies": 3, "pnewdt": 1,
}  # fmt: skip
_ENDS = itertools.accumulate(SIZES.values(), initial=0)
OFFSETS = dict(zip([*SIZES, "statev"], _ENDS))

INCLUDE = """\
      IMPLICIT REAL*8 (A-H, O-Z)
      PARAMETER (NPRECD=2)
"""

_AT = "\n".join(f"#define {name.upper()} (w + {start})" for name, start in OFFSETS.items())

SHIM = f"""\
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

{_AT}

#define GUARDS 16 /* numbers behind STATEV */

typedef double real;

extern void umat_(
    real *, real *, real *, real *, real *, real *, real *, real *, real *, real *, real *, real *,
    real *, real *, real *, real *, real *, real *, char *, int *, int *, int *, int *, real *,
    int *, real *, real *, real *, real *, real *, real *, int *, int *, int *, int *, int *, int *,
    size_t);

static jmp_buf place;
static int inside = 0;

/* 0, or 1 where the UMAT has called XIT or has stopped, or 2 where it asks for a shorter step, or 4
   where it writes behind STATEV. The guards are -0.0: they add nothing, and 0.0 has other bits. */
int dolfinmpm_umat(real *w, real *props, const int64_t *n, const char *name)
{{
    char cmname[80];
    int ndi = n[0], nshr = n[1], ntens = n[2], nstatv = n[3], nprops = n[4], noel = n[5];
    int one = 1, steps[4] = {{1, 1, 1, 0}};
    real rpl = 0.0, drpldt = 0.0, ddsddt[6] = {{0}}, drplde[6] = {{0}};
    real temp = 0.0, dtemp = 0.0, predef[1] = {{0}}, dpred[1] = {{0}};
    real own[nprops > 0 ? nprops : 1]; /* some UMATs write into PROPS */
    real state[nstatv + GUARDS], guards[GUARDS];
    for (int i = 0; i < GUARDS; ++i)
        guards[i] = -0.0;
    memcpy(state, STATEV, nstatv * sizeof(real));
    memcpy(state + nstatv, guards, sizeof(guards));
    memcpy(own, props, nprops * sizeof(real));
    memcpy(cmname, name, 80);
    inside = 1;
    if (_setjmp(place)) {{
        inside = 0;
        return 1;
    }}
    umat_(STRESS, state, DDSDDE, ENERGIES, ENERGIES + 1, ENERGIES + 2, &rpl, ddsddt, drplde,
          &drpldt, STRAN, DSTRAN, TIME, DTIME, &temp, &dtemp, predef, dpred, cmname, &ndi, &nshr,
          &ntens, &nstatv, own, &nprops, COORDS, DROT, PNEWDT, CELENT, DFGRD0, DFGRD1, &noel,
          &one, &one, &one, steps, &one, (size_t)80);
    inside = 0;
    memcpy(STATEV, state, nstatv * sizeof(real));
    if (memcmp(state + nstatv, guards, sizeof(guards)))
        return 4;
    return *PNEWDT < 1.0 ? 2 : 0;
}}

__attribute__((weak)) void xit_(void)
{{
    if (inside)
        longjmp(place, 1);
    _exit(77); /* in the process that tries a UMAT */
}}

/* What gfortran makes of STOP and of some errors; in the process that tries a UMAT they end it */
static void failed(int code, const char *where, const char *format, va_list values)
{{
    if (inside)
        longjmp(place, 1);
    if (where)
        fprintf(stderr, "%s\\n", where);
    vfprintf(stderr, format, values);
    fprintf(stderr, "\\n");
    fflush(stderr);
    _exit(code);
}}

static void stopped(int code, const char *format, ...)
{{
    va_list values;
    va_start(values, format);
    failed(code, NULL, format, values);
}}

void _gfortran_stop_string(const char *text, size_t length, _Bool quiet)
{{
    stopped(0, "STOP %.*s", (int)length, text ? text : "");
}}

void _gfortran_error_stop_string(const char *text, size_t length, _Bool quiet)
{{
    stopped(1, "ERROR STOP %.*s", (int)length, text ? text : "");
}}

void _gfortran_stop_numeric(int code, _Bool quiet)
{{
    stopped(code, "STOP %d", code);
}}

void _gfortran_error_stop_numeric(int code, _Bool quiet)
{{
    stopped(code ? code : 1, "ERROR STOP %d", code);
}}

void _gfortran_runtime_error_at(const char *where, const char *format, ...)
{{
    va_list values;
    va_start(values, format);
    failed(2, where, format, values);
}}

void _gfortran_os_error_at(const char *where, const char *format, ...)
{{
    va_list values;
    va_start(values, format);
    failed(2, where, format, values);
}}

void _gfortran_runtime_error(const char *format, ...)
{{
    va_list values;
    va_start(values, format);
    failed(2, "error at run time", format, values);
}}

__attribute__((weak)) void stdb_abqerr_(
    int *kind, char *text, int *integers, real *reals, char *words, size_t length)
{{
    if (*kind == -3)
        xit_();
}}

__attribute__((weak)) void getoutdir_(char *folder, int *length, size_t size)
{{
    memset(folder, ' ', size);
    folder[0] = '.';
    *length = 1;
}}

static void unpack(const real *s, int kind, int ndi, int nshr, real t[3][3])
{{
    static const int a[3] = {{0, 0, 1}}, b[3] = {{1, 2, 2}};
    real half = kind == 2 ? 0.5 : 1.0;
    memset(t, 0, 9 * sizeof(real));
    for (int i = 0; i < ndi; ++i)
        t[i][i] = s[i];
    for (int i = 0; i < nshr; ++i)
        t[a[i]][b[i]] = t[b[i]][a[i]] = half * s[ndi + i];
}}

/* R is a matrix of Fortran, column by column */
__attribute__((weak)) void rotsig_(real *s, real *R, real *out, int *kind, int *ndi, int *nshr)
{{
    static const int a[3] = {{0, 0, 1}}, b[3] = {{1, 2, 2}};
    real t[3][3], r[3][3];
    unpack(s, *kind, *ndi, *nshr, t);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {{
            r[i][j] = 0.0;
            for (int k = 0; k < 3; ++k)
                for (int l = 0; l < 3; ++l)
                    r[i][j] += R[i + 3 * k] * t[k][l] * R[j + 3 * l];
        }}
    for (int i = 0; i < *ndi; ++i)
        out[i] = r[i][i];
    for (int i = 0; i < *nshr; ++i)
        out[*ndi + i] = (*kind == 2 ? 2.0 : 1.0) * r[a[i]][b[i]];
}}

__attribute__((weak)) void sinv_(real *s, real *mean, real *mises, int *ndi, int *nshr)
{{
    real t[3][3], total = 0.0;
    unpack(s, 1, *ndi, *nshr, t);
    *mean = (t[0][0] + t[1][1] + t[2][2]) / 3.0;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {{
            real d = t[i][j] - (i == j ? *mean : 0.0);
            total += d * d;
        }}
    *mises = sqrt(1.5 * total);
}}

/* Jacobi's rotations: values, and directions row by row */
static void jacobi(real t[3][3], real *values, real v[3][3])
{{
    memset(v, 0, 9 * sizeof(real));
    v[0][0] = v[1][1] = v[2][2] = 1.0;
    for (int sweep = 0; sweep < 60; ++sweep) {{
        real off = fabs(t[0][1]) + fabs(t[0][2]) + fabs(t[1][2]);
        if (off == 0.0)
            break;
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {{
                if (t[p][q] == 0.0)
                    continue;
                real h = 0.5 * (t[q][q] - t[p][p]) / t[p][q];
                real tan = (h >= 0 ? 1.0 : -1.0) / (fabs(h) + sqrt(h * h + 1.0));
                real c = 1.0 / sqrt(tan * tan + 1.0), s = tan * c;
                for (int k = 0; k < 3; ++k) {{
                    real x = t[k][p], y = t[k][q];
                    t[k][p] = c * x - s * y;
                    t[k][q] = s * x + c * y;
                }}
                for (int k = 0; k < 3; ++k) {{
                    real x = t[p][k], y = t[q][k];
                    t[p][k] = c * x - s * y;
                    t[q][k] = s * x + c * y;
                    x = v[p][k], y = v[q][k];
                    v[p][k] = c * x - s * y;
                    v[q][k] = s * x + c * y;
                }}
                t[p][q] = t[q][p] = 0.0;
            }}
    }}
    for (int i = 0; i < 3; ++i)
        values[i] = t[i][i];
}}

__attribute__((weak)) void sprinc_(real *s, real *values, int *kind, int *ndi, int *nshr)
{{
    real t[3][3], v[3][3];
    unpack(s, *kind, *ndi, *nshr, t);
    jacobi(t, values, v);
}}

/* directions(k, :) is the k-th direction, a matrix of Fortran */
__attribute__((weak)) void sprind_(
    real *s, real *values, real *directions, int *kind, int *ndi, int *nshr)
{{
    real t[3][3], v[3][3];
    unpack(s, *kind, *ndi, *nshr, t);
    jacobi(t, values, v);
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i)
            directions[k + 3 * i] = v[k][i];
}}
"""
