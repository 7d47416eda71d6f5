# SPDX-License-Identifier: Apache-2.0
"""The nodes, one module each; `foretouch.ros.graph` lists and makes them, `foretouch.ros.executables` starts them."""
