#!/usr/bin/env python3
"""Fits the polynomial that the kernels use for GELU and prints it as Rust.

GELU(x) = relu(x) - p(|x|) with p(a) = a * Phi(-a), and p is smooth on [0, inf) and vanishes
towards infinity. So one polynomial in t = a * SCALE - 1, t in [-1, 1], is enough; past LIMIT
the argument is clamped, which costs at most p(LIMIT).

Chebyshev interpolation with exact integer arithmetic is not needed: the coefficients are printed
as f32, and their rounding (about 6e-8 each) is the larger part of the error. The errors printed
are for an f64 evaluation of the rounded coefficients; the f32 evaluation is measured by the
predictor's tests.

Usage: python3 tools/fit_gelu.py [limit [degree]]      (standard library only)
"""
import math
import struct
import sys


def target(a):
    return 0.5 * a * math.erfc(a / math.sqrt(2.0))


def f32(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


def literal(x):
    """The shortest decimal that is this f32."""
    return next(text for digits in range(10) if f32(float(text := f"{x:.{digits}e}")) == x)


def chebyshev(function, degree):
    """Coefficients of the interpolant of function on [-1, 1] in Chebyshev polynomials."""
    n = degree + 1
    nodes = [math.cos(math.pi * (k + 0.5) / n) for k in range(n)]
    values = [function(t) for t in nodes]
    return [
        (2.0 if j else 1.0) / n
        * math.fsum(values[k] * math.cos(math.pi * j * (k + 0.5) / n) for k in range(n))
        for j in range(n)
    ]


def monomials(series):
    """The same polynomial in powers of t, lowest first."""
    out = [0.0] * len(series)
    before, current = [1.0], [0.0, 1.0]
    for j, c in enumerate(series):
        if j >= 2:
            following = [0.0] + [2.0 * x for x in current]
            for i, x in enumerate(before):
                following[i] -= x
            before, current = current, following
        for i, x in enumerate([1.0] if j == 0 else current):
            out[i] += c * x
    return out


def main():
    limit = f32(float(sys.argv[1])) if len(sys.argv) > 1 else 5.5
    degree = int(sys.argv[2]) if len(sys.argv) > 2 else 17
    scale = f32(2.0 / limit)
    raw = monomials(chebyshev(lambda t: target((t + 1.0) / scale), degree))
    coefficients = [f32(c) for c in raw]

    worst = 0.0
    for k in range(200_001):
        a = limit * k / 200_000
        t = a * scale - 1.0
        value = 0.0
        for c in reversed(coefficients):
            value = value * t + c
        worst = max(worst, abs(value - target(a)))
    print(f"// limit {limit}, degree {degree}: error {worst:.2e} inside, "
          f"{target(limit):.2e} past the limit, sum |c| {sum(map(abs, coefficients)):.2f}")
    print(f"const GELU_LIMIT: f32 = {literal(limit)};")
    print(f"const GELU_SCALE: f32 = {literal(scale)};")
    print(f"const GELU_COEFFICIENTS: [f32; {degree + 1}] = [")
    for c in coefficients:
        print(f"    {literal(c)},")
    print("];")


if __name__ == "__main__":
    main()
