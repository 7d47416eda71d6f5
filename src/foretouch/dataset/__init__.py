# SPDX-License-Identifier: Apache-2.0
"""Datasets of grasps: recordings, formats, labelling, and sources of clouds.

Import from the modules: loading one reader must not load the libraries of all formats (`formats` lists them).
"""
