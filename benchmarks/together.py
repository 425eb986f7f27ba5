"""Who walks with whom, by the relational filter as it runs along: with learned constants, and with some set by hand.

``WAKEFOLD_PEDESTRIANS=.../datasets python -m benchmarks.together``, 15 minutes of CPU time. The four scenes
of docs/walking.md, each judged with constants learned on the other three; names are given, error 0.1 m. A pair's
probability is that at the last frame at which both are there. Pairs seen together for five frames and more count;
calibration is over those that were ever within 3 m. How fast evidence fades is chosen by the filter's mean F1 on the
training scenes, each judged by constants of the other two; the other fades are shown beside. Intervals are of 95 %,
from drawing pairs a thousand times (seed 0).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import process_time

import numpy as np

import wakefold as wf
from wakefold.experiments.stats import f1
from wakefold.experiments.walking import trials as walking
from wakefold.experiments.walking.pedestrians import FRAME
from wakefold.relations.learning.together import fit
from wakefold.relations.model import couple_velocity, near, same_velocity

FADES = (0.0, 0.15, 0.3, 0.5)
BY_HAND = wf.Relation(  # that of docs/relational.md
    "together",
    ("person", "person"),
    on_when=near(2.0) & same_velocity(0.5),
    rate_on=0.2,
    rate_off=0.0075,
    couples=couple_velocity(k=0.3, noise=0.15, pull=0.02),
)


def followed(known: walking.Known, relation: wf.Relation, q: float, gate: float) -> tuple[np.ndarray, float]:
    """Probability of each of a scene's pairs at its last frame, and CPU milliseconds a frame."""
    w, pairs = known.walkers, known.crowd.pairs
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=q)}, [relation])
    f = wf.RelationalFilter(model, "collapsed", gate=gate, forget=10.0)
    scene, last = f.start(), np.zeros((len(w.ids), len(w.ids)))
    start = process_time()
    frames = range(int(w.begin.min()), int(w.end.max()))
    for frame in frames:
        here = np.flatnonzero((w.begin <= frame) & (w.end > frame))
        at = w.seen[w.offsets[here] + frame - w.begin[here]]
        seen = np.isfinite(at[:, 0])
        scan = wf.Detections(at[seen], sd=0.1, ids=here[seen])
        scene = f.step(scene, scan, dt=FRAME if frame > frames[0] else 0.0)
        last[np.ix_(here, here)] = 0.0  # pairs beyond the gate
        of, there = scene.pairs[0], np.zeros(len(w.ids), dtype=bool)
        there[here] = True
        a, b = scene.ids[of.first], scene.ids[of.second]
        both = there[a] & there[b]
        last[a[both], b[both]] = last[b[both], a[both]] = of.p[both]
    return last[pairs.first, pairs.second], (process_time() - start) / len(frames) * 1e3


def learned(known: walking.Known, train: Sequence[walking.Known], fade: float) -> tuple[np.ndarray, float]:
    """The same with constants of the training scenes, and of the scene's own people."""
    constants = fit([k.crowd for k in train], [k.truth for k in train], fade=fade, online=True)
    relation = constants.relation(known.crowd, constants.settle(known.crowd))
    return followed(known, relation, q=0.15, gate=10.0)


def main(quick: bool = False) -> None:
    root = walking.data_directory()
    if root is None:
        print(f"Not run: the data is not there. {walking.WHERE} must name OpenTraj's directory of datasets.")
        return
    everybody = walking.scenes(str(root))
    print("| scene | belief | F1 | interval | expected error | Brier skill | CPU ms a frame |")
    print("|---|---|---|---|---|---|---|")
    for test in everybody[2:3] if quick else everybody:
        others = [k for k in everybody if k is not test]
        mean = {}
        for fade in FADES[1:2] if quick else FADES:
            scores = [f1(k.truth, learned(k, [o for o in others if o is not k], fade)[0] > 0.5) for k in others]
            mean[fade] = float(np.mean(scores))
        fade = max(mean, key=lambda x: mean[x])
        batch = walking.learned(others, **walking.chosen(others)[0])
        own = batch.settle(test.crowd)
        online, cost = learned(test, others, fade)
        by_hand, another = followed(test, BY_HAND, q=0.35, gate=6.0)
        rows = {
            f"filter, learned (fade {fade})": (online, cost),
            "filter, by hand": (by_hand, another),
            "whole tracks": (batch.posterior(test.crowd, own), 0.0),
            "whole tracks, without friends in common": (
                batch.over_time(test.walkers, test.crowd, own)[test.crowd.pairs.offsets[1:] - 1],
                0.0,
            ),
        }
        if not quick:
            rows |= {f"filter, fade {x}": learned(test, others, x) for x in FADES if x != fade}
        draws = np.random.default_rng(0).integers(0, len(test.truth), (walking.RESAMPLES, len(test.truth)))
        close = test.crowd.looks.closest < 3.0
        for name, (p, cost) in rows.items():
            c = walking.calibration(p[close], test.truth[close])
            low, high = np.quantile([f1(test.truth[d], p[d] > 0.5) for d in draws], [0.025, 0.975])
            shown = f"{cost:.2f}" if cost else ""
            print(
                f"| {test.scene.name} | {name} | {f1(test.truth, p > 0.5):.3f} | {low:.3f} to {high:.3f} "
                f"| {c['ece']:.3f} | {c['skill']:.2f} | {shown} |",
                flush=True,
            )
        chosen_by = ", ".join(f"{x} {score:.3f}" for x, score in mean.items())
        print(f"| {test.scene.name} | training scenes' F1 by fade: {chosen_by} | | | | | |", flush=True)


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
