# SPDX-License-Identifier: Apache-2.0
"""Pairing of tactile readings with grasps, and of grasps with clouds: by header stamps and ids, never by arrival."""
