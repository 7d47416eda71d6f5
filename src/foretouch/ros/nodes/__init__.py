# SPDX-License-Identifier: Apache-2.0
"""The nodes, one module each; `foretouch.ros.executables` lists and starts them."""
