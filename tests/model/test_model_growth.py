"""Models that grow and forget: the tree and the velocities of learning all at once, settings that stay."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import walks

import wakefold as wf
from wakefold.model.growth import carried
from wakefold.tracks.projection import Projection

DAY = 86_400.0
MAY = 1.6e9  # seconds since 1970: a date


def named(arrays, prefix="", begin=0.0, projection=None):
    times = [begin + 10.0 * np.arange(len(track)) for track in arrays]
    return wf.Tracks.from_arrays(arrays, times, [f"{prefix}{k}" for k in range(len(arrays))], projection)


def classes_of(tree):
    """The classes by the names of their tracks, with birth and death."""
    return {
        (frozenset(tree.ids[tree.members(c)].tolist()), tree.birth[c], tree.death[c]) for c in range(len(tree.birth))
    }


@settings(max_examples=60)
@given(st.data())
def test_a_model_that_grew_is_the_one_learned_at_once(data):
    dim = data.draw(st.integers(1, 2))
    track = st.lists(st.tuples(*[st.integers(0, 4).map(float)] * dim), min_size=1, max_size=4)
    old, new = (data.draw(st.lists(track, min_size=1, max_size=size)) for size in (9, 7))
    linkage = data.draw(st.sampled_from(["single", "single", "complete"]))
    first, more = named(old), named(new, "new ")
    model = wf.learn(first, linkage=linkage)
    grown = model.extend(more)
    d = model.dynamics
    whole = wf.learn(wf.Tracks.concat([first, more]), linkage=linkage, epsilon=d.epsilon, scale=d.scale, sd=model.sd)
    assert grown.filtration.same_as(whole.filtration)
    assert classes_of(grown.filtration) == classes_of(whole.filtration)
    for name in ("points", "velocities", "starts", "lo", "hi"):
        np.testing.assert_array_equal(getattr(grown.dynamics, name), getattr(whole.dynamics, name))
    assert (grown.dynamics.epsilon, grown.dynamics.scale, grown.sd) == (d.epsilon, d.scale, model.sd)
    assert grown.dynamics.interval == d.interval
    assert grown.dynamics.diagonal == whole.dynamics.diagonal


def test_in_any_order_the_classes_are_the_same():
    arrays = walks(np.random.default_rng(0), 60, 2)
    model = wf.learn(named(arrays[:20]))
    parts = [named(arrays[20:35], "a"), named(arrays[35:], "b")]
    one = model.extend(parts[0]).extend(parts[1])
    two = model.extend(parts[1].select(np.arange(25)[::-1])).extend(parts[0])
    assert classes_of(one.filtration) == classes_of(two.filtration)
    assert len(classes_of(one.filtration)) == len(one.filtration.birth)


def test_what_grew_is_kept_on_disk_and_goes_on_growing(tmp_path):
    arrays = walks(np.random.default_rng(1), 50, 2)
    model = replace(wf.learn(named(arrays[:20])), shaping={"spacing": 3.0})
    model.save(tmp_path / "m")
    shares = []
    wf.load(tmp_path / "m").extend(named(arrays[20:30], "a"), threads=1, progress=shares.append).save(tmp_path / "m")
    again = wf.load(tmp_path / "m").extend(named(arrays[30:], "b"), threads=2)
    assert again.filtration.same_as(wf.learn(again.tracks).filtration)
    assert again.shaping == {"spacing": 3.0}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_new_tracks_lie_in_the_plane_of_the_model():
    arrays = walks(np.random.default_rng(2), 12, 2)
    here, there = Projection(11.0, 57.0), Projection(11.01, 57.02)
    first, more = named(arrays[:8], projection=here), named(arrays[8:], "new ", projection=here)
    grown, moved = wf.learn(first).extend(more), wf.learn(first).extend(more.project(there))
    np.testing.assert_allclose(moved.tracks.points, grown.tracks.points, atol=1e-3)
    assert moved.tracks.projection == here


def test_what_cannot_be_added_is_refused():
    arrays = walks(np.random.default_rng(3), 8, 2)
    model = wf.learn(named(arrays[:6]))
    assert model.extend(named(arrays[6:], "new ").select([])) is model
    with pytest.raises(ValueError, match="track id '1' is used more than once"):
        model.extend(named(arrays[6:], "").select([1]))
    with pytest.raises(
        ValueError, match="the new tracks are 2-D, with lon and lat, those of the model 2-D, with x and"
    ):
        model.extend(named(arrays[6:], "new ", projection=Projection(0.0, 0.0)))
    with pytest.raises(ValueError, match="the new tracks are 1-D"):
        model.shaped(named([track[:, :1] for track in arrays[6:]], "new "))


def test_new_tracks_are_shaped_as_those_of_the_model():
    line = np.column_stack([np.arange(0.0, 500.0, 10.0), np.zeros(50)])
    known = wf.learn(named([line, line + 3.0], begin=MAY).segment("1h").resample(spacing=25.0))
    model = replace(known, shaping={"max_gap": 60.0, "min_length": 100.0, "spacing": 25.0})
    times = MAY + DAY + 10.0 * np.arange(50.0)
    times[20:] += 300.0  # silent for 5 minutes
    times[25:] += 300.0  # a piece of 40 m
    new = wf.Tracks.from_arrays([line, line], [times, times], ["0", "other"])
    shaped = model.shaped(new)
    assert shaped.ids.tolist() == ["0#1", "0#3", "other#0", "other#2"]  # "0#0" is a track of the model
    assert shaped.median_spacing == pytest.approx(25.0, rel=0.1)
    assert shaped.attributes["agent"].tolist() == ["0", "0", "other", "other"]
    plain = new.segment(60.0).filter(min_length=100.0).resample(spacing=25.0)
    np.testing.assert_array_equal(shaped.points, plain.points)
    grown = model.extend(shaped)
    assert len(grown.tracks) == 6
    twice = grown.shaped(new)  # the same days again
    assert len(twice) == 0
    assert "4 tracks left out, of agents and times that the model has" in twice.notes[-1]


def test_a_model_that_tells_no_shaping_takes_that_of_learn():
    line = np.column_stack([np.arange(0.0, 500.0, 10.0), np.zeros(50)])
    model = wf.learn(named([line, line + 3.0]).resample(spacing=20.0))
    times = 10.0 * np.arange(50.0)
    times[30:] += 1801.0
    shaped = model.shaped(wf.Tracks.from_arrays([line], [times], ["new"]))
    assert shaped.ids.tolist() == ["new#0", "new#1"]
    assert shaped.median_spacing == pytest.approx(model.tracks.median_spacing, rel=0.1)


@pytest.mark.parametrize("linkage", ["single", "complete"])
def test_old_tracks_are_forgotten(linkage):
    arrays = walks(np.random.default_rng(4), 30, 2)
    days = [named(arrays[10 * day : 10 * day + 10], f"{day}-", MAY + day * DAY) for day in range(3)]
    model = wf.learn(wf.Tracks.concat(days), linkage=linkage)
    assert model.forget("10d") is model
    left = model.forget("36h")
    assert left.tracks.ids.tolist() == [name for day in days[1:] for name in day.ids.tolist()]
    assert left.filtration.same_as(wf.learn(left.tracks, linkage=linkage).filtration)
    assert (left.sd, left.dynamics.epsilon) == (model.sd, model.dynamics.epsilon)
    last = model.forget(0.0)
    ends = model.tracks.times[model.tracks.offsets[1:] - 1]
    assert len(last.tracks) == (ends == ends.max()).sum()
    with pytest.raises(ValueError, match="no dates"):
        wf.learn(named(arrays)).forget("90d")


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_a_class_is_found_again_in_another_tree(seed):
    rng = np.random.default_rng(seed)
    arrays = [rng.integers(0, 30, (3, 2)).astype(float) for _ in range(14)]
    every = named(arrays)
    old = wf.learn(every.select(np.sort(rng.choice(14, 9, replace=False)))).filtration
    new = wf.learn(every.select(rng.permutation(14)[:9])).filtration
    found = carried(old, new, np.arange(len(old.birth)))
    there = set(new.ids.tolist())
    members = [frozenset(new.ids[new.members(c)].tolist()) for c in range(len(new.birth))]
    for c, other in enumerate(found.tolist()):
        tracks = set(old.ids[old.members(c)].tolist()) & there
        if not tracks:
            assert other == -1
        else:
            assert members[other] == min((m for m in members if tracks <= m), key=len)
