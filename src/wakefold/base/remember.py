"""What objects work out once and keep, and why that stays at home."""

from __future__ import annotations

from functools import cached_property
from typing import Any


class Remembers:
    """Base of classes with cached properties: what was worked out is neither copied nor pickled with the rest.

    It can be worked out again, and may be many times as large.
    """

    def __getstate__(self) -> dict[str, Any]:
        kind = type(self)
        return {
            name: value
            for name, value in vars(self).items()
            if not isinstance(getattr(kind, name, None), cached_property)
        }
