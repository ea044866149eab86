"""Lines of the keys of a YAML text, for messages."""

from collections.abc import Iterable, Mapping, Sequence

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode


def key_lines(text: str, overrides: Iterable[str] = ()) -> dict[tuple[str, ...], int]:
    """Return key path → line, from 1, of a valid YAML text; a list's entries are keys from 0.

    Keys that an override (``key.path=value``) replaces are left out, with all keys inside.
    """
    if not text:
        return {}
    try:
        root = YAML(typ="safe", pure=True).compose(text)
    except (YAMLError, ValueError):
        return {}
    found: dict[tuple[str, ...], int] = {}
    _collect(root, (), found)
    for override in overrides:
        replaced = tuple(key.strip() for key in override.partition("=")[0].split("."))
        found = {
            keys: line for keys, line in found.items() if keys[: len(replaced)] != replaced
        } | {replaced: 0}
    return found


def line_of(keys: Sequence[str], lines: Mapping[tuple[str, ...], int]) -> int | None:
    """Return the line of a key, or of the innermost section that the text has of its path.

    None without a line: for the whole file, and for what an override gives.
    """
    for count in range(len(keys), 0, -1):
        line = lines.get(tuple(keys[:count]))
        if line is not None:
            return line or None
    return None


def _collect(node: Node, path: tuple[str, ...], found: dict[tuple[str, ...], int]) -> None:
    if isinstance(node, MappingNode):
        for key, value in node.value:
            inner = (*path, str(key.value))
            found[inner] = key.start_mark.line + 1
            _collect(value, inner, found)
    elif isinstance(node, SequenceNode):
        for place, value in enumerate(node.value):
            inner = (*path, str(place))
            found[inner] = value.start_mark.line + 1
            _collect(value, inner, found)
