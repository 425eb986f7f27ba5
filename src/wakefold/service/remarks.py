"""What is said of troubles: a line for each kind of them and time, however many there are."""

from __future__ import annotations

import time
from collections.abc import Callable

EVERY = 60.0  # seconds between two lines on one kind of trouble


class Remarks:
    """Says the first trouble of each kind at once, then at most one line a minute and kind, and at the end how many.

    Args:
        say: takes a line.
        clock: seconds that only rise.
    """

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self.say, self.clock = say, clock
        self._kinds: dict[str, tuple[int, int, float]] = {}  # how many there were, of them told of, when the last was

    def __call__(self, kind: str, what: str) -> None:
        """One more trouble.

        Args:
            kind: of how many things there can be some more, such as "agents dropped"; there are few kinds.
            what: this one, in a line.
        """
        count, told, when = self._kinds.get(kind, (0, 0, 0.0))
        count, now = count + 1, self.clock()
        if count == 1:
            self.say(what)
        elif now - when >= EVERY:
            self.say(f"{count - told:,} more {kind}, the last: {what}")
        else:
            self._kinds[kind] = count, told, when
            return
        self._kinds[kind] = count, count, now

    def once(self, kind: str, what: str) -> None:
        """Something that is said once only, however often it is the case."""
        if kind not in self._kinds:
            self.say(what)
            self._kinds[kind] = 1, 1, 0.0

    def totals(self) -> None:
        """Say how many there were of each kind of which there was more than one."""
        for kind, (count, _, _) in self._kinds.items():
            if count > 1:
                self.say(f"{count:,} {kind} in all")
