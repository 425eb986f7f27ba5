"""Hidden Markov models in the log domain; Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77 (1989).

log_b (T, K) is what each state makes of each observation, log_a (K, K) of the transitions, log_pi (K,) of the start.
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.filters.kernels.particles import log_sum

LEAST = 1e-250  # a sum of shares above it has lost nothing to underflow, as each of them is lost only below 1e-300


@kernel
def whiten(cov, out):
    """Inverses of the lower Cholesky factors of covariances (K, F, F) into ``out``, which is 0; false: none."""
    states, features = cov.shape[:2]
    lower = np.empty((features, features))
    for k in range(states):
        for f in range(features):
            for g in range(f + 1):
                total = cov[k, f, g]
                for m in range(g):
                    total -= lower[f, m] * lower[g, m]
                if f == g and not total > 0.0:
                    return False
                lower[f, g] = math.sqrt(total) if f == g else total / lower[g, g]
        for g in range(features):  # a column of the inverse
            out[k, g, g] = 1.0 / lower[g, g]
            for f in range(g + 1, features):
                total = 0.0
                for m in range(g, f):
                    total -= lower[f, m] * out[k, m, g]
                out[k, f, g] = total / lower[f, f]
    return True


@kernel
def log_emission(x, mean, whiten, out):
    """Log density of each observation x (T, F) in each state into out (T, K); 0 where it says nothing (NaN).

    mean (K, F), whiten (K, F, F) inverses of the Cholesky factors of the covariances.
    """
    states, features = mean.shape
    constant, off = np.empty(states), np.empty(features)
    for k in range(states):
        constant[k] = -0.5 * features * math.log(2.0 * math.pi)
        for f in range(features):
            constant[k] += math.log(whiten[k, f, f])
    for t in range(len(x)):
        seen = True
        for f in range(features):
            seen = seen and math.isfinite(x[t, f])
        for k in range(states):
            square = 0.0
            for f in range(features):
                off[f] = x[t, f] - mean[k, f]
                total = 0.0
                for g in range(f + 1):
                    total += whiten[k, f, g] * off[g]
                square += total * total
            out[t, k] = constant[k] - 0.5 * square if seen else 0.0


@kernel
def moments(x, member, mean, cov):
    """Mean (K, F) and covariance (K, F, F) of each state, given its share member (T, K) in each observation x (T, F).

    Those of a state without any observation stay as they are.
    """
    states, features = mean.shape
    for k in range(states):
        mass = 0.0
        for t in range(len(x)):
            mass += member[t, k]
        if mass <= 1e-9:
            continue
        for f in range(features):
            total = 0.0
            for t in range(len(x)):
                total += member[t, k] * x[t, f]
            mean[k, f] = total / mass
        for f in range(features):
            for g in range(f + 1):
                total = 0.0
                for t in range(len(x)):
                    total += member[t, k] * (x[t, f] - mean[k, f]) * (x[t, g] - mean[k, g])
                cov[k, f, g] = cov[k, g, f] = total / mass


@inner
def _shares(log_p, out):
    """exp(log_p) over the largest of them, into ``out``; returns the largest."""
    peak = -np.inf
    for i in range(len(log_p)):
        peak = max(peak, log_p[i])
    for i in range(len(log_p)):
        out[i] = math.exp(log_p[i] - peak) if peak > -np.inf else 0.0
    return peak


@inner
def _through(log_p, log_a, a, share, terms, out):
    """log of the sums over i of exp(log_p[i] + log_a[i, j]), into ``out`` (K,); ``a`` is exp(log_a).

    By K exponentials instead of K * K, those of ``_shares``; where a sum is so small that underflow could matter, by
    all of them. Returns what ``_shares`` does.
    """
    peak = _shares(log_p, share)
    for j in range(len(out)):
        total = 0.0
        for i in range(len(log_p)):
            total += share[i] * a[i, j]
        if total > LEAST:
            out[j] = peak + math.log(total)
        else:
            for i in range(len(log_p)):
                terms[i] = log_p[i] + log_a[i, j]
            out[j] = log_sum(terms)
    return peak


@inner
def _forward(log_b, log_a, a, log_pi, alpha, share, peak):
    """``forward``; the shares of the states of each alpha and the largest, all but the last, go to share and peak."""
    count, states = log_b.shape
    terms = np.empty(states)
    for j in range(states):
        alpha[0, j] = log_pi[j] + log_b[0, j]
    for t in range(1, count):
        peak[t - 1] = _through(alpha[t - 1], log_a, a, share[t - 1], terms, alpha[t])
        for j in range(states):
            alpha[t, j] += log_b[t, j]
    return log_sum(alpha[count - 1])


@inner
def _backward(log_b, log_a, a, beta, share, peak):
    """``backward``; the shares of log_b + beta of the next moment and the largest go to share and peak."""
    count, states = log_b.shape
    terms, ahead = np.empty(states), np.empty(states)
    for i in range(states):
        beta[count - 1, i] = 0.0
    for t in range(count - 2, -1, -1):
        for j in range(states):
            ahead[j] = log_b[t + 1, j] + beta[t + 1, j]
        peak[t] = _through(ahead, log_a.T, a.T, share[t], terms, beta[t])


@kernel
def forward(log_b, log_a, log_pi, alpha):
    """Equations 19 and 20: log p(observations so far, state now) into alpha (T, K). Returns log p(all of them)."""
    return _forward(log_b, log_a, np.exp(log_a), log_pi, alpha, np.empty_like(log_b), np.empty(len(log_b)))


@kernel
def backward(log_b, log_a, beta):
    """Equations 24 and 25: log p(observations to come given the state now) into beta (T, K)."""
    _backward(log_b, log_a, np.exp(log_a), beta, np.empty_like(log_b), np.empty(len(log_b)))


@kernel
def viterbi(log_b, log_a, log_pi, path):
    """Equations 32 to 35: the likeliest states into path (T,); of equal ones the first. Returns their log p."""
    count, states = log_b.shape
    best = log_pi + log_b[0]
    came = np.empty((count, states), dtype=np.int64)
    for t in range(1, count):
        ahead = np.empty(states)
        for j in range(states):
            came[t, j] = 0
            top = best[0] + log_a[0, j]
            for i in range(1, states):
                if best[i] + log_a[i, j] > top:
                    top = best[i] + log_a[i, j]
                    came[t, j] = i
            ahead[j] = top + log_b[t, j]
        best = ahead
    path[count - 1] = 0
    for j in range(1, states):
        if best[j] > best[path[count - 1]]:
            path[count - 1] = j
    for t in range(count - 1, 0, -1):
        path[t - 1] = came[t, path[t]]
    return best[path[count - 1]]


@kernel
def expectations(log_b, offsets, log_a, log_pi, gamma, starts, moves, totals):
    """The E-step over sequences, rows offsets[n] to offsets[n + 1] of log_b: equations 27 and 37.

    Fills gamma (P, K) with the probability of each state at each moment and totals (N,) with the log-likelihood of each
    sequence; adds to starts (K,) and moves (K, K). A sequence that no path explains adds nothing: its gamma is 0.
    """
    states = len(log_pi)
    a = np.exp(log_a)
    for n in range(len(offsets) - 1):
        lo, hi = offsets[n], offsets[n + 1]
        b = log_b[lo:hi]
        alpha, beta, here, there = np.empty_like(b), np.empty_like(b), np.empty_like(b), np.empty_like(b)
        past, future = np.empty(hi - lo), np.empty(hi - lo)
        total = _forward(b, log_a, a, log_pi, alpha, here, past)
        totals[n] = total
        if total == -np.inf:
            gamma[lo:hi] = 0.0
            continue
        _backward(b, log_a, a, beta, there, future)
        for t in range(hi - lo):
            for j in range(states):
                gamma[lo + t, j] = math.exp(alpha[t, j] + beta[t, j] - total)
        for j in range(states):
            starts[j] += gamma[lo, j]
        for t in range(1, hi - lo):
            scale = past[t - 1] + future[t - 1] - total
            if scale < 500.0:  # as in ``_through``: what underflow takes is less than 1e-80
                weight = math.exp(scale)
                for i in range(states):
                    for j in range(states):
                        moves[i, j] += weight * here[t - 1, i] * a[i, j] * there[t - 1, j]
            else:
                for i in range(states):
                    for j in range(states):
                        ahead = b[t, j] + beta[t, j]
                        moves[i, j] += math.exp(alpha[t - 1, i] + log_a[i, j] + ahead - total)
