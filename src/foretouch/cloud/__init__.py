# SPDX-License-Identifier: Apache-2.0
"""Point clouds: files, messages, segmentation, filters, sampling, and the frame that models see them in."""

from foretouch.cloud.geometry.sampling import UnitSphereFrame, sample_indices
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.cloud.io.pointcloud2 import PointCloud2Layout, PointField, decode, encode
from foretouch.cloud.segmentation.crop import CropConfig, crop_box, crop_range
from foretouch.cloud.segmentation.objects import ObjectSegment
from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.cloud.segmentation.segment import Segmentation, SegmentationConfig, segment
from foretouch.cloud.segmentation.targets import TargetConfig, choose_targets

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
