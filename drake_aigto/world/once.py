"""What is read of a world once."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakKeyDictionary

if TYPE_CHECKING:
    from drake_aigto.world.world import World

_Read = TypeVar("_Read")


def once_per_world(read: Callable[[World], _Read]) -> Callable[[World], _Read]:
    """Returns a function that remembers what was read of each world, for as long as that is there.

    Args:
        read: what it returns must not refer to the world, which would never go away then.
    """
    known: WeakKeyDictionary[World, _Read] = WeakKeyDictionary()

    @functools.wraps(read, updated=())
    def read_once(world: World) -> _Read:
        if world not in known:
            known[world] = read(world)
        return known[world]

    return read_once
