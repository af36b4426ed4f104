"""What rides on moving bodies in Meshcat: an arrow for the control, a flash for each impact."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import Motion, calc_approach_speed, find_row
from drake_aigto.show.stage import Actor, Stage
from drake_aigto.transcription import Touch
from drake_aigto.world import World

INK, YELLOW = Rgba(0.13, 0.13, 0.13), Rgba(1.0, 0.78, 0.0)

# In radii of the body: the longest arrow, its head, its shaft; the largest flash.
ARROW, _HEAD, _HEAD_RADIUS, _SHAFT_RADIUS = 5.0, 1.6, 0.5, 0.2
_FLASH_RADIUS = 1.1
# Of the largest flash's radius: that of an impact without speed.
_LEAST_FLASH = 0.4
_FLASH_TIME = 0.15  # from an impact until its flash is gone [s]
# Scale of what is not to be seen: at 0 a transform has no inverse, of which browsers complain.
GONE = 1e-3
_REPETITIONS = 10_000


class Film:
    """A recording in the making, whose parts all have one length, so that they repeat together.

    How something looks when it is first keyed is also how it looks before the film is played.

    Attributes:
        meshcat: where it is shown.
        rate: frames per second.
        last_frame: that all parts end with.
    """

    def __init__(self, meshcat: Meshcat, begin: float, end: float, rate: int) -> None:
        """Begins with a frame at one time, and ends with one at another [s]."""
        self.meshcat, self.rate, self._begin = meshcat, rate, begin
        self.last_frame = self.frame(end)
        self._animation, self._keyed = MeshcatAnimation(rate), set[tuple[str, ...]]()

    def frame(self, time: float) -> int:
        """Returns the frame of a time [s]."""
        return round((time - self._begin) * self.rate)

    def move(self, frame: int, path: str, pose: RigidTransform) -> None:
        """Has an object be somewhere at a frame."""
        if self._is_first(path, ""):
            self.meshcat.SetTransform(path, pose)
        self._animation.SetTransform(frame, path, pose)

    def change(self, frame: int, path: str, name: str, value: bool | list[float]) -> None:
        """Has a property of an object be something at a frame."""
        if self._is_first(path, name):
            self.meshcat.SetProperty(path, name, value)
        self._animation.SetProperty(frame, path, name, value)

    def _is_first(self, *key: str) -> bool:
        is_first = key not in self._keyed
        self._keyed.add(key)
        return is_first

    def play(self) -> None:
        """Plays it again and again."""
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._animation.set_repetitions(_REPETITIONS)
        self.meshcat.SetAnimation(self._animation)


class Effects:
    """Arrows and flashes of several motions on one stage, all to one scale.

    An arrow is the force of the control on a body; a flash grows with the speed of the impact.

    Attributes:
        largest_force: of all controls on one body, which has the longest arrow [N]; 0 without.
        flashes: whether there is an impact.
    """

    def __init__(self, stage: Stage, world: World, motions: Sequence[Motion], film: Film) -> None:
        """Finds the scales."""
        self._stage, self._world, self._film = stage, world, film
        forces = [self._forces(m.controls) for m in motions if m.controls is not None]
        sizes = [np.max(np.linalg.norm(force, axis=-1), initial=0.0) for force in forces]
        self.largest_force = float(max(sizes, default=0.0))
        speeds = [self._speed(motion, touch) for motion in motions for touch in motion.impacts]
        self.flashes = bool(speeds)
        self._largest_speed = max(speeds, default=0.0) or 1.0

    def add(self, motion: Motion, aside: RigidTransform, folder: str) -> None:
        """Adds to the film what rides on a motion's bodies, which are moved aside in the world."""
        if motion.controls is not None and self.largest_force > 0:
            forces = self._forces(motion.controls)
            for mover, force in zip(self._stage.movers, forces, strict=True):
                self._add_arrow(motion, mover, force, f"{folder}/{mover.name}/control")
        for contact in sorted({touch.contact for touch in motion.impacts}):
            self._add_flashes(motion, contact, aside, f"{folder}/impacts/{contact}")

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

    def _add_arrow(self, motion: Motion, mover: Actor, forces: Floats, path: str) -> None:
        """Adds a mover's arrow along its forces, shape (N, 3) in the world [N]."""
        assert motion.control_times is not None
        film = self._film
        shape_arrow(path, mover.radius, film.meshcat)
        sizes = np.linalg.norm(forces, axis=1)
        scales = np.maximum(sizes / self.largest_force, GONE)
        rotation = self._stage.rotation(mover).inverse()
        direction = np.array([1.0, 0.0, 0.0])
        for k, frame in enumerate(map(film.frame, motion.control_times[:-1])):
            if sizes[k] > 0:
                direction = rotation @ (forces[k] / sizes[k])
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            film.move(frame, path, RigidTransform(turned, mover.radius * direction))
            film.change(frame, path, "scale", [scales[k]] * 3)
        for frame in (film.frame(motion.control_times[-1]), film.last_frame):
            film.change(frame, path, "scale", [GONE] * 3)

    def _add_flashes(self, motion: Motion, contact: int, aside: RigidTransform, path: str) -> None:
        """Adds what flashes where one contact is touched."""
        mover, toward = self._struck(contact)
        film = self._film
        film.meshcat.SetObject(path, Sphere(_FLASH_RADIUS * mover.radius), YELLOW)
        touches = [touch for touch in motion.impacts if touch.contact == contact]
        for touch in touches:
            place = self._stage.pose(mover, motion.positions[find_row(motion, touch.start)])
            pose = aside.multiply(place.multiply(RigidTransform(mover.radius * toward)))
            film.move(max(film.frame(touch.start) - 1, 0), path, pose)
        shares = ((t.start, self._speed(motion, t) / self._largest_speed) for t in touches)
        for frame, scale in flash_keys(film, shares).items():
            film.change(frame, path, "scale", [scale] * 3)

    def _speed(self, motion: Motion, touch: Touch) -> float:
        return calc_approach_speed(self._world, motion, touch.start, touch.contact)

    def _struck(self, contact: int) -> tuple[Actor, Floats]:
        """Returns the first mover that a contact pushes, and where it is touched, in its frame."""
        slope = self._world.constant_inertia.jacobian[contact]
        for mover, directions in zip(self._stage.movers, self._stage.directions, strict=True):
            push = slope @ directions
            if np.any(push):
                inward = self._stage.rotation(mover).inverse() @ push
                return mover, -inward / np.linalg.norm(inward)
        raise AssertionError("a contact pushes what moves")


def flash_keys(film: Film, impacts: Iterable[tuple[float, float]]) -> dict[int, float]:
    """Returns frame → scale: nothing, an impact's size at once, and nothing a moment later.

    Impacts are times [s], in order, and their speeds as parts of the largest one.
    """
    keys: dict[int, float] = {0: GONE}
    for time, share in impacts:
        frame = film.frame(time)
        # What is left of an earlier flash ends here.
        keys = {f: scale for f, scale in keys.items() if f < frame - 1}
        keys[max(frame - 1, 0)] = GONE
        keys[frame] = _LEAST_FLASH + (1 - _LEAST_FLASH) * share
        keys[frame + round(_FLASH_TIME * film.rate)] = GONE
    keys = {f: scale for f, scale in keys.items() if f < film.last_frame}
    return {**keys, film.last_frame: GONE}


def shape_arrow(path: str, r: float, meshcat: Meshcat, color: Rgba = INK) -> None:
    """Puts an arrow of full size along z, for a body of radius r [m]."""
    shaft = (ARROW - _HEAD) * r
    meshcat.SetObject(f"{path}/shaft", Cylinder(_SHAFT_RADIUS * r, shaft), color)
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0, 0, shaft / 2]))
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD * r, *[_HEAD_RADIUS * r] * 2), color)
    tip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, ARROW * r])
    meshcat.SetTransform(f"{path}/head", tip)
