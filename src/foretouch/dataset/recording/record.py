# SPDX-License-Identifier: Apache-2.0
from foretouch.dataset.record import *  # noqa: F403
from foretouch.dataset.record import APPROACH as APPROACH
from foretouch.dataset.record import HOLD as HOLD
from foretouch.dataset.record import REST as REST
from foretouch.dataset.record import Identity as Identity
from foretouch.dataset.record import Outcome as Outcome
from foretouch.dataset.record import SampleRecord as SampleRecord
from foretouch.dataset.record import TouchSeries as TouchSeries
from foretouch.dataset.record import check_name as check_name
