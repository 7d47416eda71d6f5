# SPDX-License-Identifier: Apache-2.0
"""Decode depth images and camera infos of rclpy or rosbags, or any objects with their fields, without ROS.

- `sensor_msgs/Image`: 16UC1 and mono16 are millimetres, 32FC1 is metres (REP 118), in either byte order.
- `sensor_msgs/CompressedImage` of image_transport's `compressedDepth`: four bytes of a format, two float32 A and B, and a 16-bit
  PNG, or RVL behind columns and rows as uint32. Its whole numbers q are the depth of 16UC1; of 32FC1 they stand for A / (q - B).
- `sensor_msgs/CameraInfo`, and which of them belongs to an image (`CameraInfos`).
"""

import re
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.images import check_size, decode_image
from foretouch.errors import CalibrationError, CloudError, shown
from foretouch.kernels import Kernel
from foretouch.types import AnyArray, Cloud, Float32, UInt8, stamp_ns
from foretouch.types.camera import MODELS, CameraModel

_decode_rvl = Kernel("decode_rvl")

ENCODINGS: Final = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""Encodings of depth images, with the type of a pixel."""

_PNG: Final = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
_HEADER: Final = 12  # bytes before the data of a compressed image
_UNDONE: Final = (*MODELS, "brown_conrady", "radtan")  # names of RealSense and Kalibr for `plumb_bob`
_FISHEYES: Final = ("equidistant", "equi", "fisheye", "kannala_brandt4")
_MOST: Final = 32  # frames and sizes that are remembered
_PATIENCE_S: Final = 3.0  # without a camera info until that is an error, and between infos of two publishers


def decode_depth(message: Any) -> AnyArray:
    """Decode a `sensor_msgs/Image` or a `sensor_msgs/CompressedImage`.

    Returns:
        (H, W) uint16 [mm] or float32 [m], as `Cloud.from_depth` takes it. Of an `Image` it is a view of the message, which
        must stay unchanged as long as it is used.

    Raises:
        CloudError: If it is no depth image, or damaged. The message names the field and the rule.
    """
    return image_pixels(message, _pixel(message.encoding)) if hasattr(message, "encoding") else _compressed(message)


def image_pixels(message: Any, pixel: str) -> AnyArray:
    """View the pixels of a `sensor_msgs/Image` with one number each.

    Args:
        message: The image.
        pixel: Type of a pixel in NumPy's letters, such as `u2`.

    Returns:
        (H, W) in the byte order of the message, which must stay unchanged as long as they are used.

    Raises:
        CloudError: If sizes and bytes do not fit together.
    """
    kind = np.dtype(pixel).newbyteorder(">" if message.is_bigendian else "<")
    height = message.height
    width = message.width
    step = message.step
    check_size(height, width)
    if step < width * kind.itemsize:
        raise CloudError(f"step: {step} bytes is less than a row of {width} x {kind.itemsize}")
    data = _bytes(message.data)
    if data.size != step * height:
        raise CloudError(f"data: {data.size} bytes are not step {step} x height {height}")
    return np.ndarray((height, width), kind, data, 0, (step, kind.itemsize))


def _compressed(message: Any) -> AnyArray:
    encoding, _, transport = (part.strip() for part in message.format.partition(";"))
    name, *codecs = transport.split() or [""]
    codec = codecs[-1] if codecs else "png"
    if name != "compressedDepth" or codec not in {"png", "rvl"}:
        raise CloudError(f"format: {shown(message.format)!r} is not `ENCODING; compressedDepth png` or `rvl`")
    is_metric = _pixel(encoding) == "f4"
    data = _bytes(message.data)
    if data.size <= _HEADER:
        raise CloudError(f"data: {data.size} bytes, a compressed depth image has more than {_HEADER}")
    numbers = (_from_png if codec == "png" else _from_rvl)(data[_HEADER:])
    if not is_metric:
        return numbers
    a, b = struct.unpack("<2f", data[4:_HEADER].tobytes())
    if not (np.isfinite([a, b]).all() and a > 0.0):
        raise CloudError(f"data: the quantisation A {a:g}, B {b:g} of a 32FC1 image does not fit inverse depth")
    with np.errstate(divide="ignore"):
        depth: Float32 = np.float32(a) / (numbers.astype(np.float32) - np.float32(b))
    depth[numbers == 0] = np.nan
    return depth


def _from_png(data: UInt8) -> AnyArray:
    """Return a greyscale PNG of 16 bits; the header that the decoder goes by decides about its size, before anything is unpacked."""
    head = data[:26].tobytes()
    if len(head) < 26 or not head.startswith(_PNG):
        raise CloudError("data: is no PNG that begins with its header")
    width, height, bits, colour = struct.unpack_from(">2I2B", head, 16)
    check_size(height, width)
    if (bits, colour) != (16, 0):
        raise CloudError(f"data: a PNG of {bits} bits and colour type {colour} is not one of 16 bits in grey")
    try:
        numbers = decode_image(data.tobytes())
    except CloudError as err:
        raise CloudError(f"data: the PNG {err}") from err
    if numbers.shape != (height, width):
        raise CloudError(f"data: the PNG is damaged: its pixels are {numbers.shape}, its header says {width}x{height}")
    return numbers.astype(np.uint16, copy=False)


def _from_rvl(data: UInt8) -> AnyArray:
    if data.size < 8 or data.size % 4:
        raise CloudError(f"data: the RVL is truncated: {data.size} bytes are not whole words")
    width, height = struct.unpack("<2I", data[:8].tobytes())
    check_size(height, width)
    depth, decoded = np.empty((height, width), np.uint16), np.empty(1, np.int64)
    _decode_rvl(data[8:], data.size // 4 - 2, depth.size, depth, decoded)
    if decoded[0] != depth.size:
        raise CloudError(f"data: the RVL is truncated or damaged after {decoded[0]} of {depth.size} pixels")
    return depth


def _pixel(encoding: str) -> str:
    if encoding not in ENCODINGS:
        raise CloudError(f"encoding: {shown(encoding)!r} is no depth image: {', '.join(ENCODINGS)} are")
    return ENCODINGS[encoding]


def _bytes(data: Any) -> UInt8:
    try:
        return np.frombuffer(data, np.uint8)
    except (TypeError, ValueError, BufferError) as err:
        raise CloudError(f"data: {err}") from err


def is_rectified(topic: str) -> bool:
    """Return whether images on a topic are rectified by the rule of ROS, `image_rect…`: their info describes the raw ones too."""
    return topic.removesuffix("/compressedDepth").rpartition("/")[2].startswith("image_rect")


def info_topic(topic: str) -> str:
    """Return the topic of the camera infos of the images on a topic: `camera_info` beside it."""
    return topic.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info"


def camera_model(info: Any, *, rectified: bool = False) -> CameraModel:
    """Make the camera of a `sensor_msgs/CameraInfo`, for the images that its binning and region of interest give.

    Args:
        info: The message; of ROS 1 too, whose fields are D, K and P.
        rectified: Whether its images are rectified: then P describes them, without distortion.

    Raises:
        CloudError: If K is zero or not possible, or the distortion model is another one. The message names the field.
    """
    k, p, d = (np.asarray(_either(info, name), np.float64) for name in "kpd")
    if (k.size, p.size) != (9, 12):
        raise CloudError(f"camera_info: K of {k.size} and P of {p.size} numbers are not 9 and 12")
    fx, fy, cx, cy = k[[0, 4, 2, 5]].tolist()
    if rectified and p.any():
        fx, fy, cx, cy = p[[0, 5, 2, 6]].tolist()
    elif not rectified:
        _check_model(info.distortion_model, d)
    roi, bins = info.roi, (max(1, info.binning_x), max(1, info.binning_y))
    width, height = (roi.width or info.width) // bins[0], (roi.height or info.height) // bins[1]
    try:
        return CameraModel(
            width,
            height,
            fx / bins[0],
            fy / bins[1],
            (cx - roi.x_offset) / bins[0],
            (cy - roi.y_offset) / bins[1],
            () if rectified else tuple(d.tolist()),
        )
    except CloudError as err:
        raise CloudError(f"camera_info: {err}") from err


def _either(info: Any, name: str) -> Any:
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _check_model(model: str, coefficients: AnyArray) -> None:
    """Refuse a distortion that is not OpenCV's; of a model without coefficients only a fisheye bends the rays."""
    name = re.sub(r"[ -]", "_", model.rpartition(".")[2].lower())
    if name in _UNDONE or (not coefficients.any() and name not in _FISHEYES):
        return
    raise CloudError(
        f"camera_info: distortion_model {shown(model)!r} cannot be undone, only {' and '.join(MODELS)}: "
        "use the rectified image"
    )


@dataclass
class _Known:
    """The camera of a frame and size, or why it is refused, and what was known before it."""

    camera: CameraModel | str
    key: bytes
    seen_s: float
    before: CameraModel | str | None = None
    before_s: float = 0.0  # when that was seen last
    alternates_s: float | None = None  # when it was last seen again after another one


class CameraInfos:
    """The camera of each depth image, by the frame and size of its `camera_info`.

    Args:
        topic: Where the images come from; it names them in messages, and says whether they are rectified.
        infos: Topic of the infos; by default `camera_info` beside.
        rectified: Whether the images are rectified, whatever the name of their topic.
        scale: Metres per unit of the images; by default that of their encoding.
    """

    def __init__(
        self,
        topic: str = "depth/image",
        infos: str | None = None,
        *,
        rectified: bool | None = None,
        scale: float | None = None,
    ) -> None:
        self.topic = topic
        self._infos = infos or info_topic(topic)
        self._rectified = is_rectified(topic) if rectified is None else rectified
        self._scale = scale
        self._known: dict[tuple[str, int, int], _Known] = {}
        self._missing_s: float | None = None  # of the first image without an info

    def add(self, info: Any, now_s: float) -> str:
        """Add a `sensor_msgs/CameraInfo` that arrived at a time [s], of any clock.

        Returns:
            What to report about it: that the camera changed, what is odd about it, or why it is refused; "" if it is as before.
        """
        key, place = _key(info), _place(info)
        known = self._known.get(place)
        if known is not None and known.key == key:
            known.seen_s = now_s
            return ""
        camera: CameraModel | str
        try:
            camera = camera_model(info, rectified=self._rectified)
        except CloudError as err:
            camera = str(err)
        if known is not None and known.camera == camera:
            known.key, known.seen_s = key, now_s
            return ""
        if known is None:
            if len(self._known) == _MOST:
                del self._known[next(iter(self._known))]
            self._known[place] = _Known(camera, key, now_s)
            if isinstance(camera, str):
                return camera
            return f"{self._infos}: {camera.remark}" if camera.remark and not info.roi.width else ""
        self._known[place] = new = _Known(camera, key, now_s, known.camera, known.seen_s, known.alternates_s)
        if known.before == camera and now_s - known.before_s < _PATIENCE_S:
            was_told, new.alternates_s = _alternates(known, now_s), now_s
            return "" if was_told else self._two(place)
        return f"{self._infos}: the camera of {_named(place)} changed to {camera}"

    def cloud(self, message: Any, now_s: float, rgb: UInt8 | None = None) -> Cloud:
        """Make the cloud of a depth message, raw or compressed, with the frame and stamp of its header.

        Args:
            message: A `sensor_msgs/Image` or a `sensor_msgs/CompressedImage`.
            now_s: When it arrived [s], as in `add`.
            rgb: (H, W, 3) colours of its pixels.

        Raises:
            CalibrationError: As `camera`.
            CloudError: As `decode_depth` and `Cloud.from_depth`.
        """
        depth, frame_id = decode_depth(message), message.header.frame_id
        camera = self.camera(frame_id, (depth.shape[0], depth.shape[1]), now_s)
        stamp = stamp_ns(message.header.stamp)
        return Cloud.from_depth(depth, camera, self._scale, frame_id=frame_id, stamp_ns=stamp, rgb=rgb)

    def camera(self, frame_id: str, shape: tuple[int, int], now_s: float) -> CameraModel:
        """Find the camera of an image.

        Args:
            frame_id: Of its header.
            shape: Its rows and columns.
            now_s: When it arrived [s], as in `add`.

        Raises:
            CalibrationError: If no camera info is known: its `reason` is `no_camera_info`, for the first 3 s `awaits_camera_info`;
                `other_size`, `other_frame`, `two_camera_infos` or `bad_camera_info`.
        """
        place = (frame_id, *shape)
        known = self._known.get(place) or self._known.get(("", *shape))
        if known is None:
            raise self._missing(place, now_s)
        self._missing_s = None
        if _alternates(known, now_s):
            raise CalibrationError(self._two(place), "two_camera_infos")
        if isinstance(known.camera, str):
            raise CalibrationError(known.camera, "bad_camera_info")
        return known.camera

    def _missing(self, place: tuple[str, int, int], now_s: float) -> CalibrationError:
        if self._missing_s is None:
            self._missing_s = now_s
        info, image = self._infos, f"an image of {_named(place)}"
        for reason, same in (("other_size", slice(0, 1)), ("other_frame", slice(1, 3))):
            others = [_named(other) for other in self._known if other[same] == place[same]]
            if others:
                return CalibrationError(f"{info}: is of {', '.join(others)}, not of {image}", reason)
        reason = "awaits_camera_info" if now_s - self._missing_s < _PATIENCE_S else "no_camera_info"
        there = f"; there are infos of {', '.join(map(_named, self._known))}" if self._known else ""
        waited = f"none for {now_s - self._missing_s:.1f} s" if self._missing_s < now_s else "none yet"
        return CalibrationError(f"{info}: {waited}, for {image}{there}", reason)

    def _two(self, place: tuple[str, int, int]) -> str:
        return f"{self._infos}: two different infos of {_named(place)} alternate: does it have two publishers?"


def _alternates(known: _Known, now_s: float) -> bool:
    return known.alternates_s is not None and now_s - known.alternates_s < _PATIENCE_S


def _place(info: Any) -> tuple[str, int, int]:
    """Return frame, rows and columns of the images of an info."""
    roi = info.roi
    height, width = roi.height or info.height, roi.width or info.width
    return info.header.frame_id, height // max(1, info.binning_y), width // max(1, info.binning_x)


def _key(info: Any) -> bytes:
    """Return what two infos of the same camera have in common."""
    roi = info.roi
    numbers = [*(np.asarray(_either(info, name), np.float64).tobytes() for name in "kpd")]
    size = (info.height, info.width, info.binning_x, info.binning_y, roi.x_offset, roi.y_offset, roi.height, roi.width)
    return b"|".join([*numbers, info.distortion_model.encode(), repr(size).encode()])


def _named(place: tuple[str, int, int]) -> str:
    frame, height, width = place
    return f"{width}x{height} in frame {shown(frame)!r}"
