# SPDX-License-Identifier: Apache-2.0
"""Figures and tables drawn from results; nothing is computed here."""
