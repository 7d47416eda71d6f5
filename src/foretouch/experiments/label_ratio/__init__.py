# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 on the simulated deformables: does an SR-GAN need fewer labels than a PointNet?"""
