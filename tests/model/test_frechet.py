"""The discrete Fréchet distance: bits of the definition, metric properties, refusals, the float32 margin."""

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wakefold.model.linkage.distance import frechet, frechet_matrix
from wakefold.tracks.tracks import Tracks


def walks(rng, count, dim=2, longest=30, scale=1.0):
    """Random walks of 1 to ``longest`` points."""
    return [np.cumsum(rng.normal(0, scale, (n, dim)), axis=0) for n in rng.integers(1, longest + 1, count)]


@st.composite
def track_sets(draw):
    """Few tracks of 1 to 9 points in 1 to 3 dimensions, on a grid (ties, repeated points) or anywhere."""
    dim = draw(st.integers(1, 3))
    on_grid = st.integers(-3, 3).map(float)
    anywhere = st.floats(-1e6, 1e6)
    coordinate = draw(st.sampled_from([on_grid, anywhere]))
    return draw(
        st.lists(
            st.integers(1, 9).flatmap(lambda n: arrays(np.float64, (n, dim), elements=coordinate)),
            min_size=2,
            max_size=6,
        )
    )


@given(track_sets())
@settings(max_examples=150)
def test_bits_of_the_definition(tracks):
    expected = [[naive.frechet(a, b) for b in tracks] for a in tracks]
    np.testing.assert_array_equal(frechet_matrix(tracks), expected)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_bits_of_the_definition_for_many_tracks_of_mixed_length(dim):
    rng = np.random.default_rng(dim)
    tracks = walks(rng, 21, dim)
    tracks += [tracks[3], np.repeat(tracks[4], 3, axis=0), tracks[5][:1], np.zeros((1, dim)), np.zeros((7, dim))]
    expected = np.array([[naive.frechet(a, b) for b in tracks] for a in tracks])
    np.testing.assert_array_equal(frechet_matrix(tracks), expected)
    np.testing.assert_array_equal(frechet_matrix(tracks[:5], tracks[2:]), expected[:5, 2:])
    np.testing.assert_array_equal(frechet_matrix(tracks[2:], tracks[:5]), expected[2:, :5])


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("grid", [False, True])
def test_distances_settled_by_the_end_points(dim, grid):
    """Tracks whose distance is often, and as often just not, that of their first or last points: all bits the same."""
    rng = np.random.default_rng(7 * dim + grid)
    tracks = [rng.normal(0, 15, dim) + track for track in walks(rng, 30, dim, 40)]
    tracks += [rng.normal(0, 15, dim) + track for track in np.cumsum(rng.normal(0, 1, (14, 25, dim)), axis=1)]
    if grid:  # cells inside that equal those at the ends
        tracks = [np.round(track) for track in tracks]
    expected = np.array([[naive.frechet(a, b) for b in tracks] for a in tracks])
    ends = np.array([[max(np.linalg.norm(a[0] - b[0]), np.linalg.norm(a[-1] - b[-1])) for b in tracks] for a in tracks])
    assert 0.3 < np.isclose(ends, expected).mean() < 0.8
    np.testing.assert_array_equal(frechet_matrix(tracks), expected)
    rough = frechet_matrix(tracks, dtype="float32")
    diagonal = Tracks.from_arrays(tracks).diagonal
    assert (np.abs(rough - expected) <= 2.0**-24 * (diagonal + 4 * expected)).all()


def test_coordinates_are_taken_as_given():
    """A fused multiply-add, a centred or a scaled copy of the coordinates would change the last bits here."""
    rng = np.random.default_rng(0)
    for offset, scale in [(5e6, 10.0), (0.0, 1e-160), (0.0, 1e150)]:
        tracks = [track + offset for track in walks(rng, 12, scale=scale)]
        expected = [[naive.frechet(a, b) for b in tracks] for a in tracks]
        np.testing.assert_array_equal(frechet_matrix(tracks), expected)


def test_one_pair():
    rng = np.random.default_rng(1)
    a, b = walks(rng, 2, longest=300)
    assert frechet(a, b) == naive.frechet(a, b)
    assert frechet([0.0, 1.0, 2.0], [5.0]) == 5.0
    assert frechet([[1.0, 1.0]], [[4.0, 5.0]]) == 5.0


def test_dogs_on_short_leads():
    """Known answers: parallel lines, a detour, a track walked backwards, a track at rest."""
    line = np.stack([np.arange(11.0), np.zeros(11)], axis=1)
    assert frechet(line, line + np.array([0, 3])) == 3
    assert frechet(line, line[::2]) == 1
    assert frechet(line, line[::-1]) == 10
    assert frechet(line, [[5.0, 12.0]]) == 13
    assert frechet(line, np.repeat(line, 4, axis=0)) == 0


def test_it_is_a_metric():
    """Symmetric, zero on equal tracks, and no detour is shorter (in exact arithmetic; so to rounding)."""
    tracks = walks(np.random.default_rng(2), 40, longest=15)
    distances = frechet_matrix(tracks)
    np.testing.assert_array_equal(distances, distances.T)
    assert (np.diag(distances) == 0).all()
    assert (distances[:, None, :] <= (distances[:, :, None] + distances[None, :, :]) * (1 + 1e-12)).all()


def test_moving_or_turning_the_plane_changes_nothing():
    rng = np.random.default_rng(3)
    tracks = walks(rng, 20, dim=3)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = [track @ turn.T + [100.0, -7.0, 3.0] for track in tracks]
    np.testing.assert_allclose(frechet_matrix(moved), frechet_matrix(tracks), rtol=0, atol=1e-11)


def test_neither_order_nor_threads_matter():
    rng = np.random.default_rng(4)
    tracks = walks(rng, 50, longest=60)
    expected = frechet_matrix(tracks, threads=1)
    np.testing.assert_array_equal(frechet_matrix(tracks, threads=3), expected)
    shuffled = rng.permutation(50)
    np.testing.assert_array_equal(frechet_matrix([tracks[i] for i in shuffled]), expected[np.ix_(shuffled, shuffled)])


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (5e6, 1.0), (5e6, 1e-3), (0.0, 1e-30), (0.0, 1e30)])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_float32_stays_within_its_margin(offset, scale, dim):
    rng = np.random.default_rng(5)
    tracks = [track + offset for track in walks(rng, 60, dim, scale=scale)]
    exact, rough = frechet_matrix(tracks), frechet_matrix(tracks, dtype="float32")
    assert rough.dtype == np.float32
    margin = 2.0**-24 * (Tracks.from_arrays(tracks).diagonal + 4 * exact)
    error = np.abs(rough.astype(np.float64) - exact)
    assert (error <= margin).all()
    assert error.max() > 0.05 * margin.max()  # a margin a few times smaller would be seen to fail


def test_refusals_name_the_track():
    fine = np.zeros((3, 2))
    for bad in (np.nan, np.inf, -np.inf):
        broken = np.array([[0.0, 0.0], [bad, 0.0]])
        with pytest.raises(ValueError, match="track '2' has a position that is not finite"):
            frechet_matrix([fine, fine, broken])
        with pytest.raises(ValueError, match="track 'b' has a position that is not finite"):
            frechet(fine, broken)
    with pytest.raises(ValueError, match="track '1' has no points"):
        frechet_matrix([fine, np.empty((0, 2)), fine])
    with pytest.raises(ValueError, match="2 and 3 coordinates"):
        frechet_matrix([fine], [np.zeros((2, 3))])
    with pytest.raises(ValueError, match="tracks '0' and '1' are too far apart"):
        frechet_matrix([[[-1e200, 0.0]], [[1e200, 0.0]]])
    with pytest.raises(ValueError, match="tracks '0' and '1' are too far apart"):
        frechet_matrix([[[-1e100, 0.0]], [[1e100, 0.0]]], dtype="float32")
    with pytest.raises(ValueError, match="dtype"):
        frechet_matrix([fine, fine], dtype="float16")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="threads"):
        frechet_matrix([fine, fine], threads=0)


def test_progress_reaches_the_end():
    seen = []
    frechet_matrix(walks(np.random.default_rng(6), 10), progress=seen.append)
    assert seen[-1] == 1
    assert seen == sorted(seen)
