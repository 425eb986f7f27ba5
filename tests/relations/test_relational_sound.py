"""Whatever is seen, probabilities are probabilities: random scenes, names given or not, sensors of any sort."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_relational import ENGINES

import wakefold as wf
from wakefold.relations.model import ahead, closing, couple_velocity, follow_velocity, near, same_velocity, slow
from wakefold.relations.scene import ParticleScene

PREDICATES = [
    None,
    near(2.0),
    near(2.0) & same_velocity(0.5),
    ~slow(0.3) & near(2.0),
    near(1.0) | slow(0.2),
    ahead(3.0, 1.0),
    closing(0.2),
    ~(near(1.0) | (closing(0.1) & ~same_velocity(0.2))),
]
chances = st.floats(0.0, 1.0)
rates = st.sampled_from([0.0, 1e-3, 0.3, 5.0])


@st.composite
def models(draw):
    ties = [None, couple_velocity(0.5, 0.1), couple_velocity(0.3, 0.1, 0.05)]
    symmetric = draw(st.booleans())
    relation = wf.Relation(
        "tied",
        ("person", "person"),
        draw(st.sampled_from(PREDICATES)),
        rate_on=draw(rates),
        rate_off=draw(rates),
        prior=draw(st.sampled_from([0.0, 0.3, 1.0])),
        couples=draw(st.sampled_from(ties if symmetric else [*ties, follow_velocity(1.0, 0.2)])),
        symmetric=symmetric,
        seen_within=draw(st.sampled_from([0.0, 2.0])),
    )
    other = wf.Relation("other", ("person", "person"), near(1.0), rate_on=0.5, rate_off=0.5)
    walk = wf.Activity("walk", ["apart", "tied"], min_time=1.0)
    return wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=0.5)}, [relation, other], [walk])


@st.composite
def scans(draw, named):
    ids = draw(st.lists(st.integers(0, 3), unique=True, max_size=4))
    at = [[draw(st.floats(-3, 3)), draw(st.floats(-1, 1))] for _ in ids]
    sensor = {"detect_prob": draw(st.sampled_from([0.0, 0.01, 0.5, 1.0])) if draw(st.booleans()) else draw(chances)}
    sensor["birth"] = draw(st.sampled_from([0.0, 1e-3]))
    sensor["clutter"] = draw(st.sampled_from([0.0, 1e-2]))
    sd = draw(st.sampled_from([1e-3, 0.1, 1.0]))
    return wf.Detections(at, sd=sd, ids=ids if named else None, **sensor), draw(st.sampled_from([0.0, 0.1, 0.4, 3.0]))


@pytest.mark.parametrize("engine", ENGINES)
@settings(max_examples=40, deadline=None)
@given(model=models(), data=st.data(), named=st.booleans(), seed=st.integers(0, 5))
def test_probabilities_are_probabilities(engine, model, data, named, seed):
    f = wf.RelationalFilter(model, engine, particles=20, gate=5.0, seed=seed)
    scene = f.start()
    for _ in range(data.draw(st.integers(1, 6))):
        scan, dt = data.draw(scans(named))
        scene = f.step(scene, scan if data.draw(st.booleans()) or not len(scan) else [scan], dt=dt)
        values = [scene.existence, *(p.p for p in scene.pairs), *(s for p in scene.pairs for s in p.stages)]
        for x in values:
            assert np.isfinite(x).all()
            assert ((x >= 0.0) & (x <= 1.0)).all()
        for p in scene.pairs:
            for stages in p.stages:
                np.testing.assert_allclose(stages.sum(axis=1), 1.0)
            np.testing.assert_allclose([s[:, 1:-1].sum(axis=1) for s in p.stages], [p.p] * len(p.stages), atol=1e-6)
        assert np.isfinite(scene.mean).all()
        assert (scene.cov[:, [0, 2]] >= 0.0).all()
        table = scene.relations("other")
        for a, b, p in zip(table.first.tolist(), table.second.tolist(), table.probability, strict=True):
            assert p == scene.probability("other", a, b) == scene.probability("other", b, a)
        if isinstance(scene, ParticleScene) and len(scene):
            np.testing.assert_allclose(np.exp(scene.particles.log_weights).sum(axis=0), 1.0)
