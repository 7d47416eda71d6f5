# SPDX-License-Identifier: Apache-2.0
"""Labelled samples of tactile readings, grasps and clouds: one set of rules for the recorder, imports and `foretouch.write`.

Readings are paired with grasps, and grasps with clouds, by header stamps and ids, never by arrival.
"""
