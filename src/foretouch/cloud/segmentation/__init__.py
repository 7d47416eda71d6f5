# SPDX-License-Identifier: Apache-2.0
"""From a depth cloud to the table and the objects on it."""
