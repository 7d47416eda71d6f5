# SPDX-License-Identifier: Apache-2.0
"""Figures that several commands share; figures of an experiment lie in its own folder."""
