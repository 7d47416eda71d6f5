# SPDX-License-Identifier: Apache-2.0
"""How well is touch predicted on an object that was never felt, and after a few touches of it?"""
