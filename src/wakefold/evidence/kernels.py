"""Who names classes in the papers' experiments, and which classes are named of agents near some place."""

import math

import numpy as np

from wakefold.base.compile import kernel


@kernel
def name_classes(distances, leaves, parent, size, diagonal, out):
    """The class that scores best for the samples of each report, into ``out`` (R,).

    A sample scores a class of k tracks by -log of its mean distance to the k nearest points of the class. The named
    class is one that has k points near as many of the samples as possible, of those the one of the largest sum, of
    those the first. Neither single tracks nor the root are named.

    Args:
        distances: (R, S, K) from each sample to the points near it, rising.
        leaves: (R, S, K) class ids of the tracks of these points.
        parent: (C,) -1 for the root. size: (C,) number of tracks.
        diagonal: that distances are scaled by before they are clipped to [1e-4, 1].
    """
    reports, samples, near = distances.shape
    classes = len(parent)
    score, met = np.empty(classes), np.empty(classes, dtype=np.int64)
    total, count = np.empty(classes), np.empty(classes, dtype=np.int64)
    for r in range(reports):
        score[:] = 0.0
        met[:] = 0
        for s in range(samples):
            total[:] = 0.0
            count[:] = 0
            for j in range(near):
                c = parent[leaves[r, s, j]]
                while c >= 0:
                    if count[c] < size[c]:
                        count[c] += 1
                        total[c] += distances[r, s, j]
                        if count[c] == size[c]:
                            score[c] -= math.log(min(max(total[c] / size[c] / diagonal, 1e-4), 1.0))
                            met[c] += 1
                    c = parent[c]
        best = -1
        for c in range(classes):
            if size[c] > 1 and parent[c] >= 0:
                ahead = best < 0 or met[c] > met[best] or (met[c] == met[best] and score[c] > score[best])
                best = c if ahead else best
        out[r] = best


@kernel
def shares_near(points, covs, width2, places, hits, prior, chance, out, dims):
    """Share of the reports near each of some Gaussians that name a class, into ``out`` (n,).

    Reports weigh exp(-m / 2), m being the squared Mahalanobis distance from the Gaussian widened by ``width2``, and
    nothing beyond m = 36; ``prior`` more reports name the class at the rate ``chance``.

    Args:
        points: (n, d). covs: (n, d, d). places: (S, d) of the reports. hits: (S,) whether they name the class.
    """
    d = len(dims)
    root, gap = np.empty((d, d)), np.empty(d)
    for i in range(len(points)):
        for j in range(d):  # Cholesky factor
            for k in range(j + 1):
                total = covs[i, j, k] + (width2 if j == k else 0.0)
                for m in range(k):
                    total -= root[j, m] * root[k, m]
                root[j, k] = math.sqrt(total) if j == k else total / root[k, k]
        for j in range(d):
            root[j, j] = 1.0 / root[j, j]
        hit, near = prior * chance, prior
        for s in range(len(places)):
            apart2 = 0.0
            for j in range(d):
                total = places[s, j] - points[i, j]
                for m in range(j):
                    total -= root[j, m] * gap[m]
                gap[j] = total * root[j, j]
                apart2 += gap[j] * gap[j]
                if apart2 >= 36.0:  # it only grows
                    break
            if apart2 < 36.0:
                weight = math.exp(-0.5 * apart2)
                near += weight
                hit += weight if hits[s] else 0.0
        out[i] = hit / near
