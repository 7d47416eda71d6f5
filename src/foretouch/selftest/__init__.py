# SPDX-License-Identifier: Apache-2.0
"""Self-test: hard cases with their expected outcomes, references, invariances and damaged files.

`foretouch doctor --self-test` runs it on the user's machine, and the tests of the package import the same cases.
`python -m foretouch.selftest` runs it in one process and prints one line of JSON per row.
"""
