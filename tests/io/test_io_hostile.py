"""Files made to cost much stay within the limits of ``benchmarks/hostile.py``, at a size that is quick to make."""

import sys

import pytest

from benchmarks.hostile import CASES, MB, cost, limits, warm

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="each file is read in a fork")
LENIENT = 4  # on a machine that does other things too


@pytest.fixture(scope="module", autouse=True)
def _warmed():
    warm()


@pytest.mark.parametrize("name", CASES)
def test_cost(name):
    case = CASES[name]
    data = case.make(2 * MB)
    (seconds, memory), found = limits(case, 2 * MB, data), cost(data)
    assert found.seconds < LENIENT * seconds, found
    assert found.memory < memory, found
