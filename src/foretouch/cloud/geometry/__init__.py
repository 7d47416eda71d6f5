# SPDX-License-Identifier: Apache-2.0
"""PCL's filters, neighbours in depth images, and the sampling and scaling of model inputs."""
