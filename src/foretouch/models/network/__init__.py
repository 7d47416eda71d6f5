# SPDX-License-Identifier: Apache-2.0
"""Touch networks: PointNet, the regressor, P2's generator, checkpoints, and prediction with them."""
