# SPDX-License-Identifier: Apache-2.0
"""Conversion of messages to the types of the core and back: pure functions, no node."""
