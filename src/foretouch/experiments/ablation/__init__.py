# SPDX-License-Identifier: Apache-2.0
"""What is each part of the contact model worth, and what are a tare and touches worth to it?"""
