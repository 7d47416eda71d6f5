# SPDX-License-Identifier: Apache-2.0
"""`foretouch`, also as `python -m foretouch`: until a command handles signals, Ctrl-C ends the process without a traceback."""

import signal
import sys


def main() -> int:
    """Run the command line; returns its exit status."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from foretouch.cli.main import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
