# SPDX-License-Identifier: Apache-2.0
"""The steps of perception, each with its settings and topics: node `perception` runs all of them, a thin node one."""
