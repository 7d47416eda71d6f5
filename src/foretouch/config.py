# SPDX-License-Identifier: Apache-2.0
"""Typed settings: one frozen dataclass per component, read from YAML and `key=value`.

A component declares its settings in its own module::

    @dataclass(frozen=True, kw_only=True)
    class CropConfig(Settings):
        max_range_m: float = setting(2.0, "Points farther than this are ignored", bounds=(0.1, 16.0))

The fields contain the description, unit, bounds and whether a running node may change them. The
command line, the YAML reader and the ROS parameters are all derived from this declaration.
"""

import dataclasses
import inspect
import math
import re
import typing
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import yaml

from foretouch.base.files import read_bytes, text_in, whole_number
from foretouch.errors import ConfigError, FileError, nearest, none_of, quoted, require_type, shown

_YAML_DEPTH: Final = 32  # levels of lists and mappings; no setting has more than 6
_YAML_BYTES: Final = 100_000  # the largest file of the package has 5000
_YAML_SUFFIXES: Final = (".yaml", ".yml")
_NAME: Final = 200  # characters of a name that is looked for among known ones
_TURN: Final = 6.3  # [rad]
_MOST_ALIASES: Final = 100
_MOST_GROUPS: Final = 1000  # of a list, such as fingers; each takes a tenth of a millisecond and more

EMPTY: Final = "\0"
"""Stands for the value of `key:` in YAML and of `key=`, which has none; no setting accepts this text."""


_INT: Final = "tag:yaml.org,2002:int"
_FLOAT: Final = "tag:yaml.org,2002:float"
_UNITS: Final = {
    "hz": "Hz",
    "mb": "MB",
    "pa": "Pa",
    "n": "N",
    "kelvin": "K",
    **{unit: unit for unit in ("s", "ms", "ns", "m", "mm", "deg", "counts", "days", "kg")},
}  # by the last word of a name
_OPENCV_HEAD: Final = re.compile(r"\A%YAML:1\.\d[ \t]*\r?\n")  # which OpenCV writes, and which is no directive of YAML
_DECIMAL: Final = r"[-+]?(\.\d+|\d+(\.\d*)?)([eE][-+]?\d+)?$|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # in C ten times as fast
    """The safe loader, for which numbers are decimal as in YAML 1.2, and which keeps `key:` and `key: null` apart.

    In YAML 1.1, `010` is 8, `1:30` is 90, `1_0` is 10 and `1e3` a text. A key that occurs twice is refused.
    """

    yaml_implicit_resolvers: ClassVar = {
        **{
            first: [(tag, rule) for tag, rule in rules if tag not in (_INT, _FLOAT)]
            for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
        },
        "": [("!empty", re.compile("$"))],
    }

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if len(set(keys)) < len(keys):
            raise yaml.YAMLError(f"key {shown(max(keys, key=keys.count))} occurs twice")
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """The safe dumper, which quotes texts that `_Loader` would take for numbers."""


_Loader.add_constructor("!empty", lambda *_: EMPTY)
_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
)
_Loader.add_constructor(_INT, lambda loader, node: whole_number(loader.construct_scalar(node)))
for _kind in (_Loader, _Dumper):
    _kind.add_implicit_resolver(_INT, re.compile(r"[-+]?\d+$"), list("-+0123456789"))
    _kind.add_implicit_resolver(_FLOAT, re.compile(_DECIMAL), list("-+.0123456789"))

_S = typing.TypeVar("_S", bound="Settings")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SettingInfo:
    """Declaration of one setting."""

    name: str  # field name; names of nested settings are joined with dots
    type: type  # bool, int, float, str, or a tuple's item type with `is_list`
    default: Any  # default value
    description: str  # one sentence
    unit: str  # unit of the value, "" if it has none; by default the end of its name, such as `range_m`
    minimum: float | None  # inclusive, or None
    maximum: float | None  # inclusive, or None
    choices: Collection[Any]  # allowed values; empty if unrestricted
    read_only: bool  # whether a running node rejects changes
    is_list: bool  # whether it is a tuple of `type`
    optional: bool  # whether None is allowed


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    bounds: tuple[float | None, float | None] | None = None,
    minimum: float | None = None,
    choices: Collection[Any] = (),
    read_only: bool = False,
) -> Any:
    """Declare one field of a `Settings` dataclass.

    Args:
        default: Value where none is given.
        description: One line for help, reference and ROS.
        unit: Unit of the value; by default the end of its name, such as `range_m`.
        bounds: Least and largest value, both allowed.
        minimum: Least value, where there is no largest one.
        choices: The only values that are allowed.
        read_only: Whether a running node refuses changes.
    """
    low, high = (minimum, None) if bounds is None else bounds
    limits = {"minimum": low, "maximum": high, "choices": choices, "read_only": read_only}
    return dataclasses.field(default=default, metadata={"description": description, "unit": unit, **limits})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of every component's settings; checks each value on construction.

    Subclasses with rules across fields extend `__post_init__` and call this one first. Those with the argument
    `read_only=True` declare read-only settings alone.

    Raises:
        ConfigError: With the field, the value and the rule.
    """

    _all_read_only: ClassVar[bool] = False

    def __init_subclass__(cls, *, read_only: bool = False) -> None:
        cls._all_read_only = read_only

    def __post_init__(self) -> None:
        for info in _own_infos(type(self)):
            object.__setattr__(self, info.name, _checked(info, getattr(self, info.name)))
        for name, hint in _GROUPS[type(self)].items():
            item, is_list, _ = _analyse(hint)
            value = getattr(self, name)
            groups = value if is_list and isinstance(value, tuple) else (value,)
            if not all(isinstance(group, item) for group in groups):
                object.__setattr__(self, name, _field_value(hint, value, "", name))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], source: str = "") -> Self:
        """Make settings from plain data, such as a YAML document.

        Args:
            mapping: Values by nested or dotted keys; what is absent keeps its default.
            source: Where they are from, for errors.

        Raises:
            ConfigError: Names source and key: it is unknown, or its value of another type or out of bounds.
        """
        return _build(cls, _nested(mapping, source), f"{source}: " if source else "", "")

    def replace(self, **changes: Any) -> Self:
        """Return a checked copy with some fields changed."""
        return dataclasses.replace(self, **changes)

    def updated(self, changes: Mapping[str, Any], source: str = "") -> Self:
        """Return a copy with some settings changed.

        Args:
            changes: New values by nested or dotted keys.
            source: Where they are from, for errors.

        Raises:
            ConfigError: Names source and key: it is unknown, or its value of another type or out of bounds.
        """
        merged = self.to_mapping()
        _merge(merged, _nested(changes, source))
        return self.from_mapping(merged, source)

    def to_mapping(self) -> dict[str, Any]:
        """Return plain nested data that `from_mapping` accepts."""
        return {f.name: _plain(getattr(self, f.name)) for f in dataclasses.fields(self)}


def setting_infos(cls: type[Settings], prefix: str = "") -> list[SettingInfo]:
    """Return all settings of `cls` in order of declaration, nested ones with dotted names.

    Lists of groups and optional groups have no fixed names and are omitted.
    """
    infos: list[SettingInfo] = []
    own = {info.name: info for info in _own_infos(cls)}
    hints = typing.get_type_hints(cls)
    for f in dataclasses.fields(cls):
        if f.name in own:
            infos.append(dataclasses.replace(own[f.name], name=prefix + f.name))
        elif isinstance(hints[f.name], type):
            infos.extend(setting_infos(hints[f.name], f"{prefix}{f.name}."))
    return infos


def load_yaml(path: str | Path, limit: int = _YAML_BYTES, *, first: bool = False) -> dict[str, Any]:
    """Load a YAML mapping safely.

    Args:
        path: The file.
        limit: Its largest size [bytes].
        first: Whether to take the first of several documents, as `ros2 topic echo` prints them; others are refused.

    Raises:
        ConfigError: If the file cannot be read, is too large or is not a mapping.
    """
    try:
        document = _parse_yaml(text_in(path, read_bytes(path, limit)), first=first)
    except FileError as err:
        raise ConfigError(str(err)) from err
    except ValueError as err:
        raise ConfigError(f"{shown(path)}: not YAML: {shown(' '.join(str(err).split()), 500)}") from err
    if document is not None and not isinstance(document, dict):
        raise ConfigError(f"{shown(path)}: holds a {type(document).__name__}, not a mapping")
    return document or {}


def _parse_yaml(text: str, *, first: bool = False) -> Any:
    """Return the document in a YAML text, loaded safely; a ValueError if it is not YAML, nests too deep, or aliases repeat too much."""
    text = _OPENCV_HEAD.sub("", text)
    level = repeated = aliases = 0  # `repeated` is the level of the outermost open group with an anchor
    try:
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.CollectionStartEvent):
                level += 1
                repeated = repeated or (level if event.anchor else 0)
            elif isinstance(event, yaml.CollectionEndEvent):
                repeated = repeated if repeated < level else 0
                level -= 1
            aliases += isinstance(event, yaml.AliasEvent)
            if level > _YAML_DEPTH:
                raise yaml.YAMLError(f"more than {_YAML_DEPTH} nested levels")
            if isinstance(event, yaml.AliasEvent) and (repeated or aliases > _MOST_ALIASES):
                raise yaml.YAMLError(f"alias {shown(event.anchor)}: one within another, or more than {_MOST_ALIASES}")
        if first:
            return next(yaml.load_all(text, Loader=_Loader), None)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader, in C where it is installed
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as err:
        raise ValueError(str(err) or type(err).__name__) from err  # constructors of numbers and dates raise them


def description_file(name: str | Path, known: Mapping[str, Path]) -> Path:
    """Return the file of a description; whether it exists is checked where it is read.

    Args:
        name: Of a YAML file, or of a description of the package; as a user or a message gives it.
        known: The files of the package, by name.

    Raises:
        ConfigError: If it is neither.
    """
    if not isinstance(name, str | Path):
        raise ConfigError(f"{shown(name)} is neither a name nor a path")
    path = Path(name)
    if path.suffix.lower() in _YAML_SUFFIXES:
        return path
    if str(name) not in known:
        kind = f"a file ({_YAML_SUFFIXES[0]})" if path.suffix else "a file"
        hint = nearest(str(name)[:_NAME], known)
        raise ConfigError(f"{shown(path)}: is neither {kind} nor one of {', '.join(known)}{hint}")
    return known[str(name)]


def load_description(path: str | Path, settings: type[_S], what: str, more: Sequence[str] = ()) -> _S:
    """Load a description from a YAML file; of a file that is none, no content is reported, since anyone may name it.

    Args:
        path: The file.
        settings: Class of the description.
        what: What it describes, for messages.
        more: Keys that it has besides the settings.

    Raises:
        ConfigError: If the file cannot be read, is no such description, or breaks a rule; names file, field and rule.
    """
    known = [*(f.name for f in dataclasses.fields(settings)), *more]
    try:
        text = read_bytes(path, _YAML_BYTES).decode("utf-8", "replace")
    except FileError as err:
        raise ConfigError(str(err)) from err
    named = re.search(rf"^[\s{{'\"]*({'|'.join(known)})['\"]?\s*:", text, re.MULTILINE) is not None
    try:
        stated = load_yaml(path)
    except ConfigError:
        if named:
            raise
        raise ConfigError(f"{shown(path)}: not YAML that describes {what}") from None
    strange = sum(str(key).partition(".")[0] not in known for key in stated)
    if strange == len(stated) or 2 * strange > len(stated):
        raise ConfigError(f"{shown(path)}: is no description of {what}, whose settings are {', '.join(known)}")
    return settings.from_mapping(stated, str(path))


def require_units(settings: Settings, *, angles: Sequence[str] = (), lengths: Sequence[str] = ()) -> None:
    """Refuse angles of more than a full turn [rad], and lengths of more than a metre [m], as degrees and millimetres are.

    Raises:
        ConfigError: Names the setting and asks for its unit.
    """
    for names, limit, rule in (
        (angles, _TURN, "exceeds a full turn: is it in degrees? Angles are in rad"),
        (lengths, 1.0, "is longer than a hand: is it in mm? Lengths are in m"),
    ):
        for name in names:
            value = getattr(settings, name)
            largest = max(value if isinstance(value, tuple) else (value,), key=abs, default=0.0)
            if abs(largest) > limit:
                raise ConfigError(f"{name}: {largest:g} {rule}")


def dump_yaml(document: Mapping[str, Any]) -> str:
    """Return the text of a YAML mapping in its order, which `load_yaml` reads as it was."""
    return yaml.dump(dict(document), Dumper=_Dumper, sort_keys=False)


def flattened(values: Any, name: str = "") -> dict[str, Any]:
    """Return nested mappings by dotted name."""
    if not isinstance(values, Mapping):
        return {name: values}
    return {key: leaf for k, v in values.items() for key, leaf in flattened(v, f"{name}.{k}" if name else k).items()}


def parse_overrides(pairs: Sequence[str]) -> dict[str, Any]:
    """Parse `["a.b=1", "c=x"]` to `{"a.b": 1, "c": "x"}`; values are YAML scalars or lists.

    Raises:
        ConfigError: For a word without `=` or a value that is not YAML.
    """
    result: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key:
            raise ConfigError(f"{shown(pair)}: is not key=value")
        try:
            result[key] = _parse_yaml(text) if text.strip() else EMPTY
        except ValueError as err:
            raise ConfigError(f"{shown(key)}: {quoted(text)} is not a YAML value") from err
    return result


_INFOS: dict[type, tuple[SettingInfo, ...]] = {}
_GROUPS: dict[type, dict[str, Any]] = {}  # annotations of the fields that are groups, of a class in `_INFOS`


def _own_infos(cls: type[Settings]) -> tuple[SettingInfo, ...]:
    """Return the settings of a class without the settings of its groups, found out once."""
    if cls in _INFOS:
        return _INFOS[cls]
    hints = typing.get_type_hints(cls)
    infos, groups = [], dict[str, Any]()
    for f in dataclasses.fields(cls):
        item, is_list, optional = _analyse(hints[f.name])
        if issubclass(item, Settings):
            groups[f.name] = hints[f.name]
            continue
        if "description" not in f.metadata:
            raise TypeError(f"{cls.__name__}.{f.name}: declare it with setting()")
        quantity, _, ending = f.name.rpartition("_")
        owner = next(c for c in cls.__mro__ if issubclass(c, Settings) and f.name in inspect.get_annotations(c))
        facts = {**f.metadata, "unit": f.metadata["unit"] or (_UNITS.get(ending, "") if quantity else "")}
        facts["read_only"] |= owner._all_read_only  # noqa: SLF001  of this module
        infos.append(
            SettingInfo(name=f.name, default=f.default, type=item, is_list=is_list, optional=optional, **facts)
        )
    _GROUPS[cls], _INFOS[cls] = groups, tuple(infos)
    return _INFOS[cls]


def _analyse(hint: Any) -> tuple[type, bool, bool]:
    """Return the item type of an annotation, whether it is a tuple, and whether None is allowed."""
    arguments = typing.get_args(hint)
    optional = type(None) in arguments
    if optional:
        (hint,) = [a for a in arguments if a is not type(None)]
    origin = typing.get_origin(hint)
    if origin is tuple:
        return typing.get_args(hint)[0], True, optional
    if origin is typing.Literal:
        return type(typing.get_args(hint)[0]), False, optional
    return hint, False, optional


def _checked(info: SettingInfo, value: Any) -> Any:
    if value is None:
        if info.optional:
            return None
        raise ConfigError(f"{info.name}: is empty")
    if not info.is_list:
        return _checked_item(info, value, info.name)
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ConfigError(f"{info.name}: {quoted(value)} is not a list")
    return tuple(_checked_item(info, item, f"{info.name}[{i}]") for i, item in enumerate(value))


def _checked_item(info: SettingInfo, value: Any, name: str) -> Any:
    if getattr(value, "shape", None) == ():
        value = value.item()  # of NumPy
    if type(value) is int and not -(2**63) <= value < 2**63:
        raise ConfigError(f"{name}: a whole number of {value.bit_length()} bits is not a number that can be used")
    if info.type is str and isinstance(value, Path):
        value = str(value)
    if info.type is float and type(value) is int:
        value = float(value)
    if not isinstance(value, info.type) or (info.type is not bool and type(value) is bool):
        kinds = {int: "a whole number", float: "a number", str: "text", bool: "true or false"}
        raise ConfigError(f"{name}: {quoted(value)} is not {kinds.get(info.type, info.type.__name__)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name}: {value} is not finite")
    if isinstance(value, int | float):
        unit = f" {info.unit}" if info.unit else ""
        if info.minimum is not None and value < info.minimum:
            raise ConfigError(f"{name}: {quoted(value)} is below {info.minimum}{unit}")
        if info.maximum is not None and value > info.maximum:
            raise ConfigError(f"{name}: {quoted(value)} is above {info.maximum}{unit}")
    if info.choices and value not in info.choices:
        raise ConfigError(f"{name}: {none_of(value, info.choices)}")
    return value


def _nested(mapping: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Convert dotted keys to nested mappings; of a key that is given in both forms, the later value counts."""
    where = f"{source}: settings" if source else "settings"
    require_type(mapping, Mapping, where, "not a mapping of settings by name", ConfigError)
    result: dict[str, Any] = {}
    for key, value in mapping.items():
        path = str(key).split(".")
        group = result
        for name in path if isinstance(value, Mapping) else path[:-1]:
            group = group.setdefault(name, {})
            if not isinstance(group, dict):
                raise ConfigError(f"{source}: {shown(key)}: {shown(name)} is a value and a group at once")
        if isinstance(value, Mapping):
            _merge(group, _nested(value, source))
        elif isinstance(group.get(path[-1]), dict):
            raise ConfigError(f"{source}: {shown(key)}: {shown(path[-1])} is a value and a group at once")
        else:
            group[path[-1]] = value
    return result


def _merge(base: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(base.get(key), dict):
            _merge(base[key], value)
        else:
            base[key] = value


def _build(cls: type[_S], mapping: Mapping[str, Any], source: str, prefix: str) -> _S:
    hints = typing.get_type_hints(cls)
    known = [f.name for f in dataclasses.fields(cls)]
    values: dict[str, Any] = {}
    for key, value in mapping.items():
        if key not in known:
            hint = nearest(key, [*known, *(info.name for info in setting_infos(cls))])
            raise ConfigError(f"{source}{prefix}{shown(key)}: unknown setting; known: {', '.join(known)}{hint}")
        if value is EMPTY:
            raise ConfigError(
                f"{source}{prefix}{key}: is empty; write {{}} for a group with its defaults, null for none"
            )
        values[key] = _field_value(hints[key], value, source, f"{prefix}{key}")
    try:
        return cls(**values)
    except ConfigError as err:
        raise ConfigError(f"{source}{prefix}{err}") from err


def _field_value(hint: Any, value: Any, source: str, name: str) -> Any:
    """Convert a plain value for its field; values that are not groups are checked by `Settings`."""
    item, is_list, optional = _analyse(hint)
    if not issubclass(item, Settings):
        if is_list and item is str and isinstance(value, str) and value:
            return (value,)  # a list of one text may be written without brackets
        return tuple(value) if isinstance(value, list) else value
    if value is None and optional:
        return None
    if is_list and isinstance(value, list):
        if len(value) > _MOST_GROUPS:
            raise ConfigError(f"{source}{name}: holds {len(value)}, more than {_MOST_GROUPS}")
        return tuple(_field_value(item, element, source, f"{name}[{i}]") for i, element in enumerate(value))
    if is_list:
        raise ConfigError(f"{source}{name}: {quoted(value)} is not a list")
    if not isinstance(value, Mapping):
        shown_value = "null" if value is None else quoted(value)
        raise ConfigError(f"{source}{name}: {shown_value} is not a group of settings; {{}} is one with its defaults")
    return _build(item, value, source, f"{name}.")


def _plain(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.to_mapping()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
