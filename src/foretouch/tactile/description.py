# SPDX-License-Identifier: Apache-2.0
"""Descriptions of taxel sensors: a YAML file, with a CSV file where the taxels form no array.

Names are taken from `urdf_tactile` (ubi-agni/tactile_toolbox); besides, a description states what the numbers mean: unit,
range, sign and validity. All fingers of a description carry the same taxels.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, description_file, load_description, require_units, setting
from foretouch.errors import ConfigError, TactileError, none_of, shown
from foretouch.tactile.field_path import FieldPath
from foretouch.tactile.layout import MOST_TAXELS, ArrayConfig, Layout, present, read_layout, require_length
from foretouch.types import Bool, Index
from foretouch.types.channels import LARGEST, Channel, Channels
from foretouch.types.summary import Summarised

STAMP_UNITS: Final = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
"""Nanoseconds of each unit of a stamp that is a number."""

_OF_A_HAND: Final = ("summary", "group", "update_rate", "fingers", "source", "pad", "field", "noise")
"""Settings that do not change what a touch means: see `Sensor.sha256`."""

_UNITS: Final = ("counts", "N", "Pa", "T", "V", "Ohm", "K", "degC", "m")
_DTYPES: Final = {
    **{f"int{bits}": (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1.0) for bits in (8, 16, 32)},
    **{f"uint{bits}": (0.0, 2.0**bits - 1.0) for bits in (8, 16, 32)},
    **dict.fromkeys(("float32", "float64"), (-math.inf, math.inf)),
}


@dataclass(frozen=True, kw_only=True)
class FingerConfig(Settings):
    """One finger that carries the sensor."""

    name: str = setting("", "Name of the finger, such as TH")
    parent: str = setting("", "Link of the robot that carries the sensor; empty if it is not known")
    xyz: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Origin of the sensor's frame in its parent link", unit="m")
    rpy: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Its angles about the link's x, y and z, as in URDF", unit="rad")
    field: str = setting("", "Field path of the finger in a message; empty for the message itself")
    dead: tuple[int, ...] = setting((), "Indices of the taxels of this finger that have failed", minimum=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names_and_paths(self)
        require_length(self, 3, "xyz", "rpy")
        require_units(self, angles=["rpy"], lengths=["xyz"])


@dataclass(frozen=True, kw_only=True)
class ChannelConfig(Settings):
    """A number that is read: of each taxel (`values`), or of the finger (`scalars`)."""

    name: str = setting("", "Name of the channel, such as PDC")
    field: str = setting("", "Field path in the finger; for `values` a series, in order of the indices")
    unit: str = setting("counts", "Unit of the number", choices=_UNITS)
    dtype: str = setting("float32", "Type of the number in the message", choices=_DTYPES)
    range: tuple[float, ...] = setting(
        (), "Lowest and highest number of a working sensor; others are invalid. By default the limits of the type"
    )
    saturation: tuple[float, ...] = setting((), "Lowest and highest number that still follows the contact")
    contact: str = setting("both", "What the number does in contact", choices=("rise", "fall", "both", "none"))
    rest: str = setting(
        "tare",
        "What it is compared with: a reading without contact, zero, or nothing",
        choices=("tare", "zero", "none"),
    )
    noise: float | None = setting(None, "Standard deviation at rest; none if it is not known", minimum=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names_and_paths(self)
        outer = _DTYPES[self.dtype]
        for name in ("range", "saturation"):
            inner = getattr(self, name) or outer
            if len(inner) != 2 or not outer[0] <= inner[0] < inner[1] <= outer[1]:
                raise ConfigError(f"{name}: {list(inner)} is not [low, high] within {list(outer)}")
            outer = inner

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest number of a working sensor."""
        low, high = self.range or _DTYPES[self.dtype]
        return low, high

    @property
    def predicted(self) -> bool:
        """Whether it changes in contact, from a known rest level, so that models predict it."""
        return self.contact != "none" and self.rest != "none"

    def channel(self, size: int) -> Channel:
        """Return what a touch holds of it, for `size` numbers of a finger."""
        low, high = np.clip(self.limits, -LARGEST, LARGEST).tolist()
        span = high - low if high - low < LARGEST else 1.0  # of a force without a stated range, a millionth of a newton
        resolution = (self.noise or 1e-6 * span) if self.dtype.startswith("float") else 1.0
        sign, noise = {"rise": 1, "fall": -1}.get(self.contact, 0), self.noise or 0.0
        return Channel(self.name, size, self.unit, low, high, sign, self.rest == "tare", noise, resolution)


@dataclass(frozen=True, kw_only=True)
class SourceConfig(Settings):
    """The messages that the numbers are read from."""

    type: str = setting("", "Type of the messages, as package/Name")
    stamp: str = setting("", "Field path of the time of measurement; empty if a message has none")
    stamp_unit: str = setting("s", "Unit of a stamp that is a number", choices=STAMP_UNITS)
    invalid: tuple[str, ...] = setting(
        (), "Scalars that mark a finger that was not read by a number out of their range"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        FieldPath(self.stamp, "stamp")


@dataclass(frozen=True, kw_only=True)
class SensorConfig(Settings):
    """A taxel sensor on one or several fingers."""

    name: str = setting("", "Name of the sensor")
    summary: str = setting("", "What it is, in one line")
    group: str = setting("", "Group of sensors that it belongs to, such as fingertips")
    update_rate: float = setting(100.0, "Readings per second", unit="Hz", bounds=(0.01, 1e5))
    fingers: tuple[FingerConfig, ...] = ()
    grasp: tuple[str, ...] = setting(
        (), "Fingers that touch g1 and g2, then others that are recorded with them; by default the first two"
    )
    array: ArrayConfig | None = None
    taxels: str = setting("", "Name of a CSV file beside the description: index, x, y, z, nx, ny, nz [m]")
    absent: tuple[int, ...] = setting(
        (),
        "Places in the series of a message at which there is no taxel; the taxels are counted without them",
        minimum=0,
    )
    pad: tuple[float, ...] = setting(
        (-0.2, -0.2, -0.2, 0.2, 0.2, 0.2), "Box that holds all taxels: lowest x, y, z, then highest", unit="m"
    )
    values: tuple[ChannelConfig, ...] = ()
    scalars: tuple[ChannelConfig, ...] = ()
    source: SourceConfig = SourceConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names_and_paths(self)
        if (self.array is None) == (not self.taxels):
            raise ConfigError("array, taxels: give exactly one of them")
        if Path(self.taxels).name != self.taxels:
            raise ConfigError(f"taxels: {self.taxels!r} is not a valid file name beside the description")
        require_length(self, 6, "pad")
        require_length(self, 2, *(["grasp"] if len(self.grasp) == 1 else []))
        if not re.fullmatch(r"[A-Za-z]\w*/[A-Za-z]\w*", self.source.type, re.ASCII):
            raise ConfigError(f"source.type: {self.source.type!r} is not a type of messages, as package/Name")
        scalars = [channel.name for channel in self.scalars]
        _check_list("fingers", [finger.name for finger in self.fingers])
        _check_list("values", [channel.name for channel in self.values])
        _check_list("values, scalars", [*(channel.name for channel in self.values), *scalars])
        _check_list("grasp", [finger.name for finger in self.chosen_fingers()])
        if not any(channel.predicted for channel in self.values):
            raise ConfigError("values: none changes in contact from a known rest level: contact and rest are none")
        if unknown := set(self.source.invalid) - set(scalars):
            raise ConfigError(f"source.invalid: {none_of(unknown.pop(), scalars)}")

    def chosen_fingers(self, names: Sequence[str] = ()) -> list[FingerConfig]:
        """Return the fingers of some names, by default those that grasp; a `ConfigError` if there is no such finger."""
        known = {finger.name: finger for finger in self.fingers}
        chosen = names or self.grasp or list(known)[:2]
        unknown = [name for name in chosen if name not in known]
        if unknown:
            raise ConfigError(f"fingers: {none_of(unknown[0], known)}")
        return [known[name] for name in chosen]


@dataclass(frozen=True, eq=False, repr=False)
class Sensor(Summarised):
    """A description and its taxels."""

    config: SensorConfig
    layout: Layout

    def _summary(self) -> tuple[str, Mapping[str, Any]]:
        title, facts = self.channels._summary()  # noqa: SLF001  which a sensor adds to
        return title, {
            **facts,
            "taxels": f"{self.size} on a finger",
            "dead": ", ".join(self.dead),
            "sha256": self.sha256[:16],
        }

    @property
    def size(self) -> int:
        """Number of taxels of a finger."""
        return len(self.layout.positions)

    @property
    def series_size(self) -> int:
        """Numbers in the series of a message: taxels, and places without one."""
        return self.size + len(self.config.absent)

    @cached_property
    def places(self) -> Index:
        """(N,) places of the taxels in the series of a message."""
        return present(self.series_size, self.config.absent)

    @cached_property
    def sha256(self) -> str:
        """Hash of what the numbers mean: taxels, values and scalars, and the names of the fingers that grasp.

        How messages are read, where the sensor is mounted, which taxels have failed and how noisy they are does not count, nor
        do settings that are empty, so that later versions may add some.
        """
        stated = {key: value for key, value in self.to_mapping().items() if key not in _OF_A_HAND}
        for key in ("values", "scalars"):
            stated[key] = [{k: v for k, v in finger.items() if k not in _OF_A_HAND} for finger in stated.get(key, [])]
        stated["grasp"] = self._grasping
        return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()

    @property
    def _grasping(self) -> list[str]:
        """Names of the fingers that touch g1 and g2 in the names of modalities, whichever fingers are read."""
        return [finger.name for finger in self.config.chosen_fingers()]

    @cached_property
    def channels(self) -> Channels:
        """The values of a touch: first of the whole finger, then of its taxels.

        Raises:
            ConfigError: If there is only one finger.
        """
        if len(self._grasping) < 2:
            raise ConfigError(f"sensor: {self.config.name} has one finger, and a grasp two")
        predicted = tuple(value.channel(size) for value, size in self.predicted)
        return Channels(self.config.name, self.sha256, tuple(self._grasping), predicted)

    @property
    def predicted(self) -> list[tuple[ChannelConfig, int]]:
        """Description of each of `channels`, and its numbers of a finger."""
        both = [(scalar, 1) for scalar in self.config.scalars] + [(value, self.size) for value in self.config.values]
        return [(channel, size) for channel, size in both if channel.predicted]

    @property
    def is_biotac(self) -> bool:
        """Whether it is the BioTac SP, which has its own messages and files."""
        return self.sha256 == packaged_sensor("biotac_sp").sha256

    @property
    def scalar_channels(self) -> tuple[Channel, ...]:
        """S of `channels` that are of the whole finger."""
        return self.channels.channels[: sum(scalar.predicted for scalar in self.config.scalars)]

    @property
    def taxel_channels(self) -> tuple[Channel, ...]:
        """C of `channels` that are of each taxel."""
        return self.channels.channels[len(self.scalar_channels) :]

    @cached_property
    def scalar_columns(self) -> Index:
        """(F, S) columns of a touch: the values of each finger."""
        shape = len(self.scalar_channels), len(self.channels.fingers)
        return np.arange(shape[0] * shape[1]).reshape(shape).T

    @cached_property
    def taxel_columns(self) -> Index:
        """(F, N, C) columns of a touch: the values of each taxel."""
        shape = len(self.taxel_channels), len(self.channels.fingers), self.size
        return np.arange(self.scalar_columns.size, self.channels.size).reshape(shape).transpose(1, 2, 0)

    @cached_property
    def valid(self) -> Bool:
        """(F, N) taxels that are not declared dead."""
        taxels = np.arange(self.size)
        return np.array([~np.isin(taxels, finger.dead) for finger in self.config.chosen_fingers()])

    @cached_property
    def valid_values(self) -> Bool:
        """(D,) values of a touch that are not of taxels declared dead."""
        valid = np.ones(self.channels.size, np.bool_)
        valid[self.taxel_columns[~self.valid]] = False
        return valid

    @property
    def dead(self) -> dict[str, list[int]]:
        """Indices of the taxels declared dead, by finger that has some."""
        return self.taxels_of(~self.valid_values)

    def taxels_of(self, values: Bool) -> dict[str, list[int]]:
        """Return the indices of the taxels of which a value is in a (D,) mask, by finger that has some."""
        named = zip(self.channels.fingers, np.asarray(values[self.taxel_columns].any(axis=-1)), strict=True)
        return {finger: np.flatnonzero(chosen).tolist() for finger, chosen in named if chosen.any()}

    def with_dead(self, dead: Bool) -> "Sensor":
        """Return the same sensor with further taxels declared dead, by an (F, N) mask."""
        failed: Bool = np.logical_or(dead, ~self.valid)
        failed_of = dict(zip((finger.name for finger in self.config.chosen_fingers()), failed, strict=True))
        fingers = [
            finger.replace(dead=tuple(np.flatnonzero(failed_of[finger.name]).tolist()))
            if finger.name in failed_of
            else finger
            for finger in self.config.fingers
        ]
        return Sensor(self.config.replace(fingers=tuple(fingers)), self.layout)

    def to_mapping(self) -> dict[str, Any]:
        """Return all that `sensor_of` needs, as plain types, for manifests and cards."""
        stated: dict[str, Any] = _stated(self.config.to_mapping())
        if self.config.taxels:
            stated["taxels"] = [self.layout.positions.tolist(), self.layout.normals.tolist(), None]
        return stated


def sensor_files() -> dict[str, Path]:
    """Return the descriptions that come with the package, by name."""
    folder = Path(str(resources.files("foretouch.tactile"))) / "sensors"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_sensor(sensor: str | Path) -> Sensor:
    """Read a description and its taxels.

    Args:
        sensor: The name of a description that comes with the package, such as `biotac_sp`, or a YAML file.

    Raises:
        ConfigError: If there is none, or it breaks a rule; names file, field and rule.
        FileError: If the CSV file breaks a rule; names file, line and rule.
    """
    path = description_file(sensor, sensor_files())
    config = load_description(path, SensorConfig, "a sensor")
    layout = (
        config.array.layout(config.absent) if config.array else read_layout(path.parent / config.taxels, config.absent)
    )
    return _checked(config, layout, shown(path))


def _checked(config: SensorConfig, layout: Layout, where: str) -> Sensor:
    """Return the sensor; a `ConfigError` if a taxel is outside of the pad, or a dead one does not exist."""
    outside = ((layout.positions < config.pad[:3]) | (layout.positions > config.pad[3:])).any(axis=1)
    if outside.any():
        index = int(outside.argmax())
        place = ", ".join(f"{value:g}" for value in layout.positions[index])
        raise ConfigError(f"{where}: pad: taxel {index} at ({place}) m is outside; {outside.sum()} taxels are")
    series = len(layout.positions) + len(config.absent)
    if len(set(config.absent)) < len(config.absent) or max(config.absent, default=-1) >= series:
        raise ConfigError(f"{where}: absent: are not different places below {series}")
    for finger in config.fingers:
        if max(finger.dead, default=-1) >= len(layout.positions):
            raise ConfigError(f"{where}: dead: {finger.name} has no taxel {max(finger.dead)}")
    return Sensor(config, layout)


def sensor_of(mapping: Any, where: str) -> Sensor:
    """Make the sensor of a mapping by `Sensor.to_mapping`; a `ConfigError` names `where` it was read, field and rule."""
    if not isinstance(mapping, dict):
        raise ConfigError(f"{where}: is not a description of a sensor")
    stated, layout = dict(mapping), None
    if isinstance(stated.get("taxels"), list):
        layout = _layout_of(stated["taxels"], f"{where}: taxels")
        stated["taxels"] = "taxels.csv"
    config = SensorConfig.from_mapping(stated, where)
    if layout is None and config.array is None:
        raise ConfigError(f"{where}: taxels: are missing")
    if len(config.chosen_fingers()) < 2:
        raise ConfigError(f"{where}: fingers: there is one, and a grasp has two")
    return _checked(config, layout or config.array.layout(config.absent), where)  # type: ignore[union-attr]


def _layout_of(taxels: list[Any], where: str) -> Layout:
    """Return the taxels in a description of `Sensor.to_mapping`."""
    try:
        points, normals, _ = taxels
        parts = np.asarray([points, normals], np.float64).reshape(2, -1, 3)
    except (TypeError, ValueError, OverflowError) as err:
        raise ConfigError(f"{where}: positions, normals and null are expected") from err
    if not 0 < len(parts[0]) <= MOST_TAXELS:
        raise ConfigError(f"{where}: {len(parts[0])} are not 1 to {MOST_TAXELS}")
    if not np.allclose(np.linalg.norm(parts[1], axis=1), 1.0) or not np.isfinite(parts).all():
        raise ConfigError(f"{where}: are not finite, or the normals not of unit length")
    return Layout(parts[0], parts[1])


def sensor_in(facts: Mapping[str, Any], where: str | Path) -> Sensor:
    """Return the sensor of a manifest or a card by its key `sensor`, which `with_sensor` wrote; without one, the BioTac SP."""
    return sensor_of(facts["sensor"], f"{shown(where)}: sensor") if "sensor" in facts else packaged_sensor("biotac_sp")


def with_sensor(facts: dict[str, Any], sensor: Sensor) -> dict[str, Any]:
    """Return the facts of a manifest or a card with the description of the sensor; the BioTac SP gets none, unless taxels are dead."""
    return facts if sensor.is_biotac and sensor.valid.all() else {**facts, "sensor": sensor.to_mapping()}


def named_taxels(taxels: Mapping[str, Sequence[int]]) -> str:
    """Return the indices of taxels by finger, for people: `TH 5, 7; MF 0`."""
    return "; ".join(f"{finger} {', '.join(map(str, own))}" for finger, own in taxels.items())


def require_two(sensor: Sensor) -> Sensor:
    """Return the sensor, if it is read on two fingers as a hand is driven; a `ConfigError` if a recording has more."""
    if len(sensor.channels.fingers) != 2:
        raise ConfigError(
            f"sensor: {sensor.config.name}: grasp: {', '.join(sensor.channels.fingers)} are not two fingers"
        )
    return sensor


def require_same(given: Channels, wanted: Channels, what: str) -> None:
    """Refuse `what` where it is of another sensor, or of another description of the same, by a `TactileError` that names both."""
    if given is wanted or given.sha256 == wanted.sha256:
        return
    rule = f"the description of {given.sensor} has changed" if given.sensor == wanted.sensor else f"not {wanted.sensor}"
    raise TactileError(f"{what}: is of {given.sensor} ({given.sha256[:8]}): {rule} ({wanted.sha256[:8]} is expected)")


packaged_sensor = cache(load_sensor)
"""Load a description that comes with the package, once."""


def _check_names_and_paths(settings: Any) -> None:
    """Refuse a `name` that is not an identifier, and a `field` that is not a field path or is empty where it is required."""
    name = getattr(settings, "name", "a")
    if not re.fullmatch(r"[A-Za-z]\w{0,63}", name, re.ASCII):
        raise ConfigError(f"name: {name!r} is not a letter, followed by letters, digits and '_'")
    if hasattr(settings, "field"):
        FieldPath(settings.field, "field")
        if not settings.field and not isinstance(settings, FingerConfig):
            raise ConfigError("field: is empty")


def _check_list(what: str, names: Sequence[str]) -> None:
    if not names:
        raise ConfigError(f"{what}: there is none")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ConfigError(f"{what}: {twice} occurs twice")


def _stated(value: Any) -> Any:
    """Return a mapping without what is left out: empty texts, lists and groups, and None."""
    if isinstance(value, dict):
        stated = {key: _stated(part) for key, part in value.items()}
        return {key: part for key, part in stated.items() if part not in (None, "", [], {})}
    return [_stated(part) for part in value] if isinstance(value, list) else value
