# SPDX-License-Identifier: Apache-2.0
"""`foretouch record --check`: checks hand, camera and table before a session, and stores the report with the dataset."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from foretouch.cli.output import print_json, print_text, warn
from foretouch.dataset.recordings.folder import opened_to_write
from foretouch.ros.sessions.check import CHECKS, CheckFinding, SessionCheck, store_check
from foretouch.tactile.channels import finger_label

if TYPE_CHECKING:
    from foretouch.ros.nodes.recorder import RecorderNode

_REST_S = 5.0
_PRESS_S = 15.0  # longest wait for an answer
_OFFERED_S = 0.5  # how long a service is looked for
_SETTLE_S = 1.5  # until a finger that was released is at rest, and the detector has a reference again


def press_simulated(node: "RecorderNode", finger: str) -> bool:
    """Ask the hand to press a finger, such as `TH`; returns whether it is a simulated one, which can."""
    from std_srvs.srv import Trigger

    client = node.create_client(Trigger, f"press_{finger.lower()}")
    if client.wait_for_service(_OFFERED_S):
        client.call_async(Trigger.Request())
        return True
    node.destroy_client(client)
    return False


def run_check(node: "RecorderNode", arguments: argparse.Namespace) -> int:
    """Check with an active recorder that records nothing; 1 if there is a fault."""
    path = Path(arguments.output).resolve()
    with opened_to_write(path, node.identity, node.reader.sensor):
        findings = _check(node, as_json=arguments.json)
        store_check(path, findings, time.time_ns())
    faults = sum(bool(finding.fix) for finding in findings)
    warn(f"{len(findings)} checks, {faults} faults; stored in {path / CHECKS}")
    return int(bool(faults))


def _check(node: "RecorderNode", *, as_json: bool) -> list[CheckFinding]:
    """Print and return what is found."""
    from foretouch.ros.sessions.check import CheckFeed

    assert node.inputs is not None  # noqa: S101  an active node has them
    config, findings = node.config, list[CheckFinding]()
    check = SessionCheck(config.tactile.fingers, node.reader)
    feed = CheckFeed(check, node.inputs, node.reader)

    def report(new: list[CheckFinding]) -> None:
        findings.extend(new)
        for finding in new:
            if as_json:
                print_json(finding.record())
            elif finding.fix:
                print_text(f"FAULT {finding.name}: {finding.found}; fix: {finding.fix}", "red")
            else:
                print_text(f"ok    {finding.name}: {finding.found}")

    try:
        warn(f"keep the fingers open and still for {_REST_S:g} s")
        feed.receive(_REST_S)
        report(check.at_rest())
        for finger, name in zip(node.reader.channels.fingers, config.tactile.fingers, strict=True):
            check.pressed.clear()
            if press_simulated(node, finger):
                warn(f"the simulated hand presses its {finger_label(finger)} ({name})")
            else:
                warn(f"press the {finger_label(finger)} ({name}) on its pad, and let it go")
            feed.receive(_PRESS_S, lambda: bool(check.pressed))
            feed.receive(_SETTLE_S)
            check.end_press(finger)
        report(check.presses())
    finally:
        feed.close()
    return findings
