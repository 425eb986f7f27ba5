"""The plane: geodesics on WGS84 by Vincenty's series (1975), compiled. Arrays in, arrays out.

Only sums, products, quotients and roots, which are the same on every processor, and no branches, so that several points
are done at once.
"""

from __future__ import annotations

import math

from wakefold.base.compile import wide_inner, wide_kernel

A, F = 6_378_137.0, 1 / 298.257223563
B = A * (1 - F)
SECOND = (A * A - B * B) / (B * B)
RADIAN = math.pi / 180
SHIFT = 1.5 * 2.0**52
"""From where on numbers have no fraction."""
TINY, SMALL = 1e-150, 1e-30
"""Instead of zero below a fraction, whose numerator is as good as zero too: of an arc, of a square."""
NEAR = -0.5
"""Cosine of the longest arc from the centre, 120 degrees: farther away the series converges too slowly."""


@wide_inner
def _whole(x):
    """The nearest whole number."""
    return (x + SHIFT) - SHIFT


@wide_inner
def _sin_cos(degrees):
    """Sine and cosine of -180 to 180 degrees, by polynomials within an eighth of a turn (those of fdlibm)."""
    turns = _whole(degrees * (1.0 / 90.0))  # -2 to 2
    x = (degrees - 90.0 * turns) * RADIAN
    z = x * x
    s = z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    s = z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + s))
    s = x + x * z * (-1.66666666666666324348e-01 + s)
    c = z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
    c = z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + c))
    c = 1.0 - (0.5 * z - z * z * (4.16666666666666019037e-02 + c))
    odd = abs(turns - 2.0 * _whole(0.5 * turns)) * turns  # -1 or 1 at odd quarters, else 0
    even = (1.0 - odd * odd) * (1.0 - 0.5 * turns * turns)  # 1 or -1 at even ones
    return odd * c + even * s, even * c - odd * s


@wide_inner
def _arc(sine, cosine):
    """The angle, 0 to 120 degrees, of its sine and cosine: eight times the arc tangent of that of an eighth of it."""
    t = sine / (1.0 + cosine)
    t = t / (1.0 + math.sqrt(1.0 + t * t))
    t = t / (1.0 + math.sqrt(1.0 + t * t))
    z = t * t
    s = 1 / 25 - z * (1 / 27 - z * (1 / 29 - z * (1 / 31)))
    s = 1 / 17 - z * (1 / 19 - z * (1 / 21 - z * (1 / 23 - z * s)))
    s = 1 / 9 - z * (1 / 11 - z * (1 / 13 - z * (1 / 15 - z * s)))
    s = 1 / 3 - z * (1 / 5 - z * (1 / 7 - z * s))
    return 8.0 * t * (1.0 - z * s)


@wide_inner
def _bent(s0, c0, arc, ss, cs, sa, both):
    """Sine and cosine of the longitude on the sphere that belongs to that of the ellipsoid (``s0``, ``c0``)."""
    square = 1.0 - sa * sa
    c2 = cs - 2.0 * both / (square + SMALL)
    c = F / 16.0 * square * (4.0 + F * (4.0 - 3.0 * square))
    more = (1.0 - c) * F * sa * (arc + c * ss * (c2 + c * cs * (2.0 * c2 * c2 - 1.0)))
    z = more * more
    sine = more * (1.0 - z * (1 / 6) * (1.0 - z * (1 / 20) * (1.0 - z * (1 / 42))))
    cosine = 1.0 - z * (1 / 2) * (1.0 - z * (1 / 12) * (1.0 - z * (1 / 30) * (1.0 - z * (1 / 56))))
    return s0 * cosine + c0 * sine, c0 * cosine - s0 * sine


@wide_inner
def _sides(sl, cl, su1, cu1, su2, cu2):
    """East and north of the way to a point, its sine and cosine, and the sine of the azimuth at the equator."""
    east, north = cu2 * sl, cu1 * su2 - su1 * cu2 * cl
    ss, cs = math.sqrt(east * east + north * north), su1 * su2 + cu1 * cu2 * cl
    return east, north, ss, cs, cu1 * cu2 * sl / (ss + TINY)


@wide_inner
def _grown(arc, ss, cs, ss0, cs0):
    """An arc that differs by little from the one of ``ss0`` and ``cs0``."""
    step = ss * cs0 - cs * ss0
    return arc + step * (1.0 + step * step * (1 / 6 + step * step * 0.075))


@wide_kernel
def azimuthal(lon, lat, lon0, lat0, x, y, cosine):
    """Positions (n,) in degrees on the azimuthal equidistant plane about a centre, ``x`` and ``y`` (n,), metres.

    Right to a tenth of a millimetre where the cosine (n,) of the arc, which is given too, is ``NEAR`` and more. NaN of
    what is not finite.
    """
    su1, cu1 = _sin_cos(lat0)
    su1 = su1 * (1.0 - F)
    size = math.sqrt(su1 * su1 + cu1 * cu1)
    su1, cu1 = su1 / size, cu1 / size
    for i in range(len(lon)):
        turn = lon[i] - lon0
        s0, c0 = _sin_cos(turn - 360.0 * _whole(turn * (1.0 / 360.0)))
        su2, cu2 = _sin_cos(lat[i])
        su2 = su2 * (1.0 - F)
        size = math.sqrt(su2 * su2 + cu2 * cu2)
        su2, cu2 = su2 / size, cu2 / size
        both = su1 * su2
        east, north, ss, cs, sa = _sides(s0, c0, su1, cu1, su2, cu2)
        arc = _arc(ss, cs)
        sl, cl = _bent(s0, c0, arc, ss, cs, sa, both)
        east, north, ss1, cs1, sa = _sides(sl, cl, su1, cu1, su2, cu2)
        arc = _grown(arc, ss1, cs1, ss, cs)
        sl, cl = _bent(s0, c0, arc, ss1, cs1, sa, both)
        east, north, ss, cs, sa = _sides(sl, cl, su1, cu1, su2, cu2)
        arc = _grown(arc, ss, cs, ss1, cs1)
        sl, cl = _bent(s0, c0, arc, ss, cs, sa, both)
        east, north, ss1, cs1, sa = _sides(sl, cl, su1, cu1, su2, cu2)
        arc = _grown(arc, ss1, cs1, ss, cs)
        sl, cl = _bent(s0, c0, arc, ss1, cs1, sa, both)
        east, north, ss, cs, sa = _sides(sl, cl, su1, cu1, su2, cu2)
        arc = _grown(arc, ss, cs, ss1, cs1)
        square = 1.0 - sa * sa
        c2 = cs - 2.0 * both / (square + SMALL)
        u = square * SECOND
        long = 1.0 + u * (1 / 16384) * (4096.0 + u * (u * (320.0 - 175.0 * u) - 768.0))
        b = u * (1 / 1024) * (256.0 + u * (u * (74.0 - 47.0 * u) - 128.0))
        less = cs * (2.0 * c2 * c2 - 1.0) - b * (1 / 6) * c2 * (4.0 * ss * ss - 3.0) * (4.0 * c2 * c2 - 3.0)
        scale = B * long * (arc - b * ss * (c2 + 0.25 * b * less)) / (ss + TINY)
        x[i] = scale * east
        y[i] = scale * north
        cosine[i] = cs
