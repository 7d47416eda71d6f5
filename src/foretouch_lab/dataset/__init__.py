# SPDX-License-Identifier: Apache-2.0
"""Training stores: how they are written, in one process or in chunks on several machines."""
