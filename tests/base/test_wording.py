"""Numbers as people write them."""

import pytest

from wakefold.base.wording import counted, duration_text, length_text, number_text


@pytest.mark.parametrize(
    ("value", "text"),
    [(1e6, "1,000 km"), (999.9, "1,000 m"), (1e3, "1 km"), (12345.0, "12.3 km"), (250.0, "250 m"), (0.5, "0.5 m")],
)
def test_lengths(value: float, text: str) -> None:
    assert length_text(value) == text


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1812.3, 3, "1,812"), (6e4, 4, "60,000"), (12.345, 3, "12.3"), (1234.5, 6, "1,234.5"), (0.0, 3, "0")],
)
def test_numbers_have_no_exponent(value: float, digits: int, text: str) -> None:
    assert number_text(value, digits) == text


def test_durations_and_counts() -> None:
    assert [duration_text(s) for s in (45, 150, 86400)] == ["45 s", "2.5 min", "1,440 min"]
    assert [counted(n, "track") for n in (0, 1, 2000)] == ["0 tracks", "1 track", "2,000 tracks"]
