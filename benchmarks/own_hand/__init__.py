# SPDX-License-Identifier: Apache-2.0
"""What does another lab get from its first recorded grasps? The benchmark `python -m benchmarks.own_hand`."""
