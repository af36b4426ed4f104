"""An MJCF whose includes and classes of defaults are resolved."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from drake_aigto.errors import ModelError
from drake_aigto.world.files import read_xml
from drake_aigto.world.model_facts import ModelFacts, refuse_element

MOTORS = ("motor", "general", "position", "velocity")


class MjcfFile:
    """An MJCF, and what holds for all of it.

    Attributes:
        root: <mujoco>.
        path: of its file.
        facts: what Drake's reader can't read in the text.
        compiler: attributes of all <compiler>.
        option: of all <option>.
        off: names of flags that are disabled, and of what they imply.
        bodies: every body, the world first, with the class of what is in it.
    """

    def __init__(self, root: Element, path: Path, facts: ModelFacts) -> None:
        """Puts includes in their places.

        Raises:
            ModelError: a file is missing, or includes itself.
        """
        _include(root, path.parent, (path,))
        self.root, self.path, self.facts = root, path, facts
        root.set("model", root.get("model") or path.stem)
        self.compiler = _merge(root.findall("compiler"))
        self.option = _merge(root.findall("option"))
        flags = _merge(root.findall("option/flag"))
        self.off = {name for name, value in flags.items() if value == "disable"}
        if "constraint" in self.off:
            self.off |= {"contact", "limit", "frictionloss", "equality"}
        if "passive" in self.off:
            self.off |= {"spring", "damper"}
        for number, frame in enumerate(list(root.iter("frame"))):  # A body that is welded.
            frame.tag = "body"
            frame.set("name", frame.get("name") or f"frame{number}")
        named = {body.get("name") for body in root.iter("body")}
        free = (name for i in itertools.count() if (name := f"body{i}") not in named)
        for body in root.iter("body"):  # As parts without a name are named after their body.
            body.set("name", body.get("name") or next(free))
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        for default in root.findall("default"):
            self._read_class(default, "main", {})
        self.bodies = list(self._walk())

    def resolve(self, element: Element, childclass: str) -> dict[str, str]:
        """Returns an element's attributes with those of its class."""
        tag = "actuator" if element.tag in MOTORS else element.tag
        name = element.get("class", childclass)
        if name not in self._classes and name != "main":
            raise refuse_element(self.path, element, f"the unknown class {name!r} of defaults")
        return {**self._classes.get(name, {}).get(tag, {}), **element.attrib}

    def is_limited(self, values: dict[str, str], of: str) -> bool:
        """Returns whether a range counts: that of an actuator, or without a word a joint's."""
        limited, has_range = values.get(f"{of}limited", "auto"), f"{of}range" in values
        if limited == "auto":
            return has_range and self.compiler.get("autolimits", "true") == "true"
        return limited == "true" and has_range

    def _read_class(
        self, default: Element, name: str, inherited: dict[str, dict[str, str]]
    ) -> None:
        """Resolves a class of defaults, and those inside of it."""
        known = self._classes.get(name, inherited)
        mine = {tag: dict(values) for tag, values in known.items()}
        for child in default:
            if child.tag != "default":
                tag = "actuator" if child.tag in MOTORS else child.tag
                mine.setdefault(tag, {}).update(child.attrib)
        self._classes[name] = mine
        for child in default.findall("default"):
            self._read_class(child, child.get("class", "main"), mine)

    def _walk(self) -> Iterator[tuple[Element, str]]:
        """Yields bodies, and the class of what is in them."""
        pending = [(body, "main") for body in self.root.findall("worldbody")]
        for body, outer in pending:  # It grows meanwhile.
            childclass = body.get("childclass", outer)
            yield body, childclass
            pending += [(child, childclass) for child in body.findall("body")]


def _include(parent: Element, folder: Path, above: tuple[Path, ...]) -> None:
    """Puts what files include in place of <include>, however deep."""
    for i in reversed(range(len(parent))):
        child = parent[i]
        if child.tag != "include":
            _include(child, folder, above)
            continue
        file = folder / child.get("file", "")
        if file in above or not file.is_file():
            raise ModelError(
                f"model {above[0]}",
                got=f"an <include> of {file}, which "
                + ("includes itself" if file in above else "is missing"),
                expected="a file that is there",
                remedy="Paths of <include> are relative to the model's file.",
            )
        included = read_xml(file)
        _include(included, folder, (*above, file))
        parent[i : i + 1] = list(included)


def _merge(elements: list[Element]) -> dict[str, str]:
    """Returns the attributes of several sections, of which later ones count."""
    return {key: value for element in elements for key, value in element.attrib.items()}
