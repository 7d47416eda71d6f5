# SPDX-License-Identifier: Apache-2.0
"""The depth camera of a scene: where it stands, and which of its faults are simulated."""

from dataclasses import dataclass

import numpy as np

from foretouch.camera.deproject import pinhole_matrix
from foretouch.config import Settings, setting
from foretouch.simulation.view import CameraView


@dataclass(frozen=True, kw_only=True)
class StereoConfig(Settings):
    """Two imagers side by side: what only one of them sees has no depth."""

    baseline_m: float = setting(0.055, "Distance of the imagers (D415)", unit="m", minimum=0.001, maximum=0.5)


@dataclass(frozen=True, kw_only=True)
class DepthNoiseConfig(Settings):
    """Error of the stereo matching, sigma_z = s z² / (f B), correlated over the matching window."""

    sub_pixel: float = setting(0.05, "Standard deviation s of the disparity", unit="px", minimum=0.0, maximum=1.0)
    baseline_m: float = setting(0.055, "Distance B of the imagers (D415)", unit="m", minimum=0.001, maximum=0.5)


@dataclass(frozen=True, kw_only=True)
class FlyingPixelConfig(Settings):
    """Pixels at a depth edge that hang between both sides."""

    share: float = setting(0.5, "Part of the edge's pixels that fly", minimum=0.0, maximum=1.0)


@dataclass(frozen=True, kw_only=True)
class HoleConfig(Settings):
    """Pixels without depth: at random spots, and where the surface turns away from the camera."""

    share: float = setting(0.01, "Part of the pixels that lie in random spots", minimum=0.0, maximum=0.5)
    grazing_deg: float = setting(
        80.0,
        "Angle between ray and surface normal beyond which there is no depth",
        unit="deg",
        minimum=1.0,
        maximum=90.0,
    )


@dataclass(frozen=True, kw_only=True)
class CameraConfig(Settings):
    """An eye-to-hand camera that looks at the world's origin.

    The defaults give a point every 2 mm, as the clouds of the first paper have: a D415 at 640x480, aligned to
    colour, has a focal length of about 615 px, hence 55 degrees across.
    """

    width: int = setting(640, "Columns", unit="px", minimum=16, maximum=1920)
    height: int = setting(480, "Rows", unit="px", minimum=16, maximum=1080)
    hfov_deg: float = setting(55.0, "Horizontal field of view", unit="deg", minimum=10.0, maximum=120.0)
    distance_m: float = setting(1.25, "From the world's origin", unit="m", minimum=0.16, maximum=10.0)
    tilt_deg: float = setting(
        0.0, "Between its axis and the vertical; 0 looks straight down", unit="deg", minimum=0.0, maximum=85.0
    )
    z_step_m: float | None = setting(
        None, "Step that depth is rounded to; absent for exact depth", unit="m", minimum=1e-5, maximum=0.05
    )
    noise: DepthNoiseConfig | None = None
    stereo: StereoConfig | None = None
    flying_pixels: FlyingPixelConfig | None = None
    holes: HoleConfig | None = None

    def view(self) -> CameraView:
        """Pose and intrinsics in the world."""
        view = CameraView.towards_table(self.width, self.height, self.distance_m, float(np.radians(self.tilt_deg)))
        matrix = pinhole_matrix(self.width, self.height, self.hfov_deg)
        return CameraView(self.width, self.height, matrix, view.eye, view.R_world_camera)
