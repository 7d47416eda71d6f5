# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from every_case import every_refusal

from foretouch.errors import ContactError
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer

SOFT = ElasticLayer(modulus_pa=1e5, poisson=0.3)


def _problem(gap, layers=(SOFT,), step=1e-3):
    return ContactProblem(np.array(gap), step, layers)


def _layer(**changes):
    return ElasticLayer(**{"modulus_pa": 1e6, "poisson": 0.3, **changes})


def test_what_has_no_meaning_is_refused_and_the_modulus_of_two_equal_bodies_is_half_of_one():
    cases = [
        *((_layer, {"modulus_pa": e}, "modulus_pa: .* is not between") for e in (0.0, math.nan, 5e-324, 1e200)),
        (_layer, {"poisson": 0.51}, "poisson: 0.51 is not between 0 and 0.5"),
        (_layer, {"thickness_m": -1.0}, "thickness_m: -1.0 is not positive"),
        (_layer, {"thickness_m": math.nan}, "thickness_m: nan"),
        (_problem, {"gap": np.zeros((3, 3)), "layers": ()}, "layers: none is compliant"),
        (_problem, {"gap": np.zeros((3, 3)), "step": 0.0}, "step_m: 0.0 is not positive"),
        (Command, {}, "give force_n or depth_m, one of them"),
        (Command, {"force_n": 1.0, "depth_m": 1.0}, "give force_n or depth_m, one of them"),
        (Command, {"force_n": -1.0}, "force_n: -1.0 is negative"),
        (Command, {"depth_m": math.inf}, "depth_m: inf is not finite"),
    ]
    every_refusal(ContactError, [(rule, make, given) for make, given, rule in cases], lambda make, given: make(**given))
    problem = _problem(np.zeros((3, 3)), (SOFT, SOFT))
    assert problem.contact_modulus_pa == pytest.approx(SOFT.plane_modulus_pa / 2)
