# SPDX-License-Identifier: Apache-2.0
"""Write a small recording of synthetic depth scenes, for replay without a camera.

    python examples/make_recording.py OUT [key=value ...]

OUT is a rosbag2 directory with MCAP storage. The keys are the settings of
`foretouch.simulation.recording.SceneRecordingConfig`, such as `count=50 width=424 height=240 seed=7`.
The same settings result in the same clouds.
"""

from __future__ import annotations

import argparse
import sys

from foretouch.config import parse_overrides
from foretouch.errors import ForetouchError
from foretouch.simulation.recording import SceneRecordingConfig, record_scenes


def main() -> int:
    """Exit status 1 after a known failure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", help="directory to create")
    parser.add_argument("settings", nargs="*", metavar="key=value")
    arguments = parser.parse_args()
    try:
        config = SceneRecordingConfig.from_mapping(parse_overrides(arguments.settings))
        count = record_scenes(arguments.out, config)
    except ForetouchError as err:
        print(err, file=sys.stderr)
        return 1
    print(f"{arguments.out}: {count} clouds of {config.width} x {config.height}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
