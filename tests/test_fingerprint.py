"""A world is known again by its fingerprint, and no change of its physics goes unnoticed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from mechanisms import build
from world_models import VARIANTS, ModelWriter, make_world

from drake_aigto import ModelError, Scenario, World
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.world import Fingerprint

# A half space is in front of the ball where the box was: the same equations.
OTHERS = sorted(VARIANTS.keys() - {"as shipped", "half space"})


@pytest.fixture
def write_model(tmp_path: Path) -> ModelWriter:
    return ModelWriter(tmp_path)


@pytest.mark.parametrize("name", OTHERS)
def test_a_changed_model_has_another_fingerprint(write_model: ModelWriter, name: str) -> None:
    shipped, changed = (make_world(write_model, each).fingerprint for each in ("as shipped", name))
    again = make_world(write_model, name)
    changed.check(again.fingerprint, "")
    with pytest.raises(ModelError, match=r"the world has changed: got .*, expected .*Look\."):
        shipped.check(again.fingerprint, "Look.")


def test_a_fingerprint_survives_json_and_rounding(write_model: ModelWriter) -> None:
    world = make_world(write_model, "slope")
    read = from_plain(Fingerprint, json.loads(json.dumps(to_plain(world.fingerprint))))
    assert read == world.fingerprint
    rounded = dataclasses.replace(
        read, accelerations=tuple(tuple(row) for row in np.array(read.accelerations) * (1 + 1e-13))
    )
    rounded.check(world.fingerprint, "")


def test_mass_walls_and_restitutions_count() -> None:
    scenario = Scenario.named("room/bank_shot")
    world = World.from_scenario(scenario)
    heavier = World.from_scenario(dataclasses.replace(scenario, mass=1.001))
    for other, what in ((heavier, "accelerations"), (world.with_wall_moved(3, 1e-7), "distances")):
        with pytest.raises(ModelError, match=f"got {what}"):
            world.fingerprint.check(other.fingerprint, "")
    softer = dataclasses.replace(world.fingerprint, restitutions=(None, None, None, 0.5))
    with pytest.raises(ModelError, match="got restitutions"):
        softer.check(world.fingerprint, "")


def test_stiffness_dissipation_and_limits_count_unless_a_file_tells_none() -> None:
    soft, other, free = (
        build(f"cart_pole{kind}").fingerprint for kind in ("_soft_06", "_rigid_06", "")
    )
    rigid = dataclasses.replace(other, coordinates=soft.coordinates, actuators=soft.actuators)
    with pytest.raises(
        ModelError, match=r"got materials \(\(2000000000\.0, 2000000000\.0, 0\.0, 0\.0"
    ):
        soft.check(rigid, "")
    unlimited = dataclasses.replace(free, limits=((-np.inf,) * 5, (np.inf,) * 5))
    with pytest.raises(ModelError, match="got limits"):
        free.check(unlimited, "")
    plain = to_plain(soft)
    del plain["materials"], plain["limits"]
    from_plain(Fingerprint, plain).check(rigid, "")


def test_a_world_knows_the_model_that_it_was_built_from(write_model: ModelWriter) -> None:
    world = make_world(write_model, "as shipped")
    assert world.model == str(write_model.path) == world.fingerprint.model
    own = World.from_diagram(world.diagram)
    assert own.model is None
    world.fingerprint.check(own.fingerprint, "")
