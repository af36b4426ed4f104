"""Models of the extra `models`, where it is installed, against MuJoCo's own numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.models import Row, compare, find_models, read

pytest.importorskip("mujoco", reason="pip install 'drake_aigto[models]'")

NAMES = (
    *("suite/acrobot", "suite/cartpole", "suite/pendulum", "suite/reacher", "suite/cheetah"),
    *("suite/hopper", "assets/reacher", "assets/hopper", "assets/inverted_double_pendulum"),
    *("assets/inverted_pendulum", "assets/walker2d", "assets/half_cheetah"),
)


def find(name: str) -> Path:
    found = [path for _, path in find_models() if path.as_posix().endswith(f"{name}.xml")]
    if not found:
        pytest.skip("pip install 'drake_aigto[models]'")
    return found[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_dynamics_limits_and_efforts_are_mujocos(name: str) -> None:
    path = find(name)
    row = Row("", name)
    found = read(row, path)
    assert found is not None, row.read
    assert compare(found[0], path) < 1e-9
