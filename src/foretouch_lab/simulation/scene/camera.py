# SPDX-License-Identifier: Apache-2.0
"""The depth camera of a scene: where it stands, and which of its faults are simulated."""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch_lab.simulation.scene.ranges import Switch
from foretouch_lab.simulation.view import CameraView


@dataclass(frozen=True, kw_only=True)
class DepthNoiseConfig(Settings):
    """Error of the stereo matching, sigma_z = s z² / (f B), correlated over the matching window."""

    sub_pixel: float = setting(0.05, "Standard deviation s of the disparity", unit="px", bounds=(0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class CameraConfig(Settings):
    """An eye-to-hand camera that looks at the world's origin.

    The defaults give a point every 2 mm, as the clouds of the first paper have: a D415 at 640x480, aligned to
    colour, has a focal length of about 615 px, hence 55 degrees across.

    Attributes:
        noise: Noise of the depth.
        stereo: What only one of the two imagers, side by side, sees has no depth.
        flying_pixels: Half of the pixels at a depth edge lie between both sides.
        holes: Pixels have no depth at random spots, and where the surface turns away from the camera.
        segmented: The object's points are those that segmentation finds in the image, as in the graph: steep flanks lack some.
    """

    width: int = setting(640, "Columns of the image", unit="px", bounds=(16, 1920))
    height: int = setting(480, "Rows of the image", unit="px", bounds=(16, 1080))
    hfov_deg: float = setting(55.0, "Horizontal field of view", bounds=(10.0, 120.0))
    distance_m: float = setting(1.25, "Distance from the world's origin", bounds=(0.16, 10.0))
    tilt_deg: float = setting(
        0.0, "Angle between the optical axis and the vertical; 0 looks straight down", bounds=(0.0, 85.0)
    )
    z_step_m: float | None = setting(None, "Step that depth is rounded to; absent for exact depth", bounds=(1e-5, 0.05))
    noise: DepthNoiseConfig | None = None
    stereo: Switch | None = None
    flying_pixels: Switch | None = None
    holes: Switch | None = None
    segmented: Switch | None = None

    def view(self) -> CameraView:
        """Pose and intrinsics in the world."""
        return CameraView.towards_table(
            self.width, self.height, self.distance_m, float(np.radians(self.tilt_deg)), self.hfov_deg
        )
