# SPDX-License-Identifier: Apache-2.0
"""The simulator: objects on a table, a simulated depth camera, and BioTac SP fingertips that press on the objects."""
