# SPDX-License-Identifier: Apache-2.0
"""How many samples a second? Equal answers from one process and from several are shown first."""

from __future__ import annotations

import argparse
import os
import sys

from scenes import scene, simulate

SCENES = ("clean", "rigid", "lookalikes", "deformables", "clutter", "everything")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=200, help="samples a scene")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("scenes", nargs="*", default=SCENES)
    arguments = parser.parse_args()
    print("| scene | same content, 1 and more workers | CPU ms a sample | wall, samples/s | failed tries |")
    print("|---|---|---|---|---|")
    for name in arguments.scenes:
        alone = simulate(scene(name), arguments.n)
        spread = simulate(scene(name), arguments.n, arguments.workers)
        same = alone.sha256 == spread.sha256
        print(
            f"| {name} | {'yes' if same else '**no**'} | {1e3 * alone.cpu_s / arguments.n:.1f} "
            f"| {arguments.n / spread.wall_s:.1f} with {arguments.workers} | {alone.simulation.failures_by_reason or ''} |",
            flush=True,
        )
        if not same:
            sys.exit(1)


if __name__ == "__main__":
    main()
