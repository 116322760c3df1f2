"""Loads Mitsuba scenes and turns what Mitsuba refuses into one-line errors."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi

from compose.base.errors import UserError
from compose.camera.place import Place
from pathtrace.scene.plugins import mitsuba_folder
from pathtrace.scene.relocation import ImmovableError, camera_position, coarsest_step, relocate


@dataclass(frozen=True)
class Source:
    """What a scene is loaded from.

    Attributes:
        name: in error messages.
        content: XML text, or a scene dictionary.
        folder: that files in the XML are relative to.
    """

    name: str
    content: str | dict[str, Any]
    folder: Path | None = None


def load_mitsuba_in_place(
    source: Source, unit: float, apart: Collection[str] = ()
) -> tuple[Any, Place, float]:
    """A Mitsuba scene in coordinates of its own, whose origin is the first camera.

    Args:
        source: of the scene.
        unit: of length, in world space.
        apart: ids of shapes that are not to be merged with others.

    Returns:
        The scene, its place, and the step of float32 at vertices that a mesh file holds far from the origin.

    Raises:
        UserError: Mitsuba refuses the scene, or it has a part that cannot be moved or scaled.
    """
    found: list[tuple[Place, float]] = []

    def moved(state: Any) -> None:
        x, y, z = camera_position(state).tolist()
        found.append((Place((x, y, z), unit), coarsest_step(state)))
        relocate(state, found[0][0])

    try:
        scene = _parsed(source, apart, moved)
    except UserError as error:
        if isinstance(error.__cause__, ImmovableError):
            raise UserError(
                f"{source.name}: too small or too far from the origin for Mitsuba's float32, and "
                f"{error.__cause__} in it cannot be moved or scaled; place the scene near the origin, in a "
                "unit of length in which it is 1 to 1000 large"
            ) from error
        raise
    return scene, *found[0]


def load_mitsuba(source: Source, apart: Collection[str] = ()) -> Any:
    """A Mitsuba scene, whose meshes Mitsuba merges, by which tracing is twice as fast.

    Args:
        source: of the scene.
        apart: ids of shapes that are not to be merged with others; these keep their ids.

    Raises:
        UserError: Mitsuba refuses it, or it is not a scene.
    """
    if apart:
        return _parsed(source, apart, lambda state: None)
    # As this loads in parallel.
    is_dictionary = isinstance(source.content, dict)
    load = partial(mi.load_dict if is_dictionary else mi.load_string, source.content)
    return _checked(source.name, load if source.folder is None else lambda: _in(source.folder, load))


def _parsed(source: Source, apart: Collection[str], changed: Callable[[Any], None]) -> Any:
    """A Mitsuba scene from its parsed description, which is changed before anything is made of it."""
    configuration = mi.parser.ParserConfig(mi.variant())
    # In parallel, Mitsuba 3.9.1 makes scenes of which Dr.Jit may stumble over the arrays later, and crash.
    configuration.parallel = False

    def load() -> Any:
        if isinstance(source.content, dict):
            state = mi.parser.parse_dict(configuration, source.content)
        else:
            state = mi.parser.parse_string(configuration, source.content)
        changed(state)
        _simplify(configuration, state, apart)
        loaded = mi.parser.instantiate(configuration, state)
        return loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded

    return _checked(source.name, load if source.folder is None else lambda: _in(source.folder, load))


def _simplify(configuration: Any, state: Any, apart: Collection[str]) -> None:
    """Mitsuba's own simplifications of a parsed scene, but for shapes that are to stay as they are."""
    if not apart:
        mi.parser.transform_all(configuration, state)
        return
    mi.parser.transform_upgrade(configuration, state)
    mi.parser.transform_resolve(configuration, state)
    # While the whole scene is there: what does not hang on it would go on referring to what was merged.
    mi.parser.transform_merge_equivalent(configuration, state)
    root = state.root.props
    # Mitsuba merges what hangs on the scene.
    nodes = {
        key: state.nodes[root[key].index()]
        for key in root.keys()  # noqa: SIM118 - not a dictionary
        if root.type(key) == mi.Properties.Type.ResolvedReference
    }
    held = {key: root[key] for key, node in nodes.items() if node.props.id() in apart}
    # Mitsuba 3.9.1 crashes where there is no shape to merge.
    if any(node.type == mi.ObjectType.Shape for key, node in nodes.items() if key not in held):
        for key in held:
            del root[key]
        mi.parser.transform_merge_meshes(configuration, state)
        for key, reference in held.items():
            root[key] = reference
    mi.parser.transform_reorder(configuration, state)


def _checked(source: str, load: Callable[[], Any]) -> Any:
    try:
        loaded = load()
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        # Mitsuba's first lines name a position in its own code; the last one says what is wrong.
        raise UserError(f"{source}: Mitsuba refuses the scene: {lines[-1] if lines else error}") from error
    if isinstance(loaded, list) or not isinstance(loaded, mi.Scene):
        raise UserError(f"{source}: not a complete scene; the top element must be <scene>")
    return loaded


def _in(folder: Path | None, load: Callable[[], Any]) -> Any:
    """Loads a scene whose files are relative to a folder."""
    resolver = mi.file_resolver()
    before = [resolver[i] for i in range(len(resolver))]
    resolver.prepend(str(folder))
    # Before the scene's folder, from which plugins, which are native code, would be loaded as well.
    resolver.prepend(str(mitsuba_folder()))
    try:
        return load()
    finally:
        # The resolver is shared by the process; a folder left in it would shadow the next scene's files.
        resolver.clear()
        for entry in before:
            resolver.append(entry)
