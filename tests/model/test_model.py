"""Models and beliefs on disk: bit for bit, and refused when damaged."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import wakefold as wf
from wakefold.base import store
from wakefold.base.store import StoreError
from wakefold.model.dynamics import Dynamics
from wakefold.model.filtration import Filtration


@pytest.fixture(scope="module")
def model():
    from wakefold.tracks.projection import Projection

    rng = np.random.default_rng(0)
    tracks = [np.cumsum(rng.normal(10, 5, size=(int(rng.integers(2, 30)), 2)), axis=0) for _ in range(20)]
    plain = wf.Tracks.from_arrays(tracks, ids=[f"ship {i}" for i in range(20)], projection=Projection(11.0, 57.0))
    return wf.learn(plain, linkage="single")


def test_a_model_comes_back_bit_for_bit_and_filters_alike(model, tmp_path):
    model.save(tmp_path / "model")
    again = wf.load(tmp_path / "model")
    for name in ("points", "times", "offsets", "ids"):
        assert np.array_equal(getattr(again.tracks, name), getattr(model.tracks, name))
    for name in ("order", "gaps", "lo", "hi", "birth", "death", "parent"):
        assert np.array_equal(getattr(again.filtration, name), getattr(model.filtration, name))
    for name in ("epsilon", "diagonal", "interval", "noise", "scale"):
        assert getattr(again.dynamics, name) == getattr(model.dynamics, name)
    assert again.tracks.projection == model.tracks.projection
    assert again.sd == model.sd
    beliefs = []
    for m in (model, again):
        f = wf.MHPF(m, 30, levels="all", seed=1)
        beliefs.append(f.step(f.start(), [wf.Fix(m.tracks[3][1], sd=20.0)], dt=1.5))
    assert np.array_equal(beliefs[0].points, beliefs[1].points)
    assert np.array_equal(beliefs[0].log_weights, beliefs[1].log_weights)


def test_damaged_models_are_refused(model, tmp_path):
    place = tmp_path / "model"
    model.save(place)
    for file in sorted(place.iterdir()):
        content = file.read_bytes()
        for damaged in (
            content[:-2],
            content[: len(content) // 2],
            b"",
            content[:-9] + bytes([content[-9] ^ 1]) + content[-8:],
        ):
            file.write_bytes(damaged)
            with pytest.raises(StoreError):
                wf.load(place)
        file.unlink()
        with pytest.raises(StoreError):
            wf.load(place)
        file.write_bytes(content)
    wf.load(place)
    manifest = json.loads((place / "manifest.json").read_text())
    manifest["meta"]["dynamics"]["epsilon"] *= 2
    (place / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(StoreError, match="edited"):
        wf.load(place)
    with pytest.raises(StoreError, match="not a stored model"):
        wf.load(tmp_path / "nowhere")
    model.filtration.save(tmp_path / "tree")
    with pytest.raises(StoreError, match="holds a filtration, not a model"):
        wf.load(tmp_path / "tree")


def test_a_model_remembers_how_its_tracks_were_shaped(model, tmp_path):

    assert model.shaping == {}
    shaping = {"max_gap": 1800.0, "max_speed": None, "spacing": 50.5}
    replace(model, shaping=shaping).save(tmp_path / "model")
    assert wf.load(tmp_path / "model").shaping == shaping
    arrays, meta = store.load(tmp_path / "model", "model")
    del meta["shaping"]  # as older versions wrote it
    store.save(tmp_path / "older", arrays, meta, "model")
    assert wf.load(tmp_path / "older").shaping == {}
    for wrong in ({"gap": 1.0}, {"spacing": -1.0}, {"spacing": "far"}, {"max_gap": math.nan}):
        with pytest.raises(ValueError, match="shaping: "):
            replace(model, shaping=wrong)
    store.save(tmp_path / "wrong", arrays, meta | {"shaping": [1]}, "model")
    with pytest.raises(StoreError, match="not a sound model"):
        wf.load(tmp_path / "wrong")


def test_a_belief_comes_back_bit_for_bit_and_goes_on_alike(model, tmp_path):
    f = wf.MHPF(model, 30, seed=1, levels="all")
    belief = f.step(f.start(time=5.0), [wf.Fix(model.tracks[3][1], sd=20.0)], dt=1.5)
    belief.save(tmp_path / "belief")
    again = wf.Belief.load(tmp_path / "belief", model.filtration)
    for name in ("points", "classes", "log_weights", "key"):
        assert np.array_equal(getattr(again, name), getattr(belief, name))
    for name in ("step", "time", "log_evidence", "recoveries", "ignored"):
        assert getattr(again, name) == getattr(belief, name)
    assert np.array_equal(again.mean("stack"), belief.mean("stack"))
    one, two = (f.step(b, [wf.Fix(model.tracks[3][1], sd=20.0)], dt=1.0) for b in (belief, again))
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.stack.points, two.stack.points)
    other = wf.learn(model.tracks.select(range(5)))
    with pytest.raises(StoreError, match="another filtration"):
        wf.Belief.load(tmp_path / "belief", other.filtration)


@pytest.mark.parametrize("evidence", [None, -math.inf, -12.5])
def test_every_log_evidence_survives_the_disk(model, tmp_path, evidence):

    belief = replace(wf.BL1(model, 10).start(), log_evidence=evidence)
    belief.save(tmp_path / "belief")
    assert wf.Belief.load(tmp_path / "belief", model.filtration).log_evidence == evidence


def test_objects_show_themselves(model):
    f = wf.MHPF(model, 30, seed=1)
    belief = f.step(f.start(), [wf.Fix(model.tracks[3][1], sd=20.0)], dt=1.5)
    table = belief.level(float(np.median(model.filtration.birth[20:])))
    assert "probability" in repr(table)
    assert "<table>" in table._repr_html_()
    assert "particles" in repr(belief)
    assert "ESS" in belief._repr_html_()
    assert "20 tracks" in repr(model)
    assert "<svg" in model._repr_html_()
    assert sum(row.size for row in table) == 20
    assert set(table.members(int(table.classes[0]))) == set(model.filtration.members(int(table.classes[0])))


def test_single_points_can_be_learned_and_followed():
    points = wf.Tracks.from_arrays([np.array([[float(i), 0.0]]) for i in range(4)])
    model = wf.learn(points)
    assert model.sd == model.dynamics.epsilon / 2
    f = wf.MHPF(model, 20)
    assert np.isfinite(f.step(f.start(), [wf.Fix((1.0, 0.0))], dt=1.0).mean()).all()


def test_nothing_to_learn_from():
    with pytest.raises(ValueError, match="no tracks"):
        wf.Tracks.from_arrays([])


def test_a_belief_that_was_pickled_has_its_coarse_sets(model):
    import pickle

    f = wf.MHPF(model, 50, seed=1)
    belief = f.step(f.start(), [wf.Fix((1.0, 2.0), sd=5.0)], dt=3 * model.dynamics.interval)
    again = pickle.loads(pickle.dumps(belief))  # noqa: S301 (our own)
    assert len(pickle.dumps(again)) < 200_000  # not the model that the sets are worked out from
    assert np.array_equal(again.stack.points, belief.stack.points)
    assert np.array_equal(again.mean("stack"), belief.mean("stack"))


def test_a_track_that_is_not_there_names_those_that_are_like_it(model):
    cut = Filtration.from_distances(np.ones((3, 3)) - np.eye(3), ["ferry0#0", "ferry0#1", "tug"])
    with pytest.raises(ValueError, match=r"no track has the id 'ferry0'; did you mean 'ferry0#0' or 'ferry0#1'\?"):
        cut.class_at("ferry0", 2.0)
    with pytest.raises(ValueError, match="did you mean 'ship 7'"):
        model.filtration.track("shp 7")
    with pytest.raises(ValueError, match=r"'zeppelin'$"):
        model.filtration.track("zeppelin")


def test_a_model_keeps_its_velocities_and_one_without_them_learns_them(model, tmp_path, monkeypatch):
    model.save(tmp_path / "model")
    arrays, meta = store.load(tmp_path / "model", "model")
    assert np.array_equal(arrays["dynamics_velocities"], model.dynamics.velocities)
    older = {name: array for name, array in arrays.items() if not name.startswith("dynamics")}
    settings = {name: value for name, value in meta["dynamics"].items() if name != "interval"}
    store.save(tmp_path / "older", older, {**meta, "dynamics": settings}, "model")
    for name in ("points", "velocities", "starts", "lo", "hi"):
        for place in ("model", "older"):
            assert np.array_equal(getattr(wf.load(tmp_path / place).dynamics, name), getattr(model.dynamics, name))
    assert wf.load(tmp_path / "older").dynamics.interval == model.dynamics.interval

    v = arrays["dynamics_velocities"]
    for damaged in (v[1:], v[:, :1], np.full_like(v, np.nan), v.astype("f4"), v.astype("i8"), v.astype("U8")):
        store.save(tmp_path / "bad", {**arrays, "dynamics_velocities": damaged}, meta, "model")
        with pytest.raises(StoreError, match="velocities"):
            wf.load(tmp_path / "bad")
    for damaged in (-1.0, 0, None, "60", {}):
        bad = {**meta, "dynamics": {**meta["dynamics"], "interval": damaged}}
        store.save(tmp_path / "bad", arrays, bad, "model")
        with pytest.raises(StoreError, match="sound model"):
            wf.load(tmp_path / "bad")
    monkeypatch.setattr(Dynamics, "learn", None)
    wf.load(tmp_path / "model")


@pytest.mark.parametrize("make", [wf.BL1, wf.BL2, wf.MHPF, wf.Calibrated])
@pytest.mark.parametrize("steps", [0, 1])
def test_a_belief_stored_before_beliefs_told_whose_they_are_goes_on(model, tmp_path, make, steps):
    """Written by hand as version 0.1.0 first wrote it."""
    from wakefold.base import store
    from wakefold.filters import belief as module

    f = make(model, 70, seed=1)
    belief = f.start(time=5.0)
    for _ in range(steps):
        belief = f.step(belief, [wf.Fix((1e6, 1e6), sd=1.0)], dt=1.0)
    arrays = {name: getattr(belief, name) for name in ("points", "classes", "log_weights", "key")}
    if make is wf.MHPF and steps:
        s = belief.stack
        arrays |= {"nodes": s.nodes, "start": s.start, "copies": s.points}
        arrays |= {"copy_of": s.particle, "copied": s.copied, "factors": s.factors}
    if make is wf.Calibrated:
        arrays |= belief.gaussians._asdict()
    meta = {name: getattr(belief, name) for name in ("step", "time", "recoveries", "ignored")}
    meta |= {"log_evidence": "-inf" if steps else 0.0, "tree": module._fingerprint(model.filtration)}
    store.save(tmp_path / "belief", arrays, meta, module.KIND)
    again = wf.Belief.load(tmp_path / "belief", model.filtration)
    assert again.log_evidence == belief.log_evidence or steps
    assert math.isnan(again.log_evidence_since) if steps else again.log_evidence_since == 0.0
    one, two = (f.step(b, [wf.Fix(model.tracks[3][1], sd=20.0)], dt=1.0) for b in (belief, again))
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.log_weights, two.log_weights)
    assert np.array_equal(f.forecast(again, 2.0).points, f.forecast(belief, 2.0).points)
    again.save(tmp_path / "belief")
    assert type(wf.Belief.load(tmp_path / "belief", model.filtration)) is type(again)


def test_nothing_that_was_worked_out_is_pickled_or_copied(model):
    import copy
    import pickle

    f = wf.MHPF(model, 50, seed=1)
    belief = f.step(f.start(), [wf.Fix((1.0, 2.0), sd=5.0)], dt=3 * model.dynamics.interval)
    belief.mean("stack")
    tree = model.filtration
    assert not vars(copy.copy(tree)).keys() - tree.__dataclass_fields__.keys()
    lean = len(pickle.dumps(copy.copy(belief)))
    belief.level(0.0), tree.query(model.tracks[0], model.tracks, k=2), tree.tree_distance(0, 1)
    tree.children(tree.root), tree.track(str(tree.ids[0])), model.dynamics.velocity([[0.0, 0.0]], 0)
    assert vars(tree).keys() - tree.__dataclass_fields__.keys()
    for thing in (tree, belief, model.dynamics, model):
        for again in (pickle.loads(pickle.dumps(thing)), copy.copy(thing), copy.deepcopy(thing)):  # noqa: S301
            assert not vars(again).keys() - thing.__dataclass_fields__.keys()
    assert abs(len(pickle.dumps(belief)) - lean) < 200
    again = copy.copy(belief)
    assert np.array_equal(again.mean("stack"), belief.mean("stack"))
    assert np.array_equal(again.step, belief.step)
