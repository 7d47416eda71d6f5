# SPDX-License-Identifier: Apache-2.0
"""Point clouds: files, messages, segmentation, filters, sampling, and the frame that models see them in."""

from foretouch.cloud.crop import CropConfig, crop_box, crop_range
from foretouch.cloud.files import read_cloud, write_cloud
from foretouch.cloud.frame import UnitSphereFrame
from foretouch.cloud.objects import ObjectSegment
from foretouch.cloud.plane import PlaneConfig, fit_plane
from foretouch.cloud.pointcloud2 import PointCloud2Layout, PointField, decode, encode
from foretouch.cloud.sampling import sample_indices
from foretouch.cloud.segmentation import Segmentation, SegmentationConfig, segment
from foretouch.cloud.targets import TargetConfig, choose_targets

__all__ = [
    "CropConfig",
    "ObjectSegment",
    "PlaneConfig",
    "PointCloud2Layout",
    "PointField",
    "Segmentation",
    "SegmentationConfig",
    "TargetConfig",
    "UnitSphereFrame",
    "choose_targets",
    "crop_box",
    "crop_range",
    "decode",
    "encode",
    "fit_plane",
    "read_cloud",
    "sample_indices",
    "segment",
    "write_cloud",
]
