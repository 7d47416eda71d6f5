# SPDX-License-Identifier: Apache-2.0
"""What runs an experiment: cells, executors, the folder of results, tables and figures."""
