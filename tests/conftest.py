"""Settings that all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings
from world_models import ModelWriter

# No deadlines: Numba compiles in whichever example comes first, and machines stall. The same
# examples every time: a test that fails fails again.
settings.register_profile("drake_aigto", deadline=None, derandomize=True)
settings.load_profile("drake_aigto")


@pytest.fixture
def write_model(tmp_path: Path) -> ModelWriter:
    return ModelWriter(tmp_path)
