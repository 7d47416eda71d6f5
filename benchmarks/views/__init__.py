# SPDX-License-Identifier: Apache-2.0
"""Does touch depend on where the camera is? The benchmark `python -m benchmarks.views`."""
