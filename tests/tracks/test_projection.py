import pickle

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyproj import Geod

from wakefold.tracks.projection import Projection

GEOD = Geod(ellps="WGS84")
centres = st.tuples(st.floats(-180, 180), st.floats(-90, 90))


@given(centres, st.lists(st.tuples(st.floats(0, 360), st.floats(0, 2e6)), min_size=1, max_size=20))
def test_the_inverse_is_within_a_millimetre(centre, polar):
    plane = Projection(*centre)
    angle, radius = np.radians([a for a, _ in polar]), np.array([r for _, r in polar])
    points = np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=1)
    lonlat = plane.to_geodetic(points)
    assert (np.abs(lonlat[:, 0]) <= 180).all()
    assert np.abs(plane.to_plane(*lonlat.T) - points).max() < 1e-3


@given(centres, st.floats(0, 360), st.floats(1, 1e6))
@example((0.0, 1e-9), 0.0, 1.0)
def test_distances_from_the_centre_are_geodesic(centre, azimuth, distance):
    plane = Projection(*centre)
    lon, lat, _ = GEOD.fwd(*centre, azimuth, distance)
    (x, y), (x0, y0) = plane.to_plane(lon, lat)[0], plane.to_plane(*centre)[0]
    assert np.hypot(x0, y0) < 1e-6
    # PROJ itself is 0.1 mm off where the centre lies a hair's breadth from the equator
    assert np.hypot(x, y) == pytest.approx(distance, abs=1e-3, rel=1e-9)


@pytest.mark.parametrize(("radius", "error"), [(1e5, 5e-5), (1e6, 5e-3)])
def test_lengths_are_true_as_far_as_promised(radius, error):
    plane = Projection(10.0, 57.0)
    for azimuth in range(0, 360, 30):
        lon, lat, _ = GEOD.fwd(10.0, 57.0, azimuth, radius)
        for heading in range(0, 360, 45):
            lon2, lat2, _ = GEOD.fwd(lon, lat, heading, 1000.0)
            a, b = plane.to_plane([lon, lon2], [lat, lat2])
            assert np.linalg.norm(b - a) == pytest.approx(1000.0, rel=error)


def test_the_antimeridian_is_nowhere_special():
    lon, lat = np.array([179.9, -179.9, 179.95]), np.array([-17.0, -17.0, -17.1])
    plane = Projection.of(lon, lat)
    assert abs(plane.lon) > 179.8
    points = plane.to_plane(lon, lat)
    shifted = Projection.of(lon - 179, lat).to_plane((lon - 179 + 180) % 360 - 180, lat)
    assert points == pytest.approx(shifted, abs=1e-6)  # the same tracks elsewhere have the same shape
    assert np.hypot(*(points[1] - points[0])) == pytest.approx(GEOD.inv(179.9, -17, -179.9, -17)[2], rel=1e-4)
    assert plane.to_geodetic(points) == pytest.approx(np.stack([lon, lat], axis=1), abs=1e-9)


@pytest.mark.parametrize("lat", [89.9, -89.9, 90.0])
def test_a_voyage_over_the_pole_is_a_straight_line(lat):
    plane = Projection.of([0.0, 90.0, 180.0, -90.0], [lat] * 4)
    a, pole, b = plane.to_plane([0.0, 0.0, 180.0], [lat, np.copysign(90.0, lat), lat])
    assert np.linalg.norm(b - a) == pytest.approx(np.linalg.norm(b - pole) + np.linalg.norm(a - pole), abs=1e-3)
    assert np.linalg.norm(b - a) == pytest.approx(GEOD.inv(0, lat, 180, lat)[2], rel=1e-3, abs=1e-3)


@given(st.permutations(range(30)))
def test_the_order_of_the_rows_does_not_move_the_plane(order):
    rng = np.random.default_rng(3)
    lon, lat = rng.uniform(-75, -74, 30), rng.uniform(40, 41, 30)
    assert Projection.of(lon[order], lat[order]) == Projection.of(lon, lat)


def test_what_has_no_place_is_refused():
    for lon, lat in (([], []), ([np.nan], [0.0]), ([0.0], [91.0]), ([np.inf], [0.0])):
        with pytest.raises(ValueError, match="finite longitude"):
            Projection.of(lon, lat)


def test_a_projection_is_a_value():
    plane = Projection(-74.0, 40.5)
    before = plane.to_plane(-74.1, 40.6)
    copy = pickle.loads(pickle.dumps(plane))  # noqa: S301 -- to worker processes
    assert copy == plane
    assert hash(copy) == hash(plane)
    assert (copy.to_plane(-74.1, 40.6) == before).all()
    assert str(plane) == "metres about 40.5°N 74°W"


@pytest.mark.parametrize("lat0", [-90, -60.5, -1e-4, 0, 33.3, 55.12, 89.99, 90])
@pytest.mark.parametrize("lon0", [-180, 0, 123.4, 179.9999])
def test_the_plane_is_that_of_proj(lon0, lat0):
    """Within a millimetre over 10,000 km; farther away too, where the points that are too far for us are proj's own."""
    from pyproj import Geod

    random = np.random.default_rng(0)
    away = np.concatenate([[0.0, 1e-6, 1.0], 10 ** random.uniform(-2, 7, 500), random.uniform(1e7, 2e7, 500)])
    n = len(away)
    lon, lat, _ = Geod(ellps="WGS84").fwd(np.full(n, lon0), np.full(n, lat0), random.uniform(0, 360, n), away)
    plane = Projection(lon0, lat0)
    theirs = np.stack(plane._transformer.transform(lon, lat), axis=1)
    for turn in (0.0, 360.0, -360.0):
        assert np.abs(plane.to_plane(lon + turn, lat) - theirs).max() < 1e-3
    near = away < 1e6
    assert np.abs(plane.to_plane(lon, lat) - theirs)[near].max() < 1e-5


def test_what_is_no_position_is_nowhere():
    lon, lat = np.array([np.nan, 0.0, np.inf, 0.0, 1.0]), np.array([0.0, np.nan, 0.0, 91.0, 2.0])
    assert np.isfinite(Projection(0.0, 0.0).to_plane(lon, lat)).all(axis=1).tolist() == [False] * 4 + [True]


def test_a_point_is_placed_alike_alone_and_among_others():
    """The compiled loop takes several points at once, and the last ones by themselves."""
    random = np.random.default_rng(1)
    lon, lat = random.uniform(-180, 180, 1003), random.uniform(-90, 90, 1003)
    plane = Projection(10.0, 55.0)
    together = plane.to_plane(lon, lat)
    assert all(np.array_equal(plane.to_plane(lon[k], lat[k])[0], together[k]) for k in range(1003))
