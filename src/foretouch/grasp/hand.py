# SPDX-License-Identifier: Apache-2.0
"""Descriptions of hands: a YAML file with what two fingers that close on a line leave free, and where the hand is then.

Places are in the frame of the grasp: its origin is the middle of both contacts, x points to the thumb (of a gripper to either finger), z from the palm
to the line, and y is z × x. What changes with the width of the grasp is given for several widths, and interpolated between them.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from foretouch.config import Settings, description_file, load_description, require_units, setting
from foretouch.errors import ConfigError, shown
from foretouch.grasp.pose import cross
from foretouch.kernels import Kernel
from foretouch.types import Float32, Float64, Floating, Int32
from foretouch.types.grasps import TILTS

FINGER, THUMB, PALM = "finger", "thumb", "palm"
UNLIMITED_M: Final = 10.0
"""Depth of a hand without a palm, and how far it could move on [m]."""

_SPARE_M: Final = 0.006
"""Distance that the palm keeps from the object where it can, since sizes and places are estimated."""

_hand_clearance = Kernel("hand_clearance")

_FREE_STEP_M: Final = 0.005
_WIDER_M: Final = 0.002  # on either side of a line, where the object is not seen to end
_CELL_M: Final = 0.0025
_WIDTH_STEP_M: Final = 0.0025
_PALM_CELLS, _FINGER_CELLS = 3, 2  # around a part of the hand that it takes, too, beside other objects
_CELLS: Final = 202  # of the grid over a hand, in either direction
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES: Final = {FINGER: -0.5, PALM: 0.0, THUMB: 0.5}  # of the width, where the origin of such a box is


def _require_three(settings: Settings, *names: str) -> None:
    for name in names:
        if len(getattr(settings, name)) != 3:
            raise ConfigError(f"{name}: {list(getattr(settings, name))} are not three numbers")


@dataclass(frozen=True, kw_only=True)
class BoxConfig(Settings):
    """A box that holds a part of the hand: of the palm, in the tool's frame; of a finger, in the frame of the grasp from its contact on."""

    name: str = setting("", "What it holds")
    part: str = setting(PALM, "What it moves with", choices=tuple(_SIDES))
    xyz: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Its middle", unit="m")
    rpy: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Its angles about x, y and z, as in URDF", unit="rad")
    size: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Its edges", unit="m", bounds=(0.001, 2.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_three(self, "xyz", "rpy", "size")
        require_units(self, angles=["rpy"], lengths=["xyz"])

    @property
    def corners(self) -> Float64:
        """(8, 3) float64 [m]."""
        return np.asarray(self.xyz + (_CORNERS * self.size) @ _rotation_of(self.rpy).T, np.float64)


@dataclass(frozen=True, kw_only=True)
class WidthConfig(Settings):
    """The hand at one width of a grasp."""

    width_m: float = setting(0.0, "Distance of the contacts", bounds=(0.0, 1.0))
    depth_m: float = setting(
        UNLIMITED_M, "How far an object of this width may reach from the line to the palm", bounds=(0.001, 10.0)
    )
    middle_m: float | None = setting(
        None, "As `depth_m` between the middle halves of the fingers' distance; absent: the same", bounds=(0.001, 10.0)
    )
    xyz: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Origin of the tool's frame in the grasp's", unit="m")
    rpy: tuple[float, ...] = setting((0.0, 0.0, 0.0), "Its angles, as in URDF", unit="rad")
    angles: tuple[float, ...] = setting((), "Angles of `joints`, in their order", unit="rad")
    boxes: tuple[BoxConfig, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_three(self, "xyz", "rpy")
        require_units(self, angles=["rpy", "angles"], lengths=["xyz"])


@dataclass(frozen=True, kw_only=True)
class JointConfig(Settings):
    """A joint of the hand, as the vendor's URDF names it."""

    name: str = setting("", "Name of the joint")
    lower: float = setting(-3.2, "Smallest angle", unit="rad")
    upper: float = setting(3.2, "Largest angle", unit="rad")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_units(self, angles=["lower", "upper"])


@dataclass(frozen=True, kw_only=True)
class HandDescription(Settings):
    """Two fingers of a hand or gripper that close along a line."""

    name: str = setting("", "Name of the hand")
    summary: str = setting("", "What it is, in one line")
    tool: str = setting("", "Frame whose pose is sent to the arm, as the vendor's URDF names it")
    opening_m: float = setting(0.1, "Largest distance of the contacts", bounds=(0.005, 1.0))
    open_m: float = setting(
        0.02, "How much farther out each finger is on the way in, as far as the hand opens", bounds=(0.0, 0.3)
    )
    tip_radius_m: float = setting(
        0.008, "Radius of a fingertip where it touches; it reaches as far beyond the line", bounds=(0.001, 0.05)
    )
    across_m: float = setting(
        0.06, "Extent across the fingers of what may not be deeper than `depth_m`", bounds=(0.001, 1.0)
    )
    joints: tuple[JointConfig, ...] = ()
    boxes: tuple[BoxConfig, ...] = ()
    postures: tuple[WidthConfig, ...] = (WidthConfig(),)

    def __post_init__(self) -> None:
        super().__post_init__()
        widths = [posture.width_m for posture in self.postures]
        if not widths or sorted(set(widths)) != widths:
            raise ConfigError(f"postures: widths {widths} do not ascend")
        for number, posture in enumerate(self.postures):
            where = f"postures[{number}]"
            if len(posture.angles) != len(self.joints):
                raise ConfigError(
                    f"{where}.angles: {len(posture.angles)} of {len(self.joints)} joints; give one for each"
                )
            for joint, angle in zip(self.joints, posture.angles, strict=True):
                if not joint.lower <= angle <= joint.upper:
                    limits = f"{joint.lower:g} to {joint.upper:g} rad"
                    raise ConfigError(f"{where}.angles: {joint.name} {angle:g} is outside of its limits, {limits}")
            if [box.name for box in posture.boxes] != [box.name for box in self.postures[0].boxes]:
                raise ConfigError(f"{where}.boxes: differ from postures[0] in name or order")
        fingers = {box.part for box in self.postures[0].boxes} & {FINGER, THUMB}
        if len(fingers) == 1:
            absent = ({FINGER, THUMB} - fingers).pop()
            raise ConfigError(
                f"postures[0].boxes: none is of the {absent}, which takes the other contact; set its part: {absent}"
            )
        if any(box.part != PALM for box in self.boxes):
            raise ConfigError("boxes: hold the palm; boxes of fingers stand in `postures`")
        twice = [joint.name for joint in self.joints]
        if len(set(twice)) < len(twice):
            raise ConfigError(f"joints: {max(twice, key=twice.count)} occurs twice")


class HandAt(NamedTuple):
    """The hand at one width of a grasp."""

    depth_m: float  # free between line and palm [m]
    tool: Float64  # (4, 4) float64, the tool's frame in the frame of the grasp
    corners: Float64  # (B, 8, 3) float64 [m], of its boxes, closed, in the frame of the grasp
    posture: Float64  # (J,) float64 [rad]


class Hand:
    """A description and what follows from it.

    Args:
        config: The description.

    Raises:
        ConfigError: If the object may reach into the palm.
    """

    def __init__(self, config: HandDescription) -> None:
        self.config, first = config, config.postures[0]
        self.widths = np.array([posture.width_m for posture in config.postures])
        self.depths = np.array(
            [[posture.depth_m, posture.middle_m or posture.depth_m] for posture in config.postures]
        ).T
        self.parts = [box.part for box in (*config.boxes, *first.boxes)]
        self.names = [box.name for box in (*config.boxes, *first.boxes)]
        self._sides = np.array([_SIDES[part] for part in self.parts])
        self._rows = np.array([_flat(config, posture) for posture in config.postures])
        self._turns = bool(np.ptp(self._rows[:, 4:13], axis=0).any())
        for number, width in enumerate(self.widths):
            free = min(map(_ahead, self.at(float(width)).corners[: len(config.boxes)]), default=UNLIMITED_M)
            for name, depth in zip(("depth_m", "middle_m"), self.depths[:, number].tolist(), strict=True):
                if depth > free + 1e-4:
                    rule = f"the palm is {free:g} m from the line: the fingers are not that long"
                    raise ConfigError(f"postures[{number}].{name}: {depth:g} m, but {rule}")

    @property
    def limits_depth(self) -> bool:
        """Whether the hand has a palm that an object can meet."""
        return bool(self.depths.min() < UNLIMITED_M)

    @property
    def is_jaw(self) -> bool:
        """Whether it is a gripper without joints that bend, whose stroke ends at the opening."""
        return self.limits_depth and not self.config.joints

    @cached_property
    def palm(self) -> Float64:
        """Half of `across_m`, the step of the widths, the angles `TILTS` and the lowest height of a line at each, and free depths by width, beside the middle half of a line and over it [m]."""
        lifts = np.min([-self.lowest(float(width)) for width in self.widths], axis=(0, 1))
        widths = _FREE_STEP_M * np.arange(round(self.config.opening_m / _FREE_STEP_M) + 3)
        free = [np.interp(widths, self.widths, depths) - _SPARE_M for depths in self.depths]
        return np.concatenate([[self.config.across_m / 2.0, _FREE_STEP_M], TILTS, lifts, *free])

    @lru_cache(maxsize=128)  # noqa: B019  of hands that are read once
    def lowest(self, width_m: float) -> Float64:
        """Return (2, A) float64 [m], the lowest corner of the hand from a horizontal line, for each of `TILTS`, with the thumb at its end and at its beginning."""
        corners = self.at(width_m).corners.reshape(-1, 3)
        below = np.outer(np.cos(TILTS), np.minimum(corners[:, 2], self.config.tip_radius_m))
        beside = np.outer(np.sin(TILTS), corners[:, 1])
        return np.stack([(sign * beside - below).min(axis=1, initial=UNLIMITED_M) for sign in (1.0, -1.0)])

    def fingertip(self, part: str, width_m: float) -> Float64:
        """Orient a fingertip at a grasp as the last box of its finger.

        Args:
            part: `FINGER` or `THUMB`.
            width_m: Of the grasp.

        Returns:
            (3, 3) float64, proper rotation, columns in the frame of the grasp: x along the longest edge to the tip; z away from
            the pad, which is the face that looks most to the other contact.
        """
        last = len(self.parts) - 1 - self.parts[::-1].index(part)
        corners = self.at(width_m).corners[last]
        edges = corners[[4, 2, 1]] - corners[0]
        lengths = np.linalg.norm(edges, axis=1)
        axes = edges / lengths[:, None]
        x = axes[np.argmax(lengths)]
        if x @ (np.array([self._sides[last] * width_m, 0.0, 0.0]) - corners.mean(axis=0)) < 0.0:
            x = -x
        faces = np.delete(axes, np.argmax(lengths), axis=0)
        z = faces[np.argmax(np.abs(faces[:, 0]))]
        if z[0] * self._sides[last] < 0.0:
            z = -z
        z = z - (z @ x) * x  # boxes that are interpolated are a little skewed
        z /= np.linalg.norm(z)
        return np.column_stack([x, cross(z, x), z])

    def opened(self, width_m: float, share: float = 1.0) -> Float64:
        """Return (B, 8, 3) float64 [m], corners of the boxes with fingers that are opened from a grasp by a share of `open_m` each; tool and frame stay."""
        wide = min(
            width_m + 2.0 * share * self.config.open_m,
            max(float(self.widths[-1]), self.config.opening_m + 2.0 * _WIDER_M),
        )
        here, there = self.at(width_m), self.at(max(wide, width_m))
        back = here.tool @ np.linalg.inv(there.tool)
        return np.asarray(there.corners @ back[:3, :3].T + back[:3, 3], np.float64)

    @lru_cache(maxsize=128)  # noqa: B019  of hands that are read once
    def _fronts(self, number: int) -> Float32:
        """Map how far the hand reaches along z over x and y: opened, and anywhere between open and closed; the border is empty.

        Args:
            number: The width in steps of `_WIDTH_STEP_M`.

        Returns:
            (2, 202, 202) float32 [m]; in the second each place stands for those around it, too, by `_PALM_CELLS` or `_FINGER_CELLS`.
        """
        palm, fingers = np.full((2, 2, _CELLS, _CELLS), -np.inf)
        for share in (1.0, 0.5, 0.0):
            for corners, part in zip(self.opened(number * _WIDTH_STEP_M, share), self.parts, strict=True):
                _raise_to((palm if part == PALM else fingers)[1], corners)
            if share == 1.0:
                palm[0], fingers[0] = palm[1], fingers[1]
        around = np.maximum(_spread(palm[1:], _PALM_CELLS), _spread(fingers[1:], _FINGER_CELLS))
        fronts = np.concatenate([np.maximum(palm[:1], fingers[:1]), around]).astype(np.float32)
        fronts[:, [0, -1]] = fronts[:, :, [0, -1]] = -np.inf
        return fronts

    def clearance(self, width_m: float, own: Float64, others: Float64, height_m: float) -> tuple[Float64, Float64]:
        """Measure how much further the hand could go along each of `TILTS` before it meets something [m], negative where it is blocked.

        Its fingers are open; everything between the hand and where it comes from counts.

        Args:
            width_m: Of the grasp.
            own: (N, 3) float64 [m], the object: along a horizontal line, beside it and up, from the middle of the contacts.
            others: (M, 3) float64 [m], what stands around.
            height_m: Of the line over the table.

        Returns:
            (2, A) float64 with the thumb at the line's end, and at its beginning; and (A,) float64, how far the object reaches towards the palm [m].
        """
        points, number = np.concatenate([own, others]), round(width_m / _WIDTH_STEP_M)
        free = [float(np.interp(width_m + 2.0 * _WIDER_M, self.widths, depths)) for depths in self.depths]
        half_m, across_m = width_m / 2.0 + _WIDER_M, self.config.across_m / 2.0
        sizes = np.array([1.0 / _CELL_M, half_m, width_m / 4.0, across_m, *free])
        clear_m, behind = np.empty((2, len(TILTS))), np.empty(len(TILTS))
        _hand_clearance(
            *(points, len(points), len(own), TILTS, len(TILTS), self._fronts(number), _CELLS, sizes, clear_m, behind)
        )
        above = height_m + self.lowest(number * _WIDTH_STEP_M)  # the table is where it was seen: there is no tolerance
        return np.where(above < 0.0, -UNLIMITED_M, np.minimum(clear_m, above)), behind

    def at(self, width_m: float) -> HandAt:
        """Interpolate the hand at a width of a grasp.

        Args:
            width_m: Distance of the contacts.
        """
        place = float(np.interp(width_m, self.widths, np.arange(len(self.widths))))
        k = min(int(place), max(len(self.widths) - 2, 0))
        row = self._rows[k] + (place - k) * (self._rows[min(k + 1, len(self.widths) - 1)] - self._rows[k])
        tool = np.eye(4)
        tool[:3, :3], tool[:3, 3] = row[4:13].reshape(3, 3), row[1:4]
        if self._turns:
            left, _, right = np.linalg.svd(tool[:3, :3])  # the nearest rotation
            tool[:3, :3] = left @ right
        boxes = 24 * len(self.parts)
        corners = row[13 : 13 + boxes].reshape(-1, 8, 3).copy()
        corners[..., 0] += (self._sides * width_m)[:, None]
        return HandAt(float(row[0]), tool, corners, row[13 + boxes :])


def _ahead(corners: Float64) -> float:
    """Return how far from the origin towards the palm a box with corners (8, 3) begins [m]; `UNLIMITED_M` where it is beside."""
    edges = corners[[4, 2, 1]] - corners[0]  # along x, y and z of the box
    squares = (edges * edges).sum(axis=1)
    start, step = edges @ -corners[0] / squares, -edges[:, 2] / squares  # in parts of the edges, 0 to 1 inside
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack([-start / step, (1.0 - start) / step]), axis=0)
    first, last = ends[0].max(), ends[1].min()
    return float(first) if first <= last else UNLIMITED_M


def _cell(values: Floating) -> Int32:
    """Index of a place in `Hand._fronts`, whose border is empty."""
    return np.asarray(np.clip(values * (1.0 / _CELL_M) + _CELLS / 2, 0.5, _CELLS - 0.5), np.int32)


def _spread(fronts: Float64, cells: int) -> Float64:
    """Return the largest of each cell of maps (..., H, W) and those around it."""
    for axis in (1, 2):
        fronts = np.max([np.roll(fronts, shift, axis) for shift in range(-cells, cells + 1)], axis=0)
    return fronts


def _raise_to(front: Float64, corners: Float64) -> None:
    """Raise a map of `Hand._fronts` to a box with corners (8, 3)."""
    low, high = (_cell(end) for end in (corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)))
    x, y = (_CELL_M * (np.arange(a, b + 1) - (_CELLS - 1) / 2) for a, b in zip(low, high, strict=True))
    edges = corners[[4, 2, 1]] - corners[0]
    squares = (edges * edges).sum(axis=1)[:, None, None]
    place = np.stack(np.broadcast_arrays(x[:, None], y[None, :], 0.0), axis=-1) - corners[0]
    start = np.einsum("xyk,ek->exy", place, edges) / squares  # in parts of the edges, 0 to 1 inside
    step = edges[:, 2, None, None] / squares + 1e-12
    ends = np.stack([-start / step, (1.0 - start) / step])
    first, last = ends.min(axis=0).max(axis=0), ends.max(axis=0).min(axis=0)
    part = front[low[0] : high[0] + 1, low[1] : high[1] + 1]
    np.maximum(part, np.where(first <= last, last, -np.inf), out=part)


def _flat(config: HandDescription, posture: WidthConfig) -> Float64:
    """Return all numbers of a posture in a row: depth, tool, corners of the boxes, angles."""
    turned = _rotation_of(posture.rpy)
    palm = [posture.xyz + box.corners @ turned.T for box in config.boxes]
    corners = [*palm, *(box.corners for box in posture.boxes)]
    parts = [[posture.depth_m], posture.xyz, turned.ravel(), *(corner.ravel() for corner in corners), posture.angles]
    return np.concatenate([np.asarray(part, np.float64) for part in parts])


def _rotation_of(rpy: Sequence[float]) -> Float64:
    """Return (3, 3) float64 rotation of angles about fixed axes, as in URDF.

    Args:
        rpy: Angles about x, y and z [rad].
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x, np.float64)


@cache
def hand_files() -> dict[str, Path]:
    """Return the descriptions that come with the package, by name."""
    folder = Path(str(resources.files("foretouch.grasp"))) / "hands"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_hand(hand: str | Path) -> Hand:
    """Read a description, once, and again when its file was changed.

    Args:
        hand: The name of a description that comes with the package, such as `franka_hand`, or a YAML file.

    Raises:
        ConfigError: If there is none, or it breaks a rule; names file, field and rule.
    """
    path, changed_ns = description_file(hand, hand_files()), 0
    with suppress(OSError, ValueError):  # which reading reports
        changed_ns = path.stat().st_mtime_ns
    return _read_hand(path, changed_ns)


@lru_cache(maxsize=16)
def _read_hand(path: Path, _changed_ns: int) -> Hand:
    """Read the file of a description."""
    config = load_description(path, HandDescription, "a hand")
    try:
        return Hand(config)
    except ConfigError as err:
        raise ConfigError(f"{shown(path)}: {err}") from err


@cache
def tool_of(hand: str) -> str:
    """Return the name of the tool frame of a description; "" without a hand, or of one whose description names none.

    The file is read once, so that no answer fails where it was edited or removed since.
    """
    return load_hand(hand).config.tool if hand else ""
