# SPDX-License-Identifier: Apache-2.0
"""Read depth images from files, and the cameras that they are of, as drivers, Open3D, RealSense and GraspNet write them.

Depth: PNG of 16 bits, TIFF of 16 bits or floats, `.npy` with (H, W) numbers, `.npz` with `depth`, `depth_mm` or `depth_m`, and perhaps `K`. Cameras: YAML
of ROS (`camera_info`, or what `ros2 topic echo` prints), JSON of Open3D and RealSense, `meta.mat` of GraspNet, and (3, 3)
matrices as text.
"""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from foretouch.cloud.io.images import IMAGE_SUFFIXES
from foretouch.cloud.io.mask_files import MASK_SUFFIXES
from foretouch.errors import CloudError, FileError, described, none_of
from foretouch.files import read_bytes, require_existing
from foretouch.types import AnyArray, CameraModel, Cloud
from foretouch.types.camera import check_image

_INFO_SUFFIXES: Final = (".yaml", ".yml", ".json", ".mat", ".txt")
PAIRING: Final = (
    "a folder pairs NAME-depth.png (or .tif, .npy; _ for -) with NAME-mask, NAME-label or NAME-seg (.png, .npy), and with NAME-info, "
    "or camera_info, intrinsics or meta of all (.yaml, .json, .mat, .txt)"
)
"""The rule of folders, for help texts."""

_LIMIT: Final = 1_000_000  # bytes of a file of intrinsics
_DEPTH: Final = re.compile(r"(.+)[-_]depth|depth[-_](.+)", re.IGNORECASE)
_MASKS: Final = ("mask", "label", "labels", "seg", "segmap")
_INFOS: Final = ("info", "camera", "camera_info", "camera-info", "intrinsics", "meta")
_NAMES_OF_K: Final = ("K", "k", "intrinsic_matrix", "intrinsics", "camera_matrix", "cam_K")
_NAMES_OF_D: Final = ("D", "d", "coeffs", "distortion_coefficients", "distortion")
_OTHER_MODELS: Final = re.compile("inverse|modified|theta|fisheye|equidistant|kannala", re.IGNORECASE)
_NAMES_OF_SCALE: Final = ("factor_depth", "depth_scale")


@dataclass(frozen=True, kw_only=True)
class DepthCamera:
    """The camera and the unit of depth files that do not state them."""

    intrinsics: tuple[float, ...] = ()  # fx, fy, cx, cy [px]
    info: Path | None = None  # a file with the camera
    scale: float | None = None  # metres per unit

    def cloud(self, path: Path, depth: AnyArray, facts: Mapping[str, Any] | None = None) -> Cloud:
        """Make the cloud of the depth image of a file.

        Args:
            path: The file, for messages.
            depth: (H, W) whole numbers or floats.
            facts: What the file states beside it, such as `K`.

        Raises:
            FileError: If no camera is known, or the image is no depth image, or not of the size or unit of the camera.
        """
        facts = dict(facts or {}) | (_facts(self.info) if self.info else {})
        if self.intrinsics:
            facts |= {"K": self.intrinsics}
        matrix = next((facts[name] for name in _NAMES_OF_K if name in facts), None)
        if matrix is None:
            cure = "give --intrinsics fx,fy,cx,cy, --camera-info FILE, or K beside `depth` in an .npz"
            raise FileError(path, f"is a depth image without its camera: {cure}", field="depth")
        depth = _as_depth(depth)
        try:
            height, width = check_image(depth)
            if facts.get("width") and facts.get("height"):
                width, height = int(facts["width"]), int(facts["height"])  # of the camera, compared with the image
            model = CameraModel.of(_row_major(np.asarray(matrix, np.float64)), width, height, _distortion(facts))
            cloud = Cloud.from_depth(depth, model, self.scale if self.scale is not None else _scale(facts))
        except (CloudError, ValueError, TypeError, IndexError) as err:
            where = f" (of the camera in {self.info})" if self.info else ""
            raise FileError(path, f"{err}{where}") from err
        if not np.isfinite(cloud.xyz[..., 2]).any():
            raise FileError(path, f"no pixel of {depth.size} has a depth", field="depth")
        return cloud


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
    """Return the intrinsics by rows; Open3D stores them by columns."""
    if matrix.size == 9:
        matrix = matrix.reshape(3, 3)
        if not matrix[:2, 2].any() and matrix[2, :2].any():
            return matrix.T
    return matrix


def _distortion(facts: Mapping[str, Any]) -> AnyArray | None:
    """Return the coefficients of OpenCV's models, if there are any; a `CloudError` for a model that cannot be undone."""
    coefficients = next(
        (np.ravel(facts[name]).astype(np.float64) for name in _NAMES_OF_D if facts.get(name) is not None), None
    )
    model = str(facts.get("distortion_model") or facts.get("model") or "")
    if _OTHER_MODELS.search(model) and coefficients is not None and coefficients.any():
        raise CloudError(f"distortion: model {model!r} cannot be undone: use the rectified image with its K")
    return coefficients


def _scale(facts: Mapping[str, Any]) -> float | None:
    """Return metres per unit by a file, which states it (RealSense) or its inverse (Open3D, GraspNet); None if it does not."""
    scale = next((float(np.ravel(facts[name])[0]) for name in _NAMES_OF_SCALE if name in facts), None)
    return 1.0 / scale if scale is not None and scale > 1.0 else scale


def _facts(path: Path) -> dict[str, Any]:
    """Return what a file states of a camera, by name; a `FileError` if it cannot be read or holds no intrinsics."""
    path, suffix = require_existing(path), path.suffix.lower()
    if suffix not in _INFO_SUFFIXES:
        raise FileError(path, f"suffix: {none_of(suffix, _INFO_SUFFIXES)}")
    content = read_bytes(path, _LIMIT)
    try:
        if suffix == ".mat":
            import io

            from scipy.io import loadmat

            facts: Any = loadmat(io.BytesIO(content))
        elif suffix == ".txt":
            facts = {"K": np.array(content.decode().replace(",", " ").split(), np.float64)}
        elif suffix == ".json":
            facts = json.loads(content)
        else:
            facts = next(iter(yaml.safe_load_all(content)), None)  # `ros2 topic echo` prints several
    except Exception as err:  # the parsers raise errors of many kinds on damaged bytes
        raise FileError(path, f"holds no camera: {described(err)}") from err
    facts = facts.get("intrinsic", facts) if isinstance(facts, dict) else {}
    facts = facts if isinstance(facts, dict) else {}
    stated: dict[str, Any] = {
        name: fact["data"] if isinstance(fact, dict) and "data" in fact else fact for name, fact in facts.items()
    }
    for name, other in (("width", "image_width"), ("height", "image_height"), ("cx", "ppx"), ("cy", "ppy")):
        stated.setdefault(name, stated.get(other))
    if all(stated.get(name) is not None for name in ("fx", "fy", "cx", "cy")):
        stated.setdefault("K", [stated[name] for name in ("fx", "fy", "cx", "cy")])
    if not any(name in stated for name in _NAMES_OF_K):
        raise FileError(path, f"holds no camera: none of {', '.join(_NAMES_OF_K)}, or fx, fy, cx, cy")
    return stated


@dataclass(frozen=True)
class Pairs:
    """The files of a folder that belong together, by the rule of `PAIRING`."""

    masks: dict[Path, Path]  # of depth images
    infos: dict[Path, Path]
    depths: frozenset[Path]
    others: frozenset[Path]  # masks and files of cameras, which are no inputs

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

        masks = {}
        infos = {}
        depths = set()
        for file in files:
            match = _DEPTH.fullmatch(file.stem)
            if match is None or file.suffix.lower() not in (*IMAGE_SUFFIXES, ".npy"):
                continue
            depths.add(file)
            name = match[1] or match[2]
            mask = first(_names_with(name, _MASKS), MASK_SUFFIXES)
            if mask is not None:
                masks[file] = mask
            info = first([*_names_with(name, _INFOS), *_INFOS], _INFO_SUFFIXES)
            if info is not None:
                infos[file] = info
        return cls(masks, infos, frozenset(depths), frozenset((*masks.values(), *infos.values())))


def _names_with(name: str, words: Iterable[str]) -> list[str]:
    """Return the names of files that belong to a depth image by one of some words, the first word first."""
    return [text for word in words for text in (f"{name}-{word}", f"{name}_{word}", f"{word}-{name}", f"{word}_{name}")]
