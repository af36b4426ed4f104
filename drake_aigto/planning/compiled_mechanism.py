"""What is compiled once for all tasks of a mechanism with one law of contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import CompliantLaw
from drake_aigto.planning.mechanism_boxes import MechanismBoxes
from drake_aigto.shooting import Mechanism
from drake_aigto.transcription import MechanismProgram
from drake_aigto.world import TaskCost, World

# Programs of boxes that are kept; scenarios may have ever other durations and weights.
_MOST_PROGRAMS = 32


@dataclass(frozen=True, eq=False)
class CompiledMechanism:
    """What all tasks with one law of contact share.

    Attributes:
        mechanism: the world as shooting has it.
        boxes: the last programs of boxes, by the weights, bounds, duration and steps they have.
    """

    mechanism: Mechanism
    boxes: dict[tuple[Any, ...], MechanismBoxes]

    def find_boxes(
        self,
        world: World,
        task: TaskCost,
        springs: CompliantLaw,
        duration: float,
        num_steps: int,
        is_hard: Bools,
        control_bounds: Floats,
    ) -> MechanismBoxes:
        """Returns boxes for any start and goal (`MechanismProgram`), compiled if need be."""
        weights = task.R, task.Q, task.Qv, task.QT, task.QTv, task.is_chordal, task.is_modulo
        arrays = *weights, is_hard, control_bounds, springs.stiffness, springs.dissipation
        key = num_steps, duration, *(each.tobytes() for each in arrays)
        boxes = self.boxes.get(key)
        if boxes is None:
            program = MechanismProgram(world, task, springs, duration, num_steps, is_hard)
            if len(self.boxes) >= _MOST_PROGRAMS:
                self.boxes.pop(next(iter(self.boxes)), None)
            boxes = self.boxes[key] = MechanismBoxes(program, control_bounds)
        return boxes
