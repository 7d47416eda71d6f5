# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs in time, measured on the machine it runs on.

`foretouch tradeoff AREA` measures the skill of many variants of one component (`areas`) and the time of each, and names
those that no other variant beats in both: the frontier.
"""
