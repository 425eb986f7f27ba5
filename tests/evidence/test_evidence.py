"""Evidence refuses what it cannot mean, and says so."""

import math

import numpy as np
import pytest

import wakefold as wf
from wakefold.evidence.coarse import alive_classes, coarse_log_g
from wakefold.evidence.evidence import in_order


@pytest.fixture(scope="module")
def model():
    rng = np.random.default_rng(0)
    tracks = [np.cumsum(rng.normal(1, 0.5, size=(6, 2)), axis=0) + 5 * (i % 3) for i in range(8)]
    tracks.append(tracks[0].copy())
    return wf.learn(wf.Tracks.from_arrays(tracks))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"position": (math.nan, 0.0)}, "finite"),
        ({"position": (math.inf, 0.0)}, "finite"),
        ({"position": ()}, "coordinates"),
        ({"position": np.zeros((2, 2))}, "coordinates"),
        ({"position": (0.0, 0.0), "lon": 1.0}, "not both"),
        ({"lon": 1.0}, "lon and lat"),
        ({}, "lon and lat"),
        ({"lon": math.nan, "lat": 0.0}, "lon"),
        ({"lon": 0.0, "lat": 91.0}, "lat"),
        ({"position": (0.0, 0.0), "sd": 0.0}, "sd"),
        ({"position": (0.0, 0.0), "sd": math.nan}, "sd"),
        ({"position": (0.0, 0.0), "sd": math.inf}, "sd"),
        ({"position": (0.0, 0.0), "sd": np.array([1.0, 2.0])}, "one for all axes"),
        ({"position": (0.0, 0.0), "sd": [1.0]}, "one for all axes"),
    ],
)
def test_a_fix_names_its_bad_field(arguments, match):
    with pytest.raises(ValueError, match=match):
        wf.Fix(**arguments)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"class_": 1.5}, "integer"),
        ({"class_": True}, "integer"),
        ({"class_": 0, "level": math.nan}, "level"),
        ({"class_": 0, "level": -1.0}, "level"),
        ({"class_": 0, "confidence": 0.0}, "confidence"),
        ({"class_": 0, "confidence": 1.1}, "confidence"),
    ],
)
def test_a_class_report_names_its_bad_field(arguments, match):
    with pytest.raises(ValueError, match=match):
        wf.CoarseClass(**arguments)


def test_a_class_not_alive_at_its_level_is_refused_with_the_one_that_is(model):
    tree = model.filtration
    for c in range(len(tree.birth)):
        for level in (tree.birth[c] * 0.5 - 1e-3, tree.death[c] if math.isfinite(tree.death[c]) else -1):
            if level < 0:
                continue
            there = [a for a in tree.alive(float(level)) if set(tree.members(c)) & set(tree.members(int(a)))]
            with pytest.raises(ValueError, match=f"there class ({'|'.join(map(str, there))}) holds"):
                wf.CoarseClass(c, level=float(level)).at_level(tree)
    assert wf.CoarseClass(tree.root).at_level(tree) == tree.birth[tree.root]
    with pytest.raises(ValueError, match="there class"):  # a duplicate is never alive alone
        wf.CoarseClass(0).at_level(tree)
    with pytest.raises(ValueError, match="classes 0 to"):
        wf.CoarseClass(10_000).at_level(tree)


def test_fixes_come_first_then_classes_by_rising_level(model):
    tree = model.filtration
    low, high = wf.CoarseClass(tree.class_at(3, 0.0), level=0.0), wf.CoarseClass(tree.root)
    fix = wf.Fix((0.0, 0.0))
    assert [item for _, item in in_order([high, low, fix], tree)] == [fix, low, high]
    with pytest.raises(TypeError, match="put \\[\\] around"):
        in_order(fix, tree)
    with pytest.raises(TypeError, match="got str"):
        in_order(["north"], tree)


def test_evidence_must_fit_the_model(model):
    f = wf.MHPF(model)
    with pytest.raises(ValueError, match="planar"):
        f.step(f.start(), [wf.Fix(lon=1.0, lat=2.0)], dt=1.0)
    with pytest.raises(ValueError, match="3 coordinates"):
        f.step(f.start(), [wf.Fix((0.0, 0.0, 0.0))], dt=1.0)


def test_a_geodetic_fix_lands_where_the_projection_says():
    from wakefold.tracks.projection import Projection

    place = Projection(-74.0, 40.7)
    tracks = wf.Tracks.from_arrays([np.array([[0.0, 0.0], [500.0, 100.0]])], projection=place)
    model = wf.learn(tracks)
    lon, lat = place.to_geodetic(np.array([[500.0, 100.0]]))[0]
    assert np.allclose(wf.Fix(lon=lon, lat=lat).on_plane(place, 2), [500.0, 100.0], atol=1e-3)
    a = wf.BL1(model).start(fix=wf.Fix(lon=lon, lat=lat, sd=10.0))
    assert np.allclose(a.points, [500.0, 100.0])


def test_fixes_projected_together_lie_where_they_lie_alone():
    from wakefold.evidence.fix import on_plane
    from wakefold.tracks.projection import Projection

    rng = np.random.default_rng(0)
    place = Projection(-74.0, 40.6)
    fixes = [wf.Fix(lon=lon, lat=lat, sd=sd) for lon, lat, sd in rng.uniform([-80, 30, 1], [-70, 50, 9], (200, 3))]
    fixes[50:50] = [None, wf.Fix((1.0, 2.0)), None]
    moved = on_plane(fixes, place, 2)
    for fix, there in zip(fixes, moved, strict=True):
        assert (fix is None) == (there is None)
        if fix is not None and there is not None:
            assert there.sd == fix.sd
            assert there.position is not None
            np.testing.assert_array_equal(there.position, fix.on_plane(place, 2))  # to the bit
    assert on_plane(fixes, None, 2) == fixes  # which say themselves why they do not fit
    assert on_plane(fixes, place, 3) == fixes
    assert on_plane([], place, 2) == []


def test_proper_coarse_likelihood_is_a_distribution_over_the_level(model):
    tree = model.filtration
    for level in np.unique(tree.birth):
        classes = tree.alive(float(level))
        item = wf.CoarseClass(int(classes[0]), level=float(level), confidence=0.7)
        g = np.exp(coarse_log_g(tree, item, float(level), classes, "gaussian", model.dynamics.diagonal))
        if len(classes) == 1:
            assert g.tolist() == [1.0]
        else:
            assert g.sum() == pytest.approx(1.0)
            assert g[0] == pytest.approx(0.7)
        every = np.array([c for c in range(len(tree.birth)) if tree.birth[c] <= level])
        found = alive_classes(tree, every, float(level))
        assert found.tolist() == [tree.ancestor(int(c), float(level)) for c in every]


@pytest.mark.parametrize("likelihood", ["log", "gaussian"])
def test_a_filter_remembers_the_likelihood_of_a_report_for_every_class(model, likelihood):
    """Of single tracks that of the class that holds them at the level of the report; and other reports are others."""
    tree, f = model.filtration, wf.BL1(model, 10, likelihood=likelihood)
    leaves, seen = np.arange(len(tree)), set()
    for level in np.unique(tree.birth)[:-1].tolist():
        alive = tree.alive(level)
        for class_ in alive.tolist():
            item = wf.CoarseClass(class_, level=level, confidence=0.7)
            for classes, above in ((leaves, alive_classes(tree, leaves, level)), (alive, alive)):
                expected = coarse_log_g(tree, item, level, above, likelihood, model.dynamics.diagonal)
                for _ in range(2):
                    assert np.array_equal(f._coarse(item, level)[classes], expected)
            seen.add(f._coarse(item, level).tobytes())
    assert len(seen) > 1
