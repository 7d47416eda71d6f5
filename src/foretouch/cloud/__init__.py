# SPDX-License-Identifier: Apache-2.0
"""Point clouds: files, ROS messages, segmentation, filters, and the preparation of model inputs."""

from foretouch.cloud.geometry.sampling import UnitSphereFrame, sample_indices
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.cloud.io.pointcloud2 import decode, encode
from foretouch.cloud.segmentation.clusters import CropConfig
from foretouch.cloud.segmentation.objects import TargetConfig, select_targets
from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment

__all__ = [
    "CropConfig",
    "PlaneConfig",
    "SegmentationConfig",
    "TargetConfig",
    "UnitSphereFrame",
    "decode",
    "encode",
    "fit_plane",
    "read_cloud",
    "sample_indices",
    "segment",
    "select_targets",
    "write_cloud",
]
