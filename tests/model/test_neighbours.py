"""The localised velocity against its definition in loops; where the box tree could go wrong."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wakefold.base.compile import kernel
from wakefold.model.kernels import boxes as tree
from wakefold.model.kernels.boxes import SLACK, WIDTH, Ground, field
from wakefold.model.kernels.motion import drifts
from wakefold.model.kernels.neighbours import departures

FLOOR = 1e-7
ALONE = np.empty(0, dtype=np.int64)  # no class above any counts


@kernel
def rows_near(q, first, last, field, reach2, dims):
    """What ``boxes.rows_near`` finds, as an array: for kernels only, it takes and gives pointers."""
    room, made = tree.scratch(field.leaf_at), tree.bare(field)
    rows, count = tree.rows_near(tree.pointer(q, 0), first, last, made, reach2, tree.pointer(room, 0), dims)
    out = np.empty(count, dtype=np.int64)
    for i in range(count):
        out[i] = rows[i]
    tree.hold(room)
    return out


def naive_velocity(q, points, velocities, epsilon, floor=FLOOR):
    """Inverse-distance mean of the velocities in the open ball; of an empty ball, the nearest point's."""
    gaps = [math.sqrt(sum((a - b) ** 2 for a, b in zip(p, q, strict=True))) for p in points.tolist()]
    inside = [i for i, gap in enumerate(gaps) if gap < epsilon]
    if not inside:
        return velocities[gaps.index(min(gaps))]
    weights = [1.0 / max(gaps[i], floor) for i in inside]
    return sum(w * velocities[i] for w, i in zip(weights, inside, strict=True)) / sum(weights)


def velocities_of(tracks, q, lo, hi, epsilon):
    """(n, d) by the kernel, for positions (n, d) and one class [lo, hi) each; and the field's points, velocities."""
    points, velocities = (np.concatenate([t[k] for t in tracks]) for k in (0, 1))
    starts = np.concatenate([[0], np.cumsum([len(t[0]) for t in tracks])])
    dims = (0,) * points.shape[1]
    out = np.empty_like(q)
    reach = (float(epsilon) ** 2, FLOOR**2)
    drifts(q, np.arange(len(q)), ALONE, out, Ground(lo, hi, field(points, velocities, starts), *reach, dims))
    return out, points, velocities, starts


def check(tracks, q, lo, hi, epsilon, tolerance=1e-10):
    q, lo, hi = np.asarray(q, dtype=float), np.asarray(lo), np.asarray(hi)
    out, points, velocities, starts = velocities_of(tracks, q, lo, hi, epsilon)
    for i in range(len(q)):
        own = slice(starts[lo[i]], starts[hi[i]])
        expected = naive_velocity(q[i].tolist(), points[own], velocities[own], epsilon)
        np.testing.assert_allclose(out[i], expected, rtol=tolerance, atol=tolerance)


def random_tracks(rng, count, d, longest, grid=False):
    lengths = rng.integers(1, longest + 1, count)
    if grid:  # whole numbers: many points exactly on the edge of a ball, many in one place
        return [
            (rng.integers(-6, 7, (n, d)).astype(float), rng.integers(-9, 10, (n, d)).astype(float)) for n in lengths
        ]
    steps = [np.cumsum(rng.normal(size=(n, d)), axis=0) + rng.normal(0, 10, d) for n in lengths]
    return [(p, rng.normal(size=p.shape)) for p in steps]


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("grid", [False, True])
@given(st.data())
@settings(max_examples=60)
def test_velocity_is_that_of_its_definition(d, grid, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    tracks = random_tracks(rng, data.draw(st.integers(1, 30)), d, data.draw(st.sampled_from([1, 3, 60])), grid)
    epsilon = data.draw(st.sampled_from([1e-3, 1.0, 2.0, 5.0, 1e4]))
    n = 6
    if grid:
        q = rng.integers(-7, 8, (n, d))
    else:
        q = rng.normal(0, 12, (n, d))
    lo = rng.integers(0, len(tracks), n)
    hi = np.array([rng.integers(a + 1, len(tracks) + 1) for a in lo])
    out, points, velocities, starts = velocities_of(tracks, q.astype(float), lo, hi, epsilon)
    for i in range(n):
        own = slice(starts[lo[i]], starts[hi[i]])
        gap2 = ((points[own] - q[i]) ** 2).sum(axis=1)
        if grid and (gap2 < epsilon**2).sum() == 0:  # ties: any of the nearest points will do
            candidates = velocities[own][gap2 == gap2.min()]
            assert (candidates == out[i]).all(axis=1).any()
        else:
            expected = naive_velocity(q[i].tolist(), points[own], velocities[own], epsilon)
            np.testing.assert_allclose(out[i], expected, rtol=1e-10, atol=1e-10)


def test_a_point_on_the_edge_of_the_ball_is_outside():
    tracks = [(np.array([[0.0], [3.0]]), np.array([[1.0], [5.0]]))]
    check(tracks, [[1.0], [1.0 - 1e-9]], [0, 0], [1, 1], epsilon=2.0)
    out, *_ = velocities_of(tracks, np.array([[1.0]]), np.array([0]), np.array([1]), 2.0)
    assert out[0, 0] == 1.0
    out, *_ = velocities_of(tracks, np.array([[1.0]]), np.array([0]), np.array([1]), np.nextafter(2.0, 3.0))
    assert out[0, 0] == pytest.approx((1.0 + 5.0 / 2.0) / 1.5)


def test_points_in_one_place_count_at_the_floor():
    here = np.zeros((5, 2))
    velocities = np.arange(10.0).reshape(5, 2)
    out, *_ = velocities_of([(here, velocities)], np.zeros((1, 2)), np.array([0]), np.array([1]), 1.0)
    np.testing.assert_allclose(out[0], velocities.mean(axis=0), rtol=1e-14)


def test_far_positions_take_the_nearest_point_of_the_class():
    rng = np.random.default_rng(3)
    tracks = random_tracks(rng, 40, 2, 70)
    turn = rng.uniform(0, 2 * np.pi, 20)
    q = 1e9 * np.column_stack([np.cos(turn), np.sin(turn)])
    lo = rng.integers(0, 40, 20)
    check(tracks, q, lo, np.minimum(lo + rng.integers(1, 40, 20), 40), epsilon=5.0, tolerance=1e-9)


@pytest.mark.parametrize("where", [1e200, 1e39, -1e30])
def test_absurd_positions_give_some_velocity_of_the_class(where):
    rng = np.random.default_rng(4)
    tracks = random_tracks(rng, 10, 2, 50)
    out, _, velocities, starts = velocities_of(tracks, np.full((1, 2), where), np.array([3]), np.array([6]), 5.0)
    assert (velocities[starts[3] : starts[6]] == out[0]).all(axis=1).any()


@pytest.mark.parametrize("scale", [1e-25, 1e-12, 1e12, 1e25])
def test_units_do_not_matter(scale):
    rng = np.random.default_rng(5)
    tracks = [(p * scale, v) for p, v in random_tracks(rng, 12, 2, 50)]
    q = rng.normal(0, 12, (8, 2)) * scale
    points, velocities = (np.concatenate([t[k] for t in tracks]) for k in (0, 1))
    starts = np.concatenate([[0], np.cumsum([len(t[0]) for t in tracks])])
    epsilon, floor = 5.0 * scale, 1e-8 * scale
    out = np.empty_like(q)
    made, reach = field(points, velocities, starts), (epsilon**2, floor**2)
    drifts(q, np.arange(8), ALONE, out, Ground(np.zeros(8, int), np.full(8, 12), made, *reach, (0, 0)))
    for i in range(8):
        expected = naive_velocity(q[i].tolist(), points, velocities, epsilon, floor)
        np.testing.assert_allclose(out[i], expected, rtol=1e-10)


def test_positions_a_million_kilometres_from_the_origin():
    """The boxes are float32, good to 64 m here; the sums are not."""
    rng = np.random.default_rng(6)
    shift = np.array([1e9, -1e9])
    tracks = [(p + shift, v) for p, v in random_tracks(rng, 30, 2, 60)]
    check(tracks, rng.normal(0, 12, (20, 2)) + shift, np.zeros(20, int), np.full(20, 30), epsilon=4.0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_no_row_within_reach_is_missed_and_none_outside_the_range_found(seed):
    rng = np.random.default_rng(seed)
    tracks = random_tracks(rng, int(rng.integers(1, 60)), 2, 90)
    points = np.concatenate([t[0] for t in tracks])
    starts = np.concatenate([[0], np.cumsum([len(t[0]) for t in tracks])])
    made = field(points, np.zeros_like(points), starts)
    total = int(made.leaf_at[-1])
    first = int(rng.integers(0, total))
    last = int(rng.integers(first, total + 1))
    q, epsilon = rng.normal(0, 12, 2), float(rng.choice([0.5, 4.0, 100.0]))
    rows = rows_near(q, first, last, made, epsilon**2, (0, 0))
    assert (np.diff(rows) > 0).all()
    data = made.data.reshape(-1, 4, WIDTH)[:, :2]
    gap2 = ((data - q[:, None]) ** 2).sum(axis=1).min(axis=1)[:-1]
    needed = np.flatnonzero(gap2 < epsilon**2)
    assert set(needed[(needed >= first) & (needed < last)]) <= set(rows)
    assert all(first <= row < last for row in rows)
    low, high = data[rows], data[rows]
    low, high = low.min(axis=2, initial=np.inf), np.where(np.isfinite(high), high, -np.inf).max(axis=2)
    gap = np.maximum(np.maximum(low - q, q - high), 0.0)
    assert (np.sqrt((gap**2).sum(axis=1)) <= epsilon + 2 * SLACK * (epsilon + 100)).all()


def test_departures_leave_out_the_own_track():
    rng = np.random.default_rng(7)
    tracks = random_tracks(rng, 15, 2, 40)
    points, velocities = (np.concatenate([t[k] for t in tracks]) for k in (0, 1))
    starts = np.concatenate([[0], np.cumsum([len(t[0]) for t in tracks])])
    leaf = np.repeat(np.arange(15), np.diff(starts))
    lo, hi = np.maximum(leaf - 2, 0), np.minimum(leaf + 4, 15)
    made = field(points, velocities, starts)
    ground = Ground(ALONE, ALONE, made, 4.0, FLOOR**2, (0, 0))
    out = departures(points, velocities, leaf, lo, hi, ground)
    for i in range(len(points)):
        others = (leaf >= lo[i]) & (leaf < hi[i]) & (leaf != leaf[i])
        if not (np.sqrt(((points[others] - points[i]) ** 2).sum(axis=1)) < 2.0).any():
            assert np.isnan(out[i]).all()
            continue
        around = naive_velocity(points[i].tolist(), points[others], velocities[others], 2.0)
        np.testing.assert_allclose(out[i], velocities[i] - around, rtol=1e-9, atol=1e-9)
