"""What all tests share: real data where it is at hand; Hypothesis without a deadline, as kernels compile."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("wakefold", deadline=None, derandomize=True)
settings.load_profile("wakefold")

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def shared_data() -> Callable[[str], Path]:
    """``shared_data("nyharbor_ais/....traj")``: a path to real data beside the project; skips where it is absent."""

    def find(name: str) -> Path:
        if not (DATA / name).exists():
            pytest.skip(f"no real data: ../shared/data/{name} is not here")
        return DATA / name

    return find
