"""What rides on moving bodies in Meshcat: an arrow for the control, a flash for each impact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import Motion
from drake_aigto.show.stage import Actor, Stage
from drake_aigto.transcription import Touch
from drake_aigto.world import World

_INK, _YELLOW = Rgba(0.13, 0.13, 0.13), Rgba(1.0, 0.78, 0.0)

# In radii of the body: the longest arrow, its head, its shaft; the largest flash.
_ARROW, _HEAD, _HEAD_RADIUS, _SHAFT_RADIUS = 5.0, 1.6, 0.5, 0.2
_FLASH_RADIUS = 1.1
# Of the largest flash's radius: that of an impact without speed.
_LEAST_FLASH = 0.4
_FLASH_TIME = 0.15  # from an impact until its flash is gone [s]
# Scale of what is not to be seen: at 0 a transform has no inverse, of which browsers complain.
_GONE = 1e-3


@dataclass(frozen=True)
class Clock:
    """Frames of a recording whose parts all have one length, so that they repeat together.

    Attributes:
        begin: when the first frame is [s].
        end: when the last frame is [s].
        rate: frames per second.
    """

    begin: float
    end: float
    rate: int

    def frame(self, time: float) -> int:
        """Returns the frame of a time [s]."""
        return round((time - self.begin) * self.rate)

    @property
    def last_frame(self) -> int:
        """The frame that all parts end with."""
        return self.frame(self.end)


class Effects:
    """Arrows and flashes of several motions on one stage, all to one scale.

    An arrow is the force of the control on a body; a flash grows with the speed of the impact.

    Attributes:
        largest_force: of all controls on one body, which has the longest arrow [N]; 0 without.
        flashes: whether there is an impact.
    """

    def __init__(self, stage: Stage, world: World, motions: Sequence[Motion], clock: Clock) -> None:
        """Finds the scales."""
        self._stage, self._world, self._clock = stage, world, clock
        forces = [self._forces(m.controls) for m in motions if m.controls is not None]
        sizes = [np.max(np.linalg.norm(force, axis=-1), initial=0.0) for force in forces]
        self.largest_force = float(max(sizes, default=0.0))
        speeds = [self._speed(motion, touch) for motion in motions for touch in motion.impacts]
        self.flashes = bool(speeds)
        self._largest_speed = max(speeds, default=0.0) or 1.0

    def add(
        self,
        motion: Motion,
        aside: RigidTransform,
        folder: str,
        meshcat: Meshcat,
        animation: MeshcatAnimation,
    ) -> None:
        """Puts the shapes where they belong, and adds how they change."""
        if motion.controls is not None and self.largest_force > 0:
            forces = self._forces(motion.controls)
            for mover, force in zip(self._stage.movers, forces, strict=True):
                self._add_arrow(
                    motion, mover, force, f"{folder}/{mover.name}/control", meshcat, animation
                )
        for contact in sorted({touch.contact for touch in motion.impacts}):
            self._add_flashes(motion, contact, aside, f"{folder}/impacts", meshcat, animation)

    def _forces(self, controls: Floats) -> Floats:
        """Returns the controls' forces (N, nu) on each mover, in the world: (movers, N, 3) [N]."""
        generalized = controls @ self._world.actuation.T
        directions = self._stage.directions
        forces = np.zeros((len(directions), len(controls), 3))
        for i in range(generalized.shape[1]):
            # Of bodies that ride on others, the one that the joint itself moves.
            mover = int(np.argmax(np.any(directions[:, i], axis=1)))
            forces[mover] += np.outer(generalized[:, i], directions[mover, i])
        return forces

    def _add_arrow(
        self,
        motion: Motion,
        mover: Actor,
        forces: Floats,
        path: str,
        meshcat: Meshcat,
        animation: MeshcatAnimation,
    ) -> None:
        """Adds a mover's arrow along its forces, shape (N, 3) in the world [N]."""
        assert motion.control_times is not None
        _shape_arrow(path, mover.radius, meshcat)
        sizes = np.linalg.norm(forces, axis=1)
        scales = np.maximum(sizes / self.largest_force, _GONE)
        rotation = self._stage.rotation(mover).inverse()
        direction = np.array([1.0, 0.0, 0.0])
        for k, time in enumerate(motion.control_times[:-1]):
            if sizes[k] > 0:
                direction = rotation @ (forces[k] / sizes[k])
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            pose = RigidTransform(turned, mover.radius * direction)
            if k == 0:
                meshcat.SetTransform(path, pose)
                meshcat.SetProperty(path, "scale", [scales[0]] * 3)
            frame = self._clock.frame(time)
            animation.SetTransform(frame, path, pose)
            animation.SetProperty(frame, path, "scale", [scales[k]] * 3)
        for frame in (self._clock.frame(motion.control_times[-1]), self._clock.last_frame):
            animation.SetProperty(frame, path, "scale", [_GONE] * 3)

    def _add_flashes(
        self,
        motion: Motion,
        contact: int,
        aside: RigidTransform,
        folder: str,
        meshcat: Meshcat,
        animation: MeshcatAnimation,
    ) -> None:
        """Adds what flashes where one contact is touched."""
        mover, toward = self._struck(contact)
        path = f"{folder}/{contact}"
        meshcat.SetObject(path, Sphere(_FLASH_RADIUS * mover.radius), _YELLOW)
        meshcat.SetProperty(path, "scale", [_GONE] * 3)
        touches = [touch for touch in motion.impacts if touch.contact == contact]
        for i, touch in enumerate(touches):
            place = self._stage.pose(mover, motion.positions[self._row(motion, touch)])
            pose = aside.multiply(place.multiply(RigidTransform(mover.radius * toward)))
            if i == 0:
                meshcat.SetTransform(path, pose)
            animation.SetTransform(max(self._clock.frame(touch.start) - 1, 0), path, pose)
        for frame, scale in self._flash_keys(motion, touches).items():
            animation.SetProperty(frame, path, "scale", [scale] * 3)

    def _row(self, motion: Motion, touch: Touch) -> int:
        """Returns a motion's row as it touches: of the two of an impact the first."""
        return min(int(np.searchsorted(motion.times, touch.start)), len(motion.times) - 1)

    def _speed(self, motion: Motion, touch: Touch) -> float:
        """Returns how fast a motion approaches what it is about to touch [m/s]."""
        row = self._row(motion, touch)
        slope = self._world.calc_contact_jacobian(motion.positions[row])[touch.contact]
        return max(0.0, -float(slope @ motion.velocities[row]))

    def _struck(self, contact: int) -> tuple[Actor, Floats]:
        """Returns the first mover that a contact pushes, and where it is touched, in its frame."""
        slope = self._world.constant_inertia.jacobian[contact]
        for mover, directions in zip(self._stage.movers, self._stage.directions, strict=True):
            push = slope @ directions
            if np.any(push):
                inward = self._stage.rotation(mover).inverse() @ push
                return mover, -inward / np.linalg.norm(inward)
        raise AssertionError("a contact pushes what moves")

    def _flash_keys(self, motion: Motion, touches: Sequence[Touch]) -> dict[int, float]:
        """Returns frame → scale: nothing, an impact's size at once, and nothing a moment later."""
        keys: dict[int, float] = {0: _GONE}
        for touch in touches:
            frame = self._clock.frame(touch.start)
            # What is left of an earlier flash ends here.
            keys = {f: scale for f, scale in keys.items() if f < frame - 1}
            keys[max(frame - 1, 0)] = _GONE
            share = self._speed(motion, touch) / self._largest_speed
            keys[frame] = _LEAST_FLASH + (1 - _LEAST_FLASH) * share
            keys[frame + round(_FLASH_TIME * self._clock.rate)] = _GONE
        keys = {f: scale for f, scale in keys.items() if f < self._clock.last_frame}
        return {**keys, self._clock.last_frame: _GONE}


def _shape_arrow(path: str, r: float, meshcat: Meshcat) -> None:
    """Puts an arrow of full size along z, for a body of radius r [m]."""
    shaft = (_ARROW - _HEAD) * r
    meshcat.SetObject(f"{path}/shaft", Cylinder(_SHAFT_RADIUS * r, shaft), _INK)
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0, 0, shaft / 2]))
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD * r, *[_HEAD_RADIUS * r] * 2), _INK)
    tip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, _ARROW * r])
    meshcat.SetTransform(f"{path}/head", tip)
