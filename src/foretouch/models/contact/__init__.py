# SPDX-License-Identifier: Apache-2.0
"""The contact model: forests and a kernel on the geometry at each contact."""
