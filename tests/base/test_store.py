"""Stored directories: back bit for bit, and anything else refused."""

import hashlib
import json
import os

import numpy as np
import pytest

from wakefold.base import store
from wakefold.base.store import StoreError

ARRAYS = {
    "heights": np.array([0.1, -0.0, np.nan, np.inf, 5e-324]),
    "table": np.arange(12, dtype=np.int32).reshape(3, 4)[:, ::2],
    "names": np.array(["Fähre", "a'b", ""]),
    "mask": np.array([True, False]),
    "nothing": np.empty((0, 3), dtype=np.float32),
    "number": np.array(7, dtype=np.uint8),
}


@pytest.fixture
def stored(tmp_path):
    store.save(tmp_path / "thing", ARRAYS, {"linkage": "single", "nested": [1, None, {"a": 0.1}]}, "thing")
    return tmp_path / "thing"


def test_round_trip_bit_for_bit(stored):
    arrays, meta = store.load(stored, "thing")
    assert meta == {"linkage": "single", "nested": [1, None, {"a": 0.1}]}
    assert arrays.keys() == ARRAYS.keys()
    for name, array in arrays.items():
        assert array.dtype == ARRAYS[name].dtype
        assert array.shape == ARRAYS[name].shape
        assert array.tobytes() == ARRAYS[name].tobytes()
        assert not array.flags.writeable


def test_saving_again_replaces_and_leaves_no_debris(stored):
    store.save(stored, {"one": np.ones(1)}, {}, "thing")
    arrays, meta = store.load(stored, "thing")
    assert list(arrays) == ["one"]
    assert meta == {}
    assert [path.name for path in stored.parent.iterdir()] == ["thing"]


def test_what_is_not_ours_is_not_overwritten(tmp_path, stored):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").write_text("...")
    with pytest.raises(StoreError, match="not a stored thing"):
        store.save(precious, ARRAYS, {}, "thing")
    assert (precious / "thesis.tex").exists()
    with pytest.raises(StoreError, match="holds a thing, not a model"):
        store.save(stored, ARRAYS, {}, "model")
    store.load(stored, "thing")


def test_a_failed_save_leaves_the_old_one(stored):
    for arrays, meta in [({"bad": np.array([object()])}, {}), ({"../up": np.ones(1)}, {}), ({}, {"x": float("nan")})]:
        with pytest.raises(ValueError):  # noqa: PT011
            store.save(stored, arrays, meta, "thing")
    assert store.load(stored, "thing")[0].keys() == ARRAYS.keys()
    assert [path.name for path in stored.parent.iterdir()] == ["thing"]


def truncate(path):
    path.write_bytes(path.read_bytes()[:-8])


def flip_last_byte(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "message"),
    [(truncate, "bytes, not"), (flip_last_byte, "has been edited"), (lambda path: path.unlink(), "is missing")],
)
def test_a_damaged_array_is_refused(stored, damage, message):
    damage(stored / "heights.npy")
    with pytest.raises(StoreError, match=message):
        store.load(stored, "thing")


def edit(stored, change):
    manifest = json.loads((stored / store.MANIFEST).read_text())
    change(manifest)
    manifest["sha256"] = store._digest(manifest)
    (stored / store.MANIFEST).write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(format=99), "store format 99"),
        (lambda m: m.update(kind="model"), "holds a model, not a thing"),
        (lambda m: m.pop("arrays"), "not a Wakefold manifest"),
        (lambda m: m.update(arrays=[]), "not a Wakefold manifest"),
        (lambda m: m["arrays"].update({"../../etc/passwd": {}}), "damaged"),
        (lambda m: m["arrays"]["heights"].update(dtype="<f4"), "not the array of the manifest"),
        (lambda m: m["arrays"]["heights"].update(shape=[2]), "not the array of the manifest"),
        (lambda m: m["arrays"]["heights"].pop("shape"), "not a readable array"),
        (lambda m: m["arrays"].update(heights=None), "damaged"),
    ],
)
def test_an_unsound_manifest_is_refused(stored, change, message):
    edit(stored, change)
    with pytest.raises(StoreError, match=message):
        store.load(stored, "thing")


def test_a_manifest_edited_by_hand_is_refused(stored):
    path = stored / store.MANIFEST
    path.write_text(path.read_text().replace("single", "complete"))
    with pytest.raises(StoreError, match="has been edited"):
        store.load(stored, "thing")


def test_what_is_no_store_is_refused(tmp_path, stored):
    with pytest.raises(StoreError, match="cannot read"):
        store.load(tmp_path / "nowhere", "thing")
    (stored / store.MANIFEST).write_bytes(b"\x93NUMPY")
    with pytest.raises(StoreError, match="not JSON"):
        store.load(stored, "thing")
    (stored / store.MANIFEST).write_text("[" * 100_000)
    with pytest.raises(StoreError, match="not JSON"):
        store.load(stored, "thing")


def test_nothing_is_unpickled(tmp_path, stored):
    """An object array under a correct hash is still refused."""
    path = stored / "heights.npy"
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    edit(
        stored,
        lambda m: m["arrays"]["heights"].update(
            bytes=path.stat().st_size, sha256=store._sha256(path), dtype="|O", shape=[1]
        ),
    )
    with pytest.raises(StoreError, match="not a readable array"):
        store.load(stored, "thing")


def test_a_link_to_a_store_stays_a_link(tmp_path, stored):
    (tmp_path / "latest").symlink_to(stored)
    store.save(tmp_path / "latest", {"x": np.arange(4)}, {}, "thing")
    assert (tmp_path / "latest").is_symlink()
    assert store.load(stored, "thing")[0]["x"].tolist() == [0, 1, 2, 3]


def test_a_store_with_files_of_others_is_not_replaced(stored):
    for name in ("notes.txt", "heights.npy.bak", "sub"):
        path = stored / name
        path.mkdir() if name == "sub" else path.write_text("mine")
        with pytest.raises(StoreError, match=f"holds what is no part of a stored thing, and is not replaced: {name!r}"):
            store.save(stored, {"x": np.arange(4)}, {}, "thing")
        assert path.exists()
        path.rmdir() if name == "sub" else path.unlink()
    store.load(stored, "thing")


def test_devices_and_links_in_the_place_of_files_are_refused(tmp_path, stored):
    manifest = (stored / store.MANIFEST).read_bytes()
    for name in (store.MANIFEST, "heights.npy"):
        path = stored / name
        content = path.read_bytes()
        path.unlink()
        for link in ("/dev/zero", "/dev/stdin", tmp_path / "copy"):
            (tmp_path / "copy").write_bytes(content)
            path.symlink_to(link)
            with pytest.raises(StoreError):
                store.load(stored, "thing")
            path.unlink()
        os.mkfifo(path)
        with pytest.raises(StoreError, match="regular file"):
            store.load(stored, "thing")
        path.unlink()
        path.write_bytes(content)
    assert (stored / store.MANIFEST).read_bytes() == manifest
    store.load(stored, "thing")


def test_sizes_that_are_claimed_are_not_allocated(stored):
    """An array of 1e12 rows, in the manifest and in the file's own header, and numbers of 400 digits."""
    shapes = {"heights": [10**12], "nothing": [0, 10**12], "table": [10**6, 10**6], "mask": [10**400]}
    for name, shape in shapes.items():
        before = (stored / f"{name}.npy").read_bytes()
        header = str({"descr": ARRAYS[name].dtype.str, "fortran_order": False, "shape": tuple(shape)})
        header = header.ljust(118 + 1024) + "\n"
        raw = b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode() + before[128:]
        (stored / f"{name}.npy").write_bytes(raw)
        manifest = (stored / store.MANIFEST).read_text()
        edit(
            stored,
            lambda m, n=name, s=shape, r=raw: m["arrays"][n].update(
                shape=s, bytes=len(r), sha256=hashlib.sha256(r).hexdigest()
            ),
        )
        if name == "nothing":
            assert store.load(stored, "thing")[0]["nothing"].shape == (0, 10**12)
        else:
            with pytest.raises(StoreError):
                store.load(stored, "thing")
        (stored / f"{name}.npy").write_bytes(before)
        (stored / store.MANIFEST).write_text(manifest)
    edit(stored, lambda m: m["meta"].update(nested=[10**400]))
    with pytest.raises(StoreError, match="over 128 bits"):
        store.load(stored, "thing")


def test_errors_of_the_system_are_ours(tmp_path, stored):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        store.save(tmp_path / "file" / "thing", ARRAYS, {}, "thing")
    with pytest.raises(StoreError, match="cannot be written"):
        store.save(tmp_path / ("n" * 300), ARRAYS, {}, "thing")


def test_a_store_has_the_permissions_of_any_directory(tmp_path):
    store.save(tmp_path / "kept", {"x": np.arange(3)}, {}, "thing")
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "kept").stat().st_mode == (tmp_path / "plain").stat().st_mode
