"""Draws the map of the packages in docs/design.md from what they import: ``python docs/house.py``."""

import ast
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image

import wakefold
from wakefold import plot

SOURCE = Path(wakefold.__file__).parent
PICTURE = Path(__file__).with_name("img") / "house.png"
ROOMS = {  # package: where it stands across the picture, and what is in it; how high it stands is what it imports
    "cli": (0.35, "learn, track, relations, ...:\nparse, call, print"),
    "experiments": (0.18, "what reproduce and\ndemo run"),
    "service": (0.50, "feed → live agents\n→ answers"),
    "forecast": (0.69, "questions about held-out\ntracks, scores, rivals"),
    "filters": (0.89, "beliefs; BL1, BL2, MHPF,\nCalibrated, HMM"),
    "plot": (0.53, "pictures"),
    "evidence": (0.79, "fixes, reports of classes,\nwhat they are worth"),
    "relations": (0.11, "several objects, what they\nare to each other; events"),
    "io": (0.32, "formats, reports,\nwriters"),
    "model": (0.67, "distance → tree of classes,\ntheir dynamics"),
    "tracks": (0.5, "ragged arrays, shaping, projection"),
    "base": (0.5, "arrays on disk, executors, random numbers, units, compiling"),
}


def stands_on() -> dict[str, list[str]]:
    """For each package those it imports, but for those that these import themselves."""
    to: dict[str, set[str]] = {}
    for package in (p.parent.name for p in SOURCE.glob("*/__init__.py")):
        names = set()
        for file in (SOURCE / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.ImportFrom):
                    names |= {f"{node.module}.{alias.name}" for alias in node.names}
                elif isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
        parts = [name.split(".") for name in names if name.startswith("wakefold.")]
        to[package] = {p[1] for p in parts if (SOURCE / p[1]).is_dir()} - {package}

    def below(package: str) -> set[str]:
        return to[package].union(*(below(other) for other in to[package]))

    return {
        package: sorted(o for o in others if not any(o in below(other) for other in others))
        for package, others in to.items()
    }


def draw() -> Figure:
    on = stands_on()

    def floor(package: str) -> int:
        return 1 + max((floor(other) for other in on[package]), default=-1)

    figure = Figure(figsize=(9.5, 6.2), dpi=110, layout="constrained")
    ax = figure.subplots()
    ax.set(xlim=(0, 1), ylim=(-0.4, floor("cli") + 0.4))
    ax.axis("off")
    for package, (x, words) in ROOMS.items():
        half, y = (0.48 if floor(package) < 2 else 0.09), floor(package)
        box = FancyBboxPatch((x - half, y - 0.3), 2 * half, 0.6, boxstyle="round,pad=0,rounding_size=0.02")
        box.set(facecolor="#eef3f8", edgecolor="#4a6b8a", zorder=2)
        ax.add_patch(box)
        ax.text(x, y + 0.16, package, weight="bold", ha="center", va="center", size=10, zorder=3)
        ax.text(x, y - 0.1, words, ha="center", va="center", size=7.5, zorder=3)
        lower = sorted(on[package], key=lambda other: ROOMS[other][0])
        for k, other in enumerate(lower):
            head = x + half * (2 * (k + 1) / (len(lower) + 1) - 1)
            foot = x if floor(other) < 2 else ROOMS[other][0]  # straight down onto a wide room
            ends = (foot, floor(other) + 0.3), (head, y - 0.3)
            look = {"arrowstyle": "-|>", "color": "#4a6b8a", "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", *ends, arrowprops=look, zorder=1)
    return figure


if __name__ == "__main__":
    plot.save(draw(), PICTURE)
    with Image.open(PICTURE) as picture:
        picture.convert("RGB").quantize(32, dither=Image.Dither.NONE).save(PICTURE, optimize=True)
