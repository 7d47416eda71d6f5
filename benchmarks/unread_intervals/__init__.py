# SPDX-License-Identifier: Apache-2.0
"""Do intervals before any reading hold nine in ten readings? The benchmark `python -m benchmarks.unread_intervals`."""
