"""Validation of YAML files that people write: models, or every error with its place.

Mission and fleet files share these rules: YAML 1.2, bounded size, no duplicate keys, unknown keys
refused, NaN and infinities refused. Errors read ``file:line: key.path: expected …, got …``; what a
``--set`` override gives has no line.
"""

import io
import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.resolver import VersionedResolver

from swarm.errors import InputError, Problem, nearest, shown
from swarm.files import DEEPEST_NESTING


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
    lines: dict[tuple[str, ...], int] = {}
    _collect(root, (), lines)
    for override in overrides:
        replaced = tuple(key.strip() for key in override.partition("=")[0].split("."))
        lines = {
            keys: line for keys, line in lines.items() if keys[: len(replaced)] != replaced
        } | {replaced: 0}
    return lines


def line_of(keys: Sequence[str], lines: Mapping[tuple[str, ...], int]) -> int | None:
    """Return the line of a key, or of the innermost section that the text has of its path.

    None without a line: for the whole file, and for what an override gives.
    """
    for count in range(len(keys), 0, -1):
        line = lines.get(tuple(keys[:count]))
        if line is not None:
            return line or None
    return None


def _collect(node: Node, path: tuple[str, ...], lines: dict[tuple[str, ...], int]) -> None:
    if isinstance(node, MappingNode):
        for key, value in node.value:
            inner = (*path, str(key.value))
            lines[inner] = key.start_mark.line + 1
            _collect(value, inner, lines)
    elif isinstance(node, SequenceNode):
        for place, value in enumerate(node.value):
            inner = (*path, str(place))
            lines[inner] = value.start_mark.line + 1
            _collect(value, inner, lines)


_UNITS: Mapping[str, Mapping[str, float]] = {
    "metres": {"mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "kg": {"g": 1e-3, "kg": 1.0},
    "kg/m": {"g/m": 1e-3, "kg/m": 1.0},
    "m/s": {"km/h": 1.0 / 3.6, "m/s": 1.0},
    "m/s²": {"mm/s²": 1e-3, "m/s²": 1.0},
    "newtons": {"mN": 1e-3, "N": 1.0},
    "s": {"ms": 1e-3, "s": 1.0, "min": 60.0},
}
"""Unit of a key → the units that people write, in this unit."""


_LARGER_UNITS: Mapping[str, float] = {"s": 60.0}
"""Unit of a key → the larger unit that people write, in this unit: minutes."""

_ALIKE = 4.0
"""Largest ratio of a value in minutes to the default: endurances are 5 to 40 minutes, by default
10."""


def other_unit(value: float, unit: str, bounds: tuple[float, float], typical: Any) -> str:
    """Return ``: did you mean …?`` for a value out of bounds that was given in another unit.

    Of several units the one is chosen whose value is nearest to the ``typical`` one. Empty for a
    value in its bounds, and where no unit fits.
    """
    least, most = bounds
    known = isinstance(typical, int | float) and typical > 0
    smaller = [share for share in _UNITS.get(unit, {}).values() if share < 1.0]
    values = [share * value for share in smaller if value > most]
    values = [guess for guess in values if least <= guess <= most]
    if 0 < value < least and known and unit in _LARGER_UNITS:
        longer = _LARGER_UNITS[unit] * value
        values = [longer] if 1.0 / _ALIKE <= longer / typical <= _ALIKE else []
    if not values:
        return ""
    likely = min(values, key=lambda guess: abs(math.log(guess / typical))) if known else values[0]
    return f": did you mean {likely:.3g}?"


LARGEST_FILE = 1_000_000
"""Largest number of characters of a mission or fleet file."""

MOST_VALUES = 50_000
"""Most values of a YAML file, lists and mappings included: a fleet of 249 vehicles has 4,000."""

Model = TypeVar("Model", bound=BaseModel)


class Section(BaseModel):
    """Base of every section of a file: immutable, no unknown keys, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def number(
    default: Any,
    unit: str,
    sentence: str,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    kind: str = "a number",
    auto: bool = False,
) -> Any:
    """Declare a numeric key with its unit, range and the sentence that the schema shows.

    ``above`` is an exclusive lower bound, ``least`` and ``most`` are inclusive bounds. ``kind`` is
    the noun in error messages. With ``auto`` the word ``auto`` is valid too, and the type of the
    key holds the range.
    """
    bounds = [
        *([f"> {above:g}"] if above is not None else []),
        *([f">= {least:g}"] if least is not None else []),
        *([f"<= {most:g}"] if most is not None else []),
    ]
    words = " ".join([kind, *([" and ".join(bounds)] if bounds else [])])
    if unit:
        words += f" in {unit}"
    if auto:
        words = f"auto or {words}"
    extra: dict[str, Any] = {"unit": unit, "expected": words}
    if least is not None:
        extra["minimum"] = least
    if most is not None:
        extra["maximum"] = most
    return Field(
        default,
        gt=None if auto else above,
        ge=None if auto else least,
        le=None if auto else most,
        description=sentence,
        json_schema_extra=extra,
    )


def parse_yaml(text: str, source: str) -> Any:
    """Return the data of YAML 1.2 text from an untrusted source.

    Raises :class:`InputError`, with line and column for a syntax error or a repeated key, and for
    text that is too large or nested too deeply.
    """
    if len(text) > LARGEST_FILE:
        raise InputError([Problem(source, f"expected at most {LARGEST_FILE} characters")])
    loader = YAML(typ="safe", pure=True)
    loader.Resolver = _KnotNameResolver
    try:
        _refuse_hostile(loader, text, source)
        return loader.load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{source}:{mark.line + 1}:{mark.column + 1}" if mark else source
        problem = str(error.problem or error.context or "not YAML").strip().splitlines()[0]
        raise InputError([Problem(place, f"not valid YAML: {problem}")]) from None
    except (YAMLError, ValueError) as error:
        raise InputError([Problem(source, f"not valid YAML: {error}")]) from None


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """Return valid YAML text with other values of keys at its top.

    Comments and the other values stay; line breaks and indents may change.
    """
    yaml = YAML()
    yaml.Resolver = _KnotNameResolver
    yaml.width, yaml.preserve_quotes = LARGEST_FILE, True
    yaml.indent(mapping=2, sequence=4, offset=2)
    document = yaml.load(text)
    document.update(values)
    written = io.StringIO()
    yaml.dump(document, written)
    return written.getvalue()


class _KnotNameResolver(VersionedResolver):  # type: ignore[misc]
    """Reads plain scalars with an underscore as text: ``3_1`` is a knot, not the number 31."""

    def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
        if kind is ScalarNode and implicit[0] and "_" in value:
            return self.DEFAULT_SCALAR_TAG
        return super().resolve(kind, value, implicit)


def _refuse_hostile(loader: YAML, text: str, source: str) -> None:
    """Raise :class:`InputError` for text that takes a parser, or a reader of errors, too long."""
    depth = 0
    for count, event in enumerate(loader.parse(text)):
        name = type(event).__name__
        if name == "AliasEvent":
            raise InputError([Problem(source, "YAML aliases are not supported")])
        depth += name.endswith("StartEvent") - name.endswith("EndEvent")
        if depth > DEEPEST_NESTING:
            raise InputError([Problem(source, f"nested more than {DEEPEST_NESTING} deep")])
        if count > MOST_VALUES:
            raise InputError([Problem(source, f"expected at most {MOST_VALUES:,} values")])


def apply_overrides(document: Any, overrides: Iterable[str]) -> Any:
    """Return the document with ``key.path=value`` overrides applied; values are YAML.

    Raises :class:`InputError` naming every override that cannot be applied.
    """
    result = document
    problems: list[Problem] = []
    for override in overrides:
        path, equals, value = override.partition("=")
        keys = [key.strip() for key in path.split(".")]
        if not equals or not all(keys):
            problems.append(Problem("--set", f"expected key.path=value, got {override!r}"))
            continue
        try:
            result = _replaced(result, keys, parse_yaml(value, f"--set {path}"))
        except InputError as error:
            problems.extend(error.problems)
    if problems:
        raise InputError(problems)
    return result


def _replaced(document: Any, keys: list[str], value: Any) -> Any:
    if not keys:
        return value
    head, *rest = keys
    if document is None:
        document = {}
    if not isinstance(document, Mapping):
        document = {}  # the model reports the expected type
    return {**document, head: _replaced(document.get(head), rest, value)}


def validate(
    model: type[Model], document: Any, source: str, text: str = "", overrides: Iterable[str] = ()
) -> Model:
    """Return the model of a parsed document.

    ``text`` is the file's text and ``overrides`` are those that were applied to the document; the
    lines in messages are found by them. Raises :class:`InputError` with every problem, each at
    ``source:line: key.path``.
    """
    if not isinstance(document, Mapping):
        raise InputError([Problem(source, f"expected a mapping of keys, got {shown(document)}")])
    try:
        return model.model_validate(document)
    except ValidationError as error:
        lines = key_lines(text, overrides)
        items = [_of_choice(dict(item)) for item in error.errors()]
        items = [item for item in items if not _only_invalid(item)]
        items.sort(key=lambda item: line_of(_named(item["loc"]), lines) or 0)
        problems = [_problem(model, document, item, source, lines) for item in items]
        raise InputError(_with_hints(list(dict.fromkeys(problems)))) from None


def _with_hints(problems: list[Problem]) -> list[Problem]:
    """Return the problems without those that are there once more with a hint.

    A value that may be a number or a word is reported as both, and only as a word with a hint.
    """
    hinted = {
        (problem.place, problem.message.split(": did you mean")[0])
        for problem in problems
        if ": did you mean" in problem.message
    }
    return [problem for problem in problems if (problem.place, problem.message) not in hinted]


def read_model(model: type[Model], text: str, source: str, overrides: Iterable[str] = ()) -> Model:
    """Return the model of a YAML text with ``key.path=value`` overrides.

    Raises :class:`InputError` with every problem at once; ``source`` names the file in it.
    """
    overrides = tuple(overrides)
    document = apply_overrides(parse_yaml(text, source), overrides)
    return validate(model, document, source, text, overrides)


def _of_choice(item: dict[str, Any]) -> dict[str, Any]:
    """Return an error in which of several sections an entry is as one of the key that says it."""
    choice = str(item.get("ctx", {}).get("discriminator", "")).strip("'")
    if not choice:
        return item
    given, wrong = item["input"].get(choice), item["type"] == "union_tag_invalid"
    return item | {
        "type": "literal_error" if wrong else "missing",
        "loc": (*item["loc"], choice),
        "input": given,
        "ctx": {"expected": item["ctx"].get("expected_tags")},
    }


def _only_invalid(item: dict[str, Any]) -> bool:
    """Return whether a sequence is too short only without its invalid items, which are reported."""
    given = item["input"]
    return (
        item["type"] == "too_short"
        and isinstance(given, Sequence)
        and len(given) >= int(item["ctx"]["min_length"])
    )


def _named(location: tuple[int | str, ...]) -> list[str]:
    return [str(part) for part in location]


def place_of(source: str, keys: Sequence[str], lines: Mapping[tuple[str, ...], int]) -> str:
    """Return the place of a key path for messages: ``source:line: key.path``."""
    line = line_of(keys, lines)
    where = source if line is None else f"{source}:{line}"
    return ": ".join(part for part in (where, ".".join(keys)) if part)


def _problem(
    model: type[BaseModel],
    document: Any,
    item: dict[str, Any],
    source: str,
    lines: Mapping[tuple[str, ...], int],
) -> Problem:
    keys, field = _named_field(model, item["loc"])
    place = place_of(source, keys, lines)
    if name := _entry_name(document, keys):
        place += f" ({name})"
    got = f"got {shown(item['input'])}"
    match item["type"]:
        case "extra_forbidden":
            return Problem(place, f"unknown key, {got}{_nearest_key(model, keys)}")
        case "missing" if not isinstance(item["loc"][-1], int):
            purpose = f" ({field.description})" if field and field.description else ""
            examples = field.examples if field else None
            example = f"; for example: {keys[-1]}: {examples[0]}" if examples else ""
            return Problem(place, f"expected this key{purpose}, got nothing{example}")
        case "value_error":
            return Problem(place, str(item["ctx"]["error"]))
        case "literal_error" if isinstance(item["input"], str):
            choices = re.findall(r"'([^']*)'", item["ctx"]["expected"])
            hint = nearest(item["input"], choices)
            return Problem(place, f"expected {_expected(field, item)}, {got}{hint}")
        case _:
            hint = _other_unit(field, item["input"])
            return Problem(place, f"expected {_expected(field, item)}, {got}{hint}")


def _entry_name(document: Any, keys: Sequence[str]) -> str:
    """Return the name of the innermost entry of a list that has one, on the way to a key."""
    name = ""
    for key in keys:
        if isinstance(document, Mapping):
            document = document.get(key)
        elif isinstance(document, list | tuple):
            document = dict(enumerate(document)).get(int(key) if key.isdecimal() else -1)
            given = document.get("name") if isinstance(document, Mapping) else None
            name = given if isinstance(given, str) else name
    return name


def _nearest_key(model: type[BaseModel], keys: list[str]) -> str:
    """Return a hint: the nearest key of this section, or the section that has the key."""
    section: Any = model
    for key in keys[:-1]:
        field = section.model_fields.get(key)
        section = _section_of(field.annotation) if field else None
        if section is None:
            return ""
    names = [field.alias or key for key, field in section.model_fields.items()]
    hint = nearest(keys[-1], names)
    if hint:
        return hint
    homes = [
        f"{name}.{keys[-1]}"
        for name, field in model.model_fields.items()
        if (inner := _section_of(field.annotation)) is not None and keys[-1] in inner.model_fields
    ]
    return f": did you mean {' or '.join(homes)}?" if homes else ""


def _other_unit(field: FieldInfo | None, value: Any) -> str:
    """Return a hint for a number beyond its range that would be in range in another unit."""
    extra = field.json_schema_extra if field else None
    if field is None or not isinstance(extra, dict):
        return ""
    if isinstance(value, str):
        return _without_unit(value, str(extra.get("unit")))
    if not _is_finite_number(value):
        return ""
    least, most = extra.get("minimum", 0.0), extra.get("maximum", math.inf)
    if not isinstance(least, int | float) or not isinstance(most, int | float):
        return ""
    return other_unit(value, str(extra.get("unit")), (least, most), field.default)


def _without_unit(text: str, unit: str) -> str:
    """Return a hint: the number of a text such as ``10cm``, in the unit of its key."""
    match = re.fullmatch(r"([\d.]+) ?(\D+)", text.strip())
    share = _UNITS.get(unit, {}).get(match[2]) if match else None
    try:
        return f": write {share * float(match[1]):.6g}" if match and share else ""
    except ValueError:  # several points
        return ""


def _is_finite_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max  # YAML has integers without a limit


def _named_field(
    model: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[list[str], FieldInfo | None]:
    """Return the key path of an error without pydantic's union tags, and its innermost field."""
    keys: list[str] = []
    field: FieldInfo | None = None
    inside: Sequence[type[BaseModel]] = [model]
    for part in location:
        if isinstance(part, int):
            keys.append(str(part))
        elif chosen := [
            section for section in inside if len(inside) > 1 and _has_tag(section, part)
        ]:
            inside = chosen
        elif inside:
            keys.append(part)
            if part not in inside[0].model_fields:
                return keys, None
            field = inside[0].model_fields[part]
            inside = _sections_of(field.annotation)
    return keys, field


def _has_tag(section: type[BaseModel], tag: str) -> bool:
    """Return whether a key of a section takes only this word, by which it is told from others."""
    return any(get_args(field.annotation) == (tag,) for field in section.model_fields.values())


def _section_of(annotation: Any) -> Any:
    """Return the model of an annotation: bare, optional or as the element of a list."""
    return next(iter(_sections_of(annotation)), None)


def _sections_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the models of an annotation: several where an entry is one of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    arguments = getattr(annotation, "__args__", ())
    return [section for argument in arguments for section in _sections_of(argument)]


def _expected(field: FieldInfo | None, item: dict[str, Any]) -> str:
    extra = field.json_schema_extra if field else None
    if isinstance(extra, dict) and "expected" in extra:
        return _violated(str(extra["expected"]), item["input"], extra.get("maximum"))
    match item["type"]:
        case "literal_error":
            return str(item["ctx"]["expected"]).replace("'", "")
        case "model_type" | "dict_type" | "model_attributes_type":
            return "a mapping of keys"
        case "string_type":
            return "text"
        case "less_than_equal" | "greater_than_equal" | "greater_than":
            return f"a number {_SIGNS[item['type']]} {next(iter(item['ctx'].values())):g}"
        case _:
            return str(item["msg"]).removeprefix("Input should be ")


_SIGNS = {"less_than_equal": "<=", "greater_than_equal": ">=", "greater_than": ">"}


def _violated(expected: str, value: Any, most: Any) -> str:
    """Return what was expected without the bound that a number keeps."""
    if most is None or not _is_finite_number(value):
        return expected
    if value > most:
        return re.sub(r">=? \S+ and (?=<= )", "", expected)
    return re.sub(r" and <= \S+", "", expected)
