# SPDX-License-Identifier: Apache-2.0
"""Networks as torch modules, for training; a robot predicts with `foretouch.models.network.folding`."""
