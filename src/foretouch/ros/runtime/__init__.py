# SPDX-License-Identifier: Apache-2.0
"""What every node is built on: lifecycle, parameters, worker threads, synchronised inputs and diagnostics."""
