# SPDX-License-Identifier: Apache-2.0
"""P1's tables: five folds within cylinders and within boxes, and training on one type to test on the other."""
