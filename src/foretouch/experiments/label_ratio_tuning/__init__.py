# SPDX-License-Identifier: Apache-2.0
"""The tuning budget of `label_ratio`: as many trials for the PointNet as for the SR-GAN, chosen without the test samples."""
