"""The filtration: the tree of movement classes from linkage under the discrete Fréchet distance.

Put the leaves in dendrogram order and every class is a contiguous range of ranks. Two arrays then hold the whole
tree: ``order`` (rank -> track) and ``gaps`` (the height that joins neighbouring ranks); the height that joins any
two ranks i < j is ``max(gaps[i:j])``. Everything else here is derived from these two. See docs/filtration.md.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base import store
from wakefold.base.parallel import Executor, Progress
from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints
from wakefold.base.wording import near_miss
from wakefold.model.linkage import dendrogram
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.model.linkage.growth import grown_tree
from wakefold.model.linkage.search import TrackIndex, medoid
from wakefold.model.linkage.spanning import spanning_tree
from wakefold.tracks.tracks import Tracks

Linkage = Literal["single", "complete"]
KIND = "filtration"

_SMALL, _SMALL_POINTS = 2000, 1 << 16  # tracks, points of a set whose matrix takes less time than compiling the rest
_COMPLETE = 10_000  # tracks: a matrix of 0.8 GB and two of half its size


@dataclass(frozen=True, eq=False, repr=False)
class Filtration(Remembers):
    """The classes of M tracks at every resolution.

    Class ids: 0..M-1 are the single tracks, in track order; M.. are the merged classes by rising (birth, lo), so the
    root is last. Merges of bit-equal height along one branch are one class with several children, which makes the
    set of classes independent of the order of the tracks (single linkage).

    Attributes:
        order: ``(M,)`` track at each rank of the dendrogram; siblings stand in the order of their first track.
        gaps: ``(M - 1,)`` height that joins ranks i and i + 1, metres.
        ids: ``(M,)`` names of the tracks.
        linkage: "single" or "complete".
        rank: ``(M,)`` rank of each track, the inverse of ``order``.
        lo, hi: ``(C,)`` class c holds the ranks ``lo[c] <= r < hi[c]``.
        birth, death: ``(C,)`` class c is alive at b when ``birth[c] <= b < death[c]``, metres; inf for the root.
        parent: ``(C,)`` class id, -1 for the root.

    Raises:
        ValueError: ``order`` is not a permutation, or a height is negative or not finite.
    """

    order: Ints
    gaps: Floats
    ids: NDArray[np.str_]
    linkage: Linkage = "single"
    rank: Ints = field(init=False)
    lo: Ints = field(init=False)
    hi: Ints = field(init=False)
    birth: Floats = field(init=False)
    death: Floats = field(init=False)
    parent: Ints = field(init=False)

    def __post_init__(self) -> None:
        order = np.ascontiguousarray(self.order, dtype=np.int64)
        gaps = np.ascontiguousarray(self.gaps, dtype=np.float64)
        ids = np.asarray(self.ids, dtype=np.str_)
        if ids.shape != order.shape:
            raise ValueError(f"{order.size} tracks need as many ids, got {ids.shape}")
        if self.linkage not in ("single", "complete"):
            raise ValueError(f"linkage must be 'single' or 'complete', got {self.linkage!r}")
        arrays = {"order": order, "gaps": gaps, "ids": ids, **dendrogram.classes(order, gaps)}
        for name, array in arrays.items():
            view = array.view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    # Making, keeping

    @classmethod
    def fit(
        cls,
        tracks: Tracks,
        linkage: Linkage = "single",
        threads: int | None = None,
        progress: Progress | None = None,
        *,
        executor: Executor | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
    ) -> Filtration:
        """The exact filtration of the tracks under the discrete Fréchet distance.

        Args:
            tracks: at least one.
            linkage: "single" (canonical) or "complete" (ties broken by track order).
            threads: all cores by default; the result does not depend on it.
            progress: called with the share of the time estimated to have passed, 0 to 1, never falling.
            executor: where most of the work runs, such as ``wakefold.base.parallel.Ray()``; these threads by default.
                The result does not depend on it.
            checkpoint: directory that keeps what is known of the tree. A fit that was interrupted goes on from there,
                to the same result. It can be deleted afterwards.

        A small set goes by its matrix of distances; a large one by ``linkage.spanning``, which compiles more code but
        computes few of the distances and keeps none. The result is the same.

        Raises:
            ValueError: no tracks, an unknown linkage, too many tracks for complete linkage (which needs the matrix),
                an executor or a checkpoint with complete linkage, a checkpoint that is damaged or of other tracks, or
                positions so far apart that a distance overflows.
        """
        if not isinstance(tracks, Tracks):
            raise TypeError(f"learning takes Tracks, got {type(tracks).__name__}: wrap arrays by Tracks.from_arrays")
        if len(tracks) == 0:
            raise ValueError("no tracks to build a filtration from")
        if linkage not in ("single", "complete"):
            raise ValueError(f"linkage must be 'single' or 'complete', got {linkage!r}")
        if len(tracks) == 1:
            return cls(np.zeros(1, np.int64), np.empty(0), tracks.ids, linkage)
        if linkage == "complete" and len(tracks) > _COMPLETE:
            raise ValueError(
                f"complete linkage holds a matrix of distances: {_COMPLETE:,} tracks at most, not {len(tracks):,}"
            )
        beyond_matrix = executor is not None or checkpoint is not None
        if linkage == "complete" and beyond_matrix:
            raise ValueError("complete linkage runs on the threads of this machine, without a checkpoint")
        if linkage == "single" and (beyond_matrix or len(tracks) > _SMALL or len(tracks.points) > _SMALL_POINTS):
            index = TrackIndex(tracks, threads)
            tree = spanning_tree(tracks, threads, progress, executor=executor, checkpoint=checkpoint, index=index)
            fitted = cls(*dendrogram.leaf_order(*tree), tracks.ids, linkage)
            fitted._indices.append(index)  # queries and new tracks ask for it again
            return fitted
        return cls.from_distances(frechet_matrix(tracks, threads=threads, progress=progress), tracks.ids, linkage)

    def extend(
        self, tracks: Tracks, new: Tracks, threads: int | None = None, progress: Progress | None = None
    ) -> Filtration:
        """The filtration of the tracks and new ones, exactly as ``fit`` gives it for ``Tracks.concat([tracks, new])``.

        Args:
            tracks: those this filtration was built from.
            new: at least one, of other ids.
            threads, progress: as in ``fit``.

        Raises:
            ValueError: not the tracks of this filtration, an id used twice, another plane, or complete linkage, which
                new tracks can change everywhere.
        """
        self._check_tracks(tracks)
        if self.linkage != "single":
            raise ValueError("only single linkage can be extended; fit the complete linkage of all tracks again")
        if twice := [name for name in new.ids.tolist() if name in self.numbers]:
            raise ValueError(f"the id {twice[0]!r} of a new track is used already")
        if len(new) == 0:
            return self
        tree = grown_tree(self._index_of(tracks), self.order, self.gaps, new, threads, progress)
        return Filtration(*dendrogram.leaf_order(*tree), np.concatenate([tracks.ids, new.ids]))

    @classmethod
    def from_distances(cls, distances: ArrayLike, ids: ArrayLike, linkage: Linkage = "single") -> Filtration:
        """The filtration of any symmetric distances, ``(M, M)`` with zeros on the diagonal, M > 1."""
        order, gaps = dendrogram.leaf_order_of_matrix(np.asarray(distances, dtype=np.float64), linkage)
        return cls(order, gaps, np.asarray(ids, dtype=np.str_), linkage)

    def packed(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and JSON metadata that ``unpacked`` takes back."""
        return {"order": self.order, "gaps": self.gaps, "ids": self.ids}, {"linkage": self.linkage}

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> Filtration:
        """The filtration that ``packed`` took apart.

        Raises:
            StoreError: something is missing or unsound.
        """
        try:
            return cls(arrays["order"], arrays["gaps"], arrays["ids"], meta["linkage"])
        except (KeyError, ValueError, TypeError, OverflowError, AttributeError) as error:
            raise store.StoreError(f"not a sound filtration: {error}") from None

    def save(self, directory: str | os.PathLike[str]) -> None:
        """Store as a directory of arrays and a manifest (see ``wakefold.base.store``)."""
        store.save(directory, *self.packed(), KIND)

    @classmethod
    def load(cls, directory: str | os.PathLike[str]) -> Filtration:
        """Read what ``save`` wrote.

        Raises:
            StoreError: missing, damaged, edited, of another kind or version.
        """
        return cls.unpacked(*store.load(directory, KIND))

    # Classes

    def __len__(self) -> int:
        """Number of tracks, M."""
        return len(self.order)

    def same_as(self, other: Filtration) -> bool:
        """Whether the tracks, by number, and their classes are the same."""
        return np.array_equal(self.order, other.order) and np.array_equal(self.gaps, other.gaps)

    @property
    def root(self) -> int:
        """The class of all tracks."""
        return len(self.birth) - 1

    def alive(self, b: float) -> Ints:
        """Classes alive at b (metres) in the order of their ranks: the level b, a partition of the tracks."""
        dendrogram.check_level(b)
        found = np.flatnonzero((self.birth <= b) & (b < self.death))
        return found[np.argsort(self.lo[found])]

    def cuts(self, b: float) -> Ints:
        """``(K + 1,)`` cut points of level b: its k-th class in rank order holds the ranks cuts[k] .. cuts[k + 1]."""
        dendrogram.check_level(b)
        return np.concatenate([[0], np.flatnonzero(self.gaps > b) + 1, [len(self)]]).astype(np.int64)

    def class_at(self, track: int | str, b: float) -> int:
        """The class of a track (index or id) at level b."""
        return self.ancestor(self.track(track), b)

    def class_of(self, tracks: Sequence[int | str] | NDArray, level: float) -> int:
        """The class that holds all these tracks (indices or ids) at a level, metres.

        Raises:
            ValueError: no tracks, an unknown track, or tracks that lie in different classes at that level; the message
                names the level that joins them.
        """
        dendrogram.check_level(level)
        ranks = self.rank[[self.track(track) for track in tracks]]
        if not len(ranks):
            raise ValueError("no tracks named")
        joined = float(self.gaps[ranks.min() : ranks.max()].max(initial=0.0))
        if joined > level:
            raise ValueError(
                f"the tracks lie in {len(np.unique(np.searchsorted(self.cuts(level), ranks, side='right')))} classes"
                f" at level {level:g}; level {joined!r} joins them"
            )
        return self.ancestor(int(self.order[ranks[0]]), level)

    def track(self, track: int | str) -> int:
        """Index of a track given by index or by id.

        Raises:
            ValueError: there is no such track.
        """
        if isinstance(track, str):
            if track not in self.numbers:
                raise ValueError(f"no track has the id {track!r}{near_miss(track, self.numbers)}")
            return self.numbers[track]
        if not 0 <= track < len(self):
            raise ValueError(f"there is no track {track}; tracks run from 0 to {len(self) - 1}")
        return int(track)

    def ancestor(self, c: int, b: float) -> int:
        """The class alive at b that holds class c (c itself if alive).

        Raises:
            ValueError: c is born after b.
        """
        dendrogram.check_level(b)
        self._check(c)
        if self.birth[c] > b:
            raise ValueError(f"class {c} is born at {self.birth[c]:g}, after level {b:g}")
        while self.death[c] <= b:
            c = int(self.parent[c])
        return int(c)

    def ancestors(self, c: int) -> Ints:
        """The classes above c, from its parent to the root."""
        self._check(c)
        out = []
        while (c := int(self.parent[c])) >= 0:
            out.append(c)
        return np.array(out, dtype=np.int64)

    def children(self, c: int) -> Ints:
        """The classes that merge into c, in the order of their ranks; none for a single track."""
        self._check(c)
        starts, listed = self._children
        return listed[starts[c] : starts[c + 1]]

    def members(self, c: int) -> Ints:
        """Indices of the tracks of class c, in dendrogram order."""
        self._check(c)
        return self.order[self.lo[c] : self.hi[c]]

    def tree_distance(self, a: ArrayLike, b: ArrayLike) -> Floats | float:
        """Birth of the youngest common ancestor of classes a and b, 0 for a class and itself; arrays broadcast.

        Returns:
            metres; a float for two numbers, otherwise an array.
        """
        return dendrogram.tree_distance(self.lo, self.hi, self._range_maxima, a, b)

    def medoid(self, c: int, tracks: Tracks, limit: int = 1000) -> int:
        """The member of class c whose summed Fréchet distance to the others is least (first track of several).

        Args:
            tracks: those the filtration was built from.
            limit: so many members, spread evenly over the dendrogram, stand for a larger class.
        """
        self._check_tracks(tracks)
        return medoid(tracks, self.members(c), limit)

    def query(
        self, track: ArrayLike, tracks: Tracks, *, within: float | None = None, k: int | None = None
    ) -> tuple[Ints, Floats]:
        """The tracks near a track, which need not be one of them: all within so many metres, or the k nearest.

        ``tracks`` are those the filtration was built from; their boxes are kept for the next query. All else is as in
        ``wakefold.model.linkage.search.TrackIndex.query``, which serves tracks without a filtration.
        """
        self._check_tracks(tracks)
        return self._index_of(tracks).query(track, within=within, k=k)

    # A useful handful of levels

    def levels(self, number: int | None = None, *, persistence: float | None = None) -> Floats:
        """A useful handful of levels, metres, rising.

        By number (8 if nothing is said): the entropy of the class of a random track falls from log M at single
        tracks to 0 at the root; the levels are where it has fallen by equal steps, so going from one to the next
        forgets about as much each time. Single linkage adds outliers to a giant class one by one, and entropy
        hardly notices these merges. The two ends are left out. Fewer levels come back where the tree has no more.

        By persistence (metres): the fewest levels such that each class of two tracks or more (the root aside) with
        ``death - birth >= persistence`` is alive at one of them.

        A level returned is the lowest at which its partition holds.
        """
        if number is not None and persistence is not None:
            raise ValueError("give a number or a persistence, not both")
        if persistence is not None:
            merged = slice(len(self), self.root)
            return dendrogram.levels_by_persistence(self.birth[merged], self.death[merged], persistence)
        size = self.hi - self.lo
        return dendrogram.levels_by_entropy(size, self.birth, self.parent, 8 if number is None else number)

    # Other forms

    def linkage_matrix(self) -> Floats:
        """``(M - 1, 4)`` merges as scipy.cluster.hierarchy writes them; a class with k children takes k - 1 rows."""
        return dendrogram.linkage_matrix(self.lo, self.hi, self.birth, self.children)

    def newick(self) -> str:
        """The tree as one line of Newick text; a branch is as long as ``birth(parent) - birth(child)``, metres."""
        return dendrogram.newick(self.ids.tolist(), self.birth, self.parent, self.children)

    def __repr__(self) -> str:
        top = f", joined at {self.birth[self.root]:.6g}" if len(self) > 1 else ""
        counts = f"{len(self):,} tracks, {len(self.birth) - len(self):,} merged classes"
        return f"Filtration({counts}, {self.linkage} linkage{top})"

    def _repr_html_(self) -> str:
        levels = [0.0, *self.levels(), float(self.birth[self.root])]
        return f"<p>{self!r}</p>{dendrogram.html(levels, map(self.cuts, levels))}"

    # Derived tables

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Index of each track by its id."""
        return {name: index for index, name in enumerate(self.ids.tolist())}

    @cached_property
    def _children(self) -> tuple[Ints, Ints]:
        """Children of class c: ``listed[starts[c]:starts[c + 1]]``."""
        return dendrogram.children(self.lo, self.parent)

    @cached_property
    def _range_maxima(self) -> Floats:
        return dendrogram.range_maxima(self.gaps)

    @cached_property
    def _indices(self) -> list[TrackIndex]:
        """The index asked for last, if any was."""
        return []

    def _index_of(self, tracks: Tracks) -> TrackIndex:
        if not self._indices or self._indices[0].tracks is not tracks:
            self._indices[:] = [TrackIndex(tracks)]
        return self._indices[0]

    def _check_tracks(self, tracks: Tracks) -> None:
        if len(tracks) != len(self) or not np.array_equal(tracks.ids, self.ids):
            raise ValueError("these are not the tracks of the filtration")

    def _check(self, c: int) -> None:
        if not 0 <= c <= self.root:
            raise ValueError(f"there is no class {c}; classes run from 0 to {self.root}")
