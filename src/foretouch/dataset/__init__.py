# SPDX-License-Identifier: Apache-2.0
"""Datasets of grasps: recording, reading, pairing, conversion between formats, and sources of clouds.

Import from the modules: loading one reader must not load the libraries of all formats (`formats` lists them).
"""
