#!/usr/bin/env python3
"""Fits the polynomials that the kernels use for GELU and prints them as Rust.

GELU(x) = relu(x) - p(|x|): both forms of GELU, by the error function and by tanh, differ from relu
by an even function p that is smooth on [0, inf), at most 0.17 and vanishes towards infinity.

[0, LIMIT / SCALE] is cut into 8 segments, since 8 values are what one register permutation looks up
on AVX2. The kernels work with y = SCALE * x, whose unit is a segment: the weights bring the scale
along. Adding MAGIC = 2^23 to |y| rounds it to an integer, which then stands in the lowest bits of
the sum and *is* the segment. So segment i reaches from i - 1/2 to i + 1/2, and the first one is half
as wide. Past LIMIT the argument is clamped, which costs at most p there.

The value computed is 2 * SCALE * GELU = y + |y| - 2 * SCALE * p, two additions besides the
polynomial, and the next layer's weights take the factor back. Each segment has one polynomial in |y|
itself, with no local variable: the cancellation that this brings is part of the errors printed (of
GELU, not of the multiple), which are those of f32 arithmetic with fused multiply-adds, as the
kernels compute it. The tables hold the polynomials with a minus sign.

Usage: python3 tools/fit_gelu.py [largest x [degree]]      (standard library only)
"""
import math
import struct
import sys
from fractions import Fraction

SEGMENTS = 8
MAGIC = 2.0**23
TANH_SCALE = math.sqrt(2.0 / math.pi)


def erf_tail(a):
    return 0.5 * a * math.erfc(a / math.sqrt(2.0))


def tanh_tail(a):
    # 1 - tanh(z) = 2 / (1 + exp(2 z)), which avoids cancellation.
    z = TANH_SCALE * (a + 0.044715 * a**3)
    return a / (1.0 + math.exp(2.0 * z))


def f32(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


def fused(a, b, c):
    """a * b + c in f32 with one rounding (two where f64 has just rounded to a tie: never seen)."""
    return f32(float(Fraction(a) * Fraction(b) + Fraction(c)))


def literal(x):
    """The shortest decimal that is this f32."""
    return next(text for digits in range(10) if f32(float(text := f"{x:.{digits}e}")) == x)


def solve(matrix, right):
    """Gaussian elimination on exact fractions."""
    n = len(right)
    rows = [[Fraction(x) for x in row] + [Fraction(y)] for row, y in zip(matrix, right)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in range(n):
            if k != i:
                factor = rows[k][i] / rows[i][i]
                rows[k] = [x - factor * y for x, y in zip(rows[k], rows[i])]
    return [float(rows[i][n] / rows[i][i]) for i in range(n)]


def minimax(function, low, high, degree):
    """Coefficients, lowest first, with the smallest largest error on [low, high] (Remez)."""
    n = degree + 2
    grid = [low + (high - low) * k / 800 for k in range(801)]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    points = [middle - half * math.cos(math.pi * k / (n - 1)) for k in range(n)]
    for _ in range(12):
        matrix = [[Fraction(a) ** j for j in range(degree + 1)] + [(-1) ** k]
                  for k, a in enumerate(points)]
        solution = solve(matrix, [function(a) for a in points])
        coefficients = solution[:-1]
        errors = [horner(coefficients, a) - function(a) for a in grid]
        # One extremum for each run of equal sign. A grid too coarse to show all ends the iteration.
        extrema, sign = [], 0.0
        for a, error in zip(grid, errors):
            if math.copysign(1.0, error) != sign:
                sign = math.copysign(1.0, error)
                extrema.append((a, error))
            elif abs(error) > abs(extrema[-1][1]):
                extrema[-1] = (a, error)
        while len(extrema) > n:
            extrema.pop(0 if abs(extrema[0][1]) < abs(extrema[-1][1]) else -1)
        if len(extrema) < n:
            break
        points = [a for a, _ in extrema]
    return coefficients


def horner(coefficients, a):
    value = 0.0
    for c in reversed(coefficients):
        value = value * a + c
    return value


def table(function, degree):
    """Coefficients of -function for each segment, as f32, lowest first."""
    segments = []
    for i in range(SEGMENTS):
        low, high = max(0.0, i - 0.5), i + 0.5
        rounded = []
        # From the highest on: the lower ones compensate the rounding error of a coefficient.
        for order in range(degree, -1, -1):
            def rest(y):
                return -function(y) - math.fsum(c * y**j for j, c in rounded)
            rounded.append((order, f32(minimax(rest, low, high, order)[-1])))
        segments.append([c for _, c in reversed(rounded)])
    return segments


def evaluate(segments, limit, y):
    """The polynomial as the kernels compute it, with f32 operations."""
    y = min(y, limit)
    index = int(fused(y, 1.0, MAGIC) - MAGIC)
    value = segments[index][-1]
    for c in reversed(segments[index][:-1]):
        value = fused(value, y, c)
    return value


def main():
    largest = float(sys.argv[1]) if len(sys.argv) > 1 else 5.3
    degree = int(sys.argv[2]) if len(sys.argv) > 2 else 5
    end = SEGMENTS - 0.5
    limit = f32(end * (1.0 - 2.0**-24))  # the end itself would be rounded to the next segment
    scale = f32(end / largest)
    print(f"const LIMIT: f32 = {literal(limit)};")
    print(f"const SCALE: f32 = {literal(scale)};")
    print(f"const MAGIC: f32 = {literal(MAGIC)};")
    for name, tail in (("ERF", erf_tail), ("TANH", tanh_tail)):
        def scaled(y):
            return 2.0 * scale * tail(y / scale)
        segments = table(scaled, degree)
        worst = 0.0
        for k in range(20_001):
            y = f32(limit * k / 20_000)
            worst = max(worst, abs(evaluate(segments, limit, y) + scaled(y)) / (2.0 * scale))
        print(f"\n/// Maximum error {worst:.1e} up to the limit, {tail(limit / scale):.1e} beyond it.")
        print(f"static {name}: [[f32; {SEGMENTS}]; {degree + 1}] = [")
        for j in range(degree + 1):
            print("    [" + ", ".join(literal(segment[j]) for segment in segments) + "],")
        print("];")


if __name__ == "__main__":
    main()
