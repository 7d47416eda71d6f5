# SPDX-License-Identifier: Apache-2.0
"""Feel before you touch: predict BioTac SP readings from a depth cloud, before the hand moves."""

__version__ = "0.2.0"
