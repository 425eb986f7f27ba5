"""Feeds of observations, line by line, and the lines that answer them."""

import csv
import io
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import wakefold as wf
from wakefold.io import ReadError
from wakefold.service import answers, observed
from wakefold.service import feed as obs


def feed(text: str | bytes, columns: dict[str, str] | None = None) -> list[obs.Observation | obs.Refused]:
    raw = text.encode() if isinstance(text, str) else text
    return [seen for block in obs.read(obs.blocks_of(io.BytesIO(raw)), columns) for seen in block]


@pytest.fixture(scope="module")
def tree() -> wf.Filtration:
    tracks = wf.Tracks.from_arrays([[[0.0, y], [10.0, y]] for y in (0.0, 1.0, 50.0)], ids=["a", "b", "c"])
    return wf.Filtration.fit(tracks)


def test_csv_and_json_lines_say_the_same() -> None:
    (first, second) = feed(
        "agent,time,lon,lat,sd\nferry,2020-12-08T06:00:00Z,-74.02,40.61,20\ntug,1607407200,-74,40.6,\n"
    )
    (again, more) = feed(
        '{"agent":"ferry","time":"2020-12-08T06:00:00Z","lon":-74.02,"lat":40.61,"sd":20}\n'
        '{"agent":"tug","time":1607407200,"lon":-74,"lat":40.6}\n'
    )
    for one, other in ((first, again), (second, more)):
        assert isinstance(one, obs.Observation)
        assert isinstance(other, obs.Observation)
        assert one.fix is not None
        assert other.fix is not None
        assert (one.agent, one.time) == (other.agent, other.time)
        assert (one.fix.lonlat, one.fix.sd) == (other.fix.lonlat, other.fix.sd)
    assert isinstance(first, obs.Observation)
    assert (first.line, first.agent, first.time, first.stamp) == (2, "ferry", 1607407200.0, "2020-12-08T06:00:00Z")


def test_planar_fixes_other_names_and_other_delimiters() -> None:
    (seen,) = feed("\ufeffwho;t;px;py\n7;12.5;1.5;-2\n", {"agent": "who", "x": "px", "y": "py"})
    assert isinstance(seen, obs.Observation)
    assert seen.fix is not None
    assert seen.fix.position is not None
    assert (seen.agent, seen.time, seen.fix.position.tolist()) == ("7", 12.5, [1.5, -2.0])


def test_a_line_without_position_and_class_is_a_time_at_which_nothing_was_seen() -> None:
    (seen,) = feed("agent,time,x,y\na,1,,\n")
    assert isinstance(seen, obs.Observation)
    assert seen.fix is None
    assert seen.class_ is None


def test_classes_by_number_and_by_track(tree: wf.Filtration) -> None:
    seen = feed("agent,time,class,level,confidence\na,1,3,1.5,0.8\na,2,track:c,1.5,\na,3,3,,\n")
    items = [one.coarse(tree)[0] for one in seen if isinstance(one, obs.Observation)]
    assert items == [wf.CoarseClass(3, 1.5, 0.8), wf.CoarseClass(2, 1.5), wf.CoarseClass(3)]


@pytest.mark.parametrize(
    ("cells", "problem"),
    [("99,1.5", "classes 0 to"), ("3,50", "holds its tracks"), ("track:x,1", "'x'"), ("track:a,", "needs a level")],
)
def test_classes_that_are_none(tree: wf.Filtration, cells: str, problem: str) -> None:
    (seen,) = feed(f"agent,time,class,level\na,1,{cells}\n")
    assert isinstance(seen, obs.Observation)
    with pytest.raises(ValueError, match=f"^class: .*{problem}"):
        seen.coarse(tree)


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("a,,1,2,5,", "time"),
        ("a,yesterday,1,2,5,", "time"),
        ("a,1e300,1,2,5,", "time: '1e300' lies outside"),
        ("a,1e999,1,2,5,", "time"),
        ("a,1607407200000,1,2,5,", "time: '1607407200000' lies outside"),
        (",1,1,2,5,", "agent"),
        ("a,1,1,91,5,", "lat"),
        ("a,1,500,2,5,", "lon"),
        ("a,1,nan,2,5,", "lon"),
        ("a,1,,2,5,", "lon"),
        ("a,1,1,2,-5,", "sd"),
        ("a,1,1,2,x,", "sd"),
        ("a,1,,,5,north", "class"),
        ("a,1,1,2", "line"),
        ('a,1,"1,2,5,', "line"),
        ("a" * 201 + ",1,1,2,5,", "agent"),
        ("a" * (1 << 17) + ",1,1,2,5,", "line"),
    ],
)
def test_a_bad_line_is_refused_by_number_and_field_and_the_rest_goes_on(line: str, field: str) -> None:
    refused, good = feed(f"agent,time,lon,lat,sd,class\n{line}\n\nb,1,1,2,5,\n")
    assert isinstance(refused, obs.Refused)
    assert refused.line == 2
    assert field in refused.why
    assert len(refused.why) < 300
    assert isinstance(good, obs.Observation)
    assert (good.line, good.agent) == (4, "b")


@pytest.mark.parametrize("text", ["[1]", '{"agent": 1', "[" * 5000, '{"agent":{},"time":1}', '{"agent":true,"time":1}'])
def test_bad_json_lines_are_refused(text: str) -> None:
    good = '{"agent":"b","time":1,"x":1,"y":2}'
    first, refused, last = feed("\n".join([good, text, good]))
    assert isinstance(refused, obs.Refused)
    assert isinstance(first, obs.Observation)
    assert isinstance(last, obs.Observation)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ('"agent":"\\ud800x"', r"agent: '\ud800x' is not text"),
        ('"lon":500,"lat":2', "lon: must be degrees within"),
        ('"lon":5', "lat: missing"),
        ('"y":5', "x: missing"),
        ('"x":1e300,"y":1', "x: 1e+300 is out of range"),
        ('"x":"1e400","y":1', "x: '1e400' is out of range"),
        ('"x":"east","y":1', "x: 'east' is not a number"),
        ('"x":1,"y":1,"sd":-2', "sd: must be a positive number"),
        ('"class":1,"level":-1', "level: must not be below 0"),
        ('"class":1,"confidence":0', "confidence: must be above 0"),
        ('"class":"track:' + "a" * 300 + '"', "class: longer than"),
    ],
)
def test_a_refusal_begins_with_the_field_that_is_wrong(line: str, why: str) -> None:
    (refused,) = feed('{"agent":"a","time":1,' + line + "}")
    assert isinstance(refused, obs.Refused)
    assert refused.why.startswith(why)


def test_a_refusal_repeats_little_of_a_long_value() -> None:
    (refused,) = feed("agent,time,x,y\na," + "9" * 5000 + "x,1,2\n")
    assert isinstance(refused, obs.Refused)
    assert refused.why.startswith("time: '999")
    assert len(refused.why) < 130


def test_columns_that_are_not_there_are_an_error() -> None:
    with pytest.raises(ReadError, match=r"no column 'px' \(for x\)"):
        feed("agent,time,x,y\na,1,2,3\n", {"x": "px"})


def test_a_header_that_does_not_say_who_and_when_is_an_error() -> None:
    with pytest.raises(ReadError, match="agent and time"):
        feed("speed,lon,lat\n1,2,3\n")
    assert feed("") == []
    assert feed("\n\n") == []


def test_which_first_lines_begin_a_feed() -> None:
    assert obs.is_feed(b"agent,time,x,y")
    assert obs.is_feed(b"mmsi,timestamp,lon,lat")
    assert obs.is_feed(b"agent,time,class,level")
    assert obs.is_feed(b'{"agent": 1, "time": 2}')
    assert not obs.is_feed(b'{"type": "FeatureCollection", "features": []}')
    assert not obs.is_feed(b"*T*,uuid,terrestrial,2")
    assert not obs.is_feed(b"")


def test_points_of_tracks_in_the_order_of_time() -> None:
    tracks = wf.Tracks.from_arrays([[[0.0, 0], [1, 0]], [[5.0, 5], [6, 5]]], [[0.0, 10], [5.0, 15]], ids=["p", "q"])
    (block,) = observed.of_tracks(tracks)
    seen = [o for o in block if isinstance(o, obs.Observation)]
    assert [(o.agent, o.time) for o in seen] == [("p", 0.0), ("q", 5.0), ("p", 10.0), ("q", 15.0)]


def test_many_points_of_tracks_come_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observed, "POINTS", 3)
    tracks = wf.Tracks.from_arrays([[[float(k)] for k in range(7)]])
    blocks = list(observed.of_tracks(tracks))
    assert [len(block) for block in blocks] == [3, 3, 1]
    assert [seen.line for block in blocks for seen in block] == list(range(1, 8))


@given(st.binary(max_size=400))
def test_no_bytes_make_it_fail(raw: bytes) -> None:
    out = feed(b"agent,time,lon,lat,class\n" + raw)
    for one in out:
        assert isinstance(one, obs.Refused) or math.isfinite(one.time)
    assert len(out) <= raw.count(b"\n") + 1


def answer(names: tuple[str, ...] = ("lon", "lat")) -> answers.Answer:
    place = answers.Place(names, (-74.0123456789, 40.6), 12.3456)
    best = [answers.Best(500.0, 17, 0.75, 4), answers.Best(2000.0, 30, 1.0, 9)]
    return answers.Answer('fer,"ry', "2020-12-08T06:00Z", "step", place, 88.88, 1, best, [(300.0, place)])


def test_levels_that_agree_in_six_digits_have_names_of_their_own() -> None:
    (names,) = csv.reader([answers.csv_header(("x",), (1000.0001, 1000.0002, 2000.0), (300.0, 300.00001))])
    assert len(set(names)) == len(names)
    assert {"class@1000.0001", "class@1000.0002", "class@2000", "x+300s", "x+300.00001s"} <= set(names)


def test_geodetic_tracks_without_dates_keep_their_own_clock() -> None:
    lon, lat = [1.0, 1.1], [2.0, 2.0]
    for begin, stamp in ((0.0, 0.0), (1.6e9, "2020-09-13T12:26:40.000Z")):
        tracks = wf.Tracks.from_columns(agent=["a", "a"], time=[begin, begin + 1], lon=lon, lat=lat)
        first = next(observed.of_tracks(tracks))[0]
        assert isinstance(first, obs.Observation)
        assert first.stamp == stamp


def test_answers_in_csv_have_the_header_s_columns_and_in_json_the_same_values() -> None:
    text = answers.csv_header(("lon", "lat"), (500.0, 2000.0), (300.0,)) + answers.csv_line(answer())
    (row,) = csv.DictReader(io.StringIO(text))
    assert row["agent"] == 'fer,"ry'
    assert float(row["lon"]) == -74.012346
    assert (row["class@500"], row["probability@500"], row["tracks@2000"]) == ("17", "0.750000", "9")
    assert float(row["sd+300s"]) == 12.35
    said = json.loads(answers.json_line(answer()))
    assert said["estimate"] == {"lon": -74.012346, "lat": 40.6, "sd": 12.35}
    assert said["levels"][1] == {"level": 2000.0, "class": 30, "probability": 1.0, "tracks": 9}
    assert said["forecast"][0]["seconds"] == 300.0


class Dripping(io.BytesIO):
    """A stream of which a few bytes are there at a time."""

    def __init__(self, raw: bytes, sizes: list[int]) -> None:
        super().__init__(raw)
        self.sizes = sizes

    def read1(self, size: int | None = -1, /) -> bytes:
        return super().read(self.sizes.pop() if self.sizes else size)


@given(st.lists(st.binary(max_size=40), max_size=12), st.lists(st.integers(1, 60), max_size=20))
def test_lines_do_not_depend_on_how_they_come(lines: list[bytes], sizes: list[int]) -> None:
    raw = b"\n".join(lines)
    found = [pair for block in obs.blocks_of(Dripping(raw, sizes)) for pair in block]
    assert found == [(n, line.removesuffix(b"\n")) for n, line in enumerate(io.BytesIO(raw), 1)]


def test_lines_that_are_there_come_without_waiting_and_long_ones_take_little_room() -> None:
    raw = b"a\nb\nc" + b"x" * (3 * obs.LONGEST_LINE) + b"\nd"
    blocks = list(obs.blocks_of(Dripping(raw, [50_000] * 3 + [5])))
    assert blocks[0] == [(1, b"a"), (2, b"b")]
    (number, long), *rest = [pair for block in blocks[1:] for pair in block]
    assert (number, len(long)) == (3, obs.LONGEST_LINE + 1)
    assert rest == [(4, b"d")]


CELLS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\r"), max_size=12)
NUMBERS = st.floats(-1e6, 1e6)
PLACES = st.builds(answers.Place, st.just(("lon", "lat")), st.tuples(NUMBERS, NUMBERS), st.floats(0, 1e9))
PLACES |= st.builds(answers.Place, st.just(("x",)), st.tuples(NUMBERS), st.floats(0, 1e9))
BEST = st.builds(answers.Best, NUMBERS, st.integers(0, 10**6), st.floats(0, 1), st.integers(1, 10**6))
ANSWERS = st.builds(
    answers.Answer,
    CELLS,
    CELLS | NUMBERS | st.integers(0, 10**12),
    st.sampled_from(["start", "off-map"]),
    PLACES,
    st.floats(0, 1e5),
    st.integers(0, 9),
    st.lists(BEST, max_size=3),
    st.lists(st.tuples(NUMBERS, PLACES), max_size=2),
    st.none() | st.floats(0, 1),
)


@given(ANSWERS)
def test_lines_of_answers_are_what_csv_and_json_write(one: answers.Answer) -> None:
    def place(p: answers.Place) -> dict[str, float]:
        digits = 6 if "lon" in p.names else 3
        values = {name: round(value, digits) for name, value in zip(p.names, p.values, strict=True)}
        return {**values, "sd": float(f"{p.sd:.4g}")}

    cells = [one.agent, one.stamp, one.event, *place(one.place).values(), f"{one.ess:.1f}", one.recoveries]
    cells += [] if one.none is None else [f"{one.none:.4f}"]
    for b in one.levels:
        cells += [b.class_, f"{b.probability:.6f}", b.tracks]
    for _, p in one.ahead:
        cells += place(p).values()
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerow(cells)
    assert answers.csv_line(one) == out.getvalue()
    row = {"agent": one.agent, "time": one.stamp, "event": one.event, "estimate": place(one.place)}
    row |= {"ess": round(one.ess, 1), "recoveries": one.recoveries}
    row |= {} if one.none is None else {"none": round(one.none, 4)}
    row["levels"] = [
        {"level": b.level, "class": b.class_, "probability": round(b.probability, 6), "tracks": b.tracks}
        for b in one.levels
    ]
    if one.ahead:
        row["forecast"] = [{"seconds": seconds, **place(p)} for seconds, p in one.ahead]
    assert answers.json_line(one) == json.dumps(row, ensure_ascii=False) + "\n"


def test_a_course_is_no_name_of_an_agent() -> None:
    (seen,) = feed('{"class":"TPV","time":"2024-05-01T10:00:00.000Z","lat":55.1,"lon":10.2,"track":45.2}\n')
    assert isinstance(seen, obs.Refused)
    assert "45.2 is a course" in seen.why
