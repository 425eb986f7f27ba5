"""A few moments of one agent, for a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wakefold.service.agents import Crowd
from wakefold.service.feed import Observation

if TYPE_CHECKING:
    from wakefold.filters.belief import Belief
    from wakefold.model.model import Model
    from wakefold.plot import Moment


ROWS = 6  # of the picture


class Album:
    """A handful of moments of the first agent followed, evenly over its steps however many come, for a picture."""

    def __init__(self, levels: Sequence[float]) -> None:
        self.levels = levels
        self.agent: str | None = None
        self._kept: list[tuple[Moment, int]] = []
        self._fixes: list[np.ndarray] = []
        self._steps, self._stride = 0, 1

    def add(self, seen: Observation, belief: Belief, crowd: Crowd) -> None:
        """Keep the moment if its turn has come."""
        from wakefold.plot import Moment

        self.agent = seen.agent if self.agent is None else self.agent
        if seen.agent != self.agent:
            return
        tracks = crowd.model.tracks
        if seen.fix is not None and len(self._fixes) < 10_000:
            self._fixes.append(seen.fix.on_plane(tracks.projection, tracks.dim)[:2])
        if self._steps % self._stride == 0:
            tables = {b: (t.classes, t.probability) for b in self.levels for t in [belief.level(b)]}
            self._kept.append((Moment(seen.time, tables, estimate=belief.mean()[:2]), len(self._fixes)))
            if len(self._kept) > 2 * ROWS:
                self._kept, self._stride = self._kept[::2], 2 * self._stride
        self._steps += 1

    def moments(self) -> list[Moment]:
        """At most ``ROWS``, the first and the last among them."""
        fixes = np.reshape(self._fixes, (-1, 2))
        rows = np.unique(np.linspace(0, len(self._kept) - 1, ROWS).round().astype(int)) if self._kept else []
        return [self._kept[r][0]._replace(observed=fixes[: self._kept[r][1]]) for r in rows]


def draw(album: Album, model: Model, path: Path) -> None:
    """The picture of the moments collected.

    Raises:
        ValueError: there are none.
    """
    from wakefold import plot

    plot.save(plot.beliefs(model.tracks, model.filtration, album.moments()), path)
