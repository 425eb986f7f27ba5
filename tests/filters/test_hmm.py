"""The hidden Markov model against every path of states, and against hmmlearn."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from wakefold.filters.hmm import GaussianHMM


def model(states: int, features: int, seed: int) -> GaussianHMM:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(states, features, features))
    return GaussianHMM(
        initial=rng.dirichlet(np.ones(states)),
        transition=rng.dirichlet(np.ones(states), states),
        mean=2 * rng.normal(size=(states, features)),
        cov=root @ root.transpose(0, 2, 1) + 0.3 * np.eye(features),
    )


def drawn(m: GaussianHMM, n: int, length: int, seed: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Sequences from a model, and their states."""
    rng, x, labels = np.random.default_rng(seed), [], []
    for _ in range(n):
        state = [rng.choice(len(m.initial), p=m.initial)]
        while len(state) < length:
            state.append(rng.choice(len(m.initial), p=m.transition[state[-1]]))
        noise = np.einsum("tfg,tg->tf", np.linalg.cholesky(m.cov)[state], rng.normal(size=(length, m.mean.shape[1])))
        x.append(m.mean[state] + noise)
        labels.append(np.array(state))
    return x, labels


def paths(m: GaussianHMM, x: np.ndarray) -> dict[tuple[int, ...], float]:
    """Density of every path of states together with the sequence: the definition."""
    out = {}
    for path in product(range(len(m.initial)), repeat=len(x)):
        p = m.initial[path[0]]
        for t, k in enumerate(path):
            p *= m.transition[path[t - 1], k] if t else 1.0
            p *= multivariate_normal.pdf(x[t], m.mean[k], m.cov[k]) if np.isfinite(x[t]).all() else 1.0
        out[path] = p
    return out


@pytest.mark.parametrize(("states", "features", "hidden"), [(2, 1, False), (3, 2, False), (3, 2, True), (4, 3, True)])
def test_against_every_path(states, features, hidden):
    m = model(states, features, seed=states)
    (x,), _ = drawn(m, 1, 5, seed=7)
    if hidden:
        x[[0, 3]] = np.nan
    every = paths(m, x)
    total = sum(every.values())
    assert m.log_likelihood(x) == pytest.approx(np.log(total), abs=1e-10)
    exact = np.zeros((5, states))
    for path, p in every.items():
        exact[np.arange(5), path] += p / total
    assert np.allclose(m.posterior(x), exact, atol=1e-12)
    path, log_p = m.viterbi(x)
    assert tuple(path) == max(every, key=lambda key: every[key])
    assert log_p == pytest.approx(np.log(max(every.values())), abs=1e-10)
    # One observation after the other: the belief at the end is that given the whole sequence.
    belief = m.start()
    for row in x:
        belief = m.step(belief, row)
    assert np.allclose(np.exp(belief.log_probability), exact[-1], atol=1e-12)
    assert belief.log_evidence == pytest.approx(np.log(total), abs=1e-10)


def test_the_order_of_the_states_is_a_name():
    m = model(3, 2, seed=1)
    order = [2, 0, 1]
    other = GaussianHMM(m.initial[order], m.transition[np.ix_(order, order)], m.mean[order], m.cov[order])
    (x,), _ = drawn(m, 1, 40, seed=2)
    assert other.log_likelihood(x) == pytest.approx(m.log_likelihood(x), abs=1e-9)
    assert np.allclose(other.posterior(x), m.posterior(x)[:, order], atol=1e-12)


def test_long_sequences_and_far_observations_stay_finite():
    m = model(3, 2, seed=1)
    (x,), _ = drawn(m, 1, 5000, seed=2)
    x[1000] = 300.0  # hundreds of standard deviations off: exp(-1e4) is 0
    assert np.isfinite(m.log_likelihood(x))
    assert np.allclose(m.posterior(x).sum(axis=1), 1)


def test_each_round_of_learning_explains_more():
    true = model(3, 2, seed=4)
    x, _ = drawn(true, 20, 60, seed=5)
    m = GaussianHMM.learn(x, 3, np.random.default_rng(0), rounds=1, floor=0.0)
    fits = [sum(map(m.log_likelihood, x))]
    for _ in range(15):
        m = m.improve(x, rounds=1)
        fits.append(sum(map(m.log_likelihood, x)))
    assert (np.diff(fits) > -1e-7).all()
    assert fits[-1] > fits[0] + 1


def test_what_made_the_data_is_found_again():
    true = GaussianHMM([0.5, 0.5], [[0.9, 0.1], [0.2, 0.8]], [[0.0], [4.0]], [[[1.0]], [[0.5]]])
    x, labels = drawn(true, 120, 100, seed=3)
    found = GaussianHMM.learn(x, 2, np.random.default_rng(0))
    order = np.argsort(found.mean[:, 0])
    # Standard errors at 12,000 observations are .016 or less, of transitions .0063: the bounds are 4.7 of them away.
    assert np.allclose(found.mean[order], true.mean, atol=0.1)
    assert np.allclose(found.cov[order], true.cov, atol=0.1)
    assert np.allclose(found.transition[np.ix_(order, order)], true.transition, atol=0.03)
    told = GaussianHMM.learn_labelled(x, labels, 2)
    assert np.allclose(told.mean, true.mean, atol=0.1)
    assert np.allclose(told.transition, true.transition, atol=0.03)


def test_one_seed_gives_one_model():
    x, _ = drawn(model(3, 2, seed=4), 5, 40, seed=5)
    first, again = (GaussianHMM.learn(x, 3, np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(first.mean, again.mean)
    assert np.array_equal(first.transition, again.transition)


def test_wrong_input_is_refused():
    m = model(2, 2, seed=0)
    with pytest.raises(ValueError, match="sum to 1"):
        GaussianHMM([0.5, 0.6], m.transition, m.mean, m.cov)
    with pytest.raises(ValueError, match="positive definite"):
        GaussianHMM(m.initial, m.transition, m.mean, -m.cov)
    with pytest.raises(ValueError, match=r"\(T, 2\)"):
        m.log_likelihood(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="one at least"):
        m.improve([])
    with pytest.raises(ValueError, match="fewer different"):
        GaussianHMM.learn([np.zeros((4, 1))], 2, np.random.default_rng(0))
    with pytest.raises(ValueError, match="no observation of state 1"):
        GaussianHMM.learn_labelled([np.zeros((4, 1))], [np.zeros(4)], 2)
    stuck = GaussianHMM([1.0, 0.0], np.eye(2), m.mean, m.cov)
    assert stuck.posterior(np.zeros((3, 2)))[:, 1].max() == 0


@pytest.mark.parametrize("seed", range(3))
def test_against_hmmlearn(seed):
    hmmlearn = pytest.importorskip("hmmlearn.hmm", reason="hmmlearn is not installed")
    m = model(3, 2, seed)
    x, _ = drawn(m, 4, 50, seed)
    lengths = [50] * 4
    peer = hmmlearn.GaussianHMM(
        3, "full", n_iter=8, tol=-np.inf, init_params="", covars_prior=0.0, covars_weight=1.0, implementation="log"
    )
    peer.startprob_, peer.transmat_, peer.means_, peer.covars_ = m.initial, m.transition, m.mean, m.cov
    whole = np.concatenate(x)
    assert sum(map(m.log_likelihood, x)) == pytest.approx(peer.score(whole, lengths), rel=1e-10)
    assert np.allclose(np.concatenate([m.posterior(s) for s in x]), peer.predict_proba(whole, lengths), atol=1e-8)
    assert np.array_equal(np.concatenate([m.viterbi(s)[0] for s in x]), peer.predict(whole, lengths))
    peer.fit(whole, lengths)
    ours = m.improve(x, rounds=8, gain=-np.inf)
    assert np.allclose(ours.mean, peer.means_, atol=1e-6)
    assert np.allclose(ours.cov, peer.covars_, atol=1e-6)
    assert np.allclose(ours.transition, peer.transmat_, atol=1e-6)
