"""The operations of a tape, each at one order: the recurrences of ``docs/notes/tape.md``.

The coefficients of what moves are the rows of ``c``, lowest order first; what does not move is a
number in ``s``. An operation names them by one number: a row, or ``-1 - i`` for ``s[i]``. A
coefficient that does not exist is NaN, and stays so wherever it is used.
"""

from __future__ import annotations

import math

from .arrays import Floats, Ints, Matrix

#: A product and a sum are never one operation: a program's own machine code gives the same bits.
EXACT = True

# Operations, as the first number of each row of ``ops``; then come the row that is written, and
# the arguments. They are in groups, each with its own function below.
COPY, ADD, SUB, NEG, MUL, SQUARE, SCALE, DIV = 0, 1, 2, 3, 4, 5, 6, 7
SUM_OF, DOT, SOLVE = 8, 9, 10
GT, GE, LT, LE, EQ, NE = 11, 12, 13, 14, 15, 16
AND, OR, XOR, NOT, FINITE = 17, 18, 19, 20, 21
SELECT, NEAREST, FLOOR = 22, 23, 24
POW, SQRT, CBRT = 25, 26, 27
SINE, SINH = 28, 29
EXP, EXP2, EXPM1, LOG, LOG1P, TAN, TANH, LOGISTIC = 30, 31, 32, 33, 34, 35, 36, 37
ASIN, ACOS, ATAN, ASINH, ACOSH, ATANH, ERF, ERFC = 38, 39, 40, 41, 42, 43, 44, 45
ATAN2, LGAMMA, PICK, INTEGRAL = 46, 47, 48, 49

#: Beyond this the exponential is more than a double can be.
LARGEST = 709.782712893384

#: From here on every double is a whole number.
WHOLE = 4503599627370496.0


def operate(
    op: int,
    out: int,
    a: int,
    b: int,
    d: int,
    e: int,
    more: Ints,
    s: Floats,
    sides: Ints,
    c: Matrix,
    work: Floats,
    k: int,
) -> None:
    """One operation at order ``k``; before ``more`` the numbers of its row, in their order."""
    if op <= DIV:
        _arithmetic(op, out, a, b, s, c, k)
    elif op <= DOT:
        _total(op, out, a, b, more, s, c, k)
    elif op == SOLVE:
        _solve(out, a, b, d, more, s, c, work, k)
    elif op <= FINITE:
        _flag(op, out, a, b, d, s, sides, c, k)
    elif op <= FLOOR:
        _piece(op, out, a, b, d, s, sides, c, k)
    elif op <= CBRT:
        c[out, k] = _power(op, out, a, b, s, c, k)
    elif op <= SINH:
        _pair(op, out, a, b, d == 1, c, k)
    elif op <= ERFC:
        _chain(op, out, a, b, c, k)
    elif op == ATAN2:
        _angle(out, a, b, d, e, more, s, sides, c, k)
    elif op == LGAMMA:
        c[out, k] = _lgamma(c[a, 0]) if k == 0 else math.nan
    elif op == PICK:
        c[out, k] = _picked(a, b, d, more, s, c, k)
    else:
        integrate(out, a, s, c, k)


def integrate(out: int, a: int, s: Floats, c: Matrix, k: int) -> None:
    """The next coefficient of a state, from that of its flow: ``x_{k+1} = f_k / (k + 1)``."""
    c[out, k + 1] = at(c, s, a, k) * (1.0 / (k + 1))


def at(c: Matrix, s: Floats, r: int, k: int) -> float:
    """A coefficient of an argument."""
    if r >= 0:
        return c[r, k]
    return s[-1 - r] if k == 0 else 0.0


def _ratio(a: float, b: float) -> float:
    return a / b if b != 0.0 else math.nan


# -- arithmetic ------------------------------------------------------------------------------


def _arithmetic(op: int, out: int, a: int, b: int, s: Floats, c: Matrix, k: int) -> None:
    if op == ADD:
        c[out, k] = at(c, s, a, k) + at(c, s, b, k)
    elif op == SUB:
        c[out, k] = at(c, s, a, k) - at(c, s, b, k)
    elif op == MUL:
        c[out, k] = _product(c, a, b, k)
    elif op == SCALE:
        c[out, k] = at(c, s, b, 0) * c[a, k]
    elif op == SQUARE:
        c[out, k] = _square(c, a, k)
    elif op == DIV:
        c[out, k] = _quotient(c, s, out, a, b, k)
    elif op == NEG:
        c[out, k] = -at(c, s, a, k)
    else:
        c[out, k] = at(c, s, a, k)


def _product(c: Matrix, a: int, b: int, k: int) -> float:
    """The sum of ``a_i b_{k-i}``, from the middle out: the coefficients that are known last come
    last, and the sum of the others need not wait for them. In two parts, of which neither waits for
    the other."""
    total, beside = 0.0, 0.0
    if k % 2 == 0:
        total = c[a, k // 2] * c[b, k // 2]
    for i in range((k + 1) // 2 - 1, -1, -1):
        total += c[a, i] * c[b, k - i]
        beside += c[a, k - i] * c[b, i]
    return total + beside


def _rest(c: Matrix, a: int, b: int, k: int) -> float:
    """The sum of ``a_i b_{k-i}`` from ``i = 1``, last what ``b`` has last."""
    total, beside = 0.0, 0.0
    if k % 2 == 1:
        total = c[a, k] * c[b, 0]
    for i in range(k - k % 2, 0, -2):
        beside += c[a, i] * c[b, k - i]
        total += c[a, i - 1] * c[b, k - i + 1]
    return total + beside


def _square(c: Matrix, a: int, k: int) -> float:
    """As the product of a row with itself, each pair once."""
    half = (k + 1) // 2
    total, beside = 0.0, 0.0
    if k % 2 == 0:
        total = 0.5 * c[a, k // 2] * c[a, k // 2]
    if half % 2 == 1:
        beside = c[a, half - 1] * c[a, k - half + 1]
    for i in range(half - half % 2 - 1, 0, -2):
        beside += c[a, i] * c[a, k - i]
        total += c[a, i - 1] * c[a, k - i + 1]
    return 2.0 * (total + beside)


def _quotient(c: Matrix, s: Floats, y: int, a: int, b: int, k: int) -> float:
    """``y = a / b`` by ``b y = a``."""
    if b < 0:
        return _ratio(at(c, s, a, k), s[-1 - b])
    return _ratio(at(c, s, a, k) - _rest(c, b, y, k), c[b, 0])


def _total(
    op: int, out: int, first: int, count: int, more: Ints, s: Floats, c: Matrix, k: int
) -> None:
    """A sum of many, or of products of many pairs."""
    total = 0.0
    if op == SUM_OF:
        for i in range(first, first + count):
            total += at(c, s, more[i], k)
    else:
        for i in range(first, first + 2 * count, 2):
            total += _times(c, s, more[i], more[i + 1], k)
    c[out, k] = total


def _times(c: Matrix, s: Floats, a: int, b: int, k: int) -> float:
    """A product; if one is steady, ``a`` is."""
    return _product(c, a, b, k) if a >= 0 else s[-1 - a] * at(c, s, b, k)


# -- equations --------------------------------------------------------------------------------


def _solve(
    out: int,
    first: int,
    n: int,
    room: int,
    more: Ints,
    s: Floats,
    c: Matrix,
    work: Floats,
    k: int,
) -> None:
    """``A y = b`` among those that count; the others are 0.

    ``more`` has the matrix, the right side, and what counts: it is 0 where an unknown is none. The
    matrix is factorised at order 0 and used at every order: ``A_0 y_k = b_k - sum A_i y_{k-i}``.
    In ``work`` stand the factors, a right side, and which equation has come to each place.
    """
    mask = first + n * n + n
    if k == 0:
        for i in range(n):
            for m in range(n):
                work[room + i * n + m] = at(c, s, more[first + i * n + m], 0)
        _factorise(work, room, n, more, mask, c, s)
    for i in range(n):
        c[out + i, k] = 0.0
    for i in range(n):
        if at(c, s, more[mask + i], 0) != 0.0:
            equation = int(work[room + n * n + n + i])
            total = at(c, s, more[first + n * n + equation], k)
            for m in range(n):
                a = more[first + equation * n + m]
                if a >= 0 and k > 0:
                    total -= _rest(c, a, out + m, k)
            work[room + n * n + i] = total
    _substitute(work, room, n, more, mask, c, s, out, k)


def _factorise(
    work: Floats, room: int, n: int, more: Ints, mask: int, c: Matrix, s: Floats
) -> None:
    """Lower and upper triangle in place; the row with a column's largest number comes first."""
    order = room + n * n + n
    for p in range(n):
        work[order + p] = p
    for p in range(n):
        if at(c, s, more[mask + p], 0) == 0.0:
            continue
        best = p
        for i in range(p + 1, n):
            counts = at(c, s, more[mask + i], 0) != 0.0
            if counts and abs(work[room + i * n + p]) > abs(work[room + best * n + p]):
                best = i
        if best != p:
            _exchange(work, room + p * n, room + best * n, n)
            _exchange(work, order + p, order + best, 1)
        for i in range(p + 1, n):
            if at(c, s, more[mask + i], 0) == 0.0:
                continue
            factor = _ratio(work[room + i * n + p], work[room + p * n + p])
            work[room + i * n + p] = factor
            for m in range(p + 1, n):
                work[room + i * n + m] -= factor * work[room + p * n + m]


def _exchange(work: Floats, first: int, second: int, count: int) -> None:
    for i in range(count):
        value = work[first + i]
        work[first + i] = work[second + i]
        work[second + i] = value


def _substitute(
    work: Floats,
    room: int,
    n: int,
    more: Ints,
    mask: int,
    c: Matrix,
    s: Floats,
    out: int,
    k: int,
) -> None:
    right = room + n * n
    for i in range(n):
        if at(c, s, more[mask + i], 0) != 0.0:
            for p in range(i):
                if at(c, s, more[mask + p], 0) != 0.0:
                    work[right + i] -= work[room + i * n + p] * work[right + p]
    for i in range(n - 1, -1, -1):
        if at(c, s, more[mask + i], 0) != 0.0:
            total = work[right + i]
            for p in range(i + 1, n):
                if at(c, s, more[mask + p], 0) != 0.0:
                    total -= work[room + i * n + p] * c[out + p, k]
            c[out + i, k] = _ratio(total, work[room + i * n + i])


# -- what switches ---------------------------------------------------------------------------


def _flag(
    op: int, out: int, a: int, b: int, kink: int, s: Floats, sides: Ints, c: Matrix, k: int
) -> None:
    """Comparisons and logic: 1 or 0, which does not move."""
    if k > 0:
        c[out, k] = 0.0
        return
    x, y = at(c, s, a, 0), at(c, s, b, 0)
    if op <= NE and kink >= 0 and sides[kink] != 0:
        x, y = float(sides[kink]), 0.0
    if op == GT:
        flag = x > y
    elif op == GE:
        flag = x >= y
    elif op == LT:
        flag = x < y
    elif op == LE:
        flag = x <= y
    elif op == EQ:
        flag = x == y
    elif op == NE:
        flag = x != y
    elif op == AND:
        flag = x != 0.0 and y != 0.0
    elif op == OR:
        flag = x != 0.0 or y != 0.0
    elif op == XOR:
        flag = (x != 0.0) != (y != 0.0)
    elif op == NOT:
        flag = x == 0.0
    else:
        flag = math.isfinite(x)
    c[out, 0] = 1.0 if flag else 0.0


def _piece(
    op: int, out: int, a: int, b: int, other: int, s: Floats, sides: Ints, c: Matrix, k: int
) -> None:
    """A choice by a flag; whole numbers below something that moves."""
    if op == SELECT:
        chosen = b if at(c, s, a, 0) != 0.0 else other
        c[out, k] = at(c, s, chosen, k)
        return
    whole, kink = _floor(c[a, 0] + 0.5), b
    if op == NEAREST:  # the distance from the nearest whole number
        c[out, k] = c[a, 0] - whole if k == 0 else c[a, k]
    elif k > 0:
        c[out, k] = 0.0
    elif kink < 0 or sides[kink] == 0:
        c[out, 0] = _floor(c[a, 0])
    else:
        c[out, 0] = whole if sides[kink] > 0 else whole - 1.0


def _picked(first: int, index: int, count: int, more: Ints, s: Floats, c: Matrix, k: int) -> float:
    """The entry of a table at a place that does not move, or the nearest that there is."""
    place = at(c, s, index, 0)
    if not math.isfinite(place):
        return math.nan
    return at(c, s, more[first + int(min(max(place, 0.0), count - 1.0))], k)


def _floor(a: float) -> float:
    """The whole number below; from ``WHOLE`` on every double is one."""
    return float(math.floor(a)) if abs(a) < WHOLE else a


def _is_whole(a: float) -> bool:
    return a == _floor(a)


# -- powers and functions --------------------------------------------------------------------


def _power(op: int, y: int, a: int, b: int, s: Floats, c: Matrix, k: int) -> float:
    """``y = a^p`` by ``a y' = p a' y``, the power divided out by which ``a`` vanishes."""
    p = 0.5 if op == SQRT else 1.0 / 3.0 if op == CBRT else at(c, s, b, 0)
    if p == 0.0:
        return 1.0 if k == 0 else 0.0
    zeros = 0
    while zeros <= k and c[a, zeros] == 0.0:
        zeros += 1
    if zeros > k:
        return 0.0 if p >= 1.0 or (p > 0.0 and k == 0) else math.nan
    begin = p * zeros
    if p >= 1.0 and begin > k:
        return 0.0
    if zeros > 0 and (not p >= 1.0 or not _is_whole(begin)):
        return math.nan
    i = k - int(begin) if zeros > 0 else k
    if i == 0:
        return _root(op, c[a, zeros], p)
    total = 0.0
    for m in range(i, 0, -1):
        total += (p * m - (i - m)) * c[a, zeros + m] * c[y, k - m]
    return _ratio(total, i * c[a, zeros])


def _root(op: int, a: float, p: float) -> float:
    """``a^p``, where ``a`` is not 0."""
    if op == SQRT:
        return math.sqrt(a) if a >= 0.0 else math.nan
    if op == CBRT:
        return _cube_root(a)
    if a < 0.0 and not _is_whole(p):
        return math.nan
    if p * math.log(abs(a)) > LARGEST:
        return math.inf if a > 0.0 or p == 2.0 * _floor(0.5 * p) else -math.inf
    return math.pow(a, p)


def _cube_root(a: float) -> float:
    """By a power, and a step of Newton's."""
    if not math.isfinite(a):
        return a
    y = math.copysign(math.pow(abs(a), 1.0 / 3.0), a)
    return y - (y - a / y / y) / 3.0


def _pair(op: int, out: int, a: int, other: int, clock: bool, c: Matrix, k: int) -> None:
    """Sine and cosine, or the hyperbolic ones, each from the other.

    ``clock``: the argument is affine in time alone, and has no coefficients but two.
    """
    if k > 0:
        total, turn = 0.0, 0.0
        for i in range(1 if clock else k, 0, -1):
            slope = i * c[a, i]
            total += slope * c[other, k - i]
            turn += slope * c[out, k - i]
        c[out, k] = total * (1.0 / k)
        c[other, k] = (-turn if op == SINE else turn) * (1.0 / k)
    elif op == SINE and not math.isfinite(c[a, 0]):
        c[out, 0] = c[other, 0] = math.nan
    elif op == SINE:
        c[out, 0], c[other, 0] = math.sin(c[a, 0]), math.cos(c[a, 0])
    elif abs(c[a, 0]) < LARGEST:
        c[out, 0] = math.sinh(c[a, 0])
        c[other, 0] = math.cosh(c[a, 0])
    else:
        c[out, 0] = math.copysign(math.inf, c[a, 0])
        c[other, 0] = math.inf


def _along(c: Matrix, a: int, slope: int, k: int) -> float:
    """The coefficient of ``y`` where ``y' = slope a'``."""
    total, beside = 0.0, 0.0
    if k % 2 == 1:
        total = k * c[a, k] * c[slope, 0]
    for i in range(k - k % 2, 0, -2):
        beside += i * c[a, i] * c[slope, k - i]
        total += (i - 1) * c[a, i - 1] * c[slope, k - i + 1]
    return (total + beside) * (1.0 / k)


def _chain(op: int, out: int, a: int, slope: int, c: Matrix, k: int) -> None:
    """A function of one number, whose slope along it is a row."""
    if k > 0:
        c[out, k] = _along(c, a, slope, k)
    elif op <= LOGISTIC:
        c[out, 0] = _growing(op, c[a, 0])
    else:
        c[out, 0] = _inverse(op, c[a, 0])


def _growing(op: int, a: float) -> float:
    """Exponentials, logarithms, and tangents."""
    if op == EXP:
        return _exp(a)
    if op == EXP2:
        return math.pow(2.0, a) if a < 1024.0 else math.inf if a >= 1024.0 else math.nan
    if op == EXPM1:
        return math.expm1(a) if a <= LARGEST else _exp(a)
    if op == LOG:
        return math.log(a) if a > 0.0 else math.nan
    if op == LOG1P:
        return math.log1p(a) if a > -1.0 else math.nan
    if op == TAN:
        return math.tan(a) if math.isfinite(a) else math.nan
    if op == TANH:
        return math.tanh(a)
    return 1.0 / (1.0 + _exp(-a)) if a >= 0.0 else 1.0 - 1.0 / (1.0 + _exp(a))


def _exp(a: float) -> float:
    return math.inf if a > LARGEST else math.exp(a)


def _inverse(op: int, a: float) -> float:
    """Inverse functions, and the integral of the bell."""
    if op == ATAN:
        return math.atan(a)
    if op == ASINH:
        return math.asinh(a)
    if op == ERF:
        return math.erf(a)
    if op == ERFC:
        return math.erfc(a)
    if op == ACOSH:
        return math.acosh(a) if a >= 1.0 else math.nan
    if not -1.0 <= a <= 1.0:
        return math.nan
    if op == ASIN:
        return math.asin(a)
    if op == ACOS:
        return math.acos(a)
    return math.atanh(a) if abs(a) < 1.0 else math.nan


def _lgamma(a: float) -> float:
    """The logarithm of the gamma function, which has no recurrence."""
    return math.lgamma(a) if a > 0.0 else math.nan


def _angle(
    out: int,
    y: int,
    x: int,
    first: int,
    kink: int,
    more: Ints,
    s: Floats,
    sides: Ints,
    c: Matrix,
    k: int,
) -> None:
    """``atan2(y, x)``, by its slopes along ``y`` and ``x``; left of 0 it jumps where y is 0."""
    if k > 0:
        total = 0.0
        for i in range(k, 0, -1):
            total += i * at(c, s, y, i) * at(c, s, more[first], k - i)
            total += i * at(c, s, x, i) * at(c, s, more[first + 1], k - i)
        c[out, k] = total * (1.0 / k)
        return
    at_y = at(c, s, y, 0)
    if kink >= 0 and sides[kink] != 0:
        at_y = math.copysign(at_y, float(sides[kink]))
    c[out, 0] = math.atan2(at_y, at(c, s, x, 0))
