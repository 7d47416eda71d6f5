# SPDX-License-Identifier: Apache-2.0
"""Do the 90 % intervals of the contact model hold 90 % of what is read on objects that it never touched?"""
