"""Arrays and a manifest on disk: a directory of ``.npy`` files and ``manifest.json``, read by memory map.

The manifest holds the format version, the kind of thing stored, free JSON metadata, and shape, dtype, size and
SHA-256 of every array, so a truncated, edited or foreign directory is refused instead of half read. Files are
untrusted: nothing is unpickled, no file outside the directory is opened, no link is followed from inside it, and
nothing is allocated before it is known to be there.

A store that is replaced stays where it is: the new arrays are written beside the old ones under names of their own, and
one rename of the manifest makes them the store. Whenever that is stopped, by whatever, either the old or the new one is
there. A reader that meets a replacement begins anew.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from wakefold.base import __version__
from wakefold.base.checks import instance

try:
    import fcntl
except ImportError:  # not on Windows: two who save one thing at once are not kept apart there
    fcntl = None

FORMAT = 1
VERSIONED = 2
"""The format whose arrays have names of their own: a store that was replaced."""
MANIFEST = "manifest.json"
_MANIFEST_LIMIT = 16 << 20  # bytes; a manifest is a few kB, a larger one is not ours
_LARGEST = 1 << 128  # of whole numbers in a manifest: random keys have 128 bits
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_FILE = re.compile(r"[a-z][a-z0-9_]{0,63}(\.[0-9a-f]{16})?\.npy|manifest\.json(\.[0-9a-f]{16})?")
_KINDS = "biufU"  # numpy kinds that need no pickle and have one meaning everywhere
_TRIES = 20  # replacements that a reader may meet one after the other


class StoreError(ValueError):
    """A stored directory is missing, damaged, of another kind or from another version."""


def save(directory: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], kind: str):
    """Write arrays and metadata as one directory; it appears complete or not at all.

    What an earlier one that was killed has left behind is taken away.

    Args:
        directory: must not exist, or be an earlier store of the same kind, which is replaced; or a link to one.
        arrays: by name (lower case, digits, underscores); bool, integer, float or string dtype.
        meta: anything JSON can say (finite numbers only).
        kind: what the directory holds, checked by ``load``.

    Raises:
        StoreError: the directory holds something else, or cannot be written.
        ValueError: a name, dtype or metadata that cannot be stored.
    """
    check_target(directory, kind)
    target = Path(directory)
    with _named(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        if not target.exists():
            private = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
            with _locked(private):
                try:
                    parts = private / "new"  # in the private one, so that a store has the permissions of any directory
                    parts.mkdir()
                    _write_store(parts, arrays, meta, kind, "")
                    _sync(parts)
                    try:
                        parts.rename(target)
                        _sync(target.parent)
                        return
                    except OSError as error:
                        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                            raise  # else another one has saved there meanwhile
                finally:
                    shutil.rmtree(private, ignore_errors=True)
            check_target(target, kind)
        with _locked(target):
            _tidy(target)
            try:
                _write_store(target, arrays, meta, kind, f".{os.urandom(8).hex()}")
                _sync(target)
            finally:
                _tidy(target)


def _write_store(directory: Path, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], kind: str, mark: str):
    """Write arrays, then by one rename the manifest; with a ``mark`` in the names of files beside an older store."""
    entries = {name: _write_array(directory, name, np.asarray(array), mark) for name, array in arrays.items()}
    form = VERSIONED if mark else FORMAT
    manifest = {"format": form, "kind": kind, "wakefold": __version__, "meta": dict(meta), "arrays": entries}
    manifest["sha256"] = _digest(manifest)
    text = json.dumps(manifest, indent=1, allow_nan=False, sort_keys=True) + "\n"
    fresh = directory / f"{MANIFEST}{mark or '.0000000000000000'}"
    _write(fresh, text.encode())
    os.replace(fresh, directory / MANIFEST)


def _path(directory: Any) -> Path:
    return Path(instance(directory, (str, os.PathLike), "a directory is a path"))


def check_target(directory: str | os.PathLike[str], kind: str) -> None:
    """Refuse what ``save`` would: a directory that is there and is no store of this kind, or holds files that are not.

    Raises:
        StoreError: the directory holds something else.
    """
    target = _path(directory)
    with _named(target):
        there = target.exists() or target.is_symlink()
    if there:
        _read_manifest(target, kind, any_version=True)
        with _named(target):
            foreign = sorted(entry.name for entry in os.scandir(target) if not _ours(entry))
        if foreign:
            raise StoreError(f"{target} holds what is no part of a stored {kind}, and is not replaced: {foreign[0]!r}")


def _ours(entry: os.DirEntry[str]) -> bool:
    return bool(_FILE.fullmatch(entry.name)) and entry.is_file(follow_symlinks=False)


def _tidy(target: Path) -> None:
    """Remove files of a store that its manifest does not name: those of an older one, or of a save that was killed."""
    manifest = json.loads((target / MANIFEST).read_bytes())
    named = {MANIFEST, *(entry.get("file", f"{name}.npy") for name, entry in manifest["arrays"].items())}
    for entry in list(os.scandir(target)):
        if entry.name not in named and _ours(entry):
            (target / entry.name).unlink(missing_ok=True)


def _sweep(target: Path) -> None:
    """Remove what a first save of this name that was killed has left beside it."""
    mine = re.compile(re.escape(f".{target.name}.") + r"[a-z0-9_]{8}")
    for entry in list(os.scandir(target.parent)):
        if not mine.fullmatch(entry.name) or not entry.is_dir(follow_symlinks=False):
            continue
        left = target.parent / entry.name
        with _locked(left, wait=False) as free:
            if free and {child.name for child in os.scandir(left)} <= {"new", "old"}:
                shutil.rmtree(left, ignore_errors=True)


@contextmanager
def _locked(folder: Path, wait: bool = True) -> Iterator[bool]:
    """Keep others who save out of a directory, where the system can; whether it was free."""
    if fcntl is None:
        yield True
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno == errno.EWOULDBLOCK:
                yield False
                return
        yield True
    finally:
        os.close(handle)


@contextmanager
def _named(target: Path) -> Iterator[None]:
    """Errors of the system as ours, with the name that the user gave."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"{target} cannot be written: {error.strerror or error}") from error


def load(directory: str | os.PathLike[str], kind: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays (read-only memory maps) and metadata of a directory written by ``save``.

    Raises:
        StoreError: missing, of another kind or version, truncated or edited.
    """
    root = _path(directory)
    for _ in range(_TRIES):
        manifest = _read_manifest(root, kind)
        try:
            arrays = {name: _read_array(root, name, entry) for name, entry in manifest["arrays"].items()}
        except StoreError:
            if _read_manifest(root, kind)["sha256"] == manifest["sha256"]:
                raise
        else:
            return arrays, manifest["meta"]
    raise StoreError(f"{root} is replaced again and again while it is read")


def _write(path: Path, content: bytes) -> None:
    with open(path, "xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _write_array(directory: Path, name: str, array: np.ndarray, mark: str) -> dict[str, Any]:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} cannot name a stored array")
    if array.dtype.kind not in _KINDS:
        raise ValueError(f"array {name!r} of dtype {array.dtype} cannot be stored")
    array = np.ascontiguousarray(array).reshape(array.shape)
    path = directory / f"{name}{mark}.npy"
    with open(path, "xb") as file:
        np.save(file, array, allow_pickle=False)
        file.flush()
        os.fsync(file.fileno())
    entry = {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "bytes": path.stat().st_size,
        "sha256": _sha256(path),
    }
    return entry | ({"file": path.name} if mark else {})


def _sync(folder: Path) -> None:
    """Have the names in a directory on the disk, where the system can."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)


def _digest(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of a manifest without its own digest."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read_manifest(root: Path, kind: str, any_version: bool = False) -> dict[str, Any]:
    path = root / MANIFEST
    try:
        with _opened(path) as file:
            raw = file.read(_MANIFEST_LIMIT + 1)
        if len(raw) > _MANIFEST_LIMIT:
            raise StoreError(f"{path} is too large to be a manifest")
        manifest = json.loads(raw)
    except OSError as error:
        raise StoreError(f"{root} is not a stored {kind}: cannot read {MANIFEST} ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{path} is damaged: not JSON") from None
    if not isinstance(manifest, dict) or not {"format", "kind", "meta", "arrays"} <= manifest.keys():
        raise StoreError(f"{path} is not a Wakefold manifest")
    if manifest["kind"] != kind:
        raise StoreError(f"{root} holds a {str(manifest['kind'])[:80]}, not a {kind}")
    if manifest["format"] not in (FORMAT, VERSIONED) and not any_version:
        form = str(manifest["format"])[:80]
        raise StoreError(f"{root} has store format {form}; this Wakefold reads formats {FORMAT} and {VERSIONED}")
    if manifest.get("sha256") != _digest(manifest) and not any_version:
        raise StoreError(f"{path} has been edited (SHA-256 differs)")
    if not isinstance(manifest["meta"], dict) or not isinstance(manifest["arrays"], dict):
        raise StoreError(f"{path} is not a Wakefold manifest")
    if any(not isinstance(entry, dict) for entry in manifest["arrays"].values()):
        raise StoreError(f"{path} is damaged: an array that is none")
    if not _sizes_are_sane(manifest):
        raise StoreError(f"{path} is damaged: a number of over 128 bits")
    return manifest


def _sizes_are_sane(value: Any) -> bool:
    """Whether no whole number anywhere in a manifest is larger than any of ours."""
    stack = [value]
    while stack:
        one = stack.pop()
        if isinstance(one, int) and abs(one) >= _LARGEST:
            return False
        if isinstance(one, (dict, list)):
            stack += one.values() if isinstance(one, dict) else one
    return True


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A file to read that is one: no link, device or pipe, at which reading might never end.

    Raises:
        OSError: it cannot be opened, or is none.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    with open(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        yield file


def _read_array(root: Path, name: str, entry: dict[str, Any]) -> np.ndarray:
    file_name = entry.get("file", f"{name}.npy")
    if not _NAME.fullmatch(name) or not isinstance(file_name, str) or not _FILE.fullmatch(file_name):
        raise StoreError(f"{root / MANIFEST} is damaged: array {name[:80]!r}")
    path = root / file_name
    try:
        with _opened(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size != entry.get("bytes"):
                raise StoreError(f"{root} is damaged: {path.name} has {size} bytes, not {entry.get('bytes')}")
            if hashlib.file_digest(file, "sha256").hexdigest() != entry.get("sha256"):
                raise StoreError(f"{root} is damaged: {path.name} has been edited (SHA-256 differs)")
            return _mapped(file, size, entry, f"{root} is damaged: {path.name}")
    except OSError as error:
        why = "is missing" if error.errno in (errno.ENOENT, errno.ELOOP) else f"cannot be read ({error.strerror})"
        raise StoreError(f"{root} is damaged: {path.name} {why}") from None


def _mapped(file: Any, size: int, entry: dict[str, Any], which: str) -> np.ndarray:
    """The array in a file, mapped; nothing is allocated that is not there.

    Raises:
        StoreError: it is none, or not that of the manifest.
    """
    file.seek(0)
    try:
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[npy.read_magic(file)]
        shape, columnwise, dtype = read(file)
        wanted = entry["shape"]
    except (ValueError, KeyError, TypeError, EOFError, SyntaxError) as error:
        raise StoreError(f"{which} is not a readable array ({error})") from None
    if dtype.hasobject:
        raise StoreError(f"{which} is not a readable array (it holds Python objects)")
    if dtype.str != entry.get("dtype") or list(shape) != wanted or dtype.kind not in _KINDS:
        raise StoreError(f"{which} is not the array of the manifest")
    count = 1
    for length in shape:
        count *= length
    if columnwise or min(shape, default=0) < 0 or file.tell() + count * dtype.itemsize != size:
        raise StoreError(f"{which} is not a readable array ({size} bytes do not hold it)")
    if count * dtype.itemsize == 0:  # what is empty cannot be mapped
        plain = np.empty(shape, dtype=dtype)
    else:
        plain = np.asarray(np.memmap(file, dtype=dtype, mode="r", offset=file.tell(), shape=shape))
    plain.flags.writeable = False
    return plain
