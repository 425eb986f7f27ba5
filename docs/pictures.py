"""Draws the pictures of docs/concepts.md: ``python docs/pictures.py``. Seeded; the same pictures on every machine."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import wakefold as wf
from wakefold import plot

OUT = Path(__file__).with_name("img")


def junction(seed: int = 4) -> wf.Tracks:
    """Fourteen walks through a Y-junction: up the stem, then left or right, a few the other way round (metres)."""
    rng = np.random.default_rng(seed)
    left, right = np.array([[0, 0], [0, 45], [-40, 95]]), np.array([[0, 0], [0, 45], [42, 92]])
    shapes = [left] * 5 + [right] * 5 + [left[::-1]] * 2 + [np.array([[-40, 95], [0, 60], [42, 92]])] * 2
    tracks, times = [], []
    for shape in shapes:
        corners = shape + rng.normal(0, 2.5, size=(3, 2))
        share = np.linspace(0, 1, 40)
        a, b, c = corners
        curve = ((1 - share) ** 2)[:, None] * a + (2 * share * (1 - share))[:, None] * b + (share**2)[:, None] * c
        tracks.append(curve + np.cumsum(rng.normal(0, 0.15, size=(40, 2)), axis=0))
        times.append(np.arange(40) * rng.uniform(0.9, 1.2) * 2.0)
    return wf.Tracks.from_arrays(tracks, times)


def keep(figure: Figure, name: str) -> None:
    """A small PNG: 96 colours are plenty for line drawings."""
    plot.save(figure, OUT / name)
    with Image.open(OUT / name) as picture:
        picture.convert("RGB").quantize(96, dither=Image.Dither.NONE).save(OUT / name, optimize=True)


def main() -> None:
    OUT.mkdir(exist_ok=True)
    tracks = junction()
    held_out, rest = 7, [i for i in range(len(tracks)) if i != 7]
    model = wf.learn(tracks.select(rest))
    tree = model.filtration
    levels = [0.0, 5.0, 20.0, 90.0]  # single walks, bundles, ways through the junction, all that goes up
    level = levels[2]
    keep(plot.filtration(model.tracks, tree, level), "junction-filtration.png")

    f = wf.MHPF(model, particles=300, likelihood="gaussian", levels=levels, seed=1)
    walk, times = tracks[held_out], tracks.times_of(held_out)
    rng = np.random.default_rng(0)
    belief = f.start(fix=wf.Fix(walk[0], sd=6.0), time=float(times[0]))
    fixes, moments = [walk[0] + rng.normal(size=2) * 6], []
    told = tree.class_at(rest.index(6), level)
    for k in range(1, len(walk)):
        evidence: list[wf.Fix | wf.CoarseClass] = []
        if k % 3 == 0:
            fixes.append(walk[k] + rng.normal(size=2) * 6)
            evidence.append(wf.Fix(fixes[-1], sd=6.0))
        if k == 5:
            evidence.append(wf.CoarseClass(told, level=level, confidence=0.95))
        belief = f.step(belief, evidence, time=float(times[k]))
        if k in (1, 4, 5, 24):
            tables = {b: belief.level(b) for b in levels}
            answers = {b: (t.classes, t.probability) for b, t in tables.items()}
            moments.append(plot.Moment(float(times[k]), answers, belief.mean(), walk[k], np.array(fixes)))
    keep(plot.beliefs(model.tracks, tree, moments), "junction-belief.png")
    print(f"told at the third moment: class {told} at level {level:g} m")


if __name__ == "__main__":
    main()
