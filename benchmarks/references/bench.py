# SPDX-License-Identifier: Apache-2.0
"""How large is the error of each numerical kernel against a reference of 40 digits, and does its bound C ε κ hold?"""

import argparse
import sys

from benchmarks.common import write_csv
from benchmarks.references import kernels_of_clouds, kernels_of_grasps, kernels_of_models, kernels_of_touch
from benchmarks.references.reference import KERNELS, TABLE, TABLE_FILE, measure, ratio

__all__ = ["kernels_of_clouds", "kernels_of_grasps", "kernels_of_models", "kernels_of_touch"]  # they fill KERNELS


def main() -> int:
    """Measure and print, and write the measured columns of kernels.csv; the exit status is 1 if a bound is broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--levels", type=int, default=25, help="inputs between the benign and the hard end (default 25)"
    )
    parser.add_argument("--draws", type=int, default=4, help="random inputs of each level (default 4)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kernel", action="append", help="only this kernel, nothing is written; may be repeated")
    arguments = parser.parse_args()
    broken = []
    for one in KERNELS:
        if arguments.kernel and one.name not in arguments.kernel:
            continue
        cases = list(measure(one, arguments.levels, arguments.draws, arguments.seed))
        worst, conditions = max(ratio(one, case) for case in cases), [case.condition for case in cases]
        measured = {
            "worst": worst,
            "largest_error": max(case.error for case in cases),
            "least_condition": min(conditions),
            "largest_condition": max(conditions),
        }
        TABLE[one.name] |= {name: f"{value:.2g}" for name, value in measured.items()}
        print(f"{one.name:32s} C {one.constant:<6g} worst error / (ε κ) {worst:.2g}", flush=True)
        broken += [one.name] * (not worst <= one.constant)
    if not arguments.kernel:
        write_csv(TABLE_FILE, TABLE.values())
    print(f"bounds broken: {', '.join(broken) or 'none'}")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
