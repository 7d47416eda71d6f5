# SPDX-License-Identifier: Apache-2.0
"""A reader that stops reading holds up nothing, and what it did not read is counted."""

import subprocess
import sys

CODE = """
import time
from foretouch.cli.output import JsonLines
lines = JsonLines(waiting=10)
for number in range(300):
    lines.put({"number": number, "text": "x" * 10_000})
    time.sleep(0.001)
print(lines.close(0.3), lines.dropped, file=__import__("sys").stderr, flush=True)
"""


def test_a_pipe_that_nobody_reads_delays_neither_the_program_nor_its_end() -> None:
    process = subprocess.Popen([sys.executable, "-c", CODE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.wait(60.0) == 0
    out, err = process.communicate()
    done, dropped = err.split()
    assert done == "False"
    assert int(dropped) == 300 - out.count("\n")  # the lines that were written as a whole
    assert int(dropped) > 200


def test_a_reader_gets_every_line_in_order() -> None:
    code = CODE.replace("waiting=10", "waiting=1000")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=30)
    assert [line.partition(",")[0] for line in done.stdout.splitlines()] == [f'{{"number": {k}' for k in range(300)]
    assert done.stderr.split() == ["True", "0"]
