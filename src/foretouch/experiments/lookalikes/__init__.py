# SPDX-License-Identifier: Apache-2.0
"""Objects that look alike and differ in stiffness: what sight can tell of them, and what touches add."""
