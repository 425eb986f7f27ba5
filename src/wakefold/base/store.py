"""Arrays and a manifest on disk: a directory of ``.npy`` files and ``manifest.json``, read by memory map.

The manifest holds the format version, the kind of thing stored, free JSON metadata, and shape, dtype, size and
SHA-256 of every array, so a truncated, edited or foreign directory is refused instead of half read. Files are
untrusted: nothing is unpickled and no file outside the directory is opened.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wakefold.base import __version__

FORMAT = 1
MANIFEST = "manifest.json"
_MANIFEST_LIMIT = 16 << 20  # bytes; a manifest is a few kB, a larger one is not ours
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_KINDS = "biufU"  # numpy kinds that need no pickle and have one meaning everywhere


class StoreError(ValueError):
    """A stored directory is missing, damaged, of another kind or from another version."""


def save(directory: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], kind: str):
    """Write arrays and metadata as one directory; it appears complete or not at all.

    Args:
        directory: must not exist, or be an earlier store of the same kind, which is replaced.
        arrays: by name (lower case, digits, underscores); bool, integer, float or string dtype.
        meta: anything JSON can say (finite numbers only).
        kind: what the directory holds, checked by ``load``.

    Raises:
        StoreError: the directory holds something else.
        ValueError: a name, dtype or metadata that cannot be stored.
    """
    target = Path(directory)
    check_target(target, kind)
    target.parent.mkdir(parents=True, exist_ok=True)
    private = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    parts = private / "new"  # an ordinary directory inside the private one: a store has the permissions of any file
    try:
        parts.mkdir()
        entries = {name: _write_array(parts, name, np.asarray(array)) for name, array in arrays.items()}
        manifest = {
            "format": FORMAT,
            "kind": kind,
            "wakefold": __version__,
            "meta": dict(meta),
            "arrays": entries,
        }
        manifest["sha256"] = _digest(manifest)
        text = json.dumps(manifest, indent=1, allow_nan=False, sort_keys=True) + "\n"
        _write(parts / MANIFEST, text.encode())
        _replace(parts, target)
    finally:
        shutil.rmtree(private, ignore_errors=True)


def check_target(directory: str | os.PathLike[str], kind: str) -> None:
    """Refuse what ``save`` would: a directory that is there and is no store of this kind, which is never replaced.

    Raises:
        StoreError: the directory holds something else.
    """
    target = Path(directory)
    if target.exists() or target.is_symlink():
        _read_manifest(target, kind, any_version=True)


def load(directory: str | os.PathLike[str], kind: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays (read-only memory maps) and metadata of a directory written by ``save``.

    Raises:
        StoreError: missing, of another kind or version, truncated or edited.
    """
    root = Path(directory)
    manifest = _read_manifest(root, kind)
    arrays = {}
    for name, entry in manifest["arrays"].items():
        arrays[name] = _read_array(root, name, entry)
    return arrays, manifest["meta"]


def _write(path: Path, content: bytes) -> None:
    with open(path, "xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _write_array(directory: Path, name: str, array: np.ndarray) -> dict[str, Any]:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} cannot name a stored array")
    if array.dtype.kind not in _KINDS:
        raise ValueError(f"array {name!r} of dtype {array.dtype} cannot be stored")
    array = np.ascontiguousarray(array).reshape(array.shape)
    path = directory / f"{name}.npy"
    with open(path, "xb") as file:
        np.save(file, array, allow_pickle=False)
        file.flush()
        os.fsync(file.fileno())
    return {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "bytes": path.stat().st_size,
        "sha256": _sha256(path),
    }


def _replace(parts: Path, target: Path) -> None:
    """Rename ``parts`` to ``target``; a directory in the way is moved aside first, then deleted."""
    if not target.exists():
        parts.rename(target)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    old = aside / "old"
    try:
        target.rename(old)
        parts.rename(target)
    finally:
        if old.exists() and not target.exists():  # interrupted in between, by Ctrl-C for one
            old.rename(target)
        shutil.rmtree(aside, ignore_errors=True)


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
        if path.stat().st_size > _MANIFEST_LIMIT:
            raise StoreError(f"{path} is too large to be a manifest")
        manifest = json.loads(path.read_bytes())
    except OSError as error:
        raise StoreError(f"{root} is not a stored {kind}: cannot read {MANIFEST} ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{path} is damaged: not JSON") from None
    if not isinstance(manifest, dict) or not {"format", "kind", "meta", "arrays"} <= manifest.keys():
        raise StoreError(f"{path} is not a Wakefold manifest")
    if manifest["kind"] != kind:
        raise StoreError(f"{root} holds a {manifest['kind']!s}, not a {kind}")
    if manifest["format"] != FORMAT and not any_version:
        raise StoreError(f"{root} has store format {manifest['format']!s}; this Wakefold reads format {FORMAT}")
    if manifest.get("sha256") != _digest(manifest) and not any_version:
        raise StoreError(f"{path} has been edited (SHA-256 differs)")
    if not isinstance(manifest["meta"], dict) or not isinstance(manifest["arrays"], dict):
        raise StoreError(f"{path} is not a Wakefold manifest")
    return manifest


def _read_array(root: Path, name: str, entry: Any) -> np.ndarray:
    if not _NAME.fullmatch(name) or not isinstance(entry, dict):
        raise StoreError(f"{root / MANIFEST} is damaged: array {name!r}")
    path = root / f"{name}.npy"
    if path.is_symlink() or not path.is_file():
        raise StoreError(f"{root} is damaged: {path.name} is missing")
    if path.stat().st_size != entry.get("bytes"):
        raise StoreError(f"{root} is damaged: {path.name} has {path.stat().st_size} bytes, not {entry.get('bytes')}")
    if _sha256(path) != entry.get("sha256"):
        raise StoreError(f"{root} is damaged: {path.name} has been edited (SHA-256 differs)")
    try:
        # An empty array cannot be mapped.
        empty = 0 in entry["shape"]
        array = np.load(path, mmap_mode=None if empty else "r", allow_pickle=False)
    except (ValueError, OSError, KeyError, TypeError, EOFError) as error:
        raise StoreError(f"{root} is damaged: {path.name} is not a readable array ({error})") from None
    if array.dtype.str != entry.get("dtype") or list(array.shape) != entry["shape"] or array.dtype.kind not in _KINDS:
        raise StoreError(f"{root} is damaged: {path.name} is not the array of the manifest")
    plain = np.asarray(array)
    plain.flags.writeable = False
    return plain
