"""Bytes of a file: plain, .gz, .zst or .zip by their first bytes, unpacked as a stream and within a limit.

Text is made UTF-8 if it is UTF-16, and its lines end in line feeds where they end in carriage returns alone.
"""

from __future__ import annotations

import codecs
import gzip
import io
import lzma
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from wakefold.io.report import ReadError

HEAD = 1 << 16
"""Bytes that are looked at to recognise a format."""
BLOCK = 8 << 20
LONGEST_LINE = 16 << 20
LONGEST_TRAJECTORY = 256 << 20
"""Bytes of a line, and of one that holds a whole trajectory."""
LEAST_LIMIT = 256 << 20
GREATEST_RATIO = 200
"""A compressed file may unpack to 200 times its size, or 256 MiB; AIS logs compress 5 to 30 times."""
ROW, AGENT, PIECE = 40, 150, 20
"""A quarter of the bytes that a row, an agent and a piece of a line take in memory: what is made of a packed file then
takes four times what it may unpack to."""

DAMAGE = (
    OSError, EOFError, ValueError, RuntimeError, MemoryError, OverflowError, IndexError, struct.error, zlib.error,
    zipfile.BadZipFile, lzma.LZMAError,
)  # fmt: skip
"""What the unpackers of Python raise of damaged data (NotImplementedError is a RuntimeError)."""

Progress = Callable[[int, int], None]


class Source:
    """One file, or one member of an archive, unpacked.

    Attributes:
        name: for messages; members are named ``archive.zip/member``.
        head: the first bytes (up to ``HEAD``), without a byte order mark; reading starts over at them.
        path: where the very same bytes lie on disk, for formats that jump about; None for what was packed.
    """

    def __init__(self, name: str, stream: Any, limit: _Limit, after: Callable[[], None]) -> None:
        self.name, self._limit, self._after = name, limit, after
        self.path: Path | None = None
        with self._damage():
            self._stream = _unpacked(stream, limit)
        head = b""
        while len(head) < HEAD and (more := self._raw(HEAD - len(head))):
            head += more
        wide = _wide(head)
        self._decoder = codecs.getincrementaldecoder(wide)("replace") if wide else None
        self._returns = False
        self.transcoded = wide is not None
        head = self._text(head).removeprefix(b"\xef\xbb\xbf")
        if b"\r" in head and b"\n" not in head and b"\0" not in head:
            self._returns = self.transcoded = True
            head = head.replace(b"\r", b"\n")
        self.head, self._pending = head[:HEAD], head

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except DAMAGE as error:
            if isinstance(error, ReadError):
                raise
            why = str(error) or type(error).__name__
            raise ReadError(f"{self.name}: the data are damaged or cut off ({why})") from error

    def _raw(self, size: int) -> bytes:
        with self._damage():
            data = self._stream.read(size)
        self._limit.count(self.name, len(data))
        self._after()
        return data

    def _text(self, data: bytes) -> bytes:
        if self._decoder is not None:
            data = self._decoder.decode(data, final=not data).encode()
        return data.replace(b"\r", b"\n") if self._returns else data

    def _more(self, size: int) -> bytes:
        if self._decoder is None:
            return self._text(self._raw(size))
        while raw := self._raw(size):
            if data := self._text(raw):
                return data
        return self._text(b"")

    def read(self, size: int) -> bytes:
        """The next bytes, ``size`` at most; empty at the end only."""
        if self._pending:
            data, self._pending = self._pending[:size], self._pending[size:]
            return data
        return self._more(size)

    def blocks(self, size: int = BLOCK, longest: int | None = None) -> Iterator[tuple[int, bytes, int]]:
        """Whole lines in blocks of about ``size`` bytes: number of the first line, from 1, block, number of lines.

        Raises:
            ReadError: a line is longer than ``longest`` bytes, ``LONGEST_LINE`` if not given.
        """
        longest = LONGEST_LINE if longest is None else longest
        number, rest = 1, b""
        while data := self.read(size):
            cut = data.rfind(b"\n") + 1
            if not cut:
                rest += data
                if len(rest) > longest:
                    raise ReadError(f"{self.name}: line {number} is longer than {longest >> 20} MiB")
                continue
            block = b"".join((rest, memoryview(data)[:cut]))
            count = newlines(block)
            yield number, block, count
            number += count
            rest = data[cut:]
        if rest:
            yield number, rest, 1

    def lines(self, longest: int | None = None) -> Iterator[tuple[int, bytes]]:
        """Lines without their ends, with their numbers from 1; blank ones are left out."""
        for number, block, _ in self.blocks(longest=longest):
            for i, line in enumerate(block.split(b"\n")):
                if line := line.strip():
                    yield number + i, line

    def whole(self, limit: int, weight: int = 1) -> bytes:
        """Everything at once, for formats that cannot be streamed.

        Args:
            weight: how many bytes a byte counts for, since what is made of it takes so much more memory.

        Raises:
            ReadError: it is longer than ``limit`` bytes, or than a packed file may be.
        """
        parts, size = [], 0
        while data := self.read(BLOCK):
            parts.append(data)
            size += len(data)
            self._limit.hold(self.name, (weight - 1) * len(data))
            if size > limit:
                raise ReadError(f"{self.name}: longer than the {limit >> 20} MiB this format may have")
        return b"".join(parts)

    def hold(self, rows: int, agents: int = 0) -> None:
        """Count rows, and agents that are new, that stay in memory: however short they are, each takes some.

        Raises:
            ReadError: they are more than a packed file may hold.
        """
        self._limit.hold(self.name, ROW * rows + AGENT * agents)

    def afford(self, pieces: int) -> None:
        """Refuse to take apart a line of so many pieces that they would take more memory than a packed file may."""
        self._limit.afford(self.name, PIECE * pieces)

    def decoded(self, size: int) -> None:
        """Count what was decoded of a file that packs its values itself, as Parquet does."""
        self._limit.active = True
        self._limit.count(self.name, size)


def newlines(block: bytes) -> int:
    """Line ends in a block; more than twice as fast as ``bytes.count``."""
    return int(np.count_nonzero(np.frombuffer(block, dtype=np.uint8) == ord("\n")))


class _Limit:
    """Counts the bytes that a compressed file unpacks to."""

    def __init__(self, packed: int, most: int | None) -> None:
        self.most = max(LEAST_LIMIT, GREATEST_RATIO * packed) if most is None else most
        self.unpacked = self.held = 0
        self.active = False

    def count(self, name: str, size: int) -> None:
        self.unpacked += size
        self._check(name, self.unpacked)

    def hold(self, name: str, size: int) -> None:
        self.held += size
        self._check(name, self.held)

    def afford(self, name: str, size: int) -> None:
        self._check(name, size)

    def _check(self, name: str, size: int) -> None:
        if self.active and size > self.most:
            raise ReadError(
                f"{name}: unpacks to more than {self.most:,} bytes, or to rows that take as much, as a decompression "
                "bomb would; if you trust it, pass a larger max_unpacked (--max-unpacked)"
            )


def open_sources(path: Path, max_unpacked: int | None = None, progress: Progress | None = None) -> Iterator[Source]:
    """The data in a file: itself, or each member of a zip archive in order of name.

    Args:
        path: a file, plain or .gz, .zst, .zip (told by its first bytes).
        max_unpacked: bytes that a compressed file may unpack to; by default 200 times its size, and at least 256 MiB.
        progress: called as reading goes on with the bytes of the file done and in all.

    Raises:
        ReadError: no such file, a directory, an archive that is damaged, encrypted, empty, or over the limit.
    """
    try:
        what = path.stat().st_mode
        if stat.S_ISDIR(what):
            raise ReadError(f"{path}: is a directory; give its files")
        if not stat.S_ISREG(what):  # files are looked at more than once, which a stream is not for
            kind = "pipe" if stat.S_ISFIFO(what) else "device or socket"
            raise ReadError(f"{path}: is a {kind}, not a file; save what comes from it, and give that")
        file = path.open("rb")
        size = path.stat().st_size
    except OSError as error:
        raise ReadError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:  # ReadError is one; else a NUL in the name
        raise error if isinstance(error, ReadError) else ReadError(f"{str(path)!r}: {error}") from None
    limit = _Limit(size, max_unpacked)

    def after() -> None:
        if progress is not None:
            progress(file.tell(), size)

    with file:
        magic = file.read(4)
        file.seek(0)
        if magic in (b"PK\x03\x04", b"PK\x05\x06"):
            limit.active = True
            for name, member in _members(path.name, file):
                yield Source(name, member, limit, after)
            return
        source = Source(path.name, file, limit, after)
        source.path = None if limit.active or source.transcoded else path
        yield source


def _unpacked(stream: Any, limit: _Limit) -> Any:
    """The stream itself, or what it unpacks to."""
    buffered = stream if isinstance(stream, io.BufferedReader) else io.BufferedReader(stream)
    magic = buffered.peek(4)[:4]
    if magic[:2] == b"\x1f\x8b":
        limit.active = True
        return gzip.GzipFile(fileobj=buffered)
    if magic == b"\x28\xb5\x2f\xfd":
        import pyarrow as pa

        limit.active = True
        return pa.CompressedInputStream(pa.PythonFile(buffered, mode="r"), "zstd")
    return buffered


def _wide(head: bytes) -> str | None:
    """The name of UTF-16 in the byte order of a text, by its mark or by the zeros beside its first letters."""
    for mark, name in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be")):
        if head.startswith(mark):
            return name
    first = head[:64]
    if len(first) >= 8 and len(first) % 2 == 0:
        for odd, name in ((first[1::2], "utf-16-le"), (first[::2], "utf-16-be")):
            letters = first[::2] if name == "utf-16-le" else first[1::2]
            if not any(odd) and re.fullmatch(rb"[ -~\t\r\n]*", letters):
                return name
    return None


def _members(name: str, file: BinaryIO) -> Iterator[tuple[str, Any]]:
    try:
        archive = zipfile.ZipFile(file)
        members = sorted(
            (m for m in archive.infolist() if _counts(m)), key=lambda member: (member.filename, member.header_offset)
        )
        if maps := [member for member in members if member.filename.lower().endswith(".kml")]:
            members = maps  # of a KMZ, whose other members are pictures
        if not members:
            raise ReadError(f"{name}: an archive with nothing in it")
        for member in members:  # by themselves: two may have one name
            with archive.open(member) as stream:
                yield f"{name}/{member.filename}", stream
    except DAMAGE as error:
        if isinstance(error, ReadError):
            raise
        raise ReadError(f"{name}: the archive cannot be read ({error})") from error


def _counts(member: zipfile.ZipInfo) -> bool:
    """Whether a member of an archive is a file, and none that a system adds."""
    name = member.filename
    return not (member.is_dir() or name.startswith("__MACOSX/") or Path(name).name.startswith("."))
