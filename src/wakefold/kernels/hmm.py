"""Hidden Markov models in the log domain; Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77 (1989).

log_b (T, K) is what each state makes of each observation, log_a (K, K) of the transitions, log_pi (K,) of the start.
"""

import numpy as np

from wakefold.kernels.compile import kernel
from wakefold.kernels.particles import log_sum


@kernel
def forward(log_b, log_a, log_pi, alpha):
    """Equations 19 and 20: log p(observations so far, state now) into alpha (T, K). Returns log p(all of them)."""
    count, states = log_b.shape
    terms = np.empty(states)
    for j in range(states):
        alpha[0, j] = log_pi[j] + log_b[0, j]
    for t in range(1, count):
        for j in range(states):
            for i in range(states):
                terms[i] = alpha[t - 1, i] + log_a[i, j]
            alpha[t, j] = log_sum(terms) + log_b[t, j]
    return log_sum(alpha[count - 1])


@kernel
def backward(log_b, log_a, beta):
    """Equations 24 and 25: log p(observations to come given the state now) into beta (T, K)."""
    count, states = log_b.shape
    terms = np.empty(states)
    beta[count - 1] = 0.0
    for t in range(count - 2, -1, -1):
        for i in range(states):
            for j in range(states):
                terms[j] = log_a[i, j] + log_b[t + 1, j] + beta[t + 1, j]
            beta[t, i] = log_sum(terms)


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
    for n in range(len(offsets) - 1):
        lo, hi = offsets[n], offsets[n + 1]
        b = log_b[lo:hi]
        alpha, beta = np.empty_like(b), np.empty_like(b)
        total = forward(b, log_a, log_pi, alpha)
        totals[n] = total
        if total == -np.inf:
            gamma[lo:hi] = 0.0
            continue
        backward(b, log_a, beta)
        for t in range(hi - lo):
            for j in range(b.shape[1]):
                gamma[lo + t, j] = np.exp(alpha[t, j] + beta[t, j] - total)
        starts += gamma[lo]
        for t in range(1, hi - lo):
            for i in range(b.shape[1]):
                for j in range(b.shape[1]):
                    moves[i, j] += np.exp(alpha[t - 1, i] + log_a[i, j] + b[t, j] + beta[t, j] - total)
