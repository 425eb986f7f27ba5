"""What is learned from historical tracks: the tracks, their filtration and the dynamics of its classes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import NDArray

from wakefold.base import store
from wakefold.base.checks import real
from wakefold.base.parallel import Executor
from wakefold.base.units import Duration, seconds
from wakefold.base.wording import number_text
from wakefold.model import growth
from wakefold.model.dynamics import Dynamics, Noise
from wakefold.model.filtration import Filtration, Linkage
from wakefold.model.growth import SHAPING
from wakefold.model.memory import Memory
from wakefold.tracks.tracks import Tracks

KIND = "model"


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A learned model.

    Attributes:
        tracks: the training tracks.
        filtration: the tree of their classes.
        dynamics: the velocity field of every class.
        sd: standard deviation of a fix that does not tell its own, metres per axis.
        shaping: how the tracks were cut and resampled before they were learned: ``max_gap`` and ``stop_time`` in
            seconds, ``max_speed`` in m/s, ``stop_radius``, ``min_length`` and ``spacing`` in metres; None where one
            was not used. Empty if it is not known.

    Raises:
        ValueError: tracks and filtration of different numbers, or a number out of range.
    """

    tracks: Tracks
    filtration: Filtration
    dynamics: Dynamics
    sd: float
    shaping: Mapping[str, Any] = field(default_factory=dict)
    _memory: list[Memory] = field(default_factory=list)

    def __post_init__(self) -> None:
        if len(self.tracks) != len(self.filtration):
            raise ValueError(f"{len(self.tracks)} tracks but a filtration of {len(self.filtration)}")
        if not 0.0 < self.sd < math.inf:
            raise ValueError(f"sd must be a positive number of metres, got {self.sd}")
        for name, value in self.shaping.items():
            if name not in SHAPING:
                raise ValueError(f"shaping: {name!r} is none of {', '.join(SHAPING)}")
            if value is not None and not (isinstance(value, (int, float)) and 0.0 <= value < math.inf):
                raise ValueError(f"shaping: {name} must be a number >= 0 or None, got {value!r}")

    def __repr__(self) -> str:
        d = self.dynamics
        return (
            f"Model({len(self.tracks):,} tracks, {len(self.filtration.birth) - len(self.tracks):,} merged classes, "
            f"epsilon {number_text(d.epsilon)}, {d.noise} noise {number_text(d.scale)}, sd {number_text(self.sd)})"
        )

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(repr(self))}</p>{self.tracks._repr_html_()}{self.filtration._repr_html_()}"

    @property
    def memory(self) -> Memory:
        """Past states that ``Trail`` goes by; learned when it is first asked for, and kept with the model."""
        return self.remember()

    def remember(self, threads: int | None = None, progress: Callable[[float], None] | None = None) -> Memory:
        """Learn the memory, if the model has none yet.

        Args:
            threads, progress: as in ``learn``.
        """
        if not self._memory:
            self._memory.append(Memory.learn(self.tracks, self.filtration, threads, progress))
        return self._memory[0]

    def save(self, directory: str | os.PathLike[str]) -> None:
        """Store, with its memory, as a directory of arrays and a manifest (``wakefold.base.store``); no pickle."""
        arrays, meta = {}, {}
        parts = ("tracks", self.tracks), ("filtration", self.filtration), ("dynamics", self.dynamics)
        for name, part in (*parts, ("memory", self.memory)):
            packed, meta[name] = part.packed()
            arrays |= {f"{name}_{key}": array for key, array in packed.items()}
        store.save(directory, arrays, {**meta, "sd": self.sd, "shaping": dict(self.shaping)}, KIND)

    def shaped(self, tracks: Tracks) -> Tracks:
        """Tracks as ``read_tracks`` gives them, made ready for ``extend``.

        They are cut, filtered and resampled as the model's own were, by ``shaping``; what that does not tell is as
        ``wakefold learn`` does it by itself, with the median spacing of the model's tracks. Pieces are counted on where
        the model has pieces of the same name. A track that shares some time with one of the same agent in the model is
        left out, if times are dates: it was learned already. ``notes`` says what was left out.

        Raises:
            ValueError: planar tracks for a geodetic model, the other way round, or other coordinates.
        """
        return growth.shaped(tracks, self.tracks, self.shaping)

    def extend(
        self, tracks: Tracks, *, threads: int | None = None, progress: Callable[[float], None] | None = None
    ) -> Model:
        """The model with more tracks, which are numbered after those it has, without learning anew.

        Tree and velocities are those of learning all tracks at once, to the bit. Settings that ``learn`` takes from the
        data (epsilon, scale of the noise, interval, sd) stay those of this model, so that beliefs go on: see
        ``Belief.on``. Complete linkage, which new tracks can change everywhere, is fitted anew.

        Args:
            tracks: of other ids, cut and resampled as the model's own: see ``shaped``. Geodetic ones may lie in another
                plane.
            threads: all cores by default.
            progress: called with the share of the work done, 0 to 1.

        Raises:
            ValueError: an id that is used already, planar tracks for a geodetic model, the other way round, or other
                coordinates.
        """
        new = growth.on_plane(tracks, self.tracks)
        if not len(new):
            return self
        every = Tracks.concat([self.tracks, new])
        if self.filtration.linkage == "complete":
            return self._of(every, Filtration.fit(every, "complete", threads, progress))
        grown = self._of(every, self.filtration.extend(self.tracks, new, threads, progress))
        for memory in self._memory:
            grown._memory.append(memory.extend(every, grown.filtration, threads))
        return grown

    def forget(
        self, age: Duration, *, threads: int | None = None, progress: Callable[[float], None] | None = None
    ) -> Model:
        """The model without the tracks that end more than ``age`` before the last to end; settings stay.

        What held the others together may be gone, so the tree of the rest is fitted anew.

        Args:
            age: seconds, or such as "90d".
            threads, progress: as in ``learn``.

        Raises:
            ValueError: times that are no dates.
        """
        kept = growth.recent(self.tracks, seconds(age))
        if kept.all():
            return self
        left = self.tracks.select(kept)
        return self._of(left, Filtration.fit(left, self.filtration.linkage, threads, progress))

    def _of(self, tracks: Tracks, filtration: Filtration) -> Model:
        """This model with other tracks, which have its plane."""
        own = self.dynamics
        learned = Dynamics.learn(tracks, filtration, own.epsilon, own.noise, own.scale)
        dynamics = replace(learned, interval=own.interval)
        return replace(self, tracks=tracks, filtration=filtration, dynamics=dynamics, _memory=[])


def load(directory: str | os.PathLike[str]) -> Model:
    """Read a model that ``Model.save`` wrote; its arrays are memory maps.

    Raises:
        StoreError: missing, of another kind or version, truncated or edited.
    """
    arrays, meta = store.load(directory, KIND)

    def part(name: str) -> dict[str, NDArray[Any]]:
        return {key.removeprefix(f"{name}_"): array for key, array in arrays.items() if key.startswith(f"{name}_")}

    try:
        tracks = Tracks.unpacked(part("tracks"), meta["tracks"])
        filtration = Filtration.unpacked(part("filtration"), meta["filtration"])
        dynamics = Dynamics.unpacked(part("dynamics"), meta["dynamics"], tracks, filtration)
        memory = [Memory.unpacked(part("memory"), meta["memory"], filtration)] if "memory" in meta else []
        if memory and memory[0].dim != tracks.dim:
            raise ValueError(f"its memory is {memory[0].dim}-D, its tracks {tracks.dim}-D")
        shaping = meta.get("shaping", {})  # older models have none, and no memory
        return Model(tracks, filtration, dynamics, meta["sd"], shaping, memory)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError) as error:
        raise store.StoreError(f"{directory} is not a sound model: {error}") from None


def learn(
    tracks: Tracks,
    *,
    linkage: Linkage = "single",
    epsilon: float | None = None,
    noise: Noise = "gaussian",
    scale: float | None = None,
    sd: float | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Model:
    """Learn movement classes and their dynamics from historical tracks.

    Args:
        tracks: at least one; evenly spaced points (``Tracks.resample``) serve the Fréchet distance best.
        linkage: "single" (the papers', canonical) or "complete".
        epsilon: radius of the dynamics' ball, metres; see ``Dynamics.learn`` for the default.
        noise, scale: motion noise; see ``Dynamics``. The default scale is learned from the tracks.
        sd: of a fix that does not tell its own, metres; half the median spacing of track points by default.
        threads: of the distance kernel, all cores by default.
        progress: called with the share of the work done, 0 to 1.
        executor: where most of the comparison runs, such as ``wakefold.base.parallel.Ray()``; see ``Filtration.fit``.
        checkpoint: directory from which an interrupted comparison of the tracks goes on, see ``Filtration.fit``.

    Raises:
        ValueError: no tracks, a setting out of range, or an executor or a checkpoint that cannot serve.
    """
    filtration = Filtration.fit(tracks, linkage, threads, progress, executor=executor, checkpoint=checkpoint)
    dynamics = Dynamics.learn(tracks, filtration, epsilon=epsilon, noise=noise, scale=scale)
    if sd is None:
        spacing = tracks.median_spacing
        sd = 0.5 * (spacing if spacing > 0 else dynamics.epsilon)  # NaN when every track is a single point
    return Model(tracks, filtration, dynamics, real(sd, "sd"))
