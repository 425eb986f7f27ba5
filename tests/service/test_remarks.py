"""What is said of troubles: few lines, however many there are."""

from hypothesis import given
from hypothesis import strategies as st

from wakefold.service.remarks import EVERY, Remarks


def test_the_first_of_each_kind_is_told_then_one_line_a_minute_then_the_total() -> None:
    said: list[str] = []
    now = [0.0]
    remarks = Remarks(said.append, lambda: now[0])
    remarks("lines refused (time)", "line 3 refused: time: missing")
    for k in range(10):
        remarks("lines refused (time)", f"line {4 + k} refused: time: missing")
    remarks("agents dropped", "agent a dropped")
    assert said == ["line 3 refused: time: missing", "agent a dropped"]
    now[0] = 61.0
    remarks("lines refused (time)", "line 90 refused: time: missing")
    remarks("lines refused (time)", "line 91 refused: time: missing")
    assert said[2:] == ["11 more lines refused (time), the last: line 90 refused: time: missing"]
    remarks.totals()
    assert said[3:] == ["13 lines refused (time) in all"]  # one agent was told of


def test_what_is_always_so_is_said_once() -> None:
    said: list[str] = []
    remarks = Remarks(said.append)
    for _ in range(5):
        remarks.once("plane", "x and y are metres")
    remarks.totals()
    assert said == ["x and y are metres"]


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 50)), max_size=300))
def test_lines_are_bounded_by_kinds_and_minutes(troubles: list[tuple[str, float]]) -> None:
    said: list[str] = []
    now = 0.0
    remarks = Remarks(said.append, lambda: now)
    for kind, wait in troubles:
        now += wait
        remarks(kind, f"one of {kind}")
    kinds = {kind for kind, _ in troubles}
    assert len(said) <= len(kinds) * (1 + now / EVERY)
    before = len(said)
    remarks.totals()
    totals = {line.split()[1]: int(line.split()[0]) for line in said[before:]}
    counts = {kind: sum(k == kind for k, _ in troubles) for kind in kinds}
    assert totals == {kind: count for kind, count in counts.items() if count > 1}
