# SPDX-License-Identifier: Apache-2.0
"""Are GeoGrasp's results those of the original, and of the grasps that a robot executed? See README.md."""

import argparse
import sys

from benchmarks.common import add_data
from benchmarks.geograsp import parity

ALLOWED = {"grasp": 10, "score": 20}  # rows; the original sums in float32, where near ties may fall either way
UNDETERMINED = {
    "score_undefined": "not finite in the original, NaN with a reason here",
    "axis_sign": "undetermined by the rule in side views",
}


def main() -> int:
    """Compare, and print the differences; exit status 1 if there are more than allowed."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--every", type=int, default=1, help="use every n-th row and grasp only")
    options = parser.parse_args()
    if options.data is None:
        parser.error("--data or FORETOUCH_DATA: where are the recordings?")
    rows = parity.read_reference(options.data)[:: options.every]
    found = parity.compare_all(rows)
    print(f"original GeoGrasp, {len(rows)} rows: rows that differ, by what")
    equal = True
    for name in (*parity.COUNTS, "status", "initial_points", "grasp", "score", "axis", "centroid", "rotation"):
        allowed = ALLOWED.get(name, 0) // options.every
        equal &= found[name] <= allowed
        print(f"  {name:16} {found[name]:5}   allowed {allowed}")
    for name, why in UNDETERMINED.items():
        print(f"  {name:16} {found[name]:5}   {why}")
    executed = parity.read_executed(options.data)[:: options.every]
    rest = [grasp for grasp in executed if not parity.reproduces(grasp, grasp.slide_m)]
    unexplained = [grasp for grasp in rest if parity.explaining_slide(grasp) is None]
    by_middle, by_some = len(executed) - len(rest), len(executed) - len(unexplained)
    print(f"executed grasps, {len(executed)}: by the middle slide {by_middle}, by some {by_some}")
    return int(not equal or bool(unexplained))


if __name__ == "__main__":
    sys.exit(main())
