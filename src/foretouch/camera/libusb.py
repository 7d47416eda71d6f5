# SPDX-License-Identifier: Apache-2.0
"""Make `import open3d` and `import pyrealsense2` work without libusb in the system.

Both wheels link against `libusb-1.0.so.0`, which minimal systems lack. The wheel `libusb-package` contains the same
library; loaded globally beforehand, it satisfies both.
"""

import ctypes

from foretouch.errors import MissingDependencyError


def ensure_libusb() -> None:
    """Load libusb from the system or else from the wheel; a `MissingDependencyError` if neither has it."""
    try:
        ctypes.CDLL("libusb-1.0.so.0", mode=ctypes.RTLD_GLOBAL)
        return
    except OSError:
        pass
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError) as err:
        raise MissingDependencyError(
            "libusb-1.0.so.0: not found, Open3D and pyrealsense2 need it: pip install libusb-package"
        ) from err
