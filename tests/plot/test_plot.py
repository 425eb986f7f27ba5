import json
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex

from wakefold import plot
from wakefold.model.filtration import Filtration
from wakefold.plot import belief as plot_belief
from wakefold.plot.canvas import PALETTE
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks


def bundles(projection=None, seed=0) -> Tracks:
    """Three bundles of 6, 4 and 2 tracks and one track by itself."""
    rng = np.random.default_rng(seed)
    points = []
    for bundle, size in enumerate((6, 4, 2, 1)):
        for _ in range(size):
            x = np.linspace(0, 5000, 40)
            points.append(np.stack([x, bundle * 3000 + (bundle - 1) * x / 3 + rng.normal(0, 30, 40)], axis=1))
    return Tracks.from_arrays(points, projection=projection)


@pytest.fixture(scope="module")
def tracks():
    return bundles(Projection(-74.0, 40.6))


@pytest.fixture(scope="module")
def tree(tracks):
    return Filtration.fit(tracks)


def moments(tracks, tree, levels, shares):
    """One moment per row of ``shares``, a probability of each track."""
    out = []
    for k, share in enumerate(np.asarray(shares, dtype=float)):
        table = {b: (tree.alive(b), np.array([share[tree.members(c)].sum() for c in tree.alive(b)])) for b in levels}
        here = tracks[0][10 * k]
        out.append(
            plot.Moment(1.6e9 + 600 * k, table, estimate=here + 50, truth=here, observed=tracks[0][: 10 * k + 1])
        )
    return out


def line_colours(ax):
    """Colour -> number of lines, of the lines drawn over the backdrop."""
    out = {}
    for collection in ax.collections:
        if isinstance(collection, LineCollection) and collection.get_zorder() == 2:
            colours = collection.get_colors()
            for k in range(len(collection.get_segments())):
                name = to_hex(colours[k % len(colours)])
                out[name] = out.get(name, 0) + 1
    return out


def legend_counts(figure):
    text = [entry.get_text() for entry in figure.legends[0].get_texts()]
    return [int(t.split(":")[-1].split()[0].replace(",", "")) for t in text]


@pytest.mark.parametrize("level", [0.0, 100.0, 500.0, 1e9, None])
def test_every_track_is_drawn_once_in_the_colour_of_its_class(tracks, tree, level):
    figure = plot.filtration(tracks, tree, level)
    left, right = figure.axes
    assert sum(legend_counts(figure)) == len(tracks)
    colours = line_colours(left)
    assert sum(colours.values()) == len(tracks)
    if level == 500.0:
        assert legend_counts(figure) == [6, 4, 2, 1]
        assert [colours[c] for c in PALETTE[:3]] == [6, 4, 2]
        assert right.get_yscale() == "log"
    if level == 1e9:
        assert colours == {PALETTE[0]: 13}


def test_the_dendrogram_joins_tracks_at_their_heights(tracks, tree):
    right = plot.filtration(tracks, tree, 500.0).axes[1]
    bars = [s for c in right.collections for s in c.get_segments() if s[0, 1] == s[1, 1] and s[0, 0] < s[1, 0]]
    for c in range(len(tree), len(tree.birth)):
        inside = [bar for bar in bars if bar[0, 1] == tree.birth[c]]
        assert len(inside) == 1
        assert tree.lo[c] <= inside[0][0, 0] < inside[0][1, 0] <= tree.hi[c] - 1
    assert len(bars) == len(tree.birth) - len(tree)
    tops = {round(s[1, 1], 9) for c in right.collections for s in c.get_segments() if s[0, 0] == s[1, 0]}
    assert {round(float(h), 9) for h in tree.gaps} <= tops


def test_trees_without_shape_are_drawn():
    one = Tracks.from_arrays([[[0.0, 0.0], [1.0, 1.0]]])
    same = Tracks.from_arrays([[[0.0, 0.0], [1.0, 1.0]]] * 3)
    still = Tracks.from_arrays([[[2.0, 3.0]], [[2.0, 3.0]]])
    for tracks in (one, same, still):
        tree = Filtration.fit(tracks)
        for figure in (plot.tracks(tracks), plot.filtration(tracks, tree), plot.filtration(tracks, tree, 5.0)):
            figure.draw_without_rendering()
    assert plot.filtration(same, tree=Filtration.fit(same), level=5.0).axes[0].get_title("left").endswith("level 5")
    with pytest.raises(ValueError, match="two coordinates"):
        plot.tracks(Tracks.from_arrays([[1.0, 2.0]]))
    with pytest.raises(ValueError, match="nothing to draw"):
        plot.tracks(one.select([]))


def test_opacity_is_probability(tracks, tree):
    share = np.zeros((3, 13))
    share[0], share[1, :6], share[2, [0, 12]] = 1 / 13, 1 / 6, [0.96, 0.04]
    figure = plot.beliefs(tracks, tree, moments(tracks, tree, [0.0, 500.0, 1e9], share))
    panels = np.reshape(np.array(figure.axes, dtype=object), (3, 3))
    assert [ax.get_title(loc="left") for ax in panels[0]] == [
        "level 0 m\n13 classes", "level 500 m\n4 classes", "level 1,000,000 km\n1 classes"
    ]  # fmt: skip
    assert [sum(line_colours(ax).values()) for ax in panels[0]] == [13, 13, 13]
    assert [sum(line_colours(ax).values()) for ax in panels[1]] == [6, 6, 13]  # unlikely classes are not drawn
    assert [sum(line_colours(ax).values()) for ax in panels[2]] == [2, 7, 13]
    assert panels[1, 1].texts[0].get_text() == "100%  6 tracks"
    assert panels[2, 0].texts[0].get_text() == "96%  1 track"
    # A certain class has its colour in full, and keeps it from column to column.
    (certain,) = line_colours(panels[1, 1])
    assert certain == PALETTE[0]
    assert set(line_colours(panels[1, 2])) == {certain}
    assert [ax.yaxis.label.get_text() for ax in panels[:, 0]] == [
        "13 Sep 12:26\nstart", "13 Sep 12:36\n+10 min", "13 Sep 12:46\n+20 min"
    ]  # fmt: skip


def test_no_two_classes_of_a_panel_share_a_colour(tracks, tree):
    share = np.random.default_rng(0).dirichlet(np.ones(13), size=4)
    levels = [0.0, float(np.median(tree.gaps)), 500.0, 1e9]
    colours = plot_belief._belief_colours(tree, moments(tracks, tree, levels, share), levels)
    for level in levels:
        used = [colour for colour in colours[level].values() if colour in PALETTE]
        assert len(set(used)) == len(used) == min(len(PALETTE), len(tree.alive(level)))
    for fine, coarse in pairwise(levels):
        for d, colour in colours[coarse].items():
            inside = {c: k for c, k in colours[fine].items() if tree.lo[d] <= tree.lo[c] < tree.hi[d]}
            if colour in PALETTE and set(inside.values()) & set(PALETTE):
                assert colour in inside.values()


def test_beliefs_of_different_levels_are_refused(tracks, tree):
    share = np.full((2, 13), 1 / 13)
    a, b = moments(tracks, tree, [0.0, 500.0], share)[0], moments(tracks, tree, [0.0], share)[1]
    with pytest.raises(ValueError, match="same levels"):
        plot.beliefs(tracks, tree, [a, b])
    with pytest.raises(ValueError, match="no moments"):
        plot.beliefs(tracks, tree, [])


def test_a_forecast_shows_all_it_is_given(tracks):
    rng = np.random.default_rng(0)
    ahead = [
        plot.Ahead(300, rng.normal(0, 100, (50, 2)), truth=[0, 9000]),
        plot.Ahead(900, rng.normal(0, 300, (50, 2)), np.eye(50)[0], constant_velocity=[-8000, 0]),
    ]
    figure = plot.forecast(tracks, tracks[0][:5], ahead, truth=tracks[0][4:9])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["fixes so far", "truth", "in 5 min", "in 15 min", "mean", "truth then", "constant velocity"]
    (ax,) = figure.axes
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    assert x0 < -8000 < x1
    assert y0 < 9000 < y1
    means = [c.get_offsets().tolist()[0] for c in ax.collections if len(c.get_offsets()) == 1]
    assert ahead[1].particles[0].tolist() in means  # all the weight is on the first particle
    with pytest.raises(ValueError, match="no horizons"):
        plot.forecast(tracks, [0, 0], [])


def test_a_legend_stays_inside_a_narrow_picture():
    north = Tracks.from_arrays([[[0.0, 0.0], [x, 9000.0]] for x in (0.0, 50.0, 2000.0)])
    tree, going = Filtration.fit(north), np.linspace([0.0, 0.0], [0.0, 9000.0], 10)
    ahead = [plot.Ahead(s, going[-2:], truth=[0, 8000], constant_velocity=[0, 7000]) for s in (300, 900)]
    share = np.full((1, 3), 1 / 3)
    for figure in (
        plot.forecast(north, going[:5], ahead, truth=going[4:]),
        plot.filtration(north, tree, 100.0),
        plot.beliefs(north, tree, moments(north, tree, [100.0], share)),
    ):
        figure.draw_without_rendering()
        legend = figure.legends[0].get_window_extent()
        assert 0 <= legend.x0 < legend.x1 <= figure.bbox.width
        assert legend.y0 >= 0


@pytest.mark.parametrize(("lon", "lat"), [(-74.0, 40.6), (179.99, -17.0), (25.0, 89.99), (0.0, -90.0), (-180.0, 0.0)])
def test_the_frame_tells_degrees(lon, lat):
    plane = Projection(lon, lat)
    ax = plot.tracks(bundles(plane)).axes[0]
    x0, y0 = ax.get_xlim()[0], ax.get_ylim()[0]
    checked = 0
    for at, label in zip(ax.get_xticks(), ax.get_xticklabels(), strict=True):
        side, text = label.get_text()[-1], label.get_text().rstrip("EW")
        there = plane.to_geodetic([[at, y0]])[0, 0] * (-1 if side == "W" else 1)
        assert (float(text.rstrip("°")) - there + 180) % 360 - 180 == pytest.approx(
            0, abs=1e-3 if abs(lat) < 80 else 0.5
        )
        checked += 1
    for at, label in zip(ax.get_yticks(), ax.get_yticklabels(), strict=True):
        side, text = label.get_text()[-1], label.get_text().rstrip("NS")
        assert float(text.rstrip("°")) == pytest.approx(
            plane.to_geodetic([[x0, at]])[0, 1] * (-1 if side == "S" else 1), abs=1e-4
        )
        checked += 1
    assert checked >= 4


def test_the_antimeridian_is_drawn_and_named():
    ax = plot.tracks(bundles(Projection(179.99, -17.0))).axes[0]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["180.00°", "179.98°W", "179.96°W"]


def square(lon, lat, size):
    return [[lon, lat], [lon + size, lat], [lon + size, lat + size], [lon, lat + size], [lon, lat]]


def test_a_coastline_is_drawn_from_a_file(tracks, tree, tmp_path):
    path = tmp_path / "coast.geojson"
    land = {"type": "MultiPolygon", "coordinates": [[square(-74.02, 40.62, 0.02), square(-74.01, 40.63, 0.001)]]}
    beach = {"type": "LineString", "coordinates": [[-74.05, 40.6, 3.0], [-74.0, 40.65, 3.0]]}
    features = [{"type": "Feature", "properties": {}, "geometry": g} for g in (land, beach, None)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    ax = plot.tracks(tracks, coastline=path).axes[0]
    (areas,) = (c for c in ax.collections if isinstance(c, PolyCollection))
    assert len(areas.get_paths()) == 1  # the lake is no land
    corner = areas.get_paths()[0].vertices[0]
    assert tracks.projection.to_geodetic(corner)[0] == pytest.approx([-74.02, 40.62])
    shores = [c for c in ax.collections if isinstance(c, LineCollection) and c.get_zorder() == 0.3]
    assert len(shores[0].get_segments()) == 3
    assert ax.get_xlim() == plot.tracks(tracks).axes[0].get_xlim()
    plot.filtration(tracks, tree, coastline=path)


NO_COASTLINES = [
    "",
    "[]",
    '{"type": "Topology"}',
    '{"type": "FeatureCollection"}',
    '{"type": "LineString", "coordinates": [[1]]}',
    '{"type": "Polygon", "coordinates": [["a"]]}',
]


@pytest.mark.parametrize("text", NO_COASTLINES)
def test_what_is_no_coastline_is_refused(tracks, tmp_path, text):
    path = tmp_path / "coast.geojson"
    path.write_text(text)
    with pytest.raises(ValueError, match="not a GeoJSON file"):
        plot.tracks(tracks, coastline=path)


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_the_same_picture_is_the_same_file(tracks, tree, tmp_path, ending):
    files = [tmp_path / f"{k}.{ending}" for k in range(2)]
    for file in files:
        plot.save(plot.filtration(tracks, tree, 500.0), file)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].stat().st_size > 10_000


def test_pictures_leave_the_users_matplotlib_alone():
    code = """if True:
        import sys, matplotlib
        before = matplotlib.rcParams.copy()
        from wakefold import Tracks, plot
        plot.tracks(Tracks.from_arrays([[[0, 0], [1, 1]]]))
        assert matplotlib.rcParams.copy() == before
        assert "matplotlib.pyplot" not in sys.modules
    """
    subprocess.run([sys.executable, "-c", code], check=True)
