# SPDX-License-Identifier: Apache-2.0
"""Commands of the laboratory: one module each, which `foretouch.cli.main` finds by name."""
