# SPDX-License-Identifier: Apache-2.0
"""Would more data help? Skill over the number of grasps an object, and over the number of objects."""
