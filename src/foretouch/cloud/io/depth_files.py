# SPDX-License-Identifier: Apache-2.0
"""Read depth images from files, and the cameras that they are of, as drivers, Open3D, RealSense and GraspNet write them.

Depth: PNG of 16 bits, TIFF of 16 bits or floats, `.npy` with (H, W) numbers, `.npz` with `depth`, `depth_mm` or `depth_m`, and perhaps `K`. Cameras: YAML
of ROS (`camera_info`, or what `ros2 topic echo` prints) and of OpenCV, JSON of Open3D, RealSense and BOP, `meta.mat` of GraspNet, and (3, 3)
matrices as text. What they state becomes a `sensor_msgs/CameraInfo`, and is read as one. Colours of the same pixels may stand beside them.
"""

import io
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.base.files import json_in, read_bytes, require_existing
from foretouch.cloud.io.colours import COLOUR_SUFFIXES, as_colours, read_colours, require_size
from foretouch.cloud.io.depth_messages import camera_model
from foretouch.cloud.io.images import IMAGE_SUFFIXES
from foretouch.cloud.io.mask_files import MASK_SUFFIXES
from foretouch.config import EMPTY, load_yaml
from foretouch.errors import CloudError, ConfigError, FileError, described, none_of, require_type, shown
from foretouch.types import AnyArray, CameraModel, Cloud, UInt8
from foretouch.types.camera import MODELS, check_image

_INFO_SUFFIXES: Final = (".yaml", ".yml", ".json", ".mat", ".txt")
PAIRING: Final = (
    "a folder pairs NAME-depth.png (or .tif, .npy; _ for -) with NAME-color or NAME-rgb (.png, .jpg), with NAME-mask, NAME-label or NAME-seg "
    "(.png, .npy), and with NAME-info, or camera_info, intrinsics or meta of all (.yaml, .json, .mat, .txt)"
)
"""The rule of folders, for help texts."""

_LIMIT: Final = 1_000_000  # bytes of a file of intrinsics; BOP's has some hundred images
_MAT_LIMIT: Final = 100_000  # bytes of one that may be compressed, or a text; they have less than 5000
_MOST_NUMBERS: Final = 1000  # of an array in such a file
_DEPTH: Final = re.compile(r"(.+)[-_]depth|depth[-_](.+)", re.IGNORECASE)
_MASKS: Final = ("mask", "label", "labels", "seg", "segmap")
_COLOURS: Final = ("color", "colour", "rgb")
_INFOS: Final = ("info", "camera", "camera_info", "camera-info", "intrinsics", "meta")
_NAMES_OF_K: Final = ("K", "k", "intrinsic_matrix", "intrinsics", "camera_matrix", "cam_K")
_NAMES_OF_D: Final = ("D", "coeffs", "distortion_coefficients", "distortion_coeffs", "distortion")
_NAMES_OF_P: Final = ("P", "projection_matrix")
_NAMES_OF_COLOURS: Final = ("color", "rgb")
_NAMES_OF_SCALE: Final = ("factor_depth", "depth_scale")
_COARSEST_M: Final = 0.02  # unit of whole numbers that no camera exceeds
_UNUSABLE: Final = (
    CloudError,
    ValueError,
    TypeError,
    IndexError,
    OverflowError,
    AttributeError,
)  # of numbers in a file


@dataclass(frozen=True, kw_only=True)
class DepthCamera:
    """What is known of the camera, the unit and the colours of depth images, besides what they state; it goes before that."""

    intrinsics: tuple[float, ...] = ()  # fx, fy, cx, cy [px], without distortion
    info: Path | None = None  # a file with the camera
    scale: float | None = None  # metres per unit
    rectified: bool | None = None  # whether the images are rectified; by default by their names
    info_topic: str = ""  # of the camera infos in a recording
    color: str | Path = ""  # a file with the colours of the pixels of one image
    remarks: list[str] = field(
        default_factory=list, compare=False
    )  # what is odd about the cameras of the images so far

    def __post_init__(self) -> None:
        require_type(self.intrinsics, tuple | list, "--intrinsics", "not the numbers (fx, fy, cx, cy)", ConfigError)
        twice = [name for name in self.stated if name in ("--intrinsics", "--camera-info", "--info-topic")]
        if len(twice) > 1:
            raise ConfigError(f"{', '.join(twice)}: state the camera twice; give one of them")
        if self.intrinsics and self.rectified is not None:
            raise ConfigError(
                "--intrinsics, --rectified: intrinsics are those of the images, rectified or not; leave one out"
            )

    @property
    def stated(self) -> tuple[str, ...]:
        """The options of commands that state something."""
        given = {
            "--intrinsics": bool(self.intrinsics),
            "--camera-info": self.info is not None,
            "--depth-scale": self.scale is not None,
            "--rectified": self.rectified is not None,
            "--info-topic": bool(self.info_topic),
            "--color": bool(self.color),
        }
        return tuple(name for name, is_given in given.items() if is_given)

    @property
    def is_known(self) -> bool:
        """Whether it states intrinsics."""
        return bool(self.intrinsics or self.info)

    def cloud(self, path: Path, depth: AnyArray, facts: Mapping[str, Any] | None = None) -> Cloud:
        """Make the cloud of the depth image of a file.

        Args:
            path: The file, for messages; its name may say which of several images it is, and whether it is rectified.
            depth: (H, W) whole numbers or floats.
            facts: What the file states beside it, such as `K` or `color`.

        Raises:
            FileError: If no camera is known, or the image is no depth image, or not of the size or unit of the camera, or
                its colours are none, or of another size.
        """
        stated = _named(facts or {})
        if self.info:
            stated |= camera_facts(self.info, path.stem)
        if not self.intrinsics and _first(stated, _NAMES_OF_K) is None:
            cure = "give --intrinsics fx,fy,cx,cy, --camera-info FILE, or K beside `depth` in an .npz"
            raise FileError(path, f"is a depth image without its camera: {cure}", field="depth")
        depth = _as_depth(depth)
        try:
            model = self._model(stated, check_image(depth), path.stem)
            scale = self.scale if self.scale is not None else _scale(stated, depth)
            cloud = Cloud.from_depth(depth, model, scale, rgb=self._colours(path, model.shape, stated))
        except _UNUSABLE as err:
            where = f" (of the camera in {self.info})" if self.info else ""
            raise FileError(path, f"{err}{where}") from err
        if not np.isfinite(cloud.xyz[..., 2]).any():
            raise FileError(path, f"no pixel of {depth.size} has a depth", field="depth")
        return cloud

    def _colours(self, path: Path, shape: tuple[int, int], stated: Mapping[str, Any]) -> UInt8 | None:
        """Return the colours (H, W, 3) of the depth image in a file: of `color`, else what the file states."""
        if self.color:
            return read_colours(self.color, shape, path)
        given = _first(stated, _NAMES_OF_COLOURS)
        if given is None:
            return None
        try:
            colours = as_colours(np.asarray(given))
            require_size(colours, shape, "`depth`")
        except CloudError as err:
            raise FileError(path, str(err), field="color") from err
        return colours

    def require_none(self, path: Path, what: str) -> None:
        """Refuse a source that has no use for what is stated, by a `FileError` that says `what` it is."""
        if self.stated:
            raise FileError(path, f"{what}: leave out {', '.join(self.stated)}, which is for depth images")

    @lru_cache(maxsize=8)  # noqa: B019  of a few recordings
    def recorded(self, shape: tuple[int, int], topic: str) -> tuple[CameraModel, float | None]:
        """Return the camera of the images of a recording, and their metres per unit where these are stated.

        Args:
            shape: Rows and columns of the images.
            topic: Of the images.

        Raises:
            FileError: If `info` cannot be read.
            CloudError: If it is no camera of such images.
        """
        stated = camera_facts(self.info, topic) if self.info else {}
        try:
            scale = self.scale if self.scale is not None else _scale(stated, np.empty(0, np.uint16))
            return self._model(stated, shape, topic.rpartition("/")[2]), scale
        except CloudError as err:
            raise CloudError(f"{err} (of the camera in {self.info})" if self.info else str(err)) from err
        except _UNUSABLE as err:
            raise FileError(self.info or "", str(err)) from err

    def _model(self, stated: Mapping[str, Any], shape: tuple[int, int], name: str) -> CameraModel:
        """Return the camera of images of a shape and a name."""
        if self.intrinsics:
            whole = CameraModel.of(self.intrinsics, shape[1], shape[0])
        else:
            info = _as_info(stated, shape)
            model = camera_model(info, rectified=self._is_rectified(info, name))
            if info.roi.width or info.roi.height:
                return model
            whole = CameraModel.of(model.matrix, model.width, model.height, model.distortion)
        if whole.remark and not any(one.endswith(whole.remark) for one in self.remarks):
            self.remarks.append(f"{name}: {whole.remark}")
        return whole

    def _is_rectified(self, info: Any, name: str) -> bool:
        """Return whether P describes an image; a `CloudError` if it is another camera than K, and nothing says which is meant."""
        if self.rectified is not None:
            return self.rectified
        k, p = info.k[[0, 4, 2, 5]], info.p[[0, 5, 2, 6]]
        if not info.p.any() or np.allclose(k, p, rtol=1e-3, atol=0.1):
            return False
        if (kind := re.search(r"image[-_](rect|raw)", name, re.IGNORECASE)) is not None:
            return kind[1].lower() == "rect"
        focal = f"{k[0]:g} px of raw images (K), {p[0]:g} px of rectified ones (P)"
        raise CloudError(f"camera: fx is {focal}: give --rectified yes or --rectified no, whichever this image is")


def _as_depth(depth: AnyArray) -> AnyArray:
    """Return the image without sides of length one, whole numbers as uint16 where they fit, and half floats as float32."""
    if depth.ndim == 3 and 1 in (depth.shape[0], depth.shape[2]):
        depth = depth.squeeze(2 if depth.shape[2] == 1 else 0)
    if (
        depth.dtype.kind in "iu"
        and depth.dtype.itemsize > 1
        and depth.size
        and depth.min() >= 0
        and depth.max() < 2**16
    ):
        return depth.astype(np.uint16)
    return depth.astype(np.float32) if depth.dtype == np.float16 else depth


def _row_major(matrix: AnyArray) -> AnyArray:
    """Return intrinsics (9,) by rows, of a matrix or of fx, fy, cx, cy; Open3D stores matrices by columns."""
    if matrix.size == 4:
        fx, fy, cx, cy = matrix.ravel()
        return np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
    if matrix.size != 9:
        raise CloudError(f"K: shape {matrix.shape} is neither (3, 3) nor the four numbers fx, fy, cx, cy")
    matrix = matrix.reshape(3, 3)
    if not matrix[:2, 2].any() and matrix[2, :2].any():
        matrix = matrix.T
    if matrix.any() and (matrix[[0, 1, 2, 2], [1, 0, 0, 1]].any() or matrix[2, 2] != 1.0):
        raise CloudError("K: is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return matrix.ravel()


def _as_info(stated: Mapping[str, Any], shape: tuple[int, int]) -> Any:
    """Return the fields of a `sensor_msgs/CameraInfo` that a file states, of images of a shape."""
    roi = stated.get("roi") or {}
    if not isinstance(roi, dict):
        raise CloudError(f"roi: {shown(roi, 60)} is not a mapping of x_offset, y_offset, width and height")
    region = {name: _whole(roi.get(name), f"roi.{name}") for name in ("x_offset", "y_offset", "width", "height")}
    bins = {name: _whole(stated.get(name), name) for name in ("binning_x", "binning_y")}
    width = _whole(stated.get("width"), "width") or shape[1] * max(1, bins["binning_x"])
    height = _whole(stated.get("height"), "height") or shape[0] * max(1, bins["binning_y"])
    d, p = _first(stated, _NAMES_OF_D), _first(stated, _NAMES_OF_P)
    model = stated.get("distortion_model") or stated.get("model") or MODELS[0]  # OpenCV states none
    return SimpleNamespace(
        **{"width": width, "height": height, "roi": SimpleNamespace(**region), **bins},
        k=_row_major(np.asarray(_first(stated, _NAMES_OF_K), np.float64)),
        d=np.zeros(0) if d is None else np.ravel(np.asarray(d, np.float64)),
        p=np.zeros(12) if p is None else np.ravel(np.asarray(p, np.float64)),
        distortion_model="fisheye" if stated.get("fisheye_model") else str(model),
    )


def _whole(value: Any, name: str) -> int:
    """Return a whole number of pixels, 0 where it is absent."""
    value = np.ravel(0 if value is None else value)
    if (
        value.size != 1
        or value.dtype.kind not in "iuf"
        or not float(value[0]).is_integer()
        or not 0 <= value[0] < 2**31
    ):
        raise CloudError(f"{name}: {shown(value.tolist(), 60)} is not a whole number of pixels")
    return int(value[0])


def _first(stated: Mapping[str, Any], names: Iterable[str]) -> Any:
    """Return what is stated under the first of some names that is; None if none is."""
    return next((stated[name.lower()] for name in names if stated.get(name.lower()) is not None), None)


def _scale(stated: Mapping[str, Any], depth: AnyArray) -> float | None:
    """Return metres per unit by a file; None if it does not state them.

    It states them (RealSense), their inverse (Open3D, GraspNet, TUM), or millimetres per unit (BOP). A metre has at least 50
    units where they are whole numbers.
    """
    scale = next((float(np.ravel(stated[name])[0]) for name in _NAMES_OF_SCALE if name in stated), None)
    if scale is None or not 0.0 < scale < math.inf:
        return scale
    if scale > 1.0:
        return 1.0 / scale
    is_bop = "cam_k" in stated or (scale >= _COARSEST_M and depth.dtype.kind in "iu")
    return scale * 1e-3 if is_bop else scale


def camera_facts(path: Path, image: str) -> dict[str, Any]:
    """Return what a file states of a camera, by name in lower case.

    Args:
        path: The file.
        image: Name of the image; where a file of BOP describes several, its number is in it.

    Raises:
        FileError: If it cannot be read or holds no intrinsics.
    """
    path, suffix = require_existing(path), path.suffix.lower()
    if suffix == ".xml":
        raise FileError(path, "is XML, as of OpenCV, which is not read: write it as .yaml, or give --intrinsics")
    if suffix not in _INFO_SUFFIXES:
        raise FileError(path, f"suffix: {none_of(suffix, _INFO_SUFFIXES)}")
    try:
        facts = _READERS[suffix](path)
    except FileError:
        raise
    except Exception as err:  # the parsers raise errors of many kinds on damaged bytes
        raise FileError(path, f"holds no camera: {described(err)}") from err
    facts = _of_image(path, facts, image) if isinstance(facts, dict) else {}
    facts = facts.get("intrinsic", facts)
    stated = _named(facts if isinstance(facts, dict) else {})
    for name, other in (("width", "image_width"), ("height", "image_height"), ("cx", "ppx"), ("cy", "ppy")):
        stated.setdefault(name, stated.get(other))
    if all(stated.get(name) is not None for name in ("fx", "fy", "cx", "cy")):
        stated.setdefault("k", [stated[name] for name in ("fx", "fy", "cx", "cy")])
    if _first(stated, _NAMES_OF_K) is None:
        raise FileError(path, f"holds no camera: none of {', '.join(_NAMES_OF_K)}, or fx, fy, cx, cy")
    return stated


def _of_image(path: Path, facts: dict[str, Any], image: str) -> dict[str, Any]:
    """Return the camera of an image in BOP's `scene_camera.json`, which has one for each; other files as they are."""
    if not facts or not all(isinstance(entry, dict) and "cam_K" in entry for entry in facts.values()):
        return facts
    number = re.search(r"\d+", image)
    key = str(int(number[0])) if number else ""
    if key in facts or len(facts) == 1:
        return dict(facts.get(key) or next(iter(facts.values())))
    raise FileError(path, f"describes {len(facts)} images by their numbers, and {shown(image)} is none of them")


def _named(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return facts by name in lower case, without what is empty, and matrices as their numbers."""
    return {
        str(name).lower(): fact["data"] if isinstance(fact, dict) and "data" in fact else fact
        for name, fact in facts.items()
        if not (fact is None or (isinstance(fact, str) and fact == EMPTY))
    }


def _read_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    content = read_bytes(path, _MAT_LIMIT)
    known = [*_NAMES_OF_K, *_NAMES_OF_SCALE]
    there = {name: (math.prod(shape), kind) for name, shape, kind in whosmat(io.BytesIO(content)) if name in known}
    for name, (size, kind) in there.items():
        if size > _MOST_NUMBERS or not re.fullmatch(r"double|single|u?int\d+", kind):
            raise FileError(path, f"{size} of {kind} are not the few numbers of a camera", field=name)
    return dict(loadmat(io.BytesIO(content), variable_names=[*there]))


def _read_text(path: Path) -> dict[str, Any]:
    words = read_bytes(path, _MAT_LIMIT).decode("utf-8", "replace").replace(",", " ").split()
    try:
        return {"K": np.array(words, np.float64)}
    except ValueError:
        raise FileError(path, "holds no camera: is not a matrix of numbers") from None  # anyone may name the file


def _read_json(path: Path) -> Any:
    content = read_bytes(path, _LIMIT)
    try:
        return json_in(path, content)
    except FileError as err:
        raise FileError(path, f"holds no camera: {err.rule}", field=err.field) from err


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        return load_yaml(path, _LIMIT, first=True)
    except ConfigError as err:
        rule = str(err).removeprefix(f"{shown(path)}: ")
        raise FileError(path, f"holds no camera: {rule}") from err


_READERS: Final[Mapping[str, Callable[[Path], Any]]] = {
    ".mat": _read_mat,
    ".txt": _read_text,
    ".json": _read_json,
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
}


@dataclass(frozen=True)
class Pairs:
    """The files of a folder that belong together, by the rule of `PAIRING`."""

    masks: dict[Path, Path]  # of depth images
    infos: dict[Path, Path]
    colours: dict[Path, Path]
    depths: frozenset[Path]
    others: frozenset[Path]  # masks, colours and files of cameras, which are no inputs

    @classmethod
    def of(cls, files: Iterable[Path]) -> "Pairs":
        """Pair the files of a folder."""
        files = list(files)
        by_stem: dict[str, list[Path]] = {}
        for file in files:
            by_stem.setdefault(file.stem.lower(), []).append(file)

        def first(stems: Iterable[str], suffixes: tuple[str, ...]) -> Path | None:
            fitting = (
                file for stem in stems for file in by_stem.get(stem.lower(), []) if file.suffix.lower() in suffixes
            )
            return next(fitting, None)

        masks: dict[Path, Path] = {}
        infos: dict[Path, Path] = {}
        colours: dict[Path, Path] = {}
        depths = set()
        for file in files:
            match = _DEPTH.fullmatch(file.stem)
            if match is None or file.suffix.lower() not in (*IMAGE_SUFFIXES, ".npy"):
                continue
            depths.add(file)
            name = match[1] or match[2]
            for there, stems, suffixes in (
                (masks, _names_with(name, _MASKS), MASK_SUFFIXES),
                (infos, [*_names_with(name, _INFOS), *_INFOS], _INFO_SUFFIXES),
                (colours, _names_with(name, _COLOURS), COLOUR_SUFFIXES),
            ):
                if (found := first(stems, suffixes)) is not None:
                    there[file] = found
        others = frozenset((*masks.values(), *infos.values(), *colours.values()))
        return cls(masks, infos, colours, frozenset(depths), others)


def _names_with(name: str, words: Iterable[str]) -> list[str]:
    """Return the names of files that belong to a depth image by one of some words, the first word first."""
    return [text for word in words for text in (f"{name}-{word}", f"{name}_{word}", f"{word}-{name}", f"{word}_{name}")]
