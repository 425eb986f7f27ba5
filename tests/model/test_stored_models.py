"""Whatever a manifest says of a model, it is one or it is refused in one sentence."""

import json

import numpy as np
import pytest

import wakefold as wf
from wakefold.base import store
from wakefold.base.store import StoreError

WRONG = [None, "x", [], {}, True, -1, 0, 1e308, -1e308, 10**30, 10**400, ["x"], {"a": 1}]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    lon = np.concatenate([10 + np.arange(5) / 1e3, 10 + np.arange(5) / 1e3])
    lat = np.repeat([55.0, 55.001], 5)
    time = 1.7e9 + np.tile(60.0 * np.arange(5), 2)
    tracks = wf.Tracks.from_columns(agent=["a"] * 5 + ["b"] * 5, time=time, lon=lon, lat=lat)
    path = tmp_path_factory.mktemp("stored") / "model"
    wf.learn(tracks).save(path)
    return path


def leaves(value, path=()):
    yield path
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, (*path, key))


def put(manifest, path, value):
    inner = manifest["meta"]
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: repr(wrong)[:20])
def test_wrong_values_anywhere_in_the_metadata(place, wrong):
    path = place / store.MANIFEST
    before = path.read_text()
    refused = 0
    try:
        for leaf in [leaf for leaf in leaves(json.loads(before)["meta"]) if leaf]:
            manifest = json.loads(before)
            put(manifest, leaf, wrong)
            manifest["sha256"] = store._digest(manifest)
            path.write_text(json.dumps(manifest))
            try:
                repr(wf.load(place))
            except StoreError:
                refused += 1
    finally:
        path.write_text(before)
    assert refused > 3
    wf.load(place)


def test_a_text_for_the_centre_of_the_projection(place):
    path = place / store.MANIFEST
    before = path.read_text()
    manifest = json.loads(before)
    manifest["meta"]["tracks"]["projection"]["lon"] = "+proj=merc"
    manifest["sha256"] = store._digest(manifest)
    path.write_text(json.dumps(manifest))
    with pytest.raises(StoreError, match="the lon of a projection's centre must be degrees"):
        wf.load(place)
    path.write_text(before)
