# SPDX-License-Identifier: Apache-2.0
"""Old address of `calibrated_models`."""

from calibrated_models import FACTS, REST, make_calibration
from calibrated_models import save_calibrated_contact as save_contact_with_trust
from calibrated_models import save_calibrated_network as save_network_with_trust

__all__ = ["FACTS", "REST", "make_calibration", "save_contact_with_trust", "save_network_with_trust"]
