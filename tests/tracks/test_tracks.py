import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wakefold.base.store import StoreError
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks


def two() -> Tracks:
    return Tracks(
        points=np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [10.0, 0.0], [10.0, 5.0]]),
        times=np.array([0.0, 10.0, 20.0, 5.0, 6.0]),
        offsets=np.array([0, 3, 5]),
        ids=np.array(["a", "b"]),
        attributes={"name": np.array(["Anna", "Ben"])},
        columns={"sog": np.arange(5.0)},
    )


def same(a: Tracks, b: Tracks) -> None:
    for name in ("points", "times", "offsets", "ids"):
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype
        assert left.tobytes() == right.tobytes()
    assert (a.projection, a.notes) == (b.projection, b.notes)
    for table, other in ((a.attributes, b.attributes), (a.columns, b.columns)):
        assert list(table) == list(other)
        for name, values in table.items():
            assert values.dtype == other[name].dtype
            assert values.tobytes() == other[name].tobytes()


def test_rows_belong_to_tracks():
    tracks = two()
    assert len(tracks) == 2
    assert tracks[1].tolist() == tracks[-1].tolist() == [[10.0, 0.0], [10.0, 5.0]]
    assert tracks.times_of(0).tolist() == [0, 10, 20]
    assert [len(p) for p in tracks] == tracks.lengths.tolist() == [3, 2]
    with pytest.raises(IndexError):
        tracks[2]


def test_measures():
    tracks = two()
    assert tracks.length.tolist() == [5.0, 5.0]
    assert tracks.duration.tolist() == [20.0, 1.0]
    assert tracks.speed.tolist() == [0.25, 5.0]
    assert tracks.median_spacing == 5.0  # of 5, 0, 5
    assert tracks.median_interval == 10.0  # of 10, 10, 1
    alone = Tracks.from_arrays([[[1.0, 2.0]]])
    assert (alone.length, alone.duration, alone.speed) == (0, 0, 0)
    assert np.isnan(alone.median_spacing)
    assert np.isnan(alone.median_interval)


def test_arrays_cannot_be_written():
    tracks = two()
    for array in (tracks.points, tracks.times, tracks.offsets, tracks.ids, tracks.columns["sog"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[1]
    with pytest.raises(TypeError):
        tracks.attributes["new"] = np.zeros(2)  # type: ignore[index]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.array([[0, 0], [1, 1], [2, 2], [np.nan, 0], [0, 0]])}, r"'b' has a position .* \(point 0\)"),
        ({"times": np.array([0, 10, np.inf, 5, 6.0])}, r"'a' has a time that is not finite \(point 2\)"),
        ({"times": np.array([0, 10, 20, 5, 5.0])}, r"'b' has a time that does not follow .* \(point 1\)"),
        ({"offsets": np.array([0, 5, 5])}, "'b' has no points"),
        ({"offsets": np.array([0, 6, 5])}, "'b' has no points"),
        ({"offsets": np.array([0, 3, 4])}, "offsets must run from 0 to 5"),
        ({"ids": np.array(["a", "a"])}, "'a' is used more than once"),
        ({"ids": np.array(["a"])}, "2 tracks but 1 ids"),
        ({"points": np.zeros((5, 17))}, "d = 1 to 16"),
        ({"attributes": {"name": np.zeros(3)}}, "attribute 'name' must be"),
        ({"columns": {"sog": np.zeros(2)}}, "column 'sog' must be"),
        ({"attributes": {"name": np.array(["x", None])}}, "Python objects"),
    ],
)
def test_broken_tracks_are_refused_by_name(change, message):
    tracks = two()
    good = {name: getattr(tracks, name) for name in ("points", "times", "offsets", "ids")}
    with pytest.raises(ValueError, match=message):
        Tracks(**{**good, **change})


def test_select_takes_all_that_belongs_to_a_track():
    tracks = two().select([1, 0])
    assert tracks.ids.tolist() == ["b", "a"]
    assert tracks.attributes["name"].tolist() == ["Ben", "Anna"]
    assert tracks.columns["sog"].tolist() == [3, 4, 0, 1, 2]
    same(tracks.select([1, 0]), two())
    assert two().select(np.array([False, True])).ids.tolist() == ["b"]
    assert len(two().select([])) == 0
    with pytest.raises(ValueError, match="more than once"):
        two().select([0, 0])


rows = st.lists(
    st.tuples(st.sampled_from("abc"), st.integers(0, 50), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    min_size=1,
    max_size=40,
    unique_by=lambda row: row[:2],
)


@given(rows, st.randoms(use_true_random=False))
def test_a_table_in_any_order_gives_the_same_tracks(table, random):
    def build(table):
        agent, time, x, y = zip(*table, strict=True)
        return Tracks.from_columns(agent=agent, time=time, x=x, y=y, columns={"again": x})

    tracks = build(table)
    assert tracks.ids.tolist() == sorted({row[0] for row in table})
    assert len(tracks.points) == len(table)
    assert (tracks.columns["again"] == tracks.points[:, 0]).all()
    shuffled = list(table)
    random.shuffle(shuffled)
    same(build(shuffled), tracks)


def test_repeated_rows_are_counted():
    tracks = Tracks.from_columns(
        agent=[7, 7, 7, 8],
        time=np.array(["2020-12-01T00:00:01", "2020-12-01", "2020-12-01T00:00:01", "2020-12-01"], "datetime64[s]"),
        lon=[179.9, 179.8, 0.0, -179.9],
        lat=[1.0, 1.0, 0.0, 1.0],
        attributes={"name": ["late", "early", "later", "eight"]},
    )
    assert tracks.lengths.tolist() == [2, 1]
    assert tracks.attributes["name"].tolist() == ["early", "eight"]
    assert tracks.attributes["agent"].tolist() == tracks.ids.tolist() == ["7", "8"]
    assert "1 rows repeat" in tracks.notes[0]
    assert tracks.lonlat(0) == pytest.approx(np.array([[179.8, 1.0], [179.9, 1.0]]), abs=1e-9)
    assert tracks.times[0] == 1606780800.0


def test_columns_that_make_no_tracks_are_refused():
    with pytest.raises(ValueError, match="either x"):
        Tracks.from_columns(agent=["a"], time=[0.0])
    with pytest.raises(ValueError, match="either x"):
        Tracks.from_columns(agent=["a"], time=[0.0], lon=[0.0])
    with pytest.raises(ValueError, match="1 rows"):
        Tracks.from_columns(agent=["a"], time=[0.0], x=[0.0, 1.0])
    with pytest.raises(ValueError, match="planar"):
        two().lonlat(0)


def test_concat_is_the_inverse_of_select():
    tracks = two()
    same(Tracks.concat([tracks.select([0]), tracks.select([1])]), tracks)


def test_concat_fills_what_a_part_lacks_and_refuses_other_planes():
    other = Tracks.from_arrays([[[0.0, 0.0]]], ids=["c"])
    both = Tracks.concat([two(), other])
    assert both.attributes["name"].tolist() == ["Anna", "Ben", ""]
    assert both.columns["sog"][:5].tolist() == [0, 1, 2, 3, 4]
    assert np.isnan(both.columns["sog"][5])
    with pytest.raises(ValueError, match="different planes"):
        Tracks.concat([two(), Tracks.from_arrays([[[0.0, 0.0]]], ids=["c"], projection=Projection(0, 0))])
    with pytest.raises(ValueError, match="more than once"):
        Tracks.concat([two(), two()])
    with pytest.raises(ValueError, match="nothing"):
        Tracks.concat([])


names = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)


@settings(max_examples=20)
@given(st.lists(names.map(lambda s: s + "."), min_size=1, max_size=5, unique=True), st.integers(1, 3), names)
def test_saved_tracks_load_bit_for_bit(tmp_path_factory, ids, dim, note):
    rng = np.random.default_rng(len(ids))
    tracks = Tracks(
        points=rng.normal(size=(3 * len(ids), dim)),
        times=np.tile([0.0, 0.1, 0.3], len(ids)),
        offsets=np.arange(0, 3 * len(ids) + 1, 3),
        ids=np.array(ids),
        projection=Projection(1.25, -7.0),
        attributes={"Ship / type": np.array(ids), "imo": np.arange(len(ids))},
        columns={"sog": np.where(rng.random(3 * len(ids)) < 0.5, np.nan, 1.0)},
        notes=(note,),
    )
    place = tmp_path_factory.mktemp("store") / "tracks"
    tracks.save(place)
    loaded = Tracks.load(place)
    same(loaded, tracks)
    base = loaded.points
    while isinstance(base, np.ndarray) and not isinstance(base, np.memmap):
        base = base.base
    assert isinstance(base, np.memmap)


def test_a_directory_that_does_not_describe_tracks_is_refused(tmp_path):
    from wakefold.base import store

    store.save(tmp_path / "bad", {"points": np.zeros((1, 2))}, {"projection": None}, kind="tracks")
    with pytest.raises(StoreError, match="describe tracks"):
        Tracks.load(tmp_path / "bad")
    with pytest.raises(StoreError):
        Tracks.load(tmp_path / "none")


def test_a_notebook_shows_tracks_without_letting_their_names_in():
    html = Tracks.from_arrays([[[0.0, 0.0], [1.0, 1.0]]], ids=["<script>"])._repr_html_()
    assert "<svg" in html
    assert "&lt;script&gt;" in html
    assert "<script>" not in html
    many = Tracks.from_arrays(np.random.default_rng(0).normal(size=(2000, 50, 2)))
    assert len(many._repr_html_()) < 200_000
    for track in ([[1.0, 2.0]], [1.0, 3.0], [[0.0, 0, 0], [0.0, 0, 1]]):
        assert "nan" not in Tracks.from_arrays([track])._repr_html_()
    assert "0 tracks" in many.select([])._repr_html_()


def test_tracks_can_be_copied_and_sent_to_other_processes():
    tracks = Tracks.from_arrays([np.zeros((2, 2)), np.ones((3, 2))], ids=["a", "b"])
    for again in (copy.deepcopy(tracks), pickle.loads(pickle.dumps(tracks))):  # noqa: S301 -- to worker processes
        assert again.ids.tolist() == ["a", "b"]
        assert (again.points == tracks.points).all()
        assert dict(again.attributes).keys() == dict(tracks.attributes).keys()
        with pytest.raises(ValueError, match="read-only"):
            again.points[0] = 1.0
