"""A Gaussian given that it lies in a region: how probable that is, and the mean and variance it then has.

Every function has a probability first. With no variance (sampled objects) it is 0 or 1. A Gaussian of a pair is a row
of seven: relative position (0, 1) and velocity (2, 3), second minus first, and the covariance of either axis (position,
cross, velocity; 4 to 6). Where a region is about velocities of the two themselves, ``own`` has those: velocity of the
first (0, 1) and the second (2, 3), and covariances of their own filters: cross and velocity of the first (4, 5) and of
the second (6, 7).
"""

import math

import numpy as np

from wakefold.base.compile import inner

FAR = 25.0  # squared standard deviations from a border, beyond which nothing or everything is inside
LARGE = 100.0  # argument of the Bessel functions from which on the border of a ball is integrated over instead
LEAST = 1e-3  # share of a variance that is always left
ROOT_HALF, PEAK = math.sqrt(0.5), 1.0 / math.sqrt(2.0 * math.pi)
# Gauss-Hermite nodes of a normal law and their weights
THREE, WEIGHT3 = np.array([-math.sqrt(3.0), 0.0, math.sqrt(3.0)]), np.array([1.0, 4.0, 1.0]) / 6.0
BESIDE, SHARE = np.array([0.0, 3.0]), np.array([2.0, 1.0]) / 3.0  # of the same three their squares
_NODES9, _WEIGHTS9 = np.polynomial.hermite_e.hermegauss(9)
NINE, WEIGHT9 = _NODES9, _WEIGHTS9 / _WEIGHTS9.sum()
# Of a normal law of the plane: a middle and six about it; and three rings of twelve for directions about the origin.
_SIX, _TWELVE = np.arange(6) * math.pi / 3.0, (np.arange(12) + 0.5) * math.pi / 6.0
_HEXAGON = np.column_stack([np.cos(_SIX), np.sin(_SIX)]) * 2.0
CLEAR, WEIGHT_CLEAR = np.concatenate([np.zeros((1, 2)), _HEXAGON]), np.array([0.5] + [1.0 / 12.0] * 6)
_RADII, _SHARES = np.polynomial.laguerre.laggauss(3)
_RING = np.column_stack([np.cos(_TWELVE), np.sin(_TWELVE)])
UNCLEAR = np.concatenate([math.sqrt(2.0 * r) * _RING for r in _RADII])
WEIGHT_UNCLEAR = np.repeat(_SHARES / 12.0, 12)


@inner
def below(x):
    """The standard normal law."""
    return 0.5 * math.erfc(-x * ROOT_HALF)


@inner
def peak(x):
    """The standard normal density."""
    return PEAK * math.exp(-0.5 * x * x) if x * x < 1400.0 else 0.0


@inner
def _border(a, b):
    """``_series`` where the border of the ball is nearly straight: by the coordinate along it."""
    p = slope = square = 0.0
    for j in range(2):
        y = BESIDE[j]
        c = math.sqrt(b * b - y) - a
        inside, density = below(c), peak(c)
        p += SHARE[j] * inside
        slope += SHARE[j] * density
        square += 0.5 * SHARE[j] * ((1.0 + y) * inside - c * density)
    return p, slope / a, square


@inner
def _series(a, b):
    """Of a point of unit variance with its mean at a distance ``a``, and the ball of radius ``b``.

    Returns:
        P of being inside; 2 f(4), and half the mean square from the mean, inside: f(d) is the density of the
        non-central chi-squared law of d degrees of freedom at b^2.
    """
    z = a * b
    if z < 1e-6:
        e = math.exp(-0.5 * b * b)
        p, twice, six = 1.0 - e, 0.5 * b * b * e, b * b * b * b * e / 16.0
    else:
        # Bessel functions times exp(-z), by Miller's recurrence from where they are nothing
        last, step = 8 + int(4.0 * math.sqrt(z)), 2.0 / z
        ratio = b / a if b <= a else a / b
        higher, here, total, powers, second = 0.0, 1e-200, 0.0, 0.0, 0.0
        for k in range(last, 0, -1):
            total += 2.0 * here
            powers = (powers + here) * ratio
            if k == 2:
                second = here
            higher, here = here, higher + step * k * here
        scale = math.exp(-0.5 * (a - b) * (a - b)) / (total + here)
        p = scale * powers if b <= a else 1.0 - scale * (powers + here)
        twice, six = scale * (b / a) * higher, 0.5 * scale * (b / a) * (b / a) * second
    return p, twice, p - twice - a * a * (six - 0.5 * twice)


@inner
def ball(mean2, variance, radius):
    """A Gaussian point of the plane within ``radius`` of the origin.

    Args:
        mean2: squared length of its mean; variance: per axis.

    Returns:
        P; the share of its mean that is left, and its variance, given that it is inside.
    """
    if variance <= 0.0:
        return 1.0 if mean2 <= radius * radius else 0.0, 1.0, 0.0
    away = math.sqrt(mean2) - radius
    if away * abs(away) > FAR * variance:
        return 0.0, 1.0, variance
    if away * abs(away) < -FAR * variance:
        return 1.0, 1.0, variance
    s = 1.0 / math.sqrt(variance)
    a, b = math.sqrt(mean2) * s, radius * s
    p, twice, square = _series(a, b) if a * b < LARGE else _border(a, b)
    if p <= 0.0:
        return 0.0, 1.0, variance
    p = min(p, 1.0)
    shift = twice / p
    return p, 1.0 - shift, variance * min(max(square / p - 0.5 * shift * shift * a * a, LEAST), 1.0)


@inner
def given(g, k, mean0, mean1, variance):
    """The Gaussian ``g`` once its position (``k`` 0) or velocity (2) is known to have a mean and variance, in place."""
    own, other = (4, 6) if k == 0 else (6, 4)
    slope = g[5] / g[own] if g[own] > 0.0 else 0.0
    left = variance - g[own]
    g[2 - k] += slope * (mean0 - g[k])
    g[3 - k] += slope * (mean1 - g[k + 1])
    g[k], g[k + 1] = mean0, mean1
    g[other] += slope * slope * left
    g[5] += slope * left
    g[own] = variance


@inner
def within(g, k, radius):
    """Position (``k`` 0) or velocity (2) within a ball; ``g`` given that, in place."""
    variance = g[4] if k == 0 else g[6]
    p, left, after = ball(g[k] * g[k] + g[k + 1] * g[k + 1], variance, radius)
    if 0.0 < p < 1.0:
        given(g, k, left * g[k], left * g[k + 1], after)
    return p


@inner
def _part(g, cov_u, cov_w, v0, v1, variance, left, after):
    """``g`` once something of mean (v0, v1) has ``left`` of it and another variance, in place."""
    if variance <= 0.0:
        return
    ku, kw, less, change = cov_u / variance, cov_w / variance, left - 1.0, after - variance
    g[0] += ku * less * v0
    g[1] += ku * less * v1
    g[2] += kw * less * v0
    g[3] += kw * less * v1
    g[4] = max(g[4] + ku * ku * change, LEAST * g[4])
    g[6] = max(g[6] + kw * kw * change, LEAST * g[6])
    most = 0.999 * math.sqrt(g[4] * g[6])
    g[5] = min(max(g[5] + ku * kw * change, -most), most)


@inner
def both_slow(g, own, speed):
    """Both velocities within a ball; ``g`` given that, in place.

    How they depend on the relative state follows from their own filters, if either depends on the other's position as
    the other does on its own.
    """
    pv_a, var_a, pv_b, var_b = own[4], own[5], own[6], own[7]
    first, left, after = ball(own[0] * own[0] + own[1] * own[1], var_a, speed)
    if first <= 0.0:
        return 0.0
    both, slope = 0.5 * (var_a + var_b - g[6]), 0.0
    if var_a > 0.0:
        most = 0.999 * math.sqrt(var_a * max(var_b, 0.0))
        slope = min(max(both, -most), most) / var_a
    b0, b1 = own[2] + slope * (left - 1.0) * own[0], own[3] + slope * (left - 1.0) * own[1]
    narrow = max(var_b + slope * slope * (after - var_a), LEAST * var_b)
    if first < 1.0:
        _part(g, 0.5 * (pv_b - pv_a - g[5]), 0.5 * (var_b - var_a - g[6]), own[0], own[1], var_a, left, after)
        pv_b += slope * (after / var_a - 1.0) * 0.5 * (pv_a + pv_b - g[5])
        var_a = after
    second, left, after = ball(b0 * b0 + b1 * b1, narrow, speed)
    if 0.0 < second < 1.0:
        _part(g, 0.5 * (pv_b - pv_a + g[5]), 0.5 * (narrow - var_a + g[6]), b0, b1, narrow, left, after)
    return first * second


@inner
def _interval(mean, sd, low, high):
    """A Gaussian number above ``low`` and at most ``high``: P, mean times P, mean square times P."""
    if sd <= 0.0:
        p = 1.0 if low < mean <= high else 0.0
        return p, p * mean, p * mean * mean
    a, b = (low - mean) / sd, (high - mean) / sd
    p = below(b) - below(a) if b < 0.0 else below(-a) - below(-b)
    da, db = peak(a), peak(b)
    shift = sd * (da - db)
    square = sd * sd * (p + (a * da if da > 0.0 else 0.0) - (b * db if db > 0.0 else 0.0))
    return p, p * mean + shift, p * mean * mean + 2.0 * mean * shift + square


@inner
def in_front(g, own, distance, width):
    """The second within ``distance`` along the course of the first and ``width`` beside it; ``g`` given that, in place.

    By nodes over the velocity of the first, given which it is a rectangle.
    """
    far = math.sqrt(g[0] * g[0] + g[1] * g[1]) - math.sqrt(distance * distance + width * width)
    if far > 0.0 and far * far > FAR * g[4]:
        return 0.0
    v0, v1, var_a = own[0], own[1], max(own[5], 0.0)
    speed = math.sqrt(v0 * v0 + v1 * v1)
    c, s = (v0 / speed, v1 / speed) if speed > 0.0 else (1.0, 0.0)
    slope = 0.5 * (own[6] - own[4] - g[5]) / var_a if var_a > 0.0 else 0.0
    sd_v, sd = math.sqrt(var_a), math.sqrt(max(g[4] - slope * slope * var_a, 0.05 * g[4], 0.0))
    total = m0 = m1 = a0 = a1 = uu = ud = dd = 0.0  # of the position, and of the velocity from its mean
    for i in range(3):
        for j in range(9):
            if sd_v == 0.0 and (i != 1 or j != 4):
                continue
            weight = WEIGHT3[i] * WEIGHT9[j] if sd_v > 0.0 else 1.0
            along, across = sd_v * THREE[i], sd_v * NINE[j]
            d0, d1 = c * along - s * across, s * along + c * across
            e0, e1 = v0 + d0, v1 + d1
            length = math.sqrt(e0 * e0 + e1 * e1)
            if length <= 0.0:
                continue
            e0, e1 = e0 / length, e1 / length
            u0, u1 = g[0] + slope * d0, g[1] + slope * d1
            p, x, xx = _interval(u0 * e0 + u1 * e1, sd, 0.0, distance)
            q, y, yy = _interval(u1 * e0 - u0 * e1, sd, -width, width)
            x0, x1 = weight * (x * q * e0 - p * y * e1), weight * (x * q * e1 + p * y * e0)
            total += weight * p * q
            m0 += x0
            m1 += x1
            a0 += weight * p * q * d0
            a1 += weight * p * q * d1
            uu += 0.5 * weight * (xx * q + p * yy)
            ud += 0.5 * (x0 * d0 + x1 * d1)
            dd += 0.5 * weight * p * q * (d0 * d0 + d1 * d1)
    if total <= 0.0:
        return 0.0
    if g[4] <= 0.0:
        return min(total, 1.0)
    m0, m1, a0, a1 = m0 / total, m1 / total, a0 / total, a1 / total
    uu = max(uu / total - 0.5 * (m0 * m0 + m1 * m1), LEAST * g[4])
    ud, dd = ud / total - 0.5 * (m0 * a0 + m1 * a1), dd / total - 0.5 * (a0 * a0 + a1 * a1)
    # the relative velocity by its regression on both
    cross, both = slope * var_a, 0.5 * (own[7] - var_a - g[6])
    det = g[4] * var_a - cross * cross
    if var_a <= 0.0 or det <= 1e-9 * g[4] * var_a:
        given(g, 0, m0, m1, uu)
        return min(total, 1.0)
    ku, kv = (g[5] * var_a - both * cross) / det, (both * g[4] - g[5] * cross) / det
    rest = max(g[6] - ku * g[5] - kv * both, 0.0)
    g[2] += ku * (m0 - g[0]) + kv * a0
    g[3] += ku * (m1 - g[1]) + kv * a1
    g[6] = max(rest + ku * ku * uu + 2.0 * ku * kv * ud + kv * kv * dd, LEAST * g[6])
    g[0], g[1], g[4] = m0, m1, uu
    most = 0.999 * math.sqrt(g[4] * g[6])
    g[5] = min(max(ku * uu + kv * ud, -most), most)
    return min(total, 1.0)


@inner
def nearing(g, speed):
    """The distance shrinks by ``speed`` at least; ``g`` given that, in place.

    By nodes over the relative position, given which it is a half-space of the relative velocity.
    """
    u0, u1, w0, w1, pp, pv, vv = g[0], g[1], g[2], g[3], g[4], g[5], g[6]
    slope = pv / pp if pp > 0.0 else 0.0
    sd_u, sd = math.sqrt(max(pp, 0.0)), math.sqrt(max(vv - slope * pv, 0.0))
    clear = u0 * u0 + u1 * u1 > 16.0 * pp
    total = a0 = a1 = b0 = b1 = uu = uw = ww = 0.0
    for j in range(1 if pp <= 0.0 else (len(CLEAR) if clear else len(UNCLEAR))):
        d0 = d1 = 0.0
        weight = 1.0
        if pp > 0.0:
            weight = WEIGHT_CLEAR[j] if clear else WEIGHT_UNCLEAR[j]
            d0 = sd_u * (CLEAR[j, 0] if clear else UNCLEAR[j, 0])
            d1 = sd_u * (CLEAR[j, 1] if clear else UNCLEAR[j, 1])
        x0, x1 = u0 + d0, u1 + d1
        length = math.sqrt(x0 * x0 + x1 * x1)
        if length <= 0.0:
            continue
        n0, n1 = x0 / length, x1 / length
        # about the mean of the velocity, so that a common motion costs no digits
        c0, c1 = slope * d0, slope * d1
        apart = (w0 + c0) * n0 + (w1 + c1) * n1
        if sd <= 0.0:
            p, shift, more = 1.0 if apart <= -speed else 0.0, 0.0, 0.0
        else:
            b = (-speed - apart) / sd
            p, density = below(b), peak(b)
            shift, more = -sd * density, -sd * sd * b * density
        p0, p1 = p * c0 + shift * n0, p * c1 + shift * n1
        total += weight * p
        a0 += weight * p * d0
        a1 += weight * p * d1
        b0 += weight * p0
        b1 += weight * p1
        uu += 0.5 * weight * p * (d0 * d0 + d1 * d1)
        uw += 0.5 * weight * (d0 * p0 + d1 * p1)
        ww += weight * (p * (0.5 * (c0 * c0 + c1 * c1) + sd * sd) + shift * (c0 * n0 + c1 * n1) + 0.5 * more)
    if total <= 0.0:
        return 0.0
    a0, a1, b0, b1 = a0 / total, a1 / total, b0 / total, b1 / total
    g[0], g[1], g[2], g[3] = u0 + a0, u1 + a1, w0 + b0, w1 + b1
    g[4] = max(uu / total - 0.5 * (a0 * a0 + a1 * a1), LEAST * pp)
    g[6] = max(ww / total - 0.5 * (b0 * b0 + b1 * b1), LEAST * vv)
    most = 0.999 * math.sqrt(max(g[4] * g[6], 0.0))
    g[5] = min(max(uw / total - 0.5 * (a0 * b0 + a1 * b1), -most), most)
    return min(total, 1.0)
